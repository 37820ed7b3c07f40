"""Circles of APT: which way round a motion goes along them, and where it ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc, ArcAxis, angle_between, check_radii
from qp_twist.paths.toolpath_builder import ProgramBuilder, times

_ON = 2e-5
"""How near to a circle a point is on it, m."""
_NO_MATTER = 5e-5
"""How far from its chord an arc may be, m, where the file leaves open which of both it means."""
_SMOOTH = math.cos(math.radians(3.0))
"""Cosine of the angle up to which two motions join without a corner."""
_ANGLE_ROUNDING = math.radians(0.01)
"""How an angle of an arc is rounded."""


class Circle(NamedTuple):
    """A circle of CIRCLE or MOVARC.

    Attributes:
        line: Of the file.
        word: CIRCLE or MOVARC.
        centre: m, (3,).
        axis: Unit vector, (3,).
        radius: m.
        angle: Of the motion, rad, if it is stated.
        turns: Turns begun by a helix: 1 for an arc.
    """

    line: int
    word: str
    centre: Array
    axis: Array
    radius: float
    angle: float | None
    turns: int = 1

    @property
    def side(self) -> float:
        """−1 where a negative angle turns the motion round, else 1."""
        return math.copysign(1.0, self.angle or 1.0)


class Arcs:
    """The arcs of a file, read with one sense of rotation, and which sense fits them.

    Attributes:
        begun: A circle that the next GOTO ends.
        ended: The circle that the last GOTO ended.
        sense: The sense of rotation.
        lines: Lines of circles whose sense of rotation the file leaves open.
        seconds: Points on a circle that ends before them: their lines, those of the circles, and
            how far their chords are from the arcs, m.
        for_sense: How often what stands beside an arc, or its angle, fits this sense.
        against_sense: How often it fits the other sense.
    """

    def __init__(self, out: ProgramBuilder, sense: ArcAxis) -> None:
        self.begun: Circle | None = None
        self.ended: Circle | None = None
        self.lines: list[int] = []
        self.seconds: list[tuple[int, int, float]] = []
        self.for_sense = self.against_sense = 0
        self._out, self.sense = out, sense

    def ended_at(self, circle: Circle, start: Array, end: Array, heading: Array | None) -> Arc:
        """The arc from where the tool is to the point of a GOTO.

        Args:
            circle: The circle.
            start: Where the tool is, m, (3,).
            end: The point, m, (3,).
            heading: Direction of the straight cut that led to the start, (3,), if one did.

        Raises:
            InvalidInput: If the points are not on the circle.
        """
        self.lines.append(circle.line)
        try:
            arc = Arc.between(start, end, circle.centre, self._axis_of(circle), circle.radius)
        except InvalidInput as error:
            raise InvalidInput(f"{circle.word} of line {circle.line}: {error}") from None
        if circle.angle is not None:
            self._weigh_angle(circle, circle.angle, arc.sweep, start)
        self.weigh(circle, start, heading)
        return arc._replace(sweep=arc.sweep + 2.0 * math.pi * (circle.turns - 1))

    def by_angle(self, circle: Circle, start: Array, heading: Array | None) -> Arc:
        """The arc from where the tool is, on a circle that no GOTO ends, by its angle.

        Raises:
            InvalidInput: If it has no angle, or the start is not on the circle.
        """
        if circle.angle is None:
            raise InvalidInput(f"{circle.word}: no GOTO follows, so where the arc ends is open")
        axis, sweep = self._axis_of(circle) * circle.side, abs(circle.angle)
        end = circle.centre + Rotation.from_rotvec(sweep * axis).apply(start - circle.centre)
        self.lines.append(circle.line)
        try:
            check_radii(start, end, circle.centre, axis, circle.radius)
        except InvalidInput as error:
            raise InvalidInput(f"{circle.word}: {error}") from None
        self.weigh(circle, start, heading)
        return Arc(start, end, circle.centre, axis, sweep)

    def weigh(self, circle: Circle, point: Array, heading: Array | None) -> None:
        """Count whether a straight motion beside an arc continues it in this sense of rotation."""
        if heading is None:
            return
        tangent = np.cross(self._axis_of(circle), point - circle.centre) * circle.side
        length = float(np.linalg.norm(tangent))
        cosine = float(tangent @ heading) / length if length > 0.0 else 0.0
        self.for_sense += cosine > _SMOOTH
        self.against_sense += cosine < -_SMOOTH

    @property
    def all_fit(self) -> bool:
        """Whether something fits this sense, and nothing the other one."""
        return bool(self.for_sense) and not self.against_sense

    def weigh_second(self, last: Array, point: Array) -> None:
        """Remember a second GOTO on a circle: it may be a point of the arc, or end a chord.

        Where the arc goes on for so little that it is within ``arc_error`` of its chord, it is the
        chord either way.
        """
        circle = self.ended
        if circle is None:
            return
        off, moved = point - circle.centre, point - last
        off = off - circle.axis * float(off @ circle.axis)
        flat = abs(float(moved @ circle.axis)) < 1e-6
        if not flat or np.linalg.norm(moved) <= 1e-6:
            return
        if abs(float(np.linalg.norm(off)) - circle.radius) >= 2e-6:
            return
        apart = self._off_chord(circle, last, point)
        if apart >= self._out.options.arc_error:
            self.seconds.append((self._out.line, circle.line, apart))

    def refuse_open(self) -> None:
        """Refuse second GOTOs on circles, unless most circles of the file end with their first one.

        Systems that write several points of an arc do so for every arc. Up to 0.05 mm it does not
        matter: the chord is taken.
        """
        if 4 * len(self.seconds) <= len(self.lines):
            return
        for line, circle, apart in self.seconds:
            if apart >= max(_NO_MATTER, self._out.options.arc_error):
                self._out.problems.add(
                    line,
                    f"the point is on the circle of line {circle} too, and whether the motion to "
                    "it is the arc or its chord is open; have the CAM system write one GOTO for "
                    "each circle, or linear moves",
                )

    def question(self) -> str:
        """Ask in a message for the sense of rotation."""
        evidence = "no straight motion leads into one or out of one without a corner"
        if self.for_sense:
            evidence = (
                f"the motions beside them fit right-handed ones {times(self.for_sense)} and "
                f"left-handed ones {times(self.against_sense)}"
            )
        return (
            "states an axis, but CAM systems differ on the sense of the motion about it (Creo: "
            f"right-handed; NX: clockwise), and {evidence}; add "
            'arc_axis = "right" or "left" to [path] of the task file.'
        )

    def _axis_of(self, circle: Circle) -> Array:
        """The axis about which the motion is right-handed."""
        return circle.axis if self.sense == "right" else -circle.axis

    def _weigh_angle(self, circle: Circle, angle: float, sweep: float, start: Array) -> None:
        """Count whether the angle that a circle states is that of this sense of rotation."""
        near = _ANGLE_ROUNDING + 2e-5 / float(np.linalg.norm(start - circle.centre))
        fits, mirrored = (
            abs(math.remainder(either - angle, 2.0 * math.pi)) < near
            for either in (sweep, 2.0 * math.pi - sweep)
        )
        if not fits and not mirrored:
            self._out.problems.add(
                circle.line,
                f"{circle.word}: the angle is {math.degrees(angle):.6g} degrees, but the "
                f"point after it is {math.degrees(sweep):.6g} degrees on, or "
                f"{360.0 - math.degrees(sweep):.6g} the other way round",
            )
        self.for_sense += fits and not mirrored
        self.against_sense += mirrored and not fits

    def _off_chord(self, circle: Circle, last: Array, point: Array) -> float:
        """Distance of the arc from where the tool is to a point of the circle from its chord, m."""
        axis = self._axis_of(circle) * circle.side
        radial, end = last - circle.centre, point - circle.centre
        angle = math.atan2(float(axis @ np.cross(radial, end)), float(radial @ end))
        return circle.radius * (1.0 - math.cos(0.5 * (angle % (2.0 * math.pi))))


def arc_to_line(
    start: Array,
    heading: Array,
    centre: Array,
    axis: Array,
    radius: float,
    line: Sequence[Array],
    count: int,
) -> Arc:
    """A motion along a circle up to a line.

    Args:
        start: Where it begins, m, (3,).
        heading: Direction in which it begins, (3,).
        centre: Of the circle, m, (3,).
        axis: Of the circle, unit vector, (3,).
        radius: Of the circle, m.
        line: Two points of the line, m.
        count: Which crossing of the line ends the motion, from 1.

    Raises:
        InvalidInput: If the heading is more than 60° from the circle, or the line does not cross
            the circle, or ends on it elsewhere.
    """
    tangent = np.cross(axis, start - centre)
    lengths = float(np.linalg.norm(tangent) * np.linalg.norm(heading))
    cosine = float(tangent @ heading) / lengths if lengths > 0.0 else 0.0
    if abs(cosine) < 0.5:
        raise InvalidInput(
            "INDIRV is not along the circle where the tool is, so which way round is open"
        )
    axis = math.copysign(1.0, cosine) * axis
    check_radii(start, start, centre, axis, radius)
    one, two = (p - axis * float((p - centre) @ axis) for p in line)
    along = two - one
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        raise InvalidInput("the two points of LINE are the same")
    along /= length
    foot = one + along * float((centre - one) @ along)
    square = radius**2 - float((foot - centre) @ (foot - centre))
    if square <= 0.0:
        raise InvalidInput("LINE does not cross the circle")
    crossings = [foot + side * math.sqrt(square) * along for side in (1.0, -1.0)]
    sweeps = [
        2.0 * math.pi if np.linalg.norm(p - start) < _ON else angle_between(start, p, centre, axis)
        for p in crossings
    ]
    at = int(np.argsort(sweeps, kind="stable")[count - 1])
    end = crossings[at]
    on_circle = abs(float(np.linalg.norm(two - centre)) - radius) < _ON
    if on_circle and np.linalg.norm(two - end) > 2.0 * _ON:
        raise InvalidInput(
            "the second point of LINE is on the circle, but the motion crosses the line at "
            f"another point {'first' if count == 1 else 'the second time'}; which one ends it is "
            "open"
        )
    return Arc(start, end, centre, axis, sweeps[at])
