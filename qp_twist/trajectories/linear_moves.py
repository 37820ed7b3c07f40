"""Straight moves of the tool through few of a trajectory's rows."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import mink
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.geometry import (
    Projector,
    TwistProjector,
    geodesic,
    resolved_twist_error,
    rotation_vector,
)
from qp_twist.paths import PathTask
from qp_twist.programs import Dialect, JointMoves, ProgramFrame, Speed, Target
from qp_twist.robots import ControllerArm, ControllerJoints, ToolChain
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
"""Largest difference of the joints from those planned, rad (17 mm of slides): the branch is the
same, and limits and the roll are nearly kept as planned."""
_ROUNDED = 0.25
"""Share of the tolerances by which a controller may round a point that it passes: a little more
than that of a chord, so that the points of a smooth curve are passed without a stop."""

_ROUNDED_UP = 1e-3
"""Share by which a printed speed may be above the planned one: the chord of an arc that turns by θ
is shorter by θ²/24, which is 1e-3 at 9°."""
_PROCESS = 3
"""Fewest moves at one speed between two ramps: with fewer there is nothing to hold."""
_SHORTEST = 1e-4
"""Length up to which a move has a time instead of a speed, m: that of points, so that the tool may
turn there alone."""
_FREE = Speed(1.0, float(np.radians(200.0)))
"""Speeds that do not count, as the move is slower by the other one: below those of all controllers.
"""
_RESTS = 1e-6
"""A point that goes less far, m, rests: the tool turns about it, or rests if it turns less, rad."""
_DECIMALS = 7
"""Of positions in m, as programs print them."""
_DIGITS = 4
"""Significant digits of speeds, rounded down: moves take at most a thousandth longer."""

Fits = Callable[[int, int], bool]
"""Whether a move from one row to another one, by their indices, is possible."""


class StraightMoves(NamedTuple):
    """Rows between which the tool moves straight.

    Attributes:
        rows: Those that are kept.
        straight: Whether the move to each row but the first is straight, else a joint move.
        halves: Half of the shorter move beside each row, m, the most that controllers round; 0
            where a joint move begins or ends, (N,).
        shares: Of ``halves`` what may be rounded, so that the tool is within a quarter of the
            tolerances; 0: the robot stops there, (N,).
    """

    rows: TimedPath
    straight: Mask
    halves: Array
    shares: Array

    def stops(self, zone: float) -> Mask:
        """Points at which the robot has to stop if it rounds them from ``zone`` m on, (N,)."""
        most = np.minimum(self.halves, zone)
        stops: Mask = (self.shares * self.halves < most) | (self.shares == 0.0)
        return stops


class LinearMotion(NamedTuple):
    """How straight moves of the tool are written.

    Attributes:
        tool: Number of the tool in the controller, whose TCP is the task's frame; ``None``: of
            points that are joint angles 1, of poses its values are written.
        frame: Number of the frame of poses in the controller, which is the world of the task, or
            the part's; ``None``: its values in the robot's base are written. On a part that moves
            also of points that are joint angles: of a frame on the part, or of a tool that stands
            still in LS; ``None``: 1.
        points: Joint angles or poses; ``None``: as the language prefers.
    """

    tool: int | None = None
    frame: int | None = None
    points: Literal["joints", "poses"] | None = None

    def moves(
        self, moves: JointMoves, planned: JointMoves, line: StraightMoves,
        joints: ControllerJoints, dialect: Dialect,
    ) -> JointMoves:  # fmt: skip
        """The moves, in printed digits, with those that are straight; ``planned``: in all digits.

        Raises:
            InvalidInput: If the language does not have such points, or the robot no such data.
        """
        points = self.points or (dialect.points or ("joints",))[0]
        if points not in dialect.points:
            raise InvalidInput(
                f"straight moves to {points} are not written in {dialect.title}; "
                + (f"write {dialect.points[0]}." if dialect.points else
                   "write joint moves (--motion joint).")
            )  # fmt: skip
        if self.tool is not None and not dialect.numbered:
            raise InvalidInput(
                f"{dialect.title} has no tools by number; leave it out (--tool-number)."
            )
        assert joints.tool is not None
        part = joints.tool.part
        if part and f"{part} {points}" not in dialect.parts:
            where = "on a positioner" if part == "positioner" else "in the robot's hand"
            others = [each.split()[1] for each in dialect.parts if each.startswith(part)]
            raise InvalidInput(
                f"straight moves to {points} on a part {where} are not written in {dialect.title}; "
                f"write {' or '.join(others) or 'joint moves (--motion joint)'}."
            )
        moves = replace(
            moves, straight=tuple(int(each) for each in line.straight), tool=self.tool or 1,
            stops=line.stops(dialect.zone), halves=line.halves, shares=line.shares,
            tcp=None if joints.arm is None else joints.arm.tool_in_flange,
            part=part, frame=self.frame or 1,
        )  # fmt: skip
        if points == "poses":
            moves = self._with_poses(moves, line, joints, dialect)
        elif self.frame is not None and not part:
            raise InvalidInput("a frame's number is of points that are poses (--points poses).")
        return _with_speeds(moves, planned, line, joints, dialect) if dialect.speeds else moves

    def _with_poses(
        self, moves: JointMoves, line: StraightMoves, joints: ControllerJoints, dialect: Dialect
    ) -> JointMoves:
        arm, chain = joints.arm, joints.tool
        if arm is None or chain is None or moves.durations is None:
            raise InvalidInput(
                "poses need base, flange and configuration data of a known robot (--robot); as "
                "modelled there are only joint angles."
            )
        if self.frame is None and joints.external:
            raise InvalidInput(
                "where the controller has the world of a robot on a rail, or of a part on a "
                "positioner, is not known here; state the number of the frame of the points "
                "(--frame-number)."
            )
        tool = ProgramFrame("", arm.tool_in_flange)
        frame = ProgramFrame("", arm.base.inverse())
        tool = tool if self.tool is None else ProgramFrame(str(self.tool))
        frame = frame if self.frame is None else ProgramFrame(str(self.frame))
        q = line.rows.of_joints(chain.names).q
        R, p = chain.poses(q)
        R_shown, p_shown = chain.poses(_printed(moves, joints, chain, dialect))
        p = np.round(p, _DECIMALS)
        durations, kept = moves.durations.copy(), [0] * len(line.straight)
        targets: list[Target | None] = [None]
        speeds: list[Speed | None] = []
        for k, straight in enumerate(line.straight, start=1):
            begins = (R, p) if targets[-1] else (R_shown, p_shown)  # as printed
            way, turn = _way(begins[0][k - 1], begins[1][k - 1], R[k], p[k])
            target = speed = None
            if straight and (way > _RESTS or turn > _RESTS):
                pose = mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(R[k]), p[k])
                target = Target(pose, tool, frame, arm.configuration(q[k, chain.own]))
                kept[k - 1] = 1
                if not dialect.speeds:
                    speed = _slower(durations[k - 1], way, turn)
                    durations[k - 1] = speed.seconds(way, turn)
            targets.append(target)
            speeds.append(speed)
        changes = np.append(0, kept) != np.append(kept, 0)
        return replace(
            moves, durations=durations, straight=tuple(kept), stops=moves.stops | changes,
            shares=np.where(changes, 0.0, line.shares), targets=tuple(targets),
            speeds=tuple(speeds),
        )  # fmt: skip


def _with_speeds(
    moves: JointMoves,
    planned: JointMoves,
    line: StraightMoves,
    joints: ControllerJoints,
    dialect: Dialect,
) -> JointMoves:
    """Moves with the speeds, and so the times, that the dialect prints.

    Moves of ``_SHORTEST`` or less, and those for which no unit is fine enough, keep their times. No
    speed makes a joint faster than its fastest anywhere in ``planned``.
    """
    chain, durations = joints.tool, planned.durations
    assert chain is not None and durations is not None and moves.durations is not None
    # Between close points, a printed digit counts.
    places = chain.poses(_printed(moves, joints, chain, dialect)).positions
    for k, target in enumerate(moves.targets):
        places[k] = places[k] if target is None else target.pose.translation()
    steps = np.diff(places, axis=0)
    ways = np.linalg.norm(steps, axis=1)
    fastest = (np.abs(np.diff(planned.angles, axis=0)) / durations[:, None]).max(axis=0)
    travel = np.abs(np.diff(moves.angles, axis=0))
    needed = np.divide(travel, fastest, out=np.zeros_like(travel), where=fastest > 0.0)
    least = np.maximum(needed.max(axis=1), durations / (1.0 + _ROUNDED_UP))
    speeds = np.full(len(ways), np.nan)
    for unit in dialect.speeds:
        found = unit * np.minimum(np.round(ways / durations / unit), np.floor(ways / least / unit))
        fits = found >= (1.0 - _PACE) * ways / durations
        speeds = np.where(np.isnan(speeds) & fits, found, speeds)
    speeds[~line.straight | (ways <= _SHORTEST)] = np.nan
    constant = np.zeros(len(ways), dtype=bool)
    if dialect.constant:
        # On the arc from d before a corner of angle θ to d behind it: v² tan(θ/2) / d.
        units, reach = steps / np.maximum(ways, _RESTS)[:, None], line.shares * line.halves
        apart, both = (
            np.linalg.norm(x, axis=1) for x in (np.diff(units, axis=0), units[1:] + units[:-1])
        )
        fast = ways / np.maximum(needed.max(axis=1), 1e-12)
        turns = np.sqrt(dialect.constant * both * reach[1:-1] / np.maximum(apart, 1e-12))
        for begin, end in itertools.pairwise(np.flatnonzero(reach == 0.0).tolist()):
            part = slice(begin, end)
            most = min(fast[part].min(), turns[begin : end - 1].min(initial=np.inf))
            if speed := _constant(speeds[part], most):
                speeds[part], constant[part] = speed, True
    return replace(
        moves,
        durations=np.where(np.isnan(speeds), moves.durations, ways / speeds),
        speeds=tuple(None if np.isnan(speed) else Speed(speed) for speed in speeds.tolist()),
        constant=tuple(constant.tolist()),
    )


def _printed(
    moves: JointMoves, joints: ControllerJoints, chain: ToolChain, dialect: Dialect
) -> Array:
    """Positions of the chain's joints at the points as they are printed, (N, n)."""
    order = [joints.joint_names.index(name) for name in chain.names]
    return joints.positions(moves.angles / joints.scale(dialect.unit))[:, order]


def _constant(speeds: Array, most: float) -> float:
    """The one speed of moves from stop to stop, m/s; 0 if it is above ``most``, or not one.

    All but those of the ramps at both ends have it within 2 %.
    """
    if len(speeds) < _PROCESS or np.isnan(speeds).any():
        return 0.0
    full = np.flatnonzero(speeds >= (1.0 - _PACE) * speeds.max())
    speed = float(speeds[full].min())
    is_one = len(full) == full[-1] - full[0] + 1 >= _PROCESS and speed <= most
    return speed if is_one else 0.0


def _way(
    R: Array, p: Array, R_end: Array, p_end: Array, point: mink.SE3 | None = None
) -> tuple[float, float]:
    """How far a point of a tool goes, m, which turns, rad, from a pose (3, 3), (3,) to another."""
    turn, step = rotation_vector(R.T @ R_end), p_end - p
    if point is not None:
        step = step + (R_end - R) @ point.translation()
    return float(np.linalg.norm(step)), float(np.linalg.norm(turn))


def _slower(seconds: float, way: float, turn: float) -> Speed:
    """The speeds of a move that takes some time, or a little more."""
    if way < _RESTS:
        return Speed(_FREE.linear, _rounded_down(turn / seconds))
    return Speed(_rounded_down(way / seconds), max(_FREE.angular, turn / seconds))


def _rounded_down(value: float) -> float:
    unit = 10.0 ** (np.floor(np.log10(max(value, 1e-9))) + 1.0 - _DIGITS)
    return float(np.floor(value / unit) * unit)


def straight_moves(
    rows: TimedPath, path_task: PathTask, tool: ToolChain, held: Mask | None = None, *,
    two_angles: bool = False,
) -> StraightMoves:  # fmt: skip
    """As few of the rows as keep the path if the tool moves straight from one to the next.

    Greedily, each move leads to the farthest row such that the tool is within a fifth of the
    tolerances of where it was planned, in the directions of the task, and the joints remain beside
    those planned. Where no straight move does, and between the waypoints of
    the task's joint moves, a joint move leads to the next row. With ``two_angles`` it has to be so,
    too, if a controller swings an axis of the tool, whichever it is, and turns about it at once.
    Rows that are ``held`` (N,) are points.
    """
    assert rows.times is not None
    q = rows.of_joints(tool.names).q
    planned = tool.poses(q)
    joint = _on_joint_moves(rows, path_task)
    tolerances, projector = path_task.tolerances, _rows_of(path_task)

    def fits(begin: int, end: int) -> bool:
        if held is not None and held[begin + 1 : end].any():
            return False
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
        ways = [line, *(_two_angles(R[[0, -1]], share, axis) for axis in np.eye(3) if two_angles)]
        for turned in ways:
            _, error = resolved_twist_error(turned, p[0] + share[:, None] * way, R, p, projector)
            linear, angular = (np.linalg.norm(part, axis=1) for part in np.hsplit(error, 2))
            if not tolerances.met(linear / _SHARE, angular / _SHARE).all():
                return False
        near, on = q[begin : end + 1].copy(), list(tool.external)
        near[:, on] = q[begin, on] + share[:, None] * (q[end, on] - q[begin, on])
        found = tool.beside(near, Poses(line, p[0] + share[:, None] * way))
        return found is not None and bool(np.abs(found - q[begin : end + 1]).max() <= _ASIDE)

    def follows(begin: int, end: int) -> bool:
        try:
            tool.straight(q[begin], q[end])
        except InvalidInput:
            return False
        return True

    kept, straight = _farthest(len(q), fits, follows, joint)
    assert rows.times is not None
    found = replace(
        rows, q=rows.q[kept], times=rows.times[kept], velocities=None, accelerations=None
    )
    corners = Poses(planned.rotations[kept], planned.positions[kept])
    passed = np.concatenate([[False], straight[:-1] & straight[1:], [False]])
    lengths = np.linalg.norm(np.diff(corners.positions, axis=0), axis=1)
    halves, shares = np.zeros((2, len(kept)))
    halves[1:-1] = 0.5 * np.minimum(lengths[:-1], lengths[1:])
    linear, angular = _cut(corners, projector, tolerances.position)
    most = np.maximum(linear / tolerances.position, angular / tolerances.axis)
    shares[1:-1] = _ROUNDED / np.maximum(most, _ROUNDED)
    return StraightMoves(found, straight, halves * passed, shares * passed)


def _cut(corners: Poses, projector: TwistProjector, shortest: float) -> tuple[Array, Array]:
    """How far the tool passes each inner point if half of the shorter move is rounded, m and rad.

    An arc that begins and ends at the distance d from a corner of angle θ passes it at d tan θ/4; a
    parabola, at d/2 sin θ/2, is nearer. With unit vectors u before and after it that is
    d |u₂ − u₁| / (2 + |u₁ + u₂|), along u₂ − u₁. Where the turn per way changes from w₁ to w₂, the
    orientation is off by d/4 (w₂ − w₁). Moves shorter than ``shortest`` count as turns alone.
    """
    R, p = corners
    ways, turns = np.diff(p, axis=0), rotation_vector(R[:-1].transpose(0, 2, 1) @ R[1:])
    lengths = np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), shortest)
    units, rates = ways / lengths, turns / lengths
    reach = 0.5 * np.minimum(lengths[:-1], lengths[1:])
    both = np.linalg.norm(units[:-1] + units[1:], axis=1, keepdims=True)
    at = p[1:-1] + reach * np.diff(units, axis=0) / (2.0 + both)
    turned = R[1:-1] @ Rotation.from_rotvec(0.25 * reach * np.diff(rates, axis=0)).as_matrix()
    _, error = resolved_twist_error(turned, at, R[1:-1], p[1:-1], projector)
    linear, angular = (np.linalg.norm(part, axis=1) for part in np.hsplit(error, 2))
    return linear, angular


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


def _two_angles(R: Array, share: Array, axis: Array) -> Array:
    """Rotations (K, 3, 3) at shares (K,) from R[0] to R[1].

    An axis of the tool (3,) swings, and the tool turns about it, each in proportion.
    """
    swing = geodesic(R[0] @ axis, R[1] @ axis)
    twist = rotation_vector(R[0].T @ Rotation.from_rotvec(-swing).as_matrix() @ R[1])
    before = Rotation.from_rotvec(share[:, None] * swing).as_matrix()
    after = Rotation.from_rotvec(share[:, None] * twist).as_matrix()
    turned: Array = before @ R[0] @ after
    return turned


class Followed(NamedTuple):
    """A program's motion in joint positions.

    Attributes:
        q: The rows (K, n), with those of its straight moves between.
        times: Of the rows, s, (K,); ``None`` if the program has none.
        durations: Of its moves, s, (N − 1,), likewise.
    """

    q: Array
    times: Array | None
    durations: Array | None


_ON = {
    "": "in a frame that stands still", "positioner": "on a part that a positioner moves",
    "hand": "on a part that the robot holds",
}  # fmt: skip
_MOVED = {"": "stands still", "positioner": "is on a positioner", "hand": "is in its hand"}


def followed(moves: JointMoves, q: Array, joints: ControllerJoints) -> Followed:
    """The motion of a program with joint positions q (N, n) at its points, nan where it has a pose.

    Straight moves are followed from where they begin; one to a pose has to arrive with the
    configuration that the program states. A joint move to a pose leads to the joint positions that
    the configuration names.

    Raises:
        InvalidInput: If the tool or the robot is not known, or the joints do not follow a move;
            with its line.
    """
    if moves.straight is None and not moves.targets:
        given = moves.durations
        times = None if given is None else np.concatenate([[0.0], np.cumsum(given)])
        return Followed(q, times, given)
    lines = moves.straight or (0,) * (len(q) - 1)
    targets = moves.targets or (None,) * len(q)
    tool = joints.tool
    if tool is None and (any(lines) or any(targets)):
        raise InvalidInput("straight moves of the tool are read with the task of the robot.")
    for part, number in moves.parts.items():
        if tool is not None and part not in (None, tool.part):
            raise InvalidInput(
                f"the tool moves straight {_ON[part]}; the part of the task {_MOVED[tool.part]}.",
                line=number,
            )
    order = [] if tool is None else [joints.joint_names.index(name) for name in tool.names]
    durations = None if moves.durations is None else moves.durations.copy()
    at, q = q[:1], q.copy()
    rows, shares = list[Array](), list[Array]()
    for k, target in enumerate(targets):
        line = lines[k - 1] if k else 0
        share, more = np.ones(1), q[k : k + 1]
        try:
            if tool is None:
                pass
            elif line:
                share, more = _line(tool, joints.arm, at[0, order], q[k, order], target)
            elif target is not None:
                there, near = q[k, order], at[0, order][tool.own] if k else None
                pose = tool.at_reference(_in_world(tool, joints.arm, target), np.nan_to_num(there))
                there[tool.own] = _arm(joints.arm).joints_at(pose, target.configuration, near)
                more = there[None]
        except InvalidInput as error:
            error.line = line or (target.line if target else None) or error.line
            raise
        if tool is not None and (line or target is not None):
            q_there = np.repeat(at, len(more), axis=0)
            q_there[:, order] = more
            more = q_there
        speed = moves.speeds[k - 1] if k and moves.speeds else None
        if speed is not None and durations is not None and tool is not None:
            R, p = tool.poses(np.concatenate([at, more[-1:]])[:, order])
            point = _point(joints.arm, target)
            durations[k - 1] = speed.seconds(*_way(R[0], p[0], R[1], p[1], point))
        at = more[-1:]
        rows.append(more)
        shares.append(share)
    if durations is None:
        return Followed(np.concatenate(rows), None, None)
    ends = np.concatenate([[0.0], np.cumsum(durations)])
    at_rows = [ends[:1], *(ends[k] + share * durations[k] for k, share in enumerate(shares[1:]))]
    return Followed(np.concatenate(rows), np.concatenate(at_rows), durations)


def _line(
    tool: ToolChain, arm: ControllerArm | None, begin: Array, end: Array, target: Target | None
) -> tuple[Array, Array]:
    """Shares and joint positions of a straight move, behind those where it begins."""
    if target is None:
        shares, rows = tool.straight(begin, end)
    else:
        pose = _in_world(tool, arm, target)
        there = Poses(pose.rotation().as_matrix(), pose.translation())
        shares, rows = tool.straight_to(begin, there, _point(arm, target), end)
        if target.configuration:
            _arm(arm).check_configuration(rows[-1, tool.own], target.configuration)
    return shares[1:], rows[1:]


def _point(arm: ControllerArm | None, target: Target | None) -> mink.SE3 | None:
    """The program's tool in the task's frame; ``None``: it is that one."""
    if target is None or target.tool.pose is None:
        return None
    return _arm(arm).tool_in_flange.inverse() @ target.tool.pose


def _in_world(tool: ToolChain, arm: ControllerArm | None, target: Target) -> mink.SE3:
    """The pose of the task's frame in the world, or on the part that moves, at a target."""
    if target.tool.pose is None and target.frame.pose is None:
        return target.pose
    if target.frame.pose is not None and tool.external:
        raise InvalidInput(
            f"positions in {target.frame.name}, whose pose the program states, are not read of a "
            "robot on a rail: where its controller has the world is not known. Use a frame by "
            "number, which is the world of the task."
        )
    return _arm(arm).world_pose(target.pose, target.tool.pose, target.frame.pose)


def _arm(arm: ControllerArm | None) -> ControllerArm:
    if arm is None:
        raise InvalidInput(
            "a pose in the robot's base, or with configuration data, is read for known robots, in "
            "the languages that have such data; name the robot (--robot)."
        )
    return arm
