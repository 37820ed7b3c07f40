"""External axes: joints of a cell, besides those of the arm, that its controller moves."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.errors import InvalidInput

PER_UNIT = {"rad": 1.0, "deg": float(np.degrees(1.0)), "mm": 1e3}
"""Units of a controller in one rad, or in one m."""
_EQUATION = re.compile(
    r"(?P<axis>\w+) = (?P<sign>-?)(?P<joint>\S.*?)"
    r"(?: (?P<side>[+-]) (?P<offset>[0-9.]+(?:[eE][+-]?\d+)?) (?P<unit>deg|mm))?(?: in (?:deg|mm))?"
)


class ExternalAxis(NamedTuple):
    """A joint that a controller moves as an external axis, at sign · q + offset.

    Attributes:
        joint: Its name in the model.
        slides: Whether it is a slide: its unit is mm, else degrees.
        on_part: Whether it carries the path, not the robot.
        axis: The controller's name of it; empty: the next one that the language has.
        sign: ±1.
        offset: What the controller shows at q = 0, rad or m.
    """

    joint: str
    slides: bool
    on_part: bool
    axis: str = ""
    sign: float = 1.0
    offset: float = 0.0

    @property
    def unit(self) -> str:
        """In which programs state it."""
        return "mm" if self.slides else "deg"


def as_stated(axes: Sequence[ExternalAxis], equations: Iterable[str]) -> tuple[ExternalAxis, ...]:
    """External axes by equations such as ``"E1 = -tilt + 90 deg"``, in the order of these.

    Raises:
        InvalidInput: If one is no such equation, or not each joint has one.
    """
    joints: Mapping[str, ExternalAxis] = {each.joint: each for each in axes}
    found: list[ExternalAxis] = []
    for text in equations:
        match = _EQUATION.fullmatch(text.strip())
        each = None if match is None else joints.get(match["joint"])
        if match is None or each is None or match["unit"] not in (None, each.unit):
            raise InvalidInput(
                f"external: {text!r}: expected AXIS = JOINT or AXIS = -JOINT, perhaps with + NUMBER"
                f" {each.unit if each else 'deg (or mm)'} behind it; the joints besides those of "
                f"the arm that the path needs are {', '.join(joints) or 'none'}."
            )
        size = float(match["offset"] or 0.0) / PER_UNIT[each.unit]
        sign, offset = -1.0 if match["sign"] else 1.0, -size if match["side"] == "-" else size
        found.append(each._replace(axis=match["axis"], sign=sign, offset=offset))
    if sorted(each.joint for each in found) != sorted(joints):
        missing = [name for name in joints if name not in {each.joint for each in found}]
        raise InvalidInput(
            f"external: expected one axis for each of {', '.join(joints)}; "
            f"{'there is none for ' + ', '.join(missing) if missing else 'one stands twice'}."
        )
    return tuple(found)
