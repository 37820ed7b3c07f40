"""TP programs of Fanuc as text (LS).

Written are joint moves with their times in whole milliseconds (in tenths of a second above 32 s),
points as joint angles; straight moves (``L``) and circles (``C``) also to poses. On both the tool
turns in proportion from begin to end, at the point between of a circle, too: what a controller
makes of another turn there is not public. A program longer than
:data:`LONGEST` lines is divided, and a program of its name calls the parts.

Source: Fanuc, *R-30iA/R-30iB Operator's manual*, motion instructions and positional data:
R = R_z(R) R_y(P) R_x(W); ``COORD``, motion relative to the leader's group, and ``RTCP``, to a tool
that stands still, the user frame in force. The number of lines: that at which RoboDK's public post
processors for Fanuc divide programs.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import mink
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import of_file
from qp_twist.programs.fanuc_files import MORE, TpFiles, label_of
from qp_twist.programs.joint_moves import (
    AXES,
    Beside,
    Circle,
    Dialect,
    JointMoves,
    ProgramFrame,
    Speed,
    Target,
    Zone,
)
from qp_twist.programs.moves import JointMove, Kind, Moves
from qp_twist.programs.statements import CARRIES, NUMBER, Statements, refuse, shown
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import (
    Undecided,
    Unknown,
    Values,
    fixed,
    pose_of,
    zyx_angles,
    zyx_quaternion,
)

LONGEST = 9999
"""Lines of a program."""
_GROUP = "GP2_"
"""What the names of axes of the second motion group begin with: those of a positioner."""
_REMARK = 32
"""Characters of a remark."""
_PLACES = ("FN", "DU", "BT")
"""Letters of a configuration: flip or not, down or up, back or front (top)."""
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
DEFAULT_GROUP	= {groups};
CONTROL_CODE	= 00000000 00000000;
/MN
"""


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    title = name.upper()
    remarks = [f"  !{text} ;" for line in header for text in _remarks(line)]
    if moves.straight:
        if moves.tcp is not None:
            text = f"the task's frame in the flange: {LS.tool_text(moves.tcp)}"
            remarks += [f"  !{part} ;" for part in _remarks(f"UTOOL {moves.tool} has to be {text}")]
        remarks += [f"  UFRAME_NUM={_frame_of(moves)} ;", f"  UTOOL_NUM={moves.tool} ;"]
    count = len(moves.angles) - 1
    shares = np.array([0.0, *[1.0] * (count - 1), 0.0]) if moves.shares is None else moves.shares
    speeds = zip(moves.speeds or [None] * count, moves.durations.tolist(), strict=True)
    option = {"positioner": " COORD", "hand": " RTCP"}.get(moves.part, "")
    times = [_speed(speed.linear) if speed else _time(seconds) for speed, seconds in speeds]
    words = ["L" if each else "J" for each in moves.straight or [0] * count]
    circles = moves.circles or [None] * count
    ends = [
        f"CNT{share}" if share else "FINE" for share in np.rint(100.0 * shares).astype(int).tolist()
    ]
    targets = moves.targets or [None] * (count + 1)

    def point(angles: list[float], target: Target | None) -> str:
        if target is None:
            return _joint_text(angles, moves)
        return _cartesian_text(target, angles, moves)

    points = [point(*each) for each in zip(moves.angles.tolist(), targets, strict=True)]
    rows = zip(["J", *words], ["10%", *times], ends, points, [None, *circles], strict=True)
    statements = list[tuple[str, list[str]]]()
    for k, (word, how, end, to, circle) in enumerate(rows):
        if circle is None:
            more = option if word == "L" else ""
            statements.append((f"{word} P[{{}}] {how} {end}{more} ;", [to]))
        else:  # the second point stands on a line without a number
            via = point(circle.angles or moves.angles[k].tolist(), circle.target)
            statements.append((f"C P[{{}}]\n    :  P[{{}}] {how} {end} ;", [via, to]))
        behind = moves.lines_behind(k, "!{} ;", "CALL {} ;")
        statements += [(line, []) for each in behind for line in _behind(each)]
    room = LONGEST - len(remarks)
    if len(statements) <= room:
        return {f"{name}.ls": _program(title, remarks, statements, moves)}
    count = -(-len(statements) // LONGEST)
    share = -(-len(statements) // count)
    parts = [statements[k : k + share] for k in range(0, len(statements), share)]
    LS.check_name(f"{name}_{len(parts)}")
    calls = [f"  CALL {title}_{number} ;" for number in range(1, len(parts) + 1)]
    files = {f"{name}.ls": _program(title, [*remarks, *calls], [], moves)}
    for number, part in enumerate(parts, start=1):
        files[f"{name}_{number}.ls"] = _program(f"{title}_{number}", [], part, moves)
    return files


def _program(
    title: str, first: Sequence[str], moves: Sequence[tuple[str, list[str]]], of: JointMoves,
) -> str:  # fmt: skip
    """The text of a program: statements, then moves and their points."""
    external = of.external
    groups = "1,1,*,*,*" if any(each.name.startswith(_GROUP) for each in external) else "1,*,*,*,*"
    lines, points = [*first], list[str]()
    for line, own in moves:
        lines.append(line.format(*range(len(points) + 1, len(points) + len(own) + 1)))
        points += own
    text = _HEAD.format(name=title, count=len(lines), groups=groups)
    text += "".join(f"{number:4d}:{line}\n" for number, line in enumerate(lines, start=1))
    text += "/POS\n"
    text += "".join(f"P[{k}]{{\n{point}}};\n" for k, point in enumerate(points, start=1))
    return text + "/END\n"


def _joint_text(angles: Sequence[float], of: JointMoves) -> str:
    """A point as joint angles, in its motion groups."""
    axes = _axes(angles, of)
    own = [axis for axis in axes if not axis.startswith(_GROUP)]
    part = [axis.removeprefix(_GROUP) for axis in axes if axis.startswith(_GROUP)]
    text = ""
    for group, found in enumerate(filter(None, (own, part)), start=1):
        rows = [", ".join(found[k : k + 3]) for k in range(0, len(found), 3)]
        text += f"   GP{group}:\n\tUF : {_frame_of(of)}, UT : {of.tool},\n\t"
        text += ",\n\t".join(rows) + "\n"
    return text


def _axes(angles: Sequence[float], of: JointMoves) -> list[str]:
    """The axes of a point, those of the robot first."""
    names = [*LS.axis_names, *(each.name for each in of.external)]
    units = [LS.unit] * AXES + [each.unit for each in of.external]
    values = zip(names, angles, units, strict=True)
    return [f"{name}= {value:.{LS.decimals}f} {unit}" for name, value, unit in values]


def _frame_of(moves: JointMoves) -> str:
    """The number of the user frame; 0, the robot's base, where no other is stated."""
    if moves.part == "hand":  # the frame of the tool that stands still
        return str(moves.frame)
    target = next(filter(None, moves.targets), None)
    return target.frame.name if target and target.frame.pose is None else "0"


def _cartesian_text(target: Target, angles: Sequence[float], of: JointMoves) -> str:
    """A point as a pose with its configuration, and the external axes of the robot."""
    own = target.frame.pose
    letters = " ".join(
        pair[not each] for pair, each in zip(_PLACES, target.configuration[:3], strict=True)
    )
    turns = ", ".join(map(str, target.configuration[len(_PLACES) :]))
    end, own_axes = "\n\t", _axes(angles, of)[AXES:]
    x, y, z, *turned = _pose_texts(target.pose if own is None else own @ target.pose)
    return (
        f"   GP1:\n\tUF : {_frame_of(of)}, UT : {of.tool},\tCONFIG : '{letters}, {turns}',\n"
        f"\t{x}, {y}, {z},\n\t{', '.join(turned)}{''.join(f',{end}{axis}' for axis in own_axes)}\n"
    )


def _pose_texts(pose: mink.SE3) -> list[str]:
    """X, Y, Z, W, P, R."""
    values = [*(1e3 * pose.translation()), *zyx_angles(pose.rotation())[::-1]]
    named = zip("XYZWPR", values, ["mm"] * 3 + ["deg"] * 3, strict=True)
    return [f"{key}= {fixed(value, LS.decimals)} {unit}" for key, value, unit in named]


def _time(seconds: float) -> str:
    milliseconds = round(1000.0 * seconds)
    if milliseconds <= _MS:
        return f"{milliseconds}msec"
    return f"{math.ceil(milliseconds / 100.0) / 10.0:.1f}sec"


def _behind(line: str) -> list[str]:
    """A line behind a point; a remark in lines short enough."""
    return [line] if line[0] != "!" else [f"!{text} ;" for text in _remarks(line[1:-2])]


def _speed(speed: float) -> str:
    """In the first unit in which it is whole."""
    found = ((round(speed / _FEEDS[unit]), unit) for unit in _UNITS)
    return next(f"{n}{unit}" for n, unit in found if math.isclose(n * _FEEDS[unit], speed))


def _remarks(line: str) -> list[str]:
    """A header line in remarks short enough; a semicolon would end them."""
    first, *others = textwrap.wrap(line.replace(";", ","), _REMARK - len(MORE)) or [""]
    return [first, *(f"{MORE}{text}" for text in others)]


_FIELD = re.compile(
    rf"GP(?P<group>\d)\s*:|(?:UF\s*:\s*(?P<frame>\w+)|UT\s*:\s*\w+)|CONFIG\s*:\s*'[^']*'"
    rf"|(?P<axis>[JE]\d|[XYZWPR])\s*=\s*(?P<value>{NUMBER}|\*+)\s*(?P<unit>\w*)",
    re.ASCII,
)
_FEEDS = {"mm/sec": 1e-3, "cm/min": 1e-2 / 60.0, "inch/min": 0.0254 / 60.0}
"""m/s in units of speeds."""
_OF_GROUP_2 = " of group 2"
_UNITS = ("mm/sec", "cm/min")
"""Those of speeds that are written, which are whole numbers."""
_NUMBERED = r"(?P<{}>PR?)\[\s*(?P<{}_number>R\s*\[[^\]]*\]|\w+)\s*(?::[^\]]*)?\]"
_NOTED: Mapping[Kind, Sequence[str]] = {
    "pause": (r"(WAIT)\s+(?!.*\b(?:TIMEOUT|LBL)\b)[^;]*[=<>][^;]*", r"(PAUSE)"),
    "speed": (rf"(OVERRIDE)\s*=\s*{NUMBER}\s*%",),
    "setting": (r"(PAYLOAD)\s*\[\s*\d+\s*\]",),
    # outputs, flags, timers and messages: no move that is read depends on them
    "passed": (
        r"(DO|RO|GO|AO|SO|F|M|SR|TIMER)\s*\[(?!.*\b(?:CALL|RUN|JMP)\b)[^\]]*\]\s*=.*",
        r"(MESSAGE)\s*\[.*\]",
    ),
}
_COMPARISON = [("<>", "!="), (r"(?<![<>!=])=(?!=)", "=="), (r"(?i)\bAND\b", "and"),
               (r"(?i)\bOR\b", "or")]  # fmt: skip


def _key(text: str) -> str:
    """Each register is a variable: R[1:parts] is r_1."""
    return re.sub(r"\br\s*\[\s*(\d+)\s*(?::[^\]]*)?\]", r"r_\1", text.lower())


def _translate(text: str) -> str:
    return re.sub(r"\bdiv\b", "//", re.sub(r"\bmod\b", "%", text))


class _Point(NamedTuple):
    """A point: its angles or its pose, its external axes, its tool, and the target of a pose."""

    angles: list[float] | None = None
    pose: mink.SE3 | None = None
    external: Mapping[str, tuple[float, str]] = MappingProxyType({})
    tool: str = ""
    target: Target | None = None


class TpProgram(TpFiles):
    """A program, and those that it calls.

    Attributes:
        last_line: Of its last statement.
    """

    language = Language(
        opens=(
            (r"FOR\s+(?P<name>R\[.*?\])\s*=(?P<first>.*?)\b(?P<down>DOWN)?TO\b(?P<last>.*)",
             "ENDFOR", "for"),
            (r"IF\b(?P<condition>.*)\bTHEN", "ENDIF", "if"),
        ),
        otherwise=r"ELSE(?P<condition>(?!))?",
        coordinates=r"\bPR?\s*\[",
        reads="joint moves (J P[…] with a speed or time, FINE or CNT), straight ones and circles "
        "(L P[…], C P[…] P[…] with a time, or in mm/sec, cm/min or inch/min), one after the other,",
    )  # fmt: skip

    def __init__(self, moves: Moves, beside: Beside) -> None:
        values = Values(_key, _translate, {}, lambda text: None, _COMPARISON)
        super().__init__(values, moves, beside)
        self._file = ""
        self._at_labels: dict[str, dict[str, Any]] = {}
        self._numbers: dict[str, str] = {}
        self.last_line = 0

    def grammar(self) -> Sequence[Rule]:
        """Moves, jumps, registers, words that move nothing, calls."""
        end, via = _NUMBERED.format("p", "p"), _NUMBERED.format("q", "q")
        rest = (r"\s*(?P<speed>.*?)\s*(?P<zone>FINE|CNT\s*\w+(?:\[.*?\])?|CR\s*\w+)?"
                r"(?P<options>(?<=\d)\s.*|(?<=E)\s.*|)")  # fmt: skip
        joint = "[JLC]" if self.moves.strict else "J"  # then L and C to joint angles, too
        return (
            (r"(?:!|//|--).*|", "", "silent"),
            (rf"(?P<word>{joint})\s+{end}(?:\s+{via})?{rest}", self._move, "joint"),
            (rf"(?P<word>[JLCA])\s+{end}(?:\s+{via})?{rest}", self._move, "path"),
            (r"P\s*\[\s*(\d+)[^=]*=.*", self._change, "path"),
            (r"(?:\w\s+PR?\[|OFFSET|TOOL_OFFSET|VOFFSET|UFRAME\s*\[|UTOOL\s*\[|SKIP|COL\s+GUARD|RSR"
             r"|S\s|TRACK|DEFENC|VISION|SELECT).*", self.refuse, "path"),
            (r"LBL\[.*", self._pass_label, "skip"),
            (r"JMP\s+(?P<label>LBL\s*\[.*\])", self._jump_to, "path"),
            (r"IF\b(?P<condition>.*?),\s*(?P<statement>JMP\b.*)", self._if, "path"),
            (r"IF\b(?P<condition>.*?),\s*(?P<statement>CALL\s+(?P<called>\w+)[^,]*)", self._if,
             "skip"),
            (r"IF\b.*,\s*(?P<name>R\s*\[.*?\])\s*=(?P<value>.*)", self._may_assign, "skip"),
            (r"IF\b.*,\s*[JLCA]\s+PR?\s*\[.*", self.refuse, "path"),
            (rf"(WAIT)\s+({NUMBER})\s*\(sec\)", self.wait, "pause"),
            (r"WAIT\b.*\bTIMEOUT\s*,\s*LBL\b.*", self._wait_or_jump, "skip"),
            (r"(?P<word>UFRAME_NUM|UTOOL_NUM)\s*=\s*(?P<number>\d+)", self._set_number, "setting"),
            *self.noting(_NOTED),
            (r"R\s*\[\s*\D.*?=.*", self._assign_some, "skip"),
            (r"(?P<name>R\s*\[.*?\])\s*=(?P<value>.*)", self.assign, "assigns"),
            (r"IF\b.*|(?:ELSE|MESSAGE|WAIT|UTOOL_NUM|UFRAME_NUM|OVERRIDE|PAYLOAD|\$|PR\s*\[).*",
             self.skip, "skip"),
            (r"ABORT", "end", "leaves"), (r"END", "return", "leaves"),
            (r"CALL\s+(?P<called>\w+)", self._call_file, "call"),
            (r"(?:CALL|RUN)\s+(?P<called>\w+)\s*(?P<arguments>\(.*\))?", self._call_file, "skip"),
            (r"(?P<called>[A-Za-z][\w ]*)(?P<arguments>.*)", self.call, "skip"),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    # ------------------------------------------------------------ what runs

    def _call_file(self, line: int, match: re.Match[str]) -> str | None:
        """A call of a program beside this one."""
        name, key = match["called"], match["called"].lower()
        if not self._load(name):
            if self.moves.called(line, name):
                return None
            if self.moves.strict:
                raise refuse(line, match[0], f"there is no {name}.ls beside the file.")
            self._forget_registers(f"{name} of line {line} may have changed it")
            return self.call(line, match)
        before, self._file = self._file, key
        with of_file(f"{name}.ls"):
            signal = self._call(line, key, [])
        self._file = before
        return signal

    def first(self, uncalled: list[str]) -> list[str]:
        """What stands in the file runs, and what it calls."""
        return []

    def _may_move(self, body: Statements) -> bool:
        """Whether statements move, or call a program that is not beside this one."""
        return self.listing.moving(body) is not None or any(
            re.match(r"(?:IF\b.*,\s*)?(?:CALL|RUN)\b", text, re.IGNORECASE)
            and match["called"].lower() not in self.listing.procedures
            for _, text, match, _ in self.listing.reached(body)
        )

    def _pass_over(self, line: int, begin: str, body: Statements, why: str) -> None:
        super()._pass_over(line, begin, body, why)
        if self._may_move(body):
            raise refuse(line, begin, "decides whether a program runs that is not beside the file.")

    def _registers(self) -> dict[str, Any]:
        names = self.values.names.items()
        return {name: None if isinstance(value, Unknown) else value for name, value in names}

    def _pass_label(self, line: int, match: re.Match[str]) -> None:
        self._at_labels[match[0]] = self._registers()

    def _jump_to(self, line: int, match: re.Match[str]) -> str:
        """A jump; back to a label since which no register has changed, it would be for ever."""
        label = label_of(match["label"])
        if label not in self._labels and line < self.last_line:
            raise refuse(line, match[0], f"there is no {match['label']}.")
        if label not in self._labels or self._at_labels.get(label) == self._registers():
            self.moves.note(f"{shown(match[0])} (line {line}) is for ever: read once")
            return "end"
        return f"to {label}"

    def _if(self, line: int, match: re.Match[str]) -> str | None:
        """A statement behind a condition."""
        try:
            holds = self.values.condition(match["condition"])
        except Undecided:
            called = match.groupdict().get("called")
            if called and not self._may_move([(line, match["statement"])]):
                self.skip(line, match)
                return None
            self.undecided(line, match)
        return self.run([(line, match["statement"])]) if holds else None

    def _wait_or_jump(self, line: int, match: re.Match[str]) -> None:
        self.moves.note(
            f"{shown(match[0])} (line {line}) is taken to be met before its time is out"
        )
        self.skip(line, match)

    def _may_assign(self, line: int, match: re.Match[str]) -> None:
        self.values.forget(match["name"], f"{match['name']} depends on {shown(match[0])}")
        self.skip(line, match)

    def _assign_some(self, line: int, match: re.Match[str]) -> None:
        """An assignment to a register whose number is in another one."""
        self._forget_registers(f"{shown(match[0])} (line {line}) may have changed it")
        self.skip(line, match)

    def _forget_registers(self, why: str) -> None:
        for name in self.values.names:
            self.values.forget(name, why)

    def _change(self, line: int, match: re.Match[str]) -> None:
        """A point that the program changes is one that the file does not state."""
        self._points[self._file][int(match[1])] = ""

    def _set_number(self, line: int, match: re.Match[str]) -> None:
        self.moves.noted(line, match["word"], "setting")
        for group in ("", _OF_GROUP_2):
            self._numbers[f"{match['word'][:2].upper()}{group}"] = match["number"]

    # ------------------------------------------------------------ moves

    def _check_options(self, line: int, match: re.Match[str]) -> None:
        options = f"{match['speed']} {match['options']}".upper()
        if re.search(r"\bRTCP\b", options) and not self.moves.strict:
            raise refuse(line, match[0], CARRIES)
        unread = r"\b(?:INC|OFFSET|TOOL_OFFSET|VOFFSET|SKIP|EV|COORD\[)"
        if match["word"].upper() == "A" or re.search(unread, options):
            self.refuse(line, match)
        zone = match["zone"] or "nothing"
        if self.moves.strict and not re.fullmatch(r"FINE|CNT\s*(?:\d\d?|100)", zone, re.I):
            what = f"expected FINE, or CNT0 to CNT100, behind the speed, got {zone}."
            raise refuse(line, match[0], what)

    def _move(self, line: int, match: re.Match[str]) -> None:
        word, moves, zone = match["word"].upper(), self.moves, match["zone"] or ""
        self._check_options(line, match)
        timed = re.fullmatch(rf"({NUMBER})\s*(%|sec|msec)", match["speed"], re.I)
        speed = re.fullmatch(r"(.+?)\s*(mm/sec|cm/min|inch/min)", match["speed"], re.I)
        fast = word != "J" and speed and re.fullmatch(NUMBER, speed[1])
        known = (word == "J" or timed[2] != "%") if timed else fast
        points = f"{match['p']}{match['q'] or ''}".upper() == ("PP" if word == "C" else "P")
        more = r"(\s*ACC\s*\d+)?" + r"(\s*(COORD|RTCP))?" * (word == "L")
        if moves.strict and not (known and points and re.fullmatch(more, match["options"], re.I)):
            way = "two points P[…]" if word == "C" else "P[…]"
            how = "a share or a time" if word == "J" else "a time, or a speed in mm/sec or cm/min"
            what = f"{word} is not read so; expected {way}, {how}, FINE or CNT, and at most ACC."
            raise refuse(line, match[0], what)
        if zone and zone.upper() not in ("FINE", "CNT0"):
            number = re.fullmatch(r"CNT\s*(\d+)", zone, re.I)
            moves.rounds(Zone(line, zone, share=int(number[1]) / 100.0 if number else 1.0))
        if "ACC" in match["options"].upper():
            moves.noted(line, "ACC", "speed")
        along = _FEEDS[speed[2].lower()] * self.values.number(speed[1]) if speed else math.nan
        first = self._point(line, match["p"], match["p_number"])
        on_circle = word == "C" and moves.strict
        end = self._point(line, match["q"], match["q_number"]) if on_circle else first
        angles, pose, external, tool, target = end
        circle = Circle("space", first.angles, first.target, turned=True) if on_circle else None
        if circle and (first.external or first.tool != tool):
            why = "expected one tool for both points, and no external axes at the first."
            raise refuse(line, match[0], why)
        if word != "J":
            moves.uses(self._numbers.get("UT", ""), self._numbers.get("UF", ""))
        if word == "J" or moves.strict:
            unit = {"sec": 1.0, "msec": 1e-3}
            timing = unit[timed[2].lower()] * float(timed[1]) if timed and timed[2] != "%" else None
            part = self._part(line, match, target) if word == "L" else ""
            moves.joint(JointMove(
                line, angles, pose, timing, None, external, "" if word == "J" else tool,
                target, Speed(along) if speed else None, part, circle,
            ))  # fmt: skip
            return
        moves.feed = along
        if pose is None:
            raise refuse(line, match[0], "where this is in space is not in the file (joint angles, "
                         "or a register); write a position, X Y Z W P R.")  # fmt: skip
        if word == "L":
            moves.line(line, pose)
        elif not match["q"]:
            raise refuse(line, match[0], "expected two points, C P[1] P[2].")
        else:
            last = self._point(line, match["q"], match["q_number"]).pose
            if last is None:
                self.refuse(line, match)
            moves.arc(line, pose, last)

    def _part(self, line: int, match: re.Match[str], target: Target | None) -> str:
        """What moves the part on which a straight move is."""
        options, own = match["options"].upper(), match[0]
        part = "positioner" if "COORD" in options else "hand" if "RTCP" in options else ""
        if part and target is not None:
            raise refuse(line, own, "on a part that moves, points are read as joint angles alone.")
        if part == "positioner":
            self.moves.note("COORD: the leader of the robot has to be group 2, and carry the part")
        return part

    def _point(self, line: int, kind: str, number: str) -> _Point:
        """The angles or the pose of a point, and its frame; none of a register."""
        if kind.upper() == "PR":
            return _Point()
        if not number.isdecimal():
            number = f"{self.values.value(number):g}"
        inside = self._points[self._file].get(int(number)) if number.isdecimal() else None
        if inside is None:
            raise InvalidInput(f"there is no P[{number}] under /POS", line=line)
        if not inside:
            return _Point()
        axes, frame, external = _fields(f"P[{number}]", inside, strict=self.moves.strict)
        tool = (re.search(r"\bUT\s*:\s*(\w+)", inside) or ["", ""])[1]
        own_group, _, others = inside.partition("GP2")
        for group, text in (("", own_group), (_OF_GROUP_2, others)):
            for key, own in re.findall(r"\b(UF|UT)\s*:\s*(\d+)\b", text):
                now = self._numbers.setdefault(f"{key}{group}", own)
                if self.moves.strict and int(now) != int(own):
                    raise InvalidInput(
                        f"P[{number}] has {key} : {own}{group}, but "
                        f"{'UFRAME' if key == 'UF' else 'UTOOL'}_NUM, or a point before it, has "
                        f"{now}; the controller stops there.",
                        line=line,
                    )
        if not {*"XYZ"} & axes.keys():
            angles = [value for _, value in sorted(axes.items())]
            return _Point(angles, None, external, f"tool {tool}" if tool else "")
        self.moves.external(line, external)
        if not {*"XYZWPR"} <= axes.keys():
            raise InvalidInput(f"P[{number}]: expected X, Y, Z in mm and W, P, R in deg", line=line)
        if not frame.isdecimal():
            raise InvalidInput(f"P[{number}] does not state its frame, UF", line=line)
        self.moves.frame = f"UFRAME {frame}", None
        x, y, z, w, p, r = (axes[key] for key in "XYZWPR")
        pose, target = pose_of((x, y, z), zyx_quaternion(r, p, w)), None
        if self.moves.strict:
            target = Target(
                pose, _numbered("tool", tool), _numbered("UFRAME", frame),
                _configuration(line, f"P[{number}]", inside), line,
            )  # fmt: skip
        return _Point(None, pose, external, f"tool {tool}" if tool else "", target)


def _numbered(what: str, number: str) -> ProgramFrame:
    """A tool or frame by its number; 0 is the flange, or the robot's base."""
    is_none = number.isdecimal() and int(number) == 0
    return ProgramFrame(f"{what} {number}", mink.SE3.identity() if is_none else None)


def _configuration(line: int, point: str, inside: str) -> tuple[int, ...]:
    """The numbers of a configuration, N U T, 0, 0, 0."""
    text = (re.search(r"CONFIG\s*:\s*'([^']*)'", inside) or ["", ""])[1]
    pattern = r"\s*([FN])\s*([DU])\s*([BT])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*"
    found = re.fullmatch(pattern, text, re.ASCII)
    if not found:
        raise InvalidInput(
            f"{point}: expected CONFIG : 'N U T, 0, 0, 0', got {text or 'none'!r}.", line=line
        )
    letters, turns = found.groups()[: len(_PLACES)], found.groups()[len(_PLACES) :]
    return (*(int(a == b[0]) for a, b in zip(letters, _PLACES, strict=True)), *map(int, turns))


def _fields(
    point: str, inside: str, *, strict: bool
) -> tuple[dict[str, float], str, dict[str, tuple[float, str]]]:
    """The numbers of a point, its user frame, and its external axes with their units."""
    axes: dict[str, float] = {}
    external: dict[str, tuple[float, str]] = {}
    frame = group = ""
    for match in _FIELD.finditer(inside):
        frame, axis = frame if group else match["frame"] or frame, match["axis"]
        if match["group"] not in (None, "1"):
            if strict and (match["group"] != "2" or group):
                raise InvalidInput(f"{point} moves more motion groups than 1 and 2.")
            group = f"GP{match['group']}_"
        if axis is None:
            continue
        units = {"E": ("deg", "mm"), "X": ("mm",), "Y": ("mm",), "Z": ("mm",)}
        expected = ("deg", "mm") if group else units.get(axis[0], ("deg",))
        if group and axis[0] != "J":
            raise InvalidInput(f"{point}: {axis} of group 2 is not read; expected its joints, J1=.")
        if match["unit"] not in expected:
            raise InvalidInput(
                f"{point}, {axis}: the unit is {match['unit'] or 'missing'!r}; expected "
                f"{' or '.join(expected)}."
            )
        name = group + axis
        if name in axes or name in external:
            raise InvalidInput(f"{point}: {name} stands twice.")
        if match["value"][0] == "*":
            raise InvalidInput(f"{point}: {axis} is not taught ({match['value']}).")
        if group or axis[0] == "E":
            external[name] = float(match["value"]), match["unit"]
        else:
            axes[axis] = float(match["value"])
    if strict and (left := _FIELD.sub("", inside).replace(",", " ").strip()):
        raise InvalidInput(f"{point}: {left[:60]!r} is not read.")
    return axes, frame, external


def _execute(moves: Moves, lines: Sequence[str], stem: str, beside: Beside) -> list[str]:
    """Execute a program; its remarks."""
    program = TpProgram(moves, beside)
    found = program.read(lines)
    program.load_called(found)
    program.last_line = found[-1][0] if found else 0
    program.execute(found)
    return program.comments


_PARTS = {
    "positioner joints": "COORD: group 2 has to be the leader of group 1 and carry the part.",
    "hand joints": "RTCP: UFRAME {frame} has to be the task's frame, the tool that stands still.",
}
LS = Dialect(
    "ls", "a TP program", ".ls", "deg", 4, 3, tuple(f"J{k}" for k in range(1, AXES + 1)),
    False, 36, "8 on controllers before R-30iA", _encode, _execute,
    external=(*(f"E{k}" for k in range(1, 4)), *(f"{_GROUP}J{k}" for k in range(1, 7))),
    of_parts=_GROUP, period=0.008, points=("joints", "poses"), circles=("space",),
    speeds=tuple(_FEEDS[unit] for unit in _UNITS),
    to_fill_in=("PAYLOAD[...]",), frames_to_fill_in=("UTOOL_NUM=...", "UFRAME_NUM=..."),
    rounding=lambda shares, _: np.floor(100.0 * shares + 1e-9) / 100.0,
    states_frames=False, parts=_PARTS, tool_text=lambda tcp: ", ".join(_pose_texts(tcp)),
)  # fmt: skip
"""TP programs. The period is that of the controller's interpolation (ITP): 8 ms (that of Fanuc's
RRS server, Dassault Systèmes, *3DEXPERIENCE User Assistance*, RRS)."""
