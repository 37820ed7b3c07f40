"""A smooth curve through a joint path: rows beside corners, or else stops there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import (
    SAMPLES,
    JointMotion,
    MotionLimits,
    Tolerances,
    errors_at,
    feed_shares,
    programmed_rates,
)
from qp_twist.trajectories.joint_curve import JointCurve
from qp_twist.trajectories.refine_trajectory import divided_times, with_rows_between
from qp_twist.trajectories.speed_profile import (
    SpeedProfile,
    speed_profile,
)

_ROUNDS = 30
_ROOM = 0.75
"""Share of the tolerances that a rounded corner is meant to use."""
_INWARDS = 1.5
"""Times what a curve bulges out of a joint's range by which its rows are moved inwards: the curve
between rows moves by less than they, and their neighbours follow."""
_BEYOND = 0.25 * Tolerances().joint_range
"""What a curve may bulge out of a range, rad or m; rows left out in timing may add half of what a
check lets pass."""
_SHORTEST = 1.5e-3
"""Least distance of an inserted row from its neighbours, s at the feed. Nearer, stops are faster
(deburring at 1 m/s, 1 mm beside its corners: 2.35 s, rounded 2.56)."""
_SAME_FEED = 1.1
"""Ratio up to which feeds count as equal: pieces that turn the tool vary a little in speed."""
_SEEN = 0.98
"""Share of the largest deviation of a smooth motion from its chord that is seen at least at eight
points of a cubic: of a parabola, at a place 1/18 beside its top, 0.988."""


def smooth_timing(
    trajectory: Trajectory,
    limits: MotionLimits,
    floor: Array,
    tolerances: Tolerances,
    *,
    curved: bool = False,
) -> tuple[Trajectory, SpeedProfile]:
    """The timing of a path on a smooth curve, which keeps it within the tolerances.

    Where linear interpolation does not keep the ``tolerances`` of the task errors between rows,
    the curve need not, unless the rows are ``curved``. ``floor`` (N − 1,) has the least time of
    each piece, s, above 0. Joint moves, and pieces without a feed, are as fast as the limits
    permit.

    Returns:
        The trajectory with further rows, and its timing.
    """
    timing = _Timing(trajectory, floor, tolerances, curved=curved)
    rounds = 0
    while True:
        use = timing.use()
        leaves = (use > 1.0) & ~(timing.rests[:-1] & timing.rests[1:])
        if not leaves.any():
            return timing.trajectory, timing.profile(limits)
        pieces = np.flatnonzero(leaves)
        if rounds < _ROUNDS:
            pieces = np.setdiff1d(pieces, timing.moved_inwards())
            timing.round_corners(use, pieces)
        else:
            timing.rests[pieces] = timing.rests[pieces + 1] = True
        rounds += 1


class _Timing:
    """A path whose rows and stops are still being chosen.

    Attributes:
        trajectory: The path so far.
        floor: Least time of each piece, s, (N − 1,).
        rests: Rows at which the joints stand still, (N,).
        may_help: Errors that linear interpolation keeps within the tolerances, (N − 1, B), and the
            joint ranges; of ``curved`` rows all.
        whole: Pieces that cannot be divided, (N − 1,).
    """

    def __init__(
        self, trajectory: Trajectory, floor: Array, tolerances: Tolerances, *, curved: bool
    ) -> None:
        self.trajectory, self.floor, self.tolerances = trajectory, floor, tolerances
        self.ranges = JointRanges.of(trajectory.path_task.model)
        rows = np.arange(len(trajectory.q))
        straight = JointMotion(rows.astype(np.float64), trajectory.q)
        self.may_help: Mask = self._used(straight, rows, slice(None)) <= 1.0
        self.may_help |= curved
        self.whole = np.zeros(len(rows) - 1, dtype=bool)
        # A joint move is from rest to rest: the path, which it leaves, ends in a corner.
        moves = trajectory.path.moves
        self.rests = np.concatenate([[True], moves[1:] != moves[:-1], [True]])

    def use(self) -> Array:
        """Largest error in each piece as a share of its tolerance, (N − 1,), of hard bands, too."""
        found = [self._used(curve.motion, curve.rows, part) for part, curve in self._curves()]
        largest: Array = np.where(self.may_help, np.concatenate(found), 0.0).max(axis=1)
        return largest

    def _curves(self) -> Iterator[tuple[slice, JointCurve]]:
        """From rest to rest: the rows, and the curve through them."""
        x = np.concatenate([[0.0], np.cumsum(self._ratios() * self.floor)])
        for first, last in pairwise(np.flatnonzero(self.rests).tolist()):
            part = slice(first, last + 1)
            yield part, JointCurve.through(x[part], self.trajectory.q[part])

    def _beyond(self, motion: JointMotion, rows: Indices) -> Array:
        """How far each piece of a motion bulges out of the ranges, rad or m, (N − 1, nv)."""
        room = np.minimum(*(self.ranges.room(q) for q in motion.extremes()))
        found = np.zeros((len(rows) - 1, room.shape[1]))
        np.maximum.at(found, np.repeat(np.arange(len(found)), np.diff(rows)), -room)
        return found

    def moved_inwards(self) -> Indices:
        """Move rows inwards where the curve bulges out of a joint's range, on the path.

        A plan may lie on the end of a range. The free motion gives way where there is one. Rests
        stay: the curve is straight there.

        Returns:
            The pieces beside rows that have moved.
        """
        trajectory = self.trajectory
        parts = [self._beyond(curve.motion, curve.rows) for _, curve in self._curves()]
        beyond = np.pad(self.may_help[:, -1:] * np.concatenate(parts), ((1, 1), (0, 0)))
        beyond = np.maximum(beyond[:-1], beyond[1:])
        moved = (beyond > _BEYOND).any(axis=1) & ~self.rests & trajectory.path.on_path
        at = np.flatnonzero(moved)
        q, ranges = trajectory.q.copy(), self.ranges
        # Joints move away from both ends, up to the middle; others stay where they are outside.
        room, half = ranges.room(q[at]), 0.5 * (ranges.upper - ranges.lower)
        inwards = np.minimum(np.maximum(room, 0.0) + _INWARDS * beyond[at], half)
        inset = np.where(beyond[at] > 0.0, inwards, np.minimum(room, 0.0))
        box = ranges.lower + inset, ranges.upper - inset
        path = PathRows(trajectory.path_task, trajectory.s[at])
        rows, found = path.correct_within(q[at], np.arange(len(at)), *box)
        at = at[found]
        q[at] = rows[found]
        self.trajectory = replace(trajectory, q=q)
        return np.concatenate([at - 1, at])

    def _used(self, motion: JointMotion, rows: Indices, part: slice) -> Array:
        """Each of the errors of a motion through a part of the path, ``rows`` of it, (N − 1, B)."""
        trajectory, times = self.trajectory, motion.times
        samples = np.linspace(times[:-1], times[1:], SAMPLES + 2, axis=1)[:, 1:-1].ravel()
        piece = np.searchsorted(times[rows], samples, side="right") - 1
        of = trajectory.path_task, motion, times[rows], trajectory.s[part]
        errors, units = errors_at(*of, piece, samples)
        largest = np.zeros((len(rows) - 1, len(units)))
        np.maximum.at(largest, piece, errors / (_SEEN * self.tolerances.of(units)))
        beyond = self._beyond(motion, rows).max(axis=1, keepdims=True, initial=0.0)
        return np.hstack([largest, beyond / _BEYOND])

    def _ratios(self) -> Array:
        """Length of each piece in the parameter of the curve, in its time at the feed, (N − 1,).

        Between feeds the parameter is the way, not the time, since its direction is continuous.
        """
        path = self.trajectory.path
        steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
        steps[path.moves] = 0.0  # their parameter is the time at full speed
        if self.trajectory.path_task.durations is not None:  # or where the tool turns in place
            steps[programmed_rates(self.trajectory.path_task)[0][self._waypoints - 1] == 0.0] = 0.0
        feed, floor = self.trajectory.feed, self.floor  # a plan may be slower
        return _feed_ratios(steps, floor if feed is None else np.where(feed > 0.0, feed, floor))

    def profile(self, limits: MotionLimits) -> SpeedProfile:
        """The fastest timing with these rows and stops."""
        trajectory, ratios = self.trajectory, self._ratios()
        feed = trajectory.feed
        free = trajectory.path.moves if feed is None else trajectory.path.moves | (feed <= 0.0)
        moved = np.diff(trajectory.q, axis=0) != 0.0
        known = np.isfinite(limits.velocity) | np.isfinite(limits.acceleration)
        most = np.where(free & ~(moved & ~known).any(axis=1), np.inf, ratios)
        length = ratios * self.floor
        bounds = limits.velocity, limits.acceleration
        of = trajectory.q, length, *bounds, self.rests, most, limits.jerk
        return speed_profile(*of, None if feed is None else self._shares)

    def _shares(self, q: Array, rates: Array, piece: Indices) -> Array:
        """The tool's share of its programmed speed, of joint velocities (K, nv) on pieces (K,)."""
        return feed_shares(self.trajectory.path_task, q, rates, self._waypoints[piece])

    @property
    def _waypoints(self) -> Indices:
        """The waypoint, from 0, that each piece leads to, (N − 1,)."""
        return np.ceil(self.trajectory.s[1:]).astype(np.intp)

    def round_corners(self, use: Array, pieces: Indices) -> None:
        """A row on each side of the sharper turn of these pieces, or a stop at it.

        The deviation of a cubic from its chord is proportional to the length if the directions at
        its ends stay the same; a part of it is left to what is not.
        """
        rests = self.rests
        D = np.diff(self.trajectory.q, axis=0) / self.floor[:, None]  # velocities at the feed
        turn = np.pad(np.linalg.norm(np.diff(D, axis=0), axis=1), 1)
        at_begin = rests[pieces + 1] | (~rests[pieces] & (turn[pieces] >= turn[pieces + 1]))
        near = _ROOM * self.floor[pieces] * np.minimum(0.5, 1.0 / use[pieces])
        corners = np.where(at_begin, pieces, pieces + 1)
        hopeless = (near < _SHORTEST) | rests[corners]
        rests[corners[hopeless]] = True
        cut, shares = self._around(corners[~hopeless], near[~hopeless])
        self.insert(cut[~self.whole[cut]], shares[~self.whole[cut]])
        # Where no row can be put, the next round stops at both ends.
        self.rests[np.flatnonzero(self.whole)] = True
        self.rests[np.flatnonzero(self.whole) + 1] = True

    def insert(self, pieces: Indices, shares: Array) -> None:
        """A row in each of these pieces, at these shares of them."""
        self.trajectory, divided = with_rows_between(self.trajectory, pieces, shares)
        self.whole[np.setdiff1d(pieces, divided)] = True
        shares = shares[np.isin(pieces, divided)]
        after = divided + 1
        self.rests = np.insert(self.rests, after, False)
        self.may_help = np.insert(self.may_help, after, self.may_help[divided], axis=0)
        self.whole = np.insert(self.whole, after, False)
        self.floor = divided_times(self.floor, divided, shares)

    def _around(self, corners: Indices, near: Array) -> tuple[Indices, Array]:
        """Where rows are inserted around corners: pieces, ascending, and shares of them.

        A corner may be named by both of its pieces; ``near`` is the distance of the inserted rows
        from each of them, s at the feed.
        """
        closest = np.full(len(self.rests), np.inf)
        np.minimum.at(closest, corners, near)
        at_end, at_begin = closest[1:] / self.floor, closest[:-1] / self.floor
        # A piece between two corners is halved; one that is short already stays.
        ends, begins = at_end < 1.0, at_begin < 1.0
        shares = np.where(ends & begins, 0.5, np.where(ends, 1.0 - at_end, at_begin))
        pieces = np.flatnonzero(ends | begins)
        return pieces, shares[pieces]


def _feed_ratios(steps: Array, floor: Array) -> Array:
    """The feed of each piece as a share of the highest one, (N − 1,).

    Speeds of neighbours that differ by less than a tenth count as one feed. ``steps`` (N − 1,) are
    the distances of the frame's targets, m, ``floor`` (N − 1,) the times at the feed, s.
    """
    ratios, last = np.ones(len(steps)), 0.0
    for k, speed in enumerate(steps / floor):
        if k:
            ratios[k] = ratios[k - 1]
        if speed > 0.0:  # not where the tool turns in place
            if last and not 1.0 / _SAME_FEED <= speed / last <= _SAME_FEED:
                ratios[k] *= speed / last
            last = speed
    shares: Array = ratios / ratios.max(initial=0.0)
    return shares
