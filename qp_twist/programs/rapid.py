r"""RAPID, of ABB.

Absolute joint moves, each with its time (``\T``). External axes are not moved (``9E9``).

Source: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917), MoveAbsJ, jointtarget, zonedata.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from qp_twist.errors import InvalidInput
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Act,
    Procedure,
    Program,
    Statements,
    check_identifier,
    number_of,
    refuse,
    six,
    split,
    without_texts,
)

_NONE = "9E9"
_TOOL = "tool0"
_LONGEST = 32
"""Characters of an identifier; ABB, *RAPID overview*, Basic elements."""
_PREFIX = "run_"


def _check_name(name: str) -> None:
    check_identifier(
        name, "RAPID", _LONGEST - len(_PREFIX), f"the module's; its procedure is {_PREFIX}NAME"
    )


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    external = ",".join([_NONE] * 6)

    def target(point: list[float]) -> str:
        values = ",".join(f"{value:.{RAPID.decimals}f}" for value in point)
        return f"    MoveAbsJ [[{values}],[{external}]]\\NoEOffs,"

    first, *others = (target(point) for point in moves.angles.tolist())
    lines = [f"MODULE {name}", *(f"  ! {line}" for line in header), f"  PROC {_PREFIX}{name}()"]
    lines.append(f"{first}v50,fine,tool0;")
    times = [f"{seconds:.{RAPID.time_decimals}f}" for seconds in moves.durations.tolist()]
    for number, (to, seconds) in enumerate(zip(others, times, strict=True), start=1):
        zone = "fine" if number == len(others) else "z0"
        lines.append(f"{to}v1000\\T:={seconds},{zone},tool0;")
    lines += ["  ENDPROC", "ENDMODULE", ""]
    return {f"{name}{RAPID.suffix}": "\n".join(lines)}


_NAME = r"[A-Za-z]\w*"
_TARGET = re.compile(r"\[\s*\[([^\[\]]*)\]\s*,\s*(?:\[([^\[\]]*)\]|(\w+))\s*\]", re.ASCII)
DATA = (
    rf"(?:(?:LOCAL|TASK)\s+)*(?:CONST|PERS|VAR)\s+(?P<kind>{_NAME})\s+(?P<name>{_NAME})"
    r"(?P<part>(?:\s*\{[\d\s,]*\})?)\s*(?::=(?P<value>.*))?"
)
ASSIGNMENT = rf"(?P<name>{_NAME})(?P<part>(?:\s*\.\s*\w+|\s*\{{[^{{}}]*\}})*)\s*:=(?P<value>.*)"
_BLOCK = re.compile(
    rf"MODULE\s+{_NAME}\s*(?:\(.*\))?|(?:LOCAL\s+)?PROC\s+{_NAME}\s*\(.*\)|END(?:MODULE|PROC)",
    re.IGNORECASE | re.ASCII,
)
"""Statements without a semicolon."""
_MODULE = re.compile(rf"MODULE\s+{_NAME}\s*(?:\(.*\))?", re.IGNORECASE | re.ASCII)
_INSTRUCTIONS = {
    # outputs, messages, clocks, and settings of Cartesian moves and of supervision
    "passed": (
        "ConfJ", "ConfL", "SingArea", "Set", "Reset", "SetDO", "SetAO", "SetGO", "PulseDO",
        "InvertDO", "TPWrite", "TPErase", "ClkStart", "ClkStop", "ClkReset", "MotionSup",
    ),
    "pause": ("WaitTime", "WaitDI", "WaitDO", "WaitAI", "WaitGI", "WaitUntil", "WaitRob", "Stop"),
    "speed": ("VelSet", "AccSet", "PathAccLim", "WorldAccLim"),
    "setting": ("GripLoad",),
}  # fmt: skip
BEGINNING = {kind: rf"({'|'.join(names)})\b(.*)" for kind, names in _INSTRUCTIONS.items()}
_TARGETS = ("jointtarget", "extjoint")
"""Types of the data that say where a move leads."""
_OPTIONS = (("id", "noeoffs"), ("v", "t"), ("z", "inpos"), ("wobj", "tload"))
"""Options of the four arguments of MoveAbsJ: target, speed, zone, tool."""


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a module is one file
    comments: list[str] = []
    module = _Module()
    module.execute(_statements(text, comments))
    return module.course.moves(read_header(comments))


class _Module(Program):
    """A module: data and procedures."""

    reads = "absolute joint moves (MoveAbsJ) to literals or constants, one after the other,"
    begins = rf"(?:LOCAL\s+)?PROC\s+(?P<name>{_NAME})\s*\((?P<arguments>.*)\)"
    ends = "ENDPROC"
    data = DATA, ASSIGNMENT
    noted = {kind: (pattern,) for kind, pattern in BEGINNING.items()}  # noqa: RUF012
    reserved = frozenset({
        *(word.lower() for words in _INSTRUCTIONS.values() for word in words),
        "moveabsj", "exit", "return",
    })  # fmt: skip
    twice = "assigned or declared", "targets"

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Moves, data, assignments, waits, instructions of the controller, and calls."""
        return (
            (r"MoveAbsJ\b(.*)", self._move),
            *((pattern, self._assign) for pattern in self.data),
            (rf"WaitTime(?:\s*\\InPos\s*,)?\s+({NUMBER})", self.wait),
            (r"(EXIT)", self.end),
            (r"RETURN", self.leave),
            *self.noting(),
            (
                rf"({_NAME})",
                self.calling("{} is not read here; the file has no procedure of this name."),
            ),
        )

    def name_of(self, name: str) -> str:
        """Capitals do not count."""
        return name.lower()

    def execute(self, statements: Statements) -> None:
        """Execute a module: its procedure main, or the only one that no other calls."""
        self.sort(statements)
        module = self.procedures[""].statements or [(1, "")]
        whole = _MODULE.fullmatch(module[0][1]) and module[-1][1].upper() == "ENDMODULE"
        for number, statement in module[1:-1] if whole else module:
            if not re.fullmatch(DATA, statement, self.flags):
                raise refuse(
                    number, statement,
                    "expected one MODULE with data and procedures (PROC … ENDPROC), and moves in "
                    "them.",
                )  # fmt: skip
        self.procedures[""] = Procedure("the module", 1, module[1:-1])
        self.parse_all()
        self.run("")
        del self.procedures[""]
        called = {
            statement.lower()
            for name, procedure in self.procedures.items()
            for _, statement in procedure.statements
            if statement.lower() != name  # one that calls itself is refused where it does
        }
        first = [name for name in self.procedures if name not in called]
        if "main" not in self.procedures and len(first) != 1:
            raise InvalidInput(
                f"the module has the procedures {', '.join(self.procedures) or 'none'}, and "
                "nothing says which one runs; expected one main, or one that calls the others."
            )
        self.run("main" if "main" in self.procedures else first[0])
        self.note_calls()

    def check(self, number: int, statement: str, text: str) -> None:
        """Options of instructions are given by ``:=``."""
        if any(re.match(pattern, statement, self.flags) for pattern in BEGINNING.values()):
            text = text.replace(":=", "=")
        super().check(number, statement, text)

    def _assign(self, number: int, match: re.Match[str]) -> None:
        """A declaration or an assignment."""
        name, declared = match["name"].lower(), match.groupdict().get("kind")
        is_target = (declared or self.kinds.get(name, "")).lower() in _TARGETS
        self.check(number, match[0], match["part"] + (match["value"] or ""))
        if is_target and match["part"] and not declared:
            raise refuse(
                number, match[0],
                "changes a part of a target; only targets that are assigned once can be checked.",
            )  # fmt: skip
        if match["value"]:
            self.values[name] = "" if declared and match["part"] else match["value"].strip()
        if not is_target:
            self.course.passed(number, declared or match["name"])

    def _data(self, number: int, name: str, kind: str) -> str:
        """The value of data of a type."""
        unknown = f"there is no {kind} {name} above it."
        if self.kinds.get(name.lower()) != kind or name.lower() not in self.values:
            raise refuse(number, name, unknown)
        return self.constant(number, name, name.lower(), unknown)

    def _move(self, number: int, match: re.Match[str]) -> None:
        arguments = split(match[1])
        if re.fullmatch(r"\\Conc", arguments[0], re.I):
            del arguments[0]
        if len(arguments) != len(_OPTIONS):
            raise refuse(number, match[0], "expected a target, a speed, a zone and a tool.")
        bases, given = [], {}
        for argument, known in zip(arguments, _OPTIONS, strict=True):
            base, *options = (part.strip() for part in argument.split("\\"))
            for option in options:
                key, _, value = (part.strip() for part in option.partition(":="))
                if key.lower() not in known or key.lower() in given:
                    raise refuse(number, match[0], f"\\{key} is not read here.")
                given[key.lower()] = value
            if not re.fullmatch(rf"{_NAME}|\[[^()]*\]", base, re.ASCII):
                raise refuse(number, base or match[0], "expected a name or literal data.")
            bases.append(base)
        target, _, zone, tool = bases
        if tool.lower() != _TOOL:
            self.course.setting(number, tool)
        text = target if target[0] == "[" else self._data(number, target, "jointtarget")
        point = self._target(number, text)
        seconds = number_of(number, given["t"], "a time in s") if "t" in given else None
        if zone.lower() not in ("fine", "z0") or "z" in given:
            self.course.rounds(number, zone)
        self.course.move(number, point, seconds)

    def _target(self, number: int, text: str) -> list[float]:
        match = _TARGET.fullmatch(text)
        if not match:
            raise refuse(number, text, "expected a jointtarget, [[6 angles],[6 external axes]].")
        axes = match[2]
        if match[3]:
            axes = self._data(number, match[3], "extjoint").strip("[] ")
        external = zip("abcdef", six(number, axes.split(",")), strict=True)
        given = {f"eax_{axis}": value for axis, value in external if value != float(_NONE)}
        self.course.external(number, given)
        return six(number, [part.strip() for part in match[1].split(",")])


def _statements(text: str, comments: list[str]) -> Statements:
    """The statements with the lines on which they begin; comments are collected."""
    found: Statements = []
    rest, begun = "", 0
    lines = text.split("\n")
    for number, line in enumerate(lines[heading(lines) :], start=heading(lines) + 1):
        code, comment = without_texts(number, line, '"', "!")
        if comment:
            comments.append(comment)
        if not rest.strip():
            begun = number
            if _BLOCK.fullmatch(code):
                found.append((number, code))
                continue
        *whole, rest = (rest + " " + code).split(";")
        for statement in whole:
            if statement.strip():
                found.append((begun, statement.strip()))
            begun = number
    if rest.strip():
        raise refuse(begun, rest, "expected a semicolon at its end.")
    return found


def heading(lines: Sequence[str]) -> int:
    """Number of lines of a controller's heading: its version and language between two %%%."""
    code = [k for k, line in enumerate(lines) if line.strip()]
    if not code or lines[code[0]].strip() != "%%%":
        return 0
    for k in code[1:]:
        if lines[k].strip() == "%%%":
            return k + 1
        if not re.fullmatch(r"\s*(VERSION|LANGUAGE)\s*:\s*\w+\s*", lines[k], re.ASCII):
            raise refuse(k + 1, lines[k], "expected VERSION:… or LANGUAGE:… between %%% and %%%.")
    raise InvalidInput("the heading that begins with %%% has no %%% at its end.")


RAPID = Dialect(
    "rapid", "RAPID", ".mod", "deg", 4, 5, tuple(f"rax_{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""RAPID."""
