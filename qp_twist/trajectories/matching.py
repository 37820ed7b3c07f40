"""Match a trajectory with any rows to the waypoints of a path."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import ProjectorKind
from qp_twist.paths import PathTask
from qp_twist.referee import JointMotion, Tolerances, poses_of, task_errors

_DENSITY = 8
"""Smallest number of samples of the motion for each waypoint."""
_NEAR = 100.0
"""Linear error, in tolerances, above which the angular one is not computed."""
_PAIRS = 100_000
"""Number of pairs of a waypoint and a pose that are compared together."""
_REFINED = 17
_ROUNDS = 3
_ON = 1e-3
"""Task error, in tolerances, at which the refinement ends."""


def times_at_waypoints(path_task: PathTask, motion: JointMotion, tolerances: Tolerances) -> Array:
    r"""Times, s, (N,), never decreasing, at which the motion is nearest to the waypoints in order.

    Among all nondecreasing times of the waypoints, the result minimises the sum of squared task
    errors, each in tolerances: by dynamic programming over dense samples, then by refining each
    time near its sample. So a path that crosses itself or is passed twice is matched in its order,
    and a run-in before the first waypoint or a run-out after the last costs nothing. The times need
    not be optimal: other times only give larger errors at the waypoints, and the bounds between
    waypoints are proven for the times found.
    """
    times = motion.times
    at, met = _matched(path_task, motion, times, tolerances)
    if not met.all():  # from the rows alone
        parts = max(1, -(-_DENSITY * len(at) // (len(motion.times) - 1)))
        begins, spans = motion.times[:-1, None], np.diff(motion.times)[:, None]
        times = np.append((begins + spans * np.arange(parts) / parts).ravel(), motion.times[-1])
        at, met = _matched(path_task, motion, times, tolerances)
    found, missed = times[at], np.flatnonzero(~met)
    if len(missed):
        found[missed] = _refined(path_task, motion, times, at[missed], missed, tolerances)
    ordered: Array = np.maximum.accumulate(found)
    return ordered


def _refined(
    path_task: PathTask,
    motion: JointMotion,
    times: Array,
    at: Indices,
    waypoints: Indices,
    tolerances: Tolerances,
) -> Array:
    """Refine the times (M,) of some waypoints near their samples ``at`` (M,), all at once."""
    looks = np.repeat(waypoints, _REFINED + 1)
    R_d, p_d = (part[looks] for part in path_task.poses)
    rows = [path_task.in_force[k] for k in looks]
    found = times[at]
    low, high = times[np.maximum(at - 1, 0)], times[np.minimum(at + 1, len(times) - 1)]
    for _ in range(_ROUNDS):
        near = np.column_stack([np.linspace(low, high, _REFINED, axis=1), found])
        errors = task_errors(*poses_of(path_task, motion.at(near.ravel()).q), R_d, p_d, rows)
        best = _squared(errors, tolerances).reshape(near.shape).argmin(axis=1)
        found = near[np.arange(len(near)), best]
        width = (high - low) / (_REFINED - 1)
        low, high = np.maximum(low, found - width), np.minimum(high, found + width)
    return found


def _matched(
    path_task: PathTask, motion: JointMotion, times: Array, tolerances: Tolerances
) -> tuple[Indices, Mask]:
    """Index of each waypoint's time, (N,), and whether the motion is on the waypoint then."""
    R, p = poses_of(path_task, motion.at(times).q)
    at = _in_order(_costs(path_task, R, p, tolerances))
    errors = task_errors(R[at], p[at], *path_task.poses, path_task.in_force)
    return at, _squared(errors, tolerances) < _ON**2


def _in_order(costs: Iterable[Array]) -> Indices:
    """Indices of times, (N,), never decreasing, with the least sum of N costs, (K,) each."""
    so_far: Array | None = None
    # One bit for each waypoint and time: a long path has some 1e9 of them.
    firsts = []
    for cost in costs:
        if so_far is None:
            so_far = np.zeros(len(cost))
        # The least cost up to each time, and the times at which it decreased.
        least = np.minimum.accumulate(so_far)
        firsts.append(np.packbits(np.concatenate([[True], so_far[1:] < least[:-1]])))
        so_far = least + cost
    assert so_far is not None
    at = np.empty(len(firsts), dtype=np.intp)
    at[-1] = int(np.argmin(so_far))
    for k in range(len(firsts) - 1, 0, -1):
        at[k - 1] = np.flatnonzero(np.unpackbits(firsts[k], count=at[k] + 1))[-1]
    return at


def _costs(path_task: PathTask, R: Array, p: Array, tolerances: Tolerances) -> Iterator[Array]:
    """Squared task errors of poses (K) at each waypoint in turn, in tolerances.

    For poses with a large position error the angular error is not computed but set to its maximum:
    a long path has some 1e8 of them.
    """
    (R_d, p_d), in_force = path_task.poses, path_task.in_force
    for first in range(0, len(p_d), step := max(1, _PAIRS // len(p))):
        rows = in_force[first : first + step]
        cost = ((p - p_d[first : first + step, None]) ** 2).sum(axis=2) / tolerances.position**2
        whole = np.array([t.linear.kind is ProjectorKind.FULL for t in rows])
        waypoint, pose = np.nonzero((cost < _NEAR**2) | ~whole[:, None])
        at = first + waypoint
        near = [rows[k] for k in waypoint.tolist()]
        errors = task_errors(R[pose], p[pose], R_d[at], p_d[at], near)
        cost += (np.pi / tolerances.axis) ** 2
        cost[waypoint, pose] = _squared(errors, tolerances)
        yield from cost


def _squared(errors: Array, tolerances: Tolerances) -> Array:
    """Squares of task errors (K, 6) in tolerances, (K,)."""
    scale = np.repeat([tolerances.position, tolerances.axis], 3)
    squared: Array = np.sum((errors / scale) ** 2, axis=1)
    return squared
