"""URScript, of Universal Robots.

URScript has no move along a cubic, so a program brings its own: the function ``cubic`` (or
``line``) evaluates the motion in every step of the controller and streams it by ``servoj``.
Straight moves of the tool are ``movel``, or ``movep`` where the tool's speed is constant from stop
to stop; circles are ``movec`` in mode 0, in which the tool turns in proportion from begin to end.
Of their joint positions the controller computes the poses.

Source: Universal Robots, *The URScript Programming Language*, modules *motion*, *internals* and
*urmath*: poses ``p[x, y, z, rx, ry, rz]`` are m and a rotation vector, in the robot's base. Moves
whose blends overlap are left out with a warning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import (
    AXES,
    Beside,
    Circle,
    Dialect,
    JointMoves,
    ProgramFrame,
    Speed,
    Target,
    Turning,
    Zone,
)
from qp_twist.programs.moves import JointMove, Kind, Moves
from qp_twist.programs.program import Program
from qp_twist.programs.statements import Statements, by_name, refuse, split, without_texts
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import (
    LARGEST_NUMBER,
    Pose,
    Unknown,
    Values,
    fixed,
    list_literal,
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


_ACCELERATION = 1.2
"""Default of ``movel`` and ``movep``, m/s²."""
_BLEND = 0.9
"""Share of half of the shorter move at most for a blend, so that none overlap where the tool in the
controller differs a little."""
_MICRO = 1e-6
"""Of which blend radii, m, and speeds, m/s, are whole numbers."""


def _functions(kind: str) -> str:
    terms = ",\n              ".join(_TERMS[kind].format(axis) for axis in range(AXES))
    move = {"cubic": _CUBIC, "line": _LINE}[kind]
    return _START + move.format(terms=terms, servo=_SERVO) + _FINISH


def _behind(moves: JointMoves, point: int) -> list[str]:
    """Comments and calls behind a point; a call has the robot wait there, so that it has to rest.

    Raises:
        InvalidInput: If it moves there.
    """
    calls = [each.text for each in moves.around.get(point, ()) if each.call]
    inner = 0 < point < len(moves.angles) - 1
    if calls and inner and (moves.velocities is None or moves.velocities[point].any()):
        raise InvalidInput(
            f"{calls[0]} would be called at point {point + 1}, where the robot moves: a script "
            "waits until a function ends. Have the path begin or end there, or leave the call out "
            "of [program] (--calls)."
        )
    return moves.lines_behind(point, "  # {}", "  {}()")


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    decimals, time_decimals = URSCRIPT.decimals, URSCRIPT.time_decimals

    def listed(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.{decimals}f}" for value in values) + "]"

    kind = "line" if moves.velocities is None else "cubic"
    q = moves.angles.tolist()
    w = [[0.0] * AXES] * len(q) if moves.velocities is None else moves.velocities.tolist()
    times = [f"{seconds:.{time_decimals}f}" for seconds in moves.durations.tolist()]
    if moves.tcp is not None:
        text = URSCRIPT.tool_text(moves.tcp)
        header = (*header, f"The task's frame in the flange: {text}; compare it.")
    lines = [f"# {line}" for line in header] + [f"def {name}():"]
    if moves.straight is None:
        lines.append(_functions(kind).rstrip("\n"))
        lines.append(f"  start({listed(q[0])}, {listed(w[0])})")
        rates = [f"{listed(each)}, " if kind == "cubic" else "" for each in w]
        words = [f"{kind}({listed(at)}, {rate}" for at, rate in zip(q, rates, strict=True)]
        written = [f"{words[k + 1]}{time})" for k, time in enumerate(times)]
    else:
        lines.append(f"  movej({listed(q[0])}, a=0.5, v=0.25)")
        written = []
        for k, (word, how) in enumerate(_words_of(moves, times)):
            circle = moves.circles[k] if moves.circles else None
            via = f"{listed(circle.angles)}, " if circle and circle.angles else ""
            written.append(f"{word}({via}{listed(q[k + 1])}, {how})")
    lines += _behind(moves, 0)
    for k, statement in enumerate(written, start=1):
        lines += [f"  {statement}", *_behind(moves, k)]
    lines += ["  finish()"] if moves.straight is None else []
    return {f"{name}{URSCRIPT.suffix}": "\n".join([*lines, "end", ""])}


def _rounding(shares: Array, halves: Array) -> Array:
    """The shares of blend radii."""
    radii = _MICRO * np.floor(np.minimum(_BLEND, shares) * halves / _MICRO + 1e-9)
    return np.divide(radii, halves, out=np.zeros_like(shares), where=halves > 0.0)


def _words_of(moves: JointMoves, times: Sequence[str]) -> list[tuple[str, str]]:
    """Of each move its word, and its arguments behind the joint positions."""
    assert moves.halves is not None and moves.shares is not None and moves.straight is not None
    radii = moves.shares * moves.halves
    found = []
    for k, speed in enumerate(moves.speeds):
        a = moves.accelerations[k + 1]
        how = f"a={a:.6g}, v={speed.linear:.6f}" if speed else f"t={times[k]}"
        blend = f", r={radii[k + 1]:.6f}" if moves.shares[k + 1] else ""
        word = "movep" if moves.constant[k] else "movel" if moves.straight[k] else "movej"
        if moves.circles and moves.circles[k]:
            word, blend = "movec", f"{blend}, mode=0"
        found.append((word, how + blend))
    return found


_NAME = r"[A-Za-z_]\w*"
_NOTED: Mapping[Kind, Sequence[str]] = {
    # outputs and messages: they neither move the robot nor change a target
    "passed": (
        r"(set_(?:standard_|configurable_|tool_)?digital_out|set_(?:standard_)?analog_out|set_flag"
        r"|write_output_(?:boolean|integer|float)_register|textmsg|set_tool_voltage"
        r"|set_tool_communication|set_tool_output_mode|set_tool_digital_output_mode"
        r"|set_(?:tool|standard)_analog_input_domain|set_analog_outputdomain"
        r"|set_input_actions_to_default|zero_ftsensor)\s*\((.*)\)",
    ),
    # tool and load: a joint position is the same with all of them
    "setting": (r"(set_tcp|set_payload(?:_cog|_mass)?|set_target_payload|set_gravity)\s*\((.*)\)",),
    "pause": (r"(popup)\s*\((.*)\)",),
}
_ASSIGNMENT = (
    rf"(?:(?:global|local)\s+)?(?P<name>{_NAME})(?P<part>(?:\s*\[[^\]]*\])*)\s*=(?!=)"
    r"(?P<value>.+)"
)
_ARGUMENTS = {
    "movej": ("q", "a", "v", "t", "r"), "movel": ("pose", "a", "v", "t", "r"),
    "movep": ("pose", "a", "v", "r"), "movec": ("pose_via", "pose_to", "a", "v", "r", "mode"),
    "servoj": ("q", "a", "v", "t", "lookahead_time", "gain"),
}  # fmt: skip


_MODES: dict[float, Turning] = {0.0: "space", 1.0: "tangent"}
"""Of movec: how the tool turns."""
_BASE = ProgramFrame("the robot's base", mink.SE3.identity())


def _se3(pose: Any) -> mink.SE3:
    values = np.array(pose, dtype=np.float64)
    if (
        not isinstance(pose, Pose)
        or values.shape != (6,)
        or not (np.abs(values) <= LARGEST_NUMBER).all()
    ):
        raise Unknown(f"expected a pose, p[x, y, z, rx, ry, rz], got {pose}")
    return mink.SE3.from_rotation_and_translation(mink.SO3.exp(values[3:]), values[:3])


def _pose(se3: mink.SE3) -> Pose:
    return Pose([*se3.translation().tolist(), *se3.rotation().log().tolist()])


def _tool_text(tcp: mink.SE3) -> str:
    return f"set_tcp(p[{', '.join(fixed(value, 6) for value in _pose(tcp))}])"


def _added(one: Any, other: Any) -> Pose:
    """``pose_add``: translations are added, and rotations composed."""
    a, b = _se3(one), _se3(other)
    turn = a.rotation() @ b.rotation()
    return _pose(mink.SE3.from_rotation_and_translation(turn, a.translation() + b.translation()))


_VALUES: dict[str, Callable[..., Any]] = {
    "pose_trans": lambda a, b: _pose(_se3(a) @ _se3(b)), "pose_add": _added,
    "pose_inv": lambda a: _pose(_se3(a).inverse()), "get_inverse_kin": lambda pose, *_, **__: pose,
    "d2r": math.radians, "r2d": math.degrees, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "sqrt": math.sqrt, "norm": abs,
}  # fmt: skip


class Script(Program):
    """A script of anyone."""

    language = Language(
        opens=(
            (r"def\s+(?P<name>\w+)\s*\((?P<arguments>.*)\)\s*:", "end", "procedure"),
            (r"(?:thread|sec)\s+(?P<name>\w+).*:", "end", "never"),
            (r"while\s*\(?\s*True\s*\)?\s*:", "end", "for ever"),
            (r"if\b(?P<condition>.*):", "end", "if"),
            (r"while\b(?P<condition>.*):", "end", "while"),
        ),
        otherwise=r"elif\b(?P<condition>.*):|else\s*:",
        reads="joint moves (movej, servoj), straight ones (movel, movep) and circles (movec) to "
        "literals or constants, one after the other,",
        flags=re.ASCII | re.DOTALL,  # capitals count
    )  # fmt: skip

    def __init__(self, moves: Moves) -> None:
        super().__init__(Values(str, str, _VALUES, list_literal), moves)
        self.values.names |= {"True": True, "False": False, "pi": math.pi}
        moves.frame = "the robot's base", mink.SE3.identity()
        self._blended = self._streams = False
        self._tool = ProgramFrame("the active TCP")

    def grammar(self) -> Sequence[Rule]:
        """Moves, words that move nothing, variables, calls."""
        return (
            (r"(?P<word>movej|servoj)\s*\((?P<arguments>.*)\)", self._joint, "joint"),
            (rf"(?P<word>{'movel|movep|movec' if self.moves.strict else '(?!)'})"
             r"\s*\((?P<arguments>.*)\)", self._straight, "joint"),
            (r"(?P<word>movel|movep|movec)\s*\((?P<arguments>.*)\)", self._move, "path"),
            (r"(?:move|servo|speed|force_mode|freedrive|teach|conveyor|path_offset|track|screw)\w*"
             r"\s*\(.*", self.refuse, "path"),
            (r"break", "break", "leaves"), (r"continue", "continue", "leaves"),
            (r"return\b.*", "return", "leaves"), (r"halt(?:\s*\(\s*\))?", "end", "leaves"),
            (r"(?:else|elif)\b.*", self.skip, "skip"),
            (r"(sleep)\s*\((.*)\)", self.wait, "pause"),
            (r"(sync)\s*\(\s*\)", self.stop, "pause"),
            (r"(stopj)\s*\((.*)\)", self._stop, "passed"),
            (r"(set_tcp)\s*\((.*)\)", self._set_tool, "setting"),
            *self.noting(_NOTED),
            (r"(?:.*=\s*)?run\s+(?P<beside>\w+)\s*\(.*", self.beside, "skip"),
            (_ASSIGNMENT, self.assign, "assigns"),
            (r"(?:(?:global|local|run|join|kill)\b|\$).*|\w+|stopl\s*\(.*", self.skip, "skip"),
            (r"(?P<called>\w+)\s*\((?P<arguments>.*)\)", self.call, "call"),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    def first(self, uncalled: list[str]) -> list[str]:
        """A controller runs what stands outside functions, or else the only function."""
        if not self.moves.strict:
            return super().first(uncalled)
        return [] if self._count > len(self.listing.procedures) else uncalled

    def _given(self, line: int, match: re.Match[str]) -> dict[str, str]:
        self.listing.refuse_calls(line, match["arguments"])
        given = by_name(line, match["arguments"], _ARGUMENTS[match["word"]])
        text, radius = given.get("r", "0"), math.inf
        try:
            radius = float(self.values.value(text))
        except (Unknown, TypeError):
            if self.moves.strict:
                raise
        self._blended = radius != 0.0
        if self._blended:
            self.moves.rounds(Zone(line, f"r={text}", radius, overlaps=True))
        return given

    def _joint(self, line: int, match: re.Match[str]) -> None:
        if match["word"] == "servoj" and not self.moves.strict:
            self.refuse(line, match)
        given = self._given(line, match)
        angles = pose = None
        seconds, a, v = 0.0, math.nan, math.nan
        try:
            found = self.values.value(given.get("q", ""))
            if isinstance(found, Pose):
                pose = _se3(found)
            else:
                angles = [float(x) for x in found]
            seconds = float(self.values.value(given.get("t", "0")))
            a = float(self.values.value(given.get("a", "1.4")))
            v = float(self.values.value(given.get("v", "1.05")))
        except (Unknown, TypeError, ValueError) as error:
            if self.moves.strict:
                raise refuse(
                    line, match[0], "expected [q1, …, q6], numbers or constants."
                ) from error
        self._check_turns(line, match, angles)
        streamed = match["word"] == "servoj"
        self._ends_stream(streams=streamed)
        timed = seconds != 0.0 or streamed  # then a and v do not count
        self.moves.joint(JointMove(
            line, angles, pose, seconds if seconds != 0.0 else None,
            speed=None if timed else Speed(v), acceleration=None if timed else a, passes=streamed,
        ))  # fmt: skip

    def _ends_stream(self, *, streams: bool = False) -> None:
        """Other moves than streamed ones begin at rest."""
        if self._streams and not streams:
            self.moves.rests()
        self._streams = streams

    def _straight(self, line: int, match: re.Match[str]) -> None:
        """A straight move or a circle, for ``check``, in a time or at a speed of the tool."""
        given, circle = self._given(line, match), None
        try:
            angles, target = self._to(given.get("pose", given.get("pose_to", "")))
            if match["word"] == "movec":
                circle = Circle(self._rule(given), *self._to(given.get("pose_via", "")))
            seconds, v, a = (
                float(self.values.value(given.get(key, default)))
                for key, default in (("t", "0"), ("v", "0.25"), ("a", f"{_ACCELERATION}"))
            )
        except (Unknown, TypeError, ValueError) as error:
            raise refuse(
                line,
                match[0],
                "expected [q1, …, q6] or a pose, numbers or constants, and of movec mode 0 or 1.",
            ) from error
        for each in filter(None, (angles, circle and circle.angles)):
            self._check_turns(line, match, each)
        timed = seconds != 0.0
        self._ends_stream()
        self.moves.joint(JointMove(
            line, angles, None, seconds if timed else None, tool=self._tool.name, target=target,
            speed=None if timed else Speed(v), circle=circle, acceleration=None if timed else a,
            tcp=self._tool.pose,
        ))  # fmt: skip

    def _to(self, text: str) -> tuple[list[float] | None, Target | None]:
        """Joint positions, or a pose."""
        found = self.values.value(text)
        if isinstance(found, Pose):
            return None, Target(_se3(found), self._tool, _BASE)
        return [float(x) for x in found], None

    def _rule(self, given: Mapping[str, str]) -> Turning:
        """How the tool turns on a circle."""
        mode = self.values.value(given.get("mode", "0"))
        if mode not in _MODES:
            raise Unknown(f"expected the mode 0 or 1 of movec, got {mode}")
        return _MODES[mode]

    def _check_turns(self, line: int, match: re.Match[str], angles: Sequence[float] | None) -> None:
        if self.moves.strict and max(map(abs, angles or []), default=0.0) > 4.0 * math.pi:
            raise refuse(line, match[0], "more than two turns; URScript takes rad, not degrees.")

    def _set_tool(self, line: int, match: re.Match[str]) -> None:
        """Where the tool is; joint positions are the same with all of them."""
        self._note("setting", line, match)
        try:
            pose = _se3(self.values.value(match[2]))
        except Unknown:
            pose = None
        self._tool = ProgramFrame(" ".join(match[0].split()), pose)

    def _move(self, line: int, match: re.Match[str]) -> None:
        given = self._given(line, match)
        untimed = self.values.number(given.get("t", "0")) <= 0.0
        self.moves.feed = self.values.number(given.get("v", "0.25")) if untimed else math.nan
        poses = [_se3(self.values.value(text)) for key, text in given.items() if key[0] == "p"]
        if len(poses) != 1 + (match["word"] == "movec"):
            raise refuse(line, match[0], "expected poses, p[x, y, z, rx, ry, rz].")
        if len(poses) == 2:
            self.moves.arc(line, poses[0], poses[1], rule=self._rule(given))
        else:
            self.moves.line(line, poses[0])

    def _stop(self, line: int, match: re.Match[str]) -> None:
        self.listing.refuse_calls(line, match[2])
        self.moves.noted(line, match[1], "passed")
        self._ends_stream()
        if self.moves.strict and self._blended:
            raise refuse(line, match[0], "stops the robot before it is where it was sent (r>0).")


def _own_functions(lines: Sequence[str]) -> tuple[int, int, str] | None:
    """Where the functions that this package writes begin and end, and which; ``None`` without.

    They are recognised literally, where the package writes them: as the first lines of the only
    function. What they do with their variables is therefore known.
    """
    code = [k for k, line in enumerate(lines) if line.strip() and line.strip()[0] != "#"]
    if code and re.fullmatch(rf"def {_NAME}\(\):", lines[code[0]], re.ASCII):
        begin = code[0] + 1
        for kind in _TERMS:
            block = _functions(kind).rstrip("\n").split("\n")
            if [*lines[begin : begin + len(block)]] == block:
                return begin, begin + len(block), kind
    return None


def _read_own(moves: Moves, kind: str, statements: Statements) -> None:
    """Read a script of this package: start, moves, finish.

    Its functions remember where they are and how late. Only outputs and messages may stand between
    them: those neither take time nor write to their variables.
    """
    (number, define), *others = statements
    name = define.removeprefix("def ").removesuffix("():")
    if name in ("start", "cubic", "line", "finish", "at_q", "at_w", "late", "movej", "servoj"):
        raise refuse(number, define, "a name of the functions below; export it under another.")
    following = {"start": [kind, "finish"], kind: [kind, "finish"], "finish": ["end"],
                 "end": [name], name: []}  # fmt: skip
    counts, expected = {"start": 2, "cubic": 3, "line": 2}, ["start"]
    for line, text in others:
        match = re.fullmatch(r"(\w+)\s*(?:\((.*)\))?", text, re.ASCII | re.DOTALL)
        word, arguments = (match[1], split(match[2] or "")) if match else ("", [])
        output = re.fullmatch(_NOTED["passed"][0], text, re.ASCII | re.DOTALL)
        if output and kind in expected and not re.search(r"\w\s*\(", output[2]):
            moves.noted(line, word, "passed")
            continue
        own = kind in expected and word not in expected and text == f"{word}()"
        if own and moves.called(line, word):
            continue
        setting = re.fullmatch(_NOTED["setting"][0], text, re.ASCII | re.DOTALL)
        if setting and expected == ["start"] and not re.search(r"\w\s*\(", setting[2]):
            moves.noted(line, word, "setting")
            continue
        if word not in expected or len(list(filter(None, arguments))) != counts.get(word, 0):
            what = f"{' or '.join(expected) or 'nothing'} with its arguments"
            raise refuse(line, text, f"is not read; in a script of export, here stands {what}.")
        expected = following[word]
        if word in counts:
            q, w = (_numbers(line, each) for each in (arguments[0], arguments[1]))
            seconds = None if word == "start" else _numbers(line, f"[{arguments[-1]}]")[0]
            rates = w if kind == "cubic" else None
            moves.joint(JointMove(line, q, None, seconds, rates, passes=True))
        if word in ("start", "finish"):
            moves.rests()
    if expected not in ([name], []):
        raise InvalidInput(f"the script has no {expected[-1]} at its end; a line was lost.")


def _numbers(line: int, text: str) -> list[float]:
    found = list_literal(text if text[:1] == "[" else f"[{text}]")
    if not isinstance(found, list) or not all(isinstance(x, float) for x in found):
        raise refuse(line, text, "expected numbers.")
    return found


def _execute(moves: Moves, lines: Sequence[str], stem: str, beside: Beside) -> list[str]:
    """Execute a script, which is one file; its comments."""
    lines = [line.rstrip() for line in lines]
    own = _own_functions(lines)
    found: Statements = []
    for number, line in enumerate(lines, start=1):
        if own is None or not own[0] <= number - 1 < own[1]:
            code = without_texts(number, line, "\"'", "#")[0]
            found += [(number, part.strip()) for part in code.split(";") if part.strip()]
    if own is not None:
        _read_own(moves, own[2], found)
    else:
        Script(moves).execute(found)
    return [line.strip()[1:] for line in lines if line.strip()[:1] == "#"]


def _stopped(text: str, why: str) -> str:
    """A script that stops at its first line, and at the first of its function.

    A controller that takes a script from a socket runs the function by itself, whatever is before.
    """
    before, define, after = text.partition("\ndef ")
    name, end, body = after.partition("\n")
    return f"{why}\n{before}{define}{name}{end}  halt  # {why}\n{body}"


URSCRIPT = Dialect(
    "urscript", "URScript", ".script", "rad", 10, 11,
    ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    True, 64, "a function's name", _encode, _execute, _stopped, points=("joints",),
    speeds=(_MICRO,), constant=_ACCELERATION, numbered=False, circles=("space",),
    to_fill_in=("set_tcp(p[...])", "set_target_payload(...)"), tool_text=_tool_text,
    rounding=_rounding,
)  # fmt: skip
"""URScript. At 1 rad/s a time that is 1e-9 s off changes the acceleration of a move of 3 ms by 1e-4
rad/s²; with 11 digits it is a hundredth of what `check` counts as rounding."""
