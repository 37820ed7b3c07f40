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
from collections.abc import Callable, Sequence
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, text_lines
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Act,
    Course,
    Rules,
    check_callers,
    check_identifier,
    number_of,
    refuse,
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
_POINT = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL | re.ASCII)
_FIELD = re.compile(
    rf"GP(\d)\s*:|(UF|UT)\s*:\s*\w+|([JE]\d)\s*=\s*({NUMBER}|\*+)\s*(\w*)", re.ASCII
)
_PASSED = r"(?:DO|RO|GO|AO|SO|F|M|R|SR|TIMER)\s*\[[^\]]*\]\s*=.*|MESSAGE\s*\[.*\]"
"""Outputs, flags, registers, timers and messages: no move that is read depends on them."""


def _decode(text: str, beside: Beside) -> JointMoves:
    comments: list[str] = []
    course = Course()
    reader = _Reader(beside, comments, course)
    reader.run(reader.read(text))
    return course.moves(read_header(comments))


class _Program(NamedTuple):
    """A program that was read.

    Attributes:
        name: As in /PROG.
        acts: What its statements do, each with its line.
        points: Joint angles by number.
    """

    name: str
    acts: list[tuple[int, Act, re.Match[str]]]
    points: dict[int, list[float]]


class _Reader:
    """Reads a program, and those that it calls."""

    def __init__(self, beside: Beside, comments: list[str], course: Course) -> None:
        self._beside, self._comments, self._course = beside, comments, course
        self._programs: dict[str, _Program] = {}
        self._running: list[_Program] = []
        self._external: dict[tuple[str, int], dict[str, float]] = {}

        def has(pattern: str) -> re.Pattern[str]:
            return re.compile(pattern, re.IGNORECASE | re.ASCII)

        self._rules = Rules(
            (
                (re.compile(r"(?:!|//|--).*|"), lambda number, match: None),
                (
                    has(
                        rf"J\s+P\[\s*(\d+)\s*(?::[^\]]*)?\]\s+({NUMBER})\s*(%|sec|msec)"
                        r"\s+(FINE|CNT\s*\d+)(\s+ACC\s*\d+)?"
                    ),
                    self._move,
                ),
                (has(r"CALL\s+(\w+)"), self._call),
                (has(rf"WAIT\s+({NUMBER})\s*\(sec\)"), self._wait),
                (
                    has(r"(WAIT)\s+(?!.*\b(?:TIMEOUT|LBL)\b)[^;]*[=<>][^;]*|(PAUSE)"),
                    lambda number, match: course.pause(number, match[1] or match[2]),
                ),
                (has(r"(ABORT)"), self._abort),
                (has(r"END"), lambda number, match: True),
                (has(rf"(OVERRIDE)\s*=\s*{NUMBER}\s*%"), self._with(course.speed)),
                (
                    has(r"((?:UFRAME|UTOOL)_NUM)\s*=\s*\d+|(PAYLOAD)\s*\[\s*\d+\s*\]"),
                    self._with(course.setting),
                ),
                (has(rf"(?=(\w+))(?:{_PASSED})"), self._with(course.passed)),
            ),
            "joint moves (J P[…] with a speed or time, FINE or CNT) one after the other",
        )

    def read(self, text: str) -> _Program:
        """Read a program."""
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
        tail = first + parts["MN"].count("\n") - 1
        points = self._points(name[1].upper(), parts["POS"].partition("\n")[2], tail + 1)
        program = _Program(name[1], self._rules.read(statements), points)
        used = {int(match[1]) for _, act, match in program.acts if act == self._move}
        if unused := sorted(set(points) - used):
            raise InvalidInput(
                f"{name[1]}: no line moves to P[{unused[0]}]; a line was lost, or the point is "
                "left over."
            )
        return program

    def run(self, program: _Program) -> None:
        """Execute a program."""
        check_callers([each.name.upper() for each in (*self._running, program)])
        self._running.append(program)
        left = 0
        for number, act, match in program.acts:
            if left:
                raise InvalidInput(
                    f"this never runs, since line {left} ends {program.name}.", line=number
                )
            self._course.step(number)
            left = number if act(number, match) else 0
        self._running.pop()

    def _remark(self, number: int, statement: str) -> None:
        """Collect a remark; one that continues the remark above is joined with it."""
        if re.match("!|//|--", statement):
            text = statement.lstrip("!/-")
            if text.startswith(_MORE) and self._comments:
                self._comments[-1] += " " + text.removeprefix(_MORE)
            else:
                self._comments.append(text)
        elif not statement.isascii():
            raise refuse(number, statement, "expected ASCII characters outside remarks.")

    def _move(self, number: int, match: re.Match[str]) -> None:
        point, program = int(match[1]), self._running[-1]
        if point not in program.points:
            raise refuse(number, match[0], f"there is no P[{point}] under /POS.")
        if match[4].upper() not in ("FINE", "CNT0"):
            self._course.rounds(number, match[4])
        if match[5]:
            self._course.speed(number, "ACC")
        self._course.external(number, self._external[program.name.upper(), point])
        value, unit = float(match[2]), match[3].lower()
        seconds = {"%": None, "sec": value, "msec": 1e-3 * value}[unit]
        self._course.move(number, program.points[point], seconds)

    def _wait(self, number: int, match: re.Match[str]) -> None:
        self._course.wait(number, float(match[1]))

    def _abort(self, number: int, match: re.Match[str]) -> bool:
        self._course.ends(number, match[1])
        return True

    def _with(self, note: Callable[[int, str], None]) -> Act:
        """A statement that does not move the robot: its expressions call nothing."""

        def act(number: int, match: re.Match[str]) -> None:
            word = next(group for group in match.groups() if group)
            if word.upper() != "MESSAGE" and re.search(r"\b(CALL|RUN|JMP)\b", match[0], re.I):
                raise refuse(number, match[0], "calls something in an expression.")
            note(number, word)

        return act

    def _call(self, number: int, match: re.Match[str]) -> None:
        name = match[1].upper()
        if name not in self._programs:
            content = self._beside(f"{match[1]}.ls")
            if content is None:
                raise refuse(number, match[0], f"there is no {match[1]}.ls beside the file.")
            with of_file(f"{match[1]}.ls"):
                self._programs[name] = self.read("\n".join(text_lines(content)))
        with of_file(f"{match[1]}.ls"):
            self.run(self._programs[name])

    def _points(self, name: str, tail: str, first: int) -> dict[int, list[float]]:
        """The joint angles of the points by number."""
        found: dict[int, list[float]] = {}
        for match in _POINT.finditer(tail):
            number = first + tail.count("\n", 0, match.start())
            point, inside = int(match[1]), match[2]
            if point in found:
                raise InvalidInput(f"P[{point}] stands twice.", line=number)
            if re.search(r"\b[XYZ]\s*=", inside):
                raise InvalidInput(
                    f"P[{point}] is Cartesian; only joint angles J1 to J6 can be checked.",
                    line=number,
                )
            axes: dict[str, float] = {}
            for group, _, axis, value, unit in _FIELD.findall(inside):
                if group and group != "1":
                    raise InvalidInput(f"P[{point}] moves more than one motion group.", line=number)
                if axis and unit not in ("deg", *(["mm"] if axis[0] == "E" else [])):
                    raise InvalidInput(
                        f"P[{point}], {axis}: the unit is {unit or 'missing'!r}; expected deg.",
                        line=number,
                    )
                if axis in axes:
                    raise InvalidInput(f"P[{point}]: {axis} stands twice.", line=number)
                if axis:
                    axes[axis] = number_of(number, value, f"an angle of {axis}")
            if left := _FIELD.sub("", inside).replace(",", " ").strip():
                raise InvalidInput(f"P[{point}]: {left[:60]!r} is not read.", line=number)
            if sorted(axis for axis in axes if axis[0] == "J") != list(LS.axis_names):
                raise InvalidInput(f"P[{point}]: expected J1 to J{AXES}.", line=number)
            found[point] = [axes[axis] for axis in LS.axis_names]
            self._external[name, point] = {axis: axes[axis] for axis in axes if axis[0] == "E"}
        left = _POINT.sub("", tail).strip()
        if left:
            raise InvalidInput(f"under /POS, something is left that is no point: {left[:60]!r}.")
        return found


def _statements(body: str, first: int) -> list[tuple[int, str]]:
    """The statements of a program, each with its line in the file.

    A statement ends with a semicolon, and stands on one line or, except a remark, on several.

    Raises:
        InvalidInput: If a number or a semicolon is missing.
    """
    found: list[tuple[int, str]] = []
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
