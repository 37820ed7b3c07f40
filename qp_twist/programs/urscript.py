"""URScript, of Universal Robots.

URScript has no move along a cubic, so a program brings its own: the function ``cubic`` (or
``line``) evaluates the motion in every step of the controller and streams it by ``servoj``.

Source: Universal Robots, *The URScript Programming Language*, modules *motion* and *internals*.
"""

from __future__ import annotations

import math
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


_NAME = r"[A-Za-z_]\w*"
_OWN = ("start", "cubic", "line", "finish")
_MOVEJ = ("q", "a", "v", "t", "r")
_SERVOJ = ("q", "a", "v", "t", "lookahead_time", "gain")
_FUNCTIONS = {
    # outputs and messages: they neither move the robot nor change a target
    "passed": (
        "set_digital_out", "set_standard_digital_out", "set_configurable_digital_out",
        "set_tool_digital_out", "set_analog_out", "set_standard_analog_out", "set_flag",
        "write_output_boolean_register", "write_output_integer_register",
        "write_output_float_register", "textmsg", "set_tool_voltage", "set_tool_communication",
        "set_tool_output_mode", "set_tool_digital_output_mode", "set_tool_analog_input_domain",
        "set_standard_analog_input_domain", "set_analog_outputdomain",
        "set_input_actions_to_default", "zero_ftsensor",
    ),
    # tool and load: a joint position is the same with all of them
    "setting": (
        "set_tcp", "set_payload", "set_payload_cog", "set_payload_mass", "set_target_payload",
        "set_gravity",
    ),
    "pause": ("sync", "popup"),
}  # fmt: skip
CALLS = {kind: (rf"({'|'.join(names)})\s*\((.*)\)",) for kind, names in _FUNCTIONS.items()}
ASSIGNMENT = (
    rf"(?:(?:global|local)\s+)?(?P<name>{_NAME})(?P<part>(?:\s*\[[^\]]*\])*)\s*=(?!=)"
    r"(?P<value>.+)"
)
_WORDS = {
    *(name for names in _FUNCTIONS.values() for name in names), "movej", "servoj", "stopj",
    "sleep", "halt", "d2r", "end", "return", "True", "False",
}  # fmt: skip
_BACKWARDS = "the functions that move the robot are not those that qp_twist writes; export the "
_READS = "joint moves (movej, servoj) to literals or constants, one after the other,"


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a script is one file
    lines = [line.rstrip() for line in text.split("\n")]
    header = read_header([line.strip()[1:] for line in lines if line.strip().startswith("#")])
    first = _own_functions(lines)
    statements: Statements = []
    for number, line in enumerate(lines, start=1):
        if first is None or not first[0] <= number - 1 < first[1]:
            code = without_texts(number, line, "\"'", "#")[0]
            statements += [(number, part.strip()) for part in code.split(";") if part.strip()]
    own = first is not None and _OwnScript(statements[0][1][len("def ") : -len("():")], first[2])
    script = own or _Script()
    script.execute(statements)
    return script.course.moves(header)


def _own_functions(lines: list[str]) -> tuple[int, int, str] | None:
    """Where the functions that this package writes begin and end, and which; ``None`` without.

    They are recognised literally, where the package writes them: as the first lines of the only
    function. What they do with their variables is therefore known.
    """
    code = [k for k, line in enumerate(lines) if line.strip() and line.strip()[0] != "#"]
    if code and re.fullmatch(rf"def {_NAME}\(\):", lines[code[0]], re.ASCII):
        begin = code[0] + 1
        for kind in _TERMS:
            block = _functions(kind).rstrip("\n").split("\n")
            if lines[begin : begin + len(block)] == block:
                return begin, begin + len(block), kind
    return None


class _Calculating(Program):
    """URScript's expressions: numbers, ``d2r(90)``, lists of six."""

    reads = _READS
    flags = re.ASCII | re.DOTALL  # capitals count
    twice = "assigned", "constants"
    reserved = _WORDS

    def execute(self, statements: Statements) -> None:
        """Execute a script.

        Raises:
            InvalidInput: At a statement that is not read.
        """
        raise NotImplementedError

    def check(self, number: int, statement: str, text: str) -> None:
        """Refuse a call other than ``d2r``."""
        super().check(number, statement, re.sub(rf"\bd2r\(\s*{NUMBER}\s*\)", "0", text))

    def name_of(self, name: str) -> str:
        """Capitals count."""
        return name


class _OwnScript(_Calculating):
    """A script with the functions of this package: start, moves, finish, and nothing between.

    The functions remember where they are and how late. Only outputs and messages may stand between
    them: those neither take time nor write to their variables.
    """

    reads = "start, the moves and finish, as they were written, with outputs between them"
    noted = {"passed": CALLS["passed"]}  # noqa: RUF012

    def __init__(self, name: str, kind: str) -> None:
        super().__init__()
        self._name, self._kind = name, kind
        self._expected = ["start"]

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Calls of the functions, the end, and outputs."""
        return (
            (rf"({'|'.join((*_OWN, self._name))})\s*\((.*)\)", self._move),
            (r"(end)()", self._move),
            *((pattern, self._between(act)) for pattern, act in self.noting()),
        )

    def execute(self, statements: Statements) -> None:
        """Read the whole script.

        Raises:
            InvalidInput: At any other statement.
        """
        name = self._name
        if name in {*_WORDS, *_OWN, "at_q", "at_w", "late"}:
            raise refuse(*statements[0], "a name of the functions below; export it under another.")
        self.parse("", Procedure(name, 1, statements[1:]))
        self.run("")
        if name not in self._expected and self._expected:
            last = self._expected[-1]
            raise InvalidInput(f"the script has no {last} at its end; a line was lost.")

    def _move(self, number: int, match: re.Match[str]) -> None:
        word, arguments = match[1], [each for each in split(match[2]) if each]
        name, expected = self._name, self._expected
        if not expected:
            often = f"a script of export calls its function at most once; remove this {name}()."
            raise refuse(
                number, match[0], often if word == name else f"expected nothing after {name}."
            )
        if word not in expected:
            raise refuse(number, match[0], f"expected {' or '.join(expected)} here.")
        count = {"start": 2, "cubic": 3, "line": 2}.get(word, 0)
        if len(arguments) != count:
            raise refuse(number, match[0], f"expected {count} arguments.")
        following = {"finish": ["end"], "end": [name], name: []}
        self._expected = following.get(word, [self._kind, "finish"])
        if word not in following:
            point = six(number, _elements(number, arguments[0]))
            cubic = self._kind == "cubic"
            rates = six(number, _elements(number, arguments[1])) if cubic else None
            seconds = None if word == "start" else number_of(number, arguments[-1])
            self.course.move(number, point, seconds, rates)

    def _between(self, act: Act) -> Act:
        """The act of an output, which is refused after the functions."""

        def checked(number: int, match: re.Match[str]) -> bool | None:
            if self._name in self._expected or not self._expected:
                raise refuse(number, match[0], f"expected nothing after {self._name}.")
            return act(number, match)

        return checked


class _Script(_Calculating):
    """A script of anyone."""

    begins = rf"def\s+(?P<name>{_NAME})\s*\((?P<arguments>.*)\)\s*:"
    ends, nested = "end", True
    data = (ASSIGNMENT,)
    noted = CALLS

    def __init__(self) -> None:
        super().__init__()
        self._blended = False

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Moves, waits, settings, outputs, constants and calls."""
        return (
            (r"(movej|servoj)\s*\((.*)\)", self._move),
            (
                r"sleep\s*\((.*)\)",
                lambda number, match: self.course.wait(number, self._value(number, match[1])),
            ),
            (r"(halt)(?:\s*\(\s*\))?", self.end),
            (r"(stopj)\s*\((.*)\)", self._stop),
            *self.noting(),
            (ASSIGNMENT, self._assign),
            (rf"({_NAME})\s*\(\s*\)", self.calling("calls something that the file does not have.")),
        )

    def execute(self, statements: Statements) -> None:
        """Execute a script: its statements outside functions, or else its only function."""
        for number, statement in statements:
            if re.match(r"(?:def\s+)?(?:start|cubic|line)\s*\(.*[,\w].*\)\s*:?$", statement):
                raise refuse(number, statement, f"{_BACKWARDS}trajectory again.")
        top, first = self.sort(statements), ""
        if not self.procedures[""].statements:
            del self.procedures[""]
            if len(top) != 1:
                raise InvalidInput(
                    f"the script defines {', '.join(top) or 'nothing'} and calls nothing, so that "
                    "nothing says what runs; add a call at its end."
                )
            first = top[0]
        self.parse_all()
        self.run(first)
        self.note_calls()

    def _assign(self, number: int, match: re.Match[str]) -> None:
        """A variable: a number or a list of them is a constant if it is assigned only here."""
        name, part, text = match["name"], match["part"], match["value"].strip()
        if name in _WORDS or name in self.procedures:
            raise refuse(number, match[0], "this name has a meaning already.")
        self.check(number, match[0], part + text)
        listed = re.fullmatch(r"\[([^\[\]]*)\]", text)
        elements = split(listed[1]) if listed else [text]
        count = AXES if listed else 1
        if not part and len(elements) == count and all(map(_is_number, elements)):
            self.values[name] = text
        else:
            self.course.passed(number, name)

    def _move(self, number: int, match: re.Match[str]) -> None:
        """A ``movej`` or ``servoj``, with arguments by position or by name."""
        names = _MOVEJ if match[1] == "movej" else _SERVOJ
        given: dict[str, str] = {}
        for place, argument in enumerate(split(match[2])):
            named = re.fullmatch(rf"({_NAME})\s*=\s*(.+)", argument, re.ASCII)
            key = named[1] if named else (names[place] if place < len(names) else "")
            if key not in names or key in given:
                raise refuse(number, argument, f"expected the arguments {', '.join(names)}.")
            given[key] = named[2] if named else argument
        target = given.pop("q", "").strip()
        values = {key: self._value(number, text) for key, text in given.items()}
        seconds = values.get("t", 0.0)
        self._blended = values.get("r", 0.0) > 0.0
        if self._blended:
            self.course.rounds(number, f"r={values['r']:g}")
        point = self._target(number, target)
        self.course.move(number, point, seconds if seconds > 0.0 else None)

    def _target(self, number: int, target: str) -> list[float]:
        if target.startswith(("p[", "get_inverse_kin")):
            raise refuse(number, target, "a pose; only joint positions [q1, …, q6] can be checked.")
        text = target
        if re.fullmatch(_NAME, target, re.ASCII):
            text = self.constant(number, target, target, _NO_CONSTANT)
            if _is_number(text):
                raise refuse(number, target, "a number; expected joint positions, [q1, …, q6].")
        point = [self._value(number, value) for value in _elements(number, text)]
        if max(map(abs, point)) > 4.0 * math.pi:
            raise refuse(number, target, "more than two turns; URScript takes rad, not degrees.")
        return point

    def _value(self, number: int, text: str) -> float:
        """A number, also as ``d2r(90)`` or by name."""
        text = text.strip()
        if re.fullmatch(_NAME, text, re.ASCII):
            value = self.constant(number, text, text, _NO_CONSTANT)
            text = value if _is_number(value) else text
        if match := re.fullmatch(r"d2r\((.*)\)", text):
            return math.radians(number_of(number, match[1]))
        return number_of(number, text)

    def _stop(self, number: int, match: re.Match[str]) -> None:
        self.check(number, match[0], match[2])
        self.course.passed(number, match[1])
        if self._blended:
            raise refuse(number, match[0], "stops the robot before it is where it was sent (r>0).")


_NO_CONSTANT = "expected a number or joint positions, [q1, …, q6], assigned above."


def _is_number(text: str) -> bool:
    return bool(re.fullmatch(rf"{NUMBER}|d2r\(\s*{NUMBER}\s*\)", text, re.ASCII))


def _elements(number: int, text: str) -> list[str]:
    match = re.fullmatch(r"\[(.*)\]", text.strip())
    if not match:
        raise refuse(number, text, "expected a list of joint positions, [q1, …, q6].")
    elements = split(match[1])
    if len(elements) != AXES:
        raise refuse(number, text, f"expected {AXES} joint positions, got {len(elements)}.")
    return elements


def _stopped(text: str, why: str) -> str:
    """A script that stops at its first line, and at the first of its function.

    A controller that takes a script from a socket runs the function by itself, whatever is before.
    """
    before, define, after = text.partition("\ndef ")
    name, end, body = after.partition("\n")
    return f"{why}\n{before}{define}{name}{end}  halt  # {why}\n{body}"


URSCRIPT = Dialect(
    "urscript", "URScript", ".script", "rad", 10, 9,
    ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    True, _check_name, _encode, _decode, _stopped,
)  # fmt: skip
"""URScript."""
