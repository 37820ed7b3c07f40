"""Correct configurations onto a path's waypoints, and minimise z there, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.copying import put
from qp_twist.kernel.dual_active_set import cholesky, cholesky_solve
from qp_twist.kernel.null_space import null_space, row_space
from qp_twist.kernel.twist_rows import twist_rows

_LEAST_DAMPING = 1e-8
"""Least damping where errors are minimised, as a share of the trace: rows with singular values
below its root are hardly changed."""
_WILD = 10.0
"""Length of a step, rad or m, above which it is damped: it would go far in a joint that hardly
changes the error."""
_SETTLED = 1e-2
"""Decrease of the error by a step, as a share of it, at which it counts as minimal."""


class Rows(NamedTuple):
    """Task rows of a path: its projectors and waypoints."""

    kinds: npt.NDArray[np.int64]
    """``kinds`` of ``twist_rows`` for each projector, (P, 3)."""
    shapes: npt.NDArray[np.float64]
    """``shape`` of ``twist_rows`` for each projector, (P, 27)."""
    which: npt.NDArray[np.int64]
    """Index of each waypoint's projector, (N,)."""
    targets: npt.NDArray[np.float64]
    """R_d (9), p_d (3) and the twist (6) of each waypoint, (N, 18)."""


class Couplings(NamedTuple):
    """Coupled joints: θ₁ = θ₁⁰ + c₀ + c₁ x + … + c₄ x⁴, x = θ₂ − θ₂⁰."""

    dofs: npt.NDArray[np.int64]
    """Degrees of freedom of the first and the second joint, (C, 2)."""
    start: npt.NDArray[np.float64]
    """θ₁⁰ and θ₂⁰, (C, 2)."""
    coefficients: npt.NDArray[np.float64]
    """c₀ … c₄, (C, 5)."""


class Workspace(NamedTuple):
    """Arrays for one configuration at a time; N is for the null space of the rows A."""

    pose: Any
    J: Any
    A: Any
    b: Any
    V: Any
    N: Any
    free: Any


@kernel
def workspace(nv, couplings):
    """A workspace for a robot of ``nv`` degrees of freedom."""
    m = 6 + len(couplings.dofs)
    return Workspace(
        np.zeros(12), np.zeros((6, nv)), np.zeros((m, nv)), np.zeros(m), np.zeros((nv, nv)),
        np.zeros((nv, nv)), np.zeros((0, nv)),
    )  # fmt: skip


@kernel
def _coupled_rows(couplings, q, A, b):
    """Write the rows A (C, nv) and right-hand sides b (C,) that correct coupled joints."""
    for k in range(len(couplings.dofs)):
        first, second = couplings.dofs[k, 0], couplings.dofs[k, 1]
        x = q[second] - couplings.start[k, 1]
        value, slope = 0.0, 0.0
        for power in range(4, -1, -1):  # Horner
            slope = slope * x + value
            value = value * x + couplings.coefficients[k, power]
        for dof in range(len(q)):
            A[k, dof] = 0.0
        A[k, first] = 1.0
        A[k, second] -= slope
        b[k] = couplings.start[k, 0] + value - q[first]


@kernel
def rows_at(arm, rows, couplings, at, q, w):
    """UᵀJ, UᵀΔt and the couplings' rows at a waypoint: A (r, nv) and b (r,), in w."""
    pose_and_jacobian(arm, q, w.pose, w.J)
    kinds = rows.kinds[rows.which[at]]
    twist_rows(
        kinds, rows.shapes[rows.which[at]], w.pose, rows.targets[at], w.J, 1.0, w.A, w.b, w.free,
        w.b,
    )  # fmt: skip
    task = kinds[0] + kinds[1]
    _coupled_rows(couplings, q, w.A[task:], w.b[task:])
    r = task + len(couplings.dofs)
    return w.A[:r], w.b[:r]


@kernel
def _length(b):
    """‖b‖."""
    return math.sqrt((b * b).sum())


@kernel
def _shortest(A, b, damping, wild):
    """Aᵀ(AAᵀ + λ1)⁻¹b; λ is a share of the trace, larger where a joint would move by ``wild``."""
    square = A @ A.T
    trace = np.trace(square)
    step = np.zeros(A.shape[1])
    while True:
        damped, solved = square.copy(), b.copy()
        for i in range(len(b)):
            damped[i, i] += damping * trace if trace > 0.0 else 1.0
        if cholesky(damped, len(damped)):
            cholesky_solve(damped, solved)
            step = solved @ A
            if np.abs(step).max() <= wild:
                return step
        damping *= 100.0
        if damping >= 1.0:
            return step


@kernel
def _towards(q, step, longest):
    """q + step, shortened to ``longest`` in every joint."""
    return q + step * (longest / max(longest, np.abs(step).max()))


@kernel
def _newton(arm, rows, couplings, at, q, settings, w):
    """As ``PathRows.correct``, for one configuration, in place; return whether it is on the task.

    If Newton's method does not converge, but comes near, the errors are minimised.
    """
    iterations, on_task, longest, rounding, near, _, _ = settings
    least, nearest = math.inf, q.copy()
    for _ in range(iterations):
        A, b = rows_at(arm, rows, couplings, at, q, w)
        size = _length(b)
        if size <= on_task:
            return True
        if size < least:
            least = size
            put(q, nearest)
        put(_towards(q, _shortest(A, b, rounding, _WILD), longest), q)
    if least > near:
        return False
    put(nearest, q)
    return _least_errors(arm, rows, couplings, at, q, settings, w)


@kernel
def _least_errors(arm, rows, couplings, at, q, settings, w):
    """Minimise ‖b‖ by damped steps, in place; return whether the errors are within tolerances.

    Levenberg's and Marquardt's method.
    """
    iterations, on_task, longest, _, _, linear, angular = settings
    damping = _LEAST_DAMPING
    for _ in range(2 * iterations):
        A, b = rows_at(arm, rows, couplings, at, q, w)
        before = _length(b)
        there = _towards(q, _shortest(A, b, damping, math.inf), longest)
        gained = before - _length(rows_at(arm, rows, couplings, at, there, w)[1])
        if gained > 0.0:
            put(there, q)
            damping = max(0.1 * damping, _LEAST_DAMPING)
            if gained <= _SETTLED * before:
                break
        elif damping > 1.0:
            break
        else:
            damping *= 10.0
    kinds = rows.kinds[rows.which[at]]
    _, b = rows_at(arm, rows, couplings, at, q, w)
    split, end = kinds[0], kinds[0] + kinds[1]
    return (
        _length(b[:split]) <= linear
        and _length(b[split:end]) <= angular
        and _length(b[end:]) <= on_task
    )


@kernel
def correct(arm, rows, couplings, q, at, settings):
    """As ``PathRows.correct``: q (K, nv) in place, and which are on their waypoints, (K,).

    ``settings``: largest number of iterations; error at which they end, m and rad; largest step of
    a joint, rad or m; the damping, as a share of the trace; the error from which on errors are
    minimised if it does not converge; and the linear and angular tolerances, m and rad.
    """
    arrived = np.zeros(len(q), dtype=np.bool_)
    w = workspace(q.shape[1], couplings)
    for k in range(len(q)):
        arrived[k] = _newton(arm, rows, couplings, at[k], q[k], settings, w)
    return arrived


@kernel
def _centering(q, weight, middle):
    return 0.5 * ((weight * (middle - q)) ** 2).sum()


@kernel
def _down(arm, rows, couplings, at, q, weight, middle, settings, descent, w):
    """As ``PathRows.descend``, from one configuration on its waypoint.

    Each step, along the rows of N (d, nv), minimises ‖W(θ̄ − θ − step)‖; 1e-12 is added to the
    normal equations for directions in which W is zero.
    """
    rounds, longest, settled = descent
    nv, share = len(q), 1.0
    for _ in range(rounds):
        A, _ = rows_at(arm, rows, couplings, at, q, w)
        r = row_space(A, w.V)
        if r == nv:
            return
        N = w.N[: nv - r]
        null_space(w.V[:r], N)
        weighted, away = N * weight, weight * (middle - q)
        gram, step = weighted @ weighted.T + 1e-12 * np.eye(nv - r), weighted @ away
        if not cholesky(gram, len(gram)):
            return
        cholesky_solve(gram, step)
        along = share * (step @ N)
        expected = (along * weight * away).sum()  # gain to first order
        there = _towards(q, along, longest)
        gained = -1.0
        if _newton(arm, rows, couplings, at, there, settings, w):
            gained = _centering(q, weight, middle) - _centering(there, weight, middle)
        if gained > 0.0:
            put(there, q)
        elif gained < 0.0:
            share *= 0.4
        if not (expected > settled and share > 0.01):
            return


@kernel
def centred_nearby(arm, rows, couplings, q, at, weight, middle, settings, descent):
    """As ``PathRows.descend``: q (K, nv) in place, NaN where it does not converge.

    ``settings`` as for :func:`correct`; ``descent``: largest number of rounds, largest step of a
    joint, rad or m, and the decrease of z below which it stops.
    """
    w = workspace(q.shape[1], couplings)
    for k in range(len(q)):
        if _newton(arm, rows, couplings, at[k], q[k], settings, w):
            _down(arm, rows, couplings, at[k], q[k], weight, middle, settings, descent, w)
        else:
            q[k, :] = math.nan
