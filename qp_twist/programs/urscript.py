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
_PASSED = (
    "set_digital_out", "set_standard_digital_out", "set_configurable_digital_out",
    "set_tool_digital_out", "set_analog_out", "set_standard_analog_out", "set_flag",
    "write_output_boolean_register", "write_output_integer_register",
    "write_output_float_register", "textmsg", "set_tool_voltage", "set_tool_communication",
    "set_tool_output_mode", "set_tool_digital_output_mode", "set_tool_analog_input_domain",
    "set_standard_analog_input_domain", "set_analog_outputdomain", "set_input_actions_to_default",
    "zero_ftsensor",
)  # fmt: skip
"""Functions for outputs and messages: they neither move the robot nor change a target."""
_SETTINGS = (
    "set_tcp", "set_payload", "set_payload_cog", "set_payload_mass", "set_target_payload",
    "set_gravity",
)  # fmt: skip
"""Functions for tool and load: a joint position is the same with all of them."""
_WORDS = {
    *_PASSED, *_SETTINGS, "movej", "servoj", "stopj", "sleep", "sync", "popup", "halt", "d2r",
    "end", "return", "True", "False",
}  # fmt: skip
"""Names to which a script may not give another meaning."""
_BACKWARDS = "the functions that move the robot are not those that qp_twist writes; export the "
_READS = "joint moves (movej, servoj) to literals or constants, one after the other,"
_Statements = list[tuple[int, str]]


def _decode(text: str, beside: Beside) -> JointMoves:
    del beside  # a script is one file
    lines = [line.rstrip() for line in text.split("\n")]
    header = read_header([line.strip()[1:] for line in lines if line.strip().startswith("#")])
    first = _own_functions(lines)
    statements: _Statements = []
    for number, line in enumerate(lines, start=1):
        if first is None or not first[0] <= number - 1 < first[1]:
            code = without_texts(number, line, "\"'", "#")[0]
            statements += [(number, part.strip()) for part in code.split(";") if part.strip()]
    course = Course()
    if first is None:
        _Reader(course).execute(statements)
    else:
        _read_own(statements, course, first[2])
    return course.moves(header)


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


def _read_own(statements: _Statements, course: Course, kind: str) -> None:
    """A script with the functions of this package: start, moves, finish, and nothing between.

    The functions remember where they are and how late. Only outputs and messages may stand between
    them: those neither take time nor write to their variables.

    Raises:
        InvalidInput: At any other statement.
    """
    name = statements[0][1][len("def ") : -len("():")]
    if name in {*_WORDS, *_OWN, "at_q", "at_w", "late"}:
        raise refuse(*statements[0], "a name of the functions below; export it under another.")
    expected = ["start"]

    def move(number: int, match: re.Match[str]) -> None:
        word, arguments = match[1], [each for each in split(match[2]) if each]
        if not expected:
            often = f"a script of export calls its function at most once; remove this {name}()."
            raise refuse(
                number, match[0], often if word == name else f"expected nothing after {name}."
            )
        if word not in expected:
            raise refuse(number, match[0], f"expected {' or '.join(expected)} here.")
        count = {"start": 2, "cubic": 3, "line": 2, "finish": 0, "end": 0, name: 0}[word]
        if len(arguments) != count:
            raise refuse(number, match[0], f"expected {count} arguments.")
        following = {"finish": ["end"], "end": [name], name: []}
        expected[:] = following.get(word, [kind, "finish"])
        if word not in following:
            point = six(number, _elements(number, arguments[0]))
            rates = six(number, _elements(number, arguments[1])) if kind == "cubic" else None
            seconds = None if word == "start" else number_of(number, arguments[-1])
            course.move(number, point, seconds, rates)

    def pass_over(number: int, match: re.Match[str]) -> None:
        if name in expected or not expected:
            raise refuse(number, match[0], f"expected nothing after {name}.")
        _pass(course, number, match)

    rules = Rules(
        (
            (re.compile(rf"({'|'.join((*_OWN, name))})\s*\((.*)\)", re.ASCII), move),
            (re.compile(r"(end)()"), move),
            (_call_of(_PASSED), pass_over),
        ),
        "start, the moves and finish, as they were written, with outputs between them",
    )
    for number, act, match in rules.read(statements[1:]):
        course.step(number)
        act(number, match)
    if name not in expected and expected:
        raise InvalidInput(f"the script has no {expected[-1]} at its end; a line was lost.")


def _call_of(names: tuple[str, ...]) -> re.Pattern[str]:
    return re.compile(rf"({'|'.join(names)})\s*\((.*)\)", re.ASCII)


def _pass(course: Course, number: int, match: re.Match[str]) -> None:
    _simple(number, match[0], match[2])
    course.passed(number, match[1])


class _Reader:
    """Reads the statements of a script.

    Attributes:
        course: The points so far.
        rules: The grammar.
    """

    def __init__(self, course: Course) -> None:
        self.course = course
        self._values: dict[str, list[float] | float] = {}
        self._assigned: dict[str, list[int]] = {}
        self._functions: dict[str, Procedure] = {}
        self._calls: Calls | None = None
        self._blended = False
        self.rules = Rules(
            (
                (re.compile(r"(movej|servoj)\s*\((.*)\)", re.ASCII), self._move),
                (re.compile(r"sleep\s*\((.*)\)"), self._sleep),
                (re.compile(r"(sync|popup)\s*\((.*)\)"), self._pause),
                (re.compile(r"(halt)(?:\s*\(\s*\))?"), self._halt),
                (_call_of(("stopj",)), self._stop),
                (_call_of(_SETTINGS), self._setting),
                (_call_of(_PASSED), lambda number, match: _pass(course, number, match)),
                (_ASSIGNMENT, self._assign),
                (re.compile(rf"({_NAME})\s*\(\s*\)", re.ASCII), self._call),
            ),
            _READS,
        )

    def execute(self, statements: _Statements) -> None:
        """Execute a script: its statements outside functions, or else its only function."""
        top = self._nested(statements)
        for procedure in self._functions.values():
            for number, statement in procedure.statements:
                match = _ASSIGNMENT.fullmatch(statement)
                if match:
                    self._assigned.setdefault(match[1], []).append(number)
        main = self._functions.pop("")
        if main.statements:
            self._functions[""] = main
            first = ""
        elif len(top) == 1:
            first = top[0]
        else:
            raise InvalidInput(
                f"the script defines {', '.join(top) or 'nothing'} and calls nothing, so that "
                "nothing says what runs; add a call at its end."
            )
        self._calls = Calls(self.rules, self.course, self._functions)
        self._calls.run(first)
        self._calls.note_numbers()

    def _nested(self, statements: _Statements) -> list[str]:
        """Sort statements into functions; the names of those that stand in no other."""
        top: list[str] = []
        self._functions[""] = Procedure("the script", 1, [])
        inside = [""]
        for number, statement in statements:
            if match := re.fullmatch(rf"def\s+({_NAME})\s*\((.*)\)\s*:", statement, re.ASCII):
                name = match[1]
                if name in _OWN and match[2].strip():
                    raise refuse(number, statement, f"{_BACKWARDS}trajectory again.")
                if match[2].strip():
                    raise refuse(number, statement, "functions with arguments are not read.")
                if name in _WORDS or name in self._functions:
                    raise refuse(number, statement, "this name has a meaning already.")
                self._functions[name] = Procedure(name, number, [])
                if len(inside) == 1:
                    top.append(name)
                inside.append(name)
            elif statement == "end":
                if len(inside) == 1:
                    raise refuse(number, statement, "there is no def above that it ends.")
                inside.pop()
            elif re.match(r"(?:start|cubic|line)\s*\(.*,", statement):
                raise refuse(number, statement, f"{_BACKWARDS}trajectory again.")
            else:
                self._functions[inside[-1]].statements.append((number, statement))
        if len(inside) > 1:
            raise InvalidInput(f"the function {inside[-1]} has no end; a line was lost.")
        return top

    def _call(self, number: int, match: re.Match[str]) -> None:
        if match[1] not in self._functions:
            raise refuse(number, match[0], "calls something that the file does not have.")
        assert self._calls is not None
        self._calls.run(match[1])

    def _assign(self, number: int, match: re.Match[str]) -> None:
        """A variable: a number or a list of them is a constant if it is assigned only here."""
        name, part, text = match[1], match[2], match[3].strip()
        if name in _WORDS or name in self._functions:
            raise refuse(number, match[0], "this name has a meaning already.")
        _simple(number, match[0], part + text)
        elements = split(text[1:-1]) if re.fullmatch(r"\[[^\[\]]*\]", text) else []
        if not part and _is_number(text):
            self._values[name] = self._value(number, text)
        elif not part and len(elements) == AXES and all(map(_is_number, elements)):
            self._values[name] = [self._value(number, element) for element in elements]
        else:
            self.course.passed(number, name)

    def _constant(self, number: int, name: str) -> list[float] | float:
        """The value of a variable that is assigned once, before this line is executed."""
        lines = self._assigned.get(name, [])
        if len(lines) > 1:
            raise refuse(
                number, name,
                f"is assigned in lines {', '.join(map(str, lines))}; only constants that are "
                "assigned once can be checked.",
            )  # fmt: skip
        if name not in self._values:
            raise refuse(
                number, name, "expected a number or joint positions, [q1, …, q6], assigned above."
            )
        return self._values[name]

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
        if re.fullmatch(_NAME, target, re.ASCII):
            value = self._constant(number, target)
            if isinstance(value, float):
                raise refuse(number, target, "a number; expected joint positions, [q1, …, q6].")
            point = value
        else:
            point = [self._value(number, value) for value in _elements(number, target)]
        if max(map(abs, point)) > 4.0 * math.pi:
            raise refuse(number, target, "more than two turns; URScript takes rad, not degrees.")
        return point

    def _value(self, number: int, text: str) -> float:
        """A number, also as ``d2r(90)`` or by name."""
        text = text.strip()
        if match := re.fullmatch(r"d2r\((.*)\)", text):
            return math.radians(number_of(number, match[1]))
        if re.fullmatch(_NAME, text, re.ASCII):
            value = self._constant(number, text)
            if isinstance(value, float):
                return value
        return number_of(number, text)

    def _sleep(self, number: int, match: re.Match[str]) -> None:
        self.course.wait(number, self._value(number, match[1]))

    def _pause(self, number: int, match: re.Match[str]) -> None:
        _simple(number, match[0], match[2])
        self.course.pause(number, match[1])

    def _halt(self, number: int, match: re.Match[str]) -> bool:
        self.course.ends(number, match[1])
        return True

    def _stop(self, number: int, match: re.Match[str]) -> None:
        _simple(number, match[0], match[2])
        if self._blended:
            raise refuse(number, match[0], "stops the robot before it is where it was sent (r>0).")
        self.course.passed(number, match[1])

    def _setting(self, number: int, match: re.Match[str]) -> None:
        _simple(number, match[0], match[2])
        self.course.setting(number, match[1])


_ASSIGNMENT = re.compile(
    rf"(?:(?:global|local)\s+)?({_NAME})((?:\s*\[[^\]]*\])*)\s*=(?!=)(.+)", re.ASCII
)


def _simple(number: int, statement: str, text: str) -> None:
    """Refuse an expression that calls a function other than ``d2r``: it might move the robot."""
    without_numbers = re.sub(rf"\bd2r\(\s*{NUMBER}\s*\)", "0", text)
    check_no_call(number, statement, without_numbers, _READS)


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
