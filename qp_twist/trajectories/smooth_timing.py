"""Cubics from rest to rest: rows where ramps end and beside corners, or else stops there."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.following import Trajectory
from qp_twist.referee import JointMotion, MotionLimits, Tolerances, sampled_errors
from qp_twist.trajectories.refine_trajectory import divided_times, with_rows_between
from qp_twist.trajectories.speed_profile import SpeedProfile, speed_profile, straight_profile

_ROUNDS = 30
_ROOM = 0.5
"""Share of the tolerances that is left to a rounded corner."""
_SHORTEST = 1e-3
"""Least distance of an inserted row from its neighbours, s at the feed."""
_LOST = 0.01
"""Time from which a ramp that is longer than necessary gets a row, s."""
_SAME_FEED = 1.1
"""Ratio up to which feeds count as equal: pieces that turn the tool vary a little in speed."""
_SEEN = 0.98
"""Share of the largest deviation of a smooth motion from its chord that is seen at least at eight
points between two rows: of a parabola, at a place 1/18 beside its top, 0.988."""
_GENTLE = 0.7
"""Share of the acceleration limits below which a ramp is longer than necessary."""


def smooth_timing(
    trajectory: Trajectory, limits: MotionLimits, floor: Array, tolerances: Tolerances
) -> tuple[Trajectory, SpeedProfile]:
    """The timing of a path by cubics, which keep it within the tolerances.

    Where linear interpolation does not keep the ``tolerances`` of the task errors between rows,
    cubics need not. ``floor`` (N − 1,) has the least time of each piece, s, above 0.

    Returns:
        The trajectory with further rows, and its timing.
    """
    timing = _Timing(trajectory, limits, floor, tolerances)
    for left in reversed(range(_ROUNDS)):
        profile = timing.computed()
        if not left:
            break
        use = timing.use(profile.motion)
        leaves = timing.may_help & (use > 1.0) & ~(timing.rests[:-1] & timing.rests[1:])
        if leaves.any():
            timing.round_corners(use, np.flatnonzero(leaves))
        elif not timing.shorten_ramps(profile):
            break
    return timing.trajectory, profile


class _Timing:
    """A path whose rows and stops are still being chosen.

    Attributes:
        trajectory: The path so far.
        floor: Least time of each piece, s, (N − 1,).
        rests: Rows at which the joints stand still, (N,).
        may_help: Pieces that linear interpolation keeps within the tolerances, (N − 1,).
        whole: Pieces that cannot be divided, (N − 1,).
    """

    def __init__(
        self, trajectory: Trajectory, limits: MotionLimits, floor: Array, tolerances: Tolerances
    ) -> None:
        self.trajectory, self.limits, self.floor = trajectory, limits, floor
        self.tolerances = tolerances
        q = trajectory.q
        straight = straight_profile(q, floor, limits.velocity).motion
        self.may_help: Mask = self.use(straight) <= 1.0
        self.whole = np.zeros(len(q) - 1, dtype=bool)
        # A joint move is from rest to rest: the path, which it leaves, ends in a corner.
        moves = trajectory.path.moves
        self.rests = np.concatenate([[True], moves[1:] != moves[:-1], [True]])

    def use(self, motion: JointMotion) -> Array:
        """Largest error in each piece as a share of its tolerance, of the hard bands', too."""
        trajectory = self.trajectory
        errors, units = sampled_errors(trajectory.path_task, motion, trajectory.s)
        shares = errors[:, 1:-1].max(axis=1) / (_SEEN * self.tolerances.of(units))
        largest: Array = shares.max(axis=1)
        return largest

    def computed(self) -> SpeedProfile:
        """The fastest timing with these rows and stops."""
        limits, q, path = self.limits, self.trajectory.q, self.trajectory.path
        # Between feeds the parameter is the way, not the time, since its direction is continuous;
        # the lower feed is a bound of the pace.
        steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
        steps[path.moves] = 0.0  # their parameter is the time at full speed
        feed = self.trajectory.feed  # a plan may be slower
        ratios = _feed_ratios(
            steps, self.floor if feed is None else np.where(feed > 0.0, feed, self.floor)
        )
        most = np.minimum(np.append(ratios, 1.0), np.append(1.0, ratios))
        at_highest = ratios * self.floor
        return speed_profile(q, at_highest, limits.velocity, limits.acceleration, self.rests, most)

    def round_corners(self, use: Array, pieces: Indices) -> None:
        """A row on each side of the sharper turn of these pieces, or a stop at it.

        The deviation of a cubic from its chord is proportional to the length if the directions at
        its ends stay the same; half of it is left to what is not.
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

    def shorten_ramps(self, profile: SpeedProfile) -> bool:
        """Rows where ramps can end that take longer than necessary; whether there were any.

        A piece whose accelerations use the share u of their limits would keep them, too, if its
        pace changed within the share u of its length.
        """
        begin, end = profile.pace[:-1], profile.pace[1:]
        fast = np.maximum(begin, end)
        moving = fast > 0.0
        T = np.diff(profile.motion.times)
        # Beside the time that the piece takes at the pace of its faster end, or at the feed.
        lost = T - self.floor
        lost[moving] = (T * (1.0 - 0.5 * (begin + end) / np.where(moving, fast, 1.0)))[moving]
        use = profile.acceleration_use.max(axis=1, initial=0.0)
        share = np.where(moving, np.minimum(use, 0.5), 0.5)
        share = np.maximum(share, _SHORTEST / self.floor)
        long = (lost > _LOST) & (use < _GENTLE) & (share <= 0.5) & ~self.whole
        pieces = np.flatnonzero(long)
        if not len(pieces):
            return False
        self.insert(pieces, np.where(begin < end, share, 1.0 - share)[pieces])
        return True

    def insert(self, pieces: Indices, shares: Array) -> None:
        """A row in each of these pieces, at these shares of them."""
        self.trajectory, divided = with_rows_between(self.trajectory, pieces, shares)
        self.whole[np.setdiff1d(pieces, divided)] = True
        shares = shares[np.isin(pieces, divided)]
        after = divided + 1
        self.rests = np.insert(self.rests, after, False)
        self.may_help = np.insert(self.may_help, after, self.may_help[divided])
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
