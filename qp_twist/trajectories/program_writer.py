"""Trajectories written as robot programs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.paths import PathTask
from qp_twist.programs import (
    AXES,
    Around,
    Dialect,
    ExternalColumn,
    JointMoves,
    header_lines,
    printed,
)
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories.around_moves import around_rows
from qp_twist.trajectories.check import Check
from qp_twist.trajectories.corners import Corners, task_rows
from qp_twist.trajectories.linear_moves import (
    LinearMotion,
    StraightMoves,
    rounded_shares,
    straight_moves,
)
from qp_twist.trajectories.program_findings import beyond_limits, kept_rounding
from qp_twist.trajectories.program_trajectory import axis_names, check_language
from qp_twist.trajectories.spaced_rows import spaced, until_whole
from qp_twist.trajectories.timed_path import TimedPath
from qp_twist.trajectories.within_limits import JointLimits, Way, within_limits


class _Kept(NamedTuple):
    """The points, straight moves between them, at or between which rows they are, and remarks."""

    rows: TimedPath
    line: StraightMoves | None
    at: Array
    remarks: Sequence[str]


class ProgramWriter:
    """Writes a trajectory as a program, and again, as far as its check asks for another one.

    Rows closer in time than the controller interpolates are :func:`spaced
    <qp_twist.trajectories.spaced_rows.spaced>`, with the tolerances of the task, if there is one.
    With ``linear`` the tool moves straight along the path; the moves are searched once.
    """

    def __init__(
        self,
        rows: TimedPath,
        dialect: Dialect,
        joints: ControllerJoints,
        name: str,
        path_task: PathTask | None = None,
        linear: LinearMotion | None = None,
    ) -> None:
        """``name``: of the program.

        Raises:
            InvalidInput: If the robot is not programmed in this language, or the name is none for
                the controller.
        """
        dialect.check_name(name)
        check_language(dialect, joints)
        self._rows, self._dialect, self._joints, self._name = rows, dialect, joints, name
        self._task, self._linear = path_task, linear
        self._around = {} if path_task is None else around_rows(rows, path_task)
        self._rounded: Array | None = None
        self._beside: tuple[str, ...] = ()
        self._joined = np.zeros(len(rows.q), dtype=bool)
        self._kept = self._points()

    def texts(self) -> dict[str, str]:
        """The texts of the program's files, by name.

        Raises:
            InvalidInput: If the trajectory has no times or leaves the robot's ranges, or the
                language has no such moves.
        """
        joints, dialect, kept = self._joints, self._dialect, self._kept
        task, remarks = str(self._rows.metadata.get("task", "")), list(kept.remarks)
        rows = kept.rows.of_joints(joints.joint_names)
        if outside := joints.outside(rows.q):
            raise InvalidInput(f"{outside}; the robot cannot go there.")
        if len(rows.q) < 2:
            raise InvalidInput("the trajectory has one row; a program needs two or more.")
        scale, names = joints.scale(dialect.unit), axis_names(dialect, joints)
        rates = None if rows.velocities is None else scale * joints.shown_rates(rows.velocities)
        durations = None if rows.times is None else np.diff(rows.times)
        columns = zip(names[AXES:], joints.external, strict=True)
        external = tuple(ExternalColumn(name, axis.unit) for name, axis in columns)
        planned = JointMoves(scale * joints.shown(rows.q), durations, rates, external=external)
        line = kept.line
        line = line and line._replace(shares=self._less(line.shares, line.halves))
        around = {int(np.searchsorted(kept.at, k)): each for k, each in self._around.items()}
        calls = [k for k, found in around.items() if any(each.call for each in found)]
        moves, longer = self._timed(planned, line, calls)
        if any(moves.circles) and line is not None and self._linear is not None:
            assert moves.shares is not None
            if ((moves.shares == 0.0) & (line.shares > 0.0)).any():  # it would stop beside one
                self._linear = self._linear._replace(circles=False)
                self._kept = self._points()
                return self.texts()
        if longer > 0.0:
            remarks.append(f"{longer:.3f} s longer, so that joints keep their limits")
        moves = _with_around(moves, around, calls)
        # In characters that every controller reads, and on one line.
        task = " ".join("".join(c if " " <= c <= "~" else "?" for c in task).split())[:60]
        equations, remark = joints.equations(names), "; ".join(remarks)
        lines = header_lines(dialect, moves, joints.robot, equations, task, remark, self._beside)
        return dialect.encode(self._name, moves, lines)

    def answers(self, rows: TimedPath, check: Check) -> bool:
        """Whether the next program will be another one for what a check finds of these rows.

        It states that the trajectory goes beside the path before it or after it, has joint moves
        where digits of straight ones make joints exceed their limits, or rounds its points less.
        """
        assert self._task is not None
        if not {*check.beside} <= {*self._beside}:
            self._beside = tuple(check.beside)
            return True
        if self.joins(beyond_limits(rows, check)):
            return True
        kept = kept_rounding(rows, self._task, check)
        before = self._rounded
        self._rounded = kept * (1.0 if before is None or len(before) != len(kept) else before)
        return bool((kept < 1.0).any())

    def joins(self, moves: Sequence[int]) -> bool:
        """Whether some moves of the last program, from 0, were not joint moves, but will be.

        Of those that were, the straight ones beside will be: a pose's digits tell the joints less
        exactly than theirs, so that a joint move that begins there begins elsewhere.
        """
        line, before = self._kept.line, self._joined.copy()
        at = np.floor(self._kept.at + 1e-6).astype(int)  # the rows that points are at, or behind
        if line is None:
            return False
        for k in moves:
            for each in (k,) if line.straight[k] else (max(k - 1, 0), min(k + 1, len(at) - 2)):
                self._joined[at[each] + 1 : at[each + 1] + 1] = True
        if (self._joined == before).all():
            return False
        self._kept = self._points()
        return True

    def _points(self) -> _Kept:
        """The rows that become points, none closer than a period; those held are among them."""
        rows, dialect, linear = self._rows, self._dialect, self._linear
        held = np.isin(np.arange(len(rows.q)), list(self._around))
        remarks, line, at = list[str](), None, np.arange(float(len(rows.q)))
        tick = 10.0**-dialect.time_decimals
        increasing = rows.times is not None and bool((np.diff(rows.times) > 0.0).all())
        if dialect.period and increasing and self._task is not None:
            rows = until_whole(rows, tick)
        if linear is not None:
            line = self._straight(rows, held, circles=linear.circles)
            at = np.interp(line.rows.motion.times, rows.motion.times, at)
            rows, held = line.rows, np.zeros(len(line.rows.q), dtype=bool)
            if line.instead:
                remarks.append(f"{line.instead} joint moves where the joints do not follow a "
                               "straight one, or not within their limits")  # fmt: skip
        if dialect.period and increasing:
            of = None if line is not None else self._task  # straight moves keep their points
            times = rows.motion.times
            rows, left_out, longer, points, moved = spaced(rows, dialect.period, tick, of, held)
            at = np.interp(points, times, at)
            if left_out or longer:
                remarks.append(f"{left_out} rows left out, {longer} moves longer: none is below "
                               f"the controller's {1e3 * dialect.period:g} ms")  # fmt: skip
            if moved:
                remarks.append(f"{moved} points between rows, so that times are whole {tick:g} s")
        return _Kept(rows, line, at, remarks)

    def _straight(self, rows: TimedPath, held: Mask, *, circles: bool) -> StraightMoves:
        """The rows between which the tool moves straight.

        Raises:
            InvalidInput: If the language has no such moves here, or the tool is not known.
        """
        dialect, tool = self._dialect, self._joints.tool
        if not dialect.points:
            raise InvalidInput(
                f"straight moves are not written in {dialect.title}; write joint moves (--motion "
                "joint)."
            )
        if self._task is None or tool is None or rows.times is None:
            raise InvalidInput("straight moves need a trajectory with times and its task.")
        return straight_moves(
            rows, self._task, tool, held, dialect=dialect, circles=circles, joined=self._joined,
        )  # fmt: skip

    def _timed(
        self, planned: JointMoves, line: StraightMoves | None, calls: Collection[int]
    ) -> tuple[JointMoves, float]:
        """The moves as written, and by how much they are longer, s, so that joints keep limits."""
        dialect, joints, linear, task = self._dialect, self._joints, self._linear, self._task

        def written(planned: JointMoves) -> JointMoves:
            moves = printed(planned, dialect)
            if line is None or linear is None:
                return moves
            return linear.moves(moves, planned, line, joints, dialect)

        if task is None or joints.tool is None or planned.durations is None:
            return written(planned), 0.0
        q = self._kept.rows.of_joints(joints.tool.names).q
        if line is None:
            corners = Corners.of(joints.tool, q, [None] * (len(q) - 1))
            within = task_rows(task), task.tolerances
            shares, halves = (
                rounded_shares(corners, *within, dialect.zone),
                np.pad(corners.halves, 1),
            )
            planned = replace(planned, shares=self._less(shares, halves))
            if dialect.cubic and planned.velocities is not None:
                return written(planned), 0.0
        ways = [Way.to(each) for each in q[1:]] if line is None else [x.way for x in line.moves]
        limits = JointLimits.of(task, joints.tool.names, ramps=dialect.constant > 0.0)
        return within_limits(planned, q[0], ways, limits, written, calls)

    def _less(self, shares: Array, halves: Array) -> Array:
        """As much rounding (N,) as a check left, in the digits that are printed.

        It is none where points are rounded from a zone on.
        """
        by = self._rounded
        if by is not None and len(by) == len(shares):
            shares = shares * (by == 1.0 if np.isfinite(self._dialect.zone) else by)
        return self._dialect.rounding(shares, halves)


def _with_around(
    moves: JointMoves, around: dict[int, tuple[Around, ...]], calls: Collection[int]
) -> JointMoves:
    """The moves with what stands around them; the robot stops where a procedure is called."""
    if not calls:
        return replace(moves, around=around)
    shares = np.where(moves.stops, 0.0, 1.0) if moves.shares is None else moves.shares.copy()
    shares[[*calls]] = 0.0
    return replace(moves, around=around, shares=shares)
