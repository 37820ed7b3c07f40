"""KRL, the KUKA Robot Language.

The start is reached by ``PTP`` at a tenth of the axes' speed. Then one spline in the axes
(``PTP_SPLINE``) passes all points; its ``TIME_BLOCK`` has the time of each segment and of all.

Source: public code, since KUKA's manual was not at hand. The words are those of the syntax file of
KnoP-01/krl-for-vim; the form ``PTP_SPLINE … TIME_BLOCK START … SPTP … TIME_BLOCK PART = …
TIME_BLOCK END = … ENDSPLINE`` is that of two generators of KRL programs on GitHub. One writes parts
in seconds, the other in percent of the whole, so parts are read as shares of ``END``.
"""

from __future__ import annotations

import re

from qp_twist.errors import InvalidInput
from qp_twist.files import text_lines
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
)

_LONGEST = 24
"""Characters of a program's name, as usually stated; not looked up in KUKA's manual."""
_TOP = """\
&ACCESS RVP
&REL 1
DEF {name}( )
"""
_START = """\
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0)
BAS (#VEL_PTP,10)
BAS (#ACC_PTP,20)
"""


def _check_name(name: str) -> None:
    check_identifier(name, "KRL", _LONGEST, "the name after DEF")


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    decimals = KRL.decimals

    def target(point: list[float]) -> str:
        pairs = zip(KRL.axis_names, point, strict=True)
        return "{" + ",".join(f"{axis} {value:.{decimals}f}" for axis, value in pairs) + "}"

    first, *others = moves.angles.tolist()
    times = moves.durations.tolist()
    lines = [_TOP.format(name=name).rstrip("\n"), *(f"; {line}" for line in header)]
    lines += [_START.rstrip("\n"), f"PTP {target(first)}", "PTP_SPLINE", "TIME_BLOCK START"]
    for point, seconds in zip(others, times, strict=True):
        lines += [f"SPTP {target(point)}", f"TIME_BLOCK PART = {seconds:.{KRL.time_decimals}f}"]
    lines += [f"TIME_BLOCK END = {sum(times):.{KRL.time_decimals}f}", "ENDSPLINE", "END", ""]
    return {f"{name}{KRL.suffix}": "\n".join(lines)}


_DECLARED = re.compile(
    r"(?:GLOBAL\s+)?(?:DECL\s+)?(?:GLOBAL\s+)?(?:E6AXIS|AXIS)\s+(\w+)\s*=\s*(\{.*\})", re.IGNORECASE
)


def _decode(text: str, beside: Beside) -> JointMoves:
    comments: list[str] = []
    statements: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        code, _, comment = line.partition(";")
        comments.append(comment)
        if code.strip() and not code.strip().startswith("&"):
            statements.append((number, code.strip()))
    reader = _Reader(beside)
    reader.rules.follow(statements, reader.course)
    if reader.block is not None:
        raise InvalidInput("the time block has no end (TIME_BLOCK END = …); a line was lost.")
    header = read_header(comments)
    if header and reader.shares:
        raise InvalidInput(
            f"the parts of the time block are not {header['seconds']} s together, as the header "
            "says; a time was changed. Export it again, or remove the header."
        )
    return reader.course.moves(header)


class _Reader:
    """Reads the statements of a program.

    Attributes:
        course: The points so far.
        rules: What statements are.
        block: Points of a time block that is not closed, with their lines.
        shares: Whether the parts of the time block are shares, not seconds.
    """

    def __init__(self, beside: Beside) -> None:
        self.course = Course()
        self.block: list[tuple[int, list[float]]] | None = None
        self._beside = beside
        self._targets: dict[str, list[float]] = {}
        self._name = ""
        self._parts: list[float] = []
        self._timed = False
        self.shares = False
        self.rules = Rules(
            (
                (re.compile(r"(?:GLOBAL\s+)?DEF\s+(\w+)\s*\(\s*\)", re.I), self._define),
                (re.compile(r"END|ENDSPLINE|PTP_SPLINE(\s+WITH\s.*)?", re.I), nothing),
                (re.compile(r"TIME_BLOCK\s+START", re.I), self._begin),
                (re.compile(rf"TIME_BLOCK\s+PART\s*=\s*({NUMBER})", re.I), self._part),
                (re.compile(rf"TIME_BLOCK\s+END\s*=\s*({NUMBER})", re.I), self._end),
                (_DECLARED, self._declare),
                (
                    re.compile(r"S?PTP\s+(\{.*?\}|\w+)\s*((?:C_\w+\s*)*)(?:WITH\s.*)?", re.I),
                    self._move,
                ),
                (re.compile(rf"WAIT\s+SEC\s+({NUMBER})", re.I), self._wait),
            ),
            re.compile(
                r"^(LIN|LIN_REL|PTP_REL|SPTP_REL|CIRC|CIRC_REL|SLIN|SLIN_REL|SCIRC|SCIRC_REL|SPL"
                r"|SPLINE|IF|ELSE|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|LOOP|ENDLOOP|REPEAT|UNTIL|SWITCH"
                r"|CASE|ENDSWITCH|GOTO|EXIT|CONST_VEL|ASYPTP|RETURN|TIME_BLOCK)\b",
                re.IGNORECASE,
            ),
            re.compile(
                r"((?:BAS|INTERRUPT|GLOBAL\s+INTERRUPT|DECL|EXT|SIGNAL|INT|REAL|BOOL|CHAR|FRAME"
                r"|E6POS|POS|AXIS|E6AXIS|WAIT\s+FOR|TRIGGER|CONTINUE|PULSE|ANOUT|ANIN|INI|HALT)\b"
                r"|\$?\w+(?:\[[^\]]*\])?(?:\.\w+)*(?=\s*=(?!=)))",
                re.IGNORECASE,
            ),
            "axis moves (PTP, SPTP) one after the other",
        )

    def _define(self, number: int, match: re.Match[str]) -> None:
        if self._name:
            raise refuse(number, match[0], "a second program in the file; expected one.")
        self._name = match[1]
        self._targets = _of_data_file(self._beside, self._name)

    def _declare(self, number: int, match: re.Match[str]) -> None:
        self._targets[match[1].upper()] = _target(number, match[2])

    def _begin(self, number: int, match: re.Match[str]) -> None:
        if self._timed:
            raise refuse(number, match[0], "a second time block; expected one.")
        self._timed, self.block = True, []

    def _part(self, number: int, match: re.Match[str]) -> None:
        self._parts.append(float(match[1]))
        if self.block is None or len(self._parts) != len(self.block):
            raise refuse(
                number, match[0],
                "expected TIME_BLOCK START, then one segment before each part; a line was lost or "
                "added.",
            )  # fmt: skip

    def _end(self, number: int, match: re.Match[str]) -> None:
        if self.block is None:
            raise refuse(number, match[0], "expected TIME_BLOCK START before it.")
        block, self.block = self.block, None
        self.shares = abs(sum(self._parts) - float(match[1])) > 0.6e-5
        _end_block(self.course, number, block, self._parts, float(match[1]))

    def _move(self, number: int, match: re.Match[str]) -> None:
        if match[1][0] == "{":
            point = _target(number, match[1])
        elif match[1].upper() in self._targets:
            point = self._targets[match[1].upper()]
        else:
            raise refuse(
                number, match[0],
                f"there are no axes of {match[1]}, in the program or in "
                f"{self._name or 'NAME'}.dat.",
            )  # fmt: skip
        if match[2].strip() and not self.course.notes:
            self.course.notes.append(
                f"approximated points from line {number} on ({match[2].strip()}): the robot rounds "
                "them; checked is the path through them"
            )
        if self.block is None:
            self.course.move(number, point, None)
        else:
            self.block.append((number, point))

    def _wait(self, number: int, match: re.Match[str]) -> None:
        self.course.wait(number, float(match[1]))


def _end_block(
    course: Course,
    number: int,
    block: list[tuple[int, list[float]]],
    parts: list[float],
    whole: float,
) -> None:
    """The segments of a time block: each takes its part's share of the whole time."""
    if len(parts) != len(block) or not block:
        raise InvalidInput(
            f"line {number}: the time block has {len(block)} segments and {len(parts)} parts; "
            "a line was lost or added."
        )
    total = sum(parts)
    if not (total > 0.0 and whole > 0.0 and min(parts) > 0.0):
        raise InvalidInput(f"line {number}: a time of the time block is not positive.")
    for (line, point), part in zip(block, parts, strict=True):
        course.move(line, point, part * whole / total)


def _target(number: int, text: str) -> list[float]:
    """The axes of an aggregate such as ``{E6AXIS: A1 0, A2 -90, …}``."""
    inside = text.strip()[1:-1].partition(":")
    fields: dict[str, float] = {}
    for part in (inside[2] or inside[0]).split(","):
        key, _, value = part.strip().partition(" ")
        if key.upper() in fields:
            raise refuse(number, text, f"{key} stands twice.")
        fields[key.upper()] = number_of(number, value, f"a number after {key}")
    if {"X", "Y", "Z"} & set(fields):
        raise refuse(number, text, "a Cartesian target; only axes {A1 …, A6 …} can be checked.")
    external = [key for key, value in fields.items() if re.fullmatch(r"E[1-6]", key) and value]
    if external:
        raise refuse(number, text, f"it moves external axes ({', '.join(external)}).")
    axes = {key for key in fields if not re.fullmatch(r"E[1-6]", key)}
    if axes != set(KRL.axis_names):
        raise refuse(number, text, f"expected the axes {', '.join(KRL.axis_names)}.")
    return [fields[axis] for axis in KRL.axis_names]


def _of_data_file(beside: Beside, name: str) -> dict[str, list[float]]:
    """The axes that the program's data file declares; none without a file."""
    content = beside(f"{name}.dat")
    if content is None:
        return {}
    found = {}
    for number, line in enumerate(text_lines(content), start=1):
        if match := _DECLARED.fullmatch(line.partition(";")[0].strip()):
            try:
                found[match[1].upper()] = _target(number, match[2])
            except InvalidInput as error:
                raise InvalidInput(f"{name}.dat, {error}") from None
    return found


KRL = Dialect(
    "krl", "KRL", ".src", "deg", 4, 5, tuple(f"A{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""KRL."""
