"""Where a motion is slower than its feed, and where it does not pass."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.referee import acceleration_use, jerk_use, joint_margins, velocity_use
from qp_twist.trajectories import Check

SLOWER = 0.03
"""Share by which an interval has to take longer than at the feed to count as slower: programs round
their speeds."""


def slower_intervals(path_task: PathTask, check: Check) -> Mask:
    """Which intervals between waypoints take longer than at the feed, (N − 1,)."""
    times = check.passing.times
    if path_task.durations is None or not check.passing.timed:
        return np.zeros(len(times) - 1, dtype=bool)
    slow: Mask = np.diff(times) > (1.0 + SLOWER) * path_task.durations[1 : len(times)]
    return slow & ~in_joint_moves(path_task, len(times))


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
            (check.limits.jerk, jerk_use),
        ):
            times, shares = use(check.motion, limits)
            beyond.append(times[shares.max(axis=1) > 1.0 + 1e-6])
    at = np.searchsorted(when, np.concatenate(beyond), side="right") - 1
    bad[np.clip(at, 0, len(bad) - 1)] = True
    return bad
