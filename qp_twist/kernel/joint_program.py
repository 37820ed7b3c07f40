"""A step's program in its own unknowns, in which a bound concerns one of them."""

from __future__ import annotations

from qp_twist.kernel.compiling import plain
from qp_twist.kernel.dual_active_set import SOLVED, active_set, row_lengths
from qp_twist.kernel.verified_program import clear_multipliers


@plain
def joint_program(w):
    """Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper; return the status.

    ``reduced_program`` works in the null space of the equality rows, where a bound is a dense row:
    that is faster if the rows leave one or two degrees of freedom, as in a controller's step, but
    takes twice the time if many joints have bounds, or where there are no rows.

    Args:
        w: ``step_record.Program``, with S of H⁻¹ = SSᵀ in J, which is overwritten by another S.
            Results are x, y, lam and box. The first ``active_count`` entries of ``active`` are the
            initial active set, numbered as in ``active_set``; the final one replaces them.
    """
    n, m, k, p = len(w.x), len(w.b), len(w.g), w.levels
    row_lengths(w.G, p.lengths)
    status, count = active_set(
        w.c, w.A, w.b, w.G, w.g, p.lengths, w.lower, w.upper, w.active, w.active_count[0], w.x, p.u,
        w.J, p.R, p.held[: m + k + 2 * n], p.work,
    )  # fmt: skip
    w.active_count[0] = count if status == SOLVED else 0
    if status != SOLVED:
        return status
    clear_multipliers(w)
    for place in range(count):
        which, u = w.active[place], p.u[place]
        if which < m:
            w.y[which] = -u
        elif which < m + k:
            w.lam[which - m] = u
        elif which < m + k + n:
            i = which - m - k
            w.x[i], w.box[i] = w.lower[i], w.box[i] - u
        else:
            i = which - m - k - n
            w.x[i], w.box[i] = w.upper[i], w.box[i] + u
    return SOLVED
