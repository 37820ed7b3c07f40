"""The motion of a program: its moves of the tool, followed by inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.errors import InvalidInput
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.programs import PACE, RESTS, Circle, JointMoves, Speed, Target
from qp_twist.robots import ControllerArm, ControllerJoints, ToolChain
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories.corners import Corners
from qp_twist.trajectories.rest_to_rest import RestToRest
from qp_twist.trajectories.within_limits import Ramp, Way, at_rests, travel

_SHORTEST = 1e-12
"""Time, s, of a move to where the robot is."""
_DECIMALS = 12
"""Of times: as many as any language prints, and one more."""
_TURNED = float(np.radians(0.05))
"""Turn from that in proportion, rad, that counts as none: the tolerance of an axis."""


_ON = {
    "": "in a frame that stands still", "positioner": "on a part that a positioner moves",
    "hand": "on a part that the robot holds",
}  # fmt: skip
_MOVED = {"": "stands still", "positioner": "is on a positioner", "hand": "is in its hand"}


class NotFollowed(InvalidInput):
    """The joints do not follow a move of the tool, or arrive with another configuration.

    Attributes:
        move: Which of the program's moves, from 0.
    """

    def __init__(self, sentence: str, move: int, line: int | None) -> None:
        super().__init__(sentence, line=line)
        self.move = move


class Followed(NamedTuple):
    """The motion of a program.

    Attributes:
        q: Its rows, those of moves of the tool between points, too, (K, n).
        times: Their times, s, (K,), if the program has times.
        points: Which rows are points, (N,).
        corners: Of the tool at the points; ``None`` if no point is rounded, or no tool is known.
        ramps: Joint accelerations on the moves to the points while their speeds change as the
            program states it, (N, n); ``None`` if it states no acceleration.
        at_rests: The least accelerations of joints on the moves in stated times to the points,
            from rest or to rest, (N, n); 0 of other moves. ``None`` without times.
        short: Lines of moves that do not come to their speed as the program states it.
    """

    q: Array
    times: Array | None
    points: Indices
    corners: Corners | None
    ramps: Array | None
    at_rests: Array | None
    short: list[int]


def followed(
    moves: JointMoves, q: Array, joints: ControllerJoints, vias: Sequence[Array | None] = ()
) -> Followed:
    """The motion of a program with joint positions q (N, n) at its points, nan where it has a pose.

    Moves of the tool are followed from where they begin; one to a pose has to arrive with the
    configuration that the program states. A joint move to a pose leads to the joint positions that
    the configuration names.

    Args:
        moves: The moves.
        q: Joint positions.
        joints: How the controller counts them.
        vias: Of each move the joint positions (n,) of the point on its circle; ``None``: a pose.

    Raises:
        InvalidInput: If the tool or the robot is not known, or the joints do not follow a move;
            with its line.
    """
    lines = moves.straight or (0,) * (len(q) - 1)
    targets = moves.targets or (None,) * len(q)
    tcps = moves.tcps or [target.tool.pose if target else None for target in targets]
    tool = joints.tool
    if tool is None and (any(lines) or any(targets)):
        raise InvalidInput("straight moves of the tool are read with the task of the robot.")
    _refuse_other_parts(moves, tool)
    order = [] if tool is None else [joints.joint_names.index(name) for name in tool.names]
    durations = None if moves.durations is None else moves.durations.copy()
    at, q = q[:1], q.copy()
    rows, shares, tool_moves = list[Array](), list[Array](), list[ToolMove | None]()
    for k, target in enumerate(targets):
        line = lines[k - 1] if k else 0
        share, more, move = np.ones(1), q[k : k + 1], None
        try:
            if tool is None:
                pass
            elif line:
                circle = moves.circles[k - 1] if moves.circles else None
                via = vias[k - 1][order] if circle and vias[k - 1] is not None else None  # type: ignore[index]
                begin, end = at[0, order], q[k, order]
                move = _move(tool, joints.arm, begin, end, target, tcps[k], circle, via)
                share, more = _along(tool, joints.arm, move, begin, end, target, circle)
                if (speed := _stated(moves, k)) and durations is not None:
                    durations[k - 1] = speed.seconds(move.length, move.turn)
            elif target is not None and k and target is targets[k - 1]:  # a wait
                more = at[:, order]
            elif target is not None:
                near = at[0, order][tool.own] if k else None
                more = _at_pose(tool, joints.arm, target, q[k, order], near)[None]
        except InvalidInput as error:
            place = line or (target.line if target else None) or error.line
            raise NotFollowed(error.sentence, k - 1, place) from error
        if tool is not None and (line or target is not None):
            there, more = more, np.repeat(at, len(more), axis=0)
            more[:, order] = there
        if not line and durations is not None and (speed := _stated(moves, k)):
            a = moves.accelerations[k]
            durations[k - 1], share, more = _from_rest(at[0], more[-1], speed.linear, a)
        at = more[-1:]
        rows.append(more)
        shares.append(share)
        tool_moves.append(move)
    corners, found = None, np.concatenate(rows)
    points = np.cumsum([len(more) for more in rows]) - 1
    if tool is not None and moves.zones:
        corners = Corners.of(tool, found[points][:, order], tool_moves[1:])
    ways = [Way(*each) for each in zip(shares, rows, strict=True)]
    ramps, short = _ramps(moves, ways, tool_moves, durations)
    rested = _at_rests(moves, ways, durations)
    return Followed(found, _times(durations, shares), points, corners, ramps, rested, short)


def _times(durations: Array | None, shares: Sequence[Array]) -> Array | None:
    """The times of rows at shares of the moves to points."""
    if durations is None:
        return None
    # Sums of printed times have no more digits than these: those that floats add would hide from
    # the check that the times are whole nanoseconds, whose rounding it knows.
    ends = [round(end, _DECIMALS) for end in np.cumsum(durations).tolist()]
    begins = [0.0, *ends[:-1]]
    of = zip(begins, durations, shares[1:], strict=True)
    return np.concatenate([[0.0], *(begin + share * seconds for begin, seconds, share in of)])


def _at_rests(moves: JointMoves, ways: Sequence[Way], durations: Array | None) -> Array | None:
    """What the ways to points (N) need, likewise; the robot rests before and behind all."""
    if durations is None:
        return None
    rests = np.isin(np.arange(len(ways)), [0, *moves.rests, len(ways) - 1])
    ends = (rests[:-1].astype(int) + rests[1:]) * moves.in_times
    needed = at_rests(travel(ways[0].q[-1], ways[1:]), durations, ends)
    return np.pad(needed, ((1, 0), (0, 0)))


def _from_rest(
    begin: Array, end: Array, speed: float, acceleration: float | None
) -> tuple[float, Array, Array]:
    """A joint move from rest to rest: its time, shares of it (K,), and joint positions (K, n)."""
    assert acceleration is not None  # of each joint move with a speed
    move = RestToRest(float(np.abs(end - begin).max()), speed, acceleration)
    share, way = move.samples()
    return move.seconds, share, begin + way[:, None] * (end - begin)


def _stated(moves: JointMoves, k: int) -> Speed | None:
    """The speed that the program states of the move to a point."""
    return moves.speeds[k - 1] if k and moves.speeds else None


def _refuse_other_parts(moves: JointMoves, tool: ToolChain | None) -> None:
    """Refuse straight moves on a part that is moved by something else than that of the task."""
    for part, number in moves.parts.items():
        if tool is not None and part not in (None, tool.part):
            raise InvalidInput(
                f"the tool moves straight {_ON[part]}; the part of the task {_MOVED[tool.part]}.",
                line=number,
            )


def _ramps(
    moves: JointMoves, ways: Sequence[Way], tool_moves: Sequence[ToolMove | None],
    durations: Array | None,
) -> tuple[Array | None, list[int]]:  # fmt: skip
    """Joint accelerations on the moves to points while speeds change, (N, n); 0 where none do.

    Of a joint move that of the joint that goes farthest is stated, and others are in proportion.
    Also the lines of straight moves that are too short for their speed: the controller has half of
    a move to come to it from rest, and of both moves to change it.
    """
    if not any(moves.accelerations[1:]):
        return None, []
    lines, stops = moves.straight or (0,) * (len(ways) - 1), np.isin(range(len(ways)), moves.rests)
    T = np.zeros(len(ways) + 1)  # beside the first and the last move nothing moves
    v = T.copy()
    if durations is not None:
        T[1:-1] = durations
        ways_of = [each.length if each else 0.0 for each in tool_moves[1:]]
        v[1:-1] = ways_of / np.maximum(durations, _SHORTEST)
    found, short = np.zeros((len(ways), ways[0].q.shape[1])), list[int]()
    for k, (way, move, a) in enumerate(zip(ways, tool_moves, moves.accelerations, strict=True)):
        if k == 0 or a is None:
            continue
        begin = ways[k - 1].q[-1]
        if move is None:
            change = np.abs(way.q[-1] - begin)
            found[k] = a * change / max(float(change.max()), 1e-12)
        elif move.length > RESTS and durations is not None:
            changes = [
                (v[k], T[k]) if stop else (abs(v[k] - v[other]), T[k] + T[other])
                for other, stop in ((k - 1, stops[k - 1]), (k + 1, stops[k]))
            ]
            if any(change > PACE * v[k] for change, _ in changes):
                ramp = Ramp.of(begin, way, T[k], move.length)
                found[k] = a * ramp.per_unit + ramp.steady
            if any(2.0 * change > (1.0 + PACE) * a * over for change, over in changes):
                short.append(lines[k - 1])
    return found, short


def _move(
    tool: ToolChain, arm: ControllerArm | None, begin: Array, end: Array, target: Target | None,
    tcp: mink.SE3 | None, circle: Circle | None, via: Array | None,
) -> ToolMove:  # fmt: skip
    """The move of the tool from joint positions to others, or to a pose; through a point or not.

    It is that of ``tcp``, its pose in the flange; ``None``: of the task's frame.
    """
    here, there = _first(tool.poses(begin[None])), _first(tool.poses(end[None]))
    if target is not None:
        there = _poses(_in_world(tool, arm, target))
    offset = np.zeros(3)
    if tcp is not None:
        offset = (_arm(arm).tool_in_flange.inverse() @ tcp).translation()
    if circle is None:
        return ToolMove.between(here, there, offset)
    if tool.external or tool.part:
        raise InvalidInput(
            "circles are read where the robot's arm alone moves the tool, along a part at rest; "
            "write straight moves."
        )
    on = _first(tool.poses(via[None])) if via is not None else None
    if on is None:
        assert circle.target is not None
        on = _poses(_in_world(tool, arm, circle.target))
    place = on.positions + on.rotations @ offset
    move = ToolMove.circular(here, place, there, circle.rule, offset, circle.sweep)
    if circle.turned:
        off = move.off_turn(place, on.rotations)
        if off > _TURNED:
            raise InvalidInput(
                f"at the point between, the tool is turned by {np.degrees(off):.3g}° from where it "
                "would be if it turned in proportion; what the controller makes of that is not "
                "public. Write the turn in proportion there."
            )
    return move


def _along(
    tool: ToolChain, arm: ControllerArm | None, move: ToolMove, begin: Array, end: Array,
    target: Target | None, circle: Circle | None,
) -> tuple[Array, Array]:  # fmt: skip
    """Shares and joint positions of a move of the tool, behind those where it begins."""
    elsewhere = circle is not None and (circle.sweep is not None or circle.rule == "tangent")
    if target is None and not elsewhere:
        shares, rows = tool.towards(begin, end, move.at)
    else:
        shares, rows = tool.along(begin, move.at, end)
        if target is not None and target.configuration and not elsewhere:
            _arm(arm).check_configuration(rows[-1, tool.own], target.configuration)
    return shares[1:], rows[1:]


def _at_pose(
    tool: ToolChain, arm: ControllerArm | None, target: Target, there: Array, near: Array | None
) -> Array:
    """Joint positions (n,) at a target, with external axes as they are ``there``."""
    pose = tool.at_reference(_in_world(tool, arm, target), np.nan_to_num(there))
    there[tool.own] = _arm(arm).joints_at(pose, target.configuration, near)
    return there


def _first(poses: Poses) -> Poses:
    return Poses(poses.rotations[0], poses.positions[0])


def _poses(pose: mink.SE3) -> Poses:
    return Poses(pose.rotation().as_matrix(), pose.translation())


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
            "a pose in the robot's base, of a tool in its flange, or with configuration data, is "
            "read for known robots, in the languages that have such data; name the robot (--robot)."
        )
    return arm
