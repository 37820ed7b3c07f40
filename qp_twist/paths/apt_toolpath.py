"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, of_lines, shortened
from qp_twist.paths.apt_arcs import Circle, arc_to_line
from qp_twist.paths.apt_cycles import cycle_of
from qp_twist.paths.apt_motions import Motions
from qp_twist.paths.apt_statements import (
    NUMBER,
    Statement,
    coordinates,
    not_read,
    number,
    statements,
    taken,
    unit_vector,
)
from qp_twist.paths.apt_words import (
    BREAKS,
    CHANGES,
    DIALECTS,
    FEED_UNITS,
    IGNORED,
    PER_TURN,
    TEXT,
    UNITS,
    changes_nothing,
)
from qp_twist.paths.arcs import ArcAxis, check_radius
from qp_twist.paths.machine_tool import Hole
from qp_twist.paths.program_frame import NOTHING
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
    TooManyPoints,
)
from qp_twist.paths.toolpath_options import ReadingOptions

_ALONG = re.compile(r"\(?CIRCLE/([^()/]*?)\)?,ON(,2,INTOF)?,\(?LINE/([^()/]*?)\)?")
_MOVES = frozenset({
    "GODLTA", "CIRCLE", "MOVARC", "TLON,GOFWD", "GOFWD", "FROM", "RAPID", "TOOL PATH", "NURBS",
    "CYCLE",
})  # fmt: skip
"""Words other than GOTO before which a circle ends by its angle."""
_PLAIN = re.compile(r"[+-]?[0-9]{1,9}(\.[0-9]*)?")
"""A number of which no arithmetic overflows."""
_WORDS = ProgramWords("an APT file", "i, j, k", "RAPID", "UNITS/MM")


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of an APT-CL file.

    The point after ``RAPID`` begins another curve. Points between two ``RAPID`` belong to no curve:
    they lead to the next one. A point of ``FROM`` is left out. A tool axis holds until the next
    one; before the first, and after ``MULTAX/OFF``, it is (0, 0, 1). A feed of ``FEDRAT`` holds
    until the next one, except for motions by ``RAPID``. Arcs become polygons.

    The manuals of CAM systems differ on the sense of rotation of circles. Where a circle continues
    a straight motion without a corner, or states its angle, only one of the two fits.

    Raises:
        InvalidInput: If a line is invalid, changes the path in a way that is not supported, or
            the sense of rotation of its circles is open.
    """
    if not _has_goto("", lines):
        raise InvalidInput("there is no GOTO in it.")
    found = list(statements(lines))
    words = {word for of in found for word in (of.word, " ".join([of.word, *of.arguments[:1]]))}
    if any(line.startswith(("$$->", "$$ ->")) for line in lines):
        words.add("$$->")
    dialect = next((each for each in DIALECTS if each.words & words), None)
    by_dialect: ArcAxis = "right" if dialect is None else dialect.sense
    reader = _Reader(options, options.arc_axis or by_dialect)
    reader.read(found)
    arcs, is_open = reader.to.arcs, options.arc_axis is None and dialect is None
    if is_open and arcs.against_sense and not arcs.for_sense:
        reader = _Reader(options, "left")
        reader.read(found)
    elif is_open and arcs.lines and not reader.out.problems and not arcs.all_fit:
        raise InvalidInput(
            f"CIRCLE ({of_lines(arcs.lines)}) {arcs.question()}", options={"arc_axis": None}
        )
    sense = f", {reader.to.arcs.sense}-handed about their axes" if reader.to.arcs.lines else ""
    return reader.out.toolpath(path, has_axis=reader.has_axis, sense=sense)


def _has_goto(suffix: str, lines: Sequence[str]) -> bool:
    return any(re.match(r"\s*GOTO\s*/", line, re.IGNORECASE) for line in lines)


APT = ToolpathFormat(
    _has_goto,
    _read,
    {
        **STATED_BY_PROGRAMS,
        ("rotary", "rollover"): (
            "an APT file states tool axes as vectors; leave rotary and rollover out."
        ),
    },
)
"""APT-CL."""


class _Reader:
    """Reads the statements of a file.

    Attributes:
        out: The points so far.
        to: The tool on its way.
        has_axis: Whether the file states a tool axis.
    """

    def __init__(self, options: ReadingOptions, sense: ArcAxis) -> None:
        self.out = ProgramBuilder(options, _WORDS)
        self.to = Motions(self.out, sense)
        self.has_axis = False
        self._first: RigidTransform | None = None  # the frame of the toolpath, the first one stated
        self._now = NOTHING  # that of the points, in it
        self._moved = self._in_world = False
        self._tangent: tuple[float, ...] | None = None  # of INDIRV
        self._hole: Hole | None = None
        self._zero = 0  # the first line whose axis is zero
        self._acts: dict[str, Callable[[Statement], None]] = {
            "GOTO": self._goto, "GODLTA": self._godlta, "CIRCLE": self._circle,
            "MOVARC": self._circle, "INDIRV": self._indirv, "TLON,GOFWD": self._gofwd,
            "GOFWD": self._gofwd, "TLAXIS": self._tlaxis, "FROM": self._from,
            "RAPID": self._go_rapid, "FEDRAT": self._fedrat, "FEED": self._fedrat,
            "UNITS": self._units, "UNIT": self._units, "CYCLE": self._begin_cycle,
            "NURBS": self._nurbs, "KNOT": self._knot, "CNTRL": self._control,
            "TRNTYP": self._set_up, "CSYS": self._set_up, "TOOL PATH": self._tool_path,
            "CUTCOM": self._cutcom,
            "SET": self._set, "MODE": self._set, "SPINDL": self._spindl, "MULTAX": self._multax,
            "MSYS": self._set_frame, "MCS": self._set_frame,
        }  # fmt: skip

    def read(self, found: Sequence[Statement]) -> None:
        """Read all statements."""
        _find_unit(self.out, found)
        try:
            for of in found:
                if of.word in _MOVES:
                    self.to.end_circle()
                if of.word not in ("KNOT", "CNTRL"):
                    self.to.end_spline()
                with self.out.at(of.line):
                    self._statement(of)
            self.to.end_circle()
            self.to.end_spline()
        except TooManyPoints:
            pass  # which is one of the problems
        self.to.arcs.refuse_open()
        for line, *_ in self.to.arcs.seconds:
            self.out.line = line
            self.out.note("a point behind an arc is on its circle, too ({}): the motion to it is "
                          "read as a straight one.")  # fmt: skip
        if self._zero and self.has_axis:
            self.out.problems.add(self._zero, "the axis is zero and has no direction", "i, j, k")

    def _statement(self, of: Statement) -> None:
        """Process one statement."""
        first = re.split(r"[\s,]", of.word, maxsplit=1)[0]
        text = next((word for word in TEXT if first.startswith(word)), "")
        if of.word in self._acts:
            self._acts[of.word](of)
        elif of.word in CHANGES and not changes_nothing(of):
            raise not_read(of.word, CHANGES[of.word])
        elif of.word in BREAKS or first in BREAKS:
            self.out.pass_over(first)
            self.to.begin_curve()
        elif of.word in IGNORED or of.word in CHANGES or text:
            if first == "CALSUB":
                self.out.note("CALSUB ({}) calls a routine of the machine, which is not run here.")
            if first not in ("END-OF-PATH", "FINI"):
                self.out.pass_over(text or first)
        else:
            raise InvalidInput(
                f"{shortened(of.word or '/' + of.rest)!r} is not known, and whether it changes the "
                "path neither; take the line out if it does not"
            )

    # ------------------------------------------------------------ moves

    def _goto(self, of: Statement) -> None:
        """GOTO: a straight motion, or the end of a circle."""
        circle, self.to.arcs.begun = self.to.arcs.begun, None
        scale, last, axis, self.to.last = self.out.scale(), self.to.last, self.to.axis, None
        numbers = coordinates(of)
        if len(numbers) == 6 and not any(numbers[3:]):
            self._zero = self._zero or of.line  # the previous axis holds
        elif len(numbers) == 6:
            axis, self.has_axis = self._vector(numbers[3:6]), True
        if len(of.arguments) == 7:
            self.out.note("a seventh number of GOTO ({}) is not used; a feed is stated by FEDRAT.",
                          left_out=True)  # fmt: skip
        point, self.to.last = scale * self._point(numbers[:3]), last
        if self._hole is not None:
            self.to.bore(self._hole, point, axis)
            return
        if circle is None:
            if last is not None and not self.to.rapid:
                self.to.arcs.weigh_second(last, point)
            self.to.straight(point, axis)
            return
        assert last is not None
        try:
            arc = self.to.arcs.ended_at(circle, last, point, self.to.straight_heading())
        except InvalidInput as error:
            self.out.refuse(error)
            self.to.add([point], [axis])
        else:
            self.to.add_arc(arc, axis, circle)

    def _godlta(self, of: Statement) -> None:
        """GODLTA: a straight motion by a difference of coordinates."""
        if len(of.arguments) != 3:
            raise InvalidInput(f"GODLTA takes dx, dy, dz; got {len(of.arguments)} numbers")
        numbers = coordinates(of)
        if self.to.last is None:
            raise InvalidInput("GODLTA: where the tool is before it is not known")
        way = self._vector([self.out.scale() * value for value in numbers])
        self.to.straight(self.to.last + np.array(way), self.to.axis)

    def _circle(self, of: Statement) -> None:
        """A circle that the next GOTO ends: centre, axis, perhaps a radius, an angle, turns."""
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
        scale = self.out.scale()
        if self.to.last is None:
            raise InvalidInput(f"{of.word}: where the arc begins is not known; expected a GOTO")
        if angle is not None and not 0.0 < abs(angle) <= 360.0:
            raise InvalidInput(f"{of.word}: expected an angle up to 360 degrees, got {angle:g}")
        centre = scale * self._point(values[:3])
        axis = np.array(self._vector(unit_vector(of.word, values[3:6])))
        check_radius(float(np.abs(centre - self.to.last).max()))
        self.to.arcs.begun = Circle(
            self.out.line, of.word, centre, axis,
            scale * values[6] if len(values) > 6
            else float(np.linalg.norm(np.cross(axis, self.to.last - centre))),
            None if angle is None else math.radians(angle), int(turns or 1),
        )  # fmt: skip

    def _nurbs(self, of: Statement) -> None:
        """NURBS: a cubic spline from where the tool is, by the KNOT and CNTRL that follow."""
        self.to.begin_spline()

    def _knot(self, of: Statement) -> None:
        self.to.begun_spline("KNOT").knots.extend(number("KNOT", word) for word in of.arguments)

    def _control(self, of: Statement) -> None:
        spline = self.to.begun_spline("CNTRL")
        if len(of.arguments) != 3:
            raise InvalidInput(f"CNTRL takes x, y, z; got {len(of.arguments)} numbers")
        point = self._point(coordinates(of))
        spline.control.append(self.out.scale() * point)

    def _begin_cycle(self, of: Statement) -> None:
        """CYCLE: at each point that follows the tool goes into a hole, up to CYCLE/OFF."""
        self.out.pass_over(of.word)
        self._hole, feed = cycle_of(of)
        if self._hole is not None:
            self.out.note("CYCLE ({}): the tool goes along its axis down to the depth at once and "
                          "back, without pecking and dwelling.")  # fmt: skip
        if feed is not None:
            self._set_feed(of.word, *feed)

    def _indirv(self, of: Statement) -> None:
        """INDIRV: the direction in which GOFWD begins."""
        self._tangent = None
        self._tangent = coordinates(of)

    def _gofwd(self, of: Statement) -> None:
        """GOFWD: a motion along a circle, begun in the direction of INDIRV, up to a line."""
        heading, self._tangent = self._tangent, None
        match = _ALONG.fullmatch(re.sub(r"\s", "", of.rest.upper()))
        if match is None:
            raise InvalidInput(
                "GOFWD is a move along a surface, of which (CIRCLE/x,y,z,r),ON,(LINE/…) with six "
                "numbers is read; write the path as GOTO lines (in the CAM system: linear output)"
            )
        for text, counts in ((match[1], (4, 7)), (match[3], (6,))):
            if text.count(",") + 1 not in counts:
                expected = " or ".join(map(str, counts))
                raise InvalidInput(f"GOFWD: expected {expected} numbers, got {shortened(text)!r}")
        circle, ends = ([number("GOFWD", w) for w in text.split(",")] for text in match.group(1, 3))
        if self.to.last is None or heading is None:
            lacking = "a GOTO" if self.to.last is None else "an INDIRV"
            raise InvalidInput(f"GOFWD: expected {lacking} before it")
        scale = self.out.scale()
        centre = scale * self._point(circle[:3])
        axis = unit_vector("GOFWD", circle[3:6] if len(circle) == 7 else [0.0, 0.0, 1.0])
        axis = np.array(self._vector(axis))
        # A circle without an axis is a cylinder along z: the arc is at the height of the tool.
        centre = centre + axis * float((self.to.last - centre) @ axis)
        line = [scale * self._point(ends[k : k + 3]) for k in (0, 3)]
        try:
            arc = arc_to_line(
                self.to.last, np.array(self._vector(heading[:3])), centre, axis,
                scale * circle[-1], line, 2 if match[2] else 1,
            )  # fmt: skip
        except InvalidInput as error:
            raise InvalidInput(f"GOFWD: {error}") from None
        self.to.add_arc(arc, self.to.axis, None)

    def _from(self, of: Statement) -> None:
        self.to.begin_curve()
        coordinates(of)

    def _go_rapid(self, of: Statement) -> None:
        self.to.rapid = True

    # ------------------------------------------------------------ what holds for later moves

    def _tool_path(self, of: Statement) -> None:
        self.to.begin_curve()
        self.out.name = of.rest.split(",")[0].strip()

    def _tlaxis(self, of: Statement) -> None:
        """TLAXIS: a tool axis of its own."""
        numbers = coordinates(of) if len(of.arguments) == 3 else ()
        if not any(numbers):
            raise InvalidInput("TLAXIS takes i, j, k, not all of them zero")
        self.to.axis, self.has_axis = self._vector(numbers), True

    def _multax(self, of: Statement) -> None:
        self.out.pass_over(of.word)
        if of.arguments[:1] == ["OFF"]:
            self.to.axis = self._vector((0.0, 0.0, 1.0))

    def _cutcom(self, of: Statement) -> None:
        self.out.pass_over(of.word)
        if not {"OFF", "ADJUST"} & set(of.arguments):
            self.out.note("CUTCOM ({}) has a machine shift the path by the radius of its tool; "
                          "here the points are the path of the tool's tip.")  # fmt: skip

    def _point(self, point: Sequence[float]) -> Array:
        """A point, in the unit of the file, in the frame of the toolpath."""
        found = np.array(point)
        return found if self._now is NOTHING else self._now.apply(found)

    def _vector(self, vector: Sequence[float] | Array) -> tuple[float, ...]:
        """A direction in the frame of the toolpath."""
        found = np.array(vector, dtype=np.float64)
        turned = found if self._now is NOTHING else self._now.rotation.apply(found)
        return tuple(turned.tolist())

    def _set_frame(self, of: Statement) -> None:
        """MSYS (NX: origin, x, y), MCS (CAMplete: x, y, z, origin): the frame of the points behind.

        Points in another one than the first are moved into the first. Its z is the tool axis unless
        another one is stated.
        """
        self.out.pass_over(of.word)
        numbers = [number(of.word, argument) for argument in of.arguments]
        count = {"MSYS": 9, "MCS": 12}[of.word]
        if len(numbers) != count:
            raise InvalidInput(f"{of.word} takes {count} numbers, an origin and axes")
        axes, origin = (numbers[3:], numbers[:3]) if count == 9 else (numbers[:6], numbers[9:])
        x, y = np.reshape(axes, (2, 3))
        matrix = np.column_stack([x, y, np.cross(x, y)])
        if not np.allclose(matrix.T @ matrix, np.eye(3), atol=1e-4):
            raise InvalidInput(f"{of.word}: its axes are not perpendicular unit vectors")
        frame = RigidTransform.from_components(origin, Rotation.from_matrix(matrix))
        if self._first is None:
            self._first = frame
        way = self._first.inv() * frame
        self._now = NOTHING if np.allclose(way.as_matrix(), np.eye(4), atol=1e-9) else way
        if self._now is not NOTHING:
            self._moved = True
            self.out.note("another frame ({}): the points are moved into the first frame of the "
                          "file, and the tool axes turned.")  # fmt: skip
        if self._moved:
            self.has_axis, self.to.axis = True, self._vector((0.0, 0.0, 1.0))

    def _set_up(self, of: Statement) -> None:
        """TRNTYP, CSYS of CAMWorks: a frame of the machine's set-up, and none of the points."""
        self.out.pass_over(of.word)
        if of.word == "TRNTYP":
            if of.arguments[:1] != ["WORLD"]:
                raise not_read(f"TRNTYP/{','.join(of.arguments[:1])}", "a change of coordinates")
            self._in_world = True
        elif [number(of.word, word) for word in of.arguments] != np.eye(3, 4).ravel().tolist():
            if not self._in_world:
                raise not_read("CSYS", "a change of coordinates")
            self.out.note("CSYS ({}) is a frame of the machine's set-up; the points are in the "
                          "part's, as TRNTYP/WORLD states.")  # fmt: skip

    def _set(self, of: Statement) -> None:
        if "INCR" in of.arguments:
            raise not_read(f"{of.word}/INCR", "a change to relative coordinates")
        self.out.pass_over(of.word)

    def _units(self, of: Statement) -> None:
        if len(of.arguments) == 1 and of.arguments[0] in UNITS:
            self.out.set_unit(UNITS[of.arguments[0]], moved=bool(self.out.rows))
            return
        # The unit of the points is then unknown; a missing unit would be the same problem.
        self.out.unit = self.out.length_unit
        raise InvalidInput(f"UNITS/{shortened(','.join(of.arguments))}: expected MM or INCHES")

    def _fedrat(self, of: Statement) -> None:
        """FEDRAT: a feed, a number and its unit, in either order."""
        words = [argument for argument in of.arguments if argument[:1].isalpha()]
        numbers = [argument for argument in of.arguments if not argument[:1].isalpha()]
        unit = words[0] if words else ""
        if len(numbers) != 1 or len(words) > 1 or (unit and unit not in FEED_UNITS):
            raise InvalidInput(
                f"{of.word}/{shortened(','.join(of.arguments))}: expected a number and its unit, "
                f"one of {', '.join(FEED_UNITS)}"
            )
        if not words:
            default = self.out.length_unit
            self.out.note(f"FEDRAT without a unit ({{}}) is read as {default} per minute.")
        self._set_feed(of.word, number(of.word, numbers[0]), unit)

    def _set_feed(self, word: str, value: float, unit: str) -> None:
        scale = LENGTHS[FEED_UNITS.get(unit) or self.out.length_unit]
        self.out.feeds.state(word, value, scale, per_turn=unit in PER_TURN)

    def _spindl(self, of: Statement) -> None:
        """SPINDL: turns per minute, if the statement has them."""
        self.out.pass_over(of.word)
        numbers = [argument for argument in of.arguments if NUMBER.fullmatch(argument)]
        if {"OFF", "SFM", "SMM"} & set(of.arguments):
            self.out.feeds.turns_per_minute = math.nan  # a speed of the surface: any turns
        elif len(numbers) == 1:
            self.out.feeds.turns_per_minute = number(of.word, numbers[0])


def _find_unit(out: ProgramBuilder, found: Sequence[Statement]) -> None:
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
