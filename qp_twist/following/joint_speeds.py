"""Joint speeds between waypoints, as shares of their limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.following.trajectory import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask

OVER = 1.0 + 1e-6
"""Share of its limit from which a joint counts as too fast."""


class PeakSpeed(NamedTuple):
    """The highest joint speed of a trajectory."""

    share: float
    """Share of the joint's limit."""
    joint: str
    waypoint: int
    """Waypoint at which the motion arrives, from 1."""


def has_speed_limits(path_task: PathTask) -> bool:
    """Whether the task has a feed and a joint speed limit."""
    return path_task.durations is not None and bool(np.isfinite(path_task.velocity_limits).any())


def speed_shares(trajectory: Trajectory) -> Array:
    r"""Mean speed of each joint before each waypoint, over its limit, (N, nv); 0 where none is.

    .. math:: |\theta_{i+1} - \theta_i| \,/\, (\dot\theta_{max}\, \delta t_{i+1})

    The first row is 0. δt is the trajectory's duration of the waypoint.
    """
    task = trajectory.path_task
    q = JointRanges.of(task.model).positions(trajectory.q)
    shares = np.zeros_like(q)
    if trajectory.durations is not None:
        times = trajectory.durations[1:, None]
        shares[1:] = np.abs(np.diff(q, axis=0)) / (task.velocity_limits * times)
    return shares


def peak_speed(trajectory: Trajectory) -> PeakSpeed | None:
    """The joint and waypoint closest to a speed limit; ``None`` without a feed or limits."""
    if not has_speed_limits(trajectory.path_task):
        return None
    shares = speed_shares(trajectory)
    row, joint = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return PeakSpeed(float(shares[row, joint]), trajectory.joint_names[joint], int(row) + 1)
