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
from collections.abc import Sequence

from qp_twist.errors import InvalidInput
from qp_twist.files import text_lines
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import AXES, Beside, Dialect, JointMoves
from qp_twist.programs.reading import (
    NUMBER,
    Act,
    Program,
    Statements,
    check_identifier,
    number_of,
    refuse,
    split,
    without_texts,
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
_FRAME = _START.rstrip("\n").split("\n")
"""The first statements of a program of this package: its speeds are those of the way to the start,
whose time does not count."""


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


_NAME = r"[A-Za-z]\w*"
_TYPES = r"INT|REAL|BOOL|CHAR|FRAME|POS|E6POS|AXIS|E6AXIS|FDAT|PDAT|LDAT|LOAD"
DECLARED = [
    rf"(?:GLOBAL\s+)?{word}(?P<kind>{kinds})\s+(?P<name>{_NAME})(?P<part>(?:\s*\[[\d\s,]*\])?"
    rf"(?:\s*,\s*{_NAME}(?:\s*\[[\d\s,]*\])?)*)\s*(?:=(?!=)(?P<value>.*))?"
    for word, kinds in ((r"DECL\s+(?:GLOBAL\s+)?(?:CONST\s+)?", _NAME), ("", _TYPES))
]
ASSIGNMENT = rf"(?P<name>{_NAME})(?P<part>(?:\s*\[[^\]]*\]|\s*\.\s*\w+)*)\s*=(?!=)(?P<value>.*)"
_AXES = ("AXIS", "E6AXIS")
"""Types of the data that say where an axis move leads."""
_WHERE_IT_IS = ("$AXIS_ACT", "$AXIS_ACT_MEAS", "$POS_ACT")
"""Targets that are where the robot is: it stays there."""
_PULSE = r"PULSE\s*\(\s*\$OUT\s*\[\w+\]\s*,\s*\w+\s*,\s*[\d.]+\s*\)"
_TRIGGER = (
    r"(TRIGGER)\s+WHEN\s+(?:PATH|DISTANCE)\s*=\s*[-\d.]+(?:\s+ONSTART)?\s+DELAY\s*=\s*[-\d.]+\s+DO"
    rf"\s+(?:\$OUT\s*\[\w+\]\s*=\s*\w+|{_PULSE})"
)
NOTED = {
    # outputs, flags, timers, names for them, and how far from a point rounding begins
    "passed": (
        r"(\$(?:OUT|ANOUT|FLAG|TIMER|TIMER_STOP)\s*\[[^\]]*\]|\$ADVANCE|\$BWDSTART"
        r"|\$APO(?:\.\w+)?|\$ORI_TYPE|\$CIRC_TYPE|\$H_POS)\s*=(?!=)(.*)",
        rf"(?=(PULSE)){_PULSE}",
        r"(SET_CD_PARAMS)\s*\(\s*\d+\s*\)",
        rf"(EXT)\s+{_NAME}\s*\([^()]*\)",
        rf"(SIGNAL)\s+{_NAME}\s+\$\w+\[\d+\](?:\s+TO\s+\$\w+\[\d+\])?",
    ),
    "setting": (
        rf"(BAS)\s*\(\s*#(?:TOOL|BASE|FRAMES)\s*(?:,\s*{NUMBER}\s*)?\)",
        r"(\$TOOL|\$BASE|\$LOAD|\$ACT_TOOL|\$ACT_BASE|\$IPO_MODE|(?:TOOL|BASE|LOAD)_DATA\s*\[\d+\]"
        r"|FDAT_ACT)\s*=(?!=)(.*)",
    ),
    "speed": (
        r"(BAS)\s*\(\s*#(?:(?:VEL|ACC)_(?:PTP|CP)|(?:PTP|CP)_(?:DAT|PARAMS))\s*"
        rf"(?:,\s*{NUMBER}\s*)?\)",
        r"(\$VEL(?:\.\w+)?|\$ACC(?:\.\w+)?|\$(?:VEL|ACC)_AXIS\s*\[\d+\]|\$GEAR_JERK\s*\[\d+\]"
        r"|\$OV_PRO|[PL]DAT_ACT)\s*=(?!=)(.*)",
    ),
    "pause": (r"(WAIT)\s+(?:SEC|FOR)\b(.*)", r"(HALT)"),
}
BEGIN = (
    r"GLOBAL INTERRUPT DECL 3 WHEN \$STOPMESS\s*==\s*TRUE DO IR_STOPM\s*\(\s*\)"
    r"|INTERRUPT ON 3|BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)"
)
"""What a controller's programs begin with."""
_MOVE = (
    rf"(S?PTP)\s*(?<=[P\s])(\{{[^{{}}]*\}}|(?<=\s)(?:{_NAME}|\$\w+))((?:\s*\bC_\w+)*)"
    r"(?:\s+WITH\s+(.*))?"
)
_WITH = re.compile(
    r"\$(?:TOOL|BASE|LOAD|IPO_MODE|APO|(?:VEL|ACC)_AXIS\[\d\]|GEAR_JERK\[\d\]"
    r"|COLLMON_TOL_PRO\[\d\])\s*=\s*(?:(?:SVEL_JOINT|SACC_JOINT|SJERK|STOOL2|STOOL|SBASE|SLOAD"
    r"|SIPO_MODE|SAPO_PTP|SAPO|USE_CM_PRO_VALUES)\s*\(\s*[\w.]+\s*\)|[\w.]+)",
    re.IGNORECASE | re.ASCII,
)
"""What an SPTP may have after WITH, also as the maker's inline forms write it."""


def _decode(text: str, beside: Beside) -> JointMoves:
    comments: list[str] = []
    statements: Statements = []
    for number, line in enumerate(text.split("\n"), start=1):
        code, comment = without_texts(number, line, '"', ";")
        comments.append(comment)
        if code:
            statements.append((number, code))
    program = _Krl()
    program.execute(statements, beside)
    header = read_header(comments)
    if header and program.shares:
        raise InvalidInput(
            f"the parts of the time block are not {header['seconds']} s together, as the header "
            "says; a time was changed. Export it again, or remove the header."
        )
    return program.course.moves(header)


class _Krl(Program):
    """The programs of a file.

    Attributes:
        shares: Whether the parts of the time block are shares, not seconds.
    """

    reads = "axis moves (PTP, SPTP) to literals or constants, one after the other,"
    begins = rf"(?:GLOBAL\s+)?DEF\s+(?P<name>{_NAME})\s*\((?P<arguments>.*)\)"
    data = *DECLARED, ASSIGNMENT
    noted = NOTED
    reserved = frozenset({"BAS", "SET_CD_PARAMS", "IR_STOPM", "FDAT_ACT", "PDAT_ACT", "LDAT_ACT"})

    def __init__(self) -> None:
        super().__init__()
        self.shares = False
        self._spline = self._timed = False
        self._block: list[tuple[int, list[float]]] | None = None  # points of an open time block
        self._parts: list[float] = []

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Splines and their times, moves; what may not stand in a spline."""
        outside = (
            (r"PTP_SPLINE(?:\s+WITH\s+(.*))?", self._begin_spline),
            (rf"WAIT\s+SEC\s+({NUMBER})", self.wait),
            (r"RETURN", self.leave),
            (BEGIN, lambda number, match: None),
            *self.noting(),
            *((pattern, self._assign) for pattern in self.data),
            (
                rf"({_NAME})\s*\(\s*\)",
                self.calling("calls something that the file does not have."),
            ),
        )
        return (
            (r"ENDSPLINE", self._end_spline),
            (r"TIME_BLOCK\s+START", self._begin_block),
            (rf"TIME_BLOCK\s+PART\s*=\s*({NUMBER})", self._part),
            (rf"TIME_BLOCK\s+END\s*=\s*({NUMBER})", self._end_block),
            (_MOVE, self._move),
            (_TRIGGER, lambda number, match: self.course.passed(number, match[1])),
            *((pattern, self._outside(act)) for pattern, act in outside),
        )

    def _outside(self, act: Act) -> Act:
        """The act of a statement that is refused in a spline, which has only segments and times."""

        def checked(number: int, match: re.Match[str]) -> bool | None:
            if self._spline:
                raise refuse(number, match[0], "expected SPTP and TIME_BLOCK in a spline.")
            return act(number, match)

        return checked

    def execute(self, statements: Statements, beside: Beside) -> None:
        """Execute a file: its first program, and those of the file that this one calls."""
        top = self.sort(statements)
        for number, statement in self.procedures.pop("").statements:
            if not re.fullmatch(r"&\w+.*", statement):
                raise refuse(
                    number, statement, "expected programs (DEF NAME( ) … END), and this in them."
                )
        if not top:
            raise InvalidInput("this is no KRL program: expected DEF NAME( ) … END.")
        first = self.procedures[top[0]]
        content = beside(f"{first.name}.dat")  # the axes that its data file declares
        for number, line in enumerate([] if content is None else text_lines(content), start=1):
            code = line.partition(";")[0].strip()
            match = self.assigned(f"{number} of {first.name}.dat", code)
            if match is not None and match["value"] and "kind" in match.groupdict():
                self.values[match["name"].upper()] = match["value"].strip()
        if [statement for _, statement in first.statements[: len(_FRAME)]] == _FRAME:
            del first.statements[: len(_FRAME)]
        self.parse_all()
        self.run(top[0])
        if self._spline:
            raise InvalidInput("the spline has no end (ENDSPLINE); a line was lost.")
        self.note_calls()

    def _assign(self, number: int, match: re.Match[str]) -> None:
        """A declaration or an assignment."""
        name, part, value = match["name"].upper(), match["part"], match["value"]
        kind = match.groupdict().get("kind")
        self.check(number, match[0], part + (value or ""))
        if name in self.reserved:
            raise refuse(number, match[0], "this name has a meaning already.")
        if value is not None and (kind or not part):
            self.values[name] = value.strip()
        if kind and kind.upper() not in _AXES:
            self.course.passed(number, kind.upper())
        elif not kind and (part or "{" not in value):
            self.course.passed(number, match["name"])

    def _begin_spline(self, number: int, match: re.Match[str]) -> None:
        self._check_with(number, match[0], match[1])
        self._spline = True

    def _end_spline(self, number: int, match: re.Match[str]) -> None:
        if not self._spline or self._block is not None:
            raise refuse(
                number, match[0],
                "expected a spline before it, and the end of its time block (TIME_BLOCK END = …).",
            )  # fmt: skip
        self._spline = False

    def _begin_block(self, number: int, match: re.Match[str]) -> None:
        if self._timed or not self._spline:
            raise refuse(number, match[0], "expected one time block, in a spline.")
        self._timed, self._block = True, []

    def _part(self, number: int, match: re.Match[str]) -> None:
        self._parts.append(float(match[1]))
        if self._block is None or len(self._parts) != len(self._block):
            raise refuse(
                number, match[0],
                "expected TIME_BLOCK START, then one segment before each part; a line was lost or "
                "added.",
            )  # fmt: skip

    def _end_block(self, number: int, match: re.Match[str]) -> None:
        """The end of a time block: each segment takes its part's share of the whole time."""
        if self._block is None:
            raise refuse(number, match[0], "expected TIME_BLOCK START before it.")
        (block, self._block), parts, whole = (self._block, None), self._parts, float(match[1])
        if len(parts) != len(block) or not block:
            raise InvalidInput(
                f"the time block has {len(block)} segments and {len(parts)} parts; a line was lost "
                "or added.",
                line=number,
            )
        total = sum(parts)
        self.shares = abs(total - whole) > 0.6e-5
        if not (total > 0.0 and whole > 0.0 and min(parts) > 0.0):
            raise InvalidInput("a time of the time block is not positive.", line=number)
        for (line, point), part in zip(block, parts, strict=True):
            self.course.move(line, point, part * whole / total)

    def _move(self, number: int, match: re.Match[str]) -> None:
        word, target = match[1].upper(), match[2]
        if self._spline and word == "PTP":
            raise refuse(number, match[0], "expected SPTP in a spline.")
        self._check_with(number, match[0], match[4])
        if target[0] == "$":
            if self._spline or target.upper() not in _WHERE_IT_IS:
                raise refuse(number, match[0], f"{target} is not read as a target.")
            self.course.note(f"line {number} moves to where the robot is ({target.upper()})")
            return
        text = target
        if target[0] != "{":
            first = next(iter(self.procedures.values())).name
            lacks = f"there are no axes of {target}, in the program or in {first}.dat."
            text = self.constant(number, target, target.upper(), lacks)
        point = self._target(number, text)
        if match[3].strip():
            self.course.rounds(number, match[3].strip())
        if self._block is None:
            self.course.move(number, point, None)
        else:
            self._block.append((number, point))

    def _target(self, number: int, text: str) -> list[float]:
        """The axes of an aggregate such as ``{E6AXIS: A1 0, A2 -90, …}``."""
        if not re.fullmatch(r"\{[^{}]*\}", text):
            raise refuse(number, text, "expected axes, {A1 …, A6 …}.")
        inside = text[1:-1].partition(":")
        fields: dict[str, float] = {}
        for part in (inside[2] or inside[0]).split(","):
            key, _, value = part.strip().partition(" ")
            if key.upper() in fields:
                raise refuse(number, text, f"{key} stands twice.")
            fields[key.upper()] = number_of(number, value, f"a number after {key}")
        if {"X", "Y", "Z"} & set(fields):
            raise refuse(number, text, "a Cartesian target; only axes {A1 …, A6 …} can be checked.")
        axes = {key for key in fields if not re.fullmatch(r"E[1-6]", key)}
        if axes != set(KRL.axis_names):
            raise refuse(number, text, f"expected the axes {', '.join(KRL.axis_names)}.")
        self.course.external(number, {key: fields[key] for key in sorted(fields.keys() - axes)})
        return [fields[axis] for axis in KRL.axis_names]

    def _check_with(self, number: int, statement: str, text: str | None) -> None:
        for part in split(text or ""):
            if part and not _WITH.fullmatch(part):
                raise refuse(number, statement, f"{part}: not read after WITH.")
            if part:
                # An inline form sets speed and tool of every move anew.
                speed = re.match(r"\$(VEL|ACC|GEAR)", part, re.I)
                note = self.course.speed if speed else self.course.setting
                note(number, part.partition("=")[0].strip())


KRL = Dialect(
    "krl", "KRL", ".src", "deg", 4, 5, tuple(f"A{k}" for k in range(1, AXES + 1)),
    False, _check_name, _encode, _decode,
)  # fmt: skip
"""KRL."""
