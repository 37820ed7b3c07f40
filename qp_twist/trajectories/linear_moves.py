"""Straight moves of the tool through few of a trajectory's rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, TwistProjector, resolved_twist_error, rotation_vector
from qp_twist.paths import PathTask
from qp_twist.programs import JointMoves
from qp_twist.robots import ControllerJoints, ToolChain
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories.matching import times_at_waypoints
from qp_twist.trajectories.timed_path import TimedPath

_SHARE = 0.2
"""Share of the tolerances by which a straight move may leave the planned motion, which itself uses
up to half of them between waypoints."""
_PACE = 0.02
"""Largest difference between the shares of time and of way on a move: the tool has constant speed
on it, which would otherwise be another one than planned."""
_ASIDE = float(np.radians(1.0))
"""Largest difference of the joints from those planned, rad: the branch is the same, and limits and
the roll are nearly kept as planned."""
_ROUNDED = 0.25
"""Share of the position tolerance by which a controller may round a point that it passes: a little
more than that of a chord, so that the points of a smooth curve are passed without a stop."""


Fits = Callable[[int, int], bool]
"""Whether a move from one row to another one, by their indices, is possible."""


class StraightMoves(NamedTuple):
    """Rows between which the tool moves straight.

    Attributes:
        rows: Those that are kept.
        straight: Whether the move to each row but the first is straight, else a joint move.
        corners: Angle between the moves before and after each row, rad, (N,); 0 at the ends.
        lengths: Of the moves, m.
    """

    rows: TimedPath
    straight: Mask
    corners: Array
    lengths: Array

    def stops(self, zone: float | None, position_tolerance: float) -> Mask:
        """Points at which the robot has to stop, since rounding them would leave the path, (N,).

        A parabola that begins and ends ``zone`` from a corner of angle θ passes it at zone/2 sin
        θ/2; ``None``: half of the shorter move, the most that controllers take. Where a joint move
        begins or ends, the robot stops, too.
        """
        ways = np.concatenate([[0.0], self.lengths, [0.0]])
        reach = 0.5 * np.minimum(ways[:-1], ways[1:])
        if zone is not None:
            reach = np.minimum(reach, zone)
        off = 0.5 * reach * np.sin(0.5 * self.corners)
        changes = np.append(False, self.straight) != np.append(self.straight, False)
        stops: Mask = (off > _ROUNDED * position_tolerance) | changes
        stops[[0, -1]] = True
        return stops


def straight_moves(rows: TimedPath, path_task: PathTask, tool: ToolChain) -> StraightMoves:
    """As few of the rows as keep the path if the tool moves straight from one to the next.

    Greedily, each move leads to the farthest row such that the tool is within a fifth of the
    tolerances of where it was planned, in the directions of the task, and the joints remain beside
    those planned. Where no straight move does, and between the waypoints of
    the task's joint moves, a joint move leads to the next row.
    """
    assert rows.times is not None
    q = rows.of_joints(tool.names).q
    planned = tool.poses(q)
    joint = _on_joint_moves(rows, path_task)
    tolerances, projector = path_task.tolerances, _rows_of(path_task)

    def fits(begin: int, end: int) -> bool:
        R, p = planned.rotations[begin : end + 1], planned.positions[begin : end + 1]
        way, turn = p[-1] - p[0], rotation_vector(R[0].T @ R[-1])
        times = rows.times[begin : end + 1]  # type: ignore[index]
        paced = (times - times[0]) / (times[-1] - times[0])
        share, length = paced, float(np.linalg.norm(way))
        if length > tolerances.position:
            share = (p - p[0]) @ way / length**2
        if np.abs(share - paced).max() > _PACE:
            return False
        line = R[0] @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
        _, error = resolved_twist_error(line, p[0] + share[:, None] * way, R, p, projector)
        linear, angular = (np.linalg.norm(part, axis=1) for part in np.hsplit(error, 2))
        if not tolerances.met(linear / _SHARE, angular / _SHARE).all():
            return False
        found = tool.beside(q[begin : end + 1], Poses(line, p[0] + share[:, None] * way))
        return found is not None and bool(np.abs(found - q[begin : end + 1]).max() <= _ASIDE)

    def follows(begin: int, end: int) -> bool:
        try:
            tool.straight(q[begin], q[end])
        except InvalidInput:
            return False
        return True

    kept, straight = _farthest(len(q), fits, follows, joint)
    positions = planned.positions[kept]
    ways = np.diff(positions, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    units = ways / np.maximum(lengths, 1e-12)[:, None]
    between = np.arccos(np.clip((units[:-1] * units[1:]).sum(axis=1), -1.0, 1.0))
    assert rows.times is not None
    found = replace(
        rows, q=rows.q[kept], times=rows.times[kept], velocities=None, accelerations=None
    )
    return StraightMoves(found, straight, np.concatenate([[0.0], between, [0.0]]), lengths)


def _farthest(count: int, fits: Fits, follows: Fits, joint: Mask) -> tuple[Indices, Mask]:
    """The rows that are kept, and whether the moves between them are straight.

    ``fits`` is asked of many pairs of rows, ``follows`` of the farthest of them, which is nearer by
    half until it holds.
    """
    kept, straight = [0], list[bool]()
    while (begin := kept[-1]) < count - 1:
        ends = np.flatnonzero(joint[begin + 1 :])
        most = begin + int(ends[0]) if len(ends) else count - 1  # rows before the next joint move
        good, bad, step = begin, most + 1, 1
        while bad - good > 1:
            end = min(good + step, bad - 1)
            if fits(begin, end):
                good, step = end, 2 * step
            else:
                bad, step = end, max(1, (end - good) // 2)
        while good > begin and not follows(begin, good):
            good = begin + (good - begin) // 2
        straight.append(good > begin)
        kept.append(max(good, begin + 1))
    return np.array(kept), np.array(straight, dtype=bool)


def _on_joint_moves(rows: TimedPath, path_task: PathTask) -> Mask:
    """Rows that a joint move of the task leads to: those after a waypoint, up to the next, (N,)."""
    found = np.zeros(len(rows.q), dtype=bool)
    if path_task.joint_moves:
        at = times_at_waypoints(path_task, rows.motion, path_task.tolerances)
        times = rows.motion.times
        for k in path_task.joint_moves:
            found |= (times > at[k - 1] + 1e-9) & (times <= at[k] + 1e-9)
    return found


def _rows_of(path_task: PathTask) -> TwistProjector:
    """The directions in which the tool has to stay; all of them where they change on the way."""
    if not path_task.segments:
        return path_task.projector
    return TwistProjector(linear=Projector.full(), angular=Projector.full())


def followed(
    moves: JointMoves, q: Array, times: Array | None, joints: ControllerJoints
) -> tuple[Array, Array | None]:
    """The rows of a program (N, n), with those of its straight moves between, and their times.

    Raises:
        InvalidInput: If the tool of the robot is not known, or the joints do not follow a move;
            with its line.
    """
    if moves.straight is None:
        return q, times
    tool = joints.tool
    if tool is None:
        raise InvalidInput(
            "straight moves of the tool are read with a task of the robot alone, whose path is in "
            "the world: without external axes, and with the part at rest."
        )
    order = [joints.joint_names.index(name) for name in tool.names]
    rows, at = [q[:1]], [np.zeros(1) if times is None else times[:1]]
    for k, line in enumerate(moves.straight):
        if line:
            try:
                shares, between = tool.straight(q[k, order], q[k + 1, order])
            except InvalidInput as error:
                error.line = line
                raise
            more = np.empty_like(between[1:])
            more[:, order] = between[1:]
        else:
            shares, more = np.array([0.0, 1.0]), q[k + 1 : k + 2]
        rows.append(more)
        if times is not None:
            at.append(times[k] + shares[1:] * (times[k + 1] - times[k]))
    return np.concatenate(rows), None if times is None else np.concatenate(at)
