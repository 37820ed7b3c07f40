"""Where along the path something does not pass."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.referee import acceleration_use, joint_margins, velocity_use
from qp_twist.trajectories import Check


def failing_intervals(path_task: PathTask, check: Check) -> Mask:
    """Which intervals between two waypoints have something that does not pass, (N − 1,)."""
    errors, tolerances, when = check.errors, check.tolerances, check.passing.times
    off = (errors.position > tolerances.position) | (errors.axis > tolerances.axis)
    bad: Mask = ~errors.kept(tolerances.position, tolerances.axis) | off[:-1] | off[1:]
    ranges = JointRanges.of(path_task.model)
    motion = check.motion
    moments = [(joint_margins(ranges, motion), -1e-6, True)] if ranges.limited.any() else []
    if check.passing.timed:
        moments += [
            (use(motion, limits), 1.0 + 1e-6, False)
            for limits, use in (
                (check.limits.velocity, velocity_use),
                (check.limits.acceleration, acceleration_use),
            )
            if np.isfinite(limits).any()
        ]
    for (times, values), limit, least in moments:
        beyond = values.min(axis=1) < limit if least else values.max(axis=1) > limit
        at = np.searchsorted(when, times[beyond], side="right") - 1
        bad[np.clip(at, 0, len(bad) - 1)] = True
    return bad
