"""Toolpaths from APT-CL, the cutter location lines of CAM systems."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems, shortened
from qp_twist.paths.arcs import ARC_ERROR, ArcAxis, arc_points, arc_sweep, check_radii
from qp_twist.paths.arcs_to_lines import crossing, sense_of_motion
from qp_twist.paths.assemble import assembled
from qp_twist.paths.motions import Motions, PassedOver, notes_on_rapid, of_lines, times
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.turning import vectors_at

_ALONG = re.compile(r"\(?CIRCLE/([^()/]*?)\)?,ON(,2,INTOF)?,\(?LINE/([^()/]*?)\)?")
_MOVES = frozenset({
    "GOTO", "GODLTA", "CIRCLE", "MOVARC", "TLON,GOFWD", "GOFWD", "FROM", "RAPID", "TOOL PATH",
})  # fmt: skip
_SHORT = 1e-6
"""A shorter motion, m, has no direction worth comparing."""
_SMOOTH = math.cos(math.radians(3.0))
"""Cosine of the angle up to which two motions join without a corner."""
_ANGLE_ROUNDING = math.radians(0.01)
"""How an angle of an arc is rounded."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COORDINATES = ("x", "y", "z", "i", "j", "k")

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


def read_apt(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of an APT-CL file.

    The point after ``RAPID`` begins another curve. Points between two ``RAPID`` belong to no curve:
    they lead to the next one. A point of ``FROM`` is left out. A tool axis holds until the next
    one; before the first, and after ``MULTAX/OFF``, it is (0, 0, 1). A feed of ``FEDRAT`` holds
    until the next one, except for motions by ``RAPID``. Arcs become polygons.

    Raises:
        InvalidInput: If a line is invalid, changes the path in a way that is not supported, or
            the sense of rotation of its circles is open.
    """
    orientation = options.orientation
    if orientation not in (None, "axis", "none"):
        raise InvalidInput(
            f"orientation is {orientation!r}, but an APT file has tool axes; leave it "
            'out or say "axis" or "none".'
        )
    reader = _with_sense_of_arcs(lines, options)
    if not reader.motions.points:
        reader.problems.refuse()
        raise InvalidInput("there is no GOTO in it.")
    notes = []
    if orientation is None and not reader.has_axis:
        notes.append("no GOTO states a tool axis; (0, 0, 1) is taken, as APT has it.")
    cuts = reader.motions.curves()
    if not cuts:
        reader.problems.refuse()
        raise InvalidInput("no two GOTO without RAPID between them; nothing is cut.")
    notes += notes_on_rapid(cuts, reader.rapids, "RAPID")
    notes += reader.notes()
    return assembled(
        path,
        orientation or "axis",
        cuts,
        "i, j, k",
        notes,
        reader.problems,
        unit=reader.unit or options.length_unit or "m",
        unit_in_file=reader.unit is not None,
    )


def _with_sense_of_arcs(lines: Sequence[str], options: ReadingOptions) -> _Reader:
    """Read the statements with the sense of rotation that is asked for, or that alone fits.

    The manuals of CAM systems differ on it. Where a circle continues a straight motion without a
    corner, or states its angle, only one of the two fits.
    """

    def read(sense: ArcAxis) -> _Reader:
        reader = _Reader(Problems(), options.length_unit, options.arc_error, sense)
        line = 1
        try:
            for line, text in _statements(lines):
                reader.statement(line, text)
            reader.finish()
        except InvalidInput as error:  # too many points
            reader.problems.add(line, error.sentence)
        return reader

    if options.arc_axis is not None:
        return read(options.arc_axis)
    reader = read("right")
    for_right, against = reader.for_sense, reader.against_sense
    if against and not for_right:
        return read("left")
    if not reader.open_arcs or reader.problems or (for_right and not against):
        return reader
    evidence = (
        f"the motions beside them fit right-handed ones {times(for_right)} and left-handed ones "
        f"{times(against)}"
        if for_right
        else "no straight motion leads into one or out of one without a corner"
    )
    raise InvalidInput(
        f"CIRCLE ({of_lines(reader.open_arcs)}) states an axis, but CAM systems differ on the sense"
        f" of the motion about it (Creo: right-handed; NX: clockwise), and {evidence}; add "
        'arc_axis = "right" or "left" to [path] of the task file.',
        options={"arc_axis": None},
    )


def _statements(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Statements with the line that each begins in; ``$`` continues one, ``$$`` ends the line."""
    begun, text = 0, ""
    for number, line in enumerate(lines, start=1):
        code = line.partition("$$")[0]
        begun = begun or number
        before, dollar, _ = code.partition("$")
        text += before
        if dollar:
            continue
        if text.strip():
            yield begun, text.strip()
        begun, text = 0, ""
    if text.strip():
        yield begun, text.strip()


@dataclass
class _Reader:
    """State of the reader while it processes the statements."""

    problems: Problems
    length_unit: LengthUnit | None
    arc_error: float = ARC_ERROR
    sense: ArcAxis = "right"
    unit: LengthUnit | None = None
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    has_axis: bool = False
    feed: tuple[float, LengthUnit | None] = (math.nan, "m")  # per second; None: the file's unit
    turns_per_second: float | None = None
    rapid: bool = False
    rapids: int = 0
    motions: Motions = field(default_factory=Motions)
    passed: PassedOver = field(default_factory=PassedOver)
    last: Array | None = None
    """Where the tool is, m; ``None`` if it is not known."""
    heading: Array | None = None
    """Direction of the straight cut that led there."""
    circle: _Circle | None = None
    """A circle that the next GOTO ends."""
    ended: _Circle | None = None
    """The circle that the last GOTO ended."""
    tangent: tuple[float, ...] | None = None
    """Of INDIRV."""
    machine_frame: tuple[str, ...] | None = None
    arcs: int = 0
    open_arcs: list[int] = field(default_factory=list)
    """Lines of circles whose sense of rotation the file leaves open."""
    for_sense: int = 0
    against_sense: int = 0
    without_unit: list[int] = field(default_factory=list)
    seventh: list[int] = field(default_factory=list)
    shifted: list[int] = field(default_factory=list)

    def statement(self, line: int, text: str) -> None:  # noqa: PLR0912, PLR0915
        """Process one statement."""
        word, _, rest = text.partition("/")
        word = ",".join(part.strip() for part in word.upper().split(","))
        first = re.split(r"[\s,]", word, maxsplit=1)[0]
        arguments = [argument.strip() for argument in rest.split(",")] if rest.strip() else []
        upper = [argument.upper() for argument in arguments]
        if self.circle is not None and word in _MOVES - {"GOTO"}:
            self._end_circle_here()
        if word == "GOTO":
            self._goto(line, arguments)
        elif word == "GODLTA":
            self._godlta(line, arguments)
        elif word in ("CIRCLE", "MOVARC"):
            self._circle(line, word, upper)
        elif word == "INDIRV":
            self.tangent = self._numbers(line, word, arguments)
        elif word in ("TLON,GOFWD", "GOFWD"):
            self._along(line, rest)
        elif word == "TLAXIS":
            self._tlaxis(line, arguments)
        elif word == "FROM":
            self._numbers(line, "FROM", arguments)
            self._begin()
        elif word == "RAPID":
            self.rapid = True
        elif word in ("FEDRAT", "FEED"):
            self._fedrat(line, word, upper)
        elif word == "UNITS":
            self._units(line, upper)
        elif word == "TOOL PATH":
            self._begin()
            self.motions.name = arguments[0] if arguments else ""
        elif word == "CUTCOM":
            self.passed.add(word, line)
            if "OFF" not in upper and not {"ADJUST"} & set(upper):
                self.shifted.append(line)
        elif word in ("SET", "MODE") and "INCR" not in upper:
            self.passed.add(word, line)
        elif word in ("SET", "MODE"):
            self._refused(line, f"{word}/INCR", "a change to relative coordinates")
        elif word == "MSYS":
            self._msys(line, upper)
        elif word in _CHANGES and not self._changes_nothing(word, upper):
            self._refused(line, word, _CHANGES[word])
        elif word in _BREAKS or first in _BREAKS:
            self.passed.add(first, line)
            self._begin()
        elif word in _IGNORED or word in _CHANGES or first.startswith(_TEXT):
            if word == "SPINDL":
                self._spindle(upper)
            elif word == "MULTAX" and upper[:1] == ["OFF"]:
                self.axis = (0.0, 0.0, 1.0)
            if first not in ("END-OF-PATH", "FINI"):
                self.passed.add(next((t for t in _TEXT if first.startswith(t)), first), line)
        else:
            self.problems.add(
                line,
                f"{shortened(word or text)!r} is not known, and whether it changes the path neither"
                "; take the line out if it does not",
            )

    def finish(self) -> None:
        """Process the end of the file."""
        if self.circle is not None:
            self._end_circle_here()

    def notes(self) -> list[str]:
        """Notes on what was assumed about feeds, and what was passed over."""
        found = self.passed.notes()
        if self.shifted:
            found.append(
                f"CUTCOM ({of_lines(self.shifted)}) has a machine shift the path by the radius of "
                "its tool; here the points are the path of the tool's tip."
            )
        if self.arcs:
            sense = f", {self.sense}-handed about their axes" if self.open_arcs else ""
            found.append(
                f"arcs ({times(self.arcs)}){sense}: chords within {1e3 * self.arc_error:g} mm of "
                "them (arc_error)."
            )
        if self.without_unit:
            found.append(
                f"FEDRAT without a unit ({of_lines(self.without_unit)}) is read as "
                f"{self._length()} per minute."
            )
        if self.seventh:
            found.append(
                f"a seventh number of GOTO ({of_lines(self.seventh)}) is not used; a feed is "
                "stated by FEDRAT."
            )
        return found

    def _refused(self, line: int, word: str, what: str) -> None:
        self.problems.add(
            line,
            f"{word} is {what}, which is not read; write the path as GOTO lines (in "
            "the CAM system: linear output, no cycles)",
        )

    @staticmethod
    def _changes_nothing(word: str, arguments: Sequence[str]) -> bool:
        """Whether a word that may change the path does not: a cycle's end, a shift by zero."""
        if word in ("CYCLE", "OFSTNO"):
            return "OFF" in arguments
        if word == "TRACUT":
            return list(arguments) == ["NOMORE"]
        if word in ("ORIGIN", "TRANS") and arguments:
            numbers = [_NUMBER.fullmatch(argument) for argument in arguments]
            return all(numbers) and not any(float(a.replace("D", "E")) for a in arguments)
        return False

    def _msys(self, line: int, arguments: Sequence[str]) -> None:
        """Check that all coordinates are in one frame."""
        self.passed.add("MSYS", line)
        frame = tuple(arguments)
        if self.machine_frame not in (None, frame) and self.motions.points:
            self.problems.add(
                line,
                "MSYS is another frame than before, and the points after it are in it; write each "
                "frame's paths into a file of their own",
            )
        self.machine_frame = frame

    def _goto(self, line: int, arguments: Sequence[str]) -> None:
        numbers = self._numbers(line, "GOTO", arguments)
        scale = LENGTHS[self._unit(line)]
        if numbers is None:
            self.rapid, self.circle, self.last, self.heading = False, None, None, None
            return
        axis = self.axis
        if len(numbers) == 6 and not any(numbers[3:]):
            # Report it once: the points for which it would hold keep the previous axis.
            self.problems.add(line, "the axis is zero and has no direction", "i, j, k")
        elif len(numbers) == 6:
            axis, self.has_axis = numbers[3:], True
        if len(arguments) == 7:
            self.seventh.append(line)
        point = scale * np.array(numbers[:3])
        if self.circle is not None:
            self._end_circle(line, point, axis)
        else:
            self._refuse_on_circle(line, point)
            self._straight(line, point, axis)

    def _godlta(self, line: int, arguments: Sequence[str]) -> None:
        """A straight motion by a difference of coordinates."""
        if len(arguments) != 3:
            self.problems.add(line, f"GODLTA takes dx, dy, dz; got {len(arguments)} numbers")
            return
        numbers = self._numbers(line, "GODLTA", arguments)
        if numbers is None:
            return
        if self.last is None:
            self.problems.add(line, "GODLTA: where the tool is before it is not known")
            return
        self._straight(line, self.last + LENGTHS[self._unit(line)] * np.array(numbers), self.axis)

    def _straight(self, line: int, point: Array, axis: tuple[float, ...]) -> None:
        """Add a straight motion."""
        way = None if self.last is None or self.rapid else point - self.last
        length = 0.0 if way is None else float(np.linalg.norm(way))
        self.heading = way / length if way is not None and length > _SHORT else None
        if self.heading is not None and self.ended is not None and self.last is not None:
            self._weigh(self.ended, self.last, self.heading)
        self.ended = None
        self._add(line, [point], [axis])

    def _add(self, line: int, points: Sequence[Array], axes: Sequence[Sequence[float]]) -> None:
        """Add points with the feed in force; after RAPID the motion to all of them is rapid."""
        rapid, self.rapid = self.rapid, False
        self.rapids += rapid
        feed, unit = self.feed
        metres = feed * LENGTHS[unit or self._length()]
        for point, axis in zip(points, axes, strict=True):
            self.motions.add(point.tolist(), axis, line, math.nan if rapid else metres, rapid=rapid)
        self.last, self.axis = points[-1], tuple(axes[-1])

    def _circle(self, line: int, word: str, arguments: Sequence[str]) -> None:
        """A circle that the next GOTO ends: centre, axis, radius, perhaps an angle."""
        angle = None
        numbers = list(arguments)
        if "ANGLE" in numbers:
            at = numbers.index("ANGLE")
            angle = self._number(line, f"{word}, ANGLE", (numbers[at + 1 :] or [""])[0])
            numbers[at : at + 2] = []
            if angle is None:
                return
        least, most = (7, 11) if word == "CIRCLE" else (7, 7)
        if not least <= len(numbers) <= most or (word == "MOVARC" and angle is None):
            self.problems.add(
                line,
                f"{word} takes the centre x, y, z, the axis i, j, k and the radius"
                + (", then ANGLE and degrees" if word == "MOVARC" else "")
                + f"; got {len(numbers)} words in {shortened(','.join(arguments))!r}",
            )
            return
        found = [self._number(line, word, argument) for argument in numbers]
        values = [value for value in found if value is not None]
        if len(values) < len(found):
            return
        scale = LENGTHS[self._unit(line)]
        axis = np.array(values[3:6])
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            self.problems.add(line, f"{word}: the axis is zero and has no direction")
            return
        if self.last is None:
            self.problems.add(line, f"{word}: where the arc begins is not known; expected a GOTO")
            return
        if angle is not None and not 0.0 < abs(angle) <= 360.0:
            self.problems.add(line, f"{word}: expected an angle up to 360 degrees, got {angle:g}")
            return
        self.circle = _Circle(
            line, word, scale * np.array(values[:3]), axis / length, scale * values[6],
            None if angle is None else math.radians(angle),
        )  # fmt: skip

    def _axis_of(self, circle: _Circle) -> Array:
        """The axis about which the motion is right-handed."""
        return circle.axis if self.sense == "right" else -circle.axis

    def _end_circle(self, line: int, end: Array, tool_axis: tuple[float, ...]) -> None:
        """Add the arc from where the tool is to the point of a GOTO."""
        circle, self.circle = self.circle, None
        assert circle is not None and self.last is not None
        start, axis = self.last, self._axis_of(circle)
        self.open_arcs.append(circle.line)
        try:
            check_radii(start, end, circle.centre, axis, circle.radius)
            sweep = arc_sweep(start, end, circle.centre, axis)
        except InvalidInput as error:
            self.problems.add(line, f"{circle.word} of line {circle.line}: {error}")
            self._add(line, [end], [tool_axis])
            return
        if circle.angle is not None:
            self._check_angle(circle, sweep, start)
        if self.heading is not None and not self.rapid:
            self._weigh(circle, start, self.heading)
        self._arc(line, start, end, circle.centre, axis, sweep, tool_axis)
        self.ended = circle

    def _check_angle(self, circle: _Circle, sweep: float, start: Array) -> None:
        """Compare the angle that a circle states with that of either sense."""
        assert circle.angle is not None
        signed = circle.angle if circle.angle > 0.0 else 2.0 * math.pi + circle.angle
        near = _ANGLE_ROUNDING + 2e-5 / float(np.linalg.norm(start - circle.centre))
        fits, mirrored = (
            abs(math.remainder(angle - signed, 2.0 * math.pi)) < near
            for angle in (sweep, 2.0 * math.pi - sweep)
        )
        if not fits and not mirrored:
            self.problems.add(
                circle.line,
                f"{circle.word}: the angle is {math.degrees(circle.angle):.6g} degrees, but the "
                f"point after it is {math.degrees(sweep):.6g} degrees on, or "
                f"{360.0 - math.degrees(sweep):.6g} the other way round",
            )
        self.for_sense += fits and not mirrored
        self.against_sense += mirrored and not fits

    def _end_circle_here(self) -> None:
        """End a circle that no GOTO follows, by its angle."""
        circle, self.circle = self.circle, None
        assert circle is not None and self.last is not None
        if circle.angle is None:
            self.problems.add(
                circle.line, f"{circle.word}: no GOTO follows, so where the arc ends is open"
            )
            return
        axis = self._axis_of(circle) * math.copysign(1.0, circle.angle)
        turn = Rotation.from_rotvec(abs(circle.angle) * axis).as_matrix()
        end = circle.centre + turn @ (self.last - circle.centre)
        self.open_arcs.append(circle.line)
        try:
            check_radii(self.last, end, circle.centre, axis, circle.radius)
        except InvalidInput as error:
            self.problems.add(circle.line, f"{circle.word}: {error}")
            return
        if self.heading is not None and not self.rapid:
            self._weigh(circle, self.last, self.heading)
        self._arc(circle.line, self.last, end, circle.centre, axis, abs(circle.angle), self.axis)
        self.ended = circle

    def _weigh(self, circle: _Circle, point: Array, heading: Array) -> None:
        """Count whether a straight motion beside an arc continues it in this sense of rotation."""
        tangent = np.cross(self._axis_of(circle), point - circle.centre)
        tangent *= math.copysign(1.0, circle.angle or 1.0)
        length = float(np.linalg.norm(tangent))
        cosine = float(tangent @ heading) / length if length > 0.0 else 0.0
        self.for_sense += cosine > _SMOOTH
        self.against_sense += cosine < -_SMOOTH

    def _refuse_on_circle(self, line: int, point: Array) -> None:
        """Refuse a second GOTO on a circle: it may be a point of the arc, or end a chord.

        Where the arc goes on for so little that it is within ``arc_error`` of its chord, it is the
        chord either way.
        """
        circle = self.ended
        if circle is None or self.last is None or self.rapid:
            return
        off = point - circle.centre
        off = off - circle.axis * float(off @ circle.axis)
        moved = point - self.last
        flat = abs(float(moved @ circle.axis)) < 1e-6
        if flat and np.linalg.norm(moved) > 1e-6 and (
            abs(float(np.linalg.norm(off)) - circle.radius) < 2e-6
        ):  # fmt: skip
            if self._off_chord(circle, point) < self.arc_error:
                return
            self.problems.add(
                line,
                f"the point is on the circle of line {circle.line} too, and whether the motion to "
                "it is the arc or its chord is open; have the CAM system write one GOTO for each "
                "circle, or linear moves",
            )

    def _off_chord(self, circle: _Circle, point: Array) -> float:
        """Distance of the arc from where the tool is to a point of the circle from its chord, m."""
        assert self.last is not None
        axis = self._axis_of(circle) * math.copysign(1.0, circle.angle or 1.0)
        radial, end = self.last - circle.centre, point - circle.centre
        angle = math.atan2(float(axis @ np.cross(radial, end)), float(radial @ end))
        return circle.radius * (1.0 - math.cos(0.5 * (angle % (2.0 * math.pi))))

    def _along(self, line: int, rest: str) -> None:
        """A motion along a circle, begun in the direction of INDIRV, up to a line."""
        heading, self.tangent = self.tangent, None
        match = _ALONG.fullmatch(re.sub(r"\s", "", rest.upper()))
        groups = None if match is None else match.groups()
        if groups is None:
            self.problems.add(
                line,
                "GOFWD is a move along a surface, of which (CIRCLE/x,y,z,r),ON,(LINE/…) with six "
                "numbers is read; write the path as GOTO lines (in the CAM system: linear output)",
            )
            return
        circle = self._plain_numbers(line, groups[0], (4, 7))
        exit_line = self._plain_numbers(line, groups[2], (6,))
        if circle is None or exit_line is None:
            return
        if self.last is None or heading is None:
            lacking = "a GOTO" if self.last is None else "an INDIRV"
            self.problems.add(line, f"GOFWD: expected {lacking} before it")
            return
        scale = LENGTHS[self._unit(line)]
        centre = scale * np.array(circle[:3])
        axis = np.array(circle[3:6] if len(circle) == 7 else (0.0, 0.0, 1.0))
        radius = scale * circle[-1]
        if np.linalg.norm(axis) < 1e-9:
            self.problems.add(line, "GOFWD: the axis of CIRCLE is zero and has no direction")
            return
        axis /= np.linalg.norm(axis)
        # A circle without an axis is a cylinder along z: the arc is at the height of the tool.
        centre = centre + axis * float((self.last - centre) @ axis)
        points = [scale * np.array(exit_line[k : k + 3]) for k in (0, 3)]
        try:
            sense = sense_of_motion(np.array(heading[:3]), axis, self.last - centre)
            end, sweep = crossing(
                self.last, centre, sense * axis, radius, points, 2 if groups[1] else 1
            )
        except InvalidInput as error:
            self.problems.add(line, f"GOFWD: {error}")
            return
        self._arc(line, self.last, end, centre, sense * axis, sweep, self.axis)
        self.heading = self.ended = None

    def _arc(
        self,
        line: int,
        start: Array,
        end: Array,
        centre: Array,
        axis: Array,
        sweep: float,
        tool_axis: tuple[float, ...],
    ) -> None:
        """Add the chords of an arc; the tool axis turns in proportion to the angle."""
        points, shares = arc_points(start, end, centre, axis, sweep, self.arc_error)
        begin, finish = (np.array(v) / np.linalg.norm(v) for v in (self.axis, tool_axis))
        if float(begin @ finish) < -1.0 + 1e-9:
            self.problems.add(line, "the tool axis is turned round over an arc; which way is open")
            axes = np.broadcast_to(finish, points.shape)
        else:
            axes = vectors_at(begin, finish, shares)
        self.arcs += 1
        self.heading = None
        self._add(line, list(points), [*(tuple(v) for v in axes[:-1].tolist()), tool_axis])

    def _tlaxis(self, line: int, arguments: Sequence[str]) -> None:
        """A tool axis of its own."""
        numbers = self._numbers(line, "TLAXIS", arguments) if len(arguments) == 3 else None
        if numbers is None or not any(numbers):
            if len(arguments) != 3 or numbers is not None:
                self.problems.add(line, "TLAXIS takes i, j, k, not all of them zero")
            return
        self.axis, self.has_axis = numbers, True

    def _begin(self) -> None:
        """Begin another curve: where the tool is, is not known."""
        self.motions.begin()
        self.last = self.heading = self.circle = self.ended = None

    def _plain_numbers(
        self, line: int, text: str, counts: tuple[int, ...]
    ) -> tuple[float, ...] | None:
        """Numbers of a nested definition."""
        words = text.split(",")
        if len(words) not in counts:
            self.problems.add(
                line,
                f"GOFWD: expected {' or '.join(map(str, counts))} numbers, got {shortened(text)!r}",
            )
            return None
        found = [self._number(line, "GOFWD", word) for word in words]
        return None if None in found else tuple(v for v in found if v is not None)

    def _numbers(self, line: int, word: str, arguments: Sequence[str]) -> tuple[float, ...] | None:
        """Coordinates, or ``None`` if they are invalid."""
        # A seventh number is a feed rate in some systems.
        if len(arguments) not in (3, 6, 7):
            self.problems.add(
                line, f"{word} takes x, y, z or x, y, z, i, j, k; got {len(arguments)} numbers"
            )
            return None
        found = [
            self._number(line, f"{word}, {name}", argument)
            for name, argument in zip(_COORDINATES, arguments, strict=False)
        ]
        return None if None in found else tuple(v for v in found if v is not None)

    def _number(self, line: int, place: str, argument: str) -> float | None:
        """A number, or ``None`` if it is not one."""
        compact = argument.replace(" ", "")
        if not _NUMBER.fullmatch(compact):
            what = (
                f"expected a number, got {shortened(argument)!r}" if argument else "it is missing"
            )
            self.problems.add(line, f"{place}: {what}")
            return None
        value = float(compact.upper().replace("D", "E"))
        if not math.isfinite(value):
            self.problems.add(line, f"{place}: {shortened(argument)!r} is too large")
            return None
        return value

    def _fedrat(self, line: int, word: str, arguments: Sequence[str]) -> None:
        """A feed: a number and its unit, in either order."""
        words = [argument for argument in arguments if argument[:1].isalpha()]
        numbers = [argument for argument in arguments if not argument[:1].isalpha()]
        known = {**_PER_MINUTE, **_PER_TURN}
        if len(numbers) != 1 or len(words) > 1 or not set(words) <= known.keys():
            self.problems.add(
                line,
                f"{word}/{shortened(','.join(arguments))}: expected a number and its unit, one of "
                f"{', '.join(known)}",
            )
            return
        value = self._number(line, word, numbers[0])
        if value is None:
            return
        if value <= 0.0:
            self.problems.add(line, f"{word}: expected a feed above 0, got {value:g}")
            return
        if not words:
            self.without_unit.append(line)
        unit = known[words[0]] if words else None
        if not words or words[0] in _PER_MINUTE:
            self.feed = (value / 60.0, unit)
        elif self.turns_per_second:
            self.feed = (value * self.turns_per_second, unit)
        else:
            self.problems.add(
                line,
                f"{word}: {words[0]} is a feed per turn of the spindle, and no SPINDL before it "
                "states turns per minute; write SPINDL/…,RPM above it, or the feed per minute",
            )

    def _spindle(self, arguments: Sequence[str]) -> None:
        """Read turns per second, if the statement has them."""
        numbers = [argument for argument in arguments if _NUMBER.fullmatch(argument)]
        if "OFF" in arguments or {"SFM", "SMM"} & set(arguments):
            self.turns_per_second = None  # a speed of the surface depends on the tool
        elif len(numbers) == 1:
            value = float(numbers[0].replace("D", "E"))
            self.turns_per_second = value / 60.0 if math.isfinite(value) else None

    def _units(self, line: int, arguments: Sequence[str]) -> None:
        names: dict[str, LengthUnit] = {
            "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
            "METERS": "m",
        }  # fmt: skip
        if len(arguments) != 1 or arguments[0] not in names:
            self.problems.add(
                line, f"UNITS/{shortened(','.join(arguments))}: expected MM or INCHES"
            )
            # The unit of the points is then unknown; a missing unit would be the same problem.
            self.unit = self.unit or self.length_unit or "mm"
            return
        unit = names[arguments[0]]
        if self.length_unit not in (None, unit):
            self.problems.add(
                line,
                f"the file is in {unit}, length_unit of the task file says {self.length_unit}; "
                "correct one of them",
            )
        if self.motions.points and unit != self.unit:
            self.problems.add(line, "UNITS changes after the first GOTO")
        self.unit = unit

    def _length(self) -> LengthUnit:
        return self.unit or self.length_unit or "mm"

    def _unit(self, line: int) -> LengthUnit:
        """The unit of length; if there is none, the first line that needs it is a problem."""
        if self.unit is None and self.length_unit is None:
            self.problems.add(
                line,
                'no UNITS/ before the first GOTO; add UNITS/MM above it, or length_unit = "mm" '
                'or "inch" to [path] of the task file',
                options={"length_unit": None},
            )
            self.unit = "mm"
        return self._length()


@dataclass(frozen=True)
class _Circle:
    """A circle of CIRCLE or MOVARC: in m, with a unit vector as its axis; the angle in rad."""

    line: int
    word: str
    centre: Array
    axis: Array
    radius: float
    angle: float | None
