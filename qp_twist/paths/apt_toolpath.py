"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, of_lines, shortened
from qp_twist.paths.apt_arcs import Circle
from qp_twist.paths.apt_cycles import cycle_of
from qp_twist.paths.apt_frames import Frames
from qp_twist.paths.apt_gofwd import arc_to_line
from qp_twist.paths.apt_motions import Motions, Spline
from qp_twist.paths.apt_statements import Statement, coordinates, not_read, number, statements
from qp_twist.paths.apt_units import FEED_UNITS, PER_TURN, UNITS, feed_of, find_unit, turns_of
from qp_twist.paths.apt_words import BREAKS, DIALECTS, HOLDING, IGNORED, TEXT, refuse_change
from qp_twist.paths.arcs import ArcAxis
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

_MOVES = frozenset({
    "GODLTA", "CIRCLE", "MOVARC", "TLON,GOFWD", "GOFWD", "FROM", "RAPID", "TOOL PATH", "NURBS",
    "CYCLE",
})  # fmt: skip
"""Words other than GOTO before which a circle ends by its angle."""
_WORDS = ProgramWords("an APT file", "i, j, k", "RAPID", "UNITS/MM")


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of an APT-CL file.

    The manuals of CAM systems differ on the sense of rotation of circles. Where a circle continues
    a straight motion without a corner, or states its angle, only one of the two fits.
    """
    if not _has_goto("", lines):
        raise InvalidInput("there is no GOTO in it.")
    found = list(statements(lines))
    words = {word for of in found for word in (of.word, " ".join([of.word, *of.arguments[:1]]))}
    if any(line.startswith(("$$->", "$$ ->")) for line in lines):
        words.add("$$->")
    by_dialect = next((sense for word, sense in DIALECTS.items() if word in words), None)
    reader = _Reader(options, options.arc_axis or by_dialect or "right")
    reader.read(found)
    arcs, is_open = reader.to.arcs, (options.arc_axis or by_dialect) is None
    if is_open and arcs.against_sense and not arcs.for_sense:
        reader = _Reader(options, "left")
        reader.read(found)
    elif is_open and arcs.undecided and not reader.out.problems:
        raise InvalidInput(
            f"CIRCLE ({of_lines(arcs.lines)}) {arcs.question()}", options={"arc_axis": None}
        )
    sense = f", {reader.to.arcs.sense}-handed about their axes" if reader.to.arcs.lines else ""
    return reader.out.toolpath(path, has_axis=reader.has_axis, sense=sense)


def _has_goto(suffix: str, lines: Sequence[str]) -> bool:
    return any(re.match(r"\s*GOTO\s*/", line, re.IGNORECASE) for line in lines)


_VECTORS = "an APT file states tool axes as vectors; leave rotary and rollover out."
APT = ToolpathFormat(_has_goto, _read, {**STATED_BY_PROGRAMS, ("rotary", "rollover"): _VECTORS})
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
        self._frames = Frames()
        self._in_world = False
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
        find_unit(self.out, found)
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
        if self._zero and self.has_axis:
            self.out.problems.add(self._zero, "the axis is zero and has no direction", "i, j, k")

    def _statement(self, of: Statement) -> None:
        first = re.split(r"[\s,]", of.word, maxsplit=1)[0]
        text = next((word for word in TEXT if first.startswith(word)), "")
        if of.word in self._acts:
            if of.word in HOLDING:
                self.out.pass_over(of.word, of.text)
            self._acts[of.word](of)
        elif of.word in BREAKS or first in BREAKS:
            self.out.pass_over(first)
            self.to.begin_curve()
        elif of.word in IGNORED or text:
            refuse_change(of)
            if first == "CALSUB":
                self.out.note("CALSUB ({}) calls a routine of the machine, which is not run here.")
            if first not in ("END-OF-PATH", "FINI"):
                self.out.pass_over(text or first, of.text)
        else:
            raise InvalidInput(
                f"{shortened(of.word or '/' + of.rest)!r} is not known, and whether it changes the "
                "path neither; take the line out if it does not"
            )

    def _goto(self, of: Statement) -> None:
        """GOTO: a straight motion, or the end of a circle."""
        circle, self.to.arcs.begun = self.to.arcs.begun, None
        scale, last, axis, self.to.last = self.out.scale(), self.to.last, self.to.axis, None
        numbers = coordinates(of)
        if len(numbers) == 6 and not any(numbers[3:]):
            self._zero = self._zero or of.line  # the previous axis holds
        elif len(numbers) == 6:
            axis, self.has_axis = self._frames.vector(numbers[3:6]), True
        if len(of.arguments) == 7:
            self.out.note("a seventh number of GOTO ({}) is not used; a feed is stated by FEDRAT.",
                          left_out=True)  # fmt: skip
        point, self.to.last = scale * self._frames.point(numbers[:3]), last
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
        start = self.to.start(of.word)
        way = self._frames.vector([self.out.scale() * value for value in numbers])
        self.to.straight(start + np.array(way), self.to.axis)

    def _circle(self, of: Statement) -> None:
        """A circle that the next GOTO ends."""
        start = self.to.start(of.word)
        self.to.arcs.begun = Circle.of(of, start, self._frames, self.out.scale())

    def _nurbs(self, of: Statement) -> None:
        """NURBS: a cubic spline from where the tool is, by the KNOT and CNTRL that follow."""
        self.to.spline = Spline(of.line, [], [self.to.start(of.word)])

    def _knot(self, of: Statement) -> None:
        self.to.begun_spline("KNOT").knots.extend(number("KNOT", word) for word in of.arguments)

    def _control(self, of: Statement) -> None:
        spline = self.to.begun_spline("CNTRL")
        if len(of.arguments) != 3:
            raise InvalidInput(f"CNTRL takes x, y, z; got {len(of.arguments)} numbers")
        point = self._frames.point(coordinates(of))
        spline.control.append(self.out.scale() * point)

    def _begin_cycle(self, of: Statement) -> None:
        """CYCLE: at each point that follows the tool goes into a hole, up to CYCLE/OFF."""
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
        arc = arc_to_line(of, self.to.last, heading, self._frames, self.out.scale())
        self.to.add_arc(arc, self.to.axis, None)

    def _from(self, of: Statement) -> None:
        self.to.begin_curve()
        coordinates(of)

    def _go_rapid(self, of: Statement) -> None:
        self.to.rapid = True

    def _tool_path(self, of: Statement) -> None:
        self.to.begin_curve()
        self.out.name = of.rest.split(",")[0].strip()

    def _tlaxis(self, of: Statement) -> None:
        """TLAXIS: a tool axis of its own."""
        numbers = coordinates(of) if len(of.arguments) == 3 else ()
        if not any(numbers):
            raise InvalidInput("TLAXIS takes i, j, k, not all of them zero")
        self.to.axis, self.has_axis = self._frames.vector(numbers), True

    def _multax(self, of: Statement) -> None:
        if of.arguments[:1] == ["OFF"]:
            self.to.axis = self._frames.vector((0.0, 0.0, 1.0))

    def _cutcom(self, of: Statement) -> None:
        if not {"OFF", "ADJUST"} & set(of.arguments):
            self.out.note("CUTCOM ({}) has a machine shift the path by the radius of its tool; "
                          "here the points are the path of the tool's tip.")  # fmt: skip

    def _set_frame(self, of: Statement) -> None:
        """MSYS, MCS: the frame of the points behind; its z is the tool axis if none is stated."""
        self._frames = self._frames.then(of)
        if self._frames.now is not NOTHING:
            self.out.note("another frame ({}): the points are moved into the first frame of the "
                          "file, and the tool axes turned.")  # fmt: skip
        if self._frames.moved:
            self.has_axis, self.to.axis = True, self._frames.vector((0.0, 0.0, 1.0))

    def _set_up(self, of: Statement) -> None:
        """TRNTYP, CSYS of CAMWorks: a frame of the machine's set-up, and none of the points."""
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

    def _units(self, of: Statement) -> None:
        if len(of.arguments) == 1 and of.arguments[0] in UNITS:
            self.out.set_unit(UNITS[of.arguments[0]], moved=bool(self.out.rows))
            return
        # The unit of the points is then unknown; a missing unit would be the same problem.
        self.out.unit = self.out.length_unit
        raise InvalidInput(f"UNITS/{shortened(','.join(of.arguments))}: expected MM or INCHES")

    def _fedrat(self, of: Statement) -> None:
        value, unit = feed_of(of)
        if not unit:
            now = self.out.length_unit
            self.out.note(f"FEDRAT without a unit ({{}}) is read as {now} per minute.")
        self._set_feed(of.word, value, unit)

    def _set_feed(self, word: str, value: float, unit: str) -> None:
        scale = LENGTHS[FEED_UNITS.get(unit) or self.out.length_unit]
        self.out.feeds.state(word, value, scale, per_turn=unit in PER_TURN)

    def _spindl(self, of: Statement) -> None:
        feeds = self.out.feeds
        feeds.turns_per_minute = turns_of(of, feeds.turns_per_minute)
