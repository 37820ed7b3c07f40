"""Where a motion is slower than its feed and what holds it back, and where it does not pass."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.referee import acceleration_use, joint_margins, velocity_use
from qp_twist.trajectories import Check

SLOWER = 0.03
"""Share by which an interval has to take longer than at the feed to count as slower: programs round
their speeds."""
_TIGHT = 0.98
"""A limit holds a motion back where this share of it is used."""
_REST = 1e-6
"""The robot rests where all joints are slower, rad/s or m/s."""
_APART = 0.02
"""Stretches with fewer waypoints between them count as one, as a share of all waypoints."""


def slower_intervals(path_task: PathTask, check: Check) -> Mask:
    """Which intervals between waypoints take longer than at the feed, (N − 1,)."""
    times = check.passing.times
    if path_task.durations is None or not check.passing.timed:
        return np.zeros(len(times) - 1, dtype=bool)
    slow: Mask = np.diff(times) > (1.0 + SLOWER) * path_task.durations[1 : len(times)]
    return slow & ~in_joint_moves(path_task, len(times))


def slower_stretches(path_task: PathTask, check: Check) -> list[str]:
    """A sentence for each stretch that is slower than the feed, the most costly first."""
    slow = np.flatnonzero(slower_intervals(path_task, check))
    if path_task.durations is None or not len(slow):
        return []
    times = check.passing.times
    lost = np.diff(times) - path_task.durations[1 : len(times)]
    apart = max(2, round(_APART * len(times)))
    moved = np.cumsum(in_joint_moves(path_task, len(times)))[slow]
    breaks = np.flatnonzero((np.diff(slow) > apart) | (np.diff(moved) > 0)) + 1
    stretches = sorted(np.split(slow, breaks), key=lambda intervals: -lost[intervals].sum())
    found = []
    for intervals in stretches:
        first, last = int(intervals[0]), int(intervals[-1]) + 1
        causes = _causes(path_task, check, times[first], times[last])[:2]
        why = f"{' and '.join(causes)}, " if causes else ""
        where = f"waypoints {first + 1} to {last + 1}: {lost[intervals].sum():.2g}\u00a0s more"
        none = "" if causes else "; none of the known limits is used up there"
        found.append(f"{why}{where}{none}")
    return found


def _causes(path_task: PathTask, check: Check, begin: float, end: float) -> list[str]:
    """The limits that are used up between two times, the longest used one first, and stops."""
    motion, names = check.motion, JointRanges.of(path_task.model).names
    count: dict[str, int] = {}
    for kind, limits, use in (
        ("speed", check.limits.velocity, velocity_use),
        ("acceleration", check.limits.acceleration, acceleration_use),
    ):
        shares = use(motion, limits)[1]
        opens, closes = motion.times[:-1], motion.times[1:]
        if len(shares) != len(opens):  # at the rows between the pieces
            opens = closes = motion.times[1:-1]
        tight = shares[(opens < end) & (closes > begin)] >= _TIGHT
        for joint in np.flatnonzero(tight.any(axis=0)):
            count[f"{names[joint]}'s {kind}"] = int(tight[:, joint].sum())
    causes = sorted(count, key=lambda cause: -count[cause])
    if motion.velocities is not None:
        rests = (np.abs(motion.velocities) < _REST).all(axis=1)
        at = motion.times[rests & (motion.times >= begin) & (motion.times <= end)]
        if ((at > motion.times[0]) & (at < motion.times[-1])).any():
            causes.append("a stop")
        elif len(at):
            causes.append("starting from rest" if at[0] == motion.times[0] else "coming to rest")
    return causes


def failing_intervals(path_task: PathTask, check: Check) -> Mask:
    """Which intervals between two waypoints have something that does not pass, (N − 1,)."""
    errors, tolerances, when = check.errors, check.tolerances, check.passing.times
    off = ~tolerances.met(errors.position.at, errors.axis.at)
    bad: Mask = ~errors.kept(tolerances.position, tolerances.axis) | off[:-1] | off[1:]
    times, margins = joint_margins(JointRanges.of(path_task.model), check.motion)
    beyond = [times[margins.min(axis=1) < -1e-6]]
    if check.passing.timed:
        for limits, use in (
            (check.limits.velocity, velocity_use),
            (check.limits.acceleration, acceleration_use),
        ):
            times, shares = use(check.motion, limits)
            beyond.append(times[shares.max(axis=1) > 1.0 + 1e-6])
    at = np.searchsorted(when, np.concatenate(beyond), side="right") - 1
    bad[np.clip(at, 0, len(bad) - 1)] = True
    return bad
