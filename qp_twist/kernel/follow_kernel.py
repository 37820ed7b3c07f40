"""One method along a path, waypoint by waypoint, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.bounds import WINDOW, bounds
from qp_twist.kernel.compiling import inner, kernel, plain
from qp_twist.kernel.null_space import INDEPENDENT, least_norm, reflect
from qp_twist.kernel.path_kernel import Rows
from qp_twist.kernel.step_kernel import read_step, step_on_rows
from qp_twist.kernel.twist_rows import twist_rows
from qp_twist.kernel.verified_program import DONE

_STANDS_STILL = 1e-13
"""A displacement below it counts as zero, rad or m."""


class FollowSettings(NamedTuple):
    """Settings of a method, the same for every waypoint and every run."""

    program: bool
    """Whether the method is the QP; otherwise the closed form: minimum norm plus null-space
    motion."""
    twist_space: Any
    """``None`` for the QP's joint-space cost."""
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
    """``step_kernel.StepArrays`` of a step with one task, for each number of rows, (7, F)."""
    integers: npt.NDArray[np.int64]
    """The same, (7, I)."""


class Path(NamedTuple):
    """The path of a run."""

    rows: Rows
    """Task rows of the method; projector −1 marks a waypoint that is left to the reference."""
    durations: npt.NDArray[np.float64]
    """Time from the previous waypoint, s, (N,)."""
    references: npt.NDArray[np.float64]
    """Reference positions of the secondary, rad or m, (N, nv)."""


@plain
def _begin(method, path, at, q, g, w):
    """Centre the windows on q, move q towards a plan; return false if the reference has to."""
    dt = path.durations[at]
    for dof in range(len(q)):
        g.middle[dof] = path.references[at, dof]
    for index in range(len(g.types)):
        if g.types[index] == WINDOW:
            for dof in range(len(q)):
                g.limits[index, dof, 0] = q[dof]
                g.limits[index, dof, 1] = method.limits[index, dof, 1] * dt
    if not method.every_iteration:
        return True
    if not bounds(
        g.limits, g.types, q, dt, g.settings.noticeable, g.settings.unlimited, w.lower, w.upper,
        w.lower_kind, w.upper_kind,
    ):  # fmt: skip
        return False
    for dof in range(len(q)):
        desired = g.stiffness[dof] * (g.middle[dof] - q[dof])
        q[dof] += min(max(desired, min(w.lower[dof] * dt, 0.0)), max(w.upper[dof] * dt, 0.0))
    return True


@inner
def _closed_form(q, use_secondary, g, w):
    """Write (TJ)†TΔt + (1 − (TJ)†TJ) h to ``w.x``; return whether the rows are independent."""
    V = np.empty(w.A.shape)
    if len(w.b) > len(q) or not reflect(w.A, V, w.R) >= INDEPENDENT:
        return False
    for dof in range(len(q)):
        w.x[dof] = 0.0
        if use_secondary:
            w.x[dof] = g.stiffness[dof] * (g.middle[dof] - q[dof])
    least_norm(V, w.R, w.b, w.x)
    return True


@inner
def _approach(arm, method, path, at, q, floats, integers):
    """Iterate to a waypoint, as ``following.walk``; return the iterations, −1 for the reference."""
    rows = path.rows
    kinds, shape = rows.kinds[rows.which[at]], rows.shapes[rows.which[at]]
    m = kinds[0] + kinds[1]
    s = read_step(floats[m], integers[m], integers[m])
    g, w = s.inputs, s.program
    if not _begin(method, path, at, q, g, w):
        return -1
    dt = path.durations[at] if method.program else 1.0
    for iteration in range(method.iterations):
        pose_and_jacobian(arm, q, g.poses[0], g.jacobians[0])
        apart, turned = twist_rows(
            kinds, shape, g.poses[0], rows.targets[at], g.jacobians[0], dt, w.A, w.b, w.free,
            g.free_costs,
        )  # fmt: skip
        if iteration > 0 and apart <= method.tolerances[0] and turned <= method.tolerances[1]:
            return iteration
        use_secondary = iteration == 0 or method.every_iteration
        if method.program:
            if step_on_rows(g, w, q, dt, use_secondary, method.twist_space) != DONE:
                return -1
        elif not _closed_form(q, use_secondary, g, w):
            return -1
        largest = 0.0
        for dof in range(len(q)):
            step = w.x[dof] * dt
            q[dof] += step
            largest = max(largest, abs(step))
            if not abs(q[dof]) < method.sane:
                return -1
        if largest < _STANDS_STILL:
            return iteration + 1
    return method.iterations


@kernel
def follow(arm, method, path, first, q, iterations):
    """Fill the rows of q (N, nv) from ``first`` on, starting at row ``first`` − 1.

    Args:
        arm: The robot.
        method: The method.
        path: The path of the run.
        first: Index of the first waypoint to compute, at least 1.
        q: Configurations; rows before ``first`` are input, the others are the result.
        iterations: Result, (N,).

    Returns:
        The index of the first waypoint that is left to the reference; N if there is none.
    """
    floats, integers, there = method.floats.copy(), method.integers.copy(), np.empty(q.shape[1])
    for at in range(first, len(q)):
        if path.rows.which[at] < 0:
            return at
        for dof in range(q.shape[1]):
            there[dof] = q[at - 1, dof]
        iterations[at] = _approach(arm, method, path, at, there, floats, integers)
        if iterations[at] < 0:
            return at
        for dof in range(q.shape[1]):
            q[at, dof] = there[dof]
    return len(q)


@kernel
def measure(arm, rows, q, errors, found):
    """Lengths of the task errors (N, 2), m and rad, and the rows UᵀJ (N, 6, nv) along a path."""
    pose, J, b, free = np.zeros(12), np.zeros((6, q.shape[1])), np.zeros(6), np.zeros((0, 0))
    for at in range(len(q)):
        pose_and_jacobian(arm, q[at], pose, J)
        number = rows.which[at]
        errors[at, 0], errors[at, 1] = twist_rows(
            rows.kinds[number], rows.shapes[number], pose, rows.targets[at], J, 1.0, found[at], b,
            free, b,
        )  # fmt: skip


@kernel
def _move(move, targets, moved):
    """Apply a rigid motion (12) to the targets (N, 18) of a path."""
    for at in range(len(targets)):
        target, there = targets[at], moved[at]
        for i in range(3):
            a, b, c = move[3 * i], move[3 * i + 1], move[3 * i + 2]
            for j in range(3):
                there[3 * i + j] = a * target[j] + b * target[3 + j] + c * target[6 + j]
            there[9 + i] = move[9 + i] + a * target[9] + b * target[10] + c * target[11]


@kernel
def onto_start(arm, method, path, moves, q):
    """Iterate from q (K, nq), in place, to the first waypoint of K moved paths.

    ``method`` is that of the correction: no secondary, position limits only. The iteration stops
    at a step that needs the reference; the caller has to measure whether it converged.
    """
    rows = path.rows
    floats, integers = method.floats.copy(), method.integers.copy()
    targets = rows.targets[:1].copy()
    held = Rows(rows.kinds, rows.shapes, rows.which[:1], targets)
    first = Path(held, np.ones(1), path.references[:1])
    for k in range(len(q)):
        _move(moves[k], rows.targets[:1], targets)
        _approach(arm, method, first, 0, q[k], floats, integers)


@kernel
def _summary(errors, weight, middle, q, iterations, numbers):
    """Compute the ``numbers`` of :func:`follow_many` for a run from its q and errors."""
    count = len(q)
    for i in range(len(numbers)):
        numbers[i] = 0.0
    numbers[2] = math.inf
    for at in range(count):
        numbers[0] = max(numbers[0], errors[at, 0])
        numbers[1] = max(numbers[1], errors[at, 1])
        numbers[5] += iterations[at]
        for dof in range(q.shape[1]):
            offset = abs(weight[dof] * (q[at, dof] - middle[dof]))
            if weight[dof] > 0.0:
                numbers[2] = min(numbers[2], 1.0 - 2.0 * offset)
            numbers[3] += 0.5 * offset * offset / count
            if at > 0:
                numbers[4] = max(numbers[4], abs(q[at, dof] - q[at - 1, dof]))


@kernel
def follow_many(arm, method, path, measured, moves, starts, weight, middle, kept, numbers, ends):
    """:func:`follow` for many independent runs.

    Args:
        arm: The robot.
        method: The method.
        path: The path of the run.
        measured: The rows in which errors are measured.
        moves: Rigid motion of each run's path: rotation (9) and translation (3), (K, 12).
        starts: Configurations on the first waypoints, (K, nq).
        weight: 1/(θ_max − θ_min), 0 where a joint has no range, (nv,).
        middle: θ̄, (nv,).
        kept: Result: configurations (K, N, nq); with shape (0, N, nq) they are not stored.
        numbers: Result, (K, 6): largest position and axis error, m and rad; least margin; mean z;
            largest step of a joint, rad or m; number of steps.
        ends: Result: index of the first waypoint that is left to the reference, (K,).
    """
    rows = path.rows
    count, nq = len(rows.which), starts.shape[1]
    targets = rows.targets.copy()
    q, iterations = np.zeros((count, nq)), np.zeros(count, dtype=np.int64)
    errors, found = np.zeros((count, 2)), np.zeros((count, 6, nq))
    held = Rows(rows.kinds, rows.shapes, rows.which, targets)
    seen = Rows(measured.kinds, measured.shapes, measured.which, targets)
    moved = Path(held, path.durations, path.references)
    for run in range(len(starts)):
        _move(moves[run], rows.targets, targets)
        for dof in range(nq):
            q[0, dof] = starts[run, dof]
        end = follow(arm, method, moved, 1, q, iterations)
        ends[run] = end
        measure(arm, seen, q[:end], errors, found)
        _summary(errors, weight, middle, q[:end], iterations, numbers[run])
        if len(kept):
            for at in range(count):
                for dof in range(nq):
                    kept[run, at, dof] = q[at, dof] if at < end else math.nan
