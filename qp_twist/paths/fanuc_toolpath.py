"""Toolpaths from TP programs of Fanuc as text (LS).

Source: Fanuc, *R-30iA/R-30iB Operator's manual*, motion instructions and positional data:
R = R_z(R) R_y(P) R_x(W).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import mink

from qp_twist.errors import InvalidInput
from qp_twist.paths.robot_path import RobotPath
from qp_twist.paths.robot_program import RobotProgram, Rule, robot_format
from qp_twist.paths.robot_values import Values, list_literal, pose_of, zyx_quaternion
from qp_twist.paths.toolpath_builder import ProgramWords, ToolpathFormat
from qp_twist.programs.fanuc_ls import NOTED, POINT
from qp_twist.programs.reading import NUMBER, Statements, refuse

_WORDS = ProgramWords("a TP program", "the tool's frame, W, P, R", "J", "mm", "quaternion")
_BEGINS = r"/PROG\b"
"""The line with which a program begins."""
_FEEDS = {"mm/sec": 1e-3, "cm/min": 1e-2 / 60.0, "inch/min": 0.0254 / 60.0}
"""m/s in units of speeds."""
_NUMBERED = r"(?P<{}>PR?)\[\s*(?P<{}_number>\w+)[^\]]*\]"


class TpProgram(RobotProgram):
    """A program.

    Attributes:
        points: Text of each point by its number.
    """

    coordinates = r"\bPR?\s*\["

    def __init__(self, path: RobotPath, points: dict[int, str]) -> None:
        super().__init__(Values(str.lower, str, {}, list_literal), path)
        self.points = points

    def grammar(self) -> Sequence[Rule]:
        """Moves, words that move nothing, calls."""
        end, via = _NUMBERED.format("p", "p"), _NUMBERED.format("q", "q")
        return (
            (rf"(?P<word>[JLCA])\s+{end}(?:\s+{via})?\s*(?P<speed>.*?)\s*"
             r"(?P<zone>FINE|CNT\s*\w+(?:\[.*?\])?|CR\s*\w+)?(?P<options>(?<=\d)\s.*|(?<=E)\s.*|)",
             self._move, "moves"),
            (r"(?:\w\s+PR?\[|OFFSET|TOOL_OFFSET|VOFFSET|UFRAME\s*\[|UTOOL\s*\[|SKIP|COL\s+GUARD|RSR"
             r"|S\s|TRACK|DEFENC|VISION).*", self.refuse, "moves"),
            (r"IF\b(?!.*\bJMP\b).*|(?:!|//|--|LBL\s*\[|WAIT|MESSAGE|UTOOL_NUM|UFRAME_NUM|OVERRIDE"
             r"|PAYLOAD|\$|PR?\s*\[|[RFM]\s*\[).*|", self.skip, "nothing"),
            *((pattern, self.skip, "nothing")
              for patterns in NOTED.values() for pattern in patterns),
            (r"(?:END|ABORT|PAUSE)", self.leave, "moves"),
            (r"(?:CALL|RUN)\s+(?P<called>\w+)\s*(?P<arguments>\(.*\))?", self.call, "unknown"),
            (r"(?:IF|JMP|SELECT|FOR|ENDFOR).*", self._flow, "moves"),
            (r"(?P<called>[A-Za-z][\w ]*)(?P<arguments>.*)", self.call, "unknown"),
            (r".*", self.refuse, "moves"),
        )  # fmt: skip

    def _flow(self, line: int, match: re.Match[str]) -> None:
        raise refuse(line, match[0], "decides by what is not in the file which lines run; write a "
                     "program without it.")  # fmt: skip

    def _move(self, line: int, match: re.Match[str]) -> None:
        word, path = match["word"].upper(), self.path
        if word == "A" or re.search(
            r"\b(?:INC|OFFSET|TOOL_OFFSET|VOFFSET|SKIP|EV|COORD\[)", match["options"], re.I
        ):
            self.refuse(line, match)
        if match["zone"]:
            self.passed.append((line, match["zone"]))
        speed = re.fullmatch(rf"({NUMBER})\s*(mm/sec|cm/min|inch/min)", match["speed"], re.I)
        path.feed = float(speed[1]) * _FEEDS[speed[2].lower()] if speed else math.nan
        pose = self._pose(line, match["p"], match["p_number"])
        if word == "J":
            path.joint(line, pose)
            return
        if pose is None:
            raise refuse(line, match[0], "where this is in space is not in the file (joint angles, "
                         "or a register); write a position, X Y Z W P R.")  # fmt: skip
        if word == "L":
            path.line(line, pose)
        elif not match["q"]:
            raise refuse(line, match[0], "expected two points, C P[1] P[2].")
        else:
            end = self._pose(line, match["q"], match["q_number"])
            if end is None:
                self.refuse(line, match)
            else:
                path.arc(line, pose, end)

    def _pose(self, line: int, kind: str, number: str) -> mink.SE3 | None:
        """A point, and its frame; ``None`` for joint angles and registers."""
        if kind.upper() == "PR":
            return None
        inside = self.points.get(int(number)) if number.isdecimal() else None
        if inside is None:
            raise InvalidInput(f"there is no P[{number}] under /POS", line=line)
        fields = dict(re.findall(rf"\b([XYZWPR])\s*=\s*({NUMBER})\s*(?:mm|deg)", inside))
        if len(fields) < 6:
            if re.search(r"\bJ1\s*=", inside):
                return None
            raise InvalidInput(f"P[{number}]: expected X, Y, Z in mm and W, P, R in deg", line=line)
        frame = re.search(r"\bUF\s*:\s*(\d+)", inside)
        if not frame:
            raise InvalidInput(f"P[{number}] does not state its frame, UF", line=line)
        self.path.frame = f"UFRAME {frame[1]}", None
        x, y, z, w, p, r = (float(fields[key]) for key in "XYZWPR")
        return pose_of((x, y, z), zyx_quaternion(r, p, w))


def _execute(file: Path, lines: Sequence[str], path: RobotPath) -> RobotProgram:
    """Execute a program; a line of its own without number and semicolon continues the one above."""
    del file
    at = {line.split()[0].upper(): k for k, line in enumerate(lines) if re.match(r"/\w", line)}
    if "/MN" not in at:
        raise InvalidInput("this is no TP program: expected /PROG, /MN, /POS and /END.")
    tail = "\n".join(lines[at.get("/POS", len(lines)) :])
    points = {int(match[1]): match[2].partition("GP2")[0] for match in POINT.finditer(tail)}
    found: Statements = []
    open_ = False
    for k in range(at["/MN"] + 1, at.get("/POS", at.get("/END", len(lines)))):
        text = re.sub(r"^\s*\d*\s*:", "", lines[k])
        for part in re.findall(r"[^;]+;?", text):
            code = part.rstrip("; \t").strip()
            if open_:
                found[-1] = found[-1][0], f"{found[-1][1]} {code}".strip()
            elif code:
                found.append((k + 1, code))
            open_ = bool(part.strip()) and not part.rstrip().endswith(";") and bool(found)
    while found and re.fullmatch(r"JMP\s+LBL.*", found[-1][1], re.I):
        path.assumed[f"{found[-1][1]} (line {found.pop()[0]}) repeats for ever: read once."] = None
    program = TpProgram(path, points)
    program.execute(found)
    return program


LS: ToolpathFormat = robot_format(_BEGINS, _WORDS, _execute)
"""TP programs."""
