"""Moves of the tool that lead through few of a trajectory's rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.geometry import (
    TwistProjector,
    geodesic,
    resolved_twist_error,
    rotation_matrix,
    rotation_vector,
)
from qp_twist.paths import PathTask
from qp_twist.paths.tool_moves import ToolMove
from qp_twist.programs import PACE, Dialect, Turning
from qp_twist.referee import CORNER, turns_of
from qp_twist.robots import ToolChain
from qp_twist.robots.tool_chain import Poses
from qp_twist.trajectories.corners import task_rows
from qp_twist.trajectories.matching import times_at_waypoints
from qp_twist.trajectories.timed_path import TimedPath
from qp_twist.trajectories.within_limits import JointLimits, Ramp, Way

SHORTEST = 1e-4
"""Length up to which a move has a time instead of a speed, m: that of points, so that the tool may
turn there alone."""
_SLOW = 3.0 * SHORTEST
"""The tool's speed times a period, m, up to which moves may have times: such a move is SHORTEST in
a period at most, and what speeds up from rest by a constant jerk is at its end three times as fast
as in the mean."""
_RAMP = 1.5
"""Periods up to which a move that has one speed may lead through a ramp: within one the controller
changes none, and in shorter ones the printed digits of angles would ask for more jerk."""
_ROUNDING, _NEAR = 1e-9, 0.005
"""Rounding of times that are added, s; and the share of a period, or of a tick, up to which two
times count as the same."""
ROUNDED_UP = 1e-3
"""Share by which a printed speed may be above the planned one: the chord of an arc that turns by θ
is shorter by θ²/24, which is 1e-3 at 9°."""
_SHARE = 0.2
"""Share of the tolerances by which a line may leave the planned motion at its rows, which itself
uses up to half of them between waypoints."""
_OF_CIRCLE = 0.5, 0.35
"""Likewise of a circle at rows, most of which are waypoints, and between them. A file states a
circle by chords, whose middles and ends are on both sides of the nearest circle: at ±0.046 mm for
chords of 10 mm at a radius of 150 mm."""
_ASIDE = np.radians([1.0, 3.0])
"""Largest difference of the joints from those planned, rad (17 mm of slides), on a line and on a
circle, where the roll is in proportion for longer: the branch is the same, and limits are nearly
kept as planned."""
_SWEEPS = np.radians([4.0, 170.0])
"""Least and largest angles of a circle and, largest alone, of the tool's turn: from the first point
ABB's controllers need 1° between the other two, a fourth of the angle, and a turn by 180° has two
ways."""
_APART = 1e-4
"""What ABB's controllers need between the points of a circle, m (*RAPID Instructions*, MoveC)."""


class Point(NamedTuple):
    """A point of a program beside a row: the tool's pose (3, 3), (3,), and its joint positions."""

    row: int
    pose: Poses
    q: Array


class FittedMove(NamedTuple):
    """A move of the tool, and of a circle how the tool turns and the point between.

    Attributes:
        move: The move; a straight one in place of a joint move.
        end: The point to which it leads.
        way: The joints on it; of a move that is not yet followed, at its end.
        rule: ``None``: straight.
        q: Joint positions at the point between, rad, (n,); ``None``: straight.
        of_joints: Whether it is a joint move.
    """

    move: ToolMove
    end: Point
    way: Way
    rule: Turning | None = None
    q: Array | None = None
    of_joints: bool = False


class Fits:
    """Which moves keep the rows of a trajectory, and the path between them."""

    def __init__(
        self, rows: TimedPath, path_task: PathTask, tool: ToolChain, held: Mask | None, *,
        dialect: Dialect, joined: Mask | None = None,
    ) -> None:  # fmt: skip
        """Rows that are ``held`` (N,) are points; to those that are ``joined`` joint moves lead.

        Where the dialect has ``two_angles`` a move has to keep them, too, if a controller swings an
        axis of the tool, whichever it is, and turns about it at once. Within ``_RAMP`` periods a
        move may lead through a ramp. More rows are made where moves end
        between those that are given (:meth:`row_at`), which changes the indices of those behind.
        """
        self._tool, self._dialect, own = tool, dialect, rows.of_joints(tool.names)
        self._tick = 10.0**-dialect.time_decimals
        self._motion, times = own.motion, own.motion.times
        self._times = np.insert(times, np.arange(1, len(times)), own.motion.middles)
        self._q = own.motion.at(self._times).q
        self._q[::2] = own.q
        self._poses = tool.poses(self._q)
        self._held = np.zeros(len(own.q), dtype=bool) if held is None else held
        self._tolerances, self._projector = path_task.tolerances, task_rows(path_task)
        self._limits = JointLimits.of(path_task, tool.names, ramps=dialect.constant > 0.0)
        self.on_joint_moves = _on_joint_moves(rows, path_task)
        """Rows that a joint move of the task leads to, (N,)."""
        self.joined = self.on_joint_moves if joined is None else self.on_joint_moves | joined
        self._changing = _changing(rows.motion.times, self._poses, dialect.period) | self.joined

    @property
    def projector(self) -> TwistProjector:
        """The directions in which the tool has to stay."""
        return self._projector

    @property
    def times(self) -> Array:
        """Of the rows, s, (N,)."""
        return self._times[::2]

    def row_at(self, time: float) -> int:
        """The row at a time, s, which is made one if it is none."""
        row = int(np.searchsorted(self.times, time - _ROUNDING))
        if self.times[row] - time > _ROUNDING:
            own = np.array([self.times[row - 1], time, self.times[row]])
            more = np.insert(0.5 * (own[1:] + own[:-1]), 1, time)
            q, place = self._motion.at(more).q, slice(2 * row - 1, 2 * row)

            def put(of: Array, new: Array) -> Array:
                return np.concatenate([of[: place.start], new, of[place.stop :]])

            self._times, self._q = put(self._times, more), put(self._q, q)
            self._poses = Poses(*map(put, self._poses, self._tool.poses(q)))
            self._held = np.insert(self._held, row, False)
            self._changing = np.insert(self._changing, row, self._changing[row - 1])
            self.on_joint_moves, self.joined = (
                np.insert(each, row, each[row]) for each in (self.on_joint_moves, self.joined)
            )
        return row

    def most(self, begin: int) -> int:
        """The row as far as which moves from a row are joint moves, or are not."""
        ends = np.flatnonzero(self.joined[begin + 1 :] != self.joined[begin + 1])
        return begin + int(ends[0]) if len(ends) else len(self.joined) - 1

    def in_time(self, begin: int, end: int) -> float:
        """When a move from a row that leads to row ``end`` should end, s.

        Neither it nor what is left up to the last row of its kind is shorter than a period, since
        it would take longer than planned, and what is left is no move through a ramp that is too
        long for one and too short for two. Where speeds change, it takes whole ticks, in which
        times are printed.
        """
        times, period, most = self.times, self._dialect.period, self.most(begin)
        if end == most:
            return float(times[end])
        time, left, both = times[end], times[most] - times[end], times[most] - times[begin]
        if left < period or _RAMP * period < left < 2.0 * period:
            time = times[most] - (2.0 * period if both > 3.0 * period else 0.5 * both)
        time = max(time, times[begin] + period)
        ticks = (time - times[0]) / self._tick
        if self._changing[int(np.searchsorted(times, time + _ROUNDING)) - 1]:
            whole = np.floor(ticks + _NEAR) * self._tick + times[0]
            time = whole if whole - times[begin] > period - _ROUNDING else whole + self._tick
        near = abs(time - times[end]) < _NEAR * period or time > times[most] - _ROUNDING
        return float(times[end] if near else time)

    def point(self, row: int) -> Point:
        """Where a row is."""
        R, p = (each[2 * row] for each in self._poses)
        return Point(row, Poses(R, p), self._q[2 * row])

    def straight(self, begin: Point, end: int) -> FittedMove | None:
        """The straight move from a point to a row, if it keeps the rows between."""
        to = self.point(end)
        move = ToolMove.between(begin.pose, to.pose)
        places = np.arange(2 * begin.row, 2 * end + 1, 2)
        found = self._keeps(move, places, self._allowed(begin, places))
        return None if found is None else FittedMove(move, to, Way.to(to.q))

    def joints(self, begin: Point, end: int) -> FittedMove | None:
        """The joint move from a point to a row, likewise; that to the next row always.

        It has the pace of the rows but where it is from rest to rest.
        """
        to, places = self.point(end), np.arange(2 * begin.row, 2 * end + 1, 2)
        way, share = to.q - begin.q, self._paced(places)
        if self._dialect.constant:
            along = (self._q[places] - begin.q) @ way
            share = np.clip(along / max(float(way @ way), 1e-12), 0.0, 1.0)
        q = begin.q + share[:, None] * way
        if end > begin.row + 1 and (
            self._held[begin.row + 1 : end].any()
            or np.abs(q - self._q[places]).max() > _ASIDE[0]
            or not self._within(self._tool.poses(q), places, self._allowed(begin, places))
        ):
            return None
        move = ToolMove.between(begin.pose, to.pose)
        return FittedMove(move, to, Way.to(to.q), of_joints=True)

    def circle(self, begin: Point, end: int, rule: Turning) -> FittedMove | None:
        """The circular move to the nearest circle beside a row, likewise.

        Its point between is on that circle beside the row in the middle.
        """
        places = np.arange(2 * begin.row, 2 * end + 1)
        middle = (end - begin.row) // 2
        R, p = (each[places] for each in self._poses)
        points = np.array([begin.pose.positions, *_on_circle(p, p[[2 * middle, -1]])])
        try:
            move = ToolMove.circular(begin.pose, points[1], Poses(R[-1], points[2]), rule)
        except InvalidInput:  # on a line, or the same
            return None
        assert move.arc is not None
        turn = float(np.linalg.norm(move.d))
        apart = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
        if not (_SWEEPS[0] <= move.arc.sweep <= _SWEEPS[1] and turn <= _SWEEPS[1]):
            return None
        if apart.min() < _APART:
            return None
        found = self._keeps(move, places, np.where(places % 2, *_OF_CIRCLE[::-1]))
        if found is None:
            return None
        shares = np.append(move.share(points[1][None]), 1.0)
        q = self._tool.beside(found[[2 * middle, -1]], move.at(shares))
        if q is None:
            return None
        to = Point(end, Poses(R[-1], points[2]), q[1])
        return FittedMove(move, to, Way.to(to.q), rule, q[0])

    def followed(self, found: FittedMove, begin: Point) -> FittedMove | None:
        """A move from a point if the joints follow it within their limits in the planned time."""
        if found.of_joints:
            return found
        try:
            shares, q = self._tool.towards(begin.q, found.end.q, found.move.at)
        except InvalidInput:
            return None
        way = Way(shares[1:], q[1:])
        seconds = self._times[2 * found.end.row] - self._times[2 * begin.row]
        slower = self._limits.slower(begin.q, [way], np.array([seconds]))
        found = found._replace(way=way)
        # Where a script states accelerations, joints need some of theirs for ramps.
        if self._dialect.constant and not self.fastest(found, begin)[1]:
            return None
        return found if slower[0] <= 1.0 + PACE else None

    def fastest(self, found: FittedMove, begin: Point) -> tuple[float, float]:
        """The largest speed and acceleration on a move that the joints' limits allow.

        Of a joint move those of the joint that goes farthest, rad/s and rad/s²; else the tool's
        acceleration alone, m/s², 0 if a joint has next to nothing left at constant speed, which may
        be as much above the planned one as it is rounded.
        """
        if found.of_joints:
            shares = np.abs(found.end.q - begin.q)
            shares = np.maximum(shares / max(float(shares.max()), 1e-12), 1e-12)
            speed, acceleration = (float((most / shares).min()) for most in self._limits)
            return speed, acceleration
        if found.move.length < self._tolerances.position:
            return np.inf, np.inf
        seconds = self._times[2 * found.end.row] - self._times[2 * begin.row]
        ramp = Ramp.of(begin.q, found.way, seconds / (1.0 + ROUNDED_UP), found.move.length)
        left = self._limits.acceleration - ramp.steady
        if (left < PACE * self._limits.acceleration).any():
            return np.inf, 0.0
        return np.inf, float((left / np.maximum(ramp.per_unit, 1e-12)).min())

    def _paced(self, places: Indices) -> Array:
        """The share of the time at each of some places, (K,)."""
        times = self._times[places]
        share: Array = (times - times[0]) / (times[-1] - times[0])
        return share

    def _allowed(self, begin: Point, places: Indices) -> Array:
        """The shares of the tolerances (K,) for a line that may begin on a circle before."""
        beside = begin.pose.positions - self._poses.positions[2 * begin.row]
        off = float(np.linalg.norm(beside)) / self._tolerances.position
        allowed: Array = _SHARE + off * np.linspace(1.0, 0.0, len(places))
        return allowed

    def _within(self, poses: Poses, places: Indices, allowed: Array) -> bool:
        """Whether the tool is where it was planned, within shares (K,) of the tolerances."""
        R, p = (each[places] for each in self._poses)
        _, error = resolved_twist_error(*poses, R, p, self._projector)
        linear, angular = (np.linalg.norm(part, axis=1) for part in np.hsplit(error, 2))
        return bool(self._tolerances.met(linear / allowed, angular / allowed).all())

    def _keeps(self, move: ToolMove, places: Indices, allowed: Array) -> Array | None:
        """The joint positions (K, n) on a move beside places, if those are kept.

        ``allowed`` (K,) are the shares of the tolerances.
        """
        if self._held[places[0] // 2 + 1 : places[-1] // 2].any():
            return None
        times, paced = self._times[places], self._paced(places)
        p = self._poses.positions[places]
        share = move.share(p) if move.length > self._tolerances.position else paced
        longer = times[-1] - times[0] > _RAMP * self._dialect.period
        if longer and np.abs(share - paced).max() > PACE:
            return None
        line = move.at(share)
        for turned in (line.rotations, *self._swung(move, share)):
            if not self._within(Poses(turned, line.positions), places, allowed):
                return None
        near, on = self._q[places], list(self._tool.external)
        near[:, on] = near[0, on] + share[:, None] * (near[-1, on] - near[0, on])
        found = self._tool.beside(near, line)
        aside = _ASIDE[int(move.arc is not None)]
        if found is None or np.abs(found - self._q[places]).max() > aside:
            return None
        return found

    def _swung(self, move: ToolMove, share: Array) -> list[Array]:
        """The rotations (K, 3, 3) on a move if an axis of the tool swings."""
        if not self._dialect.two_angles:
            return []
        lead = rotation_matrix(share[:, None] * move.omega)
        ends = move.rotation, move.rotation @ rotation_matrix(move.d)
        return [lead @ _two_angles(np.array(ends), share, axis) for axis in np.eye(3)]


def _on_circle(positions: Array, near: Array) -> Array:
    """The points nearest to others, (K, 3), on the circle nearest to positions (N, 3).

    In the plane of the two largest singular values; its centre solves x² + y² = 2 a x + 2 b y + c
    by least squares (Kåsa 1976), its radius is between the least and the largest distance from it.
    """
    middle = positions.mean(axis=0)
    plane = np.linalg.svd(positions - middle, full_matrices=False)[2][:2]
    xy = (positions - middle) @ plane.T
    (*centre, _), *_ = np.linalg.lstsq(
        np.column_stack([2.0 * xy, np.ones(len(xy))]), (xy**2).sum(axis=1)
    )
    radii = np.linalg.norm(xy - centre, axis=1)
    away = (near - middle) @ plane.T - centre
    radius = 0.5 * (radii.min() + radii.max()) / np.linalg.norm(away, axis=1, keepdims=True)
    found: Array = middle + (centre + radius * away) @ plane
    return found


def farthest(fits: Fits, rules: Sequence[Turning]) -> tuple[list[Point], list[FittedMove]]:
    """The points, and the moves between them.

    From each row the move is the farthest. A circle, which has two points, has to lead farther than
    two such straight moves. Where the joints do not follow within their limits, it leads half as
    far; where they do not follow at all, and to rows that are joined, a joint move is next.
    """
    points, moves = [fits.point(0)], list[FittedMove]()
    while (begin := points[-1]).row < len(fits.times) - 1:
        straight, joined = partial(fits.straight, begin), fits.joined[begin.row + 1]
        of, best = straight, None if joined else _reach(fits, straight, begin, 1)
        least = 1 + 2 * (best.end.row - begin.row if best else 1)
        for rule in () if joined else rules:
            circle = partial(fits.circle, begin, rule=rule)
            found = _reach(fits, circle, begin, least)
            if found is not None and (best is None or found.end.row > best.end.row):
                of, best = circle, found
        if best is None:
            of = partial(fits.joints, begin)
            best = _reach(fits, of, begin, 1)
        assert best is not None  # to the next row
        moves.append(_in_time(fits, of, begin, best))
        points.append(moves[-1].end)
    return points, moves


def _in_time(
    fits: Fits, of: Callable[[int], FittedMove | None], begin: Point, best: FittedMove
) -> FittedMove:
    """The move, but to where a controller takes the planned times of it and of the next one."""
    planned, time = float(fits.times[best.end.row]), fits.in_time(begin.row, best.end.row)
    if time != planned:
        found = of(fits.row_at(time))
        if found is not None and (found := fits.followed(found, begin)) is not None:
            return found
    return best._replace(end=best.end._replace(row=fits.row_at(planned)))


def _reach(
    fits: Fits, of: Callable[[int], FittedMove | None], begin: Point, least: int
) -> FittedMove | None:
    """The move that leads farthest, of one kind, and ``least`` rows on at least."""
    good, bad, step, found = begin.row, fits.most(begin.row) + 1, least, None
    while bad - good > 1:
        end = min(good + step, bad - 1)
        if end < begin.row + least:
            break
        if (move := of(end)) is not None:
            good, step, found = end, 2 * step, move
        else:
            bad, step = end, max(1, (end - good) // 2)
    while found is not None and (followed := fits.followed(found, begin)) is None:
        good = begin.row + (good - begin.row) // 2
        found = of(good) if good >= begin.row + least else None
    return None if found is None else followed


def _changing(times: Array, poses: Poses, period: float) -> Mask:
    """Rows (N,) at which the tool changes its speed, or is so slow that moves may have times.

    But for corners, which are points: a move that ends before one would cut it, and leads at one
    speed from the feed before to that behind.
    """
    ways = np.linalg.norm(np.diff(poses.positions[::2], axis=0), axis=1)
    before, behind = (np.insert(ways / np.diff(times), end, 0.0) for end in (0, len(ways)))
    most = np.maximum(before, behind)
    changing: Mask = (np.abs(behind - before) > PACE * most) | (most * period < _SLOW)
    changing[1:-1] &= turns_of(poses.positions[::2]) < CORNER
    return changing


def _on_joint_moves(rows: TimedPath, path_task: PathTask) -> Mask:
    """Rows that a joint move of the task leads to: those after a waypoint, up to the next, (N,)."""
    found = np.zeros(len(rows.q), dtype=bool)
    if path_task.joint_moves:
        at = times_at_waypoints(path_task, rows.motion, path_task.tolerances)
        times = rows.motion.times
        for k in path_task.joint_moves:
            found |= (times > at[k - 1] + 1e-9) & (times <= at[k] + 1e-9)
    return found


def _two_angles(R: Array, share: Array, axis: Array) -> Array:
    """Rotations (K, 3, 3) at shares (K,) from R[0] to R[1].

    An axis of the tool (3,) swings, and the tool turns about it, each in proportion.
    """
    swing = geodesic(R[0] @ axis, R[1] @ axis)
    twist = rotation_vector(R[0].T @ rotation_matrix(-swing) @ R[1])
    before = rotation_matrix(share[:, None] * swing)
    after = rotation_matrix(share[:, None] * twist)
    turned: Array = before @ R[0] @ after
    return turned
