"""INFORM jobs of Yaskawa (JBI): the moves to Cartesian positions.

Source: public jobs and post processors (RoboDK's for Motoman: R = R_z(Rz) R_y(Ry) R_x(Rx), three
``MOVC`` for an arc, ``V`` in mm/s or cm/min by a setting of the controller, so that it is no speed
here).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import mink

from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import Beside, Zone
from qp_twist.programs.moves import JointMove, Kind, Moves
from qp_twist.programs.program import Program
from qp_twist.programs.statements import Statements, refuse
from qp_twist.programs.syntax import Language, Rule
from qp_twist.programs.values import Values, pose_of, zyx_quaternion

_POINT = re.compile(r"\s*([CP])0*(\d+)\s*=\s*(.*)", re.ASCII)
_TARGET = r"\s+(?P<kind>[CP])0*(?P<number>\d+)(?P<rest>\s.*|)"
_NOTED: Mapping[Kind, Sequence[str]] = {
    # outputs, clocks, messages, the weld; no position that is read depends on other variables
    "passed": (
        r"(DOUT|AOUT|ARATI?ON|ARATI?OF|PULSE|TIMER|WAIT|PAUSE|NWAIT|MSG|DIALOG|PRINT|CLEAR|ARCON"
        r"|ARCOF|ARCSET|ARCCTS|ARCCTE|AWELD|VWELD|SPEED|ADVINIT|ADVSTOP|CNVSET|SHCK(?:SET|RST)"
        r"|COMM)\b()(?:.*)",
        r"(INC|DEC|SET|ADD|SUB|MUL|DIV|AND|OR|XOR|NOT|DIN|GETS|GETE|SQRT|SIN|COS|ATAN)\s+"
        r"()L?[BIDRS]\[?\d.*",
    ),
}
_DECIDES = (
    r"(JUMP|CASE|FOR|NEXT|\w*WHILE\w*|IF\w*|ELSE\w*|ENDIF|SWITCH|ENDSWITCH|DEFAULT)\b.*"
    r"|(\w+)\s.*\b(?:IF|UNTIL)\b.*"
)
"""Words that decide which lines run, or how far."""


class Job(Program):
    """A job.

    Attributes:
        points: The frame and the numbers of each position by its kind and number; without
            numbers, it is in pulses or angles, or the job changes it.
    """

    language = Language(coordinates=r"\b[CP]\d|\bPX?\d")

    def __init__(self, moves: Moves) -> None:
        super().__init__(Values(str.lower, str, {}, lambda text: None), moves)
        self.points: dict[str, tuple[str, list[float]]] = {}
        self._arc: list[tuple[int, mink.SE3]] = []

    def grammar(self) -> Sequence[Rule]:
        """Moves, words that move nothing, calls."""
        return (
            (r"'.*|\*\S+|NOP", "", "silent"),
            (r"(MSG)\b.*", self.skip, "passed"),
            (_DECIDES, self._decides, "path"),
            (rf"(?P<word>MOV[JLC]){_TARGET}", self._move, "path"),
            (r"(?:GETS|GETPOS|CNVRT|SET|SETE|ADD|SUB|MULMAT|INVMAT)\s+(PX?0*\d+)\b.*", self._change,
             "path"),
            (r"END|RET|ABORT", "end", "leaves"),
            (r"CALL\s+(?:JOB:)?(\S+).*", self._call_job, "path"),
            (r"WVO(?:N|F)\b.*", self._weave, "passed"),
            *self.noting(_NOTED),
            (r".*", self.refuse, "path"),
        )  # fmt: skip

    def finish(self) -> None:
        """End an arc.

        Raises:
            InvalidInput: If it has other than three points.
        """
        if len(self._arc) not in (0, 3):
            raise InvalidInput(
                "an arc is three MOVC, its begin, a point of it and its end; here stand "
                f"{len(self._arc)}. Divide arcs that follow each other by MOVL",
                line=self._arc[0][0],
            )
        self._arc = []

    def _decides(self, line: int, match: re.Match[str]) -> None:
        raise refuse(
            line, match[0],
            f"{(match[1] or match[2]).upper()} decides here which lines run, or how far, which is "
            "not read; write a job without it.",
        )  # fmt: skip

    def _call_job(self, line: int, match: re.Match[str]) -> None:
        raise refuse(line, match[0], f"the job {match[1]} is not read; write one job of all.")

    def _weave(self, line: int, match: re.Match[str]) -> None:
        self.moves.note("weaving (WVON) is left out: the path is its middle")
        self.skip(line, match)

    def _change(self, line: int, match: re.Match[str]) -> None:
        """A position that the job changes is one that the file does not state."""
        kind, number = re.fullmatch(r"(PX?)0*(\d+)", match[1], re.IGNORECASE).groups()  # type: ignore[union-attr]
        self.points[f"{kind[0].upper()}{number}"] = "", []

    def _move(self, line: int, match: re.Match[str]) -> None:
        word = match["word"].upper()
        if word != "MOVC":
            self.finish()
        pose = self._pose(line, match)
        if word == "MOVJ":
            self.moves.joint(JointMove(line, None, pose))
        elif pose is None:
            raise refuse(
                line, match[0],
                "its position is in pulses or angles of the axes, or the job changes it; save the "
                "job with Cartesian positions (POSTYPE BASE or USER).",
            )  # fmt: skip
        elif word == "MOVL":
            self.moves.line(line, pose)
        else:
            self._arc.append((line, pose))
            if len(self._arc) == 1:
                self.moves.line(line, pose)
            elif len(self._arc) == 3:
                self.moves.arc(line, self._arc[1][1], pose)
            elif len(self._arc) > 3:
                self.finish()

    def _pose(self, line: int, match: re.Match[str]) -> mink.SE3 | None:
        """Where a move leads, and its frame; ``None`` if that is not in the file."""
        name = f"{match['kind'].upper()}{match['number']}"
        if re.search(r"\bB[CP]\d", match["rest"], re.IGNORECASE):
            raise refuse(line, match[0], "moves the base of the robot, which is not read.")
        if re.search(r"\bE[CX]\d|\+", match["rest"]):
            self.moves.noted(line, "other axes or robots", "passed")
        if zone := re.search(r"\bPL=\d+", match["rest"], re.IGNORECASE):
            self.moves.rounds(Zone(line, zone[0]))
        if name not in self.points:
            raise InvalidInput(f"there is no position {name} under //POS", line=line)
        frame, numbers = self.points[name]
        if not numbers:
            return None
        x, y, z, rx, ry, rz = numbers
        base = frame in ("BASE", "ROBOT")
        self.moves.frame = (
            ("the robot's base", mink.SE3.identity()) if base else (f"user frame {frame}", None)
        )
        if " V=" in match["rest"]:
            self.moves.note("V is mm/s or cm/min by a setting of the controller: no speed is taken")
        return pose_of((x, y, z), zyx_quaternion(rz, ry, rx))


def execute(moves: Moves, lines: Sequence[str], stem: str, beside: Beside) -> list[str]:
    """Execute a job."""
    job = Job(moves)
    found: Statements = []
    frame, user, inside = "", "", False
    for number, line in enumerate(lines, start=1):
        header = re.match(r"/+(\w+)\s*(.*)", line.strip())
        if header and header[1] == "INST":
            inside = True
        elif header and header[1] == "USER":
            user = header[2].strip()
        elif header and header[1] == "POSTYPE":
            frame = header[2].strip()
        elif point := _POINT.match(line.partition("//")[0]):
            words = [word for word in re.split(r"[,\s]+", point[3].strip()) if word]
            known = frame in ("BASE", "ROBOT", "USER")
            try:
                numbers = [float(word) for word in words] if known else []
            except ValueError:
                raise refuse(number, line, "expected x, y, z, Rx, Ry, Rz.") from None
            if known and len(numbers) != 6:
                raise refuse(number, line, f"expected six numbers, got {len(numbers)}.")
            where = user if frame == "USER" else frame
            job.points[point[1] + point[2]] = where, numbers
        elif inside and not header and line.strip():
            found.append((number, line.strip()))
    job.execute(found)
    job.finish()
    return []
