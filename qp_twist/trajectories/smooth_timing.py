"""Cubics from rest to rest: rows where ramps end and beside corners, or else stops there."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Indices
from qp_twist.following import Trajectory
from qp_twist.paths import in_joint_moves
from qp_twist.referee import JointMotion, Known, MotionLimits, PathErrors, path_errors
from qp_twist.trajectories.refine_trajectory import (
    divided_times,
    shared_pieces,
    with_rows_between,
)
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
_ROUNDING = 1e-11
"""Difference of times that is rounding, as a share."""
_GENTLE = 0.7
"""Share of the acceleration limits below which a ramp is longer than necessary."""


def smooth_timing(
    trajectory: Trajectory, limits: MotionLimits, floor: Array, tolerances: tuple[float, float]
) -> tuple[Trajectory, SpeedProfile, PathErrors]:
    """The timing of a path by cubics, which keep it within the tolerances.

    Args:
        trajectory: The path, with N rows.
        limits: Of its joints.
        floor: Least time of each piece, s, (N − 1,), above 0.
        tolerances: Largest position error, m, and axis error, rad, between rows; where linear
            interpolation does not keep them, cubics need not.

    Returns:
        The trajectory with further rows, its timing, and its errors.
    """
    timing = _Timing(trajectory, limits, floor, tolerances)
    for left in reversed(range(_ROUNDS)):
        profile, errors = timing.computed()
        leaves = timing.leaves(errors)
        if left and leaves.any():
            timing.round_corners(errors, np.flatnonzero(leaves))
        elif not (left and timing.shorten_ramps(profile)):
            break
    return timing.trajectory, profile, errors


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
        self,
        trajectory: Trajectory,
        limits: MotionLimits,
        floor: Array,
        tolerances: tuple[float, float],
    ) -> None:
        self.trajectory, self.limits, self.floor = trajectory, limits, floor
        self.tolerances = tolerances
        q = trajectory.q
        straight = straight_profile(q, floor, limits.velocity).motion
        errors = path_errors(trajectory.path_task, straight, tolerances=tolerances)
        self.may_help: npt.NDArray[np.bool_] = errors.kept(*tolerances)
        self.whole = np.zeros(len(q) - 1, dtype=bool)
        self.rests = np.zeros(len(q), dtype=bool)
        self.rests[[0, -1]] = True
        # A joint move is from rest to rest: the path, which it leaves, ends in a corner.
        moves = in_joint_moves(trajectory.path_task, len(q))
        self.rests[1:-1] |= moves[1:] != moves[:-1]
        #: The last timing and its errors, and the number there of each piece, −1 where divided.
        self._last: tuple[JointMotion, PathErrors] | None = None
        self._which: Indices = np.arange(len(q) - 1)

    def computed(self) -> tuple[SpeedProfile, PathErrors]:
        """The fastest timing with these rows and stops, and its errors."""
        limits, q = self.limits, self.trajectory.q
        task = self.trajectory.path_task
        # Between feeds the parameter is the way, not the time, since its direction is continuous;
        # the lower feed is a bound of the pace.
        steps = np.linalg.norm(np.diff(task.positions[: len(q)], axis=0), axis=1)
        steps[in_joint_moves(task, len(q))] = 0.0  # their parameter is the time at full speed
        ratios = _feed_ratios(steps, self.floor)
        most = np.minimum(np.append(ratios, 1.0), np.append(1.0, ratios))
        at_highest = ratios * self.floor
        profile = speed_profile(
            q, at_highest, limits.velocity, limits.acceleration, self.rests, most
        )
        known = None
        if self._last is not None:
            motion, errors = self._last
            known = Known(errors, _alike(profile.motion, motion, self._which))
        errors = path_errors(task, profile.motion, tolerances=self.tolerances, known=known)
        self._last, self._which = (profile.motion, errors), np.arange(len(q) - 1)
        return profile, errors

    def leaves(self, errors: PathErrors) -> npt.NDArray[np.bool_]:
        """Pieces on which a smooth motion leaves the path, and need not, (N − 1,)."""
        resting = self.rests[:-1] & self.rests[1:]
        return np.asarray(self.may_help & ~errors.kept(*self.tolerances) & ~resting)

    def round_corners(self, errors: PathErrors, pieces: Indices) -> None:
        """A row on each side of the sharper turn of these pieces, or a stop at it."""
        rests = self.rests
        turn = self._turns()
        at_begin = rests[pieces + 1] | (~rests[pieces] & (turn[pieces] >= turn[pieces + 1]))
        near = _ROOM * self.floor[pieces] * _room(errors, pieces, self.tolerances)
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
        self._which = shared_pieces(self._which, divided)

    def _turns(self) -> Array:
        """Change of the joints' velocities at each row, at the feed, (N,)."""
        D = np.diff(self.trajectory.q, axis=0) / self.floor[:, None]
        return np.concatenate([[0.0], np.linalg.norm(np.diff(D, axis=0), axis=1), [0.0]])

    def _around(self, corners: Indices, near: Array) -> tuple[Indices, Array]:
        """Where rows are inserted around corners: pieces, ascending, and shares of them.

        Args:
            corners: Rows; a corner may be named by both of its pieces.
            near: Distance of the inserted rows from each of them, s at the feed.
        """
        floor = self.floor
        closest: dict[int, float] = {}
        for corner, distance in zip(corners.tolist(), near.tolist(), strict=True):
            closest[corner] = min(distance, closest.get(corner, np.inf))
        found: dict[int, float] = {}
        for corner, distance in closest.items():
            for piece, share in (
                (corner - 1, 1.0 - distance / floor[corner - 1]),
                (corner, distance / floor[corner]),
            ):
                # A piece between two corners is halved; one that is short already stays.
                if 0.0 < share < 1.0:
                    found[piece] = 0.5 if piece in found else share
        pieces = sorted(found)
        return np.array(pieces, dtype=np.int64), np.array([found[piece] for piece in pieces])


def _alike(motion: JointMotion, other: JointMotion, which: Indices) -> Indices:
    """Those of the pieces ``which`` (N − 1,) of another motion that are the same here, else −1."""
    assert motion.velocities is not None and other.velocities is not None
    same = which >= 0
    for part, before in ((motion.q, other.q), (motion.velocities, other.velocities)):
        for end in (0, 1):
            here = part[end : len(part) - 1 + end]
            same &= (here == before[np.maximum(which, 0) + end]).all(axis=1)
    took, then = np.diff(motion.times), np.diff(other.times)[np.maximum(which, 0)]
    same &= np.abs(took - then) <= _ROUNDING * took
    alike: Indices = np.where(same, which, -1)
    return alike


def _feed_ratios(steps: Array, floor: Array) -> Array:
    """The feed of each piece as a share of the highest one, (N − 1,).

    Speeds of neighbours that differ by less than a tenth count as one feed.

    Args:
        steps: Distance of the frame's targets at the ends of each piece, m, (N − 1,).
        floor: Time of each piece at the feed, s, (N − 1,).
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


def _room(errors: PathErrors, pieces: Indices, tolerances: tuple[float, float]) -> Array:
    """Share of its length by which a piece has to shrink so that its errors fit, at most ½, (K,).

    The deviation of a cubic from its chord is proportional to the length if the directions at its
    ends stay the same. What the two tolerances do not measure is halved.
    """
    room = np.full(len(pieces), 0.5)
    for between, tolerance in zip(
        (errors.position_between, errors.axis_between), tolerances, strict=True
    ):
        room = np.minimum(room, tolerance / np.maximum(between[pieces], tolerance))
    return room
