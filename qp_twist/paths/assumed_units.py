"""Units that nothing states, by the numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.files import AngleUnit, LengthUnit
from qp_twist.paths.toolpath_points import LONGEST_REACH

_REACH = 2.0 * LONGEST_REACH
"""Diameter of the workspace of the longest arm on the market, m: no fixed arm has a longer path."""
_ROOM = 100.0
"""Largest path of an arm on a track or on a vehicle, m."""
_SHORT = 2.0
"""Smallest path of a robot, mm."""
_HUGE = 1e100
"""Larger numbers overflow when they are squared."""
_ROUNDED = 1e-3
"""Error of angles that are written with three decimals, rad."""
_FINE = 0.01
"""Points closer together than so many mm are finer than a robot repeats or a program rounds."""


_NAMED = re.compile(
    r"\bunits?[\"']?\s*(?:of\s+length|are|is|in)?\s*[:=]?\s*[\"']?(?P<a>{0})\b"
    r"|\b(?:values|coordinates|positions|points|dimensions|lengths?)\b[^\n]{{0,20}}\bin\s+(?P<b>{0})\b".format(
        r"mm|millimet(?:er|re)s?|m|met(?:er|re)s?|inch(?:es)?"
    ),
    re.IGNORECASE,
)
"""Words that name a unit of length outside of a header."""
_NAMES: dict[str, LengthUnit] = {
    "mm": "mm", "mil": "mm", "m": "m", "met": "m", "inc": "inch",
}  # fmt: skip
_SEARCHED = 400
"""Number of lines in which they stand."""


def named_length_unit(lines: Sequence[str]) -> tuple[LengthUnit, str] | None:
    """The unit that comments or keys of a table name, and where; ``None`` if none, or several."""
    found: dict[LengthUnit, str] = {}
    for number, line in enumerate(lines[:_SEARCHED], start=1):
        for match in _NAMED.finditer(line):
            word = (match["a"] or match["b"]).lower()
            unit = _NAMES[word[:3]]
            found.setdefault(unit, f"line {number} says {match[0].strip()!r}")
    return next(iter(found.items())) if len(found) == 1 else None


def assumed_length_unit(
    positions: Array, convention: LengthUnit | None = None
) -> tuple[LengthUnit, str] | None:
    """The only likely unit of positions (N, 3), and why; ``None`` if two are likely, or none.

    Positions are in the unit that is sought: of robots mm or m; inches have to be stated. The unit
    by ``convention`` of the program that writes such columns counts if the numbers agree. Otherwise
    they are mm if in m they would be beyond any arm, and m if in mm they would be too short or too
    close together.
    """
    if not len(positions):
        return None
    positions = np.clip(positions, -_HUGE, _HUGE)
    extent = float(np.ptp(positions, axis=0).max())
    size = max(extent, float(np.abs(positions).max()))
    step = float(np.median(np.linalg.norm(np.diff(positions, axis=0), axis=1))) if extent else 0.0
    usual = convention == "mm" and _SHORT < size <= 1e3 * _ROOM
    if convention is not None and (usual or (convention == "m" and size <= _ROOM)):
        return convention, "such columns have it by convention"
    if size > 1e3 * _ROOM:
        return None
    if size > _REACH:
        return "mm", f"nothing states it; in m it would reach {size:.4g} m, farther than any arm"
    if (extent or size) <= _SHORT:
        return "m", f"nothing states it; in mm it would be {extent or size:.3g} mm across"
    if 0.0 < step < _FINE:
        return "m", f"nothing states it; in mm its points would be {step:.2g} mm apart"
    return None


def assumed_angle_unit(
    angles: Array, convention: AngleUnit | None, length_unit: LengthUnit
) -> AngleUnit | None:
    """The likely unit of angles or rotation vectors (N, 3); ``None`` if both are.

    Angles beyond 2 π are degrees; with the ``convention`` "rad", that of rotation vectors, they are
    neither, and the unit has to be stated. Smaller ones are radians by that convention, if one is
    π/2 or π, as those of tools often are, or if positions are in metres: programs with SI units
    write both, controllers mm and degrees. A convention "deg" decides nothing (where all angles are
    0 no unit matters): columns with the same names are written in radians, too.
    """
    size = np.abs(angles[np.isfinite(angles)])
    if not size.any():
        return convention or "deg"
    if size.max() > 2.0 * np.pi:
        return None if convention == "rad" else "deg"
    quarters = np.abs(size[:, None] - np.pi * np.array([0.5, 1.0])) < _ROUNDED
    return "rad" if convention == "rad" or length_unit == "m" or quarters.any() else None
