"""Outcomes and tolerances of a step, and which rows are well conditioned."""

from __future__ import annotations

from typing import NamedTuple

from qp_twist.kernel.compiling import plain
from qp_twist.kernel.dual_active_set import cholesky

(
    DONE, REFUSED, SCALED, RELAXED, PRIORITIZED, INFEASIBLE, AT_THE_EDGE, BRAKED, BRAKED_BELOW,
    FADED,
) = range(10)  # fmt: skip
"""Outcome of a step.

``DONE``: verified, with all rows met. ``REFUSED``: the reference has to compute the step.
``SCALED``: verified with the rows scaled by s < 1. ``RELAXED``: verified, the first level in least
squares. ``PRIORITIZED``: verified, the first of several levels met. ``INFEASIBLE``: no velocity
inside the limits meets all rows.
``AT_THE_EDGE``: a direction is too weak for the error: ``edge_step`` computes the step. ``BRAKED``:
verified, at the share s < 1 from which the joints can stop in time. ``BRAKED_BELOW``: verified, the
first level at full speed and a lower one at such a share. ``FADED``: verified, with less
than the task asks of weak directions.
"""


class SolverTolerances(NamedTuple):
    """Tolerances of ``qp.verification`` and ``qp.levels``; described there."""

    equality: float
    optimality: float
    gain: float
    gap: float
    rounding: float
    bound: float
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
