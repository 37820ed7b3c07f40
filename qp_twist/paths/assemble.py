"""Build curves from the rows of a file, with the checks common to all formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems
from qp_twist.paths.toolpath import SAME_DIRECTION, SAME_POINT, Curve, Lines, Meaning, Toolpath
from qp_twist.paths.toolpath_columns import Orientation
from qp_twist.paths.turning import angles_between, turns_between

LARGEST_COORDINATE = 100.0
"""Coordinates beyond it, m, indicate a wrong unit."""
LARGEST_FEED = 100.0
"""Feeds above it, m/s, indicate a wrong unit."""


@dataclass
class RawCurve:
    """The rows of one curve, as they are read.

    Attributes:
        name: Of the curve; empty if the file has none.
        positions: m.
        directions: Three or four numbers for each row, or none.
        lines: Lines of the file, from 1.
        feeds: Feed of the motion to each point, m/s; NaN where the file has none.
        before: Points that lead to the first one in rapid motion; ``None`` without any.
        after: Points that lead away from the last one likewise.
    """

    name: str = ""
    positions: list[Sequence[float]] = field(default_factory=list)
    directions: list[Sequence[float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    feeds: list[float] = field(default_factory=list)
    before: RawCurve | None = None
    after: RawCurve | None = None

    def parts(self) -> list[RawCurve]:
        """The points before it, its own, and those after it, in the order of the path."""
        return [rows for rows in (self.before, self, self.after) if rows is not None]


def assembled(
    path: Path,
    orientation: Orientation,
    curves: Sequence[RawCurve],
    call: str,
    notes: Sequence[str],
    problems: Problems,
    *,
    unit: LengthUnit,
    unit_in_file: bool,
) -> Toolpath:
    """The toolpath of some curves.

    Args:
        path: The file.
        orientation: Meaning of the directions; angles in radians, a quaternion's w first.
        curves: RawCurve of at least one curve; curves without rows are left out.
        call: Name of the direction's columns in messages.
        notes: Notes of the reader.
        problems: Problems that the reader found; raised here together with those of the directions.
        unit: Unit in which the file's positions were read.
        unit_in_file: Whether the file specifies that unit itself.

    Raises:
        InvalidInput: If there is no row, a coordinate is too large, or a direction is zero.
    """
    curves = [rows for rows in curves if rows.positions]
    if not curves:
        problems.refuse()
        raise InvalidInput("there is no point in it.")
    _refuse_far(curves, problems, unit, unit_in_file=unit_in_file)
    read = [
        _curve(orientation, rows, rows.name or str(number), call, problems)
        for number, rows in enumerate(curves, start=1)
    ]
    problems.refuse()
    found, dropped = [], []
    for rows, curve in zip(curves, read, strict=True):
        kept, again = _without_repetitions(curve)
        before, after = (
            None if way is None else _curve(orientation, way, "", call, problems)
            for way in (rows.before, rows.after)
        )
        found.append(replace(kept, before=before, after=after))
        dropped += again
    problems.refuse()
    whole = orientation in ("quaternion", "rpy", "rotation_vector")
    meaning: Meaning = "rotation" if whole else orientation  # type: ignore[assignment]
    notes = list(notes)
    if dropped:
        first = f"line {dropped[0]}" if len(dropped) == 1 else f"the first in line {dropped[0]}"
        notes.append(
            f"{len(dropped)} points that repeat the one before were dropped ({first})."
            if len(dropped) > 1
            else f"a point that repeats the one before was dropped ({first})."
        )
    return Toolpath(path, meaning, tuple(found), tuple(notes), unit, unit_in_file)


def _refuse_far(
    curves: Sequence[RawCurve], problems: Problems, unit: LengthUnit, *, unit_in_file: bool
) -> None:
    """Report all points that are too far away as one problem: a wrong unit."""
    parts = [part for rows in curves for part in rows.parts()]
    positions = np.array([p for rows in parts for p in rows.positions], dtype=np.float64)
    lines = [line for rows in parts for line in rows.lines]
    apart = np.abs(positions).max(axis=1)
    far = np.flatnonzero(apart > LARGEST_COORDINATE)
    if not len(far):
        return
    more = f", and {len(far) - 1} points more are as far" if len(far) > 1 else ""
    extent = float(apart.max())
    question = UnitQuestion.of(unit, extent, LARGEST_COORDINATE, unit_in_file=unit_in_file)
    problems.add(
        lines[far[0]],
        f"the point is {apart[far[0]]:.4g} m from the origin of its file, more than "
        f"{LARGEST_COORDINATE:g} m{more}; {question.text}",
        options=question.options,
    )


class UnitQuestion(NamedTuple):
    """Whether a file is in another unit, in words, and the options that say so.

    Attributes:
        text: For a message, without a full stop.
        likely: The unit in which it is small enough; ``None`` if there is none.
        options: Options of the toolpath; none if the unit is to be changed in the file.
    """

    text: str
    likely: LengthUnit | None
    options: dict[str, str | None]

    @classmethod
    def of(cls, unit: LengthUnit, size: float, most: float, *, unit_in_file: bool) -> UnitQuestion:
        """About a file of a size (m) above ``most`` (m)."""
        factors = {other: LENGTHS[other] / LENGTHS[unit] for other in LENGTHS}
        likely = next((u for u, f in factors.items() if f < 1.0 and f * size <= most), None)
        if likely is None:
            return cls("in no unit that is known would it be small enough", None, {})
        if unit_in_file:
            how = f"the file says {unit}, so write {likely} there"
            return cls(f"is the file in {likely}? {how}", likely, {})
        how = f'if it is, say length_unit = "{likely}"'
        return cls(f"is the file in {likely}? {how}", likely, {"length_unit": likely})


def _curve(
    orientation: Orientation, rows: RawCurve, name: str, call: str, problems: Problems
) -> Curve:
    positions = np.array(rows.positions, dtype=np.float64)
    lines = np.array(rows.lines, dtype=np.int64)
    feeds = _feeds(rows, problems)
    if orientation == "none":
        return Curve(name, positions, None, None, lines, feeds)
    values = np.array(rows.directions, dtype=np.float64)
    if orientation == "rpy":
        rotations = Rotation.from_euler("xyz", values).as_matrix()
        return Curve(name, positions, None, rotations, lines, feeds)
    if orientation == "rotation_vector":
        rotations = Rotation.from_rotvec(values).as_matrix()
        return Curve(name, positions, None, rotations, lines, feeds)
    units = _unit_vectors(orientation, values, lines, call, problems)
    if orientation != "quaternion":
        return Curve(name, positions, units, None, lines, feeds)
    rotations = Rotation.from_quat(units[:, [1, 2, 3, 0]]).as_matrix()
    return Curve(name, positions, None, rotations, lines, feeds)


def _feeds(rows: RawCurve, problems: Problems) -> Array | None:
    """Feeds of the motions to the points, NaN for the first one of a curve."""
    feeds = np.array(rows.feeds or [np.nan], dtype=np.float64)
    feeds[0] = np.nan
    fast = np.flatnonzero(feeds > LARGEST_FEED)
    if len(fast):
        many = f" (and to {len(fast) - 1} points more)" if len(fast) > 1 else ""
        problems.add(
            rows.lines[fast[0]],
            f"the feed to this point{many} is {feeds[fast[0]]:.4g} m/s, more than "
            f"{LARGEST_FEED:g} m/s; check its unit",
        )
    return feeds if np.isfinite(feeds).any() else None


def _unit_vectors(
    orientation: Orientation, values: Array, lines: Lines, call: str, problems: Problems
) -> Array:
    """The directions, normalised; those of length zero are problems."""
    largest = np.abs(values).max(axis=1, keepdims=True)
    nothing = largest[:, 0] < 1e-12
    for line in lines[nothing].tolist():
        problems.add(line, f"the {orientation} is zero and has no direction", call)
    values, largest = np.where(nothing[:, None], 1.0, values), np.where(largest < 1e-12, 1, largest)
    units: Array = values / largest
    lengths = np.linalg.norm(units, axis=1)
    units /= lengths[:, None]
    if orientation == "quaternion":
        lengths *= largest[:, 0]
        for k in np.flatnonzero((np.abs(lengths - 1.0) > 0.01) & ~nothing).tolist():
            problems.add(
                int(lines[k]),
                f"the quaternion has the length {lengths[k]:.4g} instead of 1; check which columns "
                "it is in",
                call,
            )
    return units


def _without_repetitions(curve: Curve) -> tuple[Curve, list[int]]:
    """The curve without repeated points, and the lines of those."""
    same = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1) < SAME_POINT
    if curve.vectors is not None:
        same &= angles_between(curve.vectors[:-1], curve.vectors[1:]) < SAME_DIRECTION
    if curve.rotations is not None:
        same &= turns_between(curve.rotations[:-1], curve.rotations[1:]) < SAME_DIRECTION
    keep = np.concatenate([[True], ~same])
    return curve.part(keep), [int(line) for line in curve.lines[~keep]]
