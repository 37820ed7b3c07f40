"""Rows that a controller interpolates: no two closer in time than its interpolation period."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import rotation_vector
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.paths import PathTask
from qp_twist.trajectories.timed_path import TimedPath

_SHARE = 0.2
"""Share of the tolerances by which the tool may be moved where a row is left out. Rows between
waypoints and rounded corners use half of them; digits that are cut off, a twentieth (six angles of
0.5e-4° at 1 m are 5 µm)."""
_ROUNDING = 1e-9
"""Rounding of times that are added and subtracted, s."""


class Spaced(NamedTuple):
    """Rows in the distance of a period, how many were left out, how many moves take longer.

    And the indices of the rows that are kept.
    """

    rows: TimedPath
    left_out: int
    longer: int
    kept: Indices


def spaced(
    rows: TimedPath, period: float, path_task: PathTask | None, held: Mask | None = None
) -> Spaced:
    """The rows without those closer to each other than a period, s, as straight joint moves.

    A row is left out if the tool stays within a fifth of the task's tolerances of where it was at
    that time; without a task none is. A move that remains too short takes a period: slower, on the
    same path.

    Args:
        rows: With times.
        period: Of the controller, s.
        path_task: The task, whose tool and tolerances count.
        held: Rows that are not left out, (N,).
    """
    held = np.zeros(len(rows.q), dtype=bool) if held is None else held
    assert rows.times is not None
    kept: Indices = np.arange(len(rows.q))
    if path_task is not None and (np.diff(rows.times) < period - _ROUNDING).any():
        kept = _kept(rows, rows.times, period, path_task, held)
    durations = np.diff(rows.times[kept])
    least = np.maximum(durations, period)
    times = rows.times[0] + np.append(0.0, np.cumsum(least))
    found = replace(rows, q=rows.q[kept], times=times, velocities=None, accelerations=None)
    longer = int((least > durations + _ROUNDING).sum())
    left_out = len(rows.q) - len(kept)
    return Spaced(found if left_out or longer else rows, left_out, longer, kept)


def _kept(rows: TimedPath, times: Array, period: float, path_task: PathTask, held: Mask) -> Indices:
    """The rows that are kept, from the first on each as soon as a period after the one before."""
    q = rows.of_joints(JointRanges.of(path_task.model).names).q
    chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
    rotations, origins = chain.poses(q)
    tolerances = path_task.tolerances

    def stays(begin: int, end: int) -> bool:
        """Whether the tool stays if the rows between two are left out."""
        inner = slice(begin + 1, end)
        if held[inner].any():
            return False
        share = (times[inner] - times[begin]) / (times[end] - times[begin])
        R, p = chain.poses(q[begin] + share[:, None] * (q[end] - q[begin]))
        turns = np.linalg.norm(rotation_vector(R @ rotations[inner].transpose(0, 2, 1)), axis=1)
        moved = np.linalg.norm(p - origins[inner], axis=1)
        return bool(tolerances.met(moved / _SHARE, turns / _SHARE).all())

    kept, last = [0], len(times) - 1
    while kept[-1] < last:
        begin = kept[-1]
        end = begin + 1
        while end < last and times[end] - times[begin] < period - _ROUNDING:
            if not stays(begin, end + 1):
                break
            end += 1
        kept.append(end)
    # What is left before the last row may be too short: then the one before it may go.
    while len(kept) > 2 and times[kept[-1]] - times[kept[-2]] < period - _ROUNDING:
        if not stays(kept[-3], kept[-1]):
            break
        del kept[-2]
    return np.array(kept)
