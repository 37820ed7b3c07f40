"""Time a joint trajectory: as fast as the feed, within the limits."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, instance
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.referee import MotionLimits
from qp_twist.trajectories.metadata import metadata_of
from qp_twist.trajectories.smooth_timing import smooth_timing
from qp_twist.trajectories.speed_profile import SpeedProfile, straight_profile
from qp_twist.trajectories.timed_path import Slowed, TimedPath

_SLOWED = 0.02
"""A piece counts as slowed if it takes longer than the feed by more than this share, as the tool is
at speed from 98 % on. Up to 1 % are lost where the curve is longer than the chords (dome_seams)."""
_TIGHT = 0.99
"""A limit counts as active if this share of it is used."""


def time_trajectory(
    trajectory: Trajectory,
    *,
    limits: MotionLimits | None = None,
    position_tolerance: float | None = None,
    axis_tolerance_deg: float | None = None,
    curved: bool = False,
) -> TimedPath:
    r"""Time a joint path: at the feed, or slower where a limit requires it.

    All waypoints are passed. Each piece from a row to the next takes at least the time at the
    feed. Without limits of acceleration and jerk every joint moves at constant speed from row to
    row, in :math:`\max(\text{feed},\, \max_j |\Delta q_j|/v_j)`. With them the joints move from
    rest to rest on a smooth curve through the rows
    (:class:`~qp_twist.trajectories.JointCurve`), in the least time
    (:func:`~qp_twist.trajectories.speed_profile`). With jerk limits accelerations are continuous,
    and the result has them; without, velocities are. Further rows are where the motion needs them.

    A smooth curve cuts corners. Where it would leave the path by more than the tolerances, but
    linear interpolation of the joints would not, a row is inserted on each side of the waypoint
    with the sharper turn, so near that the tolerances are kept. Where these rows would be less than
    1.5 ms away at the feed, the joints stop. Where the curve would bulge out of a joint's range,
    because the path lies on the end of it, the free motion moves rows inwards, on the path.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`, preferably with ``slow_down=True``.
        limits: Speeds, accelerations and jerks of the joints; ``None``: the task's own. Those of a
            known robot are ``motion_limits(task)``; ``with_default_accelerations`` and
            ``with_default_jerks`` complete them.
        position_tolerance: Largest linear task error between waypoints, m; ``None``: that of a
            check.
        axis_tolerance_deg: Largest angular task error there, degrees; ``None``: likewise.
        curved: Whether the rows are meant for a smooth curve, which then keeps the tolerances
            between all rows, also where linear interpolation does not.

    Raises:
        InvalidInput: If neither the feed nor a limit determines the duration of a piece, or a joint
            is neither hinge nor slide.
    """
    instance("time_trajectory(trajectory)", trajectory, Trajectory)
    tolerances = trajectory.path_task.tolerances.stated(position_tolerance, axis_tolerance_deg)
    task = trajectory.path_task
    ranges = JointRanges.of(task.model)
    if not ranges.only_hinges_and_slides:
        raise InvalidInput(
            "time_trajectory: the robot has ball or free joints; only hinges and slides have times."
        )
    q = trajectory.q
    if len(q) < 2:
        raise InvalidInput("time_trajectory: the trajectory has one waypoint only; follow more.")
    if limits is None:
        limits = MotionLimits.of(task)
    instance("time_trajectory(limits)", limits, MotionLimits)
    feed = _feed(trajectory)
    moved = np.abs(np.diff(q, axis=0))
    by_limits = np.maximum(moved / limits.velocity, np.sqrt(6.0 * moved / limits.acceleration))
    least = feed if trajectory.least_times is None else trajectory.least_times
    floor = np.where(least > 0.0, least, by_limits.max(axis=1, initial=0.0))
    if (floor <= 0.0).any():
        k = int(np.argmax(floor <= 0.0))
        raise InvalidInput(
            f"time_trajectory: nothing says how long the way from waypoint {k + 1} to {k + 2} "
            "takes; add [feed] to the task file, and [limits]."
        )
    if np.isfinite([limits.acceleration, limits.jerk]).any():
        trajectory, profile = smooth_timing(trajectory, limits, floor, tolerances, curved=curved)
        feed = _feed(trajectory)
    else:
        profile = straight_profile(q, floor, limits.velocity)
    slowed = _slowed(profile, np.where(trajectory.path.moves, 0.0, feed), ranges.names)
    motion, rows = profile.motion, profile.rows
    return TimedPath(
        ranges.names, motion.q, motion.times, motion.velocities,
        metadata_of(trajectory, motion, limits, rows), motion.accelerations,
        trajectory=trajectory, path_rows=rows, limits=limits, slowed=slowed,
        stops=tuple(rows[profile.rests][1:-1].tolist()),
    )  # fmt: skip


def _feed(trajectory: Trajectory) -> Array:
    """Least time of each piece at the feed, s, (N − 1,); 0 without one."""
    return np.zeros(len(trajectory.q) - 1) if trajectory.feed is None else trajectory.feed


def _slowed(profile: SpeedProfile, feed: Array, names: tuple[str, ...]) -> tuple[Slowed, ...]:
    """The sections of the path's pieces that take longer than the feed (N − 1,), s."""
    rows = profile.rows
    T = np.diff(profile.motion.times[rows])
    slow = np.flatnonzero((feed > 0.0) & (T / np.where(feed > 0.0, feed, 1.0) > 1.0 + _SLOWED))
    found = []
    for pieces in np.split(slow, np.flatnonzero(np.diff(slow) > 1) + 1) if len(slow) else ():
        first, last = int(rows[pieces[0]]), int(rows[pieces[-1] + 1])
        count = {
            f"{kind} of {name}": int(tight)
            for kind, use in profile.uses.items()
            for name, tight in zip(names, (use[first:last] >= _TIGHT).sum(axis=0), strict=True)
            if tight
        }
        rests = rows[profile.rests]
        found.append(
            Slowed(
                first,
                last,
                float((T[pieces] / feed[pieces]).max()),
                float((T[pieces] - feed[pieces]).sum()),
                tuple(sorted(count, key=lambda name: -count[name])),
                tuple(rests[(rests >= first) & (rests <= last)].tolist()),
            )
        )
    return tuple(found)
