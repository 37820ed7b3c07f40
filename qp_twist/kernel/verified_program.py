"""The verified solution of a step's program, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.dual_active_set import NO_ROOM, SOLVED, cholesky
from qp_twist.kernel.reduced_program import reduced_program

(
    DONE, REFUSED, SCALED, RELAXED, PRIORITIZED, INFEASIBLE, DEPENDENT, AT_THE_EDGE, BRAKED,
    BRAKED_BELOW, FADED,
) = range(11)  # fmt: skip
"""Outcome of a step.

``DONE``: verified, with all rows met. ``REFUSED``: the reference has to compute the step.
``SCALED``: verified with the rows scaled by s < 1. ``RELAXED``: verified, the first level in least
squares. ``PRIORITIZED``: verified, the first of several levels met. ``INFEASIBLE``: no velocity
inside the limits meets all rows. ``DEPENDENT``: equality rows linearly dependent, to the threshold.
``AT_THE_EDGE``: a direction is too weak for the error: ``edge_step`` computes the step. ``BRAKED``:
verified, at the share s < 1 from which the joints can stop in time. ``BRAKED_BELOW``: verified, the
first level at full speed and a lower one at such a share. ``FADED``: verified, with less
than the task asks of weak directions.
"""


class SolverTolerances(NamedTuple):
    """Tolerances of ``qp.verification``, ``qp.scaling`` and ``qp.levels``; described there."""

    equality: float
    optimality: float
    gain: float
    gap: float
    rounding: float
    bound: float
    backoff: float
    held: float
    dust: float


@plain
def well_conditioned(A, ends, threshold, work, scratch):
    """Return whether no singular value of a level's rows is below a threshold.

    Each level's rows are first projected to the null space of the levels above. With AAᵀ = LLᵀ, the
    Gram matrix of a level's projected rows is that of its own diagonal block of L.
    """
    m, n = A.shape
    if m > n:
        return False
    square = threshold * threshold
    for i in range(m):
        for j in range(i + 1):
            total = -square if i == j and len(ends) == 1 else 0.0
            for k in range(n):
                total += A[i, k] * A[j, k]
            work[i, j] = total
    if not cholesky(work):
        return False
    first = 0
    for level in range(len(ends) if len(ends) > 1 else 0):
        end = ends[level]
        for i in range(first, end):
            for j in range(first, i + 1):
                total = -square if i == j else 0.0
                for k in range(first, j + 1):
                    total += work[i, k] * work[j, k]
                scratch[i - first, j - first] = total
        if not cholesky(scratch[: end - first, : end - first]):
            return False
        first = end
    return True


@part
def _excess(hardest, left, gap, w, tolerances):
    """Largest optimality or feasibility error, in units of its tolerance (``qp.verification``).

    ``hardest`` is the largest entry of H, ``left`` that of r = Hx + c + Aᵀy + Gᵀλ + μ, and ``gap``
    ½rᵀH⁻¹r. Rounding in r is not allowed for, as the reference does: where multipliers are so large
    that it matters, the reference computes the step.
    """
    n, steepest, furthest, held = len(w.c), 0.0, 0.0, 0.0
    for i in range(n):
        steepest, furthest = max(steepest, abs(w.c[i])), max(furthest, abs(w.x[i]))
        if w.box[i] > 0.0:
            held += w.box[i] * (w.upper[i] - w.x[i])
        elif w.box[i] < 0.0:
            held -= w.box[i] * (w.x[i] - w.lower[i])
    gap += held
    largest_b, off = 0.0, 0.0
    for row in range(len(w.b)):
        total = -w.b[row]
        for i in range(n):
            total += w.A[row, i] * w.x[i]
        gap -= w.y[row] * total
        off, largest_b = max(off, abs(total)), max(largest_b, abs(w.b[row]))
    over, lost = 0.0, 0.0
    for row in range(len(w.g)):
        room, terms = w.g[row], abs(w.g[row])
        for i in range(n):
            room -= w.G[row, i] * w.x[i]
            terms += abs(w.G[row, i] * w.x[i])
        over = max(over, -room)
        if w.lam[row] > 0.0:
            gap += w.lam[row] * room
            held += w.lam[row] * max(room, 0.0)
            lost += tolerances.rounding * w.lam[row] * terms
    reach = 1.0 + furthest
    cost = (hardest * reach + steepest) * reach
    worst = max(off / (tolerances.equality * (1.0 + largest_b)), over / (tolerances.bound * reach))
    worst = max(worst, left / (tolerances.optimality * hardest * reach))
    worst = max(worst, held / (tolerances.gain * cost + lost))
    return max(worst, gap / (tolerances.gap * cost + lost))


@part
def _add_multiplier_terms(A, y, residual):
    """Add Aᵀy to ``residual``."""
    for i in range(A.shape[1] if len(y) else 0):
        total = 0.0
        for row in range(len(y)):
            total += A[row, i] * y[row]
        residual[i] += total


@part
def _gradient_diagonal(w, residual):
    """Gradient of the Lagrangian for H = diag h: the first three arguments of :func:`_excess`."""
    hardest, left, gap = 1e-300, 0.0, 0.0
    for i in range(len(w.c)):
        residual[i] = w.h[i] * w.x[i] + w.c[i] + w.box[i]
    _add_multiplier_terms(w.A, w.y, residual)
    _add_multiplier_terms(w.G, w.lam, residual)
    for i in range(len(w.c)):
        hardest, left = max(hardest, w.h[i]), max(left, abs(residual[i]))
        gap += 0.5 * residual[i] * residual[i] / w.h[i]
    return hardest, left, gap


@plain
def _gradient_dense(w, residual, along):
    """As :func:`_gradient_diagonal` for any H, with JJᵀ = H⁻¹ and so rᵀH⁻¹r = ‖Jᵀr‖²."""
    n, hardest, left, gap = len(w.c), 1e-300, 0.0, 0.0
    for i in range(n):
        residual[i] = w.c[i] + w.box[i]
        along[i] = 0.0
        for j in range(n):
            residual[i] += w.dense[i, j] * w.x[j]
            hardest = max(hardest, abs(w.dense[i, j]))
    _add_multiplier_terms(w.A, w.y, residual)
    _add_multiplier_terms(w.G, w.lam, residual)
    for k in range(n):
        left = max(left, abs(residual[k]))
        for i in range(n):
            along[i] += w.J[k, i] * residual[k]
    for i in range(n):
        gap += 0.5 * along[i] * along[i]
    return hardest, left, gap


@plain
def excess_of(w, tolerances):
    """How far the result in w is from the optimum, in units of its tolerance; ≤ 1 is verified."""
    if len(w.h):
        hardest, left, gap = _gradient_diagonal(w, w.line)
    else:
        hardest, left, gap = _gradient_dense(w, w.root, w.line)
    return _excess(hardest, left, gap, w, tolerances)


@part
def clip_to_bounds(x, lower, upper):
    """Clip x to the bounds, exactly; return whether x is finite."""
    for i in range(len(x)):
        x[i] = min(max(x[i], lower[i]), upper[i])
        if not math.isfinite(x[i]):
            return False
    return True


@plain
def clear_multipliers(w):
    """Set all multipliers to 0."""
    for i in range(len(w.box)):
        w.box[i] = 0.0
    for row in range(len(w.y)):
        w.y[row] = 0.0
    for row in range(len(w.lam)):
        w.lam[row] = 0.0


@plain
def checked(w, status, tolerances):
    """``DONE``, ``INFEASIBLE`` or ``REFUSED`` of a solver's status and the result in w."""
    w.sensitivity[0] = 1.0
    if status == NO_ROOM:
        return INFEASIBLE
    if status != SOLVED or not clip_to_bounds(w.x, w.lower, w.upper):
        return REFUSED
    return DONE if excess_of(w, tolerances) <= 1.0 else REFUSED


@plain
def solved_program(w, tolerances):
    """Write the verified solution of a program to ``w.x``.

    Returns:
        ``DONE``, ``INFEASIBLE``, or ``REFUSED`` if the reference has to solve it.
    """
    return checked(w, reduced_program(w), tolerances)
