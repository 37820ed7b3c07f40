"""Moves of the tool through few of a trajectory's rows, as programs state them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Literal, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector
from qp_twist.paths import PathTask
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.programs import (
    PACE,
    RESTS,
    Circle,
    Dialect,
    JointMoves,
    ProgramFrame,
    Speed,
    Target,
)
from qp_twist.referee import Tolerances
from qp_twist.robots import ControllerJoints, ToolChain
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories.corners import Corners
from qp_twist.trajectories.fitted_moves import ROUNDED_UP, SHORTEST, Fits, FittedMove, farthest
from qp_twist.trajectories.rest_to_rest import RestToRest
from qp_twist.trajectories.timed_path import TimedPath

_ROUNDED = 0.25
"""Share of the tolerances by which a controller may round a point that it passes: a little more
than that of a chord, so that the points of a smooth curve are passed without a stop."""

_PROCESS = 3
"""Fewest straight moves at one speed between two ramps: with fewer there is nothing to hold."""
_FREE = Speed(1.0, float(np.radians(200.0)))
"""Speeds that do not count, as the move is slower by the other one: below those of all controllers.
"""
_DECIMALS = 7
"""Of positions in m, as programs print them."""
_DIGIT = 1e-5
"""Share by which the printed digits of an acceleration may raise it."""
_DIGITS = 4
"""Significant digits of speeds, rounded down: moves take at most a thousandth longer."""


class StraightMoves(NamedTuple):
    """Rows between which the tool moves straight.

    Attributes:
        rows: Those that are kept.
        straight: Whether the move to each row but the first is straight, else a joint move.
        halves: Half of the shorter move beside each row, m, the most that controllers round; 0
            where a joint move begins or ends, (N,).
        shares: Of ``halves`` what may be rounded, so that the tool is within a quarter of the
            tolerances; 0: the robot stops there, (N,).
        moves: The moves, N − 1.
        speeds: The largest of the joint that goes farthest on each joint move that the joints'
            limits allow, rad/s; ∞ of straight ones.
        accelerations: Likewise on all moves, rad/s² of that joint, or m/s² of the tool.
        instead: How many joint moves are where a straight one would lead the joints through a
            singularity or beyond their limits.
    """

    rows: TimedPath
    straight: Mask
    halves: Array
    shares: Array
    moves: tuple[FittedMove, ...]
    speeds: Array
    accelerations: Array
    instead: int


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
        circles: Whether moves may be on circles.
    """

    tool: int | None = None
    frame: int | None = None
    points: Literal["joints", "poses"] | None = None
    circles: bool = True

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
            halves=line.halves, shares=line.shares,
            tcp=None if joints.arm is None else joints.arm.tool_in_flange,
            part=part, frame=self.frame or 1, circles=_circles(line, joints, dialect),
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
        circles = list(moves.circles)
        for k, (straight, fitted) in enumerate(zip(line.straight, line.moves, strict=True), 1):
            begins = (R, p) if targets[-1] else (R_shown, p_shown)  # as printed
            move = fitted.move
            if fitted.q is None:
                here = Poses(begins[0][k - 1], begins[1][k - 1])
                move = ToolMove.between(here, Poses(R[k], p[k]))
            way, turn = move.length, move.turn
            target = speed = None
            if straight and (way > RESTS or turn > RESTS):
                pose = mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(R[k]), p[k])
                target = Target(pose, tool, frame, arm.configuration(q[k, chain.own]))
                kept[k - 1] = 1
                if fitted.q is not None and fitted.rule is not None:
                    R_via, p_via = (each[0] for each in chain.poses(fitted.q[None]))
                    pose = mink.SE3.from_rotation_and_translation(
                        mink.SO3.from_matrix(R_via), np.round(p_via, _DECIMALS)
                    )
                    via = Target(pose, tool, frame, arm.configuration(fitted.q))
                    circles[k - 1] = Circle(fitted.rule, None, via)
                if not dialect.speeds:
                    speed = _slower(durations[k - 1], way, turn)
                    durations[k - 1] = speed.seconds(way, turn)
            targets.append(target)
            speeds.append(speed)
        changes = np.append(0, kept) != np.append(kept, 0)
        assert moves.shares is not None
        return replace(
            moves, durations=durations, straight=tuple(kept), targets=tuple(targets),
            shares=np.where(changes, 0.0, moves.shares), speeds=tuple(speeds),
            circles=tuple(circles),
        )  # fmt: skip


def _circles(
    line: StraightMoves, joints: ControllerJoints, dialect: Dialect
) -> tuple[Circle | None, ...]:
    """The circles of moves, each through what the controller shows at its point between."""
    found = list[Circle | None]()
    for each in line.moves:
        angles = None
        if each.q is not None and joints.tool is not None:
            order = [joints.tool.names.index(name) for name in joints.joint_names]
            shown = joints.scale(dialect.unit) * joints.shown(each.q[None, order])
            angles = (np.round(shown[0], dialect.decimals) + 0.0).tolist()
        found.append(Circle(each.rule, angles) if each.rule else None)
    return tuple(found) if any(found) else ()


def _with_speeds(
    moves: JointMoves, planned: JointMoves, line: StraightMoves, joints: ControllerJoints,
    dialect: Dialect,
) -> JointMoves:  # fmt: skip
    """Moves with the speeds, and so the times, that the dialect prints.

    Moves of ``SHORTEST`` or less, those for which no unit is fine enough, and those whose times are
    printed as finely as the first unit has to be, keep their times. No
    speed makes a joint faster than its fastest anywhere in ``planned``.
    """
    chain, durations, shares = joints.tool, planned.durations, moves.shares
    assert chain is not None and durations is not None and moves.durations is not None
    assert shares is not None
    # Between close points, a printed digit counts.
    places = chain.poses(_printed(moves, joints, chain, dialect)).positions
    for k, target in enumerate(moves.targets):
        places[k] = places[k] if target is None else target.pose.translation()
    round_ = np.array([each.rule is not None for each in line.moves])
    ways = np.where(
        round_, [each.move.length for each in line.moves],
        np.linalg.norm(np.diff(places, axis=0), axis=1),
    )  # fmt: skip
    fastest = (np.abs(np.diff(planned.angles, axis=0)) / durations[:, None]).max(axis=0)
    travel = np.abs(np.diff(moves.angles, axis=0))
    needed = np.divide(travel, fastest, out=np.zeros_like(travel), where=fastest > 0.0)
    least = np.maximum(needed.max(axis=1), durations / (1.0 + ROUNDED_UP))
    speeds, printed = np.full(len(ways), np.nan), moves.durations <= (1.0 + ROUNDED_UP) * durations
    for unit in dialect.speeds:
        found = unit * np.minimum(np.round(ways / durations / unit), np.floor(ways / least / unit))
        # A circle of URScript has no time, so that the finest unit has to do.
        within = PACE if unit == min(dialect.speeds) else ROUNDED_UP
        fits = (found >= (1.0 - within) * ways / durations) | (
            round_ & (unit == min(dialect.speeds)) & (found > 0.0)
        )
        exact = (unit != dialect.speeds[0]) & printed  # a time is nearer to the planned one
        speeds = np.where(np.isnan(speeds) & fits & ~exact, found, speeds)
    speeds[~line.straight | (ways <= SHORTEST)] = np.nan
    constant = np.zeros(len(ways), dtype=bool)
    if dialect.constant:
        joint = ~line.straight  # from rest to rest
        shares = np.where(np.append(False, joint) | np.append(joint, False), 0.0, shares)
        # On the arc from d before a corner of angle θ to d behind it: v² tan(θ/2) / d.
        units, reach = np.array([x.move.tangents() for x in line.moves]), shares * line.halves
        apart, both = (
            np.linalg.norm(x, axis=1)
            for x in (units[1:, 0] - units[:-1, 1], units[1:, 0] + units[:-1, 1])
        )
        bends = np.linalg.norm([x.move.bends()[0] for x in line.moves], axis=1)
        fast = np.minimum(
            ways / np.maximum(needed.max(axis=1), 1e-12),
            np.sqrt(dialect.constant / np.maximum(bends, 1e-12)),
        )
        turns = np.sqrt(dialect.constant * both * reach[1:-1] / np.maximum(apart, 1e-12))
        for begin, end in itertools.pairwise(np.flatnonzero(reach == 0.0).tolist()):
            part = slice(begin, end)
            corners = np.concatenate([[np.inf], turns[begin : end - 1], [np.inf]])
            most = np.minimum(fast[part], np.minimum(corners[:-1], corners[1:]))
            circles = bool(round_[part].any())
            if speed := _constant(speeds[part], most.min(), 1 if circles else _PROCESS):
                speeds[part], constant[part] = speed, True
            else:
                constant[part] = circles and bool((speeds[part] <= most).all())
        # Only movep is known to blend with a circle.
        changes = (round_[1:] != round_[:-1]) & ~constant[1:]
        shares = np.where(np.concatenate([[False], changes, [False]]), 0.0, shares)
    times = np.where(np.isnan(speeds), moves.durations, ways / speeds)
    moves = replace(
        moves,
        durations=times,
        speeds=tuple(None if np.isnan(speed) else Speed(speed) for speed in speeds.tolist()),
        constant=tuple(constant.tolist()),
        shares=shares,
    )
    return _with_ramps(moves, ways / times, line, dialect) if dialect.constant else moves


def _with_ramps(moves: JointMoves, v: Array, line: StraightMoves, dialect: Dialect) -> JointMoves:
    """Moves at speeds v (N − 1,) with accelerations, and joint moves from rest to rest by theirs.

    A straight move has what arcs need, and at both ends the changes of speed over the times between
    the middles of moves, from stops and to stops over half of one: as far as the joints may. A
    joint move takes the planned time, or as much longer as the joints need.
    """
    times, shares = moves.durations, moves.shares
    assert times is not None and shares is not None
    v, ends, allowed = v * line.straight, shares == 0.0, (1.0 - _DIGIT) * line.accelerations
    ramps = np.abs(np.diff(v)) / (0.5 * (times[:-1] + times[1:]))
    beside = np.maximum(np.append(0.0, ramps), np.append(ramps, 0.0))
    stops = 2.0 * v / times * (ends[:-1] | ends[1:])
    needed = np.maximum(dialect.constant, np.maximum(beside, stops))
    stated = np.where(line.straight, np.minimum(needed, allowed), allowed)
    accelerations = [float(f"{a:.6g}") for a in stated.tolist()]
    durations, speeds, unit = times.copy(), [*moves.speeds], min(dialect.speeds)
    for k in np.flatnonzero(~line.straight).tolist():
        way, a = float(np.abs(np.diff(moves.angles[k : k + 2], axis=0)).max()), accelerations[k]
        fastest = RestToRest.in_time(way, float(times[k]), float(line.speeds[k]), a).speed
        if speed := unit * float(np.floor(fastest / unit)):
            speeds[k], durations[k] = Speed(speed), RestToRest(way, speed, a).seconds
    of = zip(accelerations, speeds, strict=True)
    return replace(
        moves, durations=durations, speeds=tuple(speeds),
        accelerations=(None, *(a if speed else None for a, speed in of)),
    )  # fmt: skip


def _printed(
    moves: JointMoves, joints: ControllerJoints, chain: ToolChain, dialect: Dialect
) -> Array:
    """Positions of the chain's joints at the points as they are printed, (N, n)."""
    order = [joints.joint_names.index(name) for name in chain.names]
    return joints.positions(moves.angles / joints.scale(dialect.unit))[:, order]


def _constant(speeds: Array, most: float, count: int) -> float:
    """The one speed of moves from stop to stop, m/s; 0 if it is above ``most``, or not one.

    All but those of the ramps at both ends have it within 2 %, at least ``count``.
    """
    if np.isnan(speeds).any():
        return 0.0
    full = np.flatnonzero(speeds >= (1.0 - PACE) * speeds.max())
    speed = float(speeds[full].min())
    is_one = len(full) == full[-1] - full[0] + 1 >= count and speed <= most
    return speed if is_one else 0.0


def _slower(seconds: float, way: float, turn: float) -> Speed:
    """The speeds of a move that takes some time, or a little more."""
    if way < RESTS:
        return Speed(_FREE.linear, _rounded_down(turn / seconds))
    return Speed(_rounded_down(way / seconds), max(_FREE.angular, turn / seconds))


def _rounded_down(value: float) -> float:
    unit = 10.0 ** (np.floor(np.log10(max(value, 1e-9))) + 1.0 - _DIGITS)
    return float(np.floor(value / unit) * unit)


def straight_moves(
    rows: TimedPath, path_task: PathTask, tool: ToolChain, held: Mask | None = None, *,
    dialect: Dialect, circles: bool = True, joined: Mask | None = None,
) -> StraightMoves:  # fmt: skip
    """As few of the rows as keep the path if the tool moves from one to the next.

    Greedily, each move leads to the farthest row such that the tool is within a fifth of the
    tolerances of where it was planned, in the directions of the task, and the joints remain beside
    those planned: straight or, with ``circles`` and where the arm alone moves the tool, on a
    circle, within a half. Where the joints do not follow such a move, or not within their limits
    of speed and acceleration in the planned time, and between the waypoints of the task's joint
    moves, a joint move does. Rows that are ``held`` (N,) are points; to those that are ``joined``
    (N,) joint moves lead, too.
    """
    fits = Fits(rows, path_task, tool, held, dialect=dialect, joined=joined)
    rules = dialect.circles if circles and not (tool.external or tool.part) else ()
    points, moves = farthest(fits, rules)
    kept = [point.row for point in points]
    times = fits.times[kept]
    own = np.array([point.q for point in points])
    q = rows.at(times).q
    q[:, [rows.joint_names.index(name) for name in tool.names]] = own
    found = replace(rows, q=q, times=times, velocities=None, accelerations=None)
    straight = np.array([not each.of_joints for each in moves])
    passed = np.concatenate([[False], straight[:-1] == straight[1:], [False]])
    corners = Corners.of(tool, own, [None if each.of_joints else each.move for each in moves])
    shares = rounded_shares(corners, fits.projector, path_task.tolerances, dialect.zone)
    instead = int((~straight & ~fits.on_joint_moves[kept[1:]]).sum())
    speeds, accelerations = np.transpose(
        [fits.fastest(*each) for each in zip(moves, points, strict=False)]
    )
    return StraightMoves(
        found, straight, np.pad(corners.halves, 1) * passed, shares * passed, tuple(moves),
        speeds, accelerations, instead,
    )  # fmt: skip


def rounded_shares(
    corners: Corners, projector: TwistProjector, tolerances: Tolerances, zone: float
) -> Array:
    """Shares of the moves' halves from which on points may be rounded, (N,); 0: a stop.

    Where points are rounded from ``zone`` m on, a stop is where that is too far.
    """
    linear, square, angular = corners.rounding(projector)
    # Of s linear + s² square = a quarter of the tolerance, the solution s above 0.
    most = _ROUNDED * tolerances.position
    root = 0.5 * linear + np.sqrt((0.5 * linear) ** 2 + square * most)
    shares = 1.0 / np.maximum(1.0, np.maximum(root / most, angular / (_ROUNDED * tolerances.axis)))
    far = np.isfinite(zone) & (shares * corners.halves < np.minimum(corners.halves, zone))
    return np.pad(np.where(far, 0.0, shares), 1)
