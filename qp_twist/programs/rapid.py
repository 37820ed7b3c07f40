r"""RAPID, of ABB.

Absolute joint moves, each with its time (``\T``). External axes are not moved (``9E9``).

Source: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917), MoveAbsJ, jointtarget, zonedata.
"""

from __future__ import annotations

import re

from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Course,
    Rules,
    check_identifier,
    nothing,
    number_of,
    refuse,
    six,
)

_NONE = "9E9"
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


_BLOCK = re.compile(
    r"(MODULE\s+\w+(\s*\(.*\))?|ENDMODULE|(LOCAL\s+)?PROC\s+\w+\s*\(\s*\)|ENDPROC)", re.IGNORECASE
)
_TARGET = re.compile(r"\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]\s*\]")


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a module is one file
    comments: list[str] = []
    reader = _Reader()
    reader.rules.follow(_statements(text, comments), reader.course)
    return reader.course.moves(read_header(comments))


class _Reader:
    """Reads the statements of a module.

    Attributes:
        course: The points so far.
        rules: What statements are.
    """

    def __init__(self) -> None:
        self.course = Course()
        self._targets: dict[str, list[float]] = {}
        self._procedures = 0
        self.rules = Rules(
            (
                (re.compile(r"(?:LOCAL\s+)?PROC\b.*", re.I), self._procedure),
                (_BLOCK, nothing),
                (
                    re.compile(
                        r"(?:LOCAL\s+|TASK\s+)*(?:CONST|PERS|VAR)\s+jointtarget\s+(\w+)\s*:=(.*)",
                        re.I | re.S,
                    ),
                    self._declare,
                ),
                (
                    re.compile(
                        r"MoveAbsJ\s*(?:\\Conc\s*,)?\s*(\[.*\]|\w+)\s*"
                        r"(?:\\\w+(?:\s*:=\s*[^,\\]+)?\s*)*,([^,]*),([^,]*),(.*)",
                        re.I | re.S,
                    ),
                    self._move,
                ),
                (re.compile(rf"WaitTime(?:\s*\\InPos\s*,)?\s+({NUMBER})", re.I), self._wait),
            ),
            re.compile(r"^(Move\w*|Trigg\w*|Search\w*|IF|FOR|WHILE|TEST|GOTO|RETURN)\b", re.I),
            re.compile(
                r"(ConfJ|ConfL|SingArea|AccSet|VelSet|PathAccLim|Set|Reset|SetDO|SetAO|SetGO"
                r"|PulseDO|TPWrite|TPErase|WaitDI|WaitUntil|WaitRob|ClkStart|ClkStop|ClkReset"
                r"|ActUnit|DeactUnit|GripLoad|MotionSup|(?:LOCAL\s+|TASK\s+)*(?:CONST|PERS|VAR)"
                r"\s+\w+|\w+(?:\.\w+|\{.*\})*(?=\s*:=))",
                re.I,
            ),
            "absolute joint moves (MoveAbsJ) one after the other",
        )

    def _procedure(self, number: int, match: re.Match[str]) -> None:
        self._procedures += 1
        if self._procedures > 1 or not _BLOCK.fullmatch(match[0]):
            raise refuse(number, match[0], "expected one procedure, without parameters.")

    def _declare(self, number: int, match: re.Match[str]) -> None:
        self._targets[match[1].lower()] = _target(number, match[2].strip())

    def _wait(self, number: int, match: re.Match[str]) -> None:
        self.course.wait(number, float(match[1]))

    def _move(self, number: int, match: re.Match[str]) -> None:
        name = match[1].strip()
        point = _target(number, name) if name[0] == "[" else self._targets.get(name.lower())
        if point is None:
            raise refuse(number, match[0], f"there is no jointtarget {name} above it.")
        time = re.search(r"\\T\s*:=([^\\]*)", match[2], re.I)
        seconds = None if time is None else number_of(number, time[1], "a time in s")
        if match[3].strip().lower() not in ("fine", "z0") and not self.course.notes:
            self.course.notes.append(
                f"zones from line {number} on ({match[3].strip()}): the robot rounds these points; "
                "checked is the path through them"
            )
        self.course.move(number, point, seconds)


def _statements(text: str, comments: list[str]) -> list[tuple[int, str]]:
    """The statements with the lines on which they begin; comments are collected."""
    found: list[tuple[int, str]] = []
    rest, begun = "", 0
    for number, line in enumerate(text.splitlines(), start=1):
        code, mark, comment = _without_strings(line).partition("!")
        if mark:
            comments.append(comment)
        if not rest.strip():
            begun = number
            if _BLOCK.fullmatch(code.strip()):
                found.append((number, code.strip()))
                continue
        *whole, rest = (rest + " " + code).split(";")
        for statement in whole:
            found.append((begun, statement.strip()))
            begun = number
    if rest.strip():
        raise refuse(begun, rest, "expected a semicolon at its end.")
    return found


def _without_strings(line: str) -> str:
    return re.sub(r'"[^"]*"', '""', line)


def _target(number: int, text: str) -> list[float]:
    match = _TARGET.fullmatch(text)
    if not match:
        raise refuse(number, text, "expected a jointtarget, [[6 angles],[6 external axes]].")
    external = [part.strip() for part in match[2].split(",")]
    if any(number_of(number, part) != float(_NONE) for part in external):
        raise refuse(number, text, f"it moves external axes (expected {_NONE} for each).")
    return six(number, [part.strip() for part in match[1].split(",")])


RAPID = Dialect(
    "rapid", "RAPID", ".mod", "deg", 4, 5, tuple(f"rax_{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""RAPID."""
