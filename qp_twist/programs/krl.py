"""KRL, the KUKA Robot Language.

The start is reached by ``PTP`` at a tenth of the axes' speed. Then one spline in the axes
(``PTP_SPLINE``) passes all points; its ``TIME_BLOCK`` has the time of each segment and of all.

Source: public code, since KUKA's manual was not at hand. The words are those of the syntax file of
KnoP-01/krl-for-vim; the form ``PTP_SPLINE … TIME_BLOCK START … SPTP … TIME_BLOCK PART = …
TIME_BLOCK END = … ENDSPLINE`` is that of two generators of KRL programs on GitHub. One writes parts
in seconds, the other in percent of the whole, so parts are read as shares of ``END``. Angles A, B,
C are about z, y', x'' (KUKA, *KSS Operating and programming instructions*, Coordinate systems).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import mink

from qp_twist.errors import InvalidInput
from qp_twist.files import text_lines
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.moves import Kind, Moves
from qp_twist.programs.program import Program
from qp_twist.programs.statements import NUMBER, Statements, refuse, split, without_texts
from qp_twist.programs.syntax import Rule
from qp_twist.programs.values import IN_DEGREES, Unknown, Values, pose_of, zyx_quaternion

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
_FRAME = _START.rstrip("\n").split("\n")
"""The first statements of a program of this package: its speeds are those of the way to the start,
whose time does not count."""


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


_NAME = r"[A-Za-z]\w*"
_TYPES = r"INT|REAL|BOOL|CHAR|FRAME|POS|E6POS|AXIS|E6AXIS|FDAT|PDAT|LDAT|LOAD"
_DECLARED = [
    rf"(?:GLOBAL\s+)?{word}(?P<kind>{kinds})\s+(?P<name>{_NAME})(?P<part>(?:\s*\[[\d\s,]*\])?"
    rf"(?:\s*,\s*{_NAME}(?:\s*\[[\d\s,]*\])?)*)\s*(?:=(?!=)(?P<value>.*))?"
    for word, kinds in ((r"DECL\s+(?:GLOBAL\s+)?(?:CONST\s+)?", _NAME), ("", _TYPES))
]
_ASSIGNMENT = rf"(?P<name>{_NAME})(?P<part>(?:\s*\[[^\]]*\]|\s*\.\s*\w+)*)\s*=(?!=)(?P<value>.*)"
_PULSE = r"PULSE\s*\(\s*\$OUT\s*\[\w+\]\s*,\s*\w+\s*,\s*[\d.]+\s*\)"
_TRIGGER = (
    r"(TRIGGER)\s+WHEN\s+(?:PATH|DISTANCE)\s*=\s*[-\d.]+(?:\s+ONSTART)?\s+DELAY\s*=\s*[-\d.]+\s+DO"
    rf"\s+(?:\$OUT\s*\[\w+\]\s*=\s*\w+|{_PULSE})"
)
_NOTED: Mapping[Kind, Sequence[str]] = {
    # outputs, flags, timers, names for them, and how far from a point rounding begins
    "passed": (
        r"(\$(?:OUT|ANOUT|FLAG|TIMER|TIMER_STOP)\s*\[[^\]]*\]|\$ADVANCE|\$BWDSTART"
        r"|\$APO(?:\.\w+)?|\$ORI_TYPE|\$CIRC_TYPE|\$H_POS)\s*=(?!=)(.*)",
        rf"(?=(PULSE)){_PULSE}",
        r"(SET_CD_PARAMS)\s*\(\s*\d+\s*\)",
        rf"(EXT)\s+{_NAME}\s*\([^()]*\)",
        rf"(SIGNAL)\s+{_NAME}\s+\$\w+\[\d+\](?:\s+TO\s+\$\w+\[\d+\])?",
        _TRIGGER,
    ),
    "setting": (
        rf"(BAS)\s*\(\s*#(?:TOOL|FRAMES)\s*(?:,\s*{NUMBER}\s*)?\)",
        r"(\$TOOL|\$LOAD|\$ACT_TOOL|\$ACT_BASE|(?:TOOL|LOAD)_DATA\s*\[\d+\])\s*=(?!=)(.*)",
    ),
    "speed": (
        rf"(BAS)\s*\(\s*#(?:(?:VEL|ACC)_(?:PTP|CP)|(?:PTP|CP)_(?:DAT|PARAMS))\s*"
        rf"(?:,\s*{NUMBER}\s*)?\)",
        r"(\$VEL(?:\.\w+)?|\$ACC(?:\.\w+)?|\$(?:VEL|ACC)_AXIS\s*\[\d+\]|\$GEAR_JERK\s*\[\d+\]"
        r"|\$OV_PRO|[PL]DAT_ACT)\s*=(?!=)(.*)",
    ),
    "pause": (r"(WAIT)\s+(?:SEC|FOR)\b(.*)", r"(HALT)"),
}
_BEGIN = (
    r"GLOBAL INTERRUPT DECL 3 WHEN \$STOPMESS\s*==\s*TRUE DO IR_STOPM\s*\(\s*\)"
    r"|INTERRUPT ON 3|BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)"
)
"""What a controller's programs begin with."""
_REST = r"(?P<rest>(?:\s*\bC_\w+|\s+#(?:BASE|TOOL)|\s+WITH\s.*)*)"
_WITH = re.compile(
    r"\$(?:TOOL|BASE|LOAD|IPO_MODE|APO|(?:VEL|ACC)_AXIS\[\d\]|GEAR_JERK\[\d\]"
    r"|COLLMON_TOL_PRO\[\d\])\s*=\s*(?:(?:SVEL_JOINT|SACC_JOINT|SJERK|STOOL2|STOOL|SBASE|SLOAD"
    r"|SIPO_MODE|SAPO_PTP|SAPO|USE_CM_PRO_VALUES)\s*\(\s*[\w.]+\s*\)|[\w.]+)",
    re.IGNORECASE | re.ASCII,
)
"""What an SPTP may have after WITH, also as the maker's inline forms write it."""
_POSE = "xyzabc"
_FIELD = rf"(\w+)\s+({NUMBER})"
_RECORD = re.compile(
    rf"\{{(?:\s*\w+\s*:)?\s*({_FIELD}(?:\s*,\s*{_FIELD})*)\s*\}}", re.ASCII | re.IGNORECASE
)


class _Frame(dict[str, Any]):
    """Components of a frame, position or axes; ``@`` is KRL's geometric operator."""

    def __matmul__(self, other: _Frame) -> _Frame:
        pose = _pose(self) @ _pose(other)
        yaw, pitch, roll = (math.degrees(a) for a in reversed(pose.rotation().as_rpy_radians()))
        values = [*(1e3 * pose.translation()), yaw, pitch, roll]
        return _Frame(zip(_POSE, map(float, values), strict=True))


def _pose(frame: _Frame) -> mink.SE3:
    x, y, z, a, b, c = (frame[key] for key in _POSE)
    return pose_of((x, y, z), zyx_quaternion(a, b, c))


def _literal(text: str) -> _Frame | None:
    match = _RECORD.fullmatch(text)
    if match is None:
        return None
    fields = re.findall(_FIELD, match[1])
    found = _Frame((key.lower(), float(value)) for key, value in fields)
    if len(found) < len(fields):
        raise Unknown(f"a component stands twice in {text}")
    return found


def _key(name: str) -> str:
    return name.lower().replace("$", "_")


def _translate(text: str) -> str:
    def record(match: re.Match[str]) -> str:
        parts = [part.split(None, 1) for part in split(match[1]) if part]
        return f"_f({', '.join(f'{part[0]}={part[1]}' for part in parts)})"

    text = re.sub(r"\[\s*\]", "", text)
    text = re.sub(r"#(\w+)", r'"\1"', text)
    text = re.sub(r"\{(?:\s*\w+\s*:)?([^{}]*)\}", record, text).replace(":", "@")
    text = re.sub(r"\[([^\[\]]*)\]", lambda m: "".join(f"[({i})-1]" for i in split(m[1])), text)
    return re.sub(r"(?<=[\w\])])\.\s*([a-z]\w*)", r'["\1"]', text)


class KrlProgram(Program):
    """The programs of a file.

    Attributes:
        bases: Frames of ``BASE_DATA`` that the file assigns, by number.
        shares: Whether the parts of the time block are shares, not seconds.
    """

    opens = (
        (r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+(?:\[\d*\])?)?\s+(?P<name>\w+)\s*\((?P<arguments>.*)\)",
         "END|ENDFCT", "procedure"),
        (r"DEFDAT\b.*", "ENDDAT", "once"), (r"LOOP", "ENDLOOP", "for ever"),
        (r"WHILE\s+\(?\s*TRUE\s*\)?", "ENDWHILE", "for ever"),
        (r"FOR\s+(?P<name>\w+)\s*=(?P<first>.*)\bTO\b(?P<last>.*?)(?:\bSTEP\b(?P<step>.*))?",
         "ENDFOR", "for"),
        (r"IF\b(?P<condition>.*)\bTHEN", "ENDIF", "if"),
        (r"WHILE\b(?P<condition>.*)", "ENDWHILE", "while"),
        (r"REPEAT", r"UNTIL\b(?P<condition>.*)", "until"),
        (r"SWITCH\b.*", "ENDSWITCH", "open"),
    )  # fmt: skip
    otherwise = r"ELSE(?P<condition>(?!))?"
    coordinates = r"\{|#BASE"
    outside = r"&\w+.*"
    reads = "axis moves (PTP, SPTP) to literals or constants, one after the other,"

    def __init__(self, moves: Moves) -> None:
        super().__init__(
            Values(_key, _translate, {**IN_DEGREES, "_f": _Frame}, _literal, [("<>", "!=")]), moves
        )
        nothing = _Frame(dict.fromkeys(_POSE, 0.0))
        self.values.names |= {
            "_nullframe": nothing, "_world": nothing, "true": True, "false": False,
        }  # fmt: skip
        self.bases: dict[int, tuple[str, mink.SE3 | None]] = {}
        self.shares = False
        self._at: _Frame | None = None
        self._spline = self._timed = False
        self._block_points: list[tuple[int, list[float]]] | None = None  # of an open time block
        self._parts: list[float] = []

    def grammar(self) -> Sequence[Rule]:
        """Moves, splines and their times, frames, speeds, data, what moves nothing, calls."""
        return (
            (r"S?PTP\s+(\$(?:POS|AXIS)_ACT(?:_MEAS)?)(?:\s+C_\w+)*", self._stay, "silent"),
            (rf"(?P<word>S?PTP)(?!_)\b\s*(?P<targets>.*?){_REST}", self._move, "joint"),
            (rf"(?P<word>S?(?:LIN|CIRC|PTP)(?:_REL)?)\b\s*(?P<targets>.*?){_REST}", self._move,
             "path"),
            (r"PTP_SPLINE(?:\s+WITH\s+(?P<with>.*))?", self._begin_spline, "joint"),
            (r"ENDSPLINE", self._end_spline, "joint"),
            (r"TIME_BLOCK\s+START", self._begin_block, "joint"),
            (rf"TIME_BLOCK\s+PART\s*=\s*({NUMBER})", self._part, "joint"),
            (rf"TIME_BLOCK\s+END\s*=\s*({NUMBER})", self._end_block, "joint"),
            (r"SPLINE(?:\s.*)?", self.skip, "path"),
            (r"(?:GOTO|RESUME|SPL|RSI_(?:MOVECORR|ON)|TOUCH\w*)\b.*", self.refuse, "path"),
            (r"RETURN\b.*", self.leave, "leaves"), (r"EXIT", lambda *_: "break", "leaves"),
            (rf"(WAIT)\s+SEC\s+({NUMBER})", self.wait, "pause"),
            (_BEGIN, self.nothing, "silent"),
            (r"\$BASE\s*[.\[].*", self.refuse, "path"),
            (r"(\$IPO_MODE)\s*=(.*)", self._ipo_mode, "setting"),
            (r"(?P<word>BAS)\s*\(\s*#(?:VEL_CP|CP_PARAMS)\s*,(?P<value>.*)\)", self._speed,
             "speed"),
            (r"(?P<word>\$VEL\.CP)\s*=(?!=)(?P<value>.*)", self._speed, "speed"),
            (r"(?P<word>BAS)\s*\(\s*#BASE\s*,(?P<value>.*)\)", self._base, "setting"),
            (r"(?P<word>\$BASE)\s*=(?!=)(?P<value>.*)", self._base, "setting"),
            (r"(?P<word>BASE_DATA)\s*\[(?P<part>.*?)\](?P<field>.*?)=(?!=)(?P<value>.*)",
             self._base_data, "setting"),
            (r"(?P<word>FDAT_ACT)\s*=(?!=)(?P<value>.*)", self._inline_frame, "setting"),
            *self.noting(_NOTED),
            *((pattern, self.assign, "assigns") for pattern in _DECLARED),
            (_ASSIGNMENT, self.assign, "assigns"),
            (r"\$\w+(?:\[[^\]]*\])?(?:\.\w+)?\s*=(?!=)[^{]*", self.skip, "skip"),
            (r"&.*", self.nothing, "silent"),
            (r"(?:ELSE|CASE|DEFAULT|CONTINUE|GLOBAL|INTERRUPT|DECL|STRUC|ENUM|BRAKE|EXT|ANOUT"
             r"|ON_ERROR_PROCEED|SIGNAL|PUBLIC|TRIGGER).*|\w+\s*:", self.skip, "skip"),
            (r"(?P<called>\w+)\s*(?:\((?P<arguments>.*)\))?", self.call, "call"),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    def first(self, uncalled: list[str], statements: Statements) -> list[str]:
        """The first program of a file is the one that a controller runs."""
        return [*self.procedures][:1] if self.moves.strict else super().first(uncalled, statements)

    def check(self, statements: Statements) -> None:
        """In a spline there are only segments and times."""
        super().check(statements)
        spline = False
        for line, text in statements:
            word = re.sub(r"\W.*", "", text).upper()
            if spline and word not in ("SPTP", "TIME_BLOCK", "TRIGGER", "ENDSPLINE"):
                raise refuse(line, text, "expected SPTP and TIME_BLOCK in a spline.")
            spline = word == "PTP_SPLINE" or (spline and word != "ENDSPLINE")
        if spline:
            raise InvalidInput("the spline has no end (ENDSPLINE); a line was lost.")

    def read_data(self, file: str, lines: Sequence[str]) -> None:
        """The points of the data file beside a program; another run may have changed its values."""
        for number, line in enumerate(lines, start=1):
            code = line.partition(";")[0].strip()
            for pattern in (*_DECLARED, _ASSIGNMENT):
                match = re.fullmatch(pattern, code, self.flags)
                if match and match["value"]:
                    name = self.values.key(match["name"])
                    self.assigned.setdefault(name, []).append(f"{number} of {file}")
                    if "kind" in match.groupdict():
                        self.values.assign(number, match["name"], match["value"])
                        self.values.kept.add(self.values.key(match["name"]))
                    break

    def parameter(self, words: Sequence[str]) -> str:
        """A parameter stands before its kind, ``:IN`` or ``:OUT``."""
        return words[0]

    # ------------------------------------------------------------ frames and speeds

    def _stated(self, line: int, match: re.Match[str], kind: Kind = "setting") -> None:
        self.refuse_calls(line, match["value"])
        self.moves.noted(line, match["word"], kind)

    def _speed(self, line: int, match: re.Match[str]) -> None:
        self._stated(line, match, "speed")
        self.moves.feed = math.nan
        with suppress(Unknown, TypeError):
            self.moves.feed = float(self.values.value(match["value"]))

    def _ipo_mode(self, line: int, match: re.Match[str]) -> None:
        if "#TCP" in match[2].upper() and not self.moves.strict:
            self.refuse(line, match)
        self.moves.noted(line, match[1], "setting")

    def _base(self, line: int, match: re.Match[str]) -> None:
        text = match["value"].strip()
        self._stated(line, match)
        number = re.fullmatch(r"BASE_DATA\s*\[(.*)\]", text, re.IGNORECASE)
        if match["word"].upper() == "BAS" or number:
            self.moves.frame = self._numbered(number[1] if number else text)
        else:
            self.moves.frame = self._frame(text, f"$BASE = {text}")

    def _numbered(self, text: str) -> tuple[str, mink.SE3 | None]:
        """The base whose number an expression states."""
        try:
            number = int(self.values.value(text))
        except (Unknown, TypeError):
            return f"base {text.strip()}", None
        return self.bases.get(number, (f"base {number}", None))

    def _base_data(self, line: int, match: re.Match[str]) -> None:
        self._stated(line, match)
        if self.moves.strict:
            return
        number = int(self.values.value(match["part"]))
        name = f"base {number} of line {line}"
        known = not match["field"].strip()
        self.bases[number] = self._frame(match["value"], name) if known else (name, None)

    def _frame(self, text: str, name: str) -> tuple[str, mink.SE3 | None]:
        try:
            return name, _pose(self.values.value(text))
        except (Unknown, KeyError, TypeError, ValueError):
            return name, None

    def _inline_frame(self, line: int, match: re.Match[str]) -> None:
        """The base of the move that follows, by which inline forms state it."""
        self._stated(line, match)
        with suppress(Unknown, KeyError, TypeError):  # of a point that is in no file
            self.moves.frame = self._numbered(str(self.values.value(match["value"])["base_no"]))

    # ------------------------------------------------------------ splines and their times

    def _begin_spline(self, line: int, match: re.Match[str]) -> None:
        self._with(line, match[0], match["with"] or "")
        self._spline = True

    def _end_spline(self, line: int, match: re.Match[str]) -> None:
        if (self.moves.strict and not self._spline) or self._block_points is not None:
            raise refuse(
                line, match[0],
                "expected a spline before it, and the end of its time block (TIME_BLOCK END = …).",
            )  # fmt: skip
        self._spline = False

    def _begin_block(self, line: int, match: re.Match[str]) -> None:
        if self._timed or not self._spline:
            raise refuse(line, match[0], "expected one time block, in a spline of axis moves.")
        self._timed, self._block_points = True, []

    def _part(self, line: int, match: re.Match[str]) -> None:
        self._parts.append(float(match[1]))
        if self._block_points is None or len(self._parts) != len(self._block_points):
            raise refuse(
                line, match[0],
                "expected TIME_BLOCK START, then one segment before each part; a line was lost or "
                "added.",
            )  # fmt: skip

    def _end_block(self, line: int, match: re.Match[str]) -> None:
        """The end of a time block: each segment takes its part's share of the whole time."""
        block, self._block_points = self._block_points, None
        parts, whole = self._parts, float(match[1])
        if not block or len(parts) != len(block):
            raise InvalidInput(
                f"the time block has {len(block or [])} segments and {len(parts)} parts; a line "
                "was lost or added.",
                line=line,
            )
        total = sum(parts)
        self.shares = abs(total - whole) > 0.6e-5
        if not (total > 0.0 and whole > 0.0 and min(parts) > 0.0):
            raise InvalidInput("a time of the time block is not positive.", line=line)
        for (place, point), part in zip(block, parts, strict=True):
            self.moves.joint(place, point, None, part * whole / total)

    # ------------------------------------------------------------ moves

    def _stay(self, line: int, match: re.Match[str]) -> None:
        if self._spline:
            raise refuse(line, match[0], f"{match[1]} is not read as a target in a spline.")
        self.moves.note(f"line {line} moves to where the robot is ({match[1].upper()})")

    def _with(self, line: int, statement: str, text: str) -> None:
        """What stands after WITH, for this move alone: inline forms set speed and tool anew."""
        strict, moves = self.moves.strict, self.moves
        if not strict and re.search(r"\$(?:BASE|VEL)\s*=\s*\{|\$IPO_MODE", text, re.IGNORECASE):
            raise refuse(
                line, statement,
                "states a frame or a speed for this move in a way that is not read; write it before"
                " the move.",
            )  # fmt: skip
        for part in filter(None, split(text)):
            if strict and not _WITH.fullmatch(part):
                raise refuse(line, statement, f"{part}: not read after WITH.")
            speed = re.match(r"\$(VEL|ACC|GEAR)", part, re.IGNORECASE)
            moves.noted(line, part.partition("=")[0].strip(), "speed" if speed else "setting")
        if found := re.search(rf"\$VEL(?:\.CP)?\s*=\s*(?:SVEL_CP\s*\()?\s*({NUMBER})", text, re.I):
            moves.feed = float(found[1])
        if found := re.search(r"\$BASE\s*=\s*(?:SBASE\s*\(\s*)?([\w.]+)", text, re.IGNORECASE):
            moves.frame = self._numbered(found[1])

    def _move(self, line: int, match: re.Match[str]) -> None:
        word, rest, moves = match["word"].upper(), match["rest"], self.moves
        relative, before = word.endswith("_REL"), (moves.frame, moves.feed)
        if self._spline and word == "PTP":
            raise refuse(line, match[0], "expected SPTP in a spline.")
        if relative and "#TOOL" in rest.upper():
            raise refuse(
                line, match[0], "is relative to the tool, which is not read; write a position."
            )
        marks, _, given = re.sub(r"\bwith\b", "WITH", rest, flags=re.I).partition("WITH")
        self._with(line, match[0], given)
        *parts, last = split(match["targets"])
        sweep = re.fullmatch(rf"CA\s*(?P<number>{NUMBER})", last, re.IGNORECASE)
        parts += [] if sweep else [last]
        if len(parts) != (2 if "CIRC" in word else 1):
            raise refuse(line, match[0], "expected one target, or two of an arc.")
        if marks.strip() and "#" not in marks:
            moves.rounds(line, marks.strip())
        if "PTP" in word:
            self._joint(line, parts[0], relative=relative)
        elif "LIN" in word:
            moves.line(line, self._target(parts[0], relative=relative))
        else:
            poses = [self._target(part, relative=relative) for part in parts]
            moves.arc(line, poses[0], poses[1], float(sweep["number"]) if sweep else None)
            self._at = None if sweep else self._at
        moves.frame, moves.feed = before

    def _joint(self, line: int, text: str, *, relative: bool) -> None:
        angles = pose = None
        try:
            found = None if relative else self.values.value(text)
            if isinstance(found, _Frame) and "a1" in found:
                axes = [name.lower() for name in KRL.axis_names]
                external = {k.upper(): v for k, v in found.items() if re.fullmatch("e[1-6]", k)}
                if not {*axes} <= {*found} or len(found) > len(axes) + len(external):
                    raise Unknown(f"expected the axes {', '.join(KRL.axis_names)}, got {text}")
                self.moves.external(line, external)
                angles, self._at = [found[axis] for axis in axes], None
            elif not relative and not self.moves.strict:
                pose = self._target(text)
        except Unknown:
            if self.moves.strict:
                raise
            self._at = None
        if self._block_points is None or angles is None:
            self.moves.joint(line, angles, pose)
        else:
            self._block_points.append((line, angles))

    def _target(self, text: str, *, relative: bool = False) -> mink.SE3:
        """A target; what it leaves out stays as it was."""
        found = self.values.value(text)
        if not isinstance(found, _Frame) or not set(_POSE) & set(found):
            raise Unknown(f"expected a position, {{X …,Y …,Z …,A …,B …,C …}}, got {text}")
        if not set(_POSE) <= set(found) and self._at is None:
            raise Unknown(f"{text} leaves out some of X, Y, Z, A, B, C; nothing before has them")
        at = self._at or _Frame()
        if relative and any(found.get(key) for key in "abc"):
            raise InvalidInput(f"{text}: a relative turn is not read; write a position")
        moved = {key: found.get(key, at.get(key)) for key in _POSE}
        if relative:
            moved = {key: at[key] + found.get(key, 0.0) for key in _POSE}
        self._at = _Frame(moved)
        return _pose(self._at)


def _execute(moves: Moves, lines: Sequence[str], stem: str, beside: Beside) -> list[str]:
    """Execute a program, after the data file beside it; its comments."""
    comments, found = [], []
    for number, line in enumerate(lines, start=1):
        code, comment = without_texts(number, line, '"', ";")
        comments.append(comment)
        if code:
            found.append((number, code))
    program = KrlProgram(moves)
    content = beside(f"{stem}.dat")
    program.read_data(f"{stem}.dat", [] if content is None else text_lines(content))
    at = next((k for k, each in enumerate(found, start=1) if each[1].startswith("DEF ")), 0)
    if [text for _, text in found[at : at + len(_FRAME)]] == _FRAME:
        del found[at : at + len(_FRAME)]
    program.execute(found)
    if program.shares and (header := read_header(comments)):
        raise InvalidInput(
            f"the parts of the time block are not {header['seconds']} s together, as the header "
            "says; a time was changed. Export it again, or remove the header."
        )
    return comments


KRL = Dialect(
    "krl", "KRL", ".src", "deg", 4, 5, tuple(f"A{k}" for k in range(1, AXES + 1)),
    False, 24, "the name after DEF", _encode, _execute,
)  # fmt: skip
"""KRL; the length of a name as usually stated, not looked up in KUKA's manual."""
