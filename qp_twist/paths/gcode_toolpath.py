"""Toolpaths from G-code (DIN 66025, ISO 6983), with five axes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LengthUnit
from qp_twist.paths.arcs import Arc, centre_of_radius
from qp_twist.paths.gcode_tool_axis import BY_VECTOR, ToolAxis
from qp_twist.paths.gcode_words import Block, read_block
from qp_twist.paths.toolpath import SAME_POINT, Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
    TooManyPoints,
    of_lines,
)
from qp_twist.paths.toolpath_options import ReadingOptions

SUFFIXES = (".nc", ".gcode", ".tap", ".mpf", ".ngc", ".cnc")
"""Suffixes of files that are read as G-code."""

_PASSED = frozenset({
    4, 9, 15, 40, 43, 44, 49, 50, 50.1, 60, 61, 61.1, 62, 63, 64, 67, 69, 80, 94, 97, 98, 99, 187,
    290, 450, 451, 601, 602, 603, 641, 642, 643, 644, 645,
})  # fmt: skip
"""G codes that do not change the path."""
_TIP_ON = frozenset({43.4, 43.5, 234.0})
"""G codes after which X, Y, Z are those of the tool's tip, whatever its axis."""
_OFFSETS = frozenset({54, 55, 56, 57, 58, 59, 54.1, 54.2, 59.1, 59.2, 59.3, 500,
                      505, 506, 507, 508, 509})  # fmt: skip
_REFUSED: dict[float, str] = {
    5.2: "a spline", 5.3: "a spline", 6: "a spline", 6.1: "a spline", 6.2: "a spline",
    7: "a lathe's diameter", 8: "a lathe's radius", 10: "a change of offsets",
    12: "a circular pocket", 13: "a circular pocket", 16: "polar coordinates",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
    31: "a measurement", 33: "a thread", 38.2: "a measurement",
    41: "a shift by the tool's radius", 42: "a shift by the tool's radius",
    41.1: "a shift by the tool's radius", 42.1: "a shift by the tool's radius",
    41.2: "a shift by the tool's radius", 42.2: "a shift by the tool's radius",
    51: "a scaled path", 51.1: "a mirrored path", 52: "a shift of coordinates",
    92: "a shift of coordinates", 92.1: "a shift of coordinates", 65: "a call of a macro",
    66: "a call of a macro", 68: "turned coordinates", 68.1: "turned coordinates",
    68.2: "turned coordinates", 68.3: "turned coordinates", 68.4: "turned coordinates",
    254: "turned coordinates",
    **dict.fromkeys((73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89), "a drilling cycle"),
}  # fmt: skip
_INSTEAD: dict[float, str] = {
    **dict.fromkeys((41, 42, 41.1, 42.1, 41.2, 42.2), "write the path of the tool's centre (G40)"),
}
_WORDS = ProgramWords("a G-code file", "I, J, K", "G0", "G20 (inch) or G21 (mm)")
_UNITS: dict[float, LengthUnit] = {
    **dict.fromkeys((20, 70, 700), "inch"), **dict.fromkeys((21, 71, 710), "mm"),
}  # fmt: skip
_MODAL: dict[float, tuple[str, int]] = {
    **{code: ("motion", code) for code in (0, 1, 2, 3)},
    **{code: ("plane", code) for code in (17, 18, 19)},
    90: ("relative", False), 91: ("relative", True),
    90.1: ("absolute_centres", True), 91.1: ("absolute_centres", False),
    93: ("feed", 93), 94: ("feed", 94), 95: ("feed", 95),
}  # fmt: skip
"""Codes that hold until another of their group: name and value of the mode."""
_AWAY = frozenset({28, 30, 53})
"""Codes of motions to positions of the machine."""
_PLANES: dict[float, tuple[str, str, str]] = {
    17: ("X", "Y", "Z"), 18: ("Z", "X", "Y"), 19: ("Y", "Z", "X"),
}  # fmt: skip
"""The two axes of each plane, and the one about which G3 is right-handed."""
_CENTRE = {"X": "I", "Y": "J", "Z": "K"}
_COORDINATE = re.compile(r"([XYZ])\s*=?\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))")
_KINEMATICS = {428.0: True, 429.0: False}
"""LinuxCNC's switches of a five-axis machine: with control of the tool's tip, and without."""
_CALLS = (97, 98, 198)
_ENDS = (2, 30, 99, 17)
_LETTERS = frozenset("XYZABCIJKRFSTDHPQL")
_LARGEST_TURN = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_MOST_TURNED = 36_000.0
"""Largest turn of a rotary axis in one cut, degrees: beyond it, a number is wrong."""


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a G-code program.

    A straight motion in rapid traverse (G0) begins another curve. The tool axis is (0, 0, 1), or
    that of I, J, K, or of the rotary axes by the convention ``rotary``. Feeds hold until the next F
    word. Arcs become polygons.

    Raises:
        InvalidInput: If a line is invalid, changes the path in a way that is not supported, or a
            tool axis is open.
    """
    out = ProgramBuilder(options, _WORDS)
    reader = _Reader(out)
    reader.read(lines)
    out.problems.refuse()
    assumptions = [*out.divided(), *reader.axis.notes()]
    return out.toolpath(path, assumptions, reader.left_out(), has_axis=reader.axis.stated)


GCODE = ToolpathFormat(lambda suffix, lines: suffix in SUFFIXES, _read, STATED_BY_PROGRAMS)
"""G-code."""


@dataclass
class _Modes:
    """What holds until another G code says otherwise."""

    motion: int | None = None  # G0 to G3
    plane: int = 17  # to 19
    relative: bool = False  # coordinates
    absolute_centres: bool = False  # of arcs
    feed: int = 94  # per minute; 95 per turn of the spindle, 93 motions per minute
    tip: bool = False  # whether X, Y, Z are those of the tip, whatever the tool axis


class _Reader:
    """Reads the blocks of a program.

    Attributes:
        out: The points so far.
        axis: The tool axis.
        modes: What holds.
        at: Where the tool is: X, Y, Z in m as far as they are known.
    """

    def __init__(self, out: ProgramBuilder) -> None:
        self.out = out
        self.axis = ToolAxis(out)
        self.modes = _Modes()
        self.at: dict[str, float] = {}
        self._away: list[int] = []
        self._pointed = ""
        self._whole: tuple[int, str] | None = None
        self._tip_refused = False
        self._motions_per_minute: float | None = None

    def read(self, lines: Sequence[str]) -> None:
        """Read all lines up to the end of the program.

        Raises:
            InvalidInput: If the first line with text is no block: the file is no G-code.
        """
        for number, line in enumerate(lines, start=1):
            try:
                if read_block(line) != Block():
                    break
            except InvalidInput as error:
                error.line = number
                raise
        self.out.assume_unit_by_extent(_extent(lines))
        ended = False
        try:
            for number, line in enumerate(lines, start=1):
                if ended and line.strip() not in ("", "%"):
                    self.out.pass_over("lines after the end of the program")
                    break
                with self.out.at(number):
                    ended = ended or self._block(read_block(line))
        except TooManyPoints:
            pass  # which is one of the problems
        if self._whole is not None and self._pointed:
            self.out.problems.add(
                self._whole[0],
                f"{self._whole[1]} has no decimal point, and others such as {self._pointed} do; on "
                "some machines a number without one counts thousandths. Write all with a point, or "
                "none",
            )

    def left_out(self) -> list[str]:
        """What was passed over beside single words."""
        if not self._away:
            return []
        return [
            f"motions to the machine's own positions (G28, G53, … in {of_lines(self._away)}) are "
            "left out; another curve begins after each."
        ]

    # ------------------------------------------------------------ a block

    def _block(self, block: Block) -> bool:
        """Process a block; whether it ends the program."""
        words = block.words
        if block.skipped:
            if words.keys() & set("XYZABCIJK") or block.codes:
                raise InvalidInput(
                    "a block behind / is run or not by a switch of the machine; take the / or the "
                    "block out"
                )
            self.out.pass_over("/")
            return False
        self._check(block)
        for name in block.names:
            if name in ("TRAORI", "TRAFOOF"):
                self.modes.tip = name == "TRAORI"
            self.out.pass_over(name)
        away = "SUPA" in block.names or bool(_AWAY & set(block.codes))
        dwells = 4 in block.codes
        for code in block.codes:
            self._code(code, block)
        if "L" in words:
            raise InvalidInput("L calls or repeats a subprogram, which is not read")
        self._feed(block)
        for word in [*(k for k in "ST" if k in words), *(f"M{code:g}" for code in block.switches)]:
            self.out.pass_over(word)
        if away:
            self._leave(words)
        elif words.keys() & {*"XYZABCIJKR", *BY_VECTOR, "CR"} and not dwells:
            self._move(block)
        return any(code in _ENDS for code in block.switches)

    def _check(self, block: Block) -> None:
        """Refuse unknown words and calls; remember whether numbers have a decimal point."""
        unknown = block.words.keys() - _LETTERS - {"N", "O", "CR", *BY_VECTOR}
        if unknown:
            raise InvalidInput(f"{sorted(unknown)[0]} is no word that is known")
        for name in "XYZIJK":
            text = block.written.get(name, "")
            if text.endswith("."):
                self._pointed = self._pointed or f"{name}{text}"
            elif text and "." not in text and float(text) and self._whole is None:
                self._whole = (self.out.line, f"{name}{text}")
        for code in block.switches:
            self.modes.tip = _KINEMATICS.get(code, self.modes.tip)
            if code in _CALLS:
                raise InvalidInput(
                    f"M{code:g} calls a subprogram, which is not read; have the CAM system write "
                    "one program"
                )
        if len([code for code in block.codes if code in (0, 1, 2, 3)]) > 1:
            raise InvalidInput("a block has one of G0, G1, G2 and G3; got several")

    def _code(self, code: float, block: Block) -> None:
        """Process a G code."""
        words = block.words.keys()
        # G5 with P or Q looks ahead; the words of a spline are others.
        ahead = code in (5, 5.1) and {"P", "Q"} & words and not set("XYZIJK") & words
        if code in _MODAL:
            name, value = _MODAL[code]
            if name == "feed" and self.modes.feed != value:
                self.out.feeds.set(math.nan, per_turn=value == 95)  # another F does not hold
            setattr(self.modes, name, value)
        elif code in _UNITS:
            self.out.set_unit(_UNITS[code], moved=bool(self.out.rows or self.at))
        elif code in _OFFSETS:
            self.out.set_frame(f"G{code:g}", code + 1e-3 * block.words.get("P", 0.0))
        elif code == 50 and set("XYZ") & words:
            raise InvalidInput("G50 is a shift of coordinates here, which is not read")
        elif code in _PASSED or code in _TIP_ON or ahead:
            if code in _TIP_ON:
                self.modes.tip, self.axis.vectors = True, code == 43.5
            elif code == 49:
                self.modes.tip = self.axis.vectors = False
            self.out.pass_over(f"G{code:g}")
        elif code in _REFUSED:
            instead = _INSTEAD.get(code, "have the CAM system write plain motions G0 to G3")
            raise InvalidInput(f"G{code:g} is {_REFUSED[code]}, which is not read; {instead}")
        elif code not in _AWAY:
            raise InvalidInput(
                f"G{code:g} is not known, and whether it changes the path neither; take it out if "
                "it does not"
            )

    def _leave(self, words: dict[str, float]) -> None:
        """A motion to a position of the machine: the axes it names are somewhere unknown."""
        named = set("XYZ") & words.keys()
        for axis in named or ({} if set("ABC") & words.keys() else "XYZ"):
            self.at.pop(axis, None)
        self._away.append(self.out.line)
        self.out.begin_curve()

    # ------------------------------------------------------------ a motion

    def _move(self, block: Block) -> None:
        """A motion in the mode in force."""
        words, modes = block.words, self.modes
        if modes.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        start = dict(self.at)
        if not modes.tip and self.axis.turned and not set("XYZ") & words.keys():
            self.at.clear()  # a turn about the pivot of the machine leads the tip elsewhere
        scale = self.out.scale() if words.keys() & {*"XYZIJKR", "CR"} else 1.0
        for axis in sorted(set("XYZ") & words.keys()):
            if modes.relative and axis not in self.at:
                raise InvalidInput(f"{axis} is relative (G91) to a position that is not known")
            self.at[axis] = scale * words[axis] + (self.at[axis] if modes.relative else 0.0)
        begin = self.axis.turn(block, relative=modes.relative, cut=modes.motion != 0)
        if modes.motion in (2, 3):
            self._arc(block, start, begin, scale)
            return
        self.axis.read_vector(block)
        if words.keys() & {"R", "CR"}:
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        if not modes.tip and self.axis.rotary is not None and self.axis.turned:
            self._without_tip()
        elif len(self.at) == 3:
            self._straight(start, begin)
        elif modes.motion == 1 and set("XYZ") & words.keys():
            missing = " and ".join(axis for axis in "XYZ" if axis not in self.at)
            raise InvalidInput(f"G1: where the tool is in {missing} is not known")

    def _without_tip(self) -> None:
        """A motion with turned rotary axes whose X, Y, Z are not those of the tip."""
        self.at.clear()
        self.out.begin_curve()
        if self.modes.motion != 0 and not self._tip_refused:
            self._tip_refused = True
            self.out.problem(
                "the rotary axes are turned without control of the tool's tip (G43.4, G43.5, G234 "
                "or TRAORI), so X, Y, Z depend on the dimensions of the machine; have the CAM "
                "system write the tip's coordinates, and G43.4 before them"
            )

    def _straight(self, start: dict[str, float], begin: dict[str, float]) -> None:
        """Add a straight motion, divided where rotary axes turn the tool on the way."""
        end, turn = _point(self.at), self.axis.largest_turn(begin)
        origin, count = end, 1
        # In rapid motion the way of the axis does not matter, and it is one motion.
        if len(start) == 3 and self.modes.motion != 0:
            if turn > _MOST_TURNED:
                raise InvalidInput(
                    f"a rotary axis turns by {turn:.6g} degrees in one cut, more than "
                    f"{_MOST_TURNED:g}; check the angle"
                )
            origin, count = _point(start), max(1, math.ceil(turn / _LARGEST_TURN - 1e-9))
        shares = np.arange(1, count + 1) / count
        points = origin + shares[:, None] * (end - origin)
        points[-1] = end
        self._add(points, shares, begin)

    def _add(self, points: Array, shares: Array, begin: dict[str, float]) -> None:
        """Add the points of a motion at some shares of it; in a cut those that differ."""
        rapid, rows = self.modes.motion == 0, self.out.rows
        axes = [self.axis.at(begin, float(share)) for share in shares]
        if rows and not rapid:
            moved = np.diff(np.vstack([rows[-1].position, points]), axis=0)
            turned = (np.diff(np.vstack([rows[-1].direction, axes]), axis=0) != 0.0).any(axis=1)
            differs = turned | (np.linalg.norm(moved, axis=1) >= SAME_POINT)
            points, axes = points[differs], [axes[k] for k in np.flatnonzero(differs)]
            if self.modes.feed == 93:
                self._feed_by_time(float(np.linalg.norm(moved, axis=1).sum()))
        self.out.add([*points], axes, rapid=rapid)

    def _feed(self, block: Block) -> None:
        """Read F, and S, by which a feed per turn is one per minute."""
        feeds, self._motions_per_minute = self.out.feeds, None
        feeds.turns_per_minute = block.words.get("S", feeds.turns_per_minute)
        feed = block.words.get("F")
        if feed is None or 4 in block.codes:  # the time of a dwell
            return
        if not feed > 0.0:
            raise InvalidInput(f"F: expected a feed above 0, got {feed:g}")
        if self.modes.feed == 93:
            self._motions_per_minute = feed
        else:
            feeds.set(feed * self.out.scale(), per_turn=self.modes.feed == 95)

    def _feed_by_time(self, length: float) -> None:
        """G93: F is how many such motions would take a minute, and belongs to its block alone."""
        if self._motions_per_minute is None:
            raise InvalidInput("G93: each block that cuts needs its own F")
        feed = self._motions_per_minute * length
        # A turn in place has a time, and no feed.
        self.out.feeds.set(feed if feed > 0.0 else math.nan, per_turn=False)

    def _arc(
        self, block: Block, start: dict[str, float], begin: dict[str, float], scale: float
    ) -> None:
        """Add an arc or a helix: G2 left-handed, G3 right-handed about the axis of the plane."""
        if len(start) < 3 or len(self.at) < 3:
            raise InvalidInput(f"G{self.modes.motion}: where the arc begins is not known")
        if block.words.keys() & set(BY_VECTOR):
            raise InvalidInput("a tool axis by A3, B3, C3 on an arc is not read")
        if not self.modes.tip and self.axis.turned:
            self._without_tip()
            return
        if block.words.get("P", 1.0) != 1.0:
            raise InvalidInput("P: several turns are not read; write each turn as an arc")
        s, e = _point(start), _point(self.at)
        axis = np.array([float(name == _PLANES[self.modes.plane][2]) for name in "XYZ"])
        if self.modes.motion == 2:
            axis = -axis
        centre = self._centre(block.words, s, e, axis, scale)
        self._add(*self.out.divide_arc(Arc.between(s, e, centre, axis)), begin)

    def _centre(
        self, words: dict[str, float], start: Array, end: Array, axis: Array, scale: float
    ) -> Array:
        """The centre of an arc, by I, J, K or by its radius."""
        radius = words.get("R", words.get("CR"))
        named = [letter for letter in "IJK" if letter in words]
        if radius is not None and named:
            raise InvalidInput("an arc has a radius R or a centre I, J, K; got both")
        if radius is not None:
            return centre_of_radius(start, end, axis, scale * radius)
        letters = [_CENTRE[name] for name in _PLANES[self.modes.plane][:2]]
        in_plane = f"an arc in the plane of G{self.modes.plane} has its centre in "
        if not set(named) & set(letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)}, or a radius R; got neither")
        if any(words[letter] for letter in named if letter not in letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)} alone; got {', '.join(named)}")
        if self.modes.absolute_centres and not set(letters) <= set(named):
            raise InvalidInput(f"G90.1: the centre needs both {' and '.join(letters)}")
        offsets = np.array([scale * words.get(letter, 0.0) for letter in "IJK"])
        centre: Array = offsets if self.modes.absolute_centres else start + offsets
        return centre


def _extent(lines: Sequence[str]) -> float:
    """The largest difference of X, Y or Z words, in the unit of the file."""
    ends: dict[str, list[float]] = {}
    for line in lines:
        for name, number in _COORDINATE.findall(line.partition(";")[0].partition("(")[0].upper()):
            low, high = ends.setdefault(name, [math.inf, -math.inf])
            ends[name] = [min(low, float(number)), max(high, float(number))]
    return max((high - low for low, high in ends.values()), default=0.0)


def _point(at: dict[str, float]) -> Array:
    return np.array([at[axis] for axis in "XYZ"])
