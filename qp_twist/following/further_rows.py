"""Further rows of a trajectory, measured as those at the waypoints are."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.control import Status
from qp_twist.following.trajectory import Trajectory
from qp_twist.kinematics import FramePair, largest_excess
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import poses_of, task_errors


def with_rows(
    trajectory: Trajectory, at: Indices, q: Array, s: Array, durations: Array | None
) -> Trajectory:
    """The trajectory with further rows, and their errors.

    Args:
        trajectory: The trajectory.
        at: Indices of its rows before which rows are inserted, ascending, (K,).
        q: Their configurations, (K, nq).
        s: Their parameters of the path, (K,).
        durations: Of all rows afterwards, s, (N + K,); ``None`` without a feed.
    """
    task, count = trajectory.path_task, len(at)
    path = task.at(s)
    R, p = poses_of(task, q)
    errors = task_errors(R, p, path.rotations, path.positions, path.projectors)
    excess = largest_excess(task.bands, FramePair(R, p, path.rotations, path.positions))
    columns: dict[str, Any] = {
        "q": q,
        "s": s,
        "position_error": np.where(path.on_path, np.linalg.norm(errors[:, :3], axis=1), 0.0),
        "axis_error": np.where(path.on_path, np.linalg.norm(errors[:, 3:], axis=1), 0.0),
        "band_excess": np.where(path.on_path, excess, 0.0),
        "sigma_min": PathRows(task, s).sigma_min(q, np.arange(count)),
        "scale": 1.0,
        "iterations": 0,
    }
    changes: dict[str, Any] = {
        name: np.insert(getattr(trajectory, name), at, values, axis=0)
        for name, values in columns.items()
    }
    binding, statuses = list(trajectory.binding), list(trajectory.statuses)
    for k in reversed(at.tolist()):
        binding.insert(k, ())
        statuses.insert(k, Status.SOLVED)
    return dataclasses.replace(
        trajectory,
        binding=tuple(binding),
        statuses=tuple(statuses),
        durations=durations,
        **changes,
    )
