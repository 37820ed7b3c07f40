"""Motions of Klartext: L, LN, LP, C, CP, CR, CT, APPR and DEP."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc, centre_of_radius, cross
from qp_twist.paths.machine_tool import MachineTool
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_facts import Facts
from qp_twist.paths.tool_axis import BY_VECTOR
from qp_twist.paths.toolpath_builder import ProgramBuilder

_PLANES = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}
"""The two axes of a circle's plane, the first that of the angle zero, and its normal.

DR+ is right-handed about the normal (TNC 640, User's Manual, *Path functions*).
"""

_SAME_POINT = 1e-6
"""m, by which programs with three decimals of a millimetre round a point."""


class Motions(MachineTool):
    """Motions of the tool by the words of Klartext."""

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        super().__init__(out, facts, assumes=False)
        self._pole: dict[str, float] = {}
        self._polar: complex | None = None  # of the last LP about its pole, m

    def move(self, block: Block) -> None:
        """L: a straight motion to the target of a block, if it has one."""
        self._refuse_axes(block)
        if block.words.keys().isdisjoint({*"XYZABC", *BY_VECTOR}):
            return
        rapid = "FMAX" in block.names
        if rapid:  # from where the rotary axes turn does not matter
            stated = {k: v for k, v in block.words.items() if k in ("A", "B", "C")}
            self.axis.angles = stated | self.axis.angles
        self.line(block, cut=not rapid)

    def move_by_normal(self, block: Block) -> None:
        """LN: a straight motion with the tool axis TX, TY, TZ, or with M128 along the normal."""
        if self.frame.plane is not None:
            raise InvalidInput("LN in a tilted plane is not read")
        vector, normal = ([block.words.get(f"{letter}{axis}", 0.0) for axis in "XYZ"]
                          for letter in "TN")  # fmt: skip
        if not any(vector) and self.tip and any(normal):
            self.out.note("NX, NY, NZ ({}) without TX, TY, TZ: the tool stands along the normal, "
                          "as by M128.")  # fmt: skip
            vector = normal
        if any(vector):
            block.words.update(zip(BY_VECTOR, vector, strict=True))
        self.move(block)

    def polar_move(self, block: Block) -> None:
        """LP: a straight motion to a polar radius and angle about the pole."""
        first, second, _, pole = self._circle()
        if not {"PR", "PA"} & block.words.keys():
            raise InvalidInput("LP: expected PR and PA")
        lacks = [name for name in ("PR", "PA") if name not in block.words]
        if lacks and self._polar is not None:
            here = complex(*(self.point() - pole)[[first, second]])
            if abs(here - self._polar) > _SAME_POINT:
                raise InvalidInput(
                    f"LP without {lacks[0]} where the tool is not where the LP before it led: "
                    "write PR and PA"
                )
        self.polar(block, "PR", "PA", pole, (first, second))
        self.move(block)
        self._polar = complex(*(self.point() - pole)[[first, second]])

    def pole(self, block: Block) -> None:
        """CC: the centre of circles, and the pole of polar coordinates, in two axes."""
        named, before, gone = {*"XYZ"} & block.words.keys(), self.at, set(self.gone)
        self.target(block)
        found, self.at, self.gone = self.at, before, gone
        if not named:
            self._pole = {axis: before[axis] for axis in "XY" if axis in before}
        else:
            kept = self._pole if len(named) == 1 else {}
            self._pole = {**kept, **{axis: found[axis] for axis in named}}

    def arc_about_pole(self, block: Block) -> None:
        """C: an arc about CC to a point; a full circle if that is where the tool is."""
        _, _, axis, pole = self._circle()
        self._arc_to(block, lambda start, end: Arc.between(start, end, pole, axis * _sense(block)))

    def arc_by_radius(self, block: Block) -> None:
        """CR: an arc by its radius, below 0 for more than 180°."""
        if "R" not in block.words:
            raise InvalidInput("CR: expected R, the radius")
        axis, radius = _plane(block) * _sense(block), self.scale() * block.words["R"]
        self._arc_to(block, lambda start, end: Arc.between(
            start, end, centre_of_radius(start, end, axis, radius), axis))  # fmt: skip

    def tangent_arc(self, block: Block) -> None:
        """CT: an arc that continues the motion before it without a corner."""
        heading, normal = self.heading(), _plane(block)
        if heading is None:
            raise InvalidInput("CT: expected a cut before it, which it continues")
        self._arc_to(block, lambda start, end: Arc.tangent(start, end, heading, normal))

    def polar_arc(self, block: Block) -> None:
        """CP: an arc or helix about CC by its angle."""
        first, second, axis, pole = self._circle()
        if "PA" not in block.words:
            raise InvalidInput("CP: expected PA or IPA, the angle")
        sweep = math.radians(block.words["PA"])
        if not block.relative("PA"):
            at = self.point() - pole
            begin, sense = math.atan2(at[second], at[first]), _sense(block)
            sweep = sense * ((sense * (sweep - begin)) % (2.0 * math.pi))
        elif sweep * block.words.get("DR", 0.0) < 0.0:
            raise InvalidInput("CP: IPA and DR have different signs")
        sweep = sweep or 2.0 * math.pi * _sense(block)

        def arc(start: Array, end: Array) -> Arc:
            around = math.copysign(1.0, sweep) * axis
            about = pole + axis * float((start - pole) @ axis)
            radial = start - about
            turned = about + math.cos(sweep) * radial + math.sin(sweep) * cross(axis, radial)
            end = turned + axis * float((end - turned) @ axis)
            return Arc(start, end, about, around, abs(sweep))

        self._arc_to(block, arc)

    def approach(self, block: Block, *, away: bool) -> None:
        """APPR and DEP: the way to the contour ends at its first point."""
        self._refuse_axes(block)
        if away:
            self.leave("XYZ")
            stated = {k: block.words[k] for k in {*"XYZ"} & block.words.keys() - block.kinds.keys()}
            self.target(Block(words=stated))
            return
        self.target(block)
        self.last = None
        self.out.rows.begin_curve()
        if len(self.at) == 3:
            self.straight({}, {}, cut=True)

    # ------------------------------------------------------------ shared

    def _refuse_axes(self, block: Block) -> None:
        """Refuse linear axes that are not read; rotary axes follow a tilted plane."""
        for name in [k for k in ("U", "V", "W", "A", "B", "C") if k in block.words]:
            if name in ("U", "V", "W"):
                if block.words[name]:
                    raise InvalidInput(f"{name}: a second linear axis is not read")
            elif self.frame.plane is not None:
                if self.tip and block.words[name]:
                    raise InvalidInput(
                        "rotary axes with M128 in a tilted plane lean the tool out of it, which is "
                        "not read"
                    )
                self.out.pass_over(f"{name} in a tilted plane")
                del block.words[name]

    def _arc_to(self, block: Block, arc_of: Callable[[Array, Array], Arc]) -> None:
        self._refuse_axes(block)
        self.arc("an arc", block, arc_of, cut="FMAX" not in block.names)

    def _circle(self) -> tuple[int, int, Array, Array]:
        """The plane of CC: its two axes, its normal; and a point of the circle's axis, m."""
        plane = _PLANES.get("".join(sorted(self._pole)))
        if plane is None:
            raise InvalidInput("expected a CC with two of X, Y and Z before it")
        pole = np.array([self._pole.get(axis, 0.0) for axis in "XYZ"])
        return plane[0], plane[1], np.eye(3)[plane[2]], pole


def _sense(block: Block) -> float:
    """1 for DR+, -1 for DR-."""
    if "DR" not in block.words:
        raise InvalidInput("the arc has no DR+ or DR-")
    return block.words["DR"]


def _plane(block: Block) -> Array:
    """The normal of the plane of an arc that has no CC."""
    named = "".join(axis for axis in "XYZ" if axis in block.words)
    return np.asarray(np.eye(3)[_PLANES.get(named, (0, 1, 2))[2]])
