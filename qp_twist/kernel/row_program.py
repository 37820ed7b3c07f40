"""The program of mink's ``solve_ik``, whose limits are rows, solved and verified, compiled."""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import entry, kernel, plain
from qp_twist.kernel.constants import EQUALITY_TOLERANCE, FASTEST, STEEPEST, UNLIMITED
from qp_twist.kernel.copying import put
from qp_twist.kernel.directions import directions, free_of, well_conditioned
from qp_twist.kernel.one_program import EMPTY, FAILED, OPTIMAL, Result, first_level, solve


@plain
def _picks(P, dofs):
    """Whether row i of P (k, nv) is the unit vector of degree of freedom ``dofs[i]``."""
    for i in range(len(dofs)):
        if not 0 <= dofs[i] < P.shape[1]:
            return False
        for j in range(P.shape[1]):
            if P[i, j] != (1.0 if j == dofs[i] else 0.0):
                return False
    return True


@plain
def _narrow(box, j, low, high):
    """Make a bound as narrow; NaN stays, to be refused."""
    if low > box[0, j] or math.isnan(low):
        box[0, j] = low
    if high < box[1, j] or math.isnan(high):
        box[1, j] = high


@entry
def add_bounds(q, low, high, qpos, dofs, P, gain, dt, box):
    """Narrow ``box`` (2, nv) by a limit of mink's on single joints; false if P has other rows.

    Of a ``ConfigurationLimit``, ``qpos`` (nv,) are the places of all degrees of freedom in q; of a
    ``VelocityLimit`` there are none, and ``high`` are the speeds.
    """
    if not _picks(P, dofs):
        return False
    for i in range(len(dofs)):
        below = above = dt * high[i]
        if len(qpos) > 0:
            at = qpos[dofs[i]]
            below, above = gain * (q[at] - low[at]), gain * (high[at] - q[at])
        _narrow(box, dofs[i], -below / dt, above / dt)
    return True


@plain
def _sort_rows(G, h, dt, rows, ends, box):
    """Sort rows G Δq ≤ h into bounds, of one entry, and others, without those that always hold.

    Returned is the number of others; −1 if a number is none, or too large to compute with.
    """
    lower, upper, count = box[0], box[1], 0
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
            put(G[i], rows[count])
            ends[count] = end
            count += 1
    for j in range(len(lower)):
        if not lower[j] <= upper[j] or lower[j] > UNLIMITED or upper[j] < -UNLIMITED:
            return -1
        lower[j] = lower[j] if lower[j] >= -UNLIMITED else -math.inf
        upper[j] = upper[j] if upper[j] <= UNLIMITED else math.inf
    return count


@plain
def _sum_costs(W, e, level, damping, H, c, dt):
    """Add the cost ½‖W Δq − e‖² and the dampings to H and c, and make of c that of a velocity.

    Returned is whether all numbers can be computed with.
    """
    n, hardest, largest, finite = len(c), 0.0, 0.0, True
    for row in range(len(e)):
        finite = finite and abs(e[row]) < math.inf
        for i in range(n):
            entry = W[row, i]
            if entry != 0.0:  # rows of a posture have one
                c[i] -= entry * e[row]
                for j in range(i + 1):
                    H[i, j] += entry * W[row, j]
    for i in range(n):
        H[i, i] += level + (damping[i] if len(damping) > 0 else 0.0)
        c[i] /= dt
        largest = max(largest, abs(c[i]))
        finite = finite and abs(c[i]) < math.inf  # false for NaN
        for j in range(i + 1):
            H[j, i] = H[i, j]
            hardest = max(hardest, abs(H[i, j]))
            finite = finite and abs(H[i, j]) < math.inf
    return finite and largest <= STEEPEST * hardest


@plain
def _slow_enough(b):
    """Whether no entry asks for more than ``FASTEST``; false for NaN."""
    slow = True
    for rate in b:
        slow = slow and abs(rate) <= FASTEST
    return slow


@kernel
def solve_rows(W, e, level, damping, H, c, A, b, G, h, box, dt, threshold, scales):
    """Solve and verify a program; if A q̇ = b does not fit and ``scales``, A q̇ = s b.

    The cost of a displacement is ½‖W Δq − e‖² + ½ Δqᵀ(H + level + diag(damping))Δq + cᵀΔq, with
    ``damping`` (nv,) or (0,) for none; H, of which the lower half is read, and c are changed. The
    limits are rows G Δq ≤ h (k, nv) and the bounds ``box`` (2, nv) of the velocity, which is
    changed. Dependent rows of A that are consistent count once; where one of its singular values
    is below ``threshold`` the program is left to the reference.

    Returned are whether it is solved, q̇ (nv,), s, the multipliers of the bounds, and of the rows
    with more than one entry; those of a scaled program are of s. What is not solved the reference
    has to solve, or to name what is wrong with it.
    """
    m, lower, upper = len(b), box[0], box[1]
    rows, ends = np.empty(G.shape), np.empty(len(h))
    count = _sort_rows(G, h, dt, rows, ends, box)
    fine = count >= 0 and _slow_enough(b) and _sum_costs(W, e, level, damping, H, c, dt)
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
