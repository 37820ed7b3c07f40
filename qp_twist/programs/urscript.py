"""URScript, of Universal Robots.

URScript has no move along a cubic, so a program brings its own: the function ``cubic`` (or
``line``) evaluates the motion in every step of the controller and streams it by ``servoj``.

Source: Universal Robots, *The URScript Programming Language*, modules *motion* and *internals*.
"""

from __future__ import annotations

import math
import re

from qp_twist.errors import InvalidInput
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Course,
    Rules,
    check_identifier,
    nothing,
    refuse,
    shown,
    six,
)

_TERMS = {
    "cubic": "a * at_q[{0}] + b * q[{0}] + c * at_w[{0}] + d * w[{0}]",
    "line": "(1 - s) * at_q[{0}] + s * q[{0}]",
}
_SERVO = "0, 0, get_steptime(), 0.03, 2000"
"""servoj: acceleration and speed (not used), time, look-ahead time, gain."""
_START = """\
  # Where the last move ended, at which rates, and how far the clock is past its end.
  global at_q = [0, 0, 0, 0, 0, 0]
  global at_w = [0, 0, 0, 0, 0, 0]
  global late = 0
  def start(q, w):
    movej(q, a=0.5, v=0.25)
    at_q = q
    at_w = w
  end
"""
_CUBIC = """\
  # To q at rates w in T s: every joint on a cubic.
  def cubic(q, w, T):
    t = late
    while t < T:
      s = t / T
      a = (1 + 2 * s) * (1 - s) * (1 - s)
      b = s * s * (3 - 2 * s)
      c = T * s * (1 - s) * (1 - s)
      d = T * s * s * (s - 1)
      servoj([{terms}], {servo})
      t = t + get_steptime()
    end
    late = t - T
    at_q = q
    at_w = w
  end
"""
_LINE = """\
  # To q in T s: every joint at constant speed.
  def line(q, T):
    t = late
    while t < T:
      s = t / T
      servoj([{terms}], {servo})
      t = t + get_steptime()
    end
    late = t - T
    at_q = q
  end
"""
_FINISH = f"""\
  def finish():
    servoj(at_q, {_SERVO})
    stopj(2)
  end
"""


def _functions(kind: str) -> str:
    terms = ",\n              ".join(_TERMS[kind].format(axis) for axis in range(AXES))
    move = {"cubic": _CUBIC, "line": _LINE}[kind]
    return _START + move.format(terms=terms, servo=_SERVO) + _FINISH


def _check_name(name: str) -> None:
    check_identifier(name, "URScript", 64, "a function's name")


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    decimals, time_decimals = URSCRIPT.decimals, URSCRIPT.time_decimals

    def listed(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.{decimals}f}" for value in values) + "]"

    kind = "line" if moves.velocities is None else "cubic"
    q = moves.angles.tolist()
    w = [[0.0] * AXES] * len(q) if moves.velocities is None else moves.velocities.tolist()
    lines = [f"# {line}" for line in header]
    lines += [f"def {name}():", _functions(kind).rstrip("\n")]
    lines.append(f"  start({listed(q[0])}, {listed(w[0])})")
    for point, rates, seconds in zip(q[1:], w[1:], moves.durations.tolist(), strict=True):
        rates_text = f"{listed(rates)}, " if kind == "cubic" else ""
        lines.append(f"  {kind}({listed(point)}, {rates_text}{seconds:.{time_decimals}f})")
    lines += ["  finish()", "end", ""]
    return {f"{name}{URSCRIPT.suffix}": "\n".join(lines)}


_OWN = ("start", "cubic", "line", "finish")
_ARGUMENT = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.+)")
_MOVEJ = ("q", "a", "v", "t", "r")
_SERVOJ = ("q", "a", "v", "t", "lookahead_time", "gain")


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a script is one file
    lines = [line.rstrip() for line in text.splitlines()]
    header = read_header([line.strip()[1:] for line in lines if line.strip().startswith("#")])
    ours = _own_functions(lines)
    statements = [
        (number, line.split("#", 1)[0].strip())
        for number, line in enumerate(lines, start=1)
        if number - 1 not in ours
    ]
    moving = re.compile(rf"\s*(?:{'|'.join(_OWN[:3])})\s*\(")
    for number, line in enumerate(lines, start=1):
        if not ours and moving.match(line):
            raise refuse(
                number, line,
                "the functions that move the robot are not those that qp_twist writes; export the "
                "trajectory again.",
            )  # fmt: skip
    reader = _Reader()
    reader.rules.follow([each for each in statements if each[1]], reader.course)
    return reader.course.moves(header)


class _Reader:
    """Reads the statements of a script.

    Attributes:
        course: The points so far.
        rules: What statements are.
    """

    def __init__(self) -> None:
        self.course = Course()
        self._lists: dict[str, list[float]] = {}
        self._defined: set[str] = set()
        self.rules = Rules(
            (
                (re.compile("end"), nothing),
                (re.compile(r"def\s+([A-Za-z_]\w*)\s*\(\s*\)\s*:"), self._define),
                (re.compile(rf"({'|'.join(_OWN)})\s*\((.*)\)"), self._own_move),
                (re.compile(r"(movej|servoj)\s*\((.*)\)"), self._joint_move),
                (re.compile(r"sleep\s*\((.*)\)"), self._sleep),
                (re.compile(r"(?:(?:global|local)\s+)?(\w+)\s*=\s*\[(.*)\]"), self._list),
                (re.compile(r"([A-Za-z_]\w*)\s*\(\s*\)"), self._call),
            ),
            re.compile(
                r"\b(move[lpc]|move_\w+|servoc|servol|speed[jl]|force_mode|freedrive_mode"
                r"|teach_mode|conveyor_\w+|path_\w+|if|elif|else|for|while|loop|thread|run|return"
                r"|interpreter_mode)\b"
            ),
            re.compile(
                r"((?:set_\w+|textmsg|popup|stopj|stopl|modbus_\w+|socket_\w+|rtde_\w+|write_\w+"
                r"|request_\w+)(?=\s*\()|(?:(?:global|local)\s+)?[A-Za-z_]\w*(?=\s*=(?!=)))"
            ),
            "joint moves (movej, servoj) one after the other",
        )

    def _define(self, number: int, match: re.Match[str]) -> None:
        self._defined.add(match[1])

    def _call(self, number: int, match: re.Match[str]) -> None:
        if match[1] in self._defined:
            return
        if match[1] not in ("sync", "zero_ftsensor", "halt"):
            raise refuse(number, match[0], "calls something that the file does not have.")
        self.course.passed(number, match[1])

    def _sleep(self, number: int, match: re.Match[str]) -> None:
        self.course.wait(number, _value(number, match[1]))

    def _list(self, number: int, match: re.Match[str]) -> None:
        values = _split(match[2])
        if len(values) == AXES:
            self._lists[match[1]] = [_value(number, value) for value in values]
        self.course.passed(number, match[1])

    def _own_move(self, number: int, match: re.Match[str]) -> None:
        word, arguments = match[1], [a for a in _split(match[2]) if a]
        expected = {"start": 2, "cubic": 3, "line": 2, "finish": 0}[word]
        if len(arguments) != expected:
            raise refuse(number, match[0], f"expected {expected} arguments.")
        if word == "finish":
            return
        if (word == "start") == bool(self.course.points):
            raise refuse(number, match[0], "expected start(…) once, before the first move.")
        point = six(number, _elements(number, arguments[0]))
        rates = None if word == "line" else six(number, _elements(number, arguments[1]))
        if word == "line":
            self.course.velocities = []  # the rates of the start
        seconds = None if word == "start" else _value(number, arguments[-1])
        self.course.move(number, point, seconds, rates)

    def _joint_move(self, number: int, match: re.Match[str]) -> None:
        """A ``movej`` or ``servoj``, with arguments by position or by name."""
        names = _MOVEJ if match[1] == "movej" else _SERVOJ
        given: dict[str, str] = {}
        for place, argument in enumerate(_split(match[2])):
            named = _ARGUMENT.fullmatch(argument)
            key = named[1] if named else (names[place] if place < len(names) else "")
            if key not in names or key in given:
                raise refuse(number, argument, f"expected the arguments {', '.join(names)}.")
            given[key] = named[2] if named else argument
        target = given.get("q", "").strip()
        if target.startswith(("p[", "get_inverse_kin")):
            raise refuse(number, target, "a pose; only joint positions [q1, …, q6] can be checked.")
        point = self._lists.get(target)
        if point is None:
            point = [_value(number, value) for value in _elements(number, target)]
        if max(map(abs, point)) > 4.0 * math.pi:
            raise refuse(number, target, "more than two turns; URScript takes rad, not degrees.")
        seconds = _value(number, given["t"]) if "t" in given else 0.0
        if _value(number, given.get("r", "0")) > 0.0 and not self.course.notes:
            self.course.notes.append(
                f"blend radii from line {number} on: the robot rounds these points; checked is the "
                "path through them"
            )
        self.course.move(number, point, seconds if seconds > 0.0 else None)


def _own_functions(lines: list[str]) -> set[int]:
    """Indices of the lines of the functions that this package writes; empty if there are none."""
    for kind in ("cubic", "line"):
        block = _functions(kind).rstrip("\n").split("\n")
        for first in range(len(lines) - len(block) + 1):
            if lines[first : first + len(block)] == block:
                return set(range(first, first + len(block)))
    return set()


def _elements(number: int, text: str) -> list[str]:
    match = re.fullmatch(r"\[(.*)\]", text.strip())
    if not match:
        raise refuse(number, text, "expected a list of joint positions, [q1, …, q6].")
    elements = _split(match[1])
    if len(elements) != AXES:
        raise refuse(number, text, f"expected {AXES} joint positions, got {len(elements)}.")
    return elements


def _value(number: int, text: str) -> float:
    """A number, also as ``d2r(90)``."""
    text = text.strip()
    match = re.fullmatch(rf"d2r\(\s*({NUMBER})\s*\)", text)
    if match:
        return math.radians(float(match[1]))
    if not re.fullmatch(NUMBER, text) or not math.isfinite(float(text)):
        raise InvalidInput(f"line {number}: {shown(text)}: expected a number.")
    return float(text)


def _split(text: str) -> list[str]:
    """Arguments at commas outside brackets; one empty text for nothing."""
    parts, depth, start = [], 0, 0
    for place, mark in enumerate(text):
        depth += (mark in "[(") - (mark in "])")
        if mark == "," and depth == 0:
            parts.append(text[start:place].strip())
            start = place + 1
    return [*parts, text[start:].strip()]


URSCRIPT = Dialect(
    "urscript", "URScript", ".script", "rad", 10, 9,
    ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    True, _check_name, _encode, _decode,
)  # fmt: skip
"""URScript."""
