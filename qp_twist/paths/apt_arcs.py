"""Circles of APT: which way round a motion goes along them, and where it ends."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.apt_frames import Frames
from qp_twist.paths.apt_statements import Statement, number, taken, unit_vector
from qp_twist.paths.arcs import Arc, ArcAxis, check_radii, check_radius
from qp_twist.paths.toolpath_builder import ProgramBuilder, times

_NO_MATTER = 5e-5
"""How far from its chord an arc may be, m, where the file leaves open which of both it means."""
_SMOOTH = math.cos(math.radians(3.0))
"""Cosine of the angle up to which two motions join without a corner."""
_ANGLE_ROUNDING = math.radians(0.01)
"""How an angle of an arc is rounded."""


class Circle(NamedTuple):
    """A circle of CIRCLE or MOVARC: lengths in m, points and axis (3,).

    Its motion is by ``angle``, rad, if that is stated. A helix begins ``turns``, an arc one.
    """

    line: int
    word: str
    centre: Array
    axis: Array
    radius: float
    angle: float | None
    turns: int

    @classmethod
    def of(cls, of: Statement, start: Array, frames: Frames, scale: float) -> Circle:
        """The circle of a statement: centre, axis, perhaps a radius, an angle, turns.

        It begins at ``start``, m, (3,). The numbers are in ``frames``, ``scale`` metres each.
        """
        words = [word for word in of.arguments if word not in ("CENTER", "AXIS", "RADIUS")]
        angle, turns = (taken(of.word, words, name) for name in ("ANGLE", "TIMES"))
        # After the radius NX states tolerances and the tool's size; SolidWorks leaves it out.
        if not 6 <= len(words) <= (11 if of.word == "CIRCLE" else 7):
            raise InvalidInput(
                f"{of.word} takes the centre x, y, z, the axis i, j, k and the radius"
                + (", then ANGLE and degrees" if of.word == "MOVARC" else "")
                + f"; got {len(words)} words in {shortened(','.join(of.arguments))!r}"
            )
        if turns is not None and not (turns >= 1.0 and turns.is_integer()):
            raise InvalidInput(f"{of.word}, TIMES: expected a number of turns, got {turns:g}")
        values = [number(of.word, word) for word in words]
        if angle is not None and not 0.0 < abs(angle) <= 360.0:
            raise InvalidInput(f"{of.word}: expected an angle up to 360 degrees, got {angle:g}")
        centre = scale * frames.point(values[:3])
        axis = np.array(frames.vector(unit_vector(of.word, values[3:6])))
        check_radius(float(np.abs(centre - start).max()))
        return cls(
            of.line, of.word, centre, axis,
            scale * values[6] if len(values) > 6
            else float(np.linalg.norm(np.cross(axis, start - centre))),
            None if angle is None else math.radians(angle), int(turns or 1),
        )  # fmt: skip

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

        ``heading`` is the direction of the straight cut that led to the start, if one did.

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
    def undecided(self) -> bool:
        """Whether there are circles of an open sense, and not all beside them fits this one."""
        return bool(self.lines and (self.against_sense or not self.for_sense))

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
        on_circle = abs(float(np.linalg.norm(off)) - circle.radius) < 2e-6
        if not (flat and on_circle) or np.linalg.norm(moved) <= 1e-6:
            return
        axis = self._axis_of(circle) * circle.side
        radial = last - circle.centre
        angle = math.atan2(float(axis @ np.cross(radial, off)), float(radial @ off))
        apart = circle.radius * (1.0 - math.cos(0.5 * (angle % (2.0 * math.pi))))
        if apart >= self._out.options.arc_error:
            self.seconds.append((self._out.line, circle.line, apart))
            self._out.note("a point behind an arc is on its circle, too ({}): the motion to it is "
                           "read as a straight one.")  # fmt: skip

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
