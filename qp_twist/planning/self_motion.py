"""Self-motion manifolds of a task with one redundant degree of freedom, traced by continuation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.path_rows import PathRows

STEP_LENGTH = np.radians(3.0)
"""Length of a predictor step in joint space, rad."""
_LONGEST = int(20.0 * 2.0 * np.pi / STEP_LENGTH)
"""Number of steps after which a curve is left open."""


def manifolds(
    path_task: PathTask, indices: Sequence[int], *, seeds: int = 16, rng: np.random.Generator
) -> list[list[Array]]:
    """For each of some waypoints all self-motion manifolds found from random seeds.

    Each seed is corrected onto the task by Newton steps; unless it lies on a known curve, a new one
    is traced along the null vector of the task rows. All waypoints are traced at once, one curve of
    each at a time.

    Args:
        path_task: A task whose rows leave one degree of freedom to an arm of hinges.
        indices: The waypoints, counted from 0.
        seeds: Number of random seeds at each.
        rng: Random generator of the seeds.

    Returns:
        For each waypoint its closed curves (K, nv), rad.
    """
    rows = PathRows(path_task)
    middle = JointRanges.of(path_task.model).middle
    shape = (len(indices), seeds, len(middle))
    at = np.repeat(np.asarray(indices, dtype=np.intp), seeds)
    q, arrived = rows.correct(
        rng.uniform(middle - np.pi, middle + np.pi, shape).reshape(len(at), -1), at
    )
    left = [
        list(own[ok]) for own, ok in zip(q.reshape(shape), arrived.reshape(shape[:2]), strict=True)
    ]
    found: list[list[Array]] = [[] for _ in indices]
    while any(left):
        begun = [k for k, own in enumerate(left) if own]
        starts = np.array([left[k].pop(0) for k in begun])
        for k, curve in zip(begun, _trace(rows, starts, at[::seeds][begun]), strict=True):
            found[k].append(curve)
            left[k] = [q for q in left[k] if _distance(curve, q).min() >= 2.0 * STEP_LENGTH]
    return found


def _trace(rows: PathRows, starts: Array, at: Indices) -> list[Array]:
    """Trace from each start along the null vector until the curve closes (modulo whole turns)."""
    curves = [[start] for start in starts]
    q, going = starts.copy(), np.arange(len(starts))
    tangent = rows.motions(q, at)[:, :, 0]
    for count in range(_LONGEST):
        moved, arrived = rows.correct(q[going] + STEP_LENGTH * tangent[going], at[going])
        going = going[arrived]  # the others did not converge
        q[going] = moved[arrived]
        closed = np.zeros(len(going), dtype=bool)
        for k, curve in enumerate(going):
            curves[curve].append(q[curve].copy())
            closed[k] = count > 2 and _distance(starts[curve], q[curve]) < 0.75 * STEP_LENGTH
            if closed[k]:
                curves[curve].append(starts[curve])
        going = going[~closed]
        if not len(going):
            break
        # Keep the direction: the sign of a null vector is arbitrary.
        candidate = rows.motions(q[going], at[going])[:, :, 0]
        same = (candidate * tangent[going]).sum(axis=1) >= 0.0
        tangent[going] = np.where(same[:, None], candidate, -candidate)
    return [np.array(curve) for curve in curves]


def _distance(curve: Array, q: Array) -> Array:
    """Distance from q (nv,) to each point of a curve (…, nv), joint angles modulo whole turns."""
    difference = np.remainder(curve - q + np.pi, 2.0 * np.pi) - np.pi
    distance: Array = np.linalg.norm(difference, axis=-1)
    return distance
