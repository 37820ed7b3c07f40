"""Where a motion ends before its path does, or leaves it for good; and where it begins late."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.paths import PathTask
from qp_twist.referee.intervals import Intervals, fewer_rows
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.path_errors import poses_of, task_errors

_SAMPLES = 400
"""Number of times at which errors off the path are evaluated, beside so many rows at most."""
_COVERED = 0.5
"""Share of the missed waypoints' intervals that a motion follows which is only beside them."""


class Astray(NamedTuple):
    """A part of a motion off its path: before the first waypoint that it meets, or after the last.

    There the motion does not follow the missed waypoints. One that does, at a distance, is not off
    the path by this definition: its errors are those at the waypoints.
    """

    after: bool
    """Whether it lies after the last waypoint that is met, else before the first."""
    waypoint: int
    """This waypoint, from 1; 0 if none is met."""
    times: Array
    """s, (K,), ascending."""
    position: Array
    """Task error at the nearest of the missed waypoints, m, (K,)."""
    axis: Array
    """rad, (K,)."""

    @property
    def place(self) -> str:
        """Between which waypoint and which end of the motion it lies, in words."""
        if not self.waypoint:
            return "no waypoint met"
        side = "after" if self.after else "before"
        return f"{side} waypoint {self.waypoint}, the {'last' if self.after else 'first'} one met"

    @property
    def moves(self) -> bool:
        """Whether the motion has a part here; else it begins or ends at the waypoint."""
        return bool(self.times[-1] > self.times[0])


def astray_parts(
    path_task: PathTask, motion: JointMotion, times: Array, met: Mask
) -> tuple[Astray, ...]:
    """The parts of a motion that do not follow waypoints which are missed at either end.

    ``times`` (N,), s, are those at which the motion is nearest to the waypoints, non-decreasing;
    ``met`` (N,) whether it meets them.
    """
    on_path = path_task.at(np.arange(len(met), dtype=np.float64)).on_path
    at, count = np.flatnonzero(met & on_path), len(times)
    begin, end = motion.times[[0, -1]].tolist()
    if not len(at):
        parts = [(True, 0, np.arange(count), (begin, end))]
    else:
        first, last = int(at[0]), int(at[-1])
        parts = [
            (False, first + 1, np.arange(first + 1), (begin, float(times[first]))),
            (True, last + 1, np.arange(last, count), (float(times[last]), end)),
        ]
    return tuple(
        Astray(after, waypoint, *_errors(path_task, motion, span, which))
        for after, waypoint, which, span in parts
        if len(which) > 1 and _covered(path_task, motion, times, which) < _COVERED
    )


def _covered(path_task: PathTask, motion: JointMotion, times: Array, which: Indices) -> float:
    """Share of the intervals between consecutive waypoints along which the motion goes."""
    R, p = poses_of(path_task, motion.at(times[which]).q)
    path = path_task.at(which.astype(np.float64))
    intervals = Intervals(path.rotations, path.positions, fewer_rows(path.projectors))
    here = np.arange(len(which) - 1)
    takes_time = (np.diff(times[which]) > 0.0).astype(np.float64)
    begin = intervals.progress(R[:-1], p[:-1], here, 0.0 * takes_time)[1]
    end = intervals.progress(R[1:], p[1:], here, takes_time)[1]
    counted = ~path.moves
    return float(np.maximum(end - begin, 0.0)[counted].mean()) if counted.any() else 1.0


def _errors(
    path_task: PathTask, motion: JointMotion, span: tuple[float, float], which: Indices
) -> tuple[Array, Array, Array]:
    """Times between two, and the task errors there, m and rad, at the nearest of waypoints."""
    from scipy.spatial import cKDTree  # imported on demand: 0.1 s

    rows = motion.times[(motion.times >= span[0]) & (motion.times <= span[1])]
    rows = rows[:: -(-max(len(rows), 1) // _SAMPLES)]
    times = np.union1d(np.linspace(*span, _SAMPLES), rows)
    R, p = poses_of(path_task, motion.at(times).q)
    R_d, p_d = (part[which] for part in path_task.poses)
    # Of what is farther away than any number the tree names none.
    near = np.minimum(cKDTree(p_d).query(p)[1], len(which) - 1)
    held = [path_task.in_force[which[k]] for k in near]
    errors = task_errors(R, p, R_d[near], p_d[near], held)
    return times, np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
