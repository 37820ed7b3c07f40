"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, shortened
from qp_twist.paths.apt_arcs import Arc, Arcs, Circle, arc_to_line
from qp_twist.paths.arcs import ArcAxis
from qp_twist.paths.toolpath import Toolpath
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
    "GODLTA", "CIRCLE", "MOVARC", "TLON,GOFWD", "GOFWD", "FROM", "RAPID", "TOOL PATH",
})  # fmt: skip
"""Words other than GOTO before which a circle ends by its angle."""
_SHORT = 1e-6
"""A shorter motion, m, has no direction worth comparing."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COORDINATES = ("x", "y", "z", "i", "j", "k")
_WORDS = ProgramWords(
    title="an APT file",
    axis="i, j, k",
    rapid="RAPID",
    no_axis="no GOTO states a tool axis; (0, 0, 1) is taken, as APT has it.",
    no_unit="no UNITS/ before the first GOTO; add UNITS/MM above it",
    new_unit="UNITS changes after the first GOTO",
    no_point="there is no GOTO in it.",
    no_cut="no two GOTO without RAPID between them; nothing is cut.",
)

_TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT")
"""Words followed by free text, or that concern only the operator or the machine."""

_IGNORED = frozenset({
    *_TEXT, "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO", "SPINDL", "MULTAX",
    "CUTTER", "TLDATA", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL", "AUTOPS", "PSIS",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "HEAD", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP", "ISN",
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
    "GOCLER": "a move to a plane", "CYCLE": "a drilling cycle", "SPLINE": "a curved move",
    "NURBS": "a curved move", "TRACUT": "a change of coordinates",
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
_UNITS: dict[str, LengthUnit] = {
    "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
    "METERS": "m",
}  # fmt: skip


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
    reader = _Reader(options, options.arc_axis or "right")
    reader.read(lines)
    arcs = reader.arcs
    if options.arc_axis is None and arcs.against_sense and not arcs.for_sense:
        reader = _Reader(options, "left")
        reader.read(lines)
    elif (
        options.arc_axis is None
        and arcs.lines
        and not reader.out.problems
        and (arcs.against_sense or not arcs.for_sense)
    ):
        raise InvalidInput(
            f"CIRCLE ({of_lines(arcs.lines)}) {arcs.question()}", options={"arc_axis": None}
        )
    return reader.out.toolpath(path, reader.notes(), has_axis=reader.has_axis)


APT = ToolpathFormat(
    lambda suffix, lines: any(re.match(r"\s*GOTO\s*/", line, re.IGNORECASE) for line in lines),
    _read,
    {
        **STATED_BY_PROGRAMS,
        ("rotary", "rollover"): (
            "an APT file states tool axes as vectors; leave rotary and rollover out."
        ),
    },
)
"""APT-CL."""


def _statements(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Statements with the line that each begins in; ``$`` continues one, ``$$`` ends the line."""
    begun, text = 0, ""
    for number, line in enumerate([*lines, ""], start=1):
        before, dollar, _ = line.partition("$$")[0].partition("$")
        begun, text = begun or number, text + before
        if dollar and number <= len(lines):
            continue
        if text.strip():
            yield begun, text.strip()
        begun, text = 0, ""


class _Statement(NamedTuple):
    """A statement: its word, what follows ``/``, and the arguments in that."""

    word: str
    rest: str
    arguments: list[str]

    @property
    def upper(self) -> list[str]:
        """The arguments in capitals."""
        return [argument.upper() for argument in self.arguments]


class _Reported(Exception):
    """A statement that is not read on, since its problems are in the list."""


class _Reader:
    """Reads the statements of a file.

    Attributes:
        out: The points so far.
        arcs: The circles.
        feeds: The feeds.
        axis: The tool axis in force.
        has_axis: Whether the file states one.
    """

    def __init__(self, options: ReadingOptions, sense: ArcAxis) -> None:
        self.out = ProgramBuilder(options, _WORDS)
        self.arcs, self._sense = Arcs(self.out, sense), sense
        self.feeds = _Feeds(self.out)
        self.axis: tuple[float, ...] = (0.0, 0.0, 1.0)
        self.has_axis = self._rapid = False
        self._last: Array | None = None  # where the tool is, m; None if that is not known
        self._heading: Array | None = None  # direction of the straight cut that led there
        self._tangent: tuple[float, ...] | None = None  # of INDIRV
        self._frame: list[str] | None = None  # of MSYS
        self._noted: dict[str, list[int]] = {"seventh": [], "CUTCOM": []}

    def read(self, lines: Sequence[str]) -> None:
        """Read all statements."""
        for line, text in _statements(lines):
            word, _, rest = text.partition("/")
            word = ",".join(part.strip() for part in word.upper().split(","))
            if word in _MOVES:
                self._end_circle_by_angle()
            self.out.line = line
            arguments = [argument.strip() for argument in rest.split(",")] if rest.strip() else []
            try:
                self._statement(_Statement(word, rest, arguments))
            except _Reported:
                pass
            except InvalidInput as error:
                self.out.refuse(error)
                if isinstance(error, TooManyPoints):
                    return
        self._end_circle_by_angle()

    def notes(self) -> list[str]:
        """Notes on what was assumed about feeds, and what was passed over."""
        shifted, seventh = self._noted["CUTCOM"], self._noted["seventh"]
        found = self.out.passed_over()
        if shifted:
            found.append(
                f"CUTCOM ({of_lines(shifted)}) has a machine shift the path by the radius of its "
                "tool; here the points are the path of the tool's tip."
            )
        sense = f", {self._sense}-handed about their axes" if self.arcs.lines else ""
        found += [*self.out.divided(sense), *self.feeds.notes()]
        if seventh:
            found.append(
                f"a seventh number of GOTO ({of_lines(seventh)}) is not used; a feed is stated by "
                "FEDRAT."
            )
        return found

    # ------------------------------------------------------------ statements

    def _statement(self, of: _Statement) -> None:
        """Process one statement."""
        first = re.split(r"[\s,]", of.word, maxsplit=1)[0]
        text = next((word for word in _TEXT if first.startswith(word)), "")
        if of.word in _ACTS:
            _ACTS[of.word](self, of)
        elif of.word in _CHANGES and not _changes_nothing(of):
            raise _not_read(of.word, _CHANGES[of.word])
        elif of.word in _BREAKS or first in _BREAKS:
            self.out.pass_over(first)
            self._begin_curve()
        elif of.word in _IGNORED or of.word in _CHANGES or text:
            if of.word == "SPINDL":
                self.feeds.read_spindle(of.upper)
            elif of.word == "MULTAX" and of.upper[:1] == ["OFF"]:
                self.axis = (0.0, 0.0, 1.0)
            if first not in ("END-OF-PATH", "FINI"):
                self.out.pass_over(text or first)
        else:
            raise InvalidInput(
                f"{shortened(of.word or '/' + of.rest)!r} is not known, and whether it changes the "
                "path neither; take the line out if it does not"
            )

    def _goto(self, of: _Statement) -> None:
        """GOTO: a straight motion, or the end of a circle."""
        try:
            numbers = _coordinates(self.out, of)
        except _Reported:
            self.out.scale()
            self._rapid, self.arcs.begun, self._last, self._heading = False, None, None, None
            raise
        axis = self.axis
        if len(numbers) == 6 and not any(numbers[3:]):
            # Report it once: the points for which it would hold keep the previous axis.
            self.out.problem("the axis is zero and has no direction", "i, j, k")
        elif len(numbers) == 6:
            axis, self.has_axis = numbers[3:], True
        if len(of.arguments) == 7:
            self._noted["seventh"].append(self.out.line)
        point = self.out.scale() * np.array(numbers[:3])
        circle, self.arcs.begun = self.arcs.begun, None
        if circle is None:
            if self._last is not None and not self._rapid:
                self.arcs.refuse_open(self._last, point)
            self._straight(point, axis)
            return
        assert self._last is not None
        try:
            arc = self.arcs.ended_at(circle, self._last, point, self._straight_heading())
        except InvalidInput as error:
            self.out.refuse(error)
            self._add([point], [axis])
        else:
            self._add_arc(arc, axis, circle)

    def _godlta(self, of: _Statement) -> None:
        """GODLTA: a straight motion by a difference of coordinates."""
        if len(of.arguments) != 3:
            raise InvalidInput(f"GODLTA takes dx, dy, dz; got {len(of.arguments)} numbers")
        numbers = _coordinates(self.out, of)
        if self._last is None:
            raise InvalidInput("GODLTA: where the tool is before it is not known")
        self._straight(self._last + self.out.scale() * np.array(numbers), self.axis)

    def _circle(self, of: _Statement) -> None:
        """A circle that the next GOTO ends: centre, axis, radius, perhaps an angle."""
        angle, words = None, of.upper
        if "ANGLE" in words:
            at = words.index("ANGLE")
            angle = _number(f"{of.word}, ANGLE", (words[at + 1 :] or [""])[0])
            words[at : at + 2] = []
        least, most = (7, 11) if of.word == "CIRCLE" else (7, 7)
        if not least <= len(words) <= most or (of.word == "MOVARC" and angle is None):
            raise InvalidInput(
                f"{of.word} takes the centre x, y, z, the axis i, j, k and the radius"
                + (", then ANGLE and degrees" if of.word == "MOVARC" else "")
                + f"; got {len(words)} words in {shortened(','.join(of.upper))!r}"
            )
        values = _numbers(self.out, [of.word] * len(words), words)
        scale = self.out.scale()
        axis = np.array(values[3:6])
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise InvalidInput(f"{of.word}: the axis is zero and has no direction")
        if self._last is None:
            raise InvalidInput(f"{of.word}: where the arc begins is not known; expected a GOTO")
        if angle is not None and not 0.0 < abs(angle) <= 360.0:
            raise InvalidInput(f"{of.word}: expected an angle up to 360 degrees, got {angle:g}")
        self.arcs.begun = Circle(
            self.out.line, of.word, scale * np.array(values[:3]), axis / length, scale * values[6],
            None if angle is None else math.radians(angle),
        )  # fmt: skip

    def _indirv(self, of: _Statement) -> None:
        """INDIRV: the direction in which GOFWD begins."""
        self._tangent = None
        self._tangent = _coordinates(self.out, of)

    def _gofwd(self, of: _Statement) -> None:
        """GOFWD: a motion along a circle, begun in the direction of INDIRV, up to a line."""
        heading, self._tangent = self._tangent, None
        match = _ALONG.fullmatch(re.sub(r"\s", "", of.rest.upper()))
        if match is None:
            raise InvalidInput(
                "GOFWD is a move along a surface, of which (CIRCLE/x,y,z,r),ON,(LINE/…) with six "
                "numbers is read; write the path as GOTO lines (in the CAM system: linear output)"
            )
        circle = _nested(self.out, match[1], (4, 7))
        ends = _nested(self.out, match[3], (6,))
        if self._last is None or heading is None:
            lacking = "a GOTO" if self._last is None else "an INDIRV"
            raise InvalidInput(f"GOFWD: expected {lacking} before it")
        scale = self.out.scale()
        centre = scale * np.array(circle[:3])
        axis = np.array(circle[3:6] if len(circle) == 7 else (0.0, 0.0, 1.0))
        if np.linalg.norm(axis) < 1e-9:
            raise InvalidInput("GOFWD: the axis of CIRCLE is zero and has no direction")
        axis /= np.linalg.norm(axis)
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
        self._add_arc(arc, self.axis, None)

    def _tlaxis(self, of: _Statement) -> None:
        """TLAXIS: a tool axis of its own."""
        numbers = _coordinates(self.out, of) if len(of.arguments) == 3 else ()
        if not any(numbers):
            raise InvalidInput("TLAXIS takes i, j, k, not all of them zero")
        self.axis, self.has_axis = numbers, True

    def _from(self, of: _Statement) -> None:
        self._begin_curve()
        _coordinates(self.out, of)

    def _go_rapid(self, of: _Statement) -> None:
        self._rapid = True

    def _tool_path(self, of: _Statement) -> None:
        self._begin_curve()
        self.out.name = of.arguments[0] if of.arguments else ""

    def _cutcom(self, of: _Statement) -> None:
        self.out.pass_over(of.word)
        if not {"OFF", "ADJUST"} & set(of.upper):
            self._noted["CUTCOM"].append(self.out.line)

    def _set(self, of: _Statement) -> None:
        if "INCR" in of.upper:
            raise _not_read(f"{of.word}/INCR", "a change to relative coordinates")
        self.out.pass_over(of.word)

    def _units(self, of: _Statement) -> None:
        if len(of.upper) == 1 and of.upper[0] in _UNITS:
            self.out.set_unit(_UNITS[of.upper[0]], moved=bool(self.out.rows))
            return
        # The unit of the points is then unknown; a missing unit would be the same problem.
        self.out.unit = self.out.length_unit
        raise InvalidInput(f"UNITS/{shortened(','.join(of.upper))}: expected MM or INCHES")

    def _msys(self, of: _Statement) -> None:
        """Check that all coordinates are in one frame."""
        self.out.pass_over("MSYS")
        frame, self._frame = self._frame, of.upper
        if frame not in (None, of.upper) and self.out.rows:
            raise InvalidInput(
                "MSYS is another frame than before, and the points after it are in it; write each "
                "frame's paths into a file of their own"
            )

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
        if rapid:
            self.out.count_rapid()
        for point, axis in zip(points, axes, strict=True):
            self.out.add(point, axis, self.feeds.now(), rapid=rapid)
        self._last, self.axis = points[-1], tuple(axes[-1])

    def _end_circle_by_angle(self) -> None:
        """End a circle that no GOTO follows."""
        circle, self.arcs.begun = self.arcs.begun, None
        if circle is None:
            return
        assert self._last is not None
        self.out.line = circle.line
        try:
            arc = self.arcs.by_angle(circle, self._last, self._straight_heading())
            self._add_arc(arc, self.axis, circle)
        except InvalidInput as error:
            self.out.refuse(error)

    def _add_arc(self, arc: Arc, tool_axis: tuple[float, ...], circle: Circle | None) -> None:
        """Add the chords of an arc; the tool axis turns in proportion to the angle."""
        points, shares = self.out.divide_arc(*arc)
        begin, finish = (np.array(v) / np.linalg.norm(v) for v in (self.axis, tool_axis))
        if float(begin @ finish) < -1.0 + 1e-9:
            self.out.problem("the tool axis is turned round over an arc; which way is open")
            begin = finish
        axes = vectors_at(begin, finish, shares)
        self._heading, self.arcs.ended = None, circle
        self._add(list(points), [*(tuple(v) for v in axes[:-1].tolist()), tool_axis])


class _Feeds:
    """The feeds of a file."""

    def __init__(self, out: ProgramBuilder) -> None:
        self._out = out
        self._feed: tuple[float, LengthUnit | None] = (math.nan, "m")
        """Per second, in a unit; ``None`` is the file's."""
        self._turns_per_second: float | None = None
        self._without_unit: list[int] = []

    def now(self) -> float:
        """The feed in force, m/s; NaN without one."""
        feed, unit = self._feed
        return feed * LENGTHS[unit or self._out.length_unit]

    def notes(self) -> list[str]:
        """A note on feeds without a unit, if there are any."""
        if not self._without_unit:
            return []
        lines, unit = of_lines(self._without_unit), self._out.length_unit
        return [f"FEDRAT without a unit ({lines}) is read as {unit} per minute."]

    def read(self, word: str, arguments: Sequence[str]) -> None:
        """Read a feed: a number and its unit, in either order."""
        words = [argument for argument in arguments if argument[:1].isalpha()]
        numbers = [argument for argument in arguments if not argument[:1].isalpha()]
        known = {**_PER_MINUTE, **_PER_TURN}
        if len(numbers) != 1 or len(words) > 1 or not set(words) <= known.keys():
            raise InvalidInput(
                f"{word}/{shortened(','.join(arguments))}: expected a number and its unit, one of "
                f"{', '.join(known)}"
            )
        value = _number(word, numbers[0])
        if value <= 0.0:
            raise InvalidInput(f"{word}: expected a feed above 0, got {value:g}")
        if not words:
            self._without_unit.append(self._out.line)
            self._feed = (value / 60.0, None)
        elif words[0] in _PER_MINUTE:
            self._feed = (value / 60.0, _PER_MINUTE[words[0]])
        elif self._turns_per_second:
            self._feed = (value * self._turns_per_second, _PER_TURN[words[0]])
        else:
            raise InvalidInput(
                f"{word}: {words[0]} is a feed per turn of the spindle, and no SPINDL before it "
                "states turns per minute; write SPINDL/…,RPM above it, or the feed per minute"
            )

    def read_spindle(self, arguments: Sequence[str]) -> None:
        """Read turns per second, if the statement has them."""
        numbers = [argument for argument in arguments if _NUMBER.fullmatch(argument)]
        if "OFF" in arguments or {"SFM", "SMM"} & set(arguments):
            self._turns_per_second = None  # a speed of the surface depends on the tool
        elif len(numbers) == 1:
            value = float(numbers[0].replace("D", "E"))
            self._turns_per_second = value / 60.0 if math.isfinite(value) else None


_ACTS: dict[str, Callable[[_Reader, _Statement], None]] = {
    "GOTO": _Reader._goto,
    "GODLTA": _Reader._godlta,
    "CIRCLE": _Reader._circle,
    "MOVARC": _Reader._circle,
    "INDIRV": _Reader._indirv,
    "TLON,GOFWD": _Reader._gofwd,
    "GOFWD": _Reader._gofwd,
    "TLAXIS": _Reader._tlaxis,
    "FROM": _Reader._from,
    "RAPID": _Reader._go_rapid,
    "FEDRAT": lambda reader, of: reader.feeds.read(of.word, of.upper),
    "FEED": lambda reader, of: reader.feeds.read(of.word, of.upper),
    "UNITS": _Reader._units,
    "TOOL PATH": _Reader._tool_path,
    "CUTCOM": _Reader._cutcom,
    "SET": _Reader._set,
    "MODE": _Reader._set,
    "MSYS": _Reader._msys,
}
"""What a word does."""


def _coordinates(out: ProgramBuilder, of: _Statement) -> tuple[float, ...]:
    """Three or six numbers."""
    # A seventh number is a feed rate in some systems.
    if len(of.arguments) not in (3, 6, 7):
        out.problem(f"{of.word} takes x, y, z or x, y, z, i, j, k; got {len(of.arguments)} numbers")
        raise _Reported
    return _numbers(out, [f"{of.word}, {name}" for name in _COORDINATES], of.arguments)


def _nested(out: ProgramBuilder, text: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Numbers of a nested definition."""
    words = text.split(",")
    if len(words) not in counts:
        raise InvalidInput(
            f"GOFWD: expected {' or '.join(map(str, counts))} numbers, got {shortened(text)!r}"
        )
    return _numbers(out, ["GOFWD"] * len(words), words)


def _numbers(out: ProgramBuilder, places: Sequence[str], words: Sequence[str]) -> tuple[float, ...]:
    """The numbers at some places; every invalid one is a problem."""
    found, refused = [], False
    for place, word in zip(places, words, strict=False):
        try:
            found.append(_number(place, word))
        except InvalidInput as error:
            out.refuse(error)
            refused = True
    if refused:
        raise _Reported
    return tuple(found)


def _number(place: str, argument: str) -> float:
    compact = argument.replace(" ", "")
    if not argument:
        raise InvalidInput(f"{place}: it is missing")
    if not _NUMBER.fullmatch(compact):
        raise InvalidInput(f"{place}: expected a number, got {shortened(argument)!r}")
    value = float(compact.upper().replace("D", "E"))
    if not math.isfinite(value):
        raise InvalidInput(f"{place}: {shortened(argument)!r} is too large")
    return value


def _not_read(word: str, what: str) -> InvalidInput:
    return InvalidInput(
        f"{word} is {what}, which is not read; write the path as GOTO lines (in the CAM system: "
        "linear output, no cycles)"
    )


def _changes_nothing(of: _Statement) -> bool:
    """Whether a word that may change the path does not: a cycle's end, a shift by zero."""
    if of.word in ("CYCLE", "OFSTNO"):
        return "OFF" in of.upper
    if of.word == "TRACUT":
        return of.upper == ["NOMORE"]
    if of.word in ("ORIGIN", "TRANS") and of.arguments:
        numbers = [_NUMBER.fullmatch(argument) for argument in of.upper]
        return all(numbers) and not any(float(a.replace("D", "E")) for a in of.upper)
    return False
