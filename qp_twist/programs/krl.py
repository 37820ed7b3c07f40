"""KRL, the KUKA Robot Language.

The start is reached by ``PTP`` at a tenth of the axes' speed. Then a spline in the axes
(``PTP_SPLINE``) passes all points; its ``TIME_BLOCK`` has the time of each segment and of all.
Straight moves are ``LIN`` to poses with S and T, at a speed of the tool (``$VEL.CP``, m/s); points
that are rounded have ``C_DIS``. Circles are ``CIRC``, for which ``$CIRC_TYPE`` says whether the
tool turns in proportion in space or as seen from the path; how it is turned at the point between,
does not count.

Source: public code, since KUKA's manual was not at hand. The words are those of the syntax file of
KnoP-01/krl-for-vim; the form ``PTP_SPLINE … TIME_BLOCK START … SPTP … TIME_BLOCK PART = …
TIME_BLOCK END = … ENDSPLINE`` is that of two generators of KRL programs on GitHub. One writes parts
in seconds, the other in percent of the whole, so parts are read as shares of ``END``. Angles A, B,
C are about z, y', x'' (KUKA, *KSS Operating and programming instructions*, Coordinate systems).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence

import mink

from qp_twist.errors import InvalidInput
from qp_twist.files import text_lines
from qp_twist.programs.header import read_header
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
from qp_twist.programs.krl_data import ASSIGNMENT, DECLARED, NAME
from qp_twist.programs.krl_frames import CIRCLES, KrlFrames
from qp_twist.programs.krl_spline import Spline
from qp_twist.programs.krl_values import POSE, Frame, frame_pose, krl_values, pose_text
from qp_twist.programs.moves import JointMove, Kind, Moves
from qp_twist.programs.statements import NUMBER, Statements, refuse, split, without_texts
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import Unknown

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


_BEHIND = "; {}", "{}( )"
_WITHIN_SPLINE = "; {}", "TRIGGER WHEN PATH=0 ONSTART DELAY=0 DO {}( ) PRIO=-1"
"""What stands behind a point: in a spline only a trigger calls."""


def _encode(name: str, moves: JointMoves, header: tuple[str, ...]) -> dict[str, str]:
    assert moves.durations is not None
    decimals = KRL.decimals

    def target(point: list[float]) -> str:
        names = (*KRL.axis_names, *(column.name for column in moves.external))
        pairs = zip(names, point, strict=True)
        return "{" + ",".join(f"{axis} {value:.{decimals}f}" for axis, value in pairs) + "}"

    first, *others = moves.angles.tolist()
    times = moves.durations.tolist()
    lines = [_TOP.format(name=name).rstrip("\n"), *(f"; {line}" for line in header)]
    lines += [_START.rstrip("\n"), *_stated(moves), f"PTP {target(first)}"]
    lines += moves.lines_behind(0, *_BEHIND)
    targets = moves.targets[1:] or (None,) * len(others)
    for straight, places in itertools.groupby(range(len(others)), lambda k: bool(targets[k])):
        if straight:
            lines += _lines(moves, list(places))
            continue
        block = list(places)
        lines += ["PTP_SPLINE", "TIME_BLOCK START"]
        for k in block:
            lines.append(f"SPTP {target(others[k])}")
            lines.append(f"TIME_BLOCK PART = {times[k]:.{KRL.time_decimals}f}")
            if k != block[-1]:
                lines += moves.lines_behind(k + 1, *_WITHIN_SPLINE)
        whole = sum(times[k] for k in block)
        lines += [f"TIME_BLOCK END = {whole:.{KRL.time_decimals}f}", "ENDSPLINE"]
        lines += moves.lines_behind(block[-1] + 1, *_BEHIND)
    return {f"{name}{KRL.suffix}": "\n".join([*lines, "END", ""])}


def _stated(moves: JointMoves) -> list[str]:
    """Tool, base and how the tool turns, in front of straight moves."""
    first = next(filter(None, moves.targets), None)
    if first is None:
        return []
    found = []
    for word, frame in (("TOOL", first.tool), ("BASE", first.frame)):
        value = f"{word}_DATA[{frame.name}]" if frame.pose is None else pose_text(frame.pose)
        if moves.part and word == "BASE":
            value = f"EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{value})"
        found.append(f"${word}={value}")
    return [*found, "$IPO_MODE=#BASE", "$ORI_TYPE=#VAR", f"$APO.CDIS={1e3 * KRL.zone:g}"]


def _lines(moves: JointMoves, places: Sequence[int]) -> list[str]:
    """Straight moves, with the speeds where they change."""
    found, before, rule = list[str](), {"CP": "", "ORI1": "", "ORI2": ""}, ""
    for k in places:
        target, speed = moves.targets[k + 1], moves.speeds[k]
        assert target is not None and speed is not None
        turn = f"{math.degrees(speed.angular):.4f}"
        now = {"CP": f"{speed.linear:.7f}", "ORI1": turn, "ORI2": turn}
        found += [f"$VEL.{key}={value}" for key, value in now.items() if before[key] != value]
        status, turns = target.configuration
        axes = zip(moves.external, moves.angles[k + 1, AXES:].tolist(), strict=True)
        more = "".join(f",{axis.name} {value:.{KRL.decimals}f}" for axis, value in axes)
        word, place = "LIN", pose_text(target.pose, f"S {status},T {turns}{more}")
        if (circle := moves.circles[k] if moves.circles else None) and circle.target:
            word, place = "CIRC", f"{pose_text(circle.target.pose)},{place}"
            if circle.rule != rule:
                rule = circle.rule
                found.append(f"$CIRC_TYPE={_TYPES_OF[rule]}")
        found.append(f"{word} {place}{'' if moves.stops[k + 1] else ' C_DIS'}")
        found += moves.lines_behind(k + 1, *_BEHIND)
        before = now
    return found


_TYPES_OF = {rule: word for word, rule in CIRCLES.items()}
_PULSE = r"PULSE\s*\(\s*\$OUT\s*\[\w+\]\s*,\s*\w+\s*,\s*[\d.]+\s*\)"
_TRIGGER = (
    r"(TRIGGER)\s+WHEN\s+(?:PATH|DISTANCE)\s*=\s*[-\d.]+(?:\s+ONSTART)?\s+DELAY\s*=\s*[-\d.]+\s+DO"
    rf"\s+(?:\$OUT\s*\[\w+\]\s*=\s*\w+|{_PULSE})"
)
_NOTED: Mapping[Kind, Sequence[str]] = {
    # outputs, flags, timers, names for them, and how far from a point rounding begins
    "passed": (
        r"(\$(?:OUT|ANOUT|FLAG|TIMER|TIMER_STOP)\s*\[[^\]]*\]|\$BWDSTART"
        r"|\$APO\.\w+|\$H_POS)\s*=(?!=)(.*)",
        rf"(?=(PULSE)){_PULSE}",
        r"(SET_CD_PARAMS)\s*\(\s*\d+\s*\)",
        rf"(EXT)\s+{NAME}\s*\([^()]*\)",
        rf"(SIGNAL)\s+{NAME}\s+\$\w+\[\d+\](?:\s+TO\s+\$\w+\[\d+\])?",
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
_STOPS = re.compile(
    r"(?!TRIGGER|SIGNAL|(?:GLOBAL\s+)?INTERRUPT)(?:(?:WAIT|HALT|PULSE|BAS\s*\(\s*#INITMOV)\b"
    r"|.*\$(?:(?:DIG)?(?:IN|OUT)\d*|AN(?:IN|OUT)|TIMER\w*|(?:POS|AXIS)_\w+)\b).*",
    re.IGNORECASE | re.ASCII | re.DOTALL,
)
"""At which the controller reads no farther until the robot rests at the point before (a stop of the
advance run): waits, and what reads or writes the outside. KUKA's list was not at hand; a stop too
many promises nothing, since its point is judged as rounded, too."""
_REST = r"(?P<rest>(?:\s*\bC_\w+|\s+#(?:BASE|TOOL)|\s+WITH\s.*)*)"
_MARKS = {"C_DIS", "C_VEL", "C_ORI", "C_PTP", "C_SPL"}
"""By which a point is rounded."""
_WITH = re.compile(
    r"\$(?:TOOL|BASE|LOAD|IPO_MODE|APO|(?:VEL|ACC)_AXIS\[\d\]|GEAR_JERK\[\d\]"
    r"|COLLMON_TOL_PRO\[\d\])\s*=\s*(?:(?:SVEL_JOINT|SACC_JOINT|SJERK|STOOL2|STOOL|SBASE|SLOAD"
    r"|SIPO_MODE|SAPO_PTP|SAPO|USE_CM_PRO_VALUES)\s*\(\s*[\w.]+\s*\)|[\w.]+)",
    re.IGNORECASE | re.ASCII,
)
"""What an SPTP may have after WITH, also as the maker's inline forms write it."""
_UNREAD_WITH = re.compile(
    r"\$(?:BASE|VEL)\s*=\s*\{|\$IPO_MODE|\$ORI_TYPE\s*=\s*(?!#VAR\b)"
    r"|\$CIRC_TYPE\s*=\s*(?!#(?:BASE|PATH)\b)",
    re.IGNORECASE,
)
"""What a move may not have after WITH."""


def _external(target: Frame) -> dict[str, tuple[float, str]]:
    """The external axes of a target."""
    return {key: (target[key.lower()], "") for key in KRL.external if key.lower() in target}


_UNSTATED = 1e3
"""A turn, rad/s, that takes no time."""


class KrlProgram(KrlFrames):
    """The programs of a file.

    Attributes:
        spline: The last one.
    """

    language = Language(
        opens=(
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
        ),
        otherwise=r"ELSE(?P<condition>(?!))?",
        coordinates=r"\{|#BASE",
        outside=r"&\w+.*",
        reads="axis moves (PTP, SPTP), straight ones (LIN) and circles (CIRC) to literals or "
        "constants, one after the other,",
    )  # fmt: skip

    def __init__(self, moves: Moves) -> None:
        self.spline = Spline(moves)
        super().__init__(krl_values(), moves)
        self._at: Frame | None = None
        self._before_spline = moves.frame, moves.feed, self.circle
        self._reads_ahead = True

    def grammar(self) -> Sequence[Rule]:
        """Moves, splines and their times, frames, speeds, data, what moves nothing, calls."""
        return (
            (r"S?PTP\s+(\$(?:POS|AXIS)_ACT(?:_MEAS)?)(?:\s+C_\w+)*", self._stay, "silent"),
            (rf"(?P<word>S?PTP)(?!_)\b\s*(?P<targets>.*?){_REST}", self._move, "joint"),
            *self._straight_rule(),
            (rf"(?P<word>S?(?:LIN|CIRC|PTP)(?:_REL)?)\b\s*(?P<targets>.*?){_REST}", self._move,
             "path"),
            (r"PTP_SPLINE(?:\s+WITH\s+(?P<with>.*))?", self._begin_spline, "joint"),
            (r"ENDSPLINE", self._end_spline, "joint"),
            (r"TIME_BLOCK\s+START", self.spline.begin_block, "joint"),
            (rf"TIME_BLOCK\s+PART\s*=\s*({NUMBER})", self.spline.part, "joint"),
            (rf"TIME_BLOCK\s+END\s*=\s*({NUMBER})", self.spline.end_block, "joint"),
            (r"SPLINE(?:\s+WITH\s+(?P<with>.*))?", self._begin_spline, "path"),
            (r"(?:GOTO|RESUME|SPL|RSI_(?:MOVECORR|ON)|TOUCH\w*)\b.*", self.refuse, "path"),
            (r"RETURN\b.*", "return", "leaves"), (r"EXIT", "break", "leaves"),
            (rf"(WAIT)\s+SEC\s+({NUMBER})", self.wait, "pause"),
            (_BEGIN, self._begin, "silent"),
            (r"(?P<word>\$APO(?:\.CDIS)?)\s*=(?!=)(?P<value>.*)", self._rounding, "setting"),
            (r"\$BASE\s*[.\[].*", self.refuse, "path"),
            (r"(\$(?:IPO_MODE|ORI_TYPE|CIRC_TYPE))\s*=(?!=)\s*(.*)", self._mode, "setting"),
            (r"(\$ADVANCE)\s*=(?!=)(.*)", self._advance, "passed"),
            (r"(?P<word>\$VEL)\s*=(?!=)(?P<value>.*)", self._speeds, "speed"),
            (r"(?P<word>BAS)\s*\(\s*#(?:VEL_CP|CP_PARAMS)\s*,(?P<value>.*)\)", self._speed,
             "speed"),
            (r"(?P<word>BAS)\s*\(\s*#CP_(?:DAT|PARAMS)\s*\)", self._inline_rounding, "speed"),
            (r"(?P<word>\$VEL\.CP)\s*=(?!=)(?P<value>.*)", self._speed, "speed"),
            (r"(?P<word>\$VEL\.ORI[12])\s*=(?!=)(?P<value>.*)", self._turning, "speed"),
            (r"(?P<word>BAS)\s*\(\s*#(?P<what>BASE|TOOL)\s*,(?P<value>.*)\)", self._set_frame,
             "setting"),
            (r"(?P<word>\$(?P<what>BASE|TOOL))\s*=(?!=)(?P<value>.*)", self._set_frame, "setting"),
            (r"(?P<word>(?P<what>BASE|TOOL)_DATA)\s*\[(?P<part>.*?)\](?P<field>.*?)=(?!=)"
             r"(?P<value>.*)", self._frame_data, "setting"),
            (r"(?P<word>FDAT_ACT)\s*=(?!=)(?P<value>.*)", self._inline_frame, "setting"),
            (r"(?P<word>LDAT_ACT)\s*=(?!=)(?P<value>.*)", self._inline_line, "speed"),
            *self.noting(_NOTED),
            *((pattern, self.assign, "assigns") for pattern in DECLARED),
            (ASSIGNMENT, self.assign, "assigns"),
            (r"\$\w+(?:\[[^\]]*\])?(?:\.\w+)?\s*=(?!=)[^{]*", self.skip, "skip"),
            (r"&.*", "", "silent"),
            (r"TRIGGER\s+WHEN\s+PATH\s*=\s*0\s+ONSTART\s+DELAY\s*=\s*0\s+DO\s+(?P<called>(?P<beside>\w+))\s*"
             r"\(\s*\)\s+PRIO\s*=\s*-?\d+", self.triggered, "call"),
            (r"(?:(?:GLOBAL\s+)?INTERRUPT|TRIGGER)\b.*\bDO\s+(?P<beside>\w+)\s*\(.*", self.beside,
             "skip"),
            (r"(?:ELSE|CASE|DEFAULT|CONTINUE|GLOBAL|INTERRUPT|DECL|STRUC|ENUM|BRAKE|EXT|ANOUT"
             r"|ON_ERROR_PROCEED|SIGNAL|PUBLIC|TRIGGER).*|\w+\s*:", self.skip, "skip"),
            (r"(?P<called>\w+)\s*(?:\((?P<arguments>.*)\))?", self.call, "call"),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    def triggered(self, line: int, match: re.Match[str]) -> None:
        """A call while the robot moves on: of a procedure of the process, or beside the program."""
        name = match["called"]
        if self.moves.called(line, name):
            return
        if self.moves.strict:
            why = f"calls {name}; if it is of the process, state it in [program] calls (--calls)."
            raise refuse(line, match[0], why)
        self.beside(line, match)

    def first(self, uncalled: list[str]) -> list[str]:
        """The first program of a file is the one that a controller runs."""
        found = super().first(uncalled)
        return [*self.listing.procedures][:1] if self.moves.strict else found

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

    def before(self, line: int, text: str) -> None:
        """A stop of the advance run."""
        if self.moves.strict and _STOPS.match(text):
            self.moves.wait(line, "", 0.0)

    def _advance(self, line: int, match: re.Match[str]) -> None:
        """How many moves the controller reads ahead; where it reads none, it rounds no point."""
        self._note("passed", line, match)
        self._reads_ahead = self.values.number(match[2]) >= 1.0

    # ------------------------------------------------------------ moves

    def _begin_spline(self, line: int, match: re.Match[str]) -> None:
        self._before_spline = self.moves.frame, self.moves.feed, self.circle
        self._with(line, match[0], match["with"] or "")
        self.spline.begin()

    def _end_spline(self, line: int, match: re.Match[str]) -> None:
        if self.spline.open:
            self.moves.frame, self.moves.feed, self.circle = self._before_spline
        self.spline.end(line, match)

    def _stay(self, line: int, match: re.Match[str]) -> None:
        if self.spline.open:
            raise refuse(line, match[0], f"{match[1]} is not read as a target in a spline.")
        self.moves.note(f"line {line} moves to where the robot is ({match[1].upper()})")

    def _with(self, line: int, statement: str, text: str) -> None:
        """What stands after WITH, for this move alone: inline forms set speed and tool anew."""
        strict, moves = self.moves.strict, self.moves
        if not strict and _UNREAD_WITH.search(text):
            raise refuse(
                line, statement,
                "states a frame, a speed or how the tool turns for this move in a way that is not "
                "read.",
            )  # fmt: skip
        for part in filter(None, split(text)):
            if strict and not _WITH.fullmatch(part):
                raise refuse(line, statement, f"{part}: not read after WITH.")
            speed = re.match(r"\$(VEL|ACC|GEAR)", part, re.IGNORECASE)
            moves.noted(line, part.partition("=")[0].strip(), "speed" if speed else "setting")
        if found := re.search(r"\$VEL(?:\.CP)?\s*=\s*(?:SVEL_CP\s*\()?([^,)]+)", text, re.I):
            moves.feed = self.values.number(found[1])
        if found := re.search(r"\$BASE\s*=\s*(?:SBASE\s*\(\s*)?([\w.]+)", text, re.IGNORECASE):
            moves.frame = self._numbered("base", found[1])
        if found := re.search(r"\$CIRC_TYPE\s*=\s*(#\w+)", text, re.IGNORECASE):
            self.circle = CIRCLES[found[1].upper()]

    def _move(self, line: int, match: re.Match[str]) -> None:
        word, rest, moves = match["word"].upper(), match["rest"], self.moves
        relative, before = word.endswith("_REL"), (moves.frame, moves.feed, self.circle)
        if self.spline.open and word == "PTP":
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
        if mark := " ".join(re.sub(r"#\w+", "", marks).split()):
            if moves.strict and self.spline.open:
                raise refuse(line, match[0], f"{mark} is not read in a spline.")
            if moves.strict and (left := {*mark.upper().split()} - _MARKS):
                raise refuse(line, match[0], f"{min(left)} is none of {', '.join(sorted(_MARKS))}.")
            known = {*mark.upper().split()} == {"C_DIS"} and "APO" not in given.upper()
            moves.rounds(Zone(line, mark, self.zone if known else math.inf))
        if "PTP" in word:
            self._joint(line, parts[0], relative=relative)
        elif moves.strict:
            if given.strip():
                raise refuse(line, match[0], f"what stands after WITH is not read of {word}.")
            self._straight(line, parts, float(sweep["number"]) if sweep else None)
        elif "LIN" in word:
            moves.line(line, self._target(line, parts[0], relative=relative))
        else:
            poses = [self._target(line, part, relative=relative) for part in parts]
            angle = float(sweep["number"]) if sweep else None
            moves.arc(line, poses[0], poses[1], angle, self.circle or "space")
            self._at = None if sweep else self._at
        if not (self._reads_ahead or self.spline.open):
            moves.rests()
        moves.frame, moves.feed, self.circle = before

    def _straight_rule(self) -> Sequence[Rule]:
        """Straight moves and circles, which ``check`` reads."""
        rule = (rf"(?P<word>S?LIN|CIRC)(?!_)\b\s*(?P<targets>.*?){_REST}", self._move, "joint")
        return (rule,) if self.moves.strict else ()  # type: ignore[return-value]

    def _straight(self, line: int, texts: Sequence[str], sweep_deg: float | None) -> None:
        """A straight move, or one on a circle, to the last of its targets."""
        for statement in self.unread.values():
            raise refuse(line, statement, "with it straight moves are not read.")
        feed, (one, two) = self.moves.feed, self.turns.values()
        if math.isnan(one) or math.isnan(two):
            self.moves.note(
                "how fast the tool turns on straight moves ($VEL.ORI1, $VEL.ORI2) is not stated: "
                "the time that this needs is left out"
            )
        turn = _UNSTATED if math.isnan(one) or math.isnan(two) else min(one, two)
        speed = None if math.isnan(feed) else Speed(feed, turn)
        *vias, to = (self._at_pose(line, text) for text in texts)
        circle = None
        if vias and self.circle is None:
            why = "expected $CIRC_TYPE=#BASE or #PATH before it: how the tool turns on circles."
            raise refuse(line, "CIRC", why)
        if vias and self.circle is not None:
            sweep = None if sweep_deg is None else math.radians(sweep_deg)
            circle = Circle(self.circle, None, vias[0], sweep)
        self.moves.joint(JointMove(
            line, tool=to.tool.name, target=to, speed=speed, circle=circle, tcp=to.tool.pose,
        ))  # fmt: skip

    def _at_pose(self, line: int, text: str) -> Target:
        """A target as ``check`` takes it, with S and T if it has them."""
        pose, found = self._target(line, text), self.values.value(text)
        data = tuple(found[key] for key in "st" if key in found)
        if others := set(found) - {*POSE, *"st", *(key.lower() for key in KRL.external)}:
            raise refuse(line, text, f"{min(others)} is no component of a position.")
        if len(data) == 1 or any(each != int(each) for each in data):
            raise refuse(line, text, "expected both S and T, whole numbers, or none.")
        name = self.moves.frame[0]
        frame = ProgramFrame(*self.moves.frame, "positioner" if name.startswith("EK(") else "")
        if not frame.name or not self.tool[0]:
            why = "expected $TOOL and $BASE before it, behind BAS(#INITMOV,…); a line is lost."
            raise refuse(line, text, why)
        self.moves.uses(self.tool[0], frame.name)
        return Target(pose, ProgramFrame(*self.tool), frame, tuple(map(int, data)), line)

    def _joint(self, line: int, text: str, *, relative: bool) -> None:
        angles = pose = target = None
        external: dict[str, tuple[float, str]] = {}
        try:
            found = None if relative else self.values.value(text)
            if isinstance(found, Frame) and "a1" in found:
                axes = [name.lower() for name in KRL.axis_names]
                external = _external(found)
                if not {*axes} <= {*found} or len(found) > len(axes) + len(external):
                    raise Unknown(f"expected the axes {', '.join(KRL.axis_names)}, got {text}")
                angles, self._at = [found[axis] for axis in axes], None
            elif not relative and self.moves.strict:
                target = self._at_pose(line, text)
            elif not relative:
                pose = self._target(line, text)
        except Unknown:
            if self.moves.strict:
                raise
            self._at = None
        if target is not None and self.spline.open:
            raise refuse(line, text, "a position in a spline of axis moves is not read.")
        if self.spline.segments is None or angles is None:
            self.moves.joint(JointMove(line, angles, pose, external=external, target=target))
        else:
            self.spline.segments.append(JointMove(line, angles, external=external))

    def _target(self, line: int, text: str, *, relative: bool = False) -> mink.SE3:
        """A target; what it leaves out stays as it was."""
        found = self.values.value(text)
        if not isinstance(found, Frame) or not set(POSE) & set(found):
            raise Unknown(f"expected a position, {{X …,Y …,Z …,A …,B …,C …}}, got {text}")
        if not set(POSE) <= set(found) and self._at is None:
            raise Unknown(f"{text} leaves out some of X, Y, Z, A, B, C; nothing before has them")
        if not relative:
            self.moves.external(line, _external(found))
        at = self._at or Frame()
        if relative and any(found.get(key) for key in "abc"):
            raise InvalidInput(f"{text}: a relative turn is not read; write a position")
        moved = {key: found.get(key, at.get(key)) for key in POSE}
        if relative:
            moved = {key: at[key] + found.get(key, 0.0) for key in POSE}
        self._at = Frame(moved)
        return frame_pose(self._at)


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
    if program.spline.shares and (header := read_header(comments)):
        raise InvalidInput(
            f"the parts of the time block are not {header['seconds']} s together, as the header "
            "says; a time was changed. Export it again, or remove the header."
        )
    return comments


KRL = Dialect(
    "krl", "KRL", ".src", "deg", 5, 5, tuple(f"A{k}" for k in range(1, AXES + 1)),
    False, 24, "the name after DEF", _encode, _execute,
    external=tuple(f"E{k}" for k in range(1, 7)), period=0.012,
    to_fill_in=("$LOAD=LOAD_DATA[...]",),
    frames_to_fill_in=("$TOOL=TOOL_DATA[...]", "$BASE=BASE_DATA[...]"),
    zone=0.3e-3, points=("poses",), two_angles=True, circles=("path", "space"),
    parts={"positioner poses": "BASE_DATA[{frame}] has to be the part's frame in the flange of the "
                               "positioner, and MACHINE_DEF[2] that."},
)  # fmt: skip
"""KRL; the length of a name as usually stated, not looked up in KUKA's manual. Its period is that
of the controller's interpolation: 12 ms (the heartbeat of KUKA's RRS server, Dassault Systèmes,
*3DEXPERIENCE User Assistance*, RRS)."""
