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
from qp_twist.files import of_file, text_lines
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Act,
    Procedure,
    Program,
    Statements,
    check_identifier,
    refuse,
    shown,
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


_SECTION = re.compile(r"/(PROG\b.*|ATTR|APPL|MN|POS|END)\s*", re.ASCII)
POINT = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL | re.ASCII)
_FIELD = re.compile(
    rf"GP(\d)\s*:|(UF|UT)\s*:\s*\w+|([JE]\d)\s*=\s*({NUMBER}|\*+)\s*(\w*)", re.ASCII
)
_MOVE = (
    rf"J\s+P\[\s*(\d+)\s*(?::[^\]]*)?\]\s+({NUMBER})\s*(%|sec|msec)\s+(FINE|CNT\s*\d+)"
    r"(\s+ACC\s*\d+)?"
)
NOTED = {
    "pause": (r"(WAIT)\s+(?!.*\b(?:TIMEOUT|LBL)\b)[^;]*[=<>][^;]*", r"(PAUSE)"),
    "speed": (rf"(OVERRIDE)\s*=\s*{NUMBER}\s*%",),
    "setting": (r"((?:UFRAME|UTOOL)_NUM)\s*=\s*\d+", r"(PAYLOAD)\s*\[\s*\d+\s*\]"),
    # outputs, flags, registers, timers and messages: no move that is read depends on them
    "passed": (
        r"(DO|RO|GO|AO|SO|F|M|R|SR|TIMER)\s*\[([^\]]*\]\s*=.*)", r"(MESSAGE)\s*\[.*\]",
    ),
}  # fmt: skip


def _decode(text: str, beside: Beside) -> JointMoves:
    program = _Tp(beside)
    program.run(program.read(text))
    return program.course.moves(read_header(program.comments))


class _Tp(Program):
    """A program, and those that it calls.

    Attributes:
        comments: Remarks.
    """

    reads = "joint moves (J P[…] with a speed or time, FINE or CNT) one after the other"
    noted = NOTED

    def __init__(self, beside: Beside) -> None:
        super().__init__()
        self.comments: list[str] = []
        self._beside = beside
        self._points: dict[str, dict[int, dict[str, float]]] = {}

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Remarks, moves, calls, waits, and what does not move."""
        return (
            (r"(?:!|//|--).*|", lambda number, match: None),
            (_MOVE, self._move),
            (r"CALL\s+(\w+)", self._call),
            (rf"WAIT\s+({NUMBER})\s*\(sec\)", self.wait),
            (r"(ABORT)", self.end),
            (r"END", self.leave),
            *self.noting(),
        )

    def check(self, number: int, statement: str, text: str) -> None:
        """Expressions call by words."""
        if re.search(r"\b(CALL|RUN|JMP)\b", text, re.I):
            raise refuse(number, statement, "calls something in an expression.")

    def read(self, text: str, called: str = "") -> str:
        """Read a program; the name under which it runs."""
        parts, found = {"": ""}, [""]
        for line in text.split("\n"):
            if match := _SECTION.fullmatch(line):
                found.append(match[1].split()[0])
                parts[found[-1]] = ""
            parts[found[-1]] += line + "\n"
        sections = [section for section in found if section != "APPL"]
        name = re.match(r"/PROG\s+(\w+)", parts.get("PROG", ""), re.ASCII)
        if not name or sections != ["", "PROG", "ATTR", "MN", "POS", "END"] or parts[""].strip():
            raise InvalidInput("this is no TP program: expected /PROG, /ATTR, /MN, /POS and /END.")
        if left := parts["END"].partition("\n")[2].strip():
            raise refuse(text.count("\n"), left, "expected nothing after /END.")
        first = text[: text.index(parts["MN"])].count("\n") + 2
        statements = _statements(parts["MN"].partition("\n")[2], first)
        count = re.search(r"LINE_COUNT\s*=\s*(\d+)", parts["ATTR"], re.ASCII)
        if count and int(count[1]) != len(statements):
            raise InvalidInput(
                f"{name[1]}: LINE_COUNT is {count[1]}, but there are {len(statements)} lines; a "
                "line was lost or added."
            )
        for number, statement in statements:
            self._remark(number, statement)
        key = called or name[1].upper()
        tail = first + parts["MN"].count("\n")
        points = self._points[key] = _points(parts["POS"].partition("\n")[2], tail)
        acts = self.parse(key, Procedure(name[1], first, statements))
        used = {int(match[1]) for _, act, match in acts if act == self._move}
        if unused := sorted(set(points) - used):
            raise InvalidInput(
                f"{name[1]}: no line moves to P[{unused[0]}]; a line was lost, or the point is "
                "left over."
            )
        return key

    def _remark(self, number: int, statement: str) -> None:
        """Collect a remark; one that continues the remark above is joined with it."""
        if re.match("!|//|--", statement):
            text = statement.lstrip("!/-")
            if text.startswith(_MORE) and self.comments:
                self.comments[-1] += " " + text.removeprefix(_MORE)
            else:
                self.comments.append(text)
        elif not statement.isascii():
            raise refuse(number, statement, "expected ASCII characters outside remarks.")

    def _move(self, number: int, match: re.Match[str]) -> None:
        point, points = int(match[1]), self._points[self.running]
        if point not in points:
            raise refuse(number, match[0], f"there is no P[{point}] under /POS.")
        if match[4].upper() not in ("FINE", "CNT0"):
            self.course.rounds(number, match[4])
        if match[5]:
            self.course.speed(number, "ACC")
        axes = points[point]
        external = {axis: value for axis, value in axes.items() if axis[0] == "E"}
        self.course.external(number, external)
        value, unit = float(match[2]), match[3].lower()
        seconds = {"%": None, "sec": value, "msec": 1e-3 * value}[unit]
        self.course.move(number, [axes[axis] for axis in LS.axis_names], seconds)

    def _call(self, number: int, match: re.Match[str]) -> None:
        name = match[1].upper()
        if name not in self.procedures:
            content = self._beside(f"{match[1]}.ls")
            if content is None:
                raise refuse(number, match[0], f"there is no {match[1]}.ls beside the file.")
            with of_file(f"{match[1]}.ls"):
                self.read("\n".join(text_lines(content)), name)
        with of_file(f"{match[1]}.ls"):
            self.run(name)


def _points(tail: str, first: int) -> dict[int, dict[str, float]]:
    """The angles of the axes of the points by number, external ones included."""
    found: dict[int, dict[str, float]] = {}
    for match in POINT.finditer(tail):
        point, inside = int(match[1]), match[2]
        try:
            if point in found:
                raise InvalidInput(f"P[{point}] stands twice.")
            found[point] = _axes(f"P[{point}]", inside)
        except InvalidInput as error:
            error.line = first + tail.count("\n", 0, match.start())
            raise
    if left := POINT.sub("", tail).strip():
        raise InvalidInput(f"under /POS, something is left that is no point: {left[:60]!r}.")
    return found


def _axes(point: str, inside: str) -> dict[str, float]:
    """The angles of the axes of a point."""
    axes: dict[str, float] = {}
    if re.search(r"\b[XYZ]\s*=", inside):
        raise InvalidInput(f"{point} is Cartesian; only joint angles J1 to J6 can be checked.")
    for group, _, axis, value, unit in _FIELD.findall(inside):
        if group and group != "1":
            raise InvalidInput(f"{point} moves more than one motion group.")
        if not axis:
            continue
        if unit not in ("deg", *(["mm"] if axis[0] == "E" else [])):
            raise InvalidInput(f"{point}, {axis}: the unit is {unit or 'missing'!r}; expected deg.")
        if axis in axes:
            raise InvalidInput(f"{point}: {axis} stands twice.")
        if value.startswith("*") or not math.isfinite(float(value)):
            raise InvalidInput(f"{shown(value)}: expected an angle of {axis}.")
        axes[axis] = float(value)
    if left := _FIELD.sub("", inside).replace(",", " ").strip():
        raise InvalidInput(f"{point}: {left[:60]!r} is not read.")
    if sorted(axis for axis in axes if axis[0] == "J") != list(LS.axis_names):
        raise InvalidInput(f"{point}: expected J1 to J{AXES}.")
    return axes


def _statements(body: str, first: int) -> Statements:
    """The statements of a program, each with its line in the file.

    A statement ends with a semicolon, and stands on one line or, except a remark, on several.

    Raises:
        InvalidInput: If a number or a semicolon is missing.
    """
    found: Statements = []
    numbered, open_ = 0, False
    for number, line in enumerate(body.split("\n"), start=first):
        if not line.strip():
            continue
        match = re.fullmatch(r"\s*(\d*)\s*:([^;]*)(;?)\s*", line, re.ASCII)
        if not match:
            raise refuse(
                number, line, "expected a line of a TP program, NUMBER: … ;, with one statement."
            )
        text = match[2].strip()
        if open_ and match[1]:
            raise refuse(number, line, "the line above has no semicolon at its end.")
        if match[1]:
            numbered += 1
            if int(match[1]) != numbered:
                raise refuse(
                    number, line,
                    f"expected line number {numbered}; a line was lost or added.",
                )  # fmt: skip
        if open_:
            found[-1] = (found[-1][0], f"{found[-1][1]} {text}")
        else:
            found.append((number, text))
        open_ = not match[3]
        if open_ and re.match("!|//|--", found[-1][1]):
            raise refuse(number, line, "a remark ends with a semicolon on its line.")
    if open_:
        raise refuse(found[-1][0], found[-1][1], "expected a semicolon at its end.")
    return found


LS = Dialect(
    "ls", "a TP program", ".ls", "deg", 4, 3, tuple(f"J{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""TP programs of Fanuc."""
