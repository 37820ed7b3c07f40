"""Units of APT-CL: those of lengths and of feeds."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import LengthUnit, shortened
from qp_twist.paths.apt_statements import NUMBER, Statement, number
from qp_twist.paths.toolpath_builder import ProgramBuilder

FEED_UNITS: dict[str, LengthUnit | None] = {
    "MMPM": "mm", "MMPMIN": "mm", "IPM": "inch", "INPM": "inch", "MPM": "m", "UPM": None,
    "PERMIN": None, "MMPR": "mm", "IPR": "inch", "UPR": None, "PERREV": None,
}  # fmt: skip
"""Units of length of feeds; ``None``: the file's own one."""
PER_TURN = frozenset({"MMPR", "IPR", "UPR", "PERREV"})
"""Those per turn of the spindle; the others are per minute."""
UNITS: dict[str, LengthUnit] = {
    "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
    "METERS": "m",
}  # fmt: skip
_PLAIN = re.compile(r"[+-]?[0-9]{1,9}(\.[0-9]*)?")
"""A number of which no arithmetic overflows."""


def feed_of(of: Statement) -> tuple[float, str]:
    """The feed of FEDRAT and its unit, in either order; empty if there is none."""
    words = [argument for argument in of.arguments if argument[:1].isalpha()]
    numbers = [argument for argument in of.arguments if not argument[:1].isalpha()]
    unit = words[0] if words else ""
    if len(numbers) != 1 or len(words) > 1 or (unit and unit not in FEED_UNITS):
        raise InvalidInput(
            f"{of.word}/{shortened(','.join(of.arguments))}: expected a number and its unit, "
            f"one of {', '.join(FEED_UNITS)}"
        )
    return number(of.word, numbers[0]), unit


def turns_of(of: Statement, before: float) -> float:
    """The turns per minute after SPINDL; NaN with a speed of the surface, for any turns."""
    if {"OFF", "SFM", "SMM"} & set(of.arguments):
        return math.nan
    numbers = [argument for argument in of.arguments if NUMBER.fullmatch(argument)]
    return number(of.word, numbers[0]) if len(numbers) == 1 else before


def find_unit(out: ProgramBuilder, found: Sequence[Statement]) -> None:
    """A file without UNITS has the unit of its feeds, if all of these have the same one."""
    words = {
        argument: unit
        for of in found
        if of.word in ("FEDRAT", "CYCLE")
        for argument in of.arguments
        if (unit := FEED_UNITS.get(argument)) is not None
    }
    units = {*words.values()}
    if len(units) == 1:
        out.assume_unit(units.pop(), f"its feeds are in {', '.join(sorted(words))}")
    points = [of.arguments[:3] for of in found if of.word == "GOTO"]
    numbers = [
        [float(word) for word in point]
        for point in points
        if len(point) == 3 and all(map(_PLAIN.fullmatch, point))
    ]
    if not units and numbers:
        out.assume_unit_by_extent(float(np.ptp(numbers, axis=0).max()))
