"""The verified solution of a step's program, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.dual_active_set import NO_ROOM, SOLVED, cholesky
from qp_twist.kernel.reduced_program import reduced_program

DONE, REFUSED, SCALED, RELAXED, PRIORITIZED, TOO_FAST, DEPENDENT = range(7)
"""The step is verified; the reference has to look at it; it is verified at a reduced speed; as
close as the limits let it come; with the first of several levels met; no velocity inside the limits
meets all rows; the equality rows depend on each other, up to the threshold."""


class Tolerances(NamedTuple):
    """What ``qp.verification``, ``qp.scaling`` and ``qp.levels`` allow; they say what each is."""

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
    """Whether no singular value of a level's rows is below a threshold.

    Of each level in the null space of those above. AAᵀ = LLᵀ, and there what is left of the squares
    of a level's rows is made of its own block of L.
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
def _excess(hardest, left, largest, gap, w, tolerances):
    """What the multipliers leave, in units of its tolerance, as ``verification`` has it.

    ``hardest`` is the largest entry of H, ``left`` that of r = Hx + c + Aᵀy + Gᵀλ + μ, ``largest``
    the largest term in it, and ``gap`` ½rᵀH⁻¹r.
    """
    n, steepest, furthest, held = len(w.c), 0.0, 0.0, 0.0
    for i in range(n):
        steepest, furthest = max(steepest, abs(w.c[i])), max(furthest, abs(w.x[i]))
        largest = max(largest, abs(w.c[i]), abs(w.box[i]))
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
    least = tolerances.optimality * hardest * reach + tolerances.rounding * largest
    worst = max(worst, left / least)
    worst = max(worst, held / (tolerances.gain * cost + lost))
    return max(worst, gap / (tolerances.gap * cost + lost))


@part
def _pull_of_rows(A, y, residual):
    """Add Aᵀy to ``residual``; the largest of it."""
    largest = 0.0
    for i in range(A.shape[1] if len(y) else 0):
        total = 0.0
        for row in range(len(y)):
            total += A[row, i] * y[row]
        residual[i] += total
        largest = max(largest, abs(total))
    return largest


@part
def _left_of_diagonal(w, residual):
    """What :func:`_excess` asks, but for w, where H = diag h."""
    hardest, left, gap = 1e-300, 0.0, 0.0
    for i in range(len(w.c)):
        residual[i] = w.h[i] * w.x[i] + w.c[i] + w.box[i]
    largest = max(_pull_of_rows(w.A, w.y, residual), _pull_of_rows(w.G, w.lam, residual))
    for i in range(len(w.c)):
        hardest, left = max(hardest, w.h[i]), max(left, abs(residual[i]))
        gap += 0.5 * residual[i] * residual[i] / w.h[i]
    return hardest, left, largest, gap


@plain
def _left_of_dense(w, residual, along):
    """What :func:`_excess` asks, but for w, for any H, with JJᵀ = H⁻¹: rᵀH⁻¹r = ‖Jᵀr‖²."""
    n, hardest, left, gap = len(w.c), 1e-300, 0.0, 0.0
    for i in range(n):
        residual[i] = w.c[i] + w.box[i]
        along[i] = 0.0
        for j in range(n):
            residual[i] += w.dense[i, j] * w.x[j]
            hardest = max(hardest, abs(w.dense[i, j]))
    largest = max(_pull_of_rows(w.A, w.y, residual), _pull_of_rows(w.G, w.lam, residual))
    for k in range(n):
        left = max(left, abs(residual[k]))
        for i in range(n):
            along[i] += w.J[k, i] * residual[k]
    for i in range(n):
        gap += 0.5 * along[i] * along[i]
    return hardest, left, largest, gap


@plain
def excess_of(w, tolerances):
    """How far the result in w is from the optimum, in units of its tolerance; ≤ 1 is verified."""
    if len(w.h):
        hardest, left, largest, gap = _left_of_diagonal(w, w.line)
    else:
        hardest, left, largest, gap = _left_of_dense(w, w.root, w.line)
    return _excess(hardest, left, largest, gap, w, tolerances)


@part
def into_the_box(x, lower, upper):
    """To the last bit; whether x is finite."""
    for i in range(len(x)):
        x[i] = min(max(x[i], lower[i]), upper[i])
        if not math.isfinite(x[i]):
            return False
    return True


@plain
def no_multipliers(w):
    """All of them 0."""
    for i in range(len(w.box)):
        w.box[i] = 0.0
    for row in range(len(w.y)):
        w.y[row] = 0.0
    for row in range(len(w.lam)):
        w.lam[row] = 0.0


@plain
def solved_program(w, tolerances):
    """The verified solution of a program into ``w.x``.

    Returns:
        ``DONE``, ``TOO_FAST``, or ``REFUSED`` where others have to look at it.
    """
    w.gains[0] = 1.0
    status = reduced_program(w)
    if status == NO_ROOM:
        return TOO_FAST
    if status != SOLVED or not into_the_box(w.x, w.lower, w.upper):
        return REFUSED
    return DONE if excess_of(w, tolerances) <= 1.0 else REFUSED
