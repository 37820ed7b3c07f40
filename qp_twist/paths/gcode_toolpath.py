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
from qp_twist.paths.arcs import Arc, centre_of_radius, check_radii
from qp_twist.paths.gcode_corners import corner_of, cut_corner
from qp_twist.paths.gcode_cycles import CYCLES, Drilling
from qp_twist.paths.gcode_facts import Facts, is_gcode
from qp_twist.paths.gcode_frames import Frames
from qp_twist.paths.gcode_program import Program
from qp_twist.paths.gcode_tool_axis import BY_VECTOR, ToolAxis
from qp_twist.paths.gcode_words import FRAMES, REFUSED_NAMES, Block, is_cycle, read_block
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

SUFFIXES = (".nc", ".gcode", ".tap", ".mpf", ".spf", ".ngc", ".cnc", ".eia", ".min")
"""Suffixes of files that are read as G-code; others are, if their blocks evidently are."""

_BARE = frozenset({11, 22, 23, 25, 26, 29, 32, 34, 50})
"""G codes that do not change the path if their block has no coordinates."""
_PASSED = frozenset({
    *_BARE, 4, 9, 13.1, 15, 40, 43, 43.1, 43.2, 44, 49, 50.1, 50.2, 60, 61, 61.1, 62, 63, 64, 67,
    94, 96, 97, 103, 187, 290, 291, 450, 451, 601, 602, 603, 641, 642, 643, 644, 645,
})  # fmt: skip
"""G codes that do not change it."""
_TIP_ON = frozenset({43.4, 43.5, 234.0})
"""G codes after which X, Y, Z are those of the tool's tip, whatever its axis."""
_OFFSETS = frozenset({54, 55, 56, 57, 58, 59, 54.1, 54.2, 59.1, 59.2, 59.3, 154, 500,
                      505, 506, 507, 508, 509})  # fmt: skip
_REFUSED: dict[float, str] = {
    **dict.fromkeys((5, 5.1, 5.2, 5.3, 6, 6.1, 6.2), "a spline"),
    7: "a lathe's diameter", 8: "a lathe's radius",
    12: "a circular pocket", 13: "a circular pocket", 16: "polar coordinates",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
    31: "a measurement", 33: "a thread", 38.2: "a measurement", 38.3: "a measurement",
    38.4: "a measurement", 38.5: "a measurement", 331: "a thread", 332: "a thread",
    41: "a shift by the tool's radius", 42: "a shift by the tool's radius",
    41.1: "a shift by the tool's radius", 42.1: "a shift by the tool's radius",
    41.2: "a shift by the tool's radius", 42.2: "a shift by the tool's radius",
    51: "a scaled path", 51.1: "a mirrored path", 92.3: "a shift of coordinates",
    65: "a call of a macro", 66: "a call of a macro", 68.1: "turned coordinates",
    68.3: "turned coordinates", 68.4: "turned coordinates", 254: "turned coordinates",
    **dict.fromkeys((71.1, 71.2, 72, 72.1, 72.2), "a lathe's cycle"), 76: "a boring cycle",
    87: "a boring cycle", 88: "a boring cycle",
}  # fmt: skip
_INSTEAD: dict[float, str] = {
    **dict.fromkeys((41, 42, 41.1, 42.1, 41.2, 42.2), "write the path of the tool's centre (G40)"),
}
_WORDS = ProgramWords("a G-code file", "I, J, K", "G0", "G20 (inch) or G21 (mm)")
_UNITS: dict[float, LengthUnit] = {
    **dict.fromkeys((20, 70, 700), "inch"), **dict.fromkeys((21, 71, 710), "mm"),
}  # fmt: skip
_FRAMES = frozenset({10, 52, 53.1, 68, 68.2, 69, 80, 92, 92.1, 92.2})
"""G codes of frames of coordinates; and G80, after which there is no drilling."""
_MODAL: dict[float, tuple[str, int]] = {
    **{code: ("motion", code) for code in (0, 1, 2, 3)},
    **{code: ("plane", code) for code in (17, 18, 19)},
    90: ("relative", False), 91: ("relative", True),
    90.1: ("absolute_centres", True), 91.1: ("absolute_centres", False),
    93: ("feed", 93), 94: ("feed", 94), 95: ("feed", 95),
    98: ("to_initial", True), 99: ("to_initial", False),
}  # fmt: skip
"""Codes that hold until another of their group: name and value of the mode."""
_AWAY = frozenset({28, 30, 53, 153})
"""Codes of motions to positions of the machine."""
_PLANES: dict[float, tuple[str, str, str]] = {
    17: ("X", "Y", "Z"), 18: ("Z", "X", "Y"), 19: ("Y", "Z", "X"),
}  # fmt: skip
"""The two axes of each plane, and the one about which G3 is right-handed."""
_CENTRE = {"X": "I", "Y": "J", "Z": "K"}
_KINEMATICS = {428.0: True, 429.0: False}
"""LinuxCNC's switches of a five-axis machine: with control of the tool's tip, and without."""
_CALLS = (97, 98, 198)
_ENDS = (2, 30, 99, 17)
_LETTERS = frozenset("XYZABCEIJKRFSTDHPQL")
_OTHERS = frozenset({"N", "O", "CR", "RND", "RNDM", "CHF", "CHR", "FRC", "FRCM", "CTOL", "S1", "S2",
                     "M1", "M2", "M3", *BY_VECTOR})  # fmt: skip
_KNOWN = _LETTERS | _OTHERS
_MOVING = frozenset({*"XYZABCIJKR", *BY_VECTOR, "CR"})
_OWN_WORDS = frozenset({4, 10, 52, 68, 68.2, 92})
"""Codes whose X, Y, Z, … are no target of a motion."""
_SUBPROGRAM = re.compile(r"\s*O\s*<[^>]*>\s*SUB", re.IGNORECASE)
_MOST_PROBLEMS = 1000
"""After them, the rest of a program is not read: it is of another language, or a loop."""
_LARGEST_TURN = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_MOST_TURNED = 36_000.0
"""Largest turn of a rotary axis in one cut, degrees: beyond it, a number is wrong."""


def _matches(suffix: str, lines: Sequence[str]) -> bool:
    return suffix in SUFFIXES or (suffix != ".csv" and is_gcode(lines))


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a G-code program.

    A straight motion in rapid traverse (G0) begins another curve. The tool axis is (0, 0, 1), or
    that of I, J, K, or of the rotary axes by the convention ``rotary``, or the normal of a tilted
    plane. Feeds hold until the next F word. Arcs become polygons.

    Raises:
        InvalidInput: If a line is invalid, changes the path in a way that is not supported, or a
            tool axis is open.
    """
    out = ProgramBuilder(options, _WORDS)
    reader = _Reader(out, Facts.of(lines))
    reader.read(lines)
    out.problems.refuse()
    if not out.rows and any(map(_SUBPROGRAM.match, lines)):
        raise InvalidInput("it has subprograms alone, which another program calls; read that one.")
    assumptions = [*reader.notes, *out.divided(), *reader.axis.notes()]
    return out.toolpath(
        path, assumptions, reader.left_out(), has_axis=reader.axis.stated or reader.tilted
    )


GCODE = ToolpathFormat(_matches, _read, STATED_BY_PROGRAMS)
"""G-code."""


@dataclass
class _Modes:
    """What holds until another G code says otherwise."""

    motion: int | None = None  # G0 to G3
    plane: int = 17  # to 19
    relative: bool = False  # coordinates
    absolute_centres: bool | None = None  # of arcs; None: nothing states it
    feed: int = 94  # per minute; 95 per turn of the spindle, 93 motions per minute
    tip: bool = False  # whether X, Y, Z are those of the tip, whatever the tool axis
    to_initial: bool = True  # after a hole: G98, or to R by G99
    filament_relative: bool = False  # E of a 3-D printer
    rounding: float = 0.0  # RNDM: of each corner
    cycle: Drilling | None = None


class _Reader:
    """Reads the blocks of a program.

    Attributes:
        out: The points so far.
        facts: What the whole program says.
        axis: The tool axis.
        modes: What holds.
        at: Where the tool is: X, Y, Z in m as far as they are known.
        frames: Of X, Y, Z.
        tilted: Whether there was a tilted plane.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self.out, self.facts = out, facts
        self.axis = ToolAxis(out, facts)
        self.modes, self.frames = _Modes(), Frames()
        self.at: dict[str, float] = {}
        self.tilted = False
        self._notes: dict[str, list[int]] = {}
        self._away: list[int] = []
        self._gone: set[str] = set()
        self._corner: tuple[Array, Array, tuple[str, float]] | None = None
        self._filament = 0.0
        self._origins: dict[tuple[float | None, float | None], dict[str, float]] = {}
        self._pointless = ("", 0)
        self._motions_per_minute: float | None = None

    @property
    def notes(self) -> list[str]:
        """What was assumed, a sentence each, with its lines."""
        return [f"{what} ({of_lines(lines)})." for what, lines in self._notes.items()]

    def _note(self, what: str) -> None:
        self._notes.setdefault(what, []).append(self.out.line)

    def read(self, lines: Sequence[str]) -> None:
        """Read all lines up to the end of the program.

        Raises:
            InvalidInput: If the first line with text is no block: the file is no G-code; or if it
                is the program of a lathe.
        """
        program = Program(lines)
        for number, line in enumerate(lines, start=1):
            try:
                if program.plain(number) and not read_block(line).empty:
                    break
            except InvalidInput as error:
                error.line = number
                raise
        if self.facts.lathe:
            raise InvalidInput(
                "X and Z alone are the program of a lathe, whose X may be a diameter; that is not "
                "read as a toolpath"
            )
        if (likely := self.facts.likely_unit()) is not None:
            self.out.assume_unit(*likely)
        last = 0
        try:
            for number, line in program.run():
                with self.out.at(number):
                    if self._block(read_block(line)):
                        last = number
                        break
                if len(self.out.problems) > _MOST_PROBLEMS:
                    break
        except TooManyPoints:
            pass  # which is one of the problems
        except InvalidInput as error:
            self.out.line = error.line or 1
            self.out.refuse(error)
        if last and any(line.strip() not in ("", "%") for line in lines[last:]):
            self.out.line = last + 1
            self.out.pass_over("lines after the end of the program")
        self._decimal_points()

    def _decimal_points(self) -> None:
        """What was taken for a number without a decimal point."""
        facts, (text, line) = self.facts, self._pointless
        self.out.line = line
        if facts.in_thousandths:
            self._note(
                "numbers count the smallest step, 0.001 mm or 0.0001 inch: none has a decimal point"
            )
        elif text and facts.unlike:
            self.out.problem(
                f"{text} has no decimal point, and others do; on some machines a number without "
                "one counts thousandths. Write all with a point, or none"
            )
        elif text and facts.pointed and not (facts.fine or facts.extrudes):
            self._note(
                f"numbers without a decimal point, as {text}, are read like those with one; on "
                "machines that count thousandths, write a point"
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
        own_words = any(code in _OWN_WORDS for code in block.codes)
        self.modes.rounding = words.get("RNDM", self.modes.rounding)
        for name in block.names:
            own_words |= self._name(name, block)
        away = "SUPA" in block.names or any(code in _AWAY for code in block.codes)
        for code in block.codes:
            self._code(code, block)
        if "L" in words and self.modes.cycle is None and 10 not in block.codes:
            raise InvalidInput("L calls or repeats a subprogram, which is not read")
        self._feed(block)
        for word in [*(k for k in "ST" if k in words), *(f"M{code:g}" for code in block.switches)]:
            self.out.pass_over(word)
        if away:
            self._leave(words)
        elif not own_words and not _MOVING.isdisjoint(words):
            self._move(block)
        elif "E" in words and not own_words:
            self._deposits(block)
        if "E" in words:
            self.out.pass_over("E")
        return any(code in _ENDS for code in block.switches)

    def _check(self, block: Block) -> None:
        """Refuse unknown words and calls; remember a number without a decimal point."""
        if unknown := block.words.keys() - _KNOWN:
            raise InvalidInput(f"{sorted(unknown)[0]} is no word that is known")
        if not self._pointless[0]:
            for name in "XYZIJK":
                text = block.written.get(name, "")
                if text and "." not in text and float(text):
                    self._pointless = (f"{name}{text}", self.out.line)
        for code in block.switches:
            self.modes.tip = _KINEMATICS.get(code, self.modes.tip)
            if code in _CALLS:
                raise InvalidInput(
                    f"M{code:g} calls a subprogram, which is not read; have the CAM system write "
                    "one program"
                )
        if len(block.codes) > 1 and sum(code in (0, 1, 2, 3) for code in block.codes) > 1:
            raise InvalidInput("a block has one of G0, G1, G2 and G3; got several")

    def _name(self, name: str, block: Block) -> bool:
        """Process another word; whether the coordinates of the block belong to it."""
        stem = name.partition("(")[0]
        self.out.pass_over(stem)
        if stem in REFUSED_NAMES or (stem not in ("CYCLE832", "CYCLE800") and is_cycle(stem)):
            what = REFUSED_NAMES.get(stem, "a cycle of the control")
            raise InvalidInput(
                f"{stem} is {what}, which is not read; have the CAM system write plain motions G0 "
                "to G3"
            )
        if stem in ("TRAORI", "TRAFOOF"):
            self.modes.tip = stem == "TRAORI"
        elif stem in ("M82", "M83"):
            self.modes.filament_relative = stem == "M83"
        elif name.startswith("CYCLE800("):
            with _Reframed(self):
                if note := self.frames.swivel(name, self._scale()):
                    self._note(note)
                    self.tilted = True
        elif stem in FRAMES:
            with _Reframed(self):
                self.frames.program(stem, block.words, self._scale())
            return True
        return False

    def _code(self, code: float, block: Block) -> None:
        """Process a G code."""
        words = block.words.keys()
        # G5 with P or Q looks ahead; the words of a spline are others.
        ahead = code in (5, 5.1, 8) and {"P", "Q"} & words and not set("XYZIJK") & words
        if code in _MODAL:
            self._mode(*_MODAL[code])
        elif code in _UNITS:
            moved = bool(self.out.rows or self.at) and self.out.length_unit != _UNITS[code]
            self.out.set_unit(_UNITS[code], moved=moved)
        elif code in _OFFSETS:
            self.out.set_frame(f"G{code:g}", code + 1e-3 * block.words.get("P", 0.0))
        elif code in CYCLES:
            self._cycle(int(code))
        elif code in _FRAMES:
            self._frame(code, block)
        elif code in _BARE and set("XYZABC") & words:
            what = "is a shift of coordinates here, which" if code == 50 else "with coordinates"
            raise InvalidInput(f"G{code:g} {what} is not read")
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

    def _mode(self, name: str, value: int) -> None:
        """Process a G code that holds until another of its group."""
        if name == "feed" and self.modes.feed != value:
            self.out.feeds.set(math.nan, per_turn=value == 95)  # another F does not hold
        if name == "motion":
            self.modes.cycle = None
        if name == "relative":
            self.modes.filament_relative = bool(value)
        setattr(self.modes, name, value)

    def _frame(self, code: float, block: Block) -> None:
        """Process a G code of frames of coordinates."""
        words, at = block.words, self.at
        self.out.pass_over(f"G{code:g}")
        if code == 80:
            self.modes.cycle = None
        elif code == 10:
            # Where a work offset is on the machine; the path is in coordinates of the offset.
            which = words.get("L"), words.get("P")
            origin = {k: words[k] for k in "XYZABC" if k in words}
            if self.out.rows and origin and self._origins.get(which) != origin:
                raise InvalidInput("G10 moves an offset after the first motion, which is not read")
            self._origins[which] = origin
        elif code == 53.1:
            if self.frames.plane is None:
                raise InvalidInput("G53.1 turns the tool to a tilted plane, and there is none")
        elif code in (68, 68.2) and self.modes.plane != 17:
            raise InvalidInput(f"G{code:g} is read in the plane of G17 alone")
        elif code == 68.2:
            with _Reframed(self):
                self.frames.tilt(words, self._scale())
            self.tilted = True
        elif code == 68:
            if (
                self.modes.relative
                or "R" not in words
                or not {"X", "Y"} <= at.keys() | words.keys()
            ):
                raise InvalidInput("G68 is read with R, and with a centre X, Y that is known")
            scale = self._scale()
            centre = [scale * words[k] if k in words else at[k] for k in "XY"]
            with _Reframed(self):
                self.frames.turn(np.array([*centre, 0.0]), words["R"])
        elif code == 52:
            scale = self._scale()
            with _Reframed(self):
                self.frames.shift({k: scale * words[k] for k in "XYZ" if k in words}, more=False)
        elif code == 92:
            self._filament = words.get("E", self._filament)
            self._set_position({k: words[k] for k in "XYZ" if k in words})
        else:
            with _Reframed(self):
                self.frames.end(shift=code != 69)

    def _set_position(self, words: dict[str, float]) -> None:
        """G92: the tool is where the words say, in coordinates that are shifted for it."""
        if not words:
            return
        scale = self._scale()
        if missing := [k for k in words if k not in self.at and self.out.rows]:
            raise InvalidInput(f"G92: where the tool is in {missing[0]} is not known")
        moved = {k: self.at[k] - scale * v for k, v in words.items() if k in self.at}
        if any(moved.values()):
            self.frames.shift(moved, more=True)
        self.at.update({k: scale * v for k, v in words.items()})
        self._gone -= words.keys()

    def _leave(self, words: dict[str, float]) -> None:
        """A motion to a position of the machine: the axes it names are somewhere unknown."""
        named = set("XYZ") & words.keys()
        for axis in named or ({} if set("ABC") & words.keys() else "XYZ"):
            self.at.pop(axis, None)
            self._gone.add(axis)
        self._away.append(self.out.line)
        self.out.begin_curve()

    def _scale(self) -> float:
        least = 1e-3 if self.out.length_unit == "mm" else 1e-4
        return self.out.scale() * (least if self.facts.in_thousandths else 1.0)

    # ------------------------------------------------------------ a motion

    def _target(self, block: Block, scale: float) -> None:
        """Read X, Y and Z."""
        for axis in "XYZ":
            if axis not in block.words:
                continue
            kind = block.kinds.get(axis, "IC" if self.modes.relative else "AC")
            if kind == "IC" and axis not in self.at:
                if axis in self._gone:
                    raise InvalidInput(f"{axis} is relative (G91) to a position that is not known")
                self._assume_zero(axis)
            value = scale * block.words[axis]
            self.at[axis] = value + self.at[axis] if kind == "IC" else value

    def _assume_zero(self, axis: str) -> None:
        """Where nothing states a coordinate, machines begin at 0.

        Raises:
            InvalidInput: If the tool went elsewhere.
        """
        if axis in self._gone:
            raise InvalidInput(
                f"G{self.modes.motion or 0}: where the tool is in {axis} is not known"
            )
        self.at[axis] = 0.0
        self._note(f"{axis} is 0 until it is stated")

    def _move(self, block: Block) -> None:
        """A motion in the mode in force."""
        words, modes = block.words, self.modes
        cut = modes.motion != 0 and self._deposits(block)
        if not cut and modes.motion and not {"X", "Y", "Z"}.isdisjoint(words):
            self._note("motions that deposit no filament (E) are rapid")
        if modes.cycle is not None:
            self._drill(block)
            return
        if modes.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        start, tip = dict(self.at), modes.tip or self.frames.plane is not None
        if not tip and not self.axis.machine and self.axis.turned and not set("XYZ") & words.keys():
            self.at.clear()  # a turn about the pivot of the machine leads the tip elsewhere
            self._gone.update("XYZ")
        scale = self._scale() if words.keys() & {*"XYZIJKR", "CR"} else 1.0
        self._target(block, scale)
        begin = self.axis.turn(block, relative=modes.relative, cut=cut)
        if not tip and self.axis.turned and self.axis.rotary is not None:
            self.axis.assume_machine()
        unread = not tip and self.axis.turned and not self.axis.machine
        if cut and self._gone - self.at.keys() and modes.motion == 1 and not unread:
            self._note("cuts are left out while the tool comes from a position of the machine")
            self.out.begin_curve()
        elif cut and len(self.at) < 3 and set("XYZ") & words.keys() and not unread:
            for axis in "XYZ":
                if axis not in self.at:
                    self._assume_zero(axis)
                    start[axis] = 0.0
            if len(start) == 3:
                self._add_point([start[axis] for axis in "XYZ"], begin, cut=False)
        if modes.motion in (2, 3):
            self._arc(block, start, begin, scale, tip=tip)
            return
        self.axis.read_vector(block)
        if words.keys() & {"R", "CR"}:
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        if unread and self.axis.rotary is not None:
            self._without_tip()
        elif len(self.at) == 3:
            self._straight(start, begin, block, cut=cut)

    def _deposits(self, block: Block) -> bool:
        """Whether a motion cuts; on a 3-D printer, whether it deposits filament."""
        if not self.facts.extrudes:
            return True
        filament = block.words.get("E")
        if filament is None:
            return False
        fed = filament if self.modes.filament_relative else filament - self._filament
        self._filament = filament
        return fed > 0.0

    def _without_tip(self) -> None:
        """A motion with turned rotary axes whose X, Y, Z are not those of the tip."""
        self.at.clear()
        self._gone.update("XYZ")
        self.out.begin_curve()
        if self.modes.motion != 0:
            self.axis.refuse_without_tip()

    def _cycle(self, code: int) -> None:
        """A drilling cycle begins."""
        if self.modes.plane != 17:
            raise InvalidInput(f"G{code}: drilling is read in the plane of G17 alone")
        if "Z" not in self.at:
            self._assume_zero("Z")
        cycle = self.modes.cycle
        self.modes.cycle = Drilling(code, self.at["Z"])
        if cycle is not None:
            self.modes.cycle.clear, self.modes.cycle.depth = cycle.clear, cycle.depth
            self.modes.cycle.initial = cycle.initial
        what = f", without {CYCLES[code]}" if CYCLES[code] else ""
        self._note(f"G{code} (drilling) is read as motions{what}")

    def _drill(self, block: Block) -> None:
        """The motions of a hole, or of several that G91 repeats."""
        cycle, words, relative = self.modes.cycle, block.words, self.modes.relative
        assert cycle is not None
        if self.axis.turned and not self.modes.tip and not self.frames.changed:
            raise InvalidInput(f"G{cycle.code}: drilling with turned rotary axes is not read")
        scale, motion = self._scale(), self.modes.motion
        cycle.state(words, scale, relative=relative)
        repeats = int(words.get("L", words.get("K", 1)))
        if not 0 <= repeats <= 1000:
            raise InvalidInput(f"G{cycle.code}: expected 0 to 1000 repeats, got {repeats}")
        begin, there = self.axis.turn(block, relative=relative, cut=False), block.words
        aside = Block(words={k: there[k] for k in "XY" if k in there})
        for _ in range(repeats):
            self._target(aside, scale)
            for axis in "XY":
                if axis not in self.at:
                    self._assume_zero(axis)
            for rapid, z in [(True, self.at["Z"]),
                             *cycle.hole(to_initial=self.modes.to_initial)]:  # fmt: skip
                start, self.at["Z"] = dict(self.at), z
                self.modes.motion = 0 if rapid else 1
                self._straight(start, begin, aside, cut=not rapid)
        self.modes.motion = motion

    def _straight(
        self, start: dict[str, float], begin: dict[str, float], block: Block, *, cut: bool
    ) -> None:
        """Add a straight motion, divided where rotary axes turn the tool on the way."""
        turn = self.axis.largest_turn(begin)
        corner = corner_of(block) or (("R", self.modes.rounding) if self.modes.rounding else None)
        if not (turn and cut) and corner is None and self._corner is None:
            self._add_point([self.at[axis] for axis in "XYZ"], begin, cut=cut)
            return
        end = _point(self.at)
        first = end
        if self._corner is not None:
            before, at, (kind, size) = self._corner
            self._corner = None
            if not cut or turn:
                raise InvalidInput("a corner is cut between two straight cuts alone")
            self._cut_corner(before, at, end, kind, size, begin)
        if cut and corner and len(start) == 3:
            if turn:
                raise InvalidInput("a corner of a cut that turns the tool is not read")
            kind, size = corner
            self._corner = _point(start), end, (kind, self._scale() * size)
        count = 1
        # In rapid motion the way of the axis does not matter, and it is one motion.
        if len(start) == 3 and cut and turn:
            if turn > _MOST_TURNED:
                raise InvalidInput(
                    f"a rotary axis turns by {turn:.6g} degrees in one cut, more than "
                    f"{_MOST_TURNED:g}; check the angle"
                )
            first = _point(start)
            step = self.axis.largest_step(first, end, tip=self._of_tip())
            count = max(1, math.ceil(turn / min(_LARGEST_TURN, step) - 1e-9))
        shares = np.arange(1, count + 1) / count
        points = first + shares[:, None] * (end - first)
        points[-1] = end
        self._add(points, shares, begin, cut=cut)

    def _cut_corner(
        self, before: Array, at: Array, end: Array, kind: str, size: float,
        begin: dict[str, float],
    ) -> None:  # fmt: skip
        """Shorten the cut that was added last, and add its corner."""
        first, motion = cut_corner(before, at, end, kind, size)
        last = self.out.rows[-1]
        moved = self.frames.whole.apply(first) if self.frames.changed else first
        self.out.rows[-1] = last._replace(position=tuple(moved.tolist()))
        if isinstance(motion, Arc):
            self._add(*self.out.divide_arc(motion), begin, cut=True)
        elif motion is not None:
            self._add(motion[None], np.ones(1), begin, cut=True)

    def _of_tip(self) -> bool:
        """Whether X, Y, Z are those of the tip."""
        return self.modes.tip or self.frames.plane is not None or not self.axis.machine

    def _add_point(self, point: list[float], begin: dict[str, float], *, cut: bool) -> None:
        """Add the end of a straight motion; in a cut if it differs from the point before."""
        rows = self.out.rows
        direction = self.frames.axis or self.axis.at(begin, 1.0)
        if not self._of_tip():
            point = self.axis.tip(begin, 1.0, point)
        if self.frames.changed:
            point = self.frames.whole.apply(point).tolist()
        if rows and cut:
            length = math.dist(rows[-1].position, point)
            if self.modes.feed == 93:
                self._feed_by_time(length)
            if length < SAME_POINT and rows[-1].direction == direction:
                return
        self.out.add([np.array(point)], [direction], rapid=not cut)

    def _add(
        self, points: Array, shares: Array, begin: dict[str, float], *, cut: bool = True
    ) -> None:
        """Add the points of a motion at some shares of it; in a cut those that differ."""
        rows = self.out.rows
        plane = self.frames.axis
        axes = [plane or self.axis.at(begin, float(share)) for share in shares]
        if not self._of_tip():
            points = np.array([self.axis.tip(begin, float(share), point.tolist())
                               for share, point in zip(shares, points, strict=True)])  # fmt: skip
        if self.frames.changed:
            points = self.frames.whole.apply(points)
        if rows and cut:
            last = rows[-1]
            moved = np.diff(np.vstack([last.position, points]), axis=0)
            lengths = np.sqrt((moved * moved).sum(axis=1))
            before = [last.direction, *axes]
            keep = [k for k in range(len(axes))
                    if lengths[k] >= SAME_POINT or before[k] != axes[k]]  # fmt: skip
            points, axes = points[keep], [axes[k] for k in keep]
            if self.modes.feed == 93:
                self._feed_by_time(float(lengths.sum()))
        self.out.add([*points], axes, rapid=not cut)

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
        self, block: Block, start: dict[str, float], begin: dict[str, float], scale: float,
        *, tip: bool,
    ) -> None:  # fmt: skip
        """Add an arc or a helix: G2 left-handed, G3 right-handed about the axis of the plane."""
        if not tip and self.axis.turned and not self.axis.machine:
            self._without_tip()
            return
        if len(start) < 3 or len(self.at) < 3:
            raise InvalidInput(f"G{self.modes.motion}: where the arc begins is not known")
        if block.words.keys() & set(BY_VECTOR):
            raise InvalidInput("a tool axis by A3, B3, C3 on an arc is not read")
        if block.words.get("P", 1.0) != 1.0:
            raise InvalidInput("P: several turns are not read; write each turn as an arc")
        if self._corner is not None or corner_of(block) is not None or self.modes.rounding:
            raise InvalidInput("a corner is cut between two straight cuts alone")
        s, e = _point(start), _point(self.at)
        axis = np.array([float(name == _PLANES[self.modes.plane][2]) for name in "XYZ"])
        if self.modes.motion == 2:
            axis = -axis
        centre = self._centre(block, s, e, axis, scale)
        self._add(*self.out.divide_arc(Arc.between(s, e, centre, axis)), begin)

    def _centre(self, block: Block, start: Array, end: Array, axis: Array, scale: float) -> Array:
        """The centre of an arc, by I, J, K or by its radius."""
        words = block.words
        radius = words.get("R", words.get("CR"))
        letters = [_CENTRE[name] for name in _PLANES[self.modes.plane][:2]]
        named = [letter for letter in "IJK" if letter in words]
        if radius is not None and any(words[letter] for letter in named):
            raise InvalidInput("an arc has a radius R or a centre I, J, K; got both")
        if radius is not None:
            return centre_of_radius(start, end, axis, scale * radius)
        in_plane = f"an arc in the plane of G{self.modes.plane} has its centre in "
        if not set(named) & set(letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)}, or a radius R; got neither")
        if any(words[letter] for letter in named if letter not in letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)} alone; got {', '.join(named)}")
        if self.modes.absolute_centres and not set(letters) <= set(named):
            raise InvalidInput(f"G90.1: the centre needs both {' and '.join(letters)}")
        stated = np.array([scale * words.get(letter, 0.0) for letter in "IJK"])
        if block.kinds.keys() & set(letters):
            absolute = {k for k, kind in block.kinds.items() if kind == "AC"}
            mixed = [k in absolute for k in "IJK"]
            return np.where(mixed, stated, start + stated)
        fits = _fits(start, end, start + stated, axis)
        if self.modes.absolute_centres is None and not fits and stated.any():
            # Some controls count I, J, K from the origin without a word: if only that fits, so.
            if not _fits(start, end, stated, axis) or not set(letters) <= set(named):
                check_radii(start, end, start + stated, axis, None)
            self.modes.absolute_centres = True
            self._note("the centres I, J, K of arcs are absolute: from the start, none would fit")
        centre: Array = stated if self.modes.absolute_centres else start + stated
        return centre


class _Reframed:
    """While it is open, the frame of the coordinates changes; the tool stays where it is."""

    def __init__(self, reader: _Reader) -> None:
        self._reader, self._before = reader, reader.frames.whole

    def __enter__(self) -> None:
        pass

    def __exit__(self, *failed: object) -> None:
        reader, after = self._reader, self._reader.frames.whole
        if len(reader.at) == 3:
            there = after.inv().apply(self._before.apply(_point(reader.at)))
            reader.at = dict(zip("XYZ", there.tolist(), strict=True))
        elif np.any(after.as_matrix() != self._before.as_matrix()):
            reader._gone.update(reader.at)
            reader.at.clear()


def _fits(start: Array, end: Array, centre: Array, axis: Array) -> bool:
    """Whether a point can be the centre of an arc."""
    try:
        check_radii(start, end, centre, axis, None)
    except InvalidInput:
        return False
    return True


def _point(at: dict[str, float]) -> Array:
    return np.array([at[axis] for axis in "XYZ"])
