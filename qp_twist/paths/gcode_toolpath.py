"""Toolpaths from G-code (DIN 66025, ISO 6983), with five axes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.paths import gcode_tables as tables
from qp_twist.paths.gcode_cycles import CALLED
from qp_twist.paths.gcode_frames import ended, programmed, shifted, swiveled, tilted, turned
from qp_twist.paths.gcode_motions import Motions
from qp_twist.paths.gcode_program import Program
from qp_twist.paths.gcode_words import ARCS, FRAMES, read_block
from qp_twist.paths.program_block import BEHIND_SLASH, Block
from qp_twist.paths.program_facts import COMMENT, Facts
from qp_twist.paths.program_frame import Frame
from qp_twist.paths.program_values import NUMBER
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
    TooManyPoints,
)
from qp_twist.paths.toolpath_options import ReadingOptions

SUFFIXES = (".nc", ".gcode", ".tap", ".mpf", ".spf", ".ngc", ".cnc", ".eia", ".min")
"""Suffixes of files that are read as G-code; others are, if their blocks evidently are."""

_WORDS = ProgramWords(
    "a G-code file", "I, J, K", "G0", "G20 (inch) or G21 (mm)",
    tip=("G43.4", "G43.5", "G234", "TRAORI"),
    applied=r"G(?:52|53\.1|68|68\.2|69|92|92\.1|43\.4|43\.5|234|98|99|80)|TRAORI|TRAFOOF|CYCLE800"
    r"|A?TRANS|A?ROT|M42[89]",
)  # fmt: skip
_LEFT_OUT = ("motions to the machine's own positions (G28, G53, … in {}) are left out; another "
             "curve begins after each.")  # fmt: skip
_PLAIN_MOTIONS = "have the CAM system write plain motions G0 to G3"
_SUBPROGRAM = re.compile(r"\s*O\s*<[^>]*>\s*SUB", re.IGNORECASE)
_BLOCK = re.compile(rf"[%/:]|(?:[/N][0-9]*\s*)?(?:[A-Z]\s*=?\s*{NUMBER}\s*)+$|[(;]|$")
_CUT = re.compile(rf"(?<![A-Z])G0*[0-3](?![0-9.]).*[XYZ]\s*=?\s*{NUMBER}", re.IGNORECASE)
_MOST_PROBLEMS = 1000
"""After them, the rest of a program is not read: it is of another language."""


def _matches(suffix: str, lines: Sequence[str]) -> bool:
    """Whether a file is G-code: by its suffix, or nearly all lines are blocks, and one a motion."""
    if suffix in SUFFIXES or suffix == ".csv":
        return suffix != ".csv"
    head = [COMMENT.sub("", line).strip().upper() for line in lines[:400]]
    text = [line for line in head if line]
    fits = sum(_BLOCK.match(line) is not None for line in text)
    return fits > 0.8 * len(text) and any(map(_CUT.search, text))


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a G-code program.

    A straight motion in rapid traverse (G0) begins another curve. The tool axis is (0, 0, 1), or
    that of I, J, K, or of the rotary axes by the convention ``rotary``, or the normal of a tilted
    plane. Feeds hold until the next F word. Arcs become polygons.
    """
    out = ProgramBuilder(options, _WORDS)
    reader = _Reader(out, Facts.of(lines))
    reader.read(lines)
    out.problems.refuse()
    if not out.rows and any(map(_SUBPROGRAM.match, lines)):
        raise InvalidInput("it has subprograms alone, which another program calls; read that one.")
    return reader.to.toolpath(path)


GCODE = ToolpathFormat(_matches, _read, STATED_BY_PROGRAMS)
"""G-code."""


class _Reader:
    """Reads the blocks of a program.

    Attributes:
        out: The points so far.
        facts: What the whole program says.
        to: The tool on its way, and what holds.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self.out, self.facts = out, facts
        self.to = Motions(out, facts)
        self._filament = 0.0
        self._origins: dict[tuple[float | None, float | None], dict[str, float]] = {}
        self._shifted: set[str] = set()  # by a SINUMERIK frame, and not stated since

    def read(self, lines: Sequence[str]) -> None:
        """Read all lines up to the end of the program."""
        program = Program(lines)
        for at, line in enumerate(lines):
            try:
                if program.plain(at) and not read_block(line).empty:
                    break
            except InvalidInput as error:
                error.line = at + 1
                raise
        if self.facts.lathe:
            raise InvalidInput(
                "X and Z alone are the program of a lathe, whose X may be a diameter; that is not "
                "read as a toolpath"
            )
        if self.facts.unit is not None:
            self.out.assume_unit(*self.facts.unit)

        def run(at: int) -> bool:
            if len(self.out.problems) > _MOST_PROBLEMS:
                raise TooManyPoints("and more; it seems to be of another language")
            text = program.block(at)
            return bool(text) and self._block(read_block(text))

        last = program.course.run(self.out, range(1, len(lines) + 1), run)
        if last and any(line.strip() not in ("", "%") for line in lines[last:]):
            self.out.line = last + 1
            self.out.pass_over("lines after the end of the program")
        self._decimal_points()

    def _decimal_points(self) -> None:
        """What was taken for a number without a decimal point."""
        if self.facts.pointless is None:
            return
        text, self.out.line = self.facts.pointless
        if self.facts.points == "none":
            self.out.note(
                "numbers count the smallest step, 0.001 mm or 0.0001 inch: none has a decimal point"
            )
        elif self.facts.points == "larger":
            self.out.problem(
                f"{text} has no decimal point, and others do; on some machines a number without "
                "one counts thousandths. Write all with a point, or none"
            )
        elif self.facts.points == "some":
            self.out.note(
                f"numbers without a decimal point, as {text}, are read like those with one; on "
                "machines that count thousandths, write a point"
            )

    # ------------------------------------------------------------ a block

    def _block(self, block: Block) -> bool:
        """Process a block; whether it ends the program."""
        words, modes = block.words, self.to.modes
        if block.skipped:
            if words.keys() & set("XYZABCIJK") or block.codes:
                raise InvalidInput(BEHIND_SLASH)
            self.out.pass_over("/")
            return False
        _check(block)
        for code in block.switches:
            self.to.tip = tables.KINEMATICS.get(code, self.to.tip)
        modes.rounding = words.get("RNDM", modes.rounding)
        modes.corner_feed = words.get("FRCM", modes.corner_feed)
        # G5 and G5.1 with P or Q look ahead; the words of a spline are others.
        ahead = bool({"P", "Q"} & words.keys()) and (
            5.1 in block.codes or not set("XYZIJK") & words.keys()
        )
        own_words = not tables.OWN_WORDS.isdisjoint(block.codes) or (5.1 in block.codes and ahead)
        for name in block.names:
            own_words |= self._name(name, block)
        for code in block.codes:
            if code in (5, 5.1, 8) and ahead:
                self.out.pass_over(f"G{code:g}")
            else:
                self._code(code, block)
        if "L" in words and modes.cycle is None and 10 not in block.codes:
            raise InvalidInput("L calls or repeats a subprogram, which is not read")
        self.to.feed(block)
        turns = f" S{words['S']:g}" if "S" in words else ""
        for word in [*(k for k in "STE" if k in words), *(f"M{code:g}" for code in block.switches)]:
            self.out.pass_over(word, word + turns * (word in ("M3", "M4")))
        if "SUPA" in block.names or not tables.AWAY.isdisjoint(block.codes):
            named = set("XYZ") & words.keys()
            self.to.leave(named or ("" if set("ABC") & words.keys() else "XYZ"))
            self.out.note(_LEFT_OUT, left_out=True)
        elif not own_words and not tables.MOVING.isdisjoint(words):
            self._move(block)
        elif "E" in words and not own_words:
            self._deposits(block)
        return any(code in tables.ENDS for code in block.switches)

    def _name(self, name: str, block: Block) -> bool:
        """Process another word; whether the coordinates of the block belong to it."""
        stem, modes = name.partition("(")[0].strip(), self.to.modes
        if stem in ARCS:
            modes.motion, modes.cycle = stem, None
            return False
        self.out.pass_over(stem)
        if stem in ("TRAORI", "TRAFOOF"):
            self.to.tip = stem == "TRAORI"
        elif stem in ("M82", "M83"):
            modes.filament_relative = modes.filament_by_itself = stem == "M83"
        elif stem == "MCALL":
            modes.called = ""
        elif stem in CALLED:
            self.to.call_drilling(name, at_each="MCALL" in block.names)
        elif stem == "CYCLE800":
            frame, note = swiveled(self.to.frame, name, self.to.scale())
            self._program_frame(frame)
            if note:
                self.out.note(note)
        elif stem in FRAMES:
            self._program_frame(programmed(self.to.frame, stem, block.words, self.to.scale()))
            return True
        return False

    def _program_frame(self, frame: Frame) -> None:
        """A frame of SINUMERIK, and the axes along which relative words are open after it."""
        before, after = self.to.frame.whole, frame.whole
        shifts = after.translation != before.translation
        turns = bool(np.any(after.rotation.as_matrix() != before.rotation.as_matrix()))
        self._shifted |= {k for k, shift in zip("XYZ", shifts, strict=True) if shift or turns}
        self.to.reframe(frame)

    def _code(self, code: float, block: Block) -> None:
        """Process a G code."""
        words = block.words.keys()
        if code in (70, 71, 72) and {"I", "J", "L"} & words:
            raise InvalidInput(f"G{code:g} with I, J or L is a pattern of holes, which is not read")
        kind, value = tables.CODES.get(code, ("", None))
        match kind:
            case "unit":
                moved = bool(self.out.rows or self.to.at) and self.out.length_unit != value
                self.out.set_unit(value, moved=moved)
            case "offset":
                self.out.set_frame(f"G{code:g}", code + 1e-3 * block.words.get("P", 0.0))
            case "drilling":
                self.to.begin_drilling(int(code))
            case "frame":
                self._frame(code, block)
            case "bare" if set("XYZABC") & words:
                what = "is a shift of coordinates here, which" if code == 50 else "with coordinates"
                raise InvalidInput(f"G{code:g} {what} is not read")
            case "bare" | "passed":
                self.out.pass_over(f"G{code:g}")
            case "tip":
                self.to.tip, self.to.axis.vectors = value, code == 43.5
                self.out.pass_over(f"G{code:g}")
            case "refused":
                instead = tables.INSTEAD.get(value, _PLAIN_MOTIONS)
                raise InvalidInput(f"G{code:g} is {value}, which is not read; {instead}")
            case "":
                raise InvalidInput(
                    f"G{code:g} is not known, and whether it changes the path neither; take it out "
                    "if it does not"
                )
            case mode if mode != "away":
                self._mode(mode, value)

    def _mode(self, name: str, value: Any) -> None:
        """Process a G code that holds until another of its group."""
        modes, feeds = self.to.modes, self.out.feeds
        if name == "feed" and modes.feed != value:
            feeds.set(math.nan, per_turn=value == 95)  # another F does not hold
            feeds.by_time = value == 93
        if name == "motion":
            modes.cycle = None
        if name == "relative":
            if self.facts.extrudes and modes.filament_by_itself and not value:
                self.out.note("G90 makes E absolute again after M83, as in Marlin; in Klipper not")
                modes.filament_by_itself = False
            modes.filament_relative = value
        setattr(modes, name, value)

    def _frame(self, code: float, block: Block) -> None:
        """Process a G code of frames of coordinates, or G80, after which there is no drilling."""
        words, at, frame, scale = block.words, self.to.at, self.to.frame, self.to.scale
        self.out.pass_over(f"G{code:g}")
        if code == 80:
            self.to.modes.cycle = None
        elif code == 10:
            # Where a work offset is on the machine; the path is in coordinates of the offset.
            which = words.get("L"), words.get("P")
            origin = {k: words[k] for k in "XYZABC" if k in words}
            if self.out.rows and origin and self._origins.get(which) != origin:
                raise InvalidInput("G10 moves an offset after the first motion, which is not read")
            self._origins[which] = origin
        elif code == 53.1:
            if frame.plane is None:
                raise InvalidInput("G53.1 turns the tool to a tilted plane, and there is none")
        elif code in (68, 68.2) and self.to.modes.plane != 17:
            raise InvalidInput(f"G{code:g} is read in the plane of G17 alone")
        elif code == 68.2:
            self.to.reframe(tilted(frame, words, scale()))
        elif code == 68:
            known = {"X", "Y"} <= at.keys() | words.keys()
            if self.to.modes.relative or "R" not in words or not known:
                raise InvalidInput("G68 is read with R, and with a centre X, Y that is known")
            centre = [scale() * words[k] if k in words else at[k] for k in "XY"]
            self.to.reframe(turned(frame, np.array([*centre, 0.0]), words["R"]))
        elif code == 52:
            origin = {k: scale() * words[k] for k in "XYZ" if k in words}
            self.to.reframe(shifted(frame, origin, more=False))
        elif code == 92:
            self._filament = words.get("E", self._filament)
            self.to.set_position({k: words[k] for k in "XYZ" if k in words})
        else:
            self.to.reframe(ended(frame, shift=code != 69))

    def _deposits(self, block: Block) -> bool:
        """Whether a motion cuts; on a 3-D printer, whether it deposits filament."""
        if not self.facts.extrudes:
            return True
        filament = block.words.get("E")
        if filament is None:
            return False
        fed = filament if self.to.modes.filament_relative else filament - self._filament
        self._filament = filament
        return fed > 0.0

    def _move(self, block: Block) -> None:
        """A motion, or the holes of a cycle."""
        motion = self.to.modes.motion
        if self.to.modes.relative:
            for name in tables.RELATIVE & block.words.keys():
                block.kinds.setdefault(name, "IC")
        if open_ := sorted(k for k in self._shifted if block.relative(k)):
            raise InvalidInput(
                f"{open_[0]} is relative, and its frame has changed since it was stated: whether "
                "the tool makes up for that too is a setting of the machine "
                "(FRAME_OFFSET_INCR_PROG); state an absolute position first"
            )
        self._shifted -= block.words.keys()
        cut = motion != 0 and self._deposits(block)
        if not cut and motion and not {"X", "Y", "Z"}.isdisjoint(block.words):
            self.out.note("motions that deposit no filament (E) are rapid")
        if self.to.modes.cycle is not None:
            self.to.drill(block)
        else:
            self.to.move(block, cut=cut)


def _check(block: Block) -> None:
    """Refuse what is not known."""
    if unknown := block.words.keys() - tables.KNOWN:
        raise InvalidInput(f"{sorted(unknown)[0]} is no word that is known")
    if len(block.codes) > 1:
        stated = {code: tables.CODES.get(code, ("", None)) for code in block.codes}
        kinds = [kind for kind, _ in {*stated.values()} if kind in tables.MODES]
        if len(kinds) > len({*kinds}):
            several = ", ".join(f"G{k:g}" for k, of in stated.items() if kinds.count(of[0]) > 1)
            raise InvalidInput(f"a block has one code of a group; got several: {several}")
    if 198 in block.switches:
        raise InvalidInput(
            "M198 calls a subprogram, which is not read; have the CAM system write one program"
        )
