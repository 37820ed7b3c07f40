"""Suggest the meaning of a table's columns by their numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array

_UNIT = 0.01
"""Tolerance of the length 1 of a direction or a quaternion."""
_EVEN = 0.05
"""Relative tolerance of equal steps of a clock."""


@dataclass(frozen=True)
class Suggestion:
    """Columns for ``[path.columns]``, and why.

    Attributes:
        columns: Column numbers, from 1, by key.
        reasons: Evidence in the numbers, one clause each.
        angle_unit: Unit of roll, pitch and yaw, if the numbers show it.
    """

    columns: dict[str, tuple[int, ...]]
    reasons: tuple[str, ...]
    angle_unit: str | None = None

    @property
    def text(self) -> str:
        """As ``qp-twist new --columns`` takes it."""
        columns = ";".join(f"{key}={','.join(map(str, at))}" for key, at in self.columns.items())
        unit = f" --angle-unit {self.angle_unit}" if self.angle_unit else ""
        return f'"{columns}"{unit}'

    def __str__(self) -> str:
        """A sentence for the user."""
        keys = ", ".join(f"{key} = {list(at)}" for key, at in self.columns.items())
        unit = f', with angle_unit = "{self.angle_unit}"' if self.angle_unit else ""
        why = f" since {', '.join(self.reasons)}" if self.reasons else ""
        return f"By the numbers in it: [path.columns] {keys}{unit}{why}; check it."


def suggested(values: Array) -> Suggestion | None:
    """Suggest the columns of a table; ``None`` if its numbers are ambiguous.

    Every choice of three neighbouring columns as a position, and of others as a direction, is rated
    by the columns that it leaves unexplained. Columns that count the rows, rise evenly like a clock
    or are constant cost little, others more. Three neighbours of length 1 in every row are a
    normal, four a quaternion; the last three after a position may be angles.

    Args:
        values: Some rows of the table, (N, columns); NaN where there is no number.
    """
    values = values[np.isfinite(values).sum(axis=1) >= 3]
    table = _Columns(values) if len(values) else None
    choices = [] if table is None else list(table.choices())
    if table is None or not choices:
        return None
    _, position, direction = min(choices, key=lambda choice: choice[0])
    columns = {"position": _named(position)}
    reasons = [f"column {k + 1} counts the rows" for k in table.counting if k not in position]
    if direction is None:
        return Suggestion(columns, tuple(reasons))
    key, at = direction
    columns[key] = _named(at)
    called = f"columns {at[0] + 1} to {at[-1] + 1}"
    if key != "rpy":
        other = {"normal": "axis", "quaternion_wxyz": "quaternion_xyzw"}[key]
        reasons.append(f"{called} have the length 1 (or {other})")
        return Suggestion(columns, tuple(reasons))
    degrees = float(np.abs(values[:, at]).max()) > 2.0 * np.pi
    reasons.append(f"{called} look like {'degrees' if degrees else 'radians'}")
    return Suggestion(columns, tuple(reasons), "deg" if degrees else "rad")


def have_length_1(values: Array) -> bool:
    """Whether each row (N, columns) has the length 1, as directions and quaternions have."""
    lengths = np.linalg.norm(values, axis=1)
    return bool(len(lengths)) and bool((np.abs(lengths - 1.0) <= _UNIT).all())


Choice = tuple[float, range, tuple[str, range] | None]
"""Cost of the unexplained columns, the position, and the kind and columns of the direction."""


class _Columns:
    """The columns of numbers of a table."""

    def __init__(self, values: Array) -> None:
        self.values = values
        self.left = [k for k in range(values.shape[1]) if np.isfinite(values[:, k]).all()]
        self.counting = [k for k in self.left if self._counts(k)]

    def choices(self) -> Iterator[Choice]:
        """Every choice, with the cost of the columns it leaves unexplained."""
        for p in self.left:
            position = range(p, p + 3)
            if not self._free(position):
                continue
            # Of equal choices prefer the first, with the direction after the position: the usual
            # order.
            price = 0.01 * p + (2.0 if all(map(self._constant, position)) else 0.0)
            price += 0.5 * self._has_length_1(position)
            price += 0.4 * len(set(position) & set(self.counting))
            for extra, direction in self._directions(position):
                used = {*position, *(direction[1] if direction else ())}
                yield price + extra + self._unexplained(used), position, direction

    def _directions(self, position: range) -> Iterator[tuple[float, tuple[str, range] | None]]:
        yield 0.0, None
        for size, key in ((3, "normal"), (4, "quaternion_wxyz")):
            for begin in self.left:
                at = range(begin, begin + size)
                if not self._free(at) or set(at) & set(position) or not self._has_length_1(at):
                    continue
                price = 0.0 if begin > position[0] else 0.05
                if size == 4 and self._is_flat(at):
                    price += 0.5
                yield price, (key, at)
        at = range(position[-1] + 1, position[-1] + 4)
        if self._free(at) and np.abs(self.values[:, at]).max() <= 360.0:
            yield 0.4, ("rpy", at)

    def _free(self, at: range) -> bool:
        return all(k in self.left for k in at)

    def _constant(self, k: int) -> bool:
        return bool(np.ptp(self.values[:, k]) == 0.0)

    def _has_length_1(self, at: range) -> bool:
        return have_length_1(self.values[:, at])

    def _is_flat(self, at: range) -> bool:
        """Whether four columns are more likely z = 0 of a flat part and a direction.

        For constant columns only if the direction is along z: (0, 1, 0, 0) turns a tool upside
        down.
        """
        if not (self._has_length_1(at[1:]) and self._constant(at[0])):
            return False
        upright = np.abs(self.values[0, at[-1]]) > 1.0 - _UNIT
        return bool(upright) or not all(map(self._constant, at))

    def _unexplained(self, used: set[int]) -> float:
        """Cost of the unexplained columns."""
        price = 0.0
        for k in self.left:
            if k in used or k in self.counting:
                continue
            first = k == min(set(self.left) - set(self.counting))
            price += 0.3 if first and self._is_clock(k) else 0.6 if self._constant(k) else 1.0
        return price

    def _counts(self, k: int) -> bool:
        """Whether a column is 0, 1, 2, … or 1, 2, 3, … or 10, 20, 30 and so on."""
        column = self.values[:, k]
        steps = np.diff(column)
        if not len(steps) or (column != np.round(column)).any() or (steps != steps[0]).any():
            return False
        return bool(steps[0] == 1.0 or (steps[0] > 1.0 and column[0] in (0.0, steps[0]) and k == 0))

    def _is_clock(self, k: int) -> bool:
        """Whether a column rises evenly."""
        steps = np.diff(self.values[:, k])
        mean = float(steps.mean()) if len(steps) else 0.0
        return mean > 0.0 and bool((np.abs(steps - mean) <= _EVEN * mean).all())


def _named(at: range) -> tuple[int, ...]:
    """Columns counted from 1."""
    return tuple(k + 1 for k in at)
