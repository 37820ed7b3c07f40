"""TP programs of Fanuc as text (LS).

Joint moves with their times in whole milliseconds (in tenths of a second above 32 s), points as
joint angles. A program longer than :data:`LONGEST` lines is divided, and a program of its name
calls the parts.

Source: Fanuc, *R-30iA/R-30iB Operator's manual*, motion instructions; the number of lines: that at
which RoboDK's public post processors for Fanuc divide programs.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence

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
    without_repeats,
)

LONGEST = 9999
"""Lines of a program."""
_NAME = 36
"""Characters of a program's name (older controllers: 8)."""
_REMARK = 32
"""Characters of a remark."""
_MORE = ".."
"""Mark of a remark that continues the one above."""
_MS = 32000
"""Largest time in milliseconds."""
_HEAD = """\
/PROG  {name}
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "qp_twist";
PROG_SIZE	= 0;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= {count};
MEMORY_SIZE	= 0;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
"""


def _check_name(name: str) -> None:
    check_identifier(name, "a TP program", _NAME, "8 on controllers before R-30iA")


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    title = name.upper()
    remarks = [f"  !{text} ;" for line in header for text in _remarks(line)]
    last = len(moves.angles)
    statements = []
    for point, seconds in enumerate([None, *moves.durations.tolist()], start=1):
        speed = "10%" if seconds is None else _time(seconds)
        end = "FINE" if point in (1, last) else "CNT100"
        statements.append((f"J P[{{}}] {speed} {end} ;", moves.angles[point - 1].tolist()))
    room = LONGEST - len(remarks)
    if len(statements) <= room:
        return {f"{name}.ls": _program(title, remarks, statements)}
    count = -(-len(statements) // LONGEST)
    share = -(-len(statements) // count)
    parts = [statements[k : k + share] for k in range(0, len(statements), share)]
    _check_name(f"{name}_{len(parts)}")
    calls = [f"  CALL {title}_{number} ;" for number in range(1, len(parts) + 1)]
    files = {f"{name}.ls": _program(title, [*remarks, *calls], [])}
    for number, part in enumerate(parts, start=1):
        files[f"{name}_{number}.ls"] = _program(f"{title}_{number}", [], part)
    return files


def _program(title: str, first: Sequence[str], moves: Sequence[tuple[str, list[float]]]) -> str:
    """The text of a program: statements, then moves and their points."""
    lines = [*first, *(text.format(k) for k, (text, _) in enumerate(moves, start=1))]
    text = _HEAD.format(name=title, count=len(lines))
    text += "".join(f"{number:4d}:{line}\n" for number, line in enumerate(lines, start=1))
    text += "/POS\n"
    for number, (_, angles) in enumerate(moves, start=1):
        axes = [f"J{k}= {value:.{LS.decimals}f} deg" for k, value in enumerate(angles, start=1)]
        text += f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\n"
        text += f"\t{', '.join(axes[:3])},\n\t{', '.join(axes[3:])}\n}};\n"
    return text + "/END\n"


def _time(seconds: float) -> str:
    milliseconds = round(1000.0 * seconds)
    if milliseconds <= _MS:
        return f"{milliseconds}msec"
    return f"{math.ceil(milliseconds / 100.0) / 10.0:.1f}sec"


def _remarks(line: str) -> list[str]:
    """A header line in remarks short enough."""
    first, *others = textwrap.wrap(line, _REMARK - len(_MORE)) or [""]
    return [first, *(f"{_MORE}{text}" for text in others)]


_POINT = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL)
_JOINT = re.compile(rf"J(\d)\s*=\s*({NUMBER}|\*+)\s*(\w*)")


def _decode(text: str, beside: Beside) -> JointMoves:
    comments: list[str] = []
    course = Course()
    _Reader(beside, comments, course, ()).read(text)
    return course.moves(read_header(comments))


class _Reader:
    """Reads a program, and those that it calls."""

    def __init__(
        self, beside: Beside, comments: list[str], course: Course, callers: tuple[str, ...]
    ) -> None:
        self._beside, self._comments, self._course = beside, comments, course
        self._callers = callers
        self._points: dict[int, list[float]] = {}
        self._used: set[int] = set()
        self._rules = Rules(
            (
                (re.compile(r"(?:!|//|--)(.*)"), self._remark),
                (re.compile(""), nothing),
                (
                    re.compile(
                        rf"J\s+P\[\s*(\d+)\s*(?::[^\]]*)?\]\s+({NUMBER})\s*(%|sec|msec)"
                        r"\s+(FINE|CNT\s*\d+)",
                        re.IGNORECASE,
                    ),
                    self._move,
                ),
                (re.compile(r"CALL\s+(\w+)", re.IGNORECASE), self._call),
                (re.compile(rf"WAIT\s+({NUMBER})\s*\(sec\)", re.IGNORECASE), self._wait),
            ),
            re.compile(
                r"^([JLCAS](?=\s)|IF|JMP|LBL|FOR|ENDFOR|SELECT|RUN|END|SKIP|OFFSET|CALL|OVERRIDE"
                r"|TOOL_OFFSET|PR)",
                re.IGNORECASE,
            ),
            re.compile(
                r"((?:UFRAME_NUM|UTOOL_NUM|PAYLOAD|DO|RO|GO|AO|R|F|\$\w+|MESSAGE|TIMER|UTOOL"
                r"|UFRAME)\b)",
                re.IGNORECASE,
            ),
            "joint moves (J P[…] with a speed or time, FINE or CNT) one after the other",
        )

    def read(self, text: str) -> None:
        """Follow the program's lines."""
        name = re.search(r"^/PROG\s+(\S+)", text, re.MULTILINE)
        if not name or "/MN" not in text or "/END" not in text:
            raise InvalidInput("this is no TP program: expected /PROG, /MN, /POS and /END.")
        self._callers = (*self._callers, name[1].upper())
        without_repeats(self._callers)
        head, _, rest = text.partition("/MN")
        body, _, tail = rest.partition("/POS")
        first = head.count("\n") + 1
        self._points = _points(tail, first + body.count("\n"))
        statements = _statements(body, first)
        count = re.search(r"LINE_COUNT\s*=\s*(\d+)", head)
        if count and int(count[1]) != len(statements):
            raise InvalidInput(
                f"{name[1]}: LINE_COUNT is {count[1]}, but there are {len(statements)} lines; a "
                "line was lost or added."
            )
        self._rules.follow(statements, self._course)
        unused = sorted(set(self._points) - self._used)
        if unused:
            raise InvalidInput(
                f"{name[1]}: no line moves to P[{unused[0]}]; a line was lost, or the point is "
                "left over."
            )

    def _remark(self, number: int, match: re.Match[str]) -> None:
        text = match[1].lstrip("!/-")
        if text.startswith(_MORE) and self._comments:
            self._comments[-1] += " " + text.removeprefix(_MORE)
        else:
            self._comments.append(text)

    def _move(self, number: int, match: re.Match[str]) -> None:
        point = int(match[1])
        if point not in self._points:
            raise refuse(number, match[0], f"there is no P[{point}] under /POS.")
        self._used.add(point)
        if match[4].upper() not in ("FINE", "CNT0") and not self._course.notes:
            self._course.notes.append(
                f"points passed without a stop from line {number} on ({match[4]}): the robot "
                "rounds them; checked is the path through them"
            )
        value, unit = float(match[2]), match[3].lower()
        seconds = {"%": None, "sec": value, "msec": 1e-3 * value}[unit]
        self._course.move(number, self._points[point], seconds)

    def _wait(self, number: int, match: re.Match[str]) -> None:
        self._course.wait(number, float(match[1]))

    def _call(self, number: int, match: re.Match[str]) -> None:
        content = self._beside(f"{match[1]}.ls")
        if content is None:
            raise refuse(number, match[0], f"there is no {match[1]}.ls beside the file.")
        called = _Reader(self._beside, self._comments, self._course, self._callers)
        try:
            called.read("\n".join(text_lines(content)))
        except InvalidInput as error:
            raise InvalidInput(f"{match[1]}.ls: {error}") from None


def _statements(body: str, first: int) -> list[tuple[int, str]]:
    """The numbered lines of a program, each with its line in the file.

    Raises:
        InvalidInput: If a number is missing.
    """
    found: list[tuple[int, str]] = []
    for number, line in enumerate(body.split("\n"), start=first):
        if not line.strip():
            continue
        match = re.fullmatch(r"\s*(\d*)\s*:(.*?);?\s*", line)
        if not match:
            raise refuse(number, line, "expected a line of a TP program, NUMBER: … ;")
        if match[1]:
            if int(match[1]) != len(found) + 1:
                raise refuse(
                    number, line,
                    f"expected line number {len(found) + 1}; a line was lost or added.",
                )  # fmt: skip
            found.append((number, match[2].strip()))
        elif found:
            found[-1] = (found[-1][0], f"{found[-1][1]} {match[2].strip()}")
    return found


def _points(tail: str, first: int) -> dict[int, list[float]]:
    """The joint angles of the points by number."""
    found: dict[int, list[float]] = {}
    for match in _POINT.finditer(tail):
        number = first + tail.count("\n", 0, match.start())
        point, inside = int(match[1]), match[2]
        if point in found:
            raise InvalidInput(f"line {number}: P[{point}] stands twice.")
        if re.search(r"\bGP[2-9]", inside):
            raise InvalidInput(f"line {number}: P[{point}] moves more than one motion group.")
        if re.search(r"\bX\s*=", inside):
            raise InvalidInput(
                f"line {number}: P[{point}] is Cartesian; only joint angles J1 to J6 can be "
                "checked."
            )
        if re.search(r"\bE\d\s*=", inside):
            raise InvalidInput(f"line {number}: P[{point}] moves an extended axis.")
        angles: dict[int, float] = {}
        for axis, value, unit in _JOINT.findall(inside):
            if unit != "deg":
                raise InvalidInput(
                    f"line {number}: P[{point}], J{axis}: the unit is {unit or 'missing'!r}; "
                    "expected deg."
                )
            if int(axis) in angles:
                raise InvalidInput(f"line {number}: P[{point}]: J{axis} stands twice.")
            angles[int(axis)] = number_of(number, value, f"an angle of J{axis}")
        if sorted(angles) != list(range(1, AXES + 1)):
            raise InvalidInput(f"line {number}: P[{point}]: expected J1 to J{AXES}.")
        found[point] = [angles[axis] for axis in range(1, AXES + 1)]
    left = _POINT.sub("", tail).partition("/END")[0].strip()
    if left:
        raise InvalidInput(f"under /POS, something is left that is no point: {left[:60]!r}.")
    return found


LS = Dialect(
    "ls", "a TP program", ".ls", "deg", 4, 3, tuple(f"J{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""TP programs of Fanuc."""
