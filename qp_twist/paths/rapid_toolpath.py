r"""Toolpaths from RAPID, of ABB: the moves of a module.

Source: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917): MoveL, MoveC, MoveJ, robtarget, wobjdata, speeddata, Offs, RelTool.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mink

from qp_twist.paths.robot_path import RobotPath
from qp_twist.paths.robot_program import RobotProgram, Rule, robot_format
from qp_twist.paths.robot_values import (
    IN_DEGREES,
    Unknown,
    Values,
    list_literal,
    pose_of,
    zyx_quaternion,
)
from qp_twist.paths.toolpath_builder import ProgramWords, ToolpathFormat
from qp_twist.programs.rapid import ASSIGNMENT, BEGINNING, DATA, heading
from qp_twist.programs.reading import Statements, refuse, split, without_texts

_WORDS = ProgramWords(
    "a RAPID program", "the tool's frame, as robtargets state it", "MoveJ", "mm", "quaternion"
)
_BEGINS = (
    r"%%%|(?:MODULE|RECORD)\s+\w+|(?:LOCAL\s+|TASK\s+)*(?:(?:CONST|PERS|VAR)\s+\w+\s+\w+"
    r"|PROC\s+\w+\s*\()"
)
"""Lines with which a module begins."""
_MOVES = (
    r"(?:Move|Trigg|Arc|Disp|Paint)(?P<kind>L|C|J|AbsJ)(?:Start|End|\d|DO|AO|GO|Sync|IOs)?\b"
    r"(?P<arguments>.*)"
)
_OPEN = r"(?:IF\b[^;]*?\bTHEN|WHILE\b[^;]*?\bDO|TEST\b[^;:]*?(?=\bCASE\b|$))"
_END = r"END(?:IF|FOR|WHILE|TEST|PROC|FUNC|TRAP|MODULE|RECORD)"
_PROCEDURE = r"(?:LOCAL\s+)?(?:PROC|FUNC\s+\w+)\s+(?P<name>\w+)\s*\((?P<arguments>[^()]*)\)"
_HEAD = re.compile(
    rf"{_PROCEDURE}|(?:LOCAL\s+)?TRAP\s+\w+|RECORD\s+\w+|MODULE\s+\w+(?:\s*\([^)]*\))?|\b{_OPEN}"
    rf"|\bELSEIF\b[^;]*?\bTHEN\b|\bELSE\b|\bFOR\b[^;]*?\bDO\b|\bCASE\b[^:]*:(?!=)"
    rf"|\bDEFAULT\s*:(?!=)|\b{_END}\b|^\s*(?:ERROR|UNDO|BACKWARD)\s*$",
    re.IGNORECASE | re.ASCII,
)
"""What no semicolon ends."""
_FIELDS = {
    **dict.fromkeys(("trans", "x", "q1", "v_tcp"), 0), **dict.fromkeys(("rot", "y", "q2"), 1),
    "z": 2, "q3": 2, "robconf": 2, "q4": 3, "extax": 3, "uframe": 3, "oframe": 4,
}  # fmt: skip
"""Places of the components of data."""


def _translate(text: str) -> str:
    text = re.sub(r"\\(\w+)\s*:=", r",\1=", text)
    text = re.sub(r"(?<=[\w\]}])\.\s*([a-z]\w*)", lambda m: f"[{_FIELDS[m[1]]}]", text)
    text = re.sub(r"\{([^{}]*)\}", lambda m: "".join(f"[({i})-1]" for i in split(m[1])), text)
    return text.replace(" mod ", " % ").replace(" div ", " // ")


def _offs(target: list[Any], x: float, y: float, z: float) -> list[Any]:
    return [[a + b for a, b in zip(target[0], (x, y, z), strict=True)], *target[1:]]


def _rel_tool(
    target: list[Any], x: float, y: float, z: float, rx: float = 0, ry: float = 0, rz: float = 0
) -> list[Any]:
    w, *v = zyx_quaternion(-rz, -ry, -rx)  # of the inverse of R_x R_y R_z
    moved = pose_of(target[0], target[1]) @ pose_of((x, y, z), (w, *(-a for a in v)))
    return [(1e3 * moved.translation()).tolist(), moved.rotation().wxyz.tolist(), *target[2:]]


class RapidModule(RobotProgram):
    """A module."""

    opens = (
        (r"MODULE\b.*", "ENDMODULE", "once"), (r"RECORD\b.*", "ENDRECORD", "never"),
        (r"(?:LOCAL\s+)?TRAP\b.*", "ENDTRAP", "never"),
        (_PROCEDURE, "END(?:PROC|FUNC)", "procedure"),
        (r"WHILE\s+\(?\s*TRUE\s*\)?\s*DO", "ENDWHILE", "for ever"),
        (r"FOR\s+(?P<name>\w+)\s+FROM\b(?P<first>.*)\bTO\b(?P<last>.*?)(?:\bSTEP\b(?P<step>.*))?"
         r"\bDO", "ENDFOR", "for"),
        (r"IF\b.*\bTHEN", "ENDIF", "open"), (r"WHILE\b.*\bDO", "ENDWHILE", "open"),
        (r"TEST\b.*", "ENDTEST", "open"),
    )  # fmt: skip

    def __init__(self, path: RobotPath) -> None:
        functions: dict[str, Callable[..., Any]] = {
            "offs": _offs,
            "reltool": _rel_tool,
            "orientzyx": zyx_quaternion,
            **IN_DEGREES,
        }
        super().__init__(Values(str.lower, _translate, functions, list_literal), path)
        self.values.names |= {"true": True, "false": False}

    def grammar(self) -> Sequence[Rule]:
        """Moves, data, words that move nothing, calls."""
        return (
            (_MOVES, self._move, "moves"),
            (r"(?:Search[LC]|FC\w+|Contact\w*|EGM\w*|Corr\w*|TrackMove\w*|PDisp(?:On|Set)|EOffs(?:On"
             r"|Set)|GOTO|CallByVar|PathRecMove\w*|StepBwdPath|MoveExtJ|%|Load\s)\b.*",
             self.refuse, "moves"),
            (rf"IF\b.*(?:\b{_MOVES}|:=|\bGOTO|\bRETURN|\bEXIT).*", self.refuse, "moves"),
            (r"RETURN\b.*|EXIT|BREAK", self.leave, "moves"),
            (r"ERROR|UNDO|BACKWARD", self.leave, "nothing"),
            (DATA, self._data, "assigns"),
            (ASSIGNMENT, self.assign, "assigns"),
            (r"(?:ELSE|ELSEIF|CASE|DEFAULT)\b.*", self.skip, "nothing"),
            *((pattern, self.skip, "nothing") for pattern in BEGINNING.values()),
            (r"(?:SyncMove\w*|WaitSyncTask|Trigg[A-Z]\w*|CirPathMode|WZ\w+)\b.*", self.skip,
             "nothing"),
            (r"IF\b.*?(?P<called>\w+)", self._conditional, "unknown"),
            (r"(?P<called>\w+)\s*(?P<arguments>(?<=\s)[^\s].*)?", self.call, "unknown"),
            (r".*", self.refuse, "moves"),
        )  # fmt: skip

    def _data(self, line: int, match: re.Match[str]) -> None:
        self.assign(line, match)
        if match["kind"].lower() == "num" and not match["value"]:
            self.values.names[match["name"].lower()] = 0.0

    def _conditional(self, line: int, match: re.Match[str]) -> None:
        """A statement behind ``IF`` without ``THEN``."""
        if self._moving([(line, match[0])]):
            self.refuse(line, match)
        self.skip(line, match)

    def _move(self, line: int, match: re.Match[str]) -> None:
        kind, path = match["kind"].upper(), self.path
        arguments = [re.split(r"\\(?![^(]*\))", part) for part in split(match["arguments"])]
        if not arguments[0][0].strip():  # \Conc
            del arguments[0]
        count = 2 if kind == "C" else 1
        if len(arguments) < count + 2:
            raise refuse(line, match[0], "expected a target, a speed, a zone and a tool.")
        options = {
            key.strip().lower(): value.strip()
            for _, *given in arguments
            for key, _, value in (option.partition(":=") for option in given)
        }
        path.frame = self._frame(options.get("wobj", "wobj0"))
        try:
            places = [] if kind == "ABSJ" else arguments[:count]
            poses = [self._pose(line, place) for place, *_ in places]
        except Unknown:
            if kind != "J":
                raise
            poses = []
        self.passed.append((line, arguments[count + 1][0].strip()))  # the zone
        path.feed = self._feed(arguments[count][0].strip(), options)
        if kind in ("J", "ABSJ"):
            path.joint(line, poses[0] if poses else None)
        elif kind == "L":
            path.line(line, poses[0])
        else:
            path.arc(line, poses[0], poses[1])

    def _pose(self, line: int, text: str) -> mink.SE3:
        target = self.values.value(text)
        if not isinstance(target, list) or len(target) != 4:
            raise Unknown(f"expected a robtarget, [[x,y,z],[q1,q2,q3,q4],[…],[…]], got {text}")
        if any(value < 8e9 for value in target[3]):
            self.passed.append((line, "external axes"))
        return pose_of(target[0], target[1])

    def _feed(self, speed: str, options: dict[str, str]) -> float:
        """m/s: of the option V, of speed data, or of its predefined name (v100, mm/s)."""
        try:
            if "t" in options:  # a time, so that the length would have to be known
                return math.nan
            name = re.fullmatch(r"v(\d+)", speed, re.IGNORECASE | re.ASCII)
            found = self.values.value(options["v"]) if "v" in options else None
            found = found or (float(name[1]) if name else self.values.value(speed)[0])
            return 1e-3 * float(found)
        except (Unknown, TypeError):
            return math.nan

    def _frame(self, name: str) -> tuple[str, mink.SE3 | None]:
        """A work object; its pose if the file states it, and no axis moves it."""
        if name.lower() == "wobj0":
            return "wobj0", mink.SE3.identity()
        try:
            held, fixed, unit, user, own = self.values.value(name)
            known = not held and fixed and not unit
            return name, pose_of(*user) @ pose_of(*own) if known else None
        except (Unknown, TypeError, ValueError):
            return name, None


def _execute(file: Path, lines: Sequence[str], path: RobotPath) -> RobotProgram:
    """Execute a module."""
    del file
    found: Statements = []
    rest, begun = "", 0
    for k in range(heading(lines), len(lines)):
        code = without_texts(k + 1, lines[k], '"', "!")[0]
        begun = begun if rest.strip() else k + 1
        if code[:4].lower() != "move":  # most lines
            code = _HEAD.sub(lambda m: f";{m[0]};", code)
        *whole, rest = f"{rest} {code}".split(";")
        for part in filter(None, map(str.strip, whole)):
            found.append((begun, part))
            begun = k + 1
    if rest.strip():
        raise refuse(begun, rest, "expected a semicolon at its end.")
    program = RapidModule(path)
    program.execute(found)
    return program


RAPID: ToolpathFormat = robot_format(_BEGINS, _WORDS, _execute)
"""RAPID."""
