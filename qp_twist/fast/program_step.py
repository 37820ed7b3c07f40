"""A step from a program that others have stated to a verified joint velocity, compiled."""

from __future__ import annotations

import math

from qp_twist.fast.compiling import entry, plain
from qp_twist.fast.dual_active_set import NO_ROOM, SOLVED, active_set, cholesky_inverse, row_lengths
from qp_twist.fast.largest_scale import scaled_program
from qp_twist.fast.step_record import read_program
from qp_twist.fast.verified_program import (
    DEPENDENT,
    DONE,
    REFUSED,
    TOO_FAST,
    excess_of,
    into_the_box,
    no_multipliers,
    well_conditioned,
)


@plain
def _take_costs(H, c, lift, steepest, dt, w):
    """H + lift·1 and c/dt into the program; whether no solver has trouble with their size."""
    hardest, largest, finite = 0.0, 0.0, True
    for i in range(len(c)):
        w.c[i] = c[i] / dt
        largest = max(largest, abs(w.c[i]))
        finite &= abs(w.c[i]) < math.inf  # false for NaN
        for j in range(len(c)):
            w.dense[i, j] = H[i, j]
            hardest = max(hardest, abs(H[i, j]))
            finite &= abs(H[i, j]) < math.inf
        w.dense[i, i] += lift
        hardest = max(hardest, abs(w.dense[i, i]))
        finite &= abs(w.dense[i, i]) < math.inf
    return finite and largest <= steepest * hardest


@plain
def _take_box(box, unlimited, w):
    """The bounds into the program, those too far away as none; whether they leave room."""
    for i in range(len(w.x)):
        low, high = box[0, i], box[1, i]
        if not low <= high or low > unlimited or high < -unlimited:
            return False
        w.lower[i] = low if low >= -unlimited else -math.inf
        w.upper[i] = high if high <= unlimited else math.inf
        w.lower_kind[i], w.upper_kind[i] = box[2, i], box[3, i]
    return True


@plain
def _in_joints(w, R, work, held):
    """x with its multipliers, by the active-set method in the joints themselves; what happened.

    There a bound is one entry of x. In the null space of the equality rows, where
    ``reduced_program`` works, it is a dense row: that pays where these leave one or two joints
    free, as in a controller's step, and costs twice the time where many joints have bounds.

    Args:
        w: The program, with S of H⁻¹ = SSᵀ in J, which becomes another one.
        R: Workspace, (n, n).
        work: Workspace: (4, n + 1) for the method and the multipliers, then room for k lengths.
        held: Workspace, (m + k + 3n,).
    """
    n, m, k = len(w.x), len(w.b), len(w.g)
    active, u = held[m + k + 2 * n :], work[3]
    lengths = work[4:].reshape(-1)[:k]
    row_lengths(w.G, lengths)
    status, count = active_set(
        w.c, w.A, w.b, w.G, w.g, lengths, w.lower, w.upper, active, 0, w.x, u, w.J, R,
        held[: m + k + 2 * n], work[:3],
    )  # fmt: skip
    if status != SOLVED:
        return status
    no_multipliers(w)
    for place in range(count):
        which = active[place]
        if which < m:
            w.y[which] = -u[place]
        elif which < m + k:
            w.lam[which - m] = u[place]
        elif which < m + k + n:
            i = which - m - k
            w.x[i], w.box[i] = w.lower[i], w.box[i] - u[place]
        else:
            i = which - m - k - n
            w.x[i], w.box[i] = w.upper[i], w.box[i] + u[place]
    return SOLVED


@entry
def program_step(
    H, c, lift, steepest, dt, A, b, box, rows, ends, unlimited, floats, integers, level_ends,
    threshold, tolerances, R, work, held,
):  # fmt: skip
    """Solve and verify a program that has been stated; it is laid out in ``floats``.

    Args:
        H: Of the cost, (nv, nv), positive definite with ``lift`` on its diagonal.
        c: Of the cost on a displacement, (nv,).
        lift: Damping.
        steepest: Largest linear cost, relative to the largest quadratic one.
        dt: Length of the step, s.
        A: Equality rows, (≥ m, nv): m is that of the sizes.
        b: Their right-hand side, (≥ m,), m/s or rad/s.
        box: Bounds and what they come from, (4, nv): see ``stated_limits``.
        rows: Inequality rows, (≥ k, nv).
        ends: Their right-hand side, (≥ k,).
        unlimited: A bound beyond it is none.
        floats: Room for ``step_record.Program``.
        integers: The same; they begin with its table.
        level_ends: Where the rows of each level end, (1,): there is one.
        threshold: Singular value of the equality rows below which they are left to others.
        tolerances: Of the verification.
        R: Workspace, as ``work`` and ``held``: see ``_in_joints``.
        work: Workspace.
        held: Workspace.

    Returns:
        ``DONE``, ``DEPENDENT``, ``TOO_FAST``, or ``REFUSED`` for whatever else is not a plain step
        inside all limits.
    """
    w = read_program(floats, integers, integers)
    w.gains[0] = 1.0
    w.active_count[0] = 0  # begun anew: the program before may be another user's
    if not (_take_box(box, unlimited, w) and _take_costs(H, c, lift, steepest, dt, w)):
        return REFUSED
    for row in range(len(w.b)):
        w.b[row] = b[row]
        for j in range(len(w.x)):
            w.A[row, j] = A[row, j]
    for row in range(len(w.g)):
        w.g[row] = ends[row]
        for j in range(len(w.x)):
            w.G[row, j] = rows[row, j]
    if not well_conditioned(w.A, level_ends, threshold, w.R, w.J):
        return DEPENDENT
    if not cholesky_inverse(w.dense, w.J):
        return REFUSED
    status = _in_joints(w, R, work, held)
    if status == NO_ROOM and len(w.b) > 0:
        return TOO_FAST
    if status != SOLVED or not into_the_box(w.x, w.lower, w.upper):
        return REFUSED
    return DONE if excess_of(w, tolerances) <= 1.0 else REFUSED


@entry
def slower_step(floats, integers, tolerances):
    """Solve and verify at a reduced speed what :func:`program_step` has found too fast.

    Returns:
        As ``scaled_program``.
    """
    w = read_program(floats, integers, integers)
    if not cholesky_inverse(w.dense, w.J):
        return REFUSED
    return scaled_program(w, tolerances)


@entry
def keep_independent(A, b, m, dependent, basis):
    """Move rows that do not depend on others to the front of A and b.

    By Gram and Schmidt, the longest remainder first. Whether the others ask for the same as these
    is for the caller to see.

    Args:
        A: Rows, (≥ m, n); the order changes.
        b: Right-hand sides, (≥ m,), likewise.
        m: How many there are.
        dependent: A remainder of at most this length is none.
        basis: Workspace, (≥ m, n).

    Returns:
        How many rows stand at the front.
    """
    n = A.shape[1]
    for row in range(m):
        for j in range(n):
            basis[row, j] = A[row, j]
    for kept in range(min(m, n)):
        longest, which = 0.0, kept
        for row in range(kept, m):
            total = 0.0
            for j in range(n):
                total += basis[row, j] * basis[row, j]
            if total > longest:
                longest, which = total, row
        length = math.sqrt(longest)
        if not length > dependent:
            return kept
        b[kept], b[which] = b[which], b[kept]
        for j in range(n):
            A[kept, j], A[which, j] = A[which, j], A[kept, j]
            basis[kept, j], basis[which, j] = basis[which, j], basis[kept, j]
            basis[kept, j] /= length
        for row in range(kept + 1, m):
            total = 0.0
            for j in range(n):
                total += basis[row, j] * basis[kept, j]
            for j in range(n):
                basis[row, j] -= total * basis[kept, j]
    return min(m, n)
