"""Toolpaths from Klartext, the conversational programs of Heidenhain controls."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.heidenhain_blocks import BEGIN, NO_MOTION, Block, Words, blocks, number, words
from qp_twist.paths.heidenhain_cycles import Cycle, cycle_of
from qp_twist.paths.heidenhain_frame import IMMEDIATE, by_cycle, by_plane
from qp_twist.paths.heidenhain_motions import Motions, feed_unit
from qp_twist.paths.machine_tool import Corner, Cut
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import (
    STATED_BY_PROGRAMS,
    ProgramBuilder,
    ProgramWords,
    ToolpathFormat,
    TooManyPoints,
)
from qp_twist.paths.toolpath_options import ReadingOptions

_WORDS = ProgramWords(
    "a Klartext program", "TX, TY, TZ", "FMAX", "MM behind BEGIN PGM",
    tip=("M128", "FUNCTION TCPM", "PLANE SPATIAL"),
    applied="M12[89]|FUNCTION|LBL|PLANE|CYCL DEF (?:7|10)",
)  # fmt: skip
_REFUSED = {
    91: "", 92: "", 114: "a correction for the machine's geometry", 130: "a point out of the plane",
    118: "handwheel motion", 136: "a feed per turn of the spindle",
    144: "a correction for the machine's geometry",
}  # fmt: skip
"""M functions that change the path."""
_SETS = re.compile(
    r"(?:(?P<kind>[0-9]+) ?: ?)?(?:SYSREAD )?(?P<name>Q[LRS]?[0-9]+)(?: ?= ?(?P<value>.*))?"
)
"""A parameter that is set, by FN 0 or another function."""
_PROGRAMS = {
    **dict.fromkeys(("CALL", "CALL PGM"), "calls another program"),
    "TCH PROBE": "is a measurement, after which the coordinates are elsewhere",
}
_JUMP = re.compile(
    r'(?P<kind>9|1[0-2]) ?: ?IF (?P<one>\S+) (?:EQU|NE|GT|LT) (?P<two>\S+) GOTO LBL "?(?P<to>.*?)"?'
)
"""FN 9 to FN 12."""
_CORRECTED = ("RL, RR ({}): a machine shifts the path by the radius of its tool; here the points "
              "are the path of the tool's tip.")  # fmt: skip
_BORED = ("cycles ({}): the tool goes along its axis down to the depth at once and back, without "
          "pecking and dwelling.")  # fmt: skip
_INCH = ("F ({}) of a program in inches is read as tenths of an inch per minute, as Heidenhain's "
         "manuals say.")  # fmt: skip
_PLANE = ("PLANE SPATIAL ({}): the points are turned into the frame of the part, and the tool "
          "stands along the plane's normal.")  # fmt: skip
_AWAY = ("motions to the machine's own positions (M91, M92, M140 in {}) are left out; another "
         "curve begins after each.")  # fmt: skip
_APPROACH = ("APPR and DEP ({}): the ways to the contour and from it are left out; a curve begins "
             "at its first point.")  # fmt: skip
_MOST_REPEATED = 200_000
"""Blocks that a program may run beside those of its file."""


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a Klartext program.

    A straight motion with FMAX begins another curve. A feed holds until the next one. The tool axis
    is (0, 0, 1), or that of TX, TY, TZ, of the tilted plane, or of the rotary axes with M128.

    Raises:
        InvalidInput: If a block is invalid, changes the path in a way that is not read, or a tool
            axis is open.
    """
    program = [*blocks(lines)]
    # Which rotary axes there are is the same question as in G-code, but for M functions.
    moved = [re.sub(r"M ?[0-9]+", "", block.text).replace(",", ".") for block in program
             if block.keyword in ("L", "LN", "LP") and "M91" not in block.text]  # fmt: skip
    reader = _Reader(ProgramBuilder(options, _WORDS), Facts.of(moved))
    reader.read(program)
    return reader.to.toolpath(path)


def _is_klartext(suffix: str, lines: Sequence[str]) -> bool:
    return any(BEGIN.match(line) for line in lines[:50])


HEIDENHAIN = ToolpathFormat(_is_klartext, _read, STATED_BY_PROGRAMS)
"""Klartext."""


class _Reader:
    """Runs the blocks of a program.

    Attributes:
        out: The points so far.
        to: The machine and its tool.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self.out, self.to = out, Motions(out, facts)
        self._parameters: dict[str, float] = {}
        self._cycle: Cycle | None = None
        to = self.to
        self._acts: dict[str, Callable[[Words], None]] = {
            "L": to.move, "LN": to.move_by_normal, "LP": to.polar_move, "CC": to.pole,
            "C": to.arc_about_pole, "CP": to.polar_arc, "CR": to.arc_by_radius,
            "CT": to.tangent_arc, "": lambda of: None,
        }  # fmt: skip
        self._others: dict[str, Callable[[Block], None]] = {
            "BEGIN PGM": self._begin, "RND": self._corner, "CHF": self._corner,
            "APPR": self._approach, "DEP": self._approach, "TOOL CALL": self._tool_call,
            "CYCL DEF": self._cycl_def, "CYCL CALL": self._cycl_call, "PLANE": self._plane,
            "FUNCTION": self._function, "FN": self._assign, "Q": self._assign,
        }  # fmt: skip

    # ------------------------------------------------------------ the program

    def read(self, program: Sequence[Block]) -> None:
        """Run the program from its first block to its end, with its subprograms and repetitions."""
        labels = {
            block.text.strip('" '): k for k, block in reversed([*enumerate(program)])
            if block.keyword == "LBL"
        }  # fmt: skip
        calls: list[int] = []
        left: dict[int, int] = {}
        at = done = 0
        try:
            while at < len(program):
                block, at, done = program[at], at + 1, done + 1
                with self.out.at(block.line):
                    if done > len(program) + _MOST_REPEATED:
                        raise TooManyPoints(
                            f"subprograms and repetitions run more than {_MOST_REPEATED} blocks"
                        )
                    if block.keyword == "CALL LBL":
                        at = self._call(block, at, labels, calls, left)
                    elif block.keyword == "FN" and (jump := _JUMP.fullmatch(block.text)):
                        at = self._jump(jump, at, labels)
                    elif block.keyword == "LBL" and block.text == "0" and calls:
                        at = calls.pop()
                    elif block.keyword == "END PGM" or self._block(block):
                        break
        except TooManyPoints:
            pass  # which is one of the problems
        self.out.problems.refuse()

    def _call(
        self, block: Block, at: int, labels: dict[str, int], calls: list[int], left: dict[int, int]
    ) -> int:
        """Where the program goes on after CALL LBL."""
        match = re.fullmatch(r'"?([^"]*?)"?(?: ?REP ?([0-9]+)(?:/[0-9]+)?)?', block.text)
        if match is None or match[1].strip() not in labels:
            raise InvalidInput(f"CALL LBL {shortened(block.text)}: there is no such LBL")
        target = labels[match[1].strip()]
        if match[2] is None:
            if len(calls) >= 20:
                raise TooManyPoints("subprograms call each other more than 20 deep")
            calls.append(at)
            return target + 1
        left[at] = left.get(at, int(match[2])) - 1
        if left[at] >= 0 and not self.out.problems:  # which would be found again each time
            return target + 1
        del left[at]
        return at

    def _jump(self, jump: re.Match[str], at: int, labels: dict[str, int]) -> int:
        """Where the program goes on after a jump on a condition of two known values."""
        one, two = (number(jump[name], self._parameters) for name in ("one", "two"))
        if jump["to"] not in labels:
            raise InvalidInput(f"LBL {shortened(jump['to'])} is not there")
        holds = {"9": one == two, "10": one != two, "11": one > two, "12": one < two}
        jumps = holds[jump["kind"]] and not self.out.problems
        return labels[jump["to"]] + 1 if jumps else at

    # ------------------------------------------------------------ a block

    def _block(self, block: Block) -> bool:
        """Process a block; whether it ends the program."""
        act = self._acts.get(block.keyword)
        if block.skipped:
            if act is not None and not re.fullmatch(r"(?:M ?[0-9]+ ?)*", block.text):
                raise InvalidInput(
                    "a block behind / is run or not by a switch of the machine; take the / or the "
                    "block out"
                )
            self.out.pass_over("/")
        elif act is not None:
            return self._move(act, words(block.text, self._parameters))
        elif block.keyword in self._others:
            self._others[block.keyword](block)
        elif block.keyword in NO_MOTION:
            self.out.pass_over(block.keyword)
        else:
            what = _PROGRAMS.get(block.keyword, "is not read: it may move the tool, or change where"
                                 " it moves")  # fmt: skip
            raise InvalidInput(
                f"{shortened(f'{block.keyword} {block.text}')!r} {what}; have the CAM system write "
                "one program of L, C, CP and LN blocks"
            )
        return False

    def _begin(self, block: Block) -> None:
        if match := re.search(r"\b(MM|INCH)$", block.text):
            self.out.set_unit("mm" if match[1] == "MM" else "inch", moved=bool(self.out.rows))

    def _corner(self, block: Block) -> None:
        """RND, CHF: the corner between the cut before and the one behind."""
        size = words(re.sub("^(?=[0-9])", "R", block.text), self._parameters).values.get("R", 0.0)
        if size <= 0.0:
            raise InvalidInput(f"{block.keyword}: expected its size, above 0")
        kind = "R" if block.keyword == "RND" else "C"
        if not isinstance(self.to.last, Cut):
            raise InvalidInput(f"{block.keyword} is read between two straight cuts alone")
        self.to.corner = Corner(kind, size * self.out.scale(), block.keyword)

    def _approach(self, block: Block) -> None:
        of = words(re.sub("^[A-Z]+", "", block.text), self._parameters)
        self._feed(of)
        self.out.note(_APPROACH, left_out=True)
        self.to.approach(of, away=block.keyword == "DEP")

    def _move(self, act: Callable[[Words], None], of: Words) -> bool:
        """Process a block of words; whether it ends the program."""
        to = self.to
        for switch in of.switches:
            if _REFUSED.get(switch):
                raise InvalidInput(f"M{switch} is {_REFUSED[switch]}, which is not read")
            to.tip = (to.tip or switch == 128) and switch != 129
            self.out.pass_over(f"M{switch}")
        if of.corrected:
            self.out.note(_CORRECTED)
        self._feed(of)
        if {91, 92, 140} & set(of.switches):
            named = [axis for axis in ("Z" if 140 in of.switches else "XYZ")
                     if 140 in of.switches or axis in of.values]  # fmt: skip
            to.leave(named if named and to.frame.plane is None else "XYZ")
            self.out.note(_AWAY, left_out=True)
        else:
            act(of)
        modal = self._cycle is not None and self._cycle.modal and act == to.move
        if 99 in of.switches or modal:
            self._bore()
        if self._cycle is not None:
            self._cycle.modal = (self._cycle.modal or 89 in of.switches) and 99 not in of.switches
        return bool({2, 30} & set(of.switches))

    def _bore(self) -> None:
        """Call the cycle that was defined."""
        if self._cycle is None:
            raise InvalidInput("a cycle is called, and none is defined before")
        self.out.note(_BORED)
        self.to.bore(self._cycle.hole(float(self.to.point()[2]), self.out))

    def _feed(self, of: Words) -> None:
        if {"FZ", "FT"} & of.values.keys():
            raise InvalidInput("FZ and FT are feeds per tooth and in a time, which are not read")
        if "FU" in of.values:
            self.out.feeds.state("FU", of.values["FU"], self.out.scale(), per_turn=True)
        if "F" in of.values:
            self.out.feeds.state("F", of.values["F"], feed_unit(self.out))
            if self.out.length_unit == "inch":
                self.out.note(_INCH)

    def _tool_call(self, block: Block) -> None:
        text = block.text
        self.out.pass_over("TOOL CALL")
        match = re.match(r'(?:"[^"]*"|[0-9.]*|Q[0-9]+)\s*(?P<axis>[XYZ])?\b(?P<rest>.*)', text)
        if match is None:
            return
        if match["axis"] in ("X", "Y"):
            raise InvalidInput(f"TOOL CALL … {match['axis']}: the tool along another axis than Z is"
                               " not read")  # fmt: skip
        for name, value in re.findall(r"\b([SF])\s*(Q?[0-9]+[.,]?[0-9]*)", match["rest"]):
            if name == "S":
                self.out.feeds.turns_per_minute = number(value, self._parameters)
            else:
                self._feed(Words({"F": number(value, self._parameters)}))

    def _cycl_call(self, block: Block) -> None:
        if not re.fullmatch(r"(?:M ?[0-9]+ ?)*", block.text):
            raise InvalidInput(
                f"CYCL CALL {shortened(block.text)} is not read; use M99 or L blocks"
            )
        self._bore()

    def _cycl_def(self, block: Block) -> None:
        """CYCL DEF: a cycle that acts at once, or waits for its call."""
        match = re.match(r"([0-9]+)(?:\.([0-9]))? ?(.*)", block.text)
        if match is None:
            raise InvalidInput("CYCL DEF: expected the number of a cycle")
        kind = int(match[1])
        self.out.pass_over(f"CYCL DEF {kind}")
        if kind == 247:
            self.out.set_frame("CYCL DEF 247", re.sub(r"\s", "", match[3].split(" Q")[-1]))
        elif kind in IMMEDIATE:
            if match[2] != "0":  # its line .0 is its name
                was, scale = self.to.frame, self.out.scale()
                frame = by_cycle(was, kind, match[3], self._parameters, scale)
                if frame is not was:
                    self.to.reframe(frame)
        else:
            before = None if match[2] == "0" else self._cycle
            self._cycle = cycle_of(kind, match[3], before, self._parameters)

    def _plane(self, block: Block) -> None:
        self.out.pass_over("PLANE")
        # The control sets Q120 to Q122 to the rotary axes of the plane, which the plane implies.
        for name in ("Q120", "Q121", "Q122"):
            self._parameters.pop(name, None)
        frame = by_plane(self.to.frame, block.text, self._parameters)
        self.to.leave("XYZ")  # the machine may move to turn to it
        self.to.reframe(frame)
        if self.to.frame.plane is not None:
            self.out.note(_PLANE)
            self._parameters |= dict.fromkeys(("Q120", "Q121", "Q122"), 0.0)

    def _function(self, block: Block) -> None:
        """FUNCTION TCPM: the coordinates are those of the tip."""
        text = block.text
        if not re.fullmatch(r"(?:RESET TCPM|TCPM\b.*|MODE MILL|PROG PATH.*|DWELL.*)", text):
            raise InvalidInput(f"FUNCTION {shortened(text)} is not read")
        if "AXIS SPAT" in text:
            raise InvalidInput("FUNCTION TCPM … AXIS SPAT: A, B, C as spatial angles are not read; "
                               "have the CAM system write AXIS POS or LN blocks")  # fmt: skip
        self.to.tip = text.startswith("TCPM") or (self.to.tip and text != "RESET TCPM")
        self.out.pass_over("FUNCTION")

    def _assign(self, block: Block) -> None:
        """A constant for a parameter; all others that are set have no known value."""
        text = f"Q{block.text}" if block.keyword == "Q" else block.text
        if re.match(r"(?:9|1[0-2])\b", text):
            raise InvalidInput(f"FN {shortened(text)}: expected IF … GOTO LBL …")
        match = _SETS.match(text)
        if match is None:
            raise InvalidInput(f"{shortened(text)!r} is no parameter that is set")
        self._parameters.pop(match["name"], None)
        if match["kind"] in (None, "0") and re.fullmatch(r"[-+]? ?[Q0-9.,]+", match["value"]):
            with contextlib.suppress(InvalidInput):  # matters only where the parameter is used
                self._parameters[match["name"]] = number(match["value"], self._parameters)
        self.out.pass_over(block.keyword)
