"""The program of mink's ``solve_ik``, whose limits are rows, solved and verified, compiled."""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import kernel, plain
from qp_twist.kernel.constants import EQUALITY_TOLERANCE, FASTEST, STEEPEST, UNLIMITED
from qp_twist.kernel.directions import directions, free_of, well_conditioned
from qp_twist.kernel.one_program import EMPTY, FAILED, OPTIMAL, Result, first_level, solve


@plain
def _sort_rows(G, h, dt, rows, ends, lower, upper):
    """Sort rows G Δq ≤ h into bounds, of one entry, and others, without those that always hold.

    Returns:
        The number of other rows; −1 if a number is none, or too large to compute with.
    """
    count = 0
    for i in range(len(h)):
        end, entries, last = h[i] / dt, 0, 0
        for j in range(G.shape[1]):
            if G[i, j] != 0.0:
                if not abs(G[i, j]) <= UNLIMITED:
                    return -1
                entries, last = entries + 1, j
        if not end > -math.inf:
            return -1
        if end > UNLIMITED:
            end = math.inf
        if entries == 1 and G[i, last] > 0.0:
            upper[last] = min(upper[last], end / G[i, last])
        elif entries == 1:
            lower[last] = max(lower[last], end / G[i, last])
        elif (entries > 1 and end < math.inf) or (entries == 0 and end < 0.0):
            for j in range(G.shape[1]):
                rows[count, j] = G[i, j]
            ends[count] = end
            count += 1
    for j in range(len(lower)):
        if not lower[j] <= upper[j] or lower[j] > UNLIMITED or upper[j] < -UNLIMITED:
            return -1
    return count


@plain
def _take_costs(W, e, H, c, damping, dt):
    """Add WᵀW and the damping, (nv,), to H, and Wᵀe to c, of a velocity; false if not usable."""
    hardest, largest, finite = 0.0, 0.0, True
    for row in range(len(e)):
        finite = finite and abs(e[row]) < math.inf
        for i in range(len(c)):
            if W[row, i] != 0.0:  # rows of a task have few: the joints that move its frame
                c[i] -= W[row, i] * e[row]
                for j in range(len(c)):
                    H[i, j] += W[row, i] * W[row, j]
    for i in range(len(c)):
        H[i, i] += damping[i]
        c[i] /= dt
        largest = max(largest, abs(c[i]))
        finite = finite and abs(c[i]) < math.inf  # false for NaN
        for j in range(len(c)):
            hardest = max(hardest, abs(H[i, j]))
            finite = finite and abs(H[i, j]) < math.inf
    return finite and largest <= STEEPEST * hardest


@kernel
def solve_rows(W, e, H, c, damping, A, b, G, h, dt, threshold, scales):
    """Solve and verify a program; if A q̇ = b does not fit and ``scales``, A q̇ = s b.

    The cost of a displacement is ½‖W Δq − e‖², with W (p, nv), and that of H, c and ``damping``,
    for the diagonal of H; these are changed. Rows G Δq ≤ h (k, nv) are those of the limits.
    Dependent rows of A that are consistent count once; where one of its singular values is below
    ``threshold`` the program is left to the reference.

    Returned are whether it is solved, q̇ (nv,), s, the multipliers of the bounds, and of the rows
    with more than one entry; those of a scaled program are of s. What is not solved the reference
    has to solve, or to name what is wrong with it.
    """
    n, m = len(c), len(b)
    lower, upper = np.full(n, -math.inf), np.full(n, math.inf)
    rows, ends = np.empty(G.shape), np.empty(len(h))
    count = _sort_rows(G, h, dt, rows, ends, lower, upper)
    fine = count >= 0 and _take_costs(W, e, H, c, damping, dt)
    for i in range(m):
        fine = fine and abs(b[i]) <= FASTEST
    if fine and threshold > 0.0:
        work, scratch = np.empty((m, m)), np.empty((m, m))
        fine = well_conditioned(A, np.array([m]), threshold, work, scratch)
    if not fine:
        return False, c, 1.0, c, h
    rows, ends, scale = rows[:count], ends[:count], 1.0
    found = solve(H, c, A, b, rows, ends, lower, upper)
    if found.status == EMPTY and m > 0 and scales:
        found, scale = _scaled(H, c, A, b, rows, ends, lower, upper)
    return found.status == OPTIMAL, found.x, scale, found.box, found.lam


@kernel
def _scaled(H, c, A, b, G, g, lower, upper):
    """The program at its largest scale; ``FAILED`` of rows that contradict each other."""
    n, m, cost = len(c), len(b), c.copy()
    d = directions(A, b, np.zeros(m), np.zeros((m, 0)), 0.0, 1.0, 0.0, False)
    for i in range(m):
        # The reference meets the consistent part.
        if d.square[i] == 0.0 and abs(d.rate[i]) > EQUALITY_TOLERANCE:
            return Result(FAILED, c, b, g, c), 1.0
    free_of(d, cost)
    found, scale, relaxed = first_level(H, cost, d, G, g, lower, upper, False, True, False)
    # Where the scale is an unknown of the program, it comes after the velocity.
    return Result(
        found.status if relaxed == 0.0 else FAILED, found.x[:n], b, found.lam, found.box[:n]
    ), scale
