r"""RAPID, of ABB.

Absolute joint moves, each with its time (``\T``). External axes are not moved (``9E9``).

Source: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917), MoveAbsJ, jointtarget, zonedata.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from qp_twist.errors import InvalidInput
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Act,
    Calls,
    Course,
    Procedure,
    Rules,
    check_identifier,
    check_no_call,
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
_BLOCK = re.compile(
    rf"(MODULE|PROC|LOCAL\s+PROC)\s+({_NAME})\s*(\(.*\))?|(END)(MODULE|PROC)",
    re.IGNORECASE | re.ASCII,
)
_TARGET = re.compile(r"\[\s*\[([^\[\]]*)\]\s*,\s*(?:\[([^\[\]]*)\]|(\w+))\s*\]", re.ASCII)
_DATA = re.compile(
    rf"(?:(?:LOCAL|TASK)\s+)*(?:CONST|PERS|VAR)\s+({_NAME})\s+({_NAME})((?:\s*\{{[\d\s,]*\}})?)"
    r"\s*(?::=(.*))?",
    re.IGNORECASE | re.ASCII | re.DOTALL,
)
_ASSIGNMENT = re.compile(
    rf"({_NAME})((?:\s*\.\s*\w+|\s*\{{[^{{}}]*\}})*)\s*:=(.*)", re.ASCII | re.DOTALL
)
_PASSED = (
    "ConfJ", "ConfL", "SingArea", "Set", "Reset", "SetDO", "SetAO", "SetGO", "PulseDO", "InvertDO",
    "TPWrite", "TPErase", "ClkStart", "ClkStop", "ClkReset", "MotionSup",
)  # fmt: skip
"""Outputs, messages, clocks, and settings of Cartesian moves and of supervision."""
_PAUSES = ("WaitTime", "WaitDI", "WaitDO", "WaitAI", "WaitGI", "WaitUntil", "WaitRob", "Stop")
_SPEEDS = ("VelSet", "AccSet", "PathAccLim", "WorldAccLim")
_SETTINGS = ("GripLoad",)
_WORDS = {
    word.lower()
    for word in (*_PASSED, *_PAUSES, *_SPEEDS, *_SETTINGS, "MoveAbsJ", "EXIT", "RETURN")
}
"""Names to which a module may not give another meaning."""
_TARGETS = ("jointtarget", "extjoint")
"""Types of the data that say where a move leads."""
_OPTIONS = (("id", "noeoffs"), ("v", "t"), ("z", "inpos"), ("wobj", "tload"))
"""Options of the four arguments of MoveAbsJ: target, speed, zone, tool."""
_READS = "absolute joint moves (MoveAbsJ) to literals or constants, one after the other,"


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a module is one file
    comments: list[str] = []
    course = Course()
    _Reader(course).execute(_statements(text, comments))
    return course.moves(read_header(comments))


class _Reader:
    """Reads the statements of a module.

    Attributes:
        course: The points so far.
        rules: The grammar.
    """

    def __init__(self, course: Course) -> None:
        self.course = course
        self._types: dict[str, str] = {}
        self._values: dict[str, str] = {}
        self._assigned: dict[str, list[int]] = {}
        self._procedures: dict[str, Procedure] = {}
        self._calls: Calls | None = None
        self.rules = Rules(
            (
                (re.compile(r"MoveAbsJ\b(.*)", re.I | re.S | re.A), self._move),
                (_DATA, self._declare),
                (_ASSIGNMENT, self._assign),
                (
                    re.compile(rf"WaitTime(?:\s*\\InPos\s*,)?\s+({NUMBER})", re.I | re.A),
                    self._wait,
                ),
                (re.compile(r"(EXIT)", re.I), self._exit),
                (re.compile(r"RETURN", re.I), lambda number, match: True),
                (_beginning(_PASSED), self._with(course.passed)),
                (_beginning(_PAUSES), self._with(course.pause)),
                (_beginning(_SPEEDS), self._with(course.speed)),
                (_beginning(_SETTINGS), self._with(course.setting)),
                (re.compile(rf"({_NAME})", re.ASCII), self._call),
            ),
            _READS,
        )

    def execute(self, statements: list[tuple[int, str]]) -> None:
        """Execute a module: its procedure main, or the only one that no other calls."""
        self._nested(statements)
        every = [each for procedure in self._procedures.values() for each in procedure.statements]
        for number, statement in every:
            if match := _DATA.fullmatch(statement):
                name = match[2].lower()
                if match[4] is not None or name in self._types:
                    self._assigned.setdefault(name, []).append(number)
                self._types[name] = match[1].lower()
            elif match := _ASSIGNMENT.fullmatch(statement):
                self._assigned.setdefault(match[1].lower(), []).append(number)
        data = self._procedures.pop("")
        self._calls = Calls(self.rules, self.course, {"": data, **self._procedures})
        self._calls.run("")
        called = {
            statement.lower()
            for name, procedure in self._procedures.items()
            for _, statement in procedure.statements
            if statement.lower() != name  # one that calls itself is refused where it does
        }
        first = [name for name in self._procedures if name not in called]
        if "main" in self._procedures or len(first) == 1:
            self._calls.run("main" if "main" in self._procedures else first[0])
        else:
            raise InvalidInput(
                f"the module has the procedures {', '.join(self._procedures) or 'none'}, and "
                "nothing says which one runs; expected one main, or one that calls the others."
            )
        self._calls.note_numbers()

    def _nested(self, statements: list[tuple[int, str]]) -> None:
        """Sort statements into procedures; data of the module are in the one without a name."""
        inside: list[str] = []
        modules = 0
        self._procedures[""] = Procedure("the module", 1, [])
        for number, statement in statements:
            match = _BLOCK.fullmatch(statement)
            word = "" if match is None else (match[4] or match[1]).split()[-1].upper()
            if match is not None and match[4]:
                if not inside or inside.pop() != match[5].upper():
                    raise refuse(number, statement, "there is nothing above that it ends.")
            elif word == "MODULE" and not inside and not modules:
                inside.append(word)
                modules += 1
            elif match is not None and word == "PROC" and inside == ["MODULE"]:
                name = match[2].lower()
                if not re.fullmatch(r"\(\s*\)", match[3] or ""):
                    raise refuse(number, statement, "expected a procedure without parameters.")
                if name in _WORDS or name in self._procedures:
                    raise refuse(number, statement, "this name has a meaning already.")
                self._procedures[name] = procedure = Procedure(match[2], number, [])
                inside.append(word)
            elif inside == ["MODULE", "PROC"]:
                procedure.statements.append((number, statement))
            elif inside == ["MODULE"] and _DATA.fullmatch(statement):
                self._procedures[""].statements.append((number, statement))
            else:
                raise refuse(
                    number, statement,
                    "expected one MODULE with data and procedures (PROC … ENDPROC), and moves in "
                    "them.",
                )  # fmt: skip
        if inside:
            raise InvalidInput(f"there is no END{inside[-1]} at the end; a line was lost.")

    def _declare(self, number: int, match: re.Match[str]) -> None:
        value = "" if match[4] is None else match[4].strip()
        check_no_call(number, match[0], value, _READS)
        if value:
            self._values[match[2].lower()] = "" if match[3] else value
        if match[1].lower() not in _TARGETS:
            self.course.passed(number, match[1])

    def _assign(self, number: int, match: re.Match[str]) -> None:
        name = match[1].lower()
        check_no_call(number, match[0], match[2] + match[3], _READS)
        target = self._types.get(name) in _TARGETS
        if target and match[2]:
            raise refuse(
                number, match[0],
                "changes a part of a target; only targets that are assigned once can be checked.",
            )  # fmt: skip
        self._values[name] = match[3].strip()
        if not target:
            self.course.passed(number, match[1])

    def _constant(self, number: int, name: str, kind: str) -> str:
        """The value of data that are assigned once, before this line is executed."""
        lines = self._assigned.get(name.lower(), [])
        if self._types.get(name.lower()) != kind or name.lower() not in self._values:
            raise refuse(number, name, f"there is no {kind} {name} above it.")
        if len(lines) > 1:
            raise refuse(
                number, name,
                f"is assigned or declared in lines {', '.join(map(str, lines))}; only targets "
                "that are assigned once can be checked.",
            )  # fmt: skip
        return self._values[name.lower()]

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
        text = target if target[0] == "[" else self._constant(number, target, "jointtarget")
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
            axes = self._constant(number, match[3], "extjoint").strip("[] ")
        external = zip("abcdef", six(number, axes.split(",")), strict=True)
        given = {f"eax_{axis}": value for axis, value in external if value != float(_NONE)}
        self.course.external(number, given)
        return six(number, [part.strip() for part in match[1].split(",")])

    def _wait(self, number: int, match: re.Match[str]) -> None:
        self.course.wait(number, float(match[1]))

    def _exit(self, number: int, match: re.Match[str]) -> bool:
        self.course.ends(number, match[1])
        return True

    def _with(self, note: Callable[[int, str], None]) -> Act:
        """An instruction of the controller: its arguments call nothing."""

        def act(number: int, match: re.Match[str]) -> None:
            check_no_call(number, match[0], match[2].replace(":=", "="), _READS)
            note(number, match[1])

        return act

    def _call(self, number: int, match: re.Match[str]) -> None:
        if match[1].lower() not in self._procedures:
            raise refuse(
                number, match[0],
                f"{match[1]} is not read here; the file has no procedure of this name.",
            )  # fmt: skip
        assert self._calls is not None
        self._calls.run(match[1].lower())


def _beginning(names: Sequence[str]) -> re.Pattern[str]:
    return re.compile(rf"({'|'.join(names)})\b(.*)", re.IGNORECASE | re.DOTALL | re.ASCII)


def _statements(text: str, comments: list[str]) -> list[tuple[int, str]]:
    """The statements with the lines on which they begin; comments are collected."""
    found: list[tuple[int, str]] = []
    rest, begun = "", 0
    lines = text.split("\n")
    for number, line in enumerate(lines[_heading(lines) :], start=_heading(lines) + 1):
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


def _heading(lines: Sequence[str]) -> int:
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
