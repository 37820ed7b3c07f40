"""The meaning of a table's columns by their numbers: assumed if nothing is open, or suggested."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array
from qp_twist.files import LengthUnit

Places = dict[str, tuple[int, ...]]
"""Indices of the columns of each group, in the order of the reader."""

LOOKED_AT = 500
"""Number of rows whose numbers are looked at."""
_UNIT = 0.01
"""Tolerance of the length 1 of a direction or a quaternion."""
_EVEN = 0.05
"""Relative tolerance of equal steps of a clock."""
_EPOCH = 1e8
"""Numbers above it that rise are times since 1970, in s (here: since 1973), ms, µs or ns."""
_LEANS = 40.0
"""Angle, degrees, by which a tool that points down may lean."""
_UPRIGHT = 0.9
"""Scalar of a quaternion from which a frame counts as little turned: by less than 52 degrees."""


@dataclass(frozen=True)
class Suggestion:
    """Columns for ``[path.columns]``, and why.

    Attributes:
        places: Indices of columns by key.
        reasons: Evidence in the numbers, one clause each.
        angle_unit: Unit of roll, pitch and yaw, if the numbers show it; else empty.
        settled: Whether the numbers leave nothing open, so that it may be assumed.
        length_unit: Unit of the positions, if a format that the numbers identify has one.
    """

    places: Places
    reasons: tuple[str, ...]
    angle_unit: str = ""
    settled: bool = False
    length_unit: LengthUnit | None = None

    @property
    def text(self) -> str:
        """As ``qp-twist new --columns`` takes it."""
        columns = ";".join(f"{key}={_counted(at, ',')}" for key, at in self.places.items())
        unit = f" --angle-unit {self.angle_unit}" if self.angle_unit else ""
        return f'"{columns}"{unit}'

    @property
    def note(self) -> str:
        """What was assumed by the numbers alone."""
        columns = " and ".join(
            f"columns {_counted(at)} as {key.replace('_', ' ')}" for key, at in self.places.items()
        )
        return f"no header: {columns} are read{self._why}; --columns reads it otherwise."

    @property
    def _why(self) -> str:
        return f" since {', '.join(self.reasons)}" if self.reasons else ""

    def __str__(self) -> str:
        """A sentence for the user."""
        keys = ", ".join(f"{key} = [{_counted(at)}]" for key, at in self.places.items())
        unit = f', with angle_unit = "{self.angle_unit}"' if self.angle_unit else ""
        order = ""
        if "quaternion_wxyz" in self.places and not self.reasons:
            order = ", quaternion_xyzw if its scalar is the last number"
        return f"By the numbers in it: [path.columns] {keys}{unit}{order}{self._why}; check it."


def _counted(at: Sequence[int], mark: str = ", ") -> str:
    """Columns counted from 1."""
    return mark.join(str(k + 1) for k in at)


def have_length_1(values: Array) -> bool:
    """Whether each row (N, columns) has the length 1, as directions and quaternions have."""
    lengths = np.linalg.norm(np.clip(values, -2.0, 2.0), axis=1)
    return bool(len(lengths)) and bool((np.abs(lengths - 1.0) <= _UNIT).all())


def suggested(values: Array) -> Suggestion | None:
    """Suggest the columns of a table (N, columns), NaN for no number; ``None`` if none fits.

    Every choice of three neighbouring columns as a position, and of others as a direction, is rated
    by the columns that it leaves unexplained. Columns that count the rows, rise evenly like a clock
    or are constant cost little. Three neighbours of length 1 in every row are a normal, four a
    quaternion; the last three after a position may be angles.

    It is settled if every other column counts, is a time, is 0 or has gaps, and the direction has
    one reading. Two more columns, speeds for example, may stand beside columns of length 1.
    """
    values = values[np.isfinite(values).sum(axis=1) >= 3]
    if (matrices := _matrices(values)) is not None:
        return matrices
    whole = np.flatnonzero(np.isfinite(values).all(axis=0)).tolist() if len(values) else []
    constant = {k for k in whole if np.ptp(values[:, k]) == 0.0}
    counting = [k for k in whole if _counts(values[:, k], first=k == 0) or _is_epoch(values[:, k])]
    others = [k for k in whole if k not in counting]
    unexplained = {k: 0.6 if k in constant else 1.0 for k in others}
    clock = others[0] if others and _is_clock(values[:, others[0]]) else None
    if clock is not None:
        unexplained[clock] = 0.3
    best, choice = np.inf, None
    for position in _spans(whole, 3):
        # Of equal choices prefer the first, with the direction after the position: the usual order.
        own = 0.01 * position[0] + 0.4 * len({*position} & {*counting})
        own += 2.0 * ({*position} <= constant) + 0.5 * have_length_1(values[:, position])
        for price, key, at in _directions(values, whole, constant, position):
            left = {k for k in others if k not in {*position, *at}}
            cost = own + price + sum(unexplained[k] for k in left)
            if cost < best - 1e-9:
                best, choice = cost, (position, key, at, left)
    if choice is None:
        return None
    position, key, at, left = choice
    reasons = [
        f"column {k + 1} {'has times' if _is_epoch(values[:, k]) else 'counts the rows'}"
        for k in counting if k not in position
    ]  # fmt: skip
    direction, settled, unit, spare = tuple(at), True, "", 0
    length: LengthUnit | None = None
    if key == "rpy":
        key, direction, unit, settled, what = _angles(values, at)
    elif key == "normal":
        what, spare = "have the length 1 (or axis)", 2
        left = {k for k in left if not _is_colour(values[:, k])}
    elif key:
        first = values[:, 0]
        timed = position.start == 1 and values.shape[1] == 8 and (_rises(first) or _is_epoch(first))
        order, why = quaternion_order(values[:, position], values[:, at], timed=timed)
        key, settled, spare = order or key, bool(order), 2
        length = "m" if timed and key == "quaternion_xyzw" else None
        what = f"have the length 1{why or ' (or quaternion_xyzw)'}"
    if key:
        reasons.append(f"columns {at[0] + 1} to {at[-1] + 1} {what}")
    elif clock in left and len(others) < 5:
        settled = False  # x, y, z and a speed, with x in even steps, would be read as t, x, y, z
    settled &= sum(k != clock and bool(values[:, k].any()) for k in left) <= spare
    places = {"position": tuple(position), **({key: direction} if key else {})}
    return Suggestion(places, tuple(reasons), unit, settled, length)


def _angles(values: Array, at: range) -> tuple[str, tuple[int, ...], str, bool, str]:
    """Key, columns in their order, unit, whether they are settled, and why, of three angles."""
    angles = values[:, at]
    unit = "deg" if np.abs(angles).max() > 2.0 * np.pi else "rad"
    if unit == "rad" and are_vectors(angles):
        why = "are no longer than half a turn, and nearly all close to it"
        return "rotation_vector", (*at,), "", True, why
    why = f"look like {'degrees' if unit == 'deg' else 'radians'}"
    down, level = (np.abs(np.abs(angles) - t).max(axis=0) < _LEANS for t in (180.0, 0.0))
    if level[1] and down[0] != down[2]:
        order = "x, y, z (FANUC)" if down[0] else "z, y, x (KUKA)"
        why += f", and about {order} the tool points down"
        return "rpy", (*at,) if down[0] else (*at[::-1],), unit, True, why
    return "rpy", (*at,), unit, not angles.any(), why


def are_vectors(values: Array) -> bool:
    """Whether three numbers, rad, are rotation vectors rather than angles.

    Controllers write vectors no longer than half a turn, and nearly so long of a tool that points
    down and is turned about its axis.
    """
    lengths, turned = np.linalg.norm(values, axis=1), np.linalg.norm(values[:, 1:], axis=1)
    near = lengths.max() <= 1.001 * np.pi and np.median(lengths) > 0.9 * np.pi
    return bool(near and np.median(turned) > 0.3)


def _matrices(values: Array) -> Suggestion | None:
    """Rows that are pose matrices, (3, 4) or (4, 4), row by row, or behind a time (KITTI)."""
    at, size = values.shape[1] % 4, values.shape[1] // 4
    if at > 1 or size not in (3, 4) or not np.isfinite(values).all() or not len(values):
        return None
    turns = np.clip(values[:, at : at + 12].reshape(-1, 3, 4)[:, :, :3], -2.0, 2.0)
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max()
    if off > _UNIT or (np.linalg.det(turns) < 0.0).any():
        return None
    last = (at + 3, at + 7, at + 11)
    turned = tuple(k for k in range(at, at + 12) if k not in last)
    places = {"position": last, "matrix": turned}
    return Suggestion(places, ("the rows are pose matrices",), settled=True)


def quaternion_order(
    positions: Array, quaternions: Array, *, timed: bool
) -> tuple[str | None, str]:
    """Where the scalar of quaternions (N, 4) is, and why; ``None`` if both orders are possible.

    Frames little turned with the scalar last would with the scalar first all be turned by about
    half a turn about z; with the scalar first they may as well be tools that point down, with the
    scalar last. A table of eight columns that begins with a time (``timed``) is of the TUM RGB-D
    benchmark, ``timestamp tx ty tz qx qy qz qw``, unless a first frame at the origin of its own
    motion shows another order, as in files of Stampede.
    """
    if timed and not positions[0].any() and abs(quaternions[0, 0]) > 1.0 - 1e-4:
        return "quaternion_wxyz", ", and at the origin the frame is not turned"
    if timed:
        return "quaternion_xyzw", ", after a time and x, y, z: the TUM format has the scalar last"
    if (np.abs(quaternions[:, 3]) > _UPRIGHT).all():
        return "quaternion_xyzw", ", and with the scalar last the frames are little turned"
    return None, ""


def _directions(
    values: Array, whole: Sequence[int], constant: set[int], position: range
) -> Iterator[tuple[float, str, range]]:
    """Cost, key and columns of every direction beside a position; first none."""
    yield 0.0, "", range(0)
    for size, key in ((3, "normal"), (4, "quaternion_wxyz")):
        for at in _spans(whole, size):
            if {*at} & {*position} or not have_length_1(values[:, at]):
                continue
            flat = size == 4 and _is_flat(values, constant, at)
            yield 0.05 * (at[0] < position[0]) + 0.5 * flat, key, at
    at = range(position.stop, position.stop + 3)
    if {*at} <= {*whole} and np.abs(values[:, at]).max() <= 360.0:
        yield 0.4, "rpy", at


def _spans(whole: Sequence[int], size: int) -> list[range]:
    """Neighbouring columns of numbers."""
    spans = [range(k, k + size) for k in whole]
    return [at for at in spans if {*at} <= {*whole}]


def _is_flat(values: Array, constant: set[int], at: range) -> bool:
    """Whether four columns are more likely z = 0 of a flat part and a direction.

    For constant columns only if the direction is along z: (0, 1, 0, 0) turns a tool upside down.
    """
    if at[0] not in constant or not have_length_1(values[:, at[1:]]):
        return False
    return bool(abs(values[0, at[-1]]) > 1.0 - _UNIT) or not {*at} <= constant


def _counts(column: Array, *, first: bool) -> bool:
    """Whether a column is 0, 1, 2, … or 1, 2, 3, …, or the first one 10, 20, 30 and so on."""
    steps = np.diff(column)
    if not len(steps) or (column != np.round(column)).any() or (steps != steps[0]).any():
        return False
    return bool(steps[0] == 1.0 or (steps[0] > 1.0 and column[0] in (0.0, steps[0]) and first))


def _is_clock(column: Array) -> bool:
    """Whether a column rises evenly, from 0 or later."""
    steps = np.diff(column)
    mean = float(steps.mean()) if len(steps) else 0.0
    even = mean > 0.0 and bool((np.abs(steps - mean) <= _EVEN * mean).all())
    return even and bool(column[0] >= 0.0)


def _rises(column: Array) -> bool:
    return len(column) > 1 and bool((column[1:] > column[:-1]).all() and column[0] >= 0.0)


def _is_epoch(column: Array) -> bool:
    """Whether a column has times since 1970."""
    return bool((column > _EPOCH).all())


def _is_colour(column: Array) -> bool:
    return bool(((column == np.round(column)) & (column >= 0.0) & (column <= 255.0)).all())
