"""Toolpaths from G-code (DIN 66025, ISO 6983), with five axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems
from qp_twist.paths.arcs import arc_points, arc_sweep, check_radii, check_radius
from qp_twist.paths.assemble import assembled
from qp_twist.paths.gcode_words import Block, read_block
from qp_twist.paths.motions import (
    Motions,
    PassedOver,
    TooManyPoints,
    notes_on_rapid,
    of_lines,
    times,
)
from qp_twist.paths.rotary_axes import (
    ROLLOVER,
    Rollover,
    Rotary,
    begin_of_turn,
    rotary_letters,
    tool_axis,
)
from qp_twist.paths.toolpath import SAME_POINT, Toolpath
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
    93: "feeds in inverse time", 254: "turned coordinates",
    **dict.fromkeys((73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89), "a drilling cycle"),
}  # fmt: skip
_INSTEAD: dict[float, str] = {
    **dict.fromkeys((41, 42, 41.1, 42.1, 41.2, 42.2), "write the path of the tool's centre (G40)"),
    93: "write feeds per minute (G94)",
}
_PLANES: dict[float, tuple[str, str, str]] = {
    17: ("X", "Y", "Z"), 18: ("Z", "X", "Y"), 19: ("Y", "Z", "X"),
}  # fmt: skip
"""The two axes of each plane, and the one about which G3 is right-handed."""
_CENTRE = {"X": "I", "Y": "J", "Z": "K"}
_CALLS: dict[float, str] = {97: "a subprogram", 98: "a subprogram", 198: "a subprogram"}
_ENDS = (2, 30, 99, 17)
_LETTERS = frozenset("XYZABCIJKRFSTDHPQL")
_LARGEST_TURN = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_MOST_TURNED = 36_000.0
"""Largest turn of a rotary axis in one cut, degrees: beyond it, a number is wrong."""


def read_gcode(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a G-code program.

    A straight motion in rapid traverse (G0) begins another curve. The tool axis is (0, 0, 1), or
    that of I, J, K, or of the rotary axes by the convention ``rotary``. Feeds hold until the next F
    word. Arcs become polygons.

    Raises:
        InvalidInput: If a line is invalid, changes the path in a way that is not supported, or a
            tool axis is open.
    """
    orientation = options.orientation
    if orientation not in (None, "axis", "none"):
        raise InvalidInput(
            f"orientation is {orientation!r}, but a G-code file has tool axes; leave it "
            'out or say "axis" or "none".'
        )
    reader = _Reader(
        Problems(), options.length_unit, options.arc_error, options.rotary, options.rollover
    )
    reader.program(lines)
    reader.problems.refuse()
    if not reader.motions.points:
        raise InvalidInput("there is no motion to a point with X, Y and Z in it.")
    cuts = reader.motions.curves()
    if not cuts:
        raise InvalidInput("no G1, G2 or G3 from a known point; nothing is cut.")
    notes = []
    if orientation is None and not reader.has_axis:
        notes.append("no tool axis is stated; (0, 0, 1) is taken, as on a machine of three axes.")
    notes += notes_on_rapid(cuts, reader.rapids, "G0")
    notes += reader.notes()
    return assembled(
        path,
        orientation or "axis",
        cuts,
        "I, J, K",
        notes,
        reader.problems,
        unit=reader.unit or options.length_unit or "m",
        unit_in_file=reader.unit is not None,
    )


@dataclass
class _Reader:
    """State of the reader while it processes the blocks."""

    problems: Problems
    length_unit: LengthUnit | None
    arc_error: float
    rotary: Rotary | None
    rollover: Rollover | None
    unit: LengthUnit | None = None
    motions: Motions = field(default_factory=Motions)
    passed: PassedOver = field(default_factory=PassedOver)
    motion: int | None = None
    plane: int = 17
    relative: bool = False
    absolute_centres: bool = False
    per_turn: bool = False
    feed: float = math.nan
    """Of F, m/min, or m per turn."""
    turns: float = math.nan
    """Of the spindle per minute."""
    at: dict[str, float] = field(default_factory=dict)
    """Where the tool is: X, Y, Z in m as far as they are known."""
    angles: dict[str, float] = field(default_factory=dict)
    """A, B, C in degrees as far as they are stated."""
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    has_axis: bool = False
    vectors: bool = False
    """Whether I, J, K of a straight motion are the tool axis."""
    tip: bool = False
    """Whether X, Y, Z are those of the tip, whatever the tool axis."""
    offset: float | None = None
    rapids: int = 0
    arcs: int = 0
    away: list[int] = field(default_factory=list)
    pointed: str = ""
    whole: tuple[int, str] | None = None
    rotary_refused: bool = False
    tip_refused: bool = False
    rolled_over: list[int] = field(default_factory=list)
    """Lines of cuts in which a rotary axis takes the short way."""
    long_turns: list[int] = field(default_factory=list)
    """Lines of cuts in which a rotary axis turns by more than 180°."""

    def program(self, lines: Sequence[str]) -> None:
        """Process all lines up to the end of the program."""
        for number, line in enumerate(lines, start=1):
            try:
                block = read_block(line)
                if self._block(number, block):
                    rest = [k for k, text in enumerate(lines[number:], number + 1) if text.strip()]
                    ends = [k for k in rest if lines[k - 1].strip() != "%"]
                    if ends:
                        self.passed.add("lines after the end of the program", ends[0])
                    break
            except InvalidInput as error:
                self.problems.add(number, error.sentence, options=error.options)
                if isinstance(error, TooManyPoints):
                    break
        if self.whole is not None and self.pointed:
            self.problems.add(
                self.whole[0],
                f"{self.whole[1]} has no decimal point, and others such as {self.pointed} do; on "
                "some machines a number without one counts thousandths. Write all with a point, or "
                "none",
            )

    def notes(self) -> list[str]:
        """Notes on what was assumed and passed over."""
        found = self.passed.notes()
        if self.away:
            found.append(
                f"motions to the machine's own positions (G28, G53, … in {of_lines(self.away)}) "
                "are left out; another curve begins after each."
            )
        if self.arcs:
            found.append(
                f"arcs ({times(self.arcs)}): chords within {1e3 * self.arc_error:g} mm of them "
                "(arc_error)."
            )
        if self.rotary not in (None, "vector") and self.has_axis:
            leaning = [p for p in self.motions.points if p.direction[2] < 1.0 - 1e-12]
            first = "(0, 0, 1) throughout"
            if leaning:
                vector = ", ".join(f"{value:.4g}" for value in leaning[0].direction)
                first = f"({vector}) in line {leaning[0].line}, the first that leans"
            found.append(f"tool axes are those of the rotary axes by {self.rotary}: {first}.")
        default = " (the default; as-written: the long way)" if self.rollover is None else ""
        turns = "a rotary axis turns by more than 180 degrees in a cut"
        if self.rolled_over:
            found.append(
                f"{turns} ({of_lines(self.rolled_over)}), as where it rolls over from 360 to 0: it "
                f'takes the short way by rollover = "shortest"{default}.'
            )
        if self.long_turns:
            found.append(f"{turns} ({of_lines(self.long_turns)}): all the way, as written.")
        return found

    # ------------------------------------------------------------ a block

    def _block(self, line: int, block: Block) -> bool:  # noqa: PLR0912
        """Process a block; whether it ends the program."""
        words = block.words
        moves = bool(words.keys() & set("XYZABCIJK"))
        if block.skipped:
            if moves or block.codes:
                raise InvalidInput(
                    "a block behind / is run or not by a switch of the machine; take the / or the "
                    "block out"
                )
            self.passed.add("/", line)
            return False
        unknown = words.keys() - _LETTERS - {"N", "O", "CR", "A3", "B3", "C3"}
        if unknown:
            raise InvalidInput(f"{sorted(unknown)[0]} is no word that is known")
        for name in ("X", "Y", "Z", "I", "J", "K"):
            self._pointed(line, block, name)
        for code in block.switches:
            if code in _CALLS:
                raise InvalidInput(
                    f"M{code:g} calls {_CALLS[code]}, which is not read; have the CAM system write "
                    "one program"
                )
        for name in block.names:
            if name in ("TRAORI", "TRAFOOF"):
                self.tip = name == "TRAORI"
            self.passed.add(name, line)
        away = "SUPA" in block.names
        dwells = 4 in block.codes
        for code in block.codes:
            away = self._code(line, code, block) or away
        if "L" in words:
            raise InvalidInput("L calls or repeats a subprogram, which is not read")
        if "S" in words:
            self.turns = words["S"]
        if "F" in words and not dwells:
            self._feed(words["F"])
        for letter in ("S", "T"):
            if letter in words:
                self.passed.add(letter, line)
        for code in block.switches:
            self.passed.add(f"M{code:g}", line)
        if away:
            self._away(line, block)
        elif dwells:
            pass
        elif words.keys() & set("XYZABCIJKR") or {"A3", "B3", "C3", "CR"} & words.keys():
            self._move(line, block)
        return any(code in _ENDS for code in block.switches)

    def _pointed(self, line: int, block: Block, name: str) -> None:
        """Remember whether numbers are written with a decimal point."""
        text = block.written.get(name, "")
        if text.endswith("."):
            self.pointed = self.pointed or f"{name}{text}"
        elif text and "." not in text and float(text) and self.whole is None:
            self.whole = (line, f"{name}{text}")

    def _code(self, line: int, code: float, block: Block) -> bool:  # noqa: PLR0912
        """Process a G code; whether the block moves to a position of the machine."""
        if code in (0, 1, 2, 3):
            if len([c for c in block.codes if c in (0, 1, 2, 3)]) > 1:
                raise InvalidInput("a block has one of G0, G1, G2 and G3; got several")
            self.motion = int(code)
        elif code in _PLANES:
            self.plane = int(code)
        elif code in (20, 21, 70, 71, 700, 710):
            self._units("inch" if code in (20, 70, 700) else "mm")
        elif code in (90, 91):
            self.relative = code == 91
        elif code in (90.1, 91.1):
            self.absolute_centres = code == 90.1
        elif code in (94, 95):
            if self.per_turn != (code == 95):
                self.feed = math.nan  # an F of the other kind does not hold
            self.per_turn = code == 95
        elif code in _TIP_ON:
            self.tip, self.vectors = True, code == 43.5
            self.passed.add(f"G{code:g}", line)
        elif code in (28, 30, 53):
            return True
        elif code in _OFFSETS:
            stated = code + 1e-3 * block.words.get("P", 0.0)
            if self.offset not in (None, stated) and self.motions.points:
                raise InvalidInput(
                    f"G{code:g} is another work offset than before, and where it is, is not known; "
                    "write each offset's paths into a file of their own"
                )
            self.offset = stated
            self.passed.add(f"G{code:g}", line)
        elif code in (5, 5.1) and {"P", "Q"} & block.words.keys() and not (
            set("XYZIJK") & block.words.keys()
        ):  # fmt: skip
            self.passed.add(f"G{code:g}", line)  # looking ahead; the words of a spline are others
        elif code == 50 and set("XYZ") & block.words.keys():
            raise InvalidInput("G50 is a shift of coordinates here, which is not read")
        elif code in _PASSED:
            if code == 49:
                self.tip = self.vectors = False
            self.passed.add(f"G{code:g}", line)
        elif code in _REFUSED:
            instead = _INSTEAD.get(code, "have the CAM system write plain motions G0 to G3")
            raise InvalidInput(f"G{code:g} is {_REFUSED[code]}, which is not read; {instead}")
        else:
            raise InvalidInput(
                f"G{code:g} is not known, and whether it changes the path neither; take it out if "
                "it does not"
            )
        return False

    def _units(self, unit: LengthUnit) -> None:
        if self.length_unit not in (None, unit):
            raise InvalidInput(
                f"the file is in {unit}, length_unit of the task file says {self.length_unit}; "
                "correct one of them"
            )
        if unit != self.unit and (self.motions.points or self.at):
            raise InvalidInput("the unit changes after the first motion")
        self.unit = unit

    def _scale(self) -> float:
        unit = self.unit or self.length_unit
        if unit is None:
            self.unit = "mm"  # report it once
            raise InvalidInput(
                "no G20 (inch) or G21 (mm) before the first coordinate; add one, or "
                'length_unit = "mm" or "inch" to [path] of the task file',
                options={"length_unit": None},
            )
        return LENGTHS[unit]

    def _feed(self, value: float) -> None:
        if not value > 0.0:
            raise InvalidInput(f"F: expected a feed above 0, got {value:g}")
        self.feed = value * self._scale()

    def _feed_now(self) -> float:
        """Feed of a cut, m/s; NaN without one."""
        if not self.per_turn:
            return self.feed / 60.0
        if math.isfinite(self.feed) and not self.turns > 0.0:
            raise InvalidInput(
                "the feed is per turn of the spindle (G95), and no S states turns per minute"
            )
        return self.feed * self.turns / 60.0

    def _away(self, line: int, block: Block) -> None:
        """A motion to a position of the machine: the axes it names are somewhere unknown."""
        named = [axis for axis in "XYZ" if axis in block.words]
        turned = [letter for letter in "ABC" if letter in block.words]
        for axis in named or ([] if turned else list("XYZ")):
            self.at.pop(axis, None)
        self.away.append(line)
        self.motions.begin()

    # ------------------------------------------------------------ a motion

    def _move(self, line: int, block: Block) -> None:
        """A motion in the mode in force."""
        if self.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        start, begin = dict(self.at), dict(self.angles)
        if not self.tip and self._turned() and not set("XYZ") & block.words.keys():
            self.at.clear()  # a turn about the pivot of the machine leads the tip elsewhere
        scale = self._scale() if set("XYZIJKR") & block.words.keys() or "CR" in block.words else 1.0
        for axis in "XYZ":
            if axis in block.words:
                value = scale * block.words[axis]
                if self.relative and axis not in self.at:
                    raise InvalidInput(f"{axis} is relative (G91) to a position that is not known")
                self.at[axis] = value + (self.at[axis] if self.relative else 0.0)
        self._turn(line, block)
        if self.motion != 0 and self.rotary not in (None, "vector"):
            begin = self._begin_of_turn(line, begin)
        if self.motion in (2, 3):
            self._arc(line, block, start, begin, scale)
            return
        self._vector(block)
        if {"R", "CR"} & block.words.keys():
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        if not self.tip and self.rotary not in (None, "vector") and self._turned():
            self._without_tip(line)
            return
        if len(self.at) < 3:
            if self.motion == 1 and set("XYZ") & block.words.keys():
                missing = " and ".join(axis for axis in "XYZ" if axis not in self.at)
                raise InvalidInput(f"G1: where the tool is in {missing} is not known")
            return
        self._straight(line, start, begin)

    def _turned(self) -> bool:
        return any(self.angles.values())

    def _without_tip(self, line: int) -> None:
        """A motion with turned rotary axes whose X, Y, Z are not those of the tip."""
        self.at.clear()
        self.motions.begin()
        if self.motion != 0 and not self.tip_refused:
            self.tip_refused = True
            self.problems.add(
                line,
                "the rotary axes are turned without control of the tool's tip (G43.4, G43.5, G234 "
                "or TRAORI), so X, Y, Z depend on the dimensions of the machine; have the CAM "
                "system write the tip's coordinates, and G43.4 before them",
            )

    def _turn(self, line: int, block: Block) -> None:
        """Take A, B and C of a block."""
        for letter in "ABC":
            if letter not in block.words:
                continue
            value = block.words[letter]
            if self.relative:
                value += self.angles.get(letter, 0.0)
            known = self.rotary not in (None, "vector") and letter in rotary_letters(self.rotary)
            if value and not known and not self.rotary_refused:
                self.rotary_refused = True
                answer: dict[str, str | None] = {}
                if self.rotary in (None, "vector"):
                    choices = [name for name in get_args(Rotary) if name != "vector"]
                    text = (
                        f"{letter} is a rotary axis; add rotary = to [path] of the task file, how "
                        f"the machine's rotary axes turn the tool: {', '.join(choices)}"
                    )
                    answer = {"rotary": f"{choices[0]} or another of these"}
                else:
                    text = f"{letter} is not one of the rotary axes of {self.rotary}"
                self.problems.add(line, text, options=answer)
            if known and letter not in self.angles and self.motions.points and value:
                raise InvalidInput(
                    f"{letter} is first stated here, after the first motion; where it was before is"
                    " open"
                )
            self.angles[letter] = value
        if self.rotary not in (None, "vector") and {"A", "B", "C"} & block.words.keys():
            self.has_axis = True

    def _begin_of_turn(self, line: int, begin: dict[str, float]) -> dict[str, float]:
        """Angles from which rotary axes turn in a cut; by G91 they turn as written."""
        rollover: Rollover = "as-written" if self.relative else self.rollover or ROLLOVER
        found = {
            letter: begin_of_turn(angle, self.angles[letter], rollover)
            for letter, angle in begin.items()
        }
        if found != begin:
            self.rolled_over.append(line)
        if any(abs(self.angles[letter] - angle) > 180.0 for letter, angle in found.items()):
            self.long_turns.append(line)
        return found

    def _vector(self, block: Block) -> None:
        """Take the tool axis of I, J, K, or of A3, B3, C3."""
        stated = [letter for letter in ("I", "J", "K") if letter in block.words]
        siemens = [letter for letter in ("A3", "B3", "C3") if letter in block.words]
        if siemens:
            vector = tuple(block.words.get(letter, 0.0) for letter in ("A3", "B3", "C3"))
        elif not stated:
            return
        elif not self.vectors and self.rotary != "vector":
            raise InvalidInput(
                f"{', '.join(stated)} on a straight motion may be the tool axis; if so, add "
                'rotary = "vector" to [path] of the task file',
                options={"rotary": "vector"},
            )
        elif len(stated) < 3:
            raise InvalidInput(
                f"the tool axis has {' and '.join(stated)} alone; whether the others are 0 or as "
                "before is open. Have the CAM system write I, J and K"
            )
        else:
            vector = tuple(block.words[letter] for letter in stated)
        if not any(vector):
            raise InvalidInput("the tool axis is zero and has no direction")
        if self._turned():
            raise InvalidInput("the tool axis is stated by a vector and by rotary axes; say one")
        self.axis, self.has_axis = vector, True

    def _axis_at(self, begin: dict[str, float], share: float) -> tuple[float, ...]:
        """The tool axis at a share of a motion over which rotary axes move in proportion."""
        if self.rotary in (None, "vector"):
            return self.axis
        letters = rotary_letters(self.rotary)
        angles = {}
        for letter in letters:
            end = self.angles.get(letter, 0.0)
            angles[letter] = end + (share - 1.0) * (end - begin.get(letter, end))
        return tuple(tool_axis(self.rotary, angles).tolist())

    def _straight(self, line: int, start: dict[str, float], begin: dict[str, float]) -> None:
        """Add a straight motion, divided where rotary axes turn the tool on the way."""
        end = np.array([self.at[axis] for axis in "XYZ"])
        rapid = self.motion == 0
        feed = math.nan if rapid else self._feed_now()
        turn = max((abs(self.angles[k] - begin.get(k, self.angles[k])) for k in self.angles),
                   default=0.0)  # fmt: skip
        known = len(start) == 3
        origin = np.array([start[axis] for axis in "XYZ"]) if known else end
        # In rapid motion the way of the axis does not matter, and it is one motion.
        cut = known and not rapid
        if cut and turn > _MOST_TURNED:
            raise InvalidInput(
                f"a rotary axis turns by {turn:.6g} degrees in one cut, more than "
                f"{_MOST_TURNED:g}; check the angle"
            )
        count = math.ceil(turn / _LARGEST_TURN - 1e-9) if cut else 1
        shares = np.arange(1, max(count, 1) + 1) / max(count, 1)
        points = origin + shares[:, None] * (end - origin)
        points[-1] = end
        self._add(line, points, [self._axis_at(begin, share) for share in shares], feed)

    def _add(
        self, line: int, points: Array, axes: Sequence[tuple[float, ...]], feed: float
    ) -> None:
        rapid = self.motion == 0
        self.rapids += rapid
        for point, axis in zip(points, axes, strict=True):
            last = self.motions.points[-1] if self.motions.points else None
            if last is not None and last.direction == axis and not rapid and (
                float(np.linalg.norm(point - last.position)) < SAME_POINT
            ):  # fmt: skip
                continue
            self.motions.add(point.tolist(), axis, line, feed, rapid=rapid)

    def _arc(
        self,
        line: int,
        block: Block,
        start: dict[str, float],
        begin: dict[str, float],
        scale: float,
    ) -> None:
        """Add an arc or a helix: G2 left-handed, G3 right-handed about the axis of the plane."""
        if len(start) < 3 or len(self.at) < 3:
            raise InvalidInput(f"G{self.motion}: where the arc begins is not known")
        if {"A3", "B3", "C3"} & block.words.keys():
            raise InvalidInput("a tool axis by A3, B3, C3 on an arc is not read")
        if not self.tip and self._turned():
            self._without_tip(line)
            return
        if block.words.get("P", 1.0) != 1.0:
            raise InvalidInput("P: several turns are not read; write each turn as an arc")
        one, two, about = _PLANES[self.plane]
        s, e = (np.array([of[axis] for axis in "XYZ"]) for of in (start, self.at))
        axis = np.array([float(name == about) for name in "XYZ"])
        if self.motion == 2:
            axis = -axis
        centre = self._centre(block, s, e, axis, scale, (one, two))
        try:
            check_radii(s, e, centre, axis, None)
            sweep = arc_sweep(s, e, centre, axis)
        except InvalidInput:
            self.at = {name: float(v) for name, v in zip("XYZ", e, strict=True)}
            raise
        points, shares = arc_points(s, e, centre, axis, sweep, self.arc_error)
        self.arcs += 1
        feed = self._feed_now()
        self._add(line, points, [self._axis_at(begin, share) for share in shares], feed)

    def _centre(
        self,
        block: Block,
        start: Array,
        end: Array,
        axis: Array,
        scale: float,
        plane: Sequence[str],
    ) -> Array:
        """The centre of an arc, by I, J, K or by its radius."""
        words = block.words
        radius = words.get("R", words.get("CR"))
        named = [letter for letter in "IJK" if letter in words]
        if radius is not None and named:
            raise InvalidInput("an arc has a radius R or a centre I, J, K; got both")
        if radius is not None:
            return _centre_of_radius(start, end, axis, scale * radius)
        letters = [_CENTRE[name] for name in plane]
        if not set(named) & set(letters):
            raise InvalidInput(
                f"an arc in the plane of G{self.plane} has its centre in {' and '.join(letters)}, "
                "or a radius R; got neither"
            )
        if any(words[letter] for letter in named if letter not in letters):
            raise InvalidInput(
                f"an arc in the plane of G{self.plane} has its centre in {' and '.join(letters)} "
                f"alone; got {', '.join(named)}"
            )
        if self.absolute_centres and not set(letters) <= set(named):
            raise InvalidInput(f"G90.1: the centre needs both {' and '.join(letters)}")
        offsets = np.array([scale * words.get(letter, 0.0) for letter in "IJK"])
        centre: Array = offsets if self.absolute_centres else start + offsets
        return centre


def _centre_of_radius(start: Array, end: Array, axis: Array, radius: float) -> Array:
    r"""Centre of a right-handed arc about an axis, of at most 180° for a radius above 0.

    .. math:: \mathbf c = \frac{\mathbf s + \mathbf e}{2}
        + \mathrm{sgn}(r) \sqrt{r^2 - d^2/4}\; \mathbf a \times \frac{\mathbf e - \mathbf s}{d}

    with e without its height above s along the axis a, and d the distance from s to e.
    """
    check_radius(radius)
    flat = end - axis * float((end - start) @ axis)
    chord = flat - start
    length = float(np.linalg.norm(chord))
    if length < 1e-7:
        raise InvalidInput("an arc with a radius R ends at its start; write a full circle by I, J")
    height = radius**2 - 0.25 * length**2
    if height < -1e-3 * radius**2 - 2e-5 * abs(radius):
        raise InvalidInput(
            f"the ends of the arc are {1e3 * length:.6g} mm apart, more than twice its radius, "
            f"{1e3 * abs(radius):.6g} mm"
        )
    side = math.copysign(math.sqrt(max(0.0, height)), radius) / length
    centre: Array = 0.5 * (start + flat) + side * np.cross(axis, chord)
    return centre
