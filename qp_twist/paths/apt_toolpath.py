"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, shortened
from qp_twist.paths.apt_arcs import Arcs, Circle, arc_to_line
from qp_twist.paths.arcs import Arc, ArcAxis, check_radius
from qp_twist.paths.splines import clamped_cubic
from qp_twist.paths.toolpath import LARGEST_NUMBER, Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
    TooManyPoints,
    of_lines,
)
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.turning import vectors_at

_ALONG = re.compile(r"\(?CIRCLE/([^()/]*?)\)?,ON(,2,INTOF)?,\(?LINE/([^()/]*?)\)?")
_MOVES = frozenset({
    "GODLTA", "CIRCLE", "MOVARC", "TLON,GOFWD", "GOFWD", "FROM", "RAPID", "TOOL PATH", "NURBS",
    "CYCLE",
})  # fmt: skip
"""Words other than GOTO before which a circle ends by its angle."""
_SHORT = 1e-6
"""A shorter motion, m, has no direction worth comparing."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_PLAIN = re.compile(r"[+-]?[0-9]{1,9}(\.[0-9]*)?")
"""A number of which no arithmetic overflows."""
_WORDS = ProgramWords("an APT file", "i, j, k", "RAPID", "UNITS/MM")

_TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT",
         "CSI_")  # fmt: skip
"""Words followed by free text, or that concern only the operator or the machine."""

_IGNORED = frozenset({
    *_TEXT, "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO", "SPINDL", "MULTAX",
    "CUTTER", "TLDATA", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL", "AUTOPS", "PSIS",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "SETUP", "HEAD", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP", "ISN",
    "END-OF-PATH", "END", "FINI", "NOPOST", "CLPRNT", "PRINT", "AIR", "COUPLE", "PPWORD",
})  # fmt: skip
"""Words that do not change the path between two points."""

_BREAKS = frozenset({"GOHOME", "HOME", "RETRCT", "RAPTO", "LOADTL", "UNLOAD", "TURRET"})
"""Words after which the tool is at an unknown point."""

_CHANGES = {
    "ARC": "a circular move", "INDIRP": "a move along a surface",
    "TLLFT": "a move along a surface", "TLRGT": "a move along a surface",
    "GOBACK": "a move along a surface", "GOLFT": "a move along a surface",
    "GORGT": "a move along a surface", "GOUP": "a move along a surface",
    "GODOWN": "a move along a surface",
    "GOCLER": "a move to a plane", "SPLINE": "a curved move", "TRACUT": "a change of coordinates",
    "ORIGIN": "a change of coordinates", "TRANS": "a change of coordinates",
    "ROTATE": "a turn of the part", "ROTABL": "a turn of the part",
    "COPY": "a repetition", "INDEX": "a repetition", "MIRROR": "a mirrored path",
    "THREAD": "a thread", "OFSTNO": "a shifted path",
}  # fmt: skip
"""Words that change the path in a way that this reader does not support."""

_PER_MINUTE: dict[str, LengthUnit | None] = {
    "MMPM": "mm", "MMPMIN": "mm", "IPM": "inch", "INPM": "inch", "MPM": "m",
    "UPM": None, "PERMIN": None,
}  # fmt: skip
"""Units of a feed per minute; ``None``: the file's own unit of length."""
_PER_TURN: dict[str, LengthUnit | None] = {
    "MMPR": "mm", "IPR": "inch", "UPR": None, "PERREV": None,
}  # fmt: skip
"""Units of a feed per turn of the spindle."""
_FEED_UNITS = {**_PER_MINUTE, **_PER_TURN}
_UNITS: dict[str, LengthUnit] = {
    "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
    "METERS": "m",
}  # fmt: skip


class _Dialect(NamedTuple):
    """What the files of a CAM system have in common.

    Attributes:
        name: Of the system.
        words: Its files have one of these, alone or with its first argument.
        sense: Of the motion about the axis that a circle states.
    """

    name: str
    words: frozenset[str]
    sense: ArcAxis


_DIALECTS = (
    # Its manual calls the axis that of a clockwise motion.
    _Dialect("Siemens NX", frozenset({"TOOL PATH"}), "left"),
    # In public files of 41 parts, straight motions beside a circle continue it without a corner if
    # it is right-handed, but for 42 of 1,900 in three of them; those looked at turn back there.
    _Dialect("CAMWorks", frozenset({"UNIT", "TRNTYP"}), "right"),
    # Autodesk's post turns the axis round for a clockwise motion.
    _Dialect("ISO 4343", frozenset({"MOVARC CENTER"}), "right"),
)
_BORED = frozenset({"DRILL", "DEEP", "DEEP2", "BRKCHP", "CSINK", "FACE", "REAM", "BORE", "THRU"})
"""Cycles that lead the tool along its axis into a hole and back."""
_OF_CYCLE = frozenset({
    "FEDTO", "RAPTO", "RTRCTO", "DWELL", "STEP", "INCR", "1STPECK", "SUBPECK",
})  # fmt: skip
"""What a cycle states, each with a number."""


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
    statements = list(_statements(lines))
    words = {
        word for of in statements for word in (of.word, " ".join([of.word, *of.arguments[:1]]))
    }
    dialect = next((each for each in _DIALECTS if each.words & words), None)
    by_dialect: ArcAxis = "right" if dialect is None else dialect.sense
    reader = _Reader(options, options.arc_axis or by_dialect)
    reader.read(statements)
    arcs, is_open = reader.arcs, options.arc_axis is None and dialect is None
    if is_open and arcs.against_sense and not arcs.for_sense:
        reader = _Reader(options, "left")
        reader.read(statements)
    elif is_open and arcs.lines and not reader.out.problems and not arcs.all_fit:
        raise InvalidInput(
            f"CIRCLE ({of_lines(arcs.lines)}) {arcs.question()}", options={"arc_axis": None}
        )
    return reader.out.toolpath(
        path, reader.assumptions(), reader.left_out(), has_axis=reader.has_axis
    )


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


class _Statement(NamedTuple):
    """A statement: its line, its word, what follows ``/``, and the arguments in that."""

    line: int
    word: str
    rest: str
    arguments: list[str]


def _statements(lines: Sequence[str]) -> Iterator[_Statement]:
    """The statements, with the line that each begins in; ``$`` continues one, ``$$`` ends a line.

    Words and arguments are in capitals.
    """
    begun, text = 0, ""
    for number, line in enumerate([*lines, ""], start=1):
        before, dollar, _ = line.partition("$$")[0].partition("$")
        begun, text = begun or number, text + before
        if dollar and number <= len(lines):
            continue
        if text.strip():
            word, _, rest = text.strip().partition("/")
            words = (part.strip() for part in word.upper().split(","))
            arguments = [part.strip() for part in rest.upper().split(",")] if rest.strip() else []
            yield _Statement(begun, ",".join(words), rest, arguments)
        begun, text = 0, ""


class _Cycle(NamedTuple):
    """A drilling cycle: heights above each point, and the depth below it, along the axis, m."""

    depth: float
    rapid_to: float
    retract_to: float


class _Spline(NamedTuple):
    """A curve of NURBS, which begins where the tool is."""

    line: int
    knots: list[float]
    control: list[Array]


class _Reader:
    """Reads the statements of a file.

    Attributes:
        out: The points so far.
        arcs: The circles.
        has_axis: Whether the file states a tool axis.
    """

    def __init__(self, options: ReadingOptions, sense: ArcAxis) -> None:
        self.out = ProgramBuilder(options, _WORDS)
        self.arcs = Arcs(self.out, sense)
        self.has_axis = False
        self._axis: tuple[float, ...] = (0.0, 0.0, 1.0)
        self._rapid = False
        self._last: Array | None = None  # where the tool is, m; None if that is not known
        self._heading: Array | None = None  # direction of the straight cut that led there
        self._tangent: tuple[float, ...] | None = None  # of INDIRV
        self._in_world = False  # since TRNTYP/WORLD
        self._cycle: _Cycle | None = None
        self._spline: _Spline | None = None
        self._noted: dict[str, list[int]] = {
            "seventh": [], "CUTCOM": [], "FEDRAT": [], "CYCLE": [], "CSYS": [],
        }  # fmt: skip
        self._acts: dict[str, Callable[[_Statement], None]] = {
            "GOTO": self._goto, "GODLTA": self._godlta, "CIRCLE": self._circle,
            "MOVARC": self._circle, "INDIRV": self._indirv, "TLON,GOFWD": self._gofwd,
            "GOFWD": self._gofwd, "TLAXIS": self._tlaxis, "FROM": self._from,
            "RAPID": self._go_rapid, "FEDRAT": self._fedrat, "FEED": self._fedrat,
            "UNITS": self._units, "UNIT": self._units, "CYCLE": self._begin_cycle,
            "NURBS": self._nurbs, "KNOT": self._knot, "CNTRL": self._control,
            "TRNTYP": self._trntyp, "CSYS": self._csys, "TOOL PATH": self._tool_path,
            "CUTCOM": self._cutcom,
            "SET": self._set, "MODE": self._set, "SPINDL": self._spindl, "MULTAX": self._multax,
            "MSYS": lambda of: self.out.set_frame("MSYS", tuple(of.arguments)),
        }  # fmt: skip

    def read(self, statements: Sequence[_Statement]) -> None:
        """Read all statements."""
        self._find_unit(statements)
        try:
            for of in statements:
                if of.word in _MOVES:
                    self._end_circle_by_angle()
                if of.word not in ("KNOT", "CNTRL"):
                    self._end_spline()
                with self.out.at(of.line):
                    self._statement(of)
            self._end_circle_by_angle()
            self._end_spline()
        except TooManyPoints:
            pass  # which is one of the problems

    def left_out(self) -> list[str]:
        """What was passed over beside single words."""
        if not (lines := self._noted["seventh"]):
            return []
        return [
            f"a seventh number of GOTO ({of_lines(lines)}) is not used; a feed is stated by FEDRAT."
        ]

    def assumptions(self) -> list[str]:
        """What was assumed about arcs, cycles, frames and feeds."""
        where = {what: of_lines(lines) for what, lines in self._noted.items() if lines}
        found: list[str] = []
        if "CUTCOM" in where:
            found.append(
                f"CUTCOM ({where['CUTCOM']}) has a machine shift the path by the radius of its "
                "tool; here the points are the path of the tool's tip."
            )
        if "CYCLE" in where:
            found.append(
                f"CYCLE ({where['CYCLE']}): the tool goes along its axis down to the depth at once "
                "and back, without pecking and dwelling."
            )
        if "CSYS" in where:
            found.append(
                f"CSYS ({where['CSYS']}) is a frame of the machine's set-up; the points are in the "
                "part's, as TRNTYP/WORLD states."
            )
        sense = f", {self.arcs.sense}-handed about their axes" if self.arcs.lines else ""
        found += self.out.divided(sense)
        if "FEDRAT" in where:
            unit = self.out.length_unit
            found.append(f"FEDRAT without a unit ({where['FEDRAT']}) is read as {unit} per minute.")
        return found

    def _statement(self, of: _Statement) -> None:
        """Process one statement."""
        first = re.split(r"[\s,]", of.word, maxsplit=1)[0]
        text = next((word for word in _TEXT if first.startswith(word)), "")
        if of.word in self._acts:
            self._acts[of.word](of)
        elif of.word in _CHANGES and not _changes_nothing(of):
            raise _not_read(of.word, _CHANGES[of.word])
        elif of.word in _BREAKS or first in _BREAKS:
            self.out.pass_over(first)
            self._begin_curve()
        elif of.word in _IGNORED or of.word in _CHANGES or text:
            if first not in ("END-OF-PATH", "FINI"):
                self.out.pass_over(text or first)
        else:
            raise InvalidInput(
                f"{shortened(of.word or '/' + of.rest)!r} is not known, and whether it changes the "
                "path neither; take the line out if it does not"
            )

    # ------------------------------------------------------------ moves

    def _goto(self, of: _Statement) -> None:
        """GOTO: a straight motion, or the end of a circle."""
        circle, self.arcs.begun = self.arcs.begun, None
        scale, last, axis, self._last = self.out.scale(), self._last, self._axis, None
        numbers = _coordinates(of)
        if len(numbers) == 6 and not any(numbers[3:]):
            # Report it once: the points for which it would hold keep the previous axis.
            self.out.problem("the axis is zero and has no direction", "i, j, k")
        elif len(numbers) == 6:
            axis, self.has_axis = numbers[3:], True
        if len(of.arguments) == 7:
            self._noted["seventh"].append(self.out.line)
        point, self._last = scale * np.array(numbers[:3]), last
        if self._cycle is not None:
            self._bore(self._cycle, point, axis)
            return
        if circle is None:
            if last is not None and not self._rapid:
                self.arcs.refuse_open(last, point)
            self._straight(point, axis)
            return
        assert last is not None
        try:
            arc = self.arcs.ended_at(circle, last, point, self._straight_heading())
        except InvalidInput as error:
            self.out.refuse(error)
            self._add([point], [axis])
        else:
            self._add_arc(arc, axis, circle)

    def _godlta(self, of: _Statement) -> None:
        """GODLTA: a straight motion by a difference of coordinates."""
        if len(of.arguments) != 3:
            raise InvalidInput(f"GODLTA takes dx, dy, dz; got {len(of.arguments)} numbers")
        numbers = _coordinates(of)
        if self._last is None:
            raise InvalidInput("GODLTA: where the tool is before it is not known")
        self._straight(self._last + self.out.scale() * np.array(numbers), self._axis)

    def _circle(self, of: _Statement) -> None:
        """A circle that the next GOTO ends: centre, axis, perhaps a radius, an angle, turns."""
        words = [word for word in of.arguments if word not in ("CENTER", "AXIS", "RADIUS")]
        angle, turns = (_taken(of.word, words, name) for name in ("ANGLE", "TIMES"))
        # After the radius NX states tolerances and the tool's size; SolidWorks leaves it out.
        if not 6 <= len(words) <= (11 if of.word == "CIRCLE" else 7):
            raise InvalidInput(
                f"{of.word} takes the centre x, y, z, the axis i, j, k and the radius"
                + (", then ANGLE and degrees" if of.word == "MOVARC" else "")
                + f"; got {len(words)} words in {shortened(','.join(of.arguments))!r}"
            )
        if turns is not None and not (turns >= 1.0 and turns.is_integer()):
            raise InvalidInput(f"{of.word}, TIMES: expected a number of turns, got {turns:g}")
        values = [_number(of.word, word) for word in words]
        scale = self.out.scale()
        if self._last is None:
            raise InvalidInput(f"{of.word}: where the arc begins is not known; expected a GOTO")
        if angle is not None and not 0.0 < abs(angle) <= 360.0:
            raise InvalidInput(f"{of.word}: expected an angle up to 360 degrees, got {angle:g}")
        centre, axis = scale * np.array(values[:3]), _unit(of.word, values[3:6])
        check_radius(float(np.abs(centre - self._last).max()))
        self.arcs.begun = Circle(
            self.out.line, of.word, centre, axis,
            scale * values[6] if len(values) > 6
            else float(np.linalg.norm(np.cross(axis, self._last - centre))),
            None if angle is None else math.radians(angle), int(turns or 1),
        )  # fmt: skip

    def _nurbs(self, of: _Statement) -> None:
        """NURBS: a cubic spline from where the tool is, by the KNOT and CNTRL that follow."""
        if self._last is None:
            raise InvalidInput("NURBS: where the curve begins is not known; expected a GOTO")
        self._spline = _Spline(self.out.line, [], [self._last])

    def _knot(self, of: _Statement) -> None:
        if self._spline is None:
            raise InvalidInput("KNOT: expected NURBS before it")
        self._spline.knots.extend(_number("KNOT", argument) for argument in of.arguments)

    def _control(self, of: _Statement) -> None:
        if self._spline is None:
            raise InvalidInput("CNTRL: expected NURBS before it")
        if len(of.arguments) != 3:
            raise InvalidInput(f"CNTRL takes x, y, z; got {len(of.arguments)} numbers")
        self._spline.control.append(self.out.scale() * np.array(_coordinates(of)))

    def _end_spline(self) -> None:
        """Add the points of a spline whose last control point has been read."""
        spline, self._spline = self._spline, None
        if spline is None:
            return
        with self.out.at(spline.line):
            if spline.knots[-1:] != [1.0]:
                raise InvalidInput("NURBS: expected KNOT with knots that end in 1")
            points, _ = clamped_cubic(
                np.array(spline.control), np.array(spline.knots[:-1]), self.out.options.arc_error
            )
            self._heading = self.arcs.ended = None
            self._add([*points], [self._axis] * len(points))

    def _begin_cycle(self, of: _Statement) -> None:
        """CYCLE: at each point that follows the tool goes into a hole, up to CYCLE/OFF."""
        kind = (of.arguments or [""])[0]
        self.out.pass_over(of.word)
        if kind in ("OFF", "CLEAR", "INIT"):
            self._cycle = None
            return
        if kind not in _BORED:
            raise _not_read(f"CYCLE/{kind}", "a cycle")
        values = _by_name(f"CYCLE/{kind}", of.arguments[1:], _OF_CYCLE | _FEED_UNITS.keys())
        if "FEDTO" not in values or "RAPTO" not in values:
            raise InvalidInput(f"CYCLE/{kind}: expected FEDTO and RAPTO, each with a distance")
        for unit in _FEED_UNITS.keys() & values:
            self._set_feed(of.word, values[unit], unit)
        depth, rapid_to = values["FEDTO"], values["RAPTO"]
        scale = self.out.scale()
        # FEDTO is a depth, in some systems with a minus; the tool does not go further out than in.
        above = max(values.get("RTRCTO", rapid_to), rapid_to)
        self._cycle = _Cycle(scale * abs(depth), scale * rapid_to, scale * above)
        self._noted["CYCLE"].append(self.out.line)

    def _bore(self, cycle: _Cycle, point: Array, axis: tuple[float, ...]) -> None:
        """The motions of a cycle at a point: above it, near it, into it, and back."""
        out = _unit("GOTO", axis)
        near, above = (point + height * out for height in (cycle.rapid_to, cycle.retract_to))
        for place in [above, near] if cycle.retract_to > cycle.rapid_to else [above]:
            self._rapid = True
            self._straight(place, axis)
        self._straight(point - cycle.depth * out, axis)
        self._rapid = True
        self._straight(above, axis)

    def _indirv(self, of: _Statement) -> None:
        """INDIRV: the direction in which GOFWD begins."""
        self._tangent = None
        self._tangent = _coordinates(of)

    def _gofwd(self, of: _Statement) -> None:
        """GOFWD: a motion along a circle, begun in the direction of INDIRV, up to a line."""
        heading, self._tangent = self._tangent, None
        match = _ALONG.fullmatch(re.sub(r"\s", "", of.rest.upper()))
        if match is None:
            raise InvalidInput(
                "GOFWD is a move along a surface, of which (CIRCLE/x,y,z,r),ON,(LINE/…) with six "
                "numbers is read; write the path as GOTO lines (in the CAM system: linear output)"
            )
        circle, ends = _nested(match[1], (4, 7)), _nested(match[3], (6,))
        if self._last is None or heading is None:
            lacking = "a GOTO" if self._last is None else "an INDIRV"
            raise InvalidInput(f"GOFWD: expected {lacking} before it")
        scale = self.out.scale()
        centre = scale * np.array(circle[:3])
        axis = _unit("GOFWD", circle[3:6] if len(circle) == 7 else [0.0, 0.0, 1.0])
        # A circle without an axis is a cylinder along z: the arc is at the height of the tool.
        centre = centre + axis * float((self._last - centre) @ axis)
        line = [scale * np.array(ends[k : k + 3]) for k in (0, 3)]
        try:
            arc = arc_to_line(
                self._last, np.array(heading[:3]), centre, axis, scale * circle[-1], line,
                2 if match[2] else 1,
            )  # fmt: skip
        except InvalidInput as error:
            raise InvalidInput(f"GOFWD: {error}") from None
        self._add_arc(arc, self._axis, None)

    def _from(self, of: _Statement) -> None:
        self._begin_curve()
        _coordinates(of)

    def _go_rapid(self, of: _Statement) -> None:
        self._rapid = True

    # ------------------------------------------------------------ what holds for later moves

    def _tool_path(self, of: _Statement) -> None:
        self._begin_curve()
        self.out.name = of.rest.split(",")[0].strip()

    def _tlaxis(self, of: _Statement) -> None:
        """TLAXIS: a tool axis of its own."""
        numbers = _coordinates(of) if len(of.arguments) == 3 else ()
        if not any(numbers):
            raise InvalidInput("TLAXIS takes i, j, k, not all of them zero")
        self._axis, self.has_axis = numbers, True

    def _multax(self, of: _Statement) -> None:
        self.out.pass_over(of.word)
        if of.arguments[:1] == ["OFF"]:
            self._axis = (0.0, 0.0, 1.0)

    def _cutcom(self, of: _Statement) -> None:
        self.out.pass_over(of.word)
        if not {"OFF", "ADJUST"} & set(of.arguments):
            self._noted["CUTCOM"].append(self.out.line)

    def _trntyp(self, of: _Statement) -> None:
        """TRNTYP: the frame of the points that follow."""
        self.out.pass_over(of.word)
        if of.arguments[:1] != ["WORLD"]:
            raise _not_read(f"TRNTYP/{','.join(of.arguments[:1])}", "a change of coordinates")
        self._in_world = True

    def _csys(self, of: _Statement) -> None:
        """CSYS: rows of a rotation, each with a part of an origin, of the machine's set-up."""
        numbers = [_number(of.word, argument) for argument in of.arguments]
        self.out.pass_over(of.word)
        if numbers == np.eye(3, 4).ravel().tolist():
            return
        if not self._in_world:
            raise _not_read("CSYS", "a change of coordinates")
        self._noted["CSYS"].append(self.out.line)

    def _set(self, of: _Statement) -> None:
        if "INCR" in of.arguments:
            raise _not_read(f"{of.word}/INCR", "a change to relative coordinates")
        self.out.pass_over(of.word)

    def _find_unit(self, statements: Sequence[_Statement]) -> None:
        """A file without UNITS has the unit of its feeds, if all of these have the same one."""
        words = {
            argument: unit
            for of in statements
            if of.word in ("FEDRAT", "CYCLE")
            for argument in of.arguments
            if (unit := _FEED_UNITS.get(argument)) is not None
        }
        units = {*words.values()}
        if len(units) == 1:
            self.out.assume_unit(units.pop(), f"its feeds are in {', '.join(sorted(words))}")
        points = [of.arguments[:3] for of in statements if of.word == "GOTO"]
        numbers = [
            [float(word) for word in point]
            for point in points
            if len(point) == 3 and all(map(_PLAIN.fullmatch, point))
        ]
        if not units and numbers:
            self.out.assume_unit_by_extent(float(np.ptp(numbers, axis=0).max()))

    def _units(self, of: _Statement) -> None:
        if len(of.arguments) == 1 and of.arguments[0] in _UNITS:
            self.out.set_unit(_UNITS[of.arguments[0]], moved=bool(self.out.rows))
            return
        # The unit of the points is then unknown; a missing unit would be the same problem.
        self.out.unit = self.out.length_unit
        raise InvalidInput(f"UNITS/{shortened(','.join(of.arguments))}: expected MM or INCHES")

    def _fedrat(self, of: _Statement) -> None:
        """FEDRAT: a feed, a number and its unit, in either order."""
        words = [argument for argument in of.arguments if argument[:1].isalpha()]
        numbers = [argument for argument in of.arguments if not argument[:1].isalpha()]
        unit = words[0] if words else ""
        if len(numbers) != 1 or len(words) > 1 or (unit and unit not in _FEED_UNITS):
            raise InvalidInput(
                f"{of.word}/{shortened(','.join(of.arguments))}: expected a number and its unit, "
                f"one of {', '.join(_FEED_UNITS)}"
            )
        if not words:
            self._noted["FEDRAT"].append(self.out.line)
        self._set_feed(of.word, _number(of.word, numbers[0]), unit)

    def _set_feed(self, word: str, value: float, unit: str) -> None:
        if value <= 0.0:
            raise InvalidInput(f"{word}: expected a feed above 0, got {value:g}")
        scale = LENGTHS[_FEED_UNITS.get(unit) or self.out.length_unit]
        self.out.feeds.set(scale * value, per_turn=unit in _PER_TURN)

    def _spindl(self, of: _Statement) -> None:
        """SPINDL: turns per minute, if the statement has them."""
        self.out.pass_over(of.word)
        numbers = [argument for argument in of.arguments if _NUMBER.fullmatch(argument)]
        if {"OFF", "SFM", "SMM"} & set(of.arguments):
            self.out.feeds.turns_per_minute = math.nan  # a speed of the surface: any turns
        elif len(numbers) == 1:
            self.out.feeds.turns_per_minute = _number(of.word, numbers[0])

    # ------------------------------------------------------------ motions

    def _begin_curve(self) -> None:
        """Begin another curve: where the tool is, is not known."""
        self.out.begin_curve()
        self._last = self._heading = self.arcs.begun = self.arcs.ended = None

    def _straight_heading(self) -> Array | None:
        """Direction of the straight cut that led to where the tool is, if a cut follows it."""
        return None if self._rapid else self._heading

    def _straight(self, point: Array, axis: tuple[float, ...]) -> None:
        """Add a straight motion."""
        way = None if self._last is None or self._rapid else point - self._last
        length = 0.0 if way is None else float(np.linalg.norm(way))
        self._heading = way / length if way is not None and length > _SHORT else None
        if self.arcs.ended is not None and self._last is not None:
            self.arcs.weigh(self.arcs.ended, self._last, self._heading)
        self.arcs.ended = None
        self._add([point], [axis])

    def _add(self, points: Sequence[Array], axes: Sequence[Sequence[float]]) -> None:
        """Add points with the feed in force; after RAPID the motion to all of them is rapid."""
        rapid, self._rapid = self._rapid, False
        self._last, self._axis = points[-1], tuple(axes[-1])
        self.out.add(points, axes, rapid=rapid)

    def _end_circle_by_angle(self) -> None:
        """End a circle that no GOTO follows."""
        circle, self.arcs.begun = self.arcs.begun, None
        if circle is None:
            return
        assert self._last is not None
        with self.out.at(circle.line):
            arc = self.arcs.by_angle(circle, self._last, self._straight_heading())
            self._add_arc(arc, self._axis, circle)

    def _add_arc(self, arc: Arc, tool_axis: tuple[float, ...], circle: Circle | None) -> None:
        """Add the chords of an arc; the tool axis turns in proportion to the angle."""
        points, shares = self.out.divide_arc(arc)
        begin, finish = (np.array(v) / np.linalg.norm(v) for v in (self._axis, tool_axis))
        if float(begin @ finish) < -1.0 + 1e-9:
            self.out.problem("the tool axis is turned round over an arc; which way is open")
            begin = finish
        axes = vectors_at(begin, finish, shares).tolist()
        self._heading, self.arcs.ended = None, circle
        self._add([*points], [*axes[:-1], tool_axis])


def _by_name(word: str, words: Sequence[str], names: AbstractSet[str]) -> dict[str, float]:
    """Numbers by the name before each.

    Raises:
        InvalidInput: If a name is another one, or no number follows it.
    """
    found: dict[str, float] = {}
    for name, number in zip_longest(words[::2], words[1::2], fillvalue=""):
        if name in _BORED:  # a second word of the kind, as in DRILL, DEEP
            return _by_name(word, [other for other in words if other != name], names)
        if name not in names:
            raise InvalidInput(f"{word}: {shortened(name)!r} is not known in a cycle")
        found[name] = _number(f"{word}, {name}", number)
    return found


def _taken(word: str, words: list[str], name: str) -> float | None:
    """The number after a name, both taken out of the words; ``None`` without the name."""
    if name not in words:
        return None
    at = words.index(name)
    number = _number(f"{word}, {name}", (words[at + 1 :] or [""])[0])
    words[at : at + 2] = []
    return number


def _coordinates(of: _Statement) -> tuple[float, ...]:
    """Three or six numbers; a seventh, a feed in some systems, is left out."""
    if len(of.arguments) not in (3, 6, 7):
        raise InvalidInput(
            f"{of.word} takes x, y, z or x, y, z, i, j, k; got {len(of.arguments)} numbers"
        )
    pairs = zip("xyzijk", of.arguments, strict=False)
    return tuple(_number(f"{of.word}, {name}", argument) for name, argument in pairs)


def _nested(text: str, counts: tuple[int, ...]) -> list[float]:
    """Numbers of a nested definition."""
    words = text.split(",")
    if len(words) not in counts:
        raise InvalidInput(
            f"GOFWD: expected {' or '.join(map(str, counts))} numbers, got {shortened(text)!r}"
        )
    return [_number("GOFWD", word) for word in words]


def _unit(word: str, vector: Sequence[float]) -> Array:
    """The direction of an axis."""
    axis = np.array(vector)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InvalidInput(f"{word}: the axis is zero and has no direction")
    return np.asarray(axis / length)


def _number(place: str, argument: str) -> float:
    compact = argument.replace(" ", "")
    if not argument:
        raise InvalidInput(f"{place}: it is missing")
    if not _NUMBER.fullmatch(compact):
        raise InvalidInput(f"{place}: expected a number, got {shortened(argument)!r}")
    value = float(compact.replace("D", "E").replace("d", "e"))
    if not abs(value) <= LARGEST_NUMBER:
        raise InvalidInput(f"{place}: {shortened(argument)!r} is too large")
    return value


def _not_read(word: str, what: str) -> InvalidInput:
    return InvalidInput(
        f"{word} is {what}, which is not read; write the path as GOTO lines (in the CAM system: "
        "linear output, no cycles)"
    )


def _changes_nothing(of: _Statement) -> bool:
    """Whether a word that may change the path does not: a cycle's end, a shift by zero."""
    if of.word == "OFSTNO":
        return "OFF" in of.arguments
    if of.word == "TRACUT":
        return of.arguments == ["NOMORE"]
    if of.word in ("ORIGIN", "TRANS") and of.arguments:
        numbers = [_NUMBER.fullmatch(argument) for argument in of.arguments]
        return all(numbers) and not any(_number(of.word, a) for a in of.arguments)
    return False
