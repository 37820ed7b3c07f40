"""Poles, polar coordinates and arcs of Klartext: CC, LP, C, CP, CR and CT."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc, centre_of_radius
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.heidenhain_blocks import Words
from qp_twist.paths.heidenhain_motions import StraightMotions
from qp_twist.paths.toolpath_builder import ProgramBuilder

_PLANES = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}
"""The two axes of a circle's plane, the first that of the angle zero, and its normal.

DR+ is right-handed about the normal (TNC 640, User's Manual, *Path functions*).
"""


class Motions(StraightMotions):
    """All motions: straight ones, and those about a pole or along an arc."""

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        super().__init__(out, facts)
        self._pole: dict[str, float] = {}
        self._pole_radius: float | None = None

    def polar_line(self, of: Words) -> None:
        """LP: a straight motion to a polar radius and angle about the pole."""
        first, second, _, pole = self._circle()
        radius, angle = self._polar(pole, first, second)
        radius = self.out.scale() * of.values["PR"] if "PR" in of.values else (
            self._pole_radius if self._pole_radius is not None else radius
        )  # fmt: skip
        radius += self.out.scale() * of.values.get("IPR", 0.0)
        if "PA" in of.values:
            angle = math.radians(of.values["PA"])
        angle += math.radians(of.values.get("IPA", 0.0))
        if not (radius or angle):
            raise InvalidInput("LP: expected PR and PA")
        self._pole_radius = radius
        start = self._start()
        others = {k: v for k, v in of.values.items() if k in ("Z", "IZ", "A", "B", "C")}
        scale = self.out.scale()
        others["XYZ"[first]] = (pole[first] + radius * math.cos(angle)) / scale
        others["XYZ"[second]] = (pole[second] + radius * math.sin(angle)) / scale
        self._move_to(others)
        if len(self.at) == 3:
            self._straight_to(start, self._turn(of), rapid=of.rapid)

    def pole(self, of: Words) -> None:
        """CC: the centre of circles, and the pole of polar coordinates, in two axes."""
        named = {name: value for name, value in of.values.items() if name[-1] in "XYZ"}
        at = dict(self.at)
        if not named:
            named_axes = [axis for axis in "XY" if axis in at]
            self._pole = {axis: at[axis] for axis in named_axes}
        else:
            self._pole = dict(self._pole) if len(named) == 1 else {}
            for name, value in named.items():
                if name[0] == "I" and name[-1] not in at:
                    raise InvalidInput(f"{name}: where the tool is in {name[-1]} is not known")
                before = at[name[-1]] if name[0] == "I" else 0.0
                self._pole[name[-1]] = before + self.out.scale() * value
        self._pole_radius = None

    def arc(self, of: Words) -> None:
        """C: an arc about CC to a point; a full circle if that is where the tool is."""
        _, _, axis, pole = self._circle()
        self._arc_to(of, lambda start, end: Arc.between(
            start, end, pole, axis * self._sense(of)))  # fmt: skip

    def arc_by_radius(self, of: Words) -> None:
        """CR: an arc by its radius, below 0 for more than 180°."""
        if "R" not in of.values:
            raise InvalidInput("CR: expected R, the radius")
        axis = self._plane(of) * self._sense(of)
        radius = self.out.scale() * of.values["R"]
        self._arc_to(of, lambda start, end: Arc.between(
            start, end, centre_of_radius(start, end, axis, radius), axis))  # fmt: skip

    def tangent_arc(self, of: Words) -> None:
        """CT: an arc that continues the motion before it without a corner."""
        heading, normal = self.heading, self._plane(of)
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
            sense = self._sense(of)
            sweep = sense * ((sense * (math.radians(of.values["PA"]) - begin)) % (2.0 * math.pi))
        else:
            raise InvalidInput("CP: expected PA or IPA, the angle")
        if sweep == 0.0:
            sweep = 2.0 * math.pi * self._sense(of)

        def arc(start: Array, end: Array) -> Arc:
            around = math.copysign(1.0, sweep) * axis
            about = pole + axis * float((start - pole) @ axis)
            radial = start - about
            turned = about + math.cos(sweep) * radial + math.sin(sweep) * np.cross(axis, radial)
            end = turned + axis * float((end - turned) @ axis)
            return Arc(start, end, about, around, abs(sweep))

        self._arc_to(of, arc)

    def _sense(self, of: Words) -> int:
        if not of.sense:
            raise InvalidInput("the arc has no DR+ or DR-")
        return of.sense

    def _plane(self, of: Words) -> Array:
        """The normal of the plane of an arc that has no CC."""
        named = "".join(axis for axis in "XYZ" if {axis, f"I{axis}"} & of.values.keys())
        return np.asarray(np.eye(3)[_PLANES.get(named, (0, 1, 2))[2]])

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

    def _arc_to(self, of: Words, arc_of: Callable[[Array, Array], Arc]) -> None:
        """Add an arc from where the tool is."""
        if self.corner is not None:
            self.corner = None
            raise InvalidInput("RND and CHF are read between two straight cuts alone")
        start = self._point()
        self._move_to(of.values)
        arc = arc_of(start, self._point())
        begin = self._turn(of)
        if not self.tip and self.axis.turned and not self.frame.tilted:
            self._without_tip(rapid=of.rapid)
            return
        points, shares = self.out.divide_arc(arc)
        self.at = dict(zip("XYZ", arc.end.tolist(), strict=True))
        self._add(points, begin, shares.tolist(), rapid=of.rapid)
        tangent = np.cross(arc.axis, arc.end - arc.centre)
        self.heading = tangent / np.linalg.norm(tangent)
        self._straight = False
