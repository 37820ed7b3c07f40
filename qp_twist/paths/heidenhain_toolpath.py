"""Toolpaths from Klartext, the conversational programs of Heidenhain controls."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.heidenhain_blocks import BEGIN, Line, blocks, number, words
from qp_twist.paths.heidenhain_cycles import Cycle, cycle_of, feed_unit
from qp_twist.paths.heidenhain_frame import IMMEDIATE, by_cycle, by_plane
from qp_twist.paths.heidenhain_motions import Motions
from qp_twist.paths.machine_tool import Corner, Cut
from qp_twist.paths.program_block import BEHIND_SLASH, Block
from qp_twist.paths.program_course import Course
from qp_twist.paths.program_facts import Facts
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
)
from qp_twist.paths.toolpath_options import ReadingOptions

_WORDS = ProgramWords(
    "a Klartext program", "TX, TY, TZ", "FMAX", "MM behind BEGIN PGM",
    tip=("M128", "FUNCTION TCPM", "PLANE SPATIAL"),
    applied="M12[89]|FUNCTION|LBL|PLANE|CYCL DEF (?:7|10)",
)  # fmt: skip
_REFUSED: dict[float, str] = {
    **dict.fromkeys((114, 144), "a correction for the machine's geometry"),
    118: "handwheel motion", 130: "a point out of the plane",
    136: "a feed per turn of the spindle",
}  # fmt: skip
"""M functions that change the path."""
_AWAY = {91, 92, 140}
"""M functions of motions to positions of the machine."""
_NO_MOTION = ("BLK FORM", "TOOL DEF", "STOP", "*", "CYCL END", "LBL")
"""Blocks that move nothing."""
_SETS = re.compile(
    r"(?:(?P<kind>[0-9]+) ?: ?)?(?:SYSREAD )?(?P<name>Q[LRS]?[0-9]+)(?: ?= ?(?P<value>.*))?"
)
"""A parameter that is set: by a formula, or by FN 0 to FN 7, or by another function."""
_PROGRAMS = {
    **dict.fromkeys(("CALL", "CALL PGM"), "calls another program"),
    "TCH PROBE": "is a measurement, after which the coordinates are elsewhere",
}
_JUMP = re.compile(
    r'(?:9|1[0-2]) ?: ?IF (?P<one>\S+) (?P<is>EQU|NE|GT|LT) (?P<two>\S+) GOTO LBL "?(?P<to>.*?)"?'
)
"""FN 9 to FN 12."""
_MOTION = re.compile(r"\s*[0-9]*\s*L\s+[XYZ]\s*[-+]?[0-9.,]+(?:\s|$)", re.IGNORECASE)
_ONLY_SWITCHES = re.compile(r"(?:M ?[0-9]+ ?)*")
_CORRECTED = ("RL, RR ({}): a machine shifts the path by the radius of its tool; here the points "
              "are the path of the tool's tip.")  # fmt: skip
_BORED = ("cycles ({}): the tool goes along its axis down to the depth at once and back, without "
          "pecking and dwelling.")  # fmt: skip
_INCH = ("F ({}) of a program in inches is read as tenths of an inch per minute, as Heidenhain's "
         "manuals say.")  # fmt: skip
_PLANE = ("PLANE SPATIAL ({}): the points are turned into the frame of the part, and the tool "
          "stands along the plane's normal.")  # fmt: skip
_LEFT_OUT = ("motions to the machine's own positions (M91, M92, M140 in {}) are left out; another "
             "curve begins after each.")  # fmt: skip
_APPROACH = ("APPR and DEP ({}): the ways to the contour and from it are left out; a curve begins "
             "at its first point.")  # fmt: skip


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a Klartext program.

    A straight motion with FMAX begins another curve. A feed holds until the next one. The tool axis
    is (0, 0, 1), or that of TX, TY, TZ, of the tilted plane, or of the rotary axes with M128.
    """
    program = [*blocks(lines)]
    # Which rotary axes there are is the same question as in G-code, but for M functions.
    moved = [re.sub(r"M ?[0-9]+", "", block.text).replace(",", ".") for block in program
             if block.keyword in ("L", "LN", "LP") and "M91" not in block.text]  # fmt: skip
    out, facts = ProgramBuilder(options, _WORDS), Facts.of(moved)
    if facts.unit is not None:
        out.assume_unit(*facts.unit)
    reader = _Reader(out, facts, program)
    reader.course.run(out, [block.number for block in program], reader.block)
    out.problems.refuse()
    return reader.to.toolpath(path)


def _matches(suffix: str, lines: Sequence[str]) -> bool:
    """Whether a file is Klartext: by BEGIN PGM, or by its suffix and a motion."""
    begin = any(map(BEGIN.match, lines[:50]))
    return begin or (suffix == ".h" and any(map(_MOTION.match, lines[:50])))


HEIDENHAIN = ToolpathFormat(_matches, _read, STATED_BY_PROGRAMS)
"""Klartext."""


class _Reader:
    """Processes the blocks of a program.

    Attributes:
        out: The points so far.
        to: The machine and its tool.
        course: Where the program goes on, and its parameters.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts, program: Sequence[Line]) -> None:
        self.out, self.to, self.course = out, Motions(out, facts), Course()
        self._program, self._values = program, self.course.variables
        self._labels = {
            block.text.strip('" '): k for k, block in reversed([*enumerate(program)])
            if block.keyword == "LBL"
        }  # fmt: skip
        self._cycle: Cycle | None = None
        to = self.to
        self._motions: dict[str, Callable[[Block], None]] = {
            "L": to.move, "LN": to.move_by_normal, "LP": to.polar_move, "CC": to.pole,
            "C": to.arc_about_pole, "CP": to.polar_arc, "CR": to.arc_by_radius,
            "CT": to.tangent_arc, "": lambda block: None,
        }  # fmt: skip
        self._others: dict[str, Callable[[str, str], None]] = {
            "BEGIN PGM": self._begin, "RND": self._corner, "CHF": self._corner,
            "APPR": self._approach, "DEP": self._approach, "TOOL CALL": self._tool_call,
            "CYCL DEF": self._cycl_def, "CYCL CALL": self._cycl_call, "PLANE": self._plane,
            "FUNCTION": self._function, "FN": self._assign, "Q": self._assign,
            "CALL LBL": self._call,
        }  # fmt: skip

    def block(self, at: int) -> bool:
        """Process a block; whether it ends the program."""
        _, keyword, text, skipped = self._program[at]
        act = self._motions.get(keyword)
        if skipped:
            if act is not None and not _ONLY_SWITCHES.fullmatch(text):
                raise InvalidInput(BEHIND_SLASH)
            self.out.pass_over("/")
            return re.search(r"M ?(?:0?2|30)\b", text) is not None  # which subprograms follow
        if act is not None:
            return self._move(act, words(text, self._values))
        if keyword == "END PGM":
            return True
        if keyword == "LBL" and text == "0" and self.course.back():
            pass
        elif keyword in self._others:
            self._others[keyword](keyword, text)
        elif keyword in _NO_MOTION:
            self.out.pass_over(keyword)
        else:
            what = _PROGRAMS.get(keyword, "is not read: it may move the tool, or change where it "
                                 "moves")  # fmt: skip
            raise InvalidInput(
                f"{shortened(f'{keyword} {text}')!r} {what}; have the CAM system write one program "
                "of L, C, CP and LN blocks"
            )
        return False

    # ------------------------------------------------------------ the order of blocks

    def _label(self, name: str) -> int:
        """The block behind a label."""
        if name.strip() not in self._labels:
            raise InvalidInput(f"LBL {shortened(name)}: there is no such LBL")
        return self._labels[name.strip()] + 1

    def _call(self, keyword: str, text: str) -> None:
        """CALL LBL: a subprogram, or with REP a repetition."""
        match = re.fullmatch(r'"?([^"]*?)"?(?: ?REP ?([0-9]+)(?:/[0-9]+)?)?', text)
        if match is None:
            raise InvalidInput(f"CALL LBL {shortened(text)} is not read")
        to = self._label(match[1])
        if match[2] is None:
            self.course.call(to)
        elif self.course.counted(self.course.next, int(match[2])):
            self.course.next = to

    def _assign(self, keyword: str, text: str) -> None:
        """A jump on a condition, or a parameter; what sets it may have no value that is known."""
        text = f"Q{text}" if keyword == "Q" else text
        if (jump := _JUMP.fullmatch(text)) is not None:
            one, two = (number(jump[name], self._values) for name in ("one", "two"))
            holds = {"EQU": one == two, "NE": one != two, "GT": one > two, "LT": one < two}
            to = self._label(jump["to"])
            self.course.next = to if holds[jump["is"]] else self.course.next
            return
        if re.match(r"(?:9|1[0-2])\b", text):
            raise InvalidInput(f"FN {shortened(text)}: expected IF … GOTO LBL …")
        if re.match(r"(?:1[56]|38)\b", text):  # they print or send
            self.out.pass_over(keyword)
            return
        if re.match(r"14\b", text):
            raise InvalidInput("FN 14 ends the program here with a message of an error; check the "
                               "values that lead to it")  # fmt: skip
        match = _SETS.match(text)
        if match is None:
            raise InvalidInput(f"{shortened(text)!r} is no parameter that is set")
        self.out.pass_over(keyword)
        name, formula = match["name"], (match["value"] or "").replace(",", ".")
        kind = match["kind"] or ""
        known = kind in ("", "0", "1", "2", "3", "4", "5", "6", "7")
        try:
            value = self._values.value(formula.replace("DIV", "/") if known else "")
        except InvalidInput:  # matters only where the parameter is used
            what = shortened(repr(formula)) if known else f"FN {kind}"
            self._values.forget(name, "" if kind == "18" else f"{what} is not computed")
        else:
            self._values.set(name, value)

    # ------------------------------------------------------------ motions

    def _move(self, act: Callable[[Block], None], block: Block) -> bool:
        """Process a block of words; whether it ends the program."""
        to = self.to
        for switch in block.switches:
            if switch in _REFUSED:
                raise InvalidInput(f"M{switch:g} is {_REFUSED[switch]}, which is not read")
            if switch == 89 and block.words.keys() - {"F"}:
                raise InvalidInput(
                    "M89 in a block with a motion: whether there is a hole where it ends is not "
                    "sure; write M89 in a block of its own before it or behind it"
                )
            to.tip = (to.tip or switch == 128) and switch != 129
            self.out.pass_over(f"M{switch:g}")
        if not {"RL", "RR", "R+", "R-"}.isdisjoint(block.names):
            self.out.note(_CORRECTED)
        self._feed(block)
        if not _AWAY.isdisjoint(block.switches):
            named = {"Z"} if 140 in block.switches else {*"XYZ"} & block.words.keys()
            to.leave(named if named and to.frame.plane is None else "XYZ")
            self.out.note(_LEFT_OUT, left_out=True)
        else:
            act(block)
        modal = self._cycle is not None and self._cycle.modal and act == to.move
        if 99 in block.switches or modal:
            self._cycl_call()
        if self._cycle is not None:
            self._cycle.modal = (
                self._cycle.modal or 89 in block.switches
            ) and 99 not in block.switches
        return not {2, 30}.isdisjoint(block.switches)

    def _feed(self, block: Block) -> None:
        if (feed := self._feed_of(block)) is not None:
            self.out.feeds.state("F", feed[0], 1.0, per_turn=feed[1])

    def _feed_of(self, block: Block) -> tuple[float, bool] | None:
        """The feed of a block, m per minute or turn, and whether per turn."""
        words = block.words
        if {"FZ", "FT"} & words.keys():
            raise InvalidInput("FZ and FT are feeds per tooth and in a time, which are not read")
        if "F" not in words:
            return (self.out.scale() * words["FU"], True) if "FU" in words else None
        if self.out.length_unit == "inch":
            self.out.note(_INCH)
        return feed_unit(self.out) * words["F"], False

    def _corner(self, keyword: str, text: str) -> None:
        """RND, CHF: the corner between the cut before and the one behind."""
        block = words(re.sub("^(?=[0-9])", "R", text), self._values)
        size = block.words.get("R", 0.0)
        if size <= 0.0 or block.names or block.words.keys() - {"R", "F", "FU"}:
            raise InvalidInput(
                f"{keyword}: expected its size, above 0, and perhaps F with a number"
            )
        if not isinstance(self.to.last, Cut):
            raise InvalidInput(f"{keyword} is read between two straight cuts alone")
        kind = "R" if keyword == "RND" else "C"
        self.to.corner = Corner(kind, size * self.out.scale(), feed=self._feed_of(block))

    def _approach(self, keyword: str, text: str) -> None:
        block = words(re.sub("^[A-Z]+", "", text), self._values)
        self._feed(block)
        self.out.note(_APPROACH, left_out=True)
        self.to.approach(block, away=keyword == "DEP")

    # ------------------------------------------------------------ what holds

    def _begin(self, keyword: str, text: str) -> None:
        if match := re.search(r"\b(MM|INCH)$", text):
            self.out.set_unit("mm" if match[1] == "MM" else "inch", moved=bool(self.out.rows))

    def _tool_call(self, keyword: str, text: str) -> None:
        self.out.pass_over(keyword)
        match = re.match(r'(?:"[^"]*"|[0-9.]*|Q[0-9]+)\s*(?P<axis>[XYZ])?\b(?P<rest>.*)', text)
        if match is None:
            return
        if match["axis"] in ("X", "Y"):
            raise InvalidInput(f"TOOL CALL … {match['axis']}: the tool along another axis than Z is"
                               " not read")  # fmt: skip
        for name, value in re.findall(r"\b([SF])\s*(Q?[0-9]+[.,]?[0-9]*)", match["rest"]):
            if name == "S":
                self.out.feeds.turns_per_minute = number(value, self._values)
            else:
                self._feed(Block({"F": number(value, self._values)}))

    def _cycl_call(self, keyword: str = "", text: str = "") -> None:
        """Call the cycle that was defined."""
        if not _ONLY_SWITCHES.fullmatch(text):
            raise InvalidInput(f"CYCL CALL {shortened(text)} is not read; use M99 or L blocks")
        if self._cycle is None:
            raise InvalidInput("a cycle is called, and none is defined before")
        self.out.note(_BORED)
        self.to.bore(self._cycle.hole(float(self.to.point()[2]), self.out))

    def _cycl_def(self, keyword: str, text: str) -> None:
        """CYCL DEF: a cycle that acts at once, or waits for its call."""
        match = re.match(r"([0-9]+)(?:\.([0-9]))? ?(.*)", text)
        if match is None:
            raise InvalidInput("CYCL DEF: expected the number of a cycle")
        kind = int(match[1])
        self.out.pass_over(f"CYCL DEF {kind}")
        if kind == 247:
            self.out.set_frame("CYCL DEF 247", re.sub(r"\s", "", match[3].split(" Q")[-1]))
        elif kind in IMMEDIATE:
            if match[2] != "0":  # its line .0 is its name
                was, scale = self.to.frame, self.out.scale()
                frame = by_cycle(was, kind, match[3], self._values, scale)
                if frame is not was:
                    self.to.reframe(frame)
        else:
            before = None if match[2] == "0" else self._cycle
            self._cycle = cycle_of(kind, match[3], before, self._values)

    def _plane(self, keyword: str, text: str) -> None:
        self.out.pass_over(keyword)
        frame = by_plane(self.to.frame, text, self._values)
        self.to.leave("XYZ")  # the machine may move to turn to it
        self.to.reframe(frame)
        # The control sets Q120 to Q122 to the rotary axes of the plane, which the plane implies.
        if self.to.frame.plane is not None:
            self.out.note(_PLANE)
        for name in ("Q120", "Q121", "Q122"):
            self._values.set(name, 0.0)

    def _function(self, keyword: str, text: str) -> None:
        """FUNCTION TCPM: the coordinates are those of the tip."""
        if not re.fullmatch(r"(?:RESET TCPM|TCPM\b.*|MODE MILL|PROG PATH.*|DWELL.*)", text):
            raise InvalidInput(f"FUNCTION {shortened(text)} is not read")
        if "AXIS SPAT" in text:
            raise InvalidInput("FUNCTION TCPM … AXIS SPAT: A, B, C as spatial angles are not read; "
                               "have the CAM system write AXIS POS or LN blocks")  # fmt: skip
        self.to.tip = text.startswith("TCPM") or (self.to.tip and text != "RESET TCPM")
        self.out.pass_over(keyword)
