"""Robot programs as toolpaths: their Cartesian moves."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import mink
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import of_lines
from qp_twist.paths.arcs import LARGEST_TURN, Arc
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.paths.toolpath import SAME_POINT, Toolpath
from qp_twist.paths.toolpath_builder import ProgramBuilder, ProgramWords, ToolpathFormat
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.programs import EXECUTE, JointMove, Moves, Turning, files_beside
from qp_twist.robots.tool_chain import Poses

REFUSED: dict[tuple[str, ...], str] = {
    (name,): f"a robot program states it itself; leave {name} out."
    for name in ("columns", "feed_unit", "angle_unit", "arc_axis", "rotary", "rollover")
}
"""Options that robot programs have no use for."""
_OVERRIDE = re.compile(r"VelSet|SpeedRefresh|\$OV_|OVERRIDE", re.IGNORECASE)
"""Words that scale the speeds of the moves behind them."""
_SLOWEST = 1e-9
"""A lower speed, m/s, is none."""


class SeveralFrames(InvalidInput):
    """A program moves in several frames, all of which it states."""


class RobotPath(Moves):
    """The path of a program's moves.

    Attributes:
        out: The points so far.
    """

    def __init__(self, options: ReadingOptions, words: ProgramWords, *, in_base: bool) -> None:
        super().__init__()
        self.out = ProgramBuilder(options, words)
        self.out.line = 1
        self.out.set_unit("m" if words.units == "m" else "mm", moved=False)
        self._assumed: dict[str, None] = {}
        self._passed: list[tuple[int, str]] = []
        self._in_base = in_base
        self._used: tuple[str, mink.SE3 | None] | None = None
        self._at: mink.SE3 | None = None
        self._waiting: list[tuple[int, str, mink.SE3]] = []
        self._elsewhere: list[int] = []
        self._arcs = self._moved = False
        self._external: dict[str, float] = {}

    def joint(self, move: JointMove) -> None:
        """A joint move: to a pose, or to where the program does not state the tool."""
        self._moved = True
        line, pose = move.line, move.pose
        self.external(line, move.external)
        if pose is None:
            self._waiting, self._at = [], None
            self._elsewhere.append(line)
            self.out.rows.begin_curve()
        else:
            name, pose = self._expressed(pose)
            self._waiting.append((line, name, pose))

    def line(self, line: int, pose: mink.SE3) -> None:
        """A straight move at the feed in force."""
        pose = self._begin(line, pose)
        self._add(line, [pose])

    def arc(
        self, line: int, via: mink.SE3, pose: mink.SE3, sweep_deg: float | None = None,
        rule: Turning = "space",
    ) -> None:  # fmt: skip
        """A move along the circle through a point, to its end or, with an angle, as far as that."""
        pose, via = self._begin(line, pose), self._expressed(via)[1]
        if self._at is None:
            raise InvalidInput("where the arc begins is not in the file")
        self._arcs = True
        begin, points = self._at, pose.translation()[None]
        shares = np.ones(1)
        arc = _arc(begin.translation(), via.translation(), points[0], sweep_deg)
        if arc is not None:
            points, shares = self.out.divide_arc(arc)
        first, last = (Poses(x.rotation().as_matrix(), x.translation()) for x in (begin, pose))
        turns = ToolMove.of(first, last, arc, rule).at(shares).rotations
        self._add(line, [
            mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(R), p)
            for R, p in zip(turns, points, strict=True)
        ])  # fmt: skip

    def external(self, line: int, axes: Mapping[str, tuple[float, str]]) -> None:
        """External axes of a target: whether they carry the frame, the program does not say."""
        for axis, (value, _) in axes.items():
            if self._external.setdefault(axis, value) != value:
                self.note(
                    f"the external axis {axis} moves; the path is that in the frame of the "
                    "coordinates, wherever it carries that or the robot"
                )

    def noted(self, line: int, word: str, kind: str) -> None:
        """A word that moves nothing."""
        self._passed.append((line, word))

    def note(self, text: str) -> None:
        """Add an assumption."""
        self._assumed[f"{text}."] = None

    def toolpath(self, path: Path) -> Toolpath:
        """The toolpath.

        Raises:
            InvalidInput: If the program has no straight moves and no arcs.
        """
        out = self.out
        if not out.rows:
            raise InvalidInput(
                "there are only joint moves in it, and how they lead the tool is not known without "
                "the robot; qp-twist check PROGRAM TASK checks them against a task."
                if self._moved
                else "there is no move in it."
            )
        for out.line, word in self._passed:
            out.pass_over(word)
        assert self._used is not None
        changed = {word for _, word in self._passed if _OVERRIDE.match(word)}
        notes = [f"coordinates are in {self._used[0] or 'the frame in force at its begin'}."]
        notes.append(f"orientations are those of {out.words.axis}; z is taken as the tool's axis.")
        if changed:
            notes.append(f"speeds are as programmed, without {', '.join(sorted(changed))}.")
        if self._elsewhere:
            notes.append(
                "joint moves to where the file does not state the tool "
                f"({of_lines(self._elsewhere)}): another curve begins after each."
            )
        if self._arcs:
            notes.append("on arcs the orientation turns in proportion, as the language has it.")
        return out.toolpath(path, [*notes, *self._assumed], has_axis=True)

    def _expressed(self, pose: mink.SE3) -> tuple[str, mink.SE3]:
        """A pose of the frame in force, and the frame in which it is expressed."""
        name, frame = self.frame
        return ("the robot's base", frame @ pose) if self._in_base and frame else (name, pose)

    def _begin(self, line: int, pose: mink.SE3) -> mink.SE3:
        """The end of a move in the frame of all; joint moves before it in that frame are added."""
        if self.feed < _SLOWEST:
            raise InvalidInput(f"a speed of {self.feed:g} m/s; expected one above 0")
        if math.isnan(self.feed):
            self.out.line = line
            self.out.note("no speed along the path is stated for moves, or it is not in the file")
        name, pose = self._expressed(pose)
        before, self._used = self._used, (name, self.frame[1])
        if before is not None and (before[0] != name or self._moved_frame(before[1])):
            known = before[1] is not None and self.frame[1] is not None and not self._in_base
            raise (SeveralFrames if known else InvalidInput)(
                f"it moves in {name or 'the frame of the controller'}, before in "
                f"{before[0] or 'that of the controller'}, and where both are, is not in the file; "
                "write each frame's paths into a file of their own"
            )
        for at, frame, waiting in self._waiting:
            if frame == name:
                self._add(at, [waiting], rapid=True)
            else:
                self.out.rows.begin_curve()
                self._at = None
        self._waiting = []
        return pose

    def _moved_frame(self, before: mink.SE3 | None) -> bool:
        """Whether the frame in force has the name of the one before, and is elsewhere."""
        now = self.frame[1]
        if self._in_base or before is None or now is None:
            return not self._in_base and (before is None) != (now is None)
        return before is not now and bool(
            (np.abs(before.wxyz_xyz - now.wxyz_xyz) > SAME_POINT).any()
        )

    def _add(self, line: int, poses: Sequence[mink.SE3], *, rapid: bool = False) -> None:
        self.out.line, self._at = line, poses[-1]
        self.out.feeds.set(60.0 * self.feed, per_turn=False)
        directions = [pose.rotation().wxyz.tolist() for pose in poses]
        self.out.add([pose.translation() for pose in poses], directions, rapid=rapid)


def _arc(a: Array, b: Array, c: Array, sweep_deg: float | None) -> Arc | None:
    """The arc from a through b to c, or by an angle; ``None`` if it is a straight line."""
    arc = Arc.through(a, b, c)
    if sweep_deg is None:
        return arc
    if arc is None:
        raise InvalidInput("the points of the arc are on a line, and not in its order")
    if not 0.0 < abs(sweep_deg) <= LARGEST_TURN:
        raise InvalidInput(f"an arc by {sweep_deg:g} degrees; expected up to {LARGEST_TURN:g}")
    # Below 0 it goes the other way round than through the second point.
    angle, axis = math.radians(abs(sweep_deg)), math.copysign(1.0, sweep_deg) * arc.axis
    end = arc.centre + Rotation.from_rotvec(angle * axis).apply(a - arc.centre)
    return Arc(a, end, arc.centre, axis, angle)


_BEGIN = 50
"""Number of lines in which one stands with which a program begins."""
_LANGUAGES: dict[str, tuple[str, ProgramWords]] = {
    "rapid": (
        r"%%%|(?:MODULE|RECORD)\s+\w+|(?:LOCAL\s+|TASK\s+)*(?:(?:CONST|PERS|VAR)\s+\w+\s+\w+"
        r"|PROC\s+\w+\s*\()",
        ProgramWords("a RAPID program", "the tool's frame, as robtargets state it", "MoveJ", "mm",
                     "quaternion"),
    ),
    "urscript": (
        r"(?:def|sec|thread)\s+\w+\s*\(.*\)\s*:|(?:move[ljpc]|set_tcp)\s*\(",
        ProgramWords("a URScript program", "the tool's frame (TCP)", "movej", "m", "quaternion"),
    ),
    "krl": (
        r"&ACCESS\b|&REL\b|DEFDAT\s+\w+|(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+\w+\s*\(",
        ProgramWords("a KRL program",
                     "the tool's frame, A, B, C (KUKA's own tools often work along its x)", "PTP",
                     "mm", "quaternion"),
    ),
    "ls": (
        r"/PROG\b",
        ProgramWords("a TP program", "the tool's frame, W, P, R", "J", "mm", "quaternion"),
    ),
    "jbi": (
        r"/JOB\b",
        ProgramWords("a job", "the tool's frame, Rx, Ry, Rz", "MOVJ", "mm", "quaternion"),
    ),
}  # fmt: skip
"""The lines with which programs begin, and what messages call their parts."""


def _format(name: str, begins: str, words: ProgramWords) -> ToolpathFormat:
    pattern = re.compile(rf"\s*(?:{begins})", re.IGNORECASE | re.ASCII)

    def read(file: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
        for in_base in (False, True):
            path = RobotPath(options, words, in_base=in_base)
            try:
                EXECUTE[name](path, lines, file.stem, files_beside(file))
                break
            except SeveralFrames:
                if in_base:
                    raise
        return path.toolpath(file)

    return ToolpathFormat(
        lambda suffix, lines: any(map(pattern.match, lines[:_BEGIN])), read, REFUSED
    )


ROBOTS: Mapping[str, ToolpathFormat] = {
    name: _format(name, begins, words) for name, (begins, words) in _LANGUAGES.items()
}
"""The formats of robot programs, by name."""
