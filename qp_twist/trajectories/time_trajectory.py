"""Time a joint trajectory: as fast as the feed, within the limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, instance
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.notebook import html_table
from qp_twist.referee import (
    JointMotion,
    MotionLimits,
    PathErrors,
    State,
    Tolerances,
    path_errors,
)
from qp_twist.trajectories.smooth_timing import smooth_timing
from qp_twist.trajectories.speed_profile import SpeedProfile, straight_profile

_SLOWED = 1e-6
"""A piece counts as slowed if it takes longer than the feed by more than this share."""
_TIGHT = 0.99
"""A limit counts as active if this share of it is used."""


@dataclass(frozen=True)
class Slowed:
    """A section of the path that is slower than the feed because of limits.

    Attributes:
        first: Index of its first waypoint, from 0.
        last: Index of its last waypoint.
        factor: Largest ratio of a piece's duration to that of the feed.
        longer: Additional time of the section, s.
        limits: The active limits, e.g. ``"velocity of joint_4"``, the most frequent first.
        stops: Indices of its waypoints at which the joints rest, from 0.
    """

    first: int
    last: int
    factor: float
    longer: float
    limits: tuple[str, ...]
    stops: tuple[int, ...]

    def __str__(self) -> str:
        """A line of text, rows counted from 1."""
        why = [", ".join(self.limits)] if self.limits else []
        if self.stops:
            word = "row" if len(self.stops) == 1 else "rows"
            why.append(f"at rest at {word} {', '.join(str(k + 1) for k in self.stops)}")
        return (
            f"rows {self.first + 1} to {self.last + 1}: up to {self.factor:.3g} times as "
            f"long, {self.longer:.3g} s in all ({'; '.join(why) or 'acceleration'})"
        )


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """Result of :func:`~qp_twist.time_trajectory`: a trajectory with its times.

    Attributes:
        trajectory: The joint path, with further rows at ramps and beside rounded corners.
        limits: The limits that it keeps.
        motion: Times, positions and velocities at the waypoints and the interpolation between them.
        slowed: Sections slower than the feed, in the order of the path.
        stops: Indices of the intermediate waypoints at which the joints rest.
        tolerances: Of the errors, for which it was made.
    """

    trajectory: Trajectory
    limits: MotionLimits
    motion: JointMotion
    slowed: tuple[Slowed, ...]
    stops: tuple[int, ...]
    tolerances: Tolerances

    @cached_property
    def errors(self) -> PathErrors:
        """Task errors at the rows, and proven between them."""
        rows, tolerances = self.trajectory, (self.tolerances.position, self.tolerances.axis)
        return path_errors(rows.path_task, self.motion, s=rows.s, tolerances=tolerances)

    @property
    def times(self) -> Array:
        """Time at each waypoint, s, (N,), the first at 0."""
        return self.motion.times

    @property
    def q(self) -> Array:
        """Joint positions at the waypoints, rad or m, (N, nv)."""
        return self.motion.q

    @property
    def velocities(self) -> Array:
        """q̇ at the waypoints, rad/s or m/s, (N, nv); where it jumps, after the waypoint."""
        given = self.motion.velocities
        return self.motion.at(self.times).velocities if given is None else given

    @property
    def accelerations(self) -> Array:
        """q̈ at the waypoints, rad/s² or m/s², (N, nv); where it jumps, after the waypoint."""
        return self.motion.at(self.times).accelerations

    @property
    def durations(self) -> Array:
        """Time from each waypoint to the next, s, (N − 1,)."""
        return np.diff(self.times)

    def at(self, t: npt.ArrayLike) -> State:
        """q, q̇ and q̈ at a time or at many, s: (nv,) or (K, nv) each."""
        return self.motion.at(t)

    def __repr__(self) -> str:
        task = self.trajectory.path_task.name
        return (
            f"TimedTrajectory({task!r}, {self.trajectory.method!r}, {self.times[-1]:.6g} s, "
            f"{len(self.slowed)} stretches slowed, {len(self.stops)} stops)"
        )

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        between = self.errors.position_between.max(initial=0.0)
        rows: list[tuple[str, object]] = [
            ("waypoints", len(self.q)),
            ("time, s", float(self.times[-1])),
            ("stretches slower than the feed", len(self.slowed)),
            ("stops between the ends", len(self.stops)),
            ("position error at waypoints, mm", 1e3 * float(self.errors.position.max())),
            ("position error between them, mm", 1e3 * float(between)),
        ]
        caption = f"{self.trajectory.method} along {self.trajectory.path_task.name}, timed"
        return html_table(caption, rows)


def time_trajectory(
    trajectory: Trajectory,
    *,
    limits: MotionLimits | None = None,
    position_tolerance: float | None = None,
    axis_tolerance_deg: float | None = None,
) -> TimedTrajectory:
    r"""Time a joint path: at the feed, or slower where a limit requires it.

    The waypoints do not change. Each piece from a waypoint to the next takes at least the duration
    of the task's feed (``path_task.durations``), and

    * without acceleration limits every joint moves at constant speed from waypoint to waypoint, the
      piece takes :math:`\max(\text{feed},\, \max_j |\Delta q_j|/v_j)`;
    * with acceleration limits every joint moves on a cubic in time
      (:class:`~qp_twist.trajectories.JointMotion`), from rest to rest, its velocity continuous;
      ``speed_profile`` computes the fastest motion that keeps velocity and acceleration limits
      everywhere, not only at the waypoints.

    The pace changes at rows only. Where rows are so far apart that a ramp would take longer than
    its acceleration needs, another is inserted where it can end.

    A smooth motion cuts corners. Where it would leave the path between two waypoints by more than
    the tolerances, but linear interpolation of the joints would not, a row is inserted on each side
    of the waypoint with the sharper turn, so near that the tolerances are kept; the joints pass
    the waypoint as fast as their accelerations permit. Where these rows would be less than a
    millisecond away at the feed, the joints stop.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`, preferably with ``slow_down=True``.
        limits: Speeds and accelerations of the joints; ``None``: the task's own. Those of a known
            robot are ``motion_limits(task)``; ``with_default_accelerations`` completes them.
        position_tolerance: Largest linear task error between waypoints, m; ``None``: that of a
            check.
        axis_tolerance_deg: Largest angular task error there, degrees; ``None``: likewise.

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
    feed = trajectory.feed
    if feed is None:
        feed = np.zeros(len(q) - 1)
    if limits is None:
        limits = MotionLimits(task.velocity_limits, task.acceleration_limits)
    instance("time_trajectory(limits)", limits, MotionLimits)
    floor = _least_times(limits, q, feed)
    if np.isfinite(limits.acceleration).any():
        trajectory, profile = smooth_timing(trajectory, limits, floor, tolerances)
        feed = np.zeros(len(profile.pace) - 1) if trajectory.feed is None else trajectory.feed
    else:
        profile = straight_profile(q, floor, limits.velocity)
    slowed = _slowed(profile, np.where(trajectory.path.moves, 0.0, feed), ranges.names)
    stops = tuple(int(k) for k in np.flatnonzero(profile.pace[1:-1] == 0.0) + 1)
    return TimedTrajectory(trajectory, limits, profile.motion, slowed, stops, tolerances)


def _least_times(limits: MotionLimits, q: Array, feed: Array) -> Array:
    """Duration of each piece at the feed, s, (N − 1,); without a feed that of the limits."""
    moved = np.abs(np.diff(q, axis=0))
    by_limits = np.maximum(moved / limits.velocity, np.sqrt(6.0 * moved / limits.acceleration))
    floor = np.where(feed > 0.0, feed, by_limits.max(axis=1, initial=0.0))
    if (floor <= 0.0).any():
        k = int(np.argmax(floor <= 0.0))
        raise InvalidInput(
            f"time_trajectory: nothing says how long the way from waypoint {k + 1} to {k + 2} "
            "takes; add [feed] to the task file, and [limits]."
        )
    return floor


def _slowed(profile: SpeedProfile, feed: Array, names: tuple[str, ...]) -> tuple[Slowed, ...]:
    """The sections of pieces that take longer than the feed."""
    T = np.diff(profile.motion.times)
    slow = np.flatnonzero((feed > 0.0) & (T / np.where(feed > 0.0, feed, 1.0) > 1.0 + _SLOWED))
    found = []
    for pieces in np.split(slow, np.flatnonzero(np.diff(slow) > 1) + 1):
        if not len(pieces):
            continue
        count: dict[str, int] = {}
        for kind, use in (
            ("velocity", profile.speed_use),
            ("acceleration", profile.acceleration_use),
        ):
            for joint, tight in enumerate((use[pieces] >= _TIGHT).sum(axis=0)):
                if tight:
                    count[f"{kind} of {names[joint]}"] = int(tight)
        first, last = int(pieces[0]), int(pieces[-1]) + 1
        found.append(
            Slowed(
                first,
                last,
                float((T[pieces] / feed[pieces]).max()),
                float((T[pieces] - feed[pieces]).sum()),
                tuple(sorted(count, key=lambda name: -count[name])),
                tuple(k for k in range(first, last + 1) if profile.pace[k] == 0.0),
            )
        )
    return tuple(found)
