"""Motions of Klartext: L, LN, LP, C, CP, CR, CT, APPR and DEP."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc, centre_of_radius
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.gcode_tool_axis import BY_VECTOR
from qp_twist.paths.gcode_words import Block
from qp_twist.paths.heidenhain_blocks import Words
from qp_twist.paths.machine_tool import MachineTool
from qp_twist.paths.toolpath_builder import ProgramBuilder

_PLANES = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}
"""The two axes of a circle's plane, the first that of the angle zero, and its normal.

DR+ is right-handed about the normal (TNC 640, User's Manual, *Path functions*).
"""


class Motions(MachineTool):
    """Motions of the tool by the words of Klartext."""

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        super().__init__(out, facts, assumes=False)
        self._pole: dict[str, float] = {}
        self._pole_radius: float | None = None

    def move(self, of: Words) -> None:
        """L: a straight motion."""
        self._go(of, self._block(of.values))

    def move_by_normal(self, of: Words) -> None:
        """LN: a straight motion with the tool axis TX, TY, TZ, or with M128 along the normal."""
        if self.frame.plane is not None:
            raise InvalidInput("LN in a tilted plane is not read")
        vectors = {letter: [of.values.get(f"{letter}{axis}", 0.0) for axis in "XYZ"]
                   for letter in "TN"}  # fmt: skip
        vector = vectors["T"]
        if not any(vector) and self.tip and any(vectors["N"]):
            self.out.note("NX, NY, NZ ({}) without TX, TY, TZ: the tool stands along the normal, "
                          "as by M128.")  # fmt: skip
            vector = vectors["N"]
        block = self._block(of.values)
        if any(vector):
            block.words.update(zip(BY_VECTOR, vector, strict=True))
        self._go(of, block)

    def polar_move(self, of: Words) -> None:
        """LP: a straight motion to a polar radius and angle about the pole."""
        first, second, _, pole = self._circle()
        radius, angle = self._polar(pole, first, second)
        scale, values = self.scale(), of.values
        radius = radius if self._pole_radius is None else self._pole_radius
        radius = scale * values["PR"] if "PR" in values else radius
        radius += scale * values.get("IPR", 0.0)
        angle = math.radians(values["PA"]) if "PA" in values else angle
        angle += math.radians(values.get("IPA", 0.0))
        if not (radius or angle):
            raise InvalidInput("LP: expected PR and PA")
        self._pole_radius = radius
        block = self._block({k: v for k, v in values.items() if k in ("Z", "IZ", "A", "B", "C")})
        block.words["XYZ"[first]] = (pole[first] + radius * math.cos(angle)) / scale
        block.words["XYZ"[second]] = (pole[second] + radius * math.sin(angle)) / scale
        self._go(of, block)

    def pole(self, of: Words) -> None:
        """CC: the centre of circles, and the pole of polar coordinates, in two axes."""
        named = self._block({k: v for k, v in of.values.items() if k[-1] in "XYZ"})
        before = self.at
        if not named.words:
            self._pole = {axis: before[axis] for axis in "XY" if axis in before}
        else:
            gone = set(self.gone)
            self.target(named)
            found, self.at, self.gone = self.at, before, gone
            kept = self._pole if len(named.words) == 1 else {}
            self._pole = {**kept, **{axis: found[axis] for axis in named.words}}
        self._pole_radius = None

    def arc_about_pole(self, of: Words) -> None:
        """C: an arc about CC to a point; a full circle if that is where the tool is."""
        _, _, axis, pole = self._circle()
        self._arc_to(of, lambda start, end: Arc.between(start, end, pole, axis * _sense(of)))

    def arc_by_radius(self, of: Words) -> None:
        """CR: an arc by its radius, below 0 for more than 180°."""
        if "R" not in of.values:
            raise InvalidInput("CR: expected R, the radius")
        axis, radius = _plane(of) * _sense(of), self.scale() * of.values["R"]
        self._arc_to(of, lambda start, end: Arc.between(
            start, end, centre_of_radius(start, end, axis, radius), axis))  # fmt: skip

    def tangent_arc(self, of: Words) -> None:
        """CT: an arc that continues the motion before it without a corner."""
        heading, normal = self.heading(), _plane(of)
        if heading is None:
            raise InvalidInput("CT: expected a cut before it, which it continues")

        def arc(start: Array, end: Array) -> Arc:
            chord = end - start
            chord = chord - normal * float(chord @ normal)
            side = np.cross(normal, heading)
            across = float(chord @ side)
            if abs(across) < 1e-9:
                raise InvalidInput("CT: its end is straight on, so it is no arc")
            centre = start + side * float(chord @ chord) / (2.0 * across)
            return Arc.between(start, end, centre, math.copysign(1.0, across) * normal)

        self._arc_to(of, arc)

    def polar_arc(self, of: Words) -> None:
        """CP: an arc or helix about CC by its angle."""
        first, second, axis, pole = self._circle()
        _, begin = self._polar(pole, first, second)
        if "IPA" in of.values:
            sweep = math.radians(of.values["IPA"])
            if of.sense and sweep * of.sense < 0.0:
                raise InvalidInput("CP: IPA and DR have different signs")
        elif "PA" in of.values:
            sense = _sense(of)
            sweep = sense * ((sense * (math.radians(of.values["PA"]) - begin)) % (2.0 * math.pi))
        else:
            raise InvalidInput("CP: expected PA or IPA, the angle")
        if sweep == 0.0:
            sweep = 2.0 * math.pi * _sense(of)

        def arc(start: Array, end: Array) -> Arc:
            around = math.copysign(1.0, sweep) * axis
            about = pole + axis * float((start - pole) @ axis)
            radial = start - about
            turned = about + math.cos(sweep) * radial + math.sin(sweep) * np.cross(axis, radial)
            end = turned + axis * float((end - turned) @ axis)
            return Arc(start, end, about, around, abs(sweep))

        self._arc_to(of, arc)

    def approach(self, of: Words, *, away: bool) -> None:
        """APPR and DEP: the way to the contour ends at its first point."""
        if away:
            self.leave("XYZ")
            self.target(self._block({k: v for k, v in of.values.items() if k in "XYZ"}))
            return
        self.target(self._block(of.values))
        self.last = None
        self.out.begin_curve()
        if len(self.at) == 3:
            self.straight({}, {}, cut=True)

    # ------------------------------------------------------------ shared

    def _go(self, of: Words, block: Block) -> None:
        """A straight motion to the target of a block, if it has one."""
        if not block.words:
            return
        if of.rapid:  # from where the rotary axes turn does not matter
            stated = {k: v for k, v in block.words.items() if k in ("A", "B", "C")}
            self.axis.angles = stated | self.axis.angles
        self.line(block, cut=not of.rapid)

    def _block(self, values: dict[str, float]) -> Block:
        """Coordinates as a block: IX is X, which is relative."""
        block = Block()
        for name, value in values.items():
            axis = name.removeprefix("I")
            if axis in ("U", "V", "W") and value:
                raise InvalidInput(f"{name}: a second linear axis is not read")
            if axis in ("A", "B", "C") and self.frame.plane is not None:
                if self.tip and value:
                    raise InvalidInput(
                        "rotary axes with M128 in a tilted plane lean the tool out of it, which is "
                        "not read"
                    )
                self.out.pass_over(f"{name} in a tilted plane")  # they follow it
            elif axis in ("A", "B", "C", "X", "Y", "Z"):
                block.words[axis] = value
                if axis != name:
                    block.kinds[axis] = "IC"
        return block

    def _arc_to(self, of: Words, arc_of: Callable[[Array, Array], Arc]) -> None:
        self.arc("an arc", self._block(of.values), arc_of, cut=not of.rapid)

    def _circle(self) -> tuple[int, int, Array, Array]:
        """The plane of CC: its two axes, its normal; and a point of the circle's axis, m."""
        plane = _PLANES.get("".join(sorted(self._pole)))
        if plane is None:
            raise InvalidInput("expected a CC with two of X, Y and Z before it")
        return plane[0], plane[1], np.eye(3)[plane[2]], \
            np.array([self._pole.get(axis, 0.0) for axis in "XYZ"])  # fmt: skip

    def _polar(self, pole: Array, first: int, second: int) -> tuple[float, float]:
        """Radius and angle about the pole of where the tool is; zeros if that is not known."""
        if not {"XYZ"[first], "XYZ"[second]} <= self.at.keys():
            return 0.0, 0.0
        u, v = (self.at["XYZ"[k]] - float(pole[k]) for k in (first, second))
        return math.hypot(u, v), math.atan2(v, u)


def feed_unit(out: ProgramBuilder) -> float:
    """The unit of F, m: mm, or tenths of an inch, per minute."""
    return (0.1 if out.length_unit == "inch" else 1.0) * out.scale()


def _sense(of: Words) -> int:
    if not of.sense:
        raise InvalidInput("the arc has no DR+ or DR-")
    return of.sense


def _plane(of: Words) -> Array:
    """The normal of the plane of an arc that has no CC."""
    named = "".join(axis for axis in "XYZ" if {axis, f"I{axis}"} & of.values.keys())
    return np.asarray(np.eye(3)[_PLANES.get(named, (0, 1, 2))[2]])
