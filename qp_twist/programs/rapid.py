r"""RAPID, of ABB.

Written are absolute joint moves, each with its time (``\T``). External axes that the path does not
need are not moved (``9E9``); those that it needs are in mm or degrees.

Circles are ``MoveC``, on which the tool turns in proportion as seen from the path.

Source: ABB, *Technical reference manual, RAPID Instructions, Functions and Data types*
(3HAC050917): MoveAbsJ, MoveL, MoveC, MoveJ, jointtarget, robtarget, wobjdata, speeddata, zonedata,
Offs, RelTool. The length of an identifier: *RAPID overview*, Basic elements.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import mink

from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import AXES, Beside, Circle, Dialect, JointMoves, Target
from qp_twist.programs.moves import JointMove, Kind, Moves
from qp_twist.programs.rapid_data import EXTERNAL, TOOL, WOBJ, Z0, RapidData
from qp_twist.programs.statements import CARRIES, NUMBER, Statements, refuse, split, without_texts
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import Unknown, fixed

_NONE = "9E9"
_OFFS = "\\NoEOffs,"
_MM = 4
"""Decimals of positions, mm."""
_SPEED = 4
"""Decimals of speeds, mm/s and degrees/s."""
_PREFIX = "run_"


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    names = [column.name for column in moves.external]

    def target(point: list[float]) -> str:
        texts = [f"{value:.{RAPID.decimals}f}" for value in point]
        values, given = ",".join(texts[:AXES]), dict(zip(names, texts[AXES:], strict=False))
        external = ",".join(given.get(name, _NONE) for name in RAPID.external)
        return f"    MoveAbsJ [[{values}],[{external}]]{_OFFS}"

    def pose(to: Target, joints: str) -> str:
        external = joints.partition("],[")[2].partition("]")[0]
        return f"[{_pose_text(to.pose)},[{','.join(map(str, to.configuration))}],[{external}]]"

    first, *others = (target(point) for point in moves.angles.tolist())
    count = len(others)
    none = (None,) * count
    targets, speeds = moves.targets[1:] or none, moves.speeds or none
    circles = moves.circles or none
    tool, frame, data = f"tool{moves.tool}", "", list[str]()
    if stated := next(filter(None, targets), None):
        tool, frame, data = _stated(stated)
    on_part = f"\\WObj:=wobj{moves.frame}" if moves.part else ""
    lines = [f"MODULE {name}", *(f"  ! {line}" for line in header), *data]
    behind = "    ! {}", "    {};"
    lines += [f"  PROC {_PREFIX}{name}()", f"{first}v50,fine,tool0;"]
    lines += moves.lines_behind(0, *behind)
    times = [f"{seconds:.{RAPID.time_decimals}f}" for seconds in moves.durations.tolist()]
    for number, (to, seconds, at, speed, circle) in enumerate(
        zip(others, times, targets, speeds, circles, strict=True), start=1
    ):
        zone = "fine" if moves.stops[number] else "z0"
        word = "MoveC" if circle else "MoveL"
        end = f"v1000\\T:={seconds},{zone}"
        if at is not None and speed is not None:
            tcp, turn = 1e3 * speed.linear, math.degrees(speed.angular)
            fast = f"[{tcp:.{_SPEED}f},{turn:.{_SPEED}f},5000,1000]"
            via = f"{pose(circle.target, to)}," if circle and circle.target else ""
            lines.append(f"    {word} {via}{pose(at, to)},{fast},{zone},{tool}\\WObj:={frame};")
        elif moves.straight is not None and moves.straight[number - 1]:
            at_joints = [target(circle.angles)] if circle and circle.angles else []
            places = ",".join(
                f"CalcRobT({each.strip().removeprefix('MoveAbsJ ').removesuffix(_OFFS)},{tool}"
                f"{on_part})"
                for each in (*at_joints, to)
            )
            lines.append(f"    {word} {places},{end},{tool}{on_part};")
        else:
            lines.append(f"{to}{end},tool0;")
        lines += moves.lines_behind(number, *behind)
    lines += ["  ENDPROC", "ENDMODULE", ""]
    return {f"{name}{RAPID.suffix}": "\n".join(lines)}


def _pose_text(pose: mink.SE3) -> str:
    """Position, mm, and quaternion with its largest component positive."""
    w = pose.rotation().wxyz
    w = w * math.copysign(1.0, w[int(abs(w).argmax())])
    xyz = ",".join(fixed(x, _MM) for x in 1e3 * pose.translation())
    return f"[{xyz}],[{','.join(fixed(x, 9) for x in w)}]"


def _stated(target: Target) -> tuple[str, str, list[str]]:
    """Names of the tool and the work object of a target, and the data where they have values.

    The tool's mass is -1, which controllers do not take: a person has to state the load.
    """
    tool, frame, data = f"tool{target.tool.name}", f"wobj{target.frame.name}", list[str]()
    if target.tool.pose is not None:
        tool = "task_tool"
        load = "[-1,[0,0,0],[1,0,0,0],0,0,0]"
        value = f"[TRUE,[{_pose_text(target.tool.pose)}],{load}]"
        data.append(f"  LOCAL PERS tooldata {tool}:={value};")
    if target.frame.pose is not None:
        frame = WOBJ
        own = "[[0,0,0],[1,0,0,0]]"
        value = f'[FALSE,TRUE,"",[{_pose_text(target.frame.pose)}],{own}]'
        data.append(f"  LOCAL PERS wobjdata {frame}:={value};")
    return tool, frame, data


_NAME = r"[A-Za-z]\w*"
_DATA = (
    rf"(?:(?:LOCAL|TASK)\s+)*(?P<storage>CONST|PERS|VAR)\s+(?P<kind>{_NAME})\s+(?P<name>{_NAME})"
    r"(?P<part>(?:\s*\{[\d\s,]*\})?)\s*(?::=(?P<value>.*))?"
)
_ASSIGNMENT = rf"(?P<name>{_NAME})(?P<part>(?:\s*\.\s*\w+|\s*\{{[^{{}}]*\}})*)\s*:=(?P<value>.*)"
_INSTRUCTIONS: dict[Kind, str] = {
    # outputs, messages, clocks, and settings of Cartesian moves and of supervision
    "passed": "ConfJ|ConfL|SingArea|Set|Reset|SetDO|SetAO|SetGO|PulseDO|InvertDO|TPWrite|TPErase"
              "|ClkStart|ClkStop|ClkReset|MotionSup",
    "pause": "WaitTime|WaitDI|WaitDO|WaitAI|WaitGI|WaitUntil|WaitRob|Stop",
    "speed": "VelSet|AccSet|PathAccLim|WorldAccLim",
    "setting": "GripLoad",
}  # fmt: skip
_NOTED: Mapping[Kind, Sequence[str]] = {
    kind: [rf"({names})\b(.*)"] for kind, names in _INSTRUCTIONS.items()
}
_OPTIONS = {"id", "noeoffs", "v", "t", "z", "inpos", "wobj", "tload"}
"""Options of MoveAbsJ."""
_MOVES = (
    r"(?:Move|Trigg|Arc|Disp|Paint)(?P<kind>L|C|J|AbsJ)(?:Start|End|\d|DO|AO|GO|Sync|IOs)?\b"
    r"(?P<arguments>.*)"
)
_OPEN = r"(?:IF\b[^;]*?\bTHEN|WHILE\b[^;]*?\bDO|TEST\b[^;:]*?(?=\bCASE\b|$))"
_END = r"END(?:IF|FOR|WHILE|TEST|PROC|FUNC|TRAP|MODULE|RECORD)"
_PROCEDURE = r"(?:LOCAL\s+)?(?:PROC|FUNC\s+\w+)\s+(?P<name>\w+)\s*\((?P<arguments>[^()]*)\)"
_HEAD = re.compile(
    rf"{_PROCEDURE}|(?:LOCAL\s+)?TRAP\s+\w+|RECORD\s+\w+|MODULE\s+\w+(?:\s*\([^)]*\))?|\b{_OPEN}"
    rf"|\bELSEIF\b[^;]*?\bTHEN\b|\bELSE\b|\bFOR\b[^;]*?\bDO\b|\bCASE\b[^:]*:(?!=)"
    rf"|\bDEFAULT\s*:(?!=)|\b{_END}\b|^\s*(?:ERROR|UNDO|BACKWARD)\s*$",
    re.IGNORECASE | re.ASCII,
)
"""What no semicolon ends."""
_PARTS = {
    "positioner joints": "wobj{frame} has to be on the part (ufprog FALSE, ufmec its unit).",
    "positioner poses": "wobj{frame} has to be the part's frame (ufprog FALSE, ufmec its unit).",
    "hand joints": "wobj{frame} has to be on the part (robhold TRUE), tool{tool} to stand still at "
                   "the task's frame (robhold FALSE).",
}  # fmt: skip


class RapidModule(RapidData):
    """A module."""

    language = Language(
        opens=(
            (r"MODULE\b.*", "ENDMODULE", "once"), (r"RECORD\b.*", "ENDRECORD", "never"),
            (r"(?:LOCAL\s+)?TRAP\s+(?P<name>\w+)", "ENDTRAP", "never"),
            (_PROCEDURE, "END(?:PROC|FUNC)", "procedure"),
            (r"WHILE\s+\(?\s*TRUE\s*\)?\s*DO", "ENDWHILE", "for ever"),
            (r"FOR\s+(?P<name>\w+)\s+FROM\b(?P<first>.*)\bTO\b(?P<last>.*?)"
             r"(?:\bSTEP\b(?P<step>.*))?\bDO", "ENDFOR", "for"),
            (r"IF\b(?P<condition>.*)\bTHEN", "ENDIF", "if"),
            (r"WHILE\b(?P<condition>.*)\bDO", "ENDWHILE", "while"),
            (r"TEST\b.*", "ENDTEST", "open"),
        ),
        otherwise=r"ELSEIF\b(?P<condition>.*)\bTHEN|ELSE",
        outside=_DATA, enclosed=True,
        own_counter=True,
        reads="joint moves (MoveAbsJ, MoveJ), straight ones (MoveL) and circles (MoveC) to "
        "literals or constants, one after the other,",
    )  # fmt: skip

    def grammar(self) -> Sequence[Rule]:
        """Moves, data, words that move nothing, calls."""
        return (
            (r"MoveAbsJ\b(?P<arguments>.*)", self._move_joints, "joint"),
            *self._straight_rule(),
            (_MOVES, self._move, "path"),
            (r"(?:Search[LC]|FC\w+|Contact\w*|EGM\w*|Corr\w*|TrackMove\w*|PDisp(?:On|Set)|EOffs(?:On"
             r"|Set)|GOTO|CallByVar|PathRecMove\w*|StepBwdPath|MoveExtJ|%|Load\s)\b.*",
             self.refuse, "path"),
            (rf"IF\b.*(?:\b{_MOVES}|:=|\bGOTO|\bRETURN|\bEXIT).*", self.refuse, "path"),
            (r"EXIT", "end", "leaves"), (r"RETURN\b.*", "return", "leaves"),
            (r"BREAK", self.refuse, "path"),
            (r"ERROR|UNDO|BACKWARD", "return", "skip"),
            (_DATA, self._data, "assigns"),
            (_ASSIGNMENT, self.assign, "assigns"),
            (r"(?:ELSE|ELSEIF|CASE|DEFAULT)\b.*", self.skip, "skip"),
            (r"CONNECT\b.*\bWITH\s+(?P<beside>\w+)", self.beside, "skip"),
            (rf"(WaitTime)(?:\s*\\InPos\s*,|\s)\s*({NUMBER})", self.wait, "pause"),
            (r"(WaitRob)\s*\\(?:InPos|ZeroSpeed)", self.stop, "pause"),
            (r"(SingArea)\s*\\\s*(?P<mode>\w+)", self._singular_area, "passed"),
            *self.noting(_NOTED),
            (r"(CirPathMode)\s*\\\s*(?P<mode>PathFrame|ObjectFrame)", self._circle_mode, "setting"),
            (r"(?:SyncMove\w*|WaitSyncTask|Trigg[A-Z]\w*|CirPathMode|WZ\w+)\b.*", self.skip,
             "skip"),
            (r"IF\b.*?(?P<called>\w+)", self._conditional, "skip"),
            (r"(?P<called>\w+)\s*(?P<arguments>(?<=\s)[^\s].*)?", self.call, "call"),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    def parameter(self, words: Sequence[str]) -> str:
        """A parameter stands behind its kind."""
        return words[-1]

    def _data(self, line: int, match: re.Match[str]) -> None:
        self.assign(line, match)
        name = match["name"].lower()
        if match["kind"].lower() in ("num", "dnum") and not match["value"]:
            self.values.names[name] = 0.0
        if match["storage"].upper() == "PERS":
            self.values.kept.add(name)

    def _conditional(self, line: int, match: re.Match[str]) -> None:
        """A statement behind ``IF`` without ``THEN``."""
        listing, words = self.listing, re.findall(r"\w+", match[0].lower())
        called = [listing.procedures[word] for word in words if word in listing.procedures]
        if any(listing.moving(each.body) for each in called):
            self.refuse(line, match)
        self.skip(line, match)

    # ------------------------------------------------------------ moves

    def _arguments(
        self, line: int, match: re.Match[str], targets: int, first: str = ""
    ) -> tuple[list[str], dict[str, str]]:
        """Targets, of which ``first`` may be one, speed, zone and tool of a move; their options."""
        arguments = [
            re.split(r"\\(?![^(]*\))", part) if "\\" in part else [part]
            for part in split(first + match["arguments"])
        ]
        if not arguments[0][0].strip():  # \Conc
            del arguments[0]
        if len(arguments) < targets + 2:
            raise refuse(line, match[0], "expected a target, a speed, a zone and a tool.")
        given = (option.partition(":=") for _, *options in arguments for option in options)
        options = {key.strip().lower(): value.strip() for key, _, value in given}
        self.moves.frame = self._frame(options.get("wobj", "wobj0"))
        tool = arguments[targets + 2][0] if len(arguments) > targets + 2 else TOOL
        if self._is_held(options.get("wobj", "wobj0")) is True or self._is_held(tool) is False:
            raise refuse(line, match[0], CARRIES)
        zone = self._zone(line, arguments[targets + 1][0].strip(), options.get("z"))
        if zone and (self.moves.strict or zone.mark.lower() != "z0"):
            self.moves.rounds(zone)
        return [first.strip() for first, *_ in arguments], options

    def _straight_rule(self) -> Sequence[Rule]:
        """Straight moves and circles to joint angles and poses, which ``check`` reads."""
        via, end = (
            rf"CalcRobT\s*\((?P<{at}>\[\[[^()]*\]\])\s*,\s*(?P<{of}>{_NAME})\s*"
            for at, of in (("via", "via_of"), ("target", "of"))
        )
        wobj = rf"(?:\\\s*WObj\s*:=\s*(?P<wobj>{_NAME})\s*)?"
        of = rf"Move(?:L\s+|C\s+{via}\)\s*,\s*){end}{wobj}\)(?P<arguments>\s*,.*)"
        to = r"Move(?P<kind>[LJC])\b(?P<arguments>.*)"
        rules: list[Rule] = [(of, self._move_straight, "joint"), (to, self._move_to_pose, "joint")]
        return rules if self.moves.strict else ()

    def _move_straight(self, line: int, match: re.Match[str]) -> None:
        """To the position of joint angles: a move to these angles, but straight or on a circle."""
        circle = None
        if match["via"]:
            angles, external = self._jointtarget(line, match["via"])
            circle = Circle(self._turns, angles)
            if match["via_of"].lower() != match["of"].lower() or {*external} != {float(_NONE)}:
                why = f"expected the tool {match['of']} for both points, and no external axes."
                raise refuse(line, match[0], why)
        self._move_joints(line, match, match["of"], match["wobj"] or "", circle)

    def _circle_mode(self, line: int, match: re.Match[str]) -> None:
        """How the tool turns on circles from here on."""
        self.moves.noted(line, match[1], "setting")
        self._turns = "path" if match["mode"].lower() == "pathframe" else "space"

    def _singular_area(self, line: int, match: re.Match[str]) -> None:
        """Whether straight moves keep the orientation near singularities from here on."""
        self.moves.noted(line, match[1], "passed")
        self._singular = "" if match["mode"].lower() == "off" else match["mode"]

    def _keeps_orientation(self, line: int, match: re.Match[str]) -> None:
        if self._singular:
            why = (
                f"behind SingArea \\{self._singular} a straight move may turn the tool otherwise "
                "than its points say where the wrist is nearly straight, which is not known here; "
                "write SingArea \\Off, or joint moves."
            )
            raise refuse(line, match[0], why)

    def _move_joints(
        self, line: int, match: re.Match[str], straight: str = "", wobj: str = "",
        circle: Circle | None = None,
    ) -> None:  # fmt: skip
        """MoveAbsJ; ``check`` knows all its arguments.

        ``straight``: the tool that moves so, in the work object ``wobj``, or on a circle.
        """
        stated = match.groupdict().get("target") or ""
        (target, *others), options = self._arguments(line, match, 1, stated)
        if not self.moves.strict:
            self.moves.joint(JointMove(line, None))
            return
        if len(others) != 3 or not all(re.fullmatch(rf"{_NAME}|\[[^()]*\]", x) for x in others):
            raise refuse(line, match[0], "expected a target, a speed, a zone and a tool.")
        if unknown := options.keys() - _OPTIONS:
            raise refuse(line, match[0], f"\\{unknown.pop()} is not read here.")
        if straight:
            self._keeps_orientation(line, match)
        of = others[2].lower(), options.get("wobj", "").lower()
        if straight and of != (straight.lower(), wobj.lower()):
            what = f"the work object {wobj}" if wobj else "no work object"
            raise refuse(line, match[0], f"expected the tool {straight} and {what}.")
        if others[2].lower() != TOOL and not straight:
            self.moves.noted(line, others[2], "setting")
        angles, external = self._jointtarget(line, target)
        given = zip(RAPID.external, external, strict=True)
        moved = {name: (value, "") for name, value in given if value != float(_NONE)}
        seconds = float(self.values.value(options["t"])) if "t" in options else None
        speed = self._tool_speed(others[0], options) if straight and seconds is None else None
        part = self._moved_by(wobj) if wobj else ""
        self.moves.uses(straight, wobj)
        if part is None:
            self.moves.note(
                f"straight moves are in {wobj}, which the program does not state: it has to be on "
                "the part, and to be moved as the part is"
            )
        self.moves.joint(JointMove(
            line, angles, None, seconds, None, moved, straight, None, speed, part, circle,
            tcp=self._tool(line, straight).pose if straight else None,
        ))  # fmt: skip

    def _move_to_pose(self, line: int, match: re.Match[str]) -> None:
        """MoveL, MoveC and MoveJ to a robtarget, for ``check``."""
        kind = match["kind"].upper()
        if kind != "J":
            self._keeps_orientation(line, match)
        arguments, options = self._arguments(line, match, count := 2 if kind == "C" else 1)
        if len(arguments) != count + 3 or options.keys() - (_OPTIONS - {"noeoffs", "tload"}):
            raise refuse(
                line, match[0], f"expected {count} targets, a speed, a zone and a tool, and no "
                "other arguments than \\ID, \\V, \\T, \\Z, \\Inpos and \\WObj.",
            )  # fmt: skip
        *vias, text, speed, _, name = arguments
        places = [self._pose(line, each) for each in vias]
        straight = kind != "J"
        target = self._target(line, match[0], text, name, options.get("wobj", "wobj0"))
        self.moves.uses(name, target.frame.name)
        seconds = float(self.values.value(options["t"])) if "t" in options else None
        circles = [Circle(self._turns, None, target._replace(pose=via)) for via in places]
        self.moves.joint(JointMove(
            line, None, None, seconds, tool=name if straight else "", target=target,
            tcp=target.tool.pose,
            circle=next(iter(circles), None),
            speed=self._tool_speed(speed, options) if straight and seconds is None else None,
        ))  # fmt: skip

    def _move(self, line: int, match: re.Match[str]) -> None:
        kind = match["kind"].upper()
        arguments, options = self._arguments(line, match, count := 2 if kind == "C" else 1)
        try:
            poses = [self._pose(line, text) for text in arguments[:count]]
        except Unknown:
            if kind not in ("J", "ABSJ"):
                raise
            poses = []
        self.moves.feed = self._feed(arguments[count], options)
        if kind in ("J", "ABSJ"):
            self.moves.joint(JointMove(line, None, poses[0] if poses else None))
        elif kind == "L":
            self.moves.line(line, poses[0])
        else:
            self.moves.arc(line, poses[0], poses[1], rule=self._turns)


def _heading(lines: Sequence[str]) -> int:
    """Number of lines of a controller's heading: its version and language between two %%%."""
    code = [k for k, line in enumerate(lines) if line.strip()]
    if not code or lines[code[0]].strip() != "%%%":
        return 0
    for k in code[1:]:
        if lines[k].strip() == "%%%":
            return k + 1
        if not re.fullmatch(r"\s*(VERSION|LANGUAGE)\s*:\s*\w+\s*", lines[k], re.ASCII):
            raise refuse(k + 1, lines[k], "expected VERSION:… or LANGUAGE:… between %%% and %%%.")
    raise InvalidInput("the heading that begins with %%% has no %%% at its end.")


def _execute(moves: Moves, lines: Sequence[str], stem: str, beside: Beside) -> list[str]:
    """Execute a module, which is one file; its comments."""
    found: Statements = []
    comments: list[str] = []
    rest, begun = "", 0
    for k in range(_heading(lines), len(lines)):
        code, comment = without_texts(k + 1, lines[k], '"', "!")
        if comment:
            comments.append(comment)
        begun = begun if rest.strip() else k + 1
        if code[:4].lower() not in ("move", "cons"):  # as in most lines
            code = _HEAD.sub(lambda m: f"\0;{m[0]};", code)
        *whole, rest = f"{rest} {code}".split(";")
        for part in filter(None, map(str.strip, whole)):
            if part[-1] == "\0" and part[:-1].strip():
                raise refuse(begun, part[:-1], "expected a semicolon at its end.")
            if part != "\0":
                found.append((begun, part))
            begun = k + 1
    if rest.strip():
        raise refuse(begun, rest, "expected a semicolon at its end.")
    RapidModule(moves).execute(found)
    return comments


RAPID = Dialect(
    "rapid", "RAPID", ".mod", "deg", 5, 5, tuple(f"rax_{k}" for k in range(1, AXES + 1)),
    False, 32 - len(_PREFIX), f"the module's; its procedure is {_PREFIX}NAME", _encode, _execute,
    external=EXTERNAL, period=0.004,
    to_fill_in=("GripLoad ...;",), frames_to_fill_in=("the tool of the moves, tool0",),
    zone=1e-3 * Z0, points=("joints", "poses"), parts=_PARTS, circles=("path",),
)  # fmt: skip
"""RAPID. Its period is that of the planned position: 250 Hz (ABB, *Robot Reference Interface*,
3HAC031973); that of the path planner before it is not public. The zone is z0's (zonedata)."""
