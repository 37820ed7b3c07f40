"""One method along the path of one or of many runs, waypoint by waypoint, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.bounds import WINDOW, bounds
from qp_twist.kernel.compiling import inner, kernel, plain
from qp_twist.kernel.copying import put
from qp_twist.kernel.path_kernel import Rows
from qp_twist.kernel.step_kernel import step_on_rows
from qp_twist.kernel.step_record import DONE, read_step
from qp_twist.kernel.twist_rows import twist_rows

_STANDS_STILL = 1e-13
"""A displacement below it counts as zero, rad or m."""


class FollowSettings(NamedTuple):
    """Settings of a method: a program, or a closed form as the program without limits."""

    twist_space: Any
    """``None`` for the joint-space cost."""
    iterations: int
    """Largest number of iterations per waypoint."""
    every_iteration: bool
    """Whether the secondary (a plan) acts before the first and in every iteration."""
    tolerances: npt.NDArray[np.float64]
    """Tolerances at which a waypoint counts as reached, m and rad, (2,)."""
    limits: npt.NDArray[np.float64]
    """Limits as in ``kernel.bounds``, (L, nv, 7); a window's half-width is that of one second."""
    sane: float
    """A joint position beyond it counts as diverged, rad or m."""
    floats: npt.NDArray[np.float64]
    """``step_record.Step`` of a step with one task, for each number of rows, (7, F)."""
    integers: npt.NDArray[np.int64]
    """The same, (7, I)."""


class Path(NamedTuple):
    """The path of a run."""

    rows: Rows
    """Task rows of the method; projector −1 marks a waypoint that is left to the reference."""
    measured: Rows
    """Those in which errors are measured, at the same targets."""
    durations: npt.NDArray[np.float64]
    """Time from the previous waypoint, s, (N,)."""
    references: npt.NDArray[np.float64]
    """Reference positions of the secondary, rad or m, (N, nv)."""


@plain
def _begin(method, path, at, q, s):
    """Centre the windows on q, move q towards a plan; return false if the reference has to."""
    dt = path.durations[at]
    put(path.references[at], s.middle)
    for index in range(len(s.types)):
        if s.types[index] == WINDOW:
            for dof in range(len(q)):
                s.limits[index, dof, 0] = q[dof]
                s.limits[index, dof, 1] = method.limits[index, dof, 1] * dt
    if not method.every_iteration:
        return True
    if not bounds(s, q, dt):
        return False
    for dof in range(len(q)):
        desired = s.stiffness[dof] * (s.middle[dof] - q[dof])
        q[dof] += min(max(desired, min(s.lower[dof] * dt, 0.0)), max(s.upper[dof] * dt, 0.0))
    return True


@inner
def _approach(arm, method, path, target, at, q, floats, integers):
    """Iterate to a waypoint, as ``following.walk``; return the iterations, −1 for the reference."""
    which = path.rows.which[at]
    if which < 0:
        return -1
    kinds, dt = path.rows.kinds[which], path.durations[at]
    m = kinds[0] + kinds[1]
    s = read_step(floats[m], integers[m])
    if not _begin(method, path, at, q, s):
        return -1
    for iteration in range(method.iterations):
        pose_and_jacobian(arm, q, s.poses[0], s.jacobians[0])
        apart, turned = twist_rows(
            kinds, path.rows.shapes[which], s.poses[0], target, s.jacobians[0], dt, s.A, s.b,
            s.free, s.free_costs,
        )  # fmt: skip
        if iteration > 0 and apart <= method.tolerances[0] and turned <= method.tolerances[1]:
            return iteration
        use_secondary = iteration == 0 or method.every_iteration
        if step_on_rows(s, q, dt, use_secondary, method.twist_space) != DONE:
            return -1
        largest = 0.0
        for dof in range(len(q)):
            step = s.x[dof] * dt
            q[dof] += step
            largest = max(largest, abs(step))
            if not abs(q[dof]) < method.sane:
                return -1
        if largest < _STANDS_STILL:
            return iteration + 1
    return method.iterations


@plain
def _move(move, target, moved):
    """Apply a rigid motion (12) to a target (18)."""
    for i in range(3):
        a, b, c = move[3 * i], move[3 * i + 1], move[3 * i + 2]
        for j in range(3):
            moved[3 * i + j] = a * target[j] + b * target[3 + j] + c * target[6 + j]
        moved[9 + i] = move[9 + i] + a * target[9] + b * target[10] + c * target[11]


@kernel
def follow(arm, method, path, moves, first, q, iterations, errors, found, ends):
    """Follow the waypoints from ``first`` on, for K independent runs.

    ``moves`` (K, 12) are rigid motions of each run's path, rotation (9) and translation (3). Of
    q (K, N, nq) row ``first`` − 1 is input, the next ones are the result; further results are
    iterations (K, N), lengths of the task errors, m and rad, (K, N, 2), and rows UᵀJ
    (K, N, 6, nv), both from row ``first`` − 1 on, and ``ends`` (K,), the index of the first
    waypoint that is left to the reference, N if none.
    """
    floats, integers = method.floats.copy(), method.integers.copy()
    seen, nv = path.measured, q.shape[2]
    target, there, pose, b = np.zeros(18), np.zeros(nv), np.zeros(12), np.zeros(6)
    J, free = np.zeros((6, nv)), np.zeros((0, nv))
    for run in range(len(q)):
        ends[run] = first
        put(q[run, first - 1], there)
        for at in range(first - 1, q.shape[1]):
            _move(moves[run], path.rows.targets[at], target)
            if at >= first:
                taken = _approach(arm, method, path, target, at, there, floats, integers)
                if taken < 0:
                    break
                iterations[run, at], ends[run] = taken, at + 1
                put(there, q[run, at])
            pose_and_jacobian(arm, there, pose, J)
            errors[run, at, 0], errors[run, at, 1] = twist_rows(
                seen.kinds[seen.which[at]], seen.shapes[seen.which[at]], pose, target, J, 1.0,
                found[run, at], b, free, b,
            )  # fmt: skip
