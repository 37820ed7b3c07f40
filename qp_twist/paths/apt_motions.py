"""Where the tool of an APT-CL file is, and the motions that lead it on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.apt_arcs import Arcs, Circle
from qp_twist.paths.apt_statements import unit_vector
from qp_twist.paths.arcs import Arc, ArcAxis
from qp_twist.paths.machine_tool import Hole
from qp_twist.paths.splines import clamped_cubic
from qp_twist.paths.toolpath_builder import ProgramBuilder
from qp_twist.paths.turning import vectors_at

_SHORT = 1e-6
"""A shorter motion, m, has no direction worth comparing."""


class Spline(NamedTuple):
    """A curve of NURBS, which begins where the tool is: its line, knots and control points, m."""

    line: int
    knots: list[float]
    control: list[Array]


class Motions:
    """The tool on its way.

    Attributes:
        out: The points so far.
        arcs: The circles.
        axis: The tool axis in force.
        rapid: Whether the next motion is rapid.
        last: Where the tool is, m, (3,); ``None`` if that is not known.
        heading: Direction of the straight cut that led there, (3,), likewise.
        spline: One that is not complete.
    """

    def __init__(self, out: ProgramBuilder, sense: ArcAxis) -> None:
        self.out, self.arcs = out, Arcs(out, sense)
        self.axis: tuple[float, ...] = (0.0, 0.0, 1.0)
        self.rapid = False
        self.last: Array | None = None
        self.heading: Array | None = None
        self.spline: Spline | None = None

    def begin_curve(self) -> None:
        """Begin another curve: where the tool is, is not known."""
        self.out.rows.begin_curve()
        self.last = self.heading = self.arcs.begun = self.arcs.ended = None

    def start(self, word: str) -> Array:
        """Where the tool is before a motion, m, (3,)."""
        if self.last is None:
            raise InvalidInput(f"{word}: where the tool is before it is not known; expected a GOTO")
        return self.last

    def straight_heading(self) -> Array | None:
        """Direction of the straight cut that led to where the tool is, if a cut follows it."""
        return None if self.rapid else self.heading

    def straight(self, point: Array, axis: tuple[float, ...]) -> None:
        """Add a straight motion."""
        way = None if self.last is None or self.rapid else point - self.last
        length = 0.0 if way is None else float(np.linalg.norm(way))
        self.heading = way / length if way is not None and length > _SHORT else None
        if self.arcs.ended is not None and self.last is not None:
            self.arcs.weigh(self.arcs.ended, self.last, self.heading)
        self.arcs.ended = None
        self.add([point], [axis])

    def add(self, points: Sequence[Array], axes: Sequence[Sequence[float]]) -> None:
        """Add points with the feed in force; after RAPID the motion to all of them is rapid."""
        rapid, self.rapid = self.rapid, False
        self.last, self.axis = points[-1], tuple(axes[-1])
        self.out.add(points, axes, rapid=rapid)

    def end_circle(self) -> None:
        """End a circle that no GOTO follows."""
        circle, self.arcs.begun = self.arcs.begun, None
        if circle is None:
            return
        assert self.last is not None
        with self.out.at(circle.line):
            arc = self.arcs.by_angle(circle, self.last, self.straight_heading())
            self.add_arc(arc, self.axis, circle)

    def add_arc(self, arc: Arc, tool_axis: tuple[float, ...], circle: Circle | None) -> None:
        """Add the chords of an arc; the tool axis turns in proportion to the angle."""
        points, shares = self.out.divide_arc(arc)
        begin, finish = (np.array(v) / np.linalg.norm(v) for v in (self.axis, tool_axis))
        if float(begin @ finish) < -1.0 + 1e-9:
            self.out.problem("the tool axis is turned round over an arc; which way is open")
            begin = finish
        axes = vectors_at(begin, finish, shares).tolist()
        self.heading, self.arcs.ended = None, circle
        self.add([*points], [*axes[:-1], tool_axis])

    def begun_spline(self, word: str) -> Spline:
        """The spline to which a word belongs."""
        if self.spline is None:
            raise InvalidInput(f"{word}: expected NURBS before it")
        return self.spline

    def end_spline(self) -> None:
        """Add the points of a spline whose last control point has been read."""
        spline, self.spline = self.spline, None
        if spline is None:
            return
        with self.out.at(spline.line):
            if spline.knots[-1:] != [1.0]:
                raise InvalidInput("NURBS: expected KNOT with knots that end in 1")
            points, _ = clamped_cubic(
                np.array(spline.control), np.array(spline.knots[:-1]), self.out.options.arc_error
            )
            self.heading = self.arcs.ended = None
            self.add([*points], [self.axis] * len(points))

    def bore(self, hole: Hole, point: Array, axis: tuple[float, ...]) -> None:
        """The motions of a hole at a point, its heights in the unit of the file."""
        out = self.out.scale() * unit_vector("GOTO", axis)
        near, above, bottom = (point + h * out for h in (hole.near, hole.above, hole.bottom))
        for place in [above, near] if hole.above > hole.near else [above]:
            self.rapid = True
            self.straight(place, axis)
        self.straight(bottom, axis)
        self.rapid = True
        self.straight(above, axis)
