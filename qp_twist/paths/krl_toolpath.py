"""Toolpaths from KRL, of KUKA: the moves of a program, with the points of its data file.

Source: public programs, and the words of the syntax file of KnoP-01/krl-for-vim. Angles A, B, C are
about z, y', x'' (KUKA, *KSS Operating and programming instructions*, Coordinate systems).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import mink

from qp_twist.errors import InvalidInput
from qp_twist.files import read_bytes, text_lines
from qp_twist.paths.robot_path import RobotPath
from qp_twist.paths.robot_program import RobotProgram, Rule, robot_format
from qp_twist.paths.robot_values import IN_DEGREES, Unknown, Values, pose_of, zyx_quaternion
from qp_twist.paths.toolpath_builder import ProgramWords, ToolpathFormat
from qp_twist.programs.krl import ASSIGNMENT, BEGIN, DECLARED, NOTED
from qp_twist.programs.reading import NUMBER, refuse, split, without_texts

_WORDS = ProgramWords(
    "a KRL program", "the tool's frame, A, B, C (KUKA's own tools often work along its x)", "PTP",
    "mm", "quaternion",
)  # fmt: skip
_BEGINS = r"&ACCESS\b|&REL\b|DEFDAT\s+\w+|(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+\w+\s*\("
"""Lines with which a program begins."""
_AXES = "xyzabc"
_FIELD = rf"(\w+)\s+({NUMBER})"
_RECORD = re.compile(
    rf"\{{(?:\s*\w+\s*:)?\s*({_FIELD}(?:\s*,\s*{_FIELD})*)\s*\}}", re.ASCII | re.IGNORECASE
)


class _Frame(dict[str, Any]):
    """Components of a frame, position or axes; ``@`` is KRL's geometric operator."""

    def __matmul__(self, other: _Frame) -> _Frame:
        pose = _pose(self) @ _pose(other)
        yaw, pitch, roll = (math.degrees(a) for a in reversed(pose.rotation().as_rpy_radians()))
        values = [*(1e3 * pose.translation()), yaw, pitch, roll]
        return _Frame(zip(_AXES, map(float, values), strict=True))


def _pose(frame: _Frame) -> mink.SE3:
    x, y, z, a, b, c = (frame[key] for key in _AXES)
    return pose_of((x, y, z), zyx_quaternion(a, b, c))


def _literal(text: str) -> _Frame | None:
    match = _RECORD.fullmatch(text)
    return _Frame((k.lower(), float(v)) for k, v in re.findall(_FIELD, match[1])) if match else None


def _key(name: str) -> str:
    return name.lower().replace("$", "_")


def _translate(text: str) -> str:
    def record(match: re.Match[str]) -> str:
        parts = [part.split(None, 1) for part in split(match[1]) if part]
        return f"_f({', '.join(f'{part[0]}={part[1]}' for part in parts)})"

    text = re.sub(r"\[\s*\]", "", text)
    text = re.sub(r"#(\w+)", r'"\1"', text)
    text = re.sub(r"\{(?:\s*\w+\s*:)?([^{}]*)\}", record, text).replace(":", "@")
    text = re.sub(r"\[([^\[\]]*)\]", lambda m: "".join(f"[({i})-1]" for i in split(m[1])), text)
    return re.sub(r"(?<=[\w\])])\.\s*([a-z]\w*)", r'["\1"]', text)


class KrlProgram(RobotProgram):
    """The programs of a file.

    Attributes:
        bases: Frames of ``BASE_DATA`` that the file assigns, by number.
    """

    opens = (
        (r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+(?:\[\d*\])?)?\s+(?P<name>\w+)\s*\((?P<arguments>.*)\)",
         "END|ENDFCT", "procedure"),
        (r"DEFDAT\b.*", "ENDDAT", "once"), (r"LOOP", "ENDLOOP", "for ever"),
        (r"WHILE\s+\(?\s*TRUE\s*\)?", "ENDWHILE", "for ever"),
        (r"FOR\s+(?P<name>\w+)\s*=(?P<first>.*)\bTO\b(?P<last>.*?)(?:\bSTEP\b(?P<step>.*))?",
         "ENDFOR", "for"),
        (r"IF\b.*\bTHEN", "ENDIF", "open"), (r"WHILE\b.*", "ENDWHILE", "open"),
        (r"REPEAT", r"UNTIL\b.*", "open"), (r"SWITCH\b.*", "ENDSWITCH", "open"),
        (r"(?:PTP_)?SPLINE\b.*", "ENDSPLINE", "open"),
    )  # fmt: skip
    coordinates = r"\{|#BASE"

    def __init__(self, path: RobotPath) -> None:
        functions: dict[str, Callable[..., Any]] = {**IN_DEGREES, "_f": _Frame}
        super().__init__(Values(_key, _translate, functions, _literal), path)
        nothing = _Frame(dict.fromkeys(_AXES, 0.0))
        self.values.names |= {
            "_nullframe": nothing,
            "_world": nothing,
            "true": True,
            "false": False,
        }
        self.bases: dict[int, tuple[str, mink.SE3 | None]] = {}
        self._at: _Frame | None = None

    def grammar(self) -> Sequence[Rule]:
        """Moves, frames, speeds, data, words that move nothing, calls."""
        number = rf"\s*[,=]\s*(?P<number>{NUMBER})\s*\)?"
        return (
            (r"S?PTP\s+\$(?:POS|AXIS)_ACT\w*.*", self.skip, "nothing"),  # it stays where it is
            (r"(?P<word>S?(?:LIN|CIRC|PTP)(?:_REL)?)\b\s*(?P<targets>.*?)"
             r"(?P<rest>(?:\s*\bC_\w+|\s+#(?:BASE|TOOL)|\s+WITH\s.*)*)", self._move, "moves"),
            (r"(?:GOTO|RESUME|SPL|RSI_(?:MOVECORR|ON)|TOUCH\w*)\b.*", self.refuse, "moves"),
            (r"RETURN\b.*|EXIT", self.leave, "moves"),
            (r"\$BASE\s*[.\[].*|\$IPO_MODE\s*=\s*#TCP\b.*", self.refuse, "moves"),
            (rf"(?:BAS\s*\(\s*#(?:VEL_CP|CP_PARAMS)|\$VEL\.CP){number}", self._speed, "nothing"),
            (r"BAS\s*\(\s*#BASE\s*,(?P<number>.*)\)", self._base_number, "moves"),
            (r"(?P<name>\$BASE)(?P<part>)\s*=(?P<value>.*)", self._base, "moves"),
            (r"(?P<name>BASE_DATA)\s*\[(?P<part>.*?)\](?P<field>.*?)=(?P<value>.*)",
             self._base_data, "moves"),
            (r"(?P<name>FDAT_ACT)(?P<part>)\s*=(?P<value>.*)", self._inline_frame, "moves"),
            *((pattern, self.skip, "nothing")
              for patterns in NOTED.values() for pattern in patterns),
            *((pattern, self.assign, "assigns") for pattern in DECLARED),
            (ASSIGNMENT, self.assign, "assigns"),
            (r"\$\w+(?:\[[^\]]*\])?(?:\.\w+)?\s*=(?!=)[^{]*", self.skip, "nothing"),
            (rf"{BEGIN}|(?:&|ELSE|CASE|DEFAULT|CONTINUE|GLOBAL|INTERRUPT|DECL|STRUC|ENUM|BRAKE|EXT|ANOUT"
             r"|ON_ERROR_PROCEED"
             r"|SIGNAL|PUBLIC).*|\w+\s*:", self.skip, "nothing"),
            (r"(?P<called>\w+)\s*(?:\((?P<arguments>.*)\))?", self.call, "unknown"),
            (r".*", self.refuse, "moves"),
        )  # fmt: skip

    def parameter(self, words: Sequence[str]) -> str:
        """A parameter stands before its kind, ``:IN`` or ``:OUT``."""
        return words[0]

    def _speed(self, line: int, match: re.Match[str]) -> None:
        self.path.feed = float(match["number"])

    def _base_number(self, line: int, match: re.Match[str]) -> None:
        self.path.frame = self._numbered(match["number"])

    def _numbered(self, text: str) -> tuple[str, mink.SE3 | None]:
        """The base whose number an expression states."""
        try:
            number = int(self.values.value(text))
        except (Unknown, TypeError):
            return f"base {text.strip()}", None
        return self.bases.get(number, (f"base {number}", None))

    def _base(self, line: int, match: re.Match[str]) -> None:
        text = match["value"].strip()
        number = re.fullmatch(r"BASE_DATA\s*\[(.*)\]", text, re.IGNORECASE)
        self.path.frame = (
            self._numbered(number[1]) if number else self._frame(text, f"$BASE = {text}")
        )

    def _base_data(self, line: int, match: re.Match[str]) -> None:
        number = int(self.values.value(match["part"]))
        name = f"base {number} of line {line}"
        known = not match["field"].strip()
        self.bases[number] = self._frame(match["value"], name) if known else (name, None)

    def _frame(self, text: str, name: str) -> tuple[str, mink.SE3 | None]:
        try:
            return name, _pose(self.values.value(text))
        except (Unknown, KeyError, TypeError, ValueError):
            return name, None

    def _inline_frame(self, line: int, match: re.Match[str]) -> None:
        """The base of the move that follows, by which inline forms state it."""
        with suppress(Unknown, KeyError, TypeError):  # of a point that is in no file
            self.path.frame = self._numbered(str(self.values.value(match["value"])["base_no"]))

    def _move(self, line: int, match: re.Match[str]) -> None:
        word, rest = match["word"].upper().lstrip("S"), match["rest"] or ""
        *parts, last = split(match["targets"])
        sweep = re.fullmatch(rf"CA\s*(?P<number>{NUMBER})", last, re.IGNORECASE)
        if not sweep:
            parts.append(last)
        if re.search(r"\$(?:BASE|VEL)\s*=\s*\{|\$IPO_MODE", rest, re.IGNORECASE):
            raise refuse(line, match[0], "states a frame or a speed for this move in a way that is "
                         "not read; write it before the move.")  # fmt: skip
        before = self.path.frame, self.path.feed
        if found := re.search(rf"\$VEL(?:\.CP)?\s*=\s*(?:SVEL_CP\s*\()?\s*({NUMBER})", rest, re.I):
            self.path.feed = float(found[1])
        if found := re.search(r"\$BASE\s*=\s*(?:SBASE\s*\(\s*)?([\w.]+)", rest, re.IGNORECASE):
            self.path.frame = self._numbered(found[1])
        count = 2 if word.startswith("CIRC") else 1
        if word.endswith("_REL") and "#TOOL" in rest.upper():
            raise refuse(line, match[0], "is relative to the tool, which is not read; write a "
                         "position.")  # fmt: skip
        if len(parts) != count:
            raise refuse(line, match[0], f"expected {count} target{'s' * (count - 1)}.")
        if word.startswith("PTP"):
            self._joint(line, parts[0], relative=word.endswith("_REL"))
            return
        poses = [self._target(part, relative=word.endswith("_REL")) for part in parts]
        if word.startswith("LIN"):
            self.path.line(line, poses[0])
        else:
            self.path.arc(line, poses[0], poses[1], float(sweep["number"]) if sweep else None)
            self._at = None if sweep else self._at
        self.path.frame, self.path.feed = before  # WITH is for this move alone

    def _joint(self, line: int, text: str, *, relative: bool) -> None:
        try:
            pose = None if relative else self._target(text)
        except Unknown:
            pose = self._at = None
        self.path.joint(line, pose)

    def _target(self, text: str, *, relative: bool = False) -> mink.SE3:
        """A target; what it leaves out stays as it was."""
        found = self.values.value(text)
        if not isinstance(found, _Frame) or not set(_AXES) & set(found):
            raise Unknown(f"expected a position, {{X …,Y …,Z …,A …,B …,C …}}, got {text}")
        if not set(_AXES) <= set(found) and self._at is None:
            raise Unknown(f"{text} leaves out some of X, Y, Z, A, B, C; nothing before has them")
        at = self._at or _Frame()
        if relative and any(found.get(key) for key in "abc"):
            raise InvalidInput(f"{text}: a relative turn is not read; write a position")
        moved = {key: found.get(key, at.get(key)) for key in _AXES}
        if relative:
            moved = {key: at[key] + found.get(key, 0.0) for key in _AXES}
        self._at = _Frame(moved)
        return _pose(self._at)


def _execute(file: Path, lines: Sequence[str], path: RobotPath) -> RobotProgram:
    """Execute a program, after the data file beside it."""
    program = KrlProgram(path)
    beside = next((f for f in file.parent.glob("*") if f.name.lower() == f"{file.stem}.dat".lower()
                   and f != file), None)  # fmt: skip
    data = [] if beside is None else text_lines(read_bytes(beside, "data file"))
    for number, text in enumerate(data, start=1):
        code = text.partition(";")[0].strip()
        for pattern in DECLARED:
            if (match := re.fullmatch(pattern, code, program.flags)) and match["value"]:
                program.values.assign(number, match["name"], match["value"])
    found = ((k, without_texts(k, line, '"', ";")[0]) for k, line in enumerate(lines, start=1))
    program.execute([(k, code) for k, code in found if code])
    return program


KRL: ToolpathFormat = robot_format(_BEGINS, _WORDS, _execute)
"""KRL."""
