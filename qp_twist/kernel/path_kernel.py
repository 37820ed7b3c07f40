"""Correct configurations onto a path's waypoints, and minimise z there, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.dual_active_set import cholesky, cholesky_solve
from qp_twist.kernel.null_space import null_space, reflect
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
    """Arrays for one configuration at a time."""

    pose: Any
    J: Any
    A: Any
    b: Any
    side: Any
    square: Any
    V: Any
    R: Any
    N: Any
    free: Any
    step: Any
    there: Any
    nearest: Any
    free_costs: Any


@kernel
def workspace(nv, couplings):
    """A workspace for a robot of ``nv`` degrees of freedom."""
    m = 6 + len(couplings.dofs)
    return Workspace(
        np.zeros(12), np.zeros((6, nv)), np.zeros((m, nv)), np.zeros(m), np.zeros(m),
        np.zeros((m, m)), np.zeros((m, nv)), np.zeros((m, m)), np.zeros((nv, nv)),
        np.zeros((0, nv)), np.zeros(nv), np.zeros(nv), np.zeros(nv), np.ones(2),
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
    """Write UᵀJ, UᵀΔt and the couplings' rows at a waypoint to w.A (r, nv), w.b (r,); return r."""
    pose_and_jacobian(arm, q, w.pose, w.J)
    kinds = rows.kinds[rows.which[at]]
    twist_rows(
        kinds, rows.shapes[rows.which[at]], w.pose, rows.targets[at], w.J, 1.0, w.A, w.b, w.free,
        w.free_costs,
    )  # fmt: skip
    r = kinds[0] + kinds[1]
    _coupled_rows(couplings, q, w.A[r:], w.b[r:])
    return r + len(couplings.dofs)


@kernel
def _shortest(A, b, rounding, square, step):
    """As ``planning.path_rows._shortest``, for one q; return whether there is a step."""
    m, n = A.shape
    trace = 0.0
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += A[i, k] * A[j, k]
            square[i, j] = total
        trace += square[i, i]
    for i in range(m):
        square[i, i] += rounding * trace if trace > 0.0 else 1.0
    if not cholesky(square[:m, :m]):
        return False
    cholesky_solve(square, b)
    for k in range(n):
        step[k] = 0.0
        for i in range(m):
            step[k] += A[i, k] * b[i]
    return True


@kernel
def _length(b):
    """‖b‖."""
    square = 0.0
    for i in range(len(b)):
        square += b[i] * b[i]
    return math.sqrt(square)


@kernel
def _towards(q, step, longest, there):
    """Write q + step, shortened to ``longest`` in every joint."""
    largest = longest
    for dof in range(len(q)):
        largest = max(largest, abs(step[dof]))
    for dof in range(len(q)):
        there[dof] = q[dof] + step[dof] * (longest / largest)


@kernel
def _tame_step(w, r, rounding):
    """Write the shortest step that satisfies w.A and w.b, r rows, to w.step, damped if it is wild.

    Return whether there is one.
    """
    w.side[:r] = w.b[:r]
    while rounding < 1.0:
        if not _shortest(w.A[:r], w.b[:r], rounding, w.square, w.step):
            return False
        if np.abs(w.step).max() <= _WILD:
            return True
        rounding *= 100.0
        w.b[:r] = w.side[:r]
    return True


@kernel
def _newton(arm, rows, couplings, at, q, settings, w):
    """As ``PathRows.correct``, for one configuration, in place; return whether it is on the task.

    If Newton's method does not converge, but comes near, the errors are minimised.
    """
    iterations, on_task, longest, rounding, near, _, _ = settings
    least = math.inf
    for _ in range(iterations):
        r = rows_at(arm, rows, couplings, at, q, w)
        size = _length(w.b[:r])
        if size <= on_task:
            return True
        if size < least:
            least = size
            w.nearest[:] = q
        if not _tame_step(w, r, rounding):
            break
        _towards(q, w.step, longest, q)
    if least > near:
        return False
    q[:] = w.nearest
    return _least_errors(arm, rows, couplings, at, q, settings, w)


@kernel
def _least_errors(arm, rows, couplings, at, q, settings, w):
    """Minimise ‖b‖ by damped steps, in place; return whether the errors are within tolerances.

    Levenberg's and Marquardt's method. The damping keeps rows that the joints hardly change, as
    those that only a rounded angle of the model makes independent, from moving them far.
    """
    iterations, on_task, longest, _, _, linear, angular = settings
    damping, done = _LEAST_DAMPING, False
    for _ in range(2 * iterations):
        r = rows_at(arm, rows, couplings, at, q, w)
        before = _length(w.b[:r])
        if not _shortest(w.A[:r], w.b[:r], damping, w.square, w.step):
            break
        _towards(q, w.step, longest, w.there)
        r = rows_at(arm, rows, couplings, at, w.there, w)
        gained = before - _length(w.b[:r])
        if gained > 0.0:
            q[:] = w.there
            damping = max(0.1 * damping, _LEAST_DAMPING)
            done = gained <= _SETTLED * before
        else:
            done = damping > 1.0
            damping *= 10.0
        if done:
            break
    kinds = rows.kinds[rows.which[at]]
    r = rows_at(arm, rows, couplings, at, q, w)
    split, end = kinds[0], kinds[0] + kinds[1]
    return (
        _length(w.b[:split]) <= linear
        and _length(w.b[split:end]) <= angular
        and _length(w.b[end:r]) <= on_task
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
def _centring(q, weight, middle):
    total = 0.0
    for dof in range(len(q)):
        offset = weight[dof] * (middle[dof] - q[dof])
        total += 0.5 * offset * offset
    return total


@kernel
def _along_null_space(N, weight, middle, q, gram, side, step):
    """Compute the step in the rows of N (d, nv) that minimises ‖W(θ̄ − θ − step)‖; return its gain.

    Solves the normal equations, regularised by 1e-12 for directions in which W is zero. The gain is
    to first order.
    """
    d, n = N.shape
    for i in range(d):
        side[i] = 0.0
        for dof in range(n):
            side[i] += N[i, dof] * weight[dof] ** 2 * (middle[dof] - q[dof])
        for j in range(i + 1):
            gram[i, j] = 1e-12 if i == j else 0.0
            for dof in range(n):
                gram[i, j] += weight[dof] * N[i, dof] * weight[dof] * N[j, dof]
    for dof in range(n):
        step[dof] = 0.0
    if not cholesky(gram[:d, :d]):
        return 0.0
    cholesky_solve(gram, side[:d])
    expected = 0.0
    for dof in range(n):
        for i in range(d):
            step[dof] += N[i, dof] * side[i]
        expected += step[dof] * weight[dof] ** 2 * (middle[dof] - q[dof])
    return expected


@kernel
def _down(arm, rows, couplings, at, q, weight, middle, settings, descent, w, gram, side):
    """As ``planning.bound.centred_nearby``, from one configuration on its waypoint."""
    rounds, longest, settled = descent
    nv, share = len(q), 1.0
    step, there = np.empty(nv), np.empty(nv)
    for _ in range(rounds):
        r = rows_at(arm, rows, couplings, at, q, w)
        if r >= nv:
            return
        reflect(w.A[:r], w.V[:r], w.R)
        N = w.N[: nv - r]
        null_space(w.V[:r], N)
        expected = share * _along_null_space(N, weight, middle, q, gram, side, step)
        for dof in range(nv):
            step[dof] *= share
        _towards(q, step, longest, there)
        gained = -1.0
        if _newton(arm, rows, couplings, at, there, settings, w):
            gained = _centring(q, weight, middle) - _centring(there, weight, middle)
        if gained > 0.0:
            for dof in range(nv):
                q[dof] = there[dof]
        elif gained < 0.0:
            share *= 0.4
        if not (expected > settled and share > 0.01):
            return


@kernel
def centred_nearby(arm, rows, couplings, q, at, weight, middle, settings, descent):
    """As ``planning.bound.centred_nearby``: q (K, nv) in place, NaN where it does not converge.

    ``settings`` as for :func:`correct`; ``descent``: largest number of rounds, largest step of a
    joint, rad or m, and the decrease of z below which it stops.
    """
    nv = q.shape[1]
    w, gram, side = workspace(nv, couplings), np.zeros((nv, nv)), np.zeros(nv)
    for k in range(len(q)):
        if _newton(arm, rows, couplings, at[k], q[k], settings, w):
            _down(
                arm, rows, couplings, at[k], q[k], weight, middle, settings, descent, w, gram, side
            )
        else:
            q[k, :] = math.nan
