"""Self-motion manifolds of a task with one redundant degree of freedom, traced by continuation."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.closed_form import minimum_norm
from qp_twist.following.resolver import twist_task
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.path import PathTask

STEP = np.radians(3.0)
"""Length of a predictor step in joint space, rad."""
_ON_TASK = 1e-6
"""Task error at which a configuration counts as on the manifold, m and rad: finer than a pixel."""


def manifolds(
    path_task: PathTask, waypoint: mink.SE3, *, seeds: int = 16, rng: np.random.Generator
) -> list[Array]:
    """All self-motion manifolds found from random seeds, each a closed curve (K, nv), rad.

    Each seed is brought onto the task by Newton steps; unless it lies on a curve that is known
    already, a new one is traced along the null vector of the task rows.

    Args:
        path_task: A task whose rows leave one degree of freedom to an arm of hinges.
        waypoint: Where.
        seeds: Number of random configurations to start from.
        rng: Source of the seeds.
    """
    task = twist_task(path_task, path_task.projector)
    task.set_target(waypoint)
    configuration = mink.Configuration(path_task.model)
    middle = JointRanges.of(path_task.model).middle
    found: list[Array] = []
    for _ in range(seeds):
        configuration.update(rng.uniform(middle - np.pi, middle + np.pi))
        if not _correct(task, configuration):
            continue
        q = configuration.q.copy()
        if not any(_distance(curve, q).min() < 2.0 * STEP for curve in found):
            found.append(_trace(task, configuration))
    return found


def _trace(task: TwistTask, configuration: mink.Configuration) -> Array:
    """Follow the null vector until the curve closes (modulo whole turns), or the rows are lost."""
    start = configuration.q.copy()
    curve = [start]
    tangent = _null_vector(task, configuration)
    for count in range(int(20.0 * 2.0 * np.pi / STEP)):
        configuration.integrate_inplace(STEP * tangent, 1.0)
        if not _correct(task, configuration):
            break
        q = configuration.q.copy()
        curve.append(q)
        if count > 2 and _distance(start[None], q)[0] < 0.75 * STEP:
            curve.append(start)
            break
        # Keep going the same way: a null vector's sign is arbitrary.
        candidate = _null_vector(task, configuration)
        tangent = candidate if candidate @ tangent >= 0.0 else -candidate
    return np.array(curve)


def _null_vector(task: TwistTask, configuration: mink.Configuration) -> Array:
    state = task.state(configuration)
    vector: Array = np.linalg.svd(state.basis.T @ state.jacobian)[2][-1]
    return vector


def _correct(task: TwistTask, configuration: mink.Configuration) -> bool:
    """Newton steps onto the task; whether it was reached."""
    for _ in range(60):
        state = task.state(configuration)
        if np.linalg.norm(state.error) < _ON_TASK:
            return True
        step = minimum_norm(state.jacobian, state.projector, state.error)
        longest = float(np.abs(step).max())
        configuration.integrate_inplace(step * min(1.0, 0.3 / longest), 1.0)
    return False


def _distance(curve: Array, q: Array) -> Array:
    """Distance from q (nv,) to each point of a curve (K, nv), joint angles modulo whole turns."""
    difference = np.remainder(curve - q + np.pi, 2.0 * np.pi) - np.pi
    distance: Array = np.linalg.norm(difference, axis=1)
    return distance
