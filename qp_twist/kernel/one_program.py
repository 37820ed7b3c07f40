"""The program of a step, solved and verified, compiled: ``qp.one_program``, ``qp.verification``."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from qp_twist.kernel.compiling import inner, kernel, plain
from qp_twist.kernel.constants import (
    BEYOND,
    BOUND_TOLERANCE,
    CURVED,
    DEAD,
    EQUALITY_TOLERANCE,
    GAIN_TOLERANCE,
    GAP_TOLERANCE,
    LARGEST,
    LEAST_MOTION,
    OF_COSTS,
    OPTIMALITY_TOLERANCE,
    ROUNDING,
    SCALE_BACKOFF,
    SOFT,
    STILL,
    WORTH,
)
from qp_twist.kernel.copying import put, put_rows
from qp_twist.kernel.directions import weakness
from qp_twist.kernel.dual_active_set import (
    NO_ROOM,
    NOT_CONVEX,
    SOLVED,
    Program,
    Work,
    active_set,
    factorise,
    hold_rows,
    lower_solve,
    multipliers,
)

OPTIMAL, EMPTY, FAILED = 0, 1, 2
"""Outcome of a program: verified; the constraints leave no room; not verified."""


Result = namedtuple("Result", "status x y lam box")
"""The solution of a program and its multipliers: Hx + c + Aᵀy + Gᵀλ + μ = 0."""
ProgramSolution = namedtuple("ProgramSolution", "found x y z z_box")
"""A solution that nobody has verified, with its multipliers, named as in qpsolvers."""


@inner
def allocated(n, m, k):
    """The workspace of a program of n unknowns, m rows of A and k of G; y, λ and μ."""
    squares, counts = np.empty((2, n, n)), np.zeros(k + 4 * n + m, dtype=np.int64)
    vectors, numbers, own = np.zeros((8, n + 1)), np.empty(m + 2 * k + n), counts[2 * n :]
    w = Work(
        vectors[0, :n], vectors[1], counts[:n], own[m:], squares[0], counts[n : 2 * n],
        np.empty((m, n)), own[:m], np.empty((n, n + 1)), squares[1], vectors[2:],
        numbers[m + k + n :],
    )  # fmt: skip
    return w, numbers[:m], numbers[m : m + k], numbers[m + k : m + k + n]


@plain
def minimise(p, w, y, lam, box):
    """Minimise from a cold start; write the multipliers."""
    if not factorise(p.H, p.G, w.L, w.start, w.lengths):
        return NOT_CONVEX
    free = hold_rows(p.A, p.b, w.L, w.start, w.V, w.rows, w.N, w.vectors)
    for i in range(len(w.held)):
        w.held[i] = 0
    status, count = active_set(0, free, p, w)
    multipliers(count, free, p, w, y, lam, box)
    return status


@plain
def solve_in(p, w, y, lam, box):
    """:func:`minimise`, inside the bounds and verified: ``OPTIMAL``, ``EMPTY`` or ``FAILED``."""
    status, x = minimise(p, w, y, lam, box), w.x
    if status != SOLVED:
        return EMPTY if status == NO_ROOM else FAILED
    for i in range(len(x)):
        x[i] = min(max(x[i], p.lower[i]), p.upper[i])
        if not math.isfinite(x[i]):
            return FAILED
    return OPTIMAL if excess_of(p, w, x, y, lam, box) <= 1.0 else FAILED


@kernel
def solve_program(H, c, A, b, G, g, lower, upper):
    """:func:`minimise`, for Python."""
    w, y, lam, box = allocated(len(c), len(b), len(g))
    p = Program(H, c, A, b, G, g, lower, upper)
    return ProgramSolution(minimise(p, w, y, lam, box) == SOLVED, w.x, y, lam, box)


@inner
def solve(H, c, A, b, G, g, lower, upper):
    """:func:`solve_in`, in new arrays."""
    w, y, lam, box = allocated(len(c), len(b), len(g))
    p = Program(H, c, A, b, G, g, lower, upper)
    return Result(solve_in(p, w, y, lam, box), w.x, y, lam, box)


@plain
def _residual(A, b, x, i):
    """A x − b of a row, and the sum of its terms' sizes."""
    total, terms = -b[i], abs(b[i])
    for j in range(len(x)):
        total += A[i, j] * x[j]
        terms += abs(A[i, j] * x[j])
    return total, terms


@plain
def excess_of(p, w, x, y, lam, box):
    """Largest error of optimality or feasibility, in units of its tolerance (``qp.verification``).

    L of H = LLᵀ serves the duality gap.
    """
    n, hardest, steepest, furthest, left, held = len(x), 1e-300, 0.0, 0.0, 0.0, 0.0
    slope, pull, push, most = w.vectors[3], w.vectors[4], w.vectors[5], 0.0
    for i in range(n):
        steepest, furthest = max(steepest, abs(p.c[i])), max(furthest, abs(x[i]))
        most = max(most, abs(p.c[i]), abs(box[i]))
        total = p.c[i] + box[i]
        for j in range(n):
            hardest = max(hardest, abs(p.H[i, j]))
            total += p.H[i, j] * x[j]
        slope[i], pull[i], push[i] = total, 0.0, 0.0
        if box[i] > 0.0:
            held += box[i] * (p.upper[i] - x[i])
        elif box[i] < 0.0:
            held -= box[i] * (x[i] - p.lower[i])
    gap, largest_b, off, over, lost = held, 0.0, 0.0, 0.0, 0.0
    for row in range(len(y)):
        total, _ = _residual(p.A, p.b, x, row)
        gap -= y[row] * total
        off, largest_b = max(off, abs(total)), max(largest_b, abs(p.b[row]))
        for i in range(n):
            pull[i] += y[row] * p.A[row, i]
    for row in range(len(lam)):
        total, terms = _residual(p.G, p.g, x, row)
        over = max(over, total)
        if lam[row] > 0.0:
            gap -= lam[row] * total
            held += lam[row] * max(-total, 0.0)
            lost += ROUNDING * lam[row] * terms
            for i in range(n):
                push[i] += lam[row] * p.G[row, i]
    for i in range(n):
        slope[i] += pull[i] + push[i]
        left, most = max(left, abs(slope[i])), max(most, abs(pull[i]), abs(push[i]))
    lower_solve(w.L, w.start, slope)
    for i in range(n):
        gap += 0.5 * slope[i] * slope[i]
    reach = 1.0 + furthest
    cost = (hardest * reach + steepest) * reach
    worst = max(off / (EQUALITY_TOLERANCE * (1.0 + largest_b)), over / (BOUND_TOLERANCE * reach))
    worst = max(worst, left / (OPTIMALITY_TOLERANCE * hardest * reach + ROUNDING * most))
    worst = max(worst, held / (GAIN_TOLERANCE * cost + lost))
    return max(worst, gap / (GAP_TOLERANCE * cost + lost))


@plain
def add_weak_row(row, rate, weight, H, c):
    """Add ½ weight (row x − rate)² to a cost."""
    for i in range(len(c)):
        c[i] -= weight * rate * row[i]
        for j in range(len(c)):
            H[i, j] += weight * row[i] * row[j]


@plain
def largest_entry(H):
    """The largest entry of a quadratic cost."""
    largest = 0.0
    for i in range(len(H)):
        for j in range(len(H)):
            largest = max(largest, abs(H[i, j]))
    return largest if largest > 0.0 else 1.0


@plain
def cost_along(H, d, i):
    """hᵢ = vᵢᵀ H vᵢ, the cost of moving along a direction."""
    total, n = 0.0, d.rows.shape[1]
    for j in range(n):
        for k in range(n):
            total += d.rows[i, j] * H[j, k] * d.rows[i, k]
    return total / d.square[i] if d.square[i] > 0.0 else largest_entry(H)


@inner
def posed_program(H, c, d, scale, G, g, lower, upper):
    """The result of the program at a given scale."""
    n, m, hard, at = len(c), len(d.rate), 0, 0
    for i in range(m):
        hard += d.slack[i] == 0.0
    softer, cost, rows, rates = H.copy(), c.copy(), np.zeros((hard, n)), np.zeros(hard)
    for i in range(m):
        phi = weakness(d, i)
        rate = (phi + scale * (1.0 - phi)) * d.rate[i]
        if d.slack[i] > 0.0:
            weight = cost_along(H, d, i) / d.slack[i]
            add_weak_row(d.rows[i], rate, weight, softer, cost)
        else:
            put(d.rows[i], rows[at])
            rates[at] = rate
            at += 1
    return solve(softer, cost, rows, rates, G, g, lower, upper)


@plain
def allowed(d, lower, upper):
    """The largest s ≤ 1 at which the bounds allow each exact direction."""
    longest, largest, share = 0.0, 0.0, 1.0
    for i in range(len(d.rate)):
        longest = max(longest, math.sqrt(d.square[i]))
        largest = max(largest, abs(d.rate[i]) if d.slack[i] == 0.0 else 0.0)
    for i in range(len(d.rate)):
        if d.slack[i] > 0.0 or d.rate[i] == 0.0:
            continue
        room = EQUALITY_TOLERANCE * (longest + largest)
        for k in range(d.rows.shape[1]):
            along = d.rows[i, k] if d.rate[i] > 0.0 else -d.rows[i, k]
            if along > 0.0:
                room += along * upper[k]
            elif along < 0.0:
                room += along * lower[k]
        share = min(share, room / abs(d.rate[i]))
    return max(share, 0.0)


@inner
def scaled_program(H, c, d, G, g, lower, upper, smooth):
    """The program with the scale: its result, s, and what a unit of its multipliers is of s.

    ``c`` is already that in the null space of the directions d.
    """
    n, m, size = len(c), len(d.rate), largest_entry(H)
    motion, speed, hard = np.zeros(n), 0.0, 0
    for i in range(m):
        if d.damped[i] > 0.0:
            gain = d.rate[i] / d.damped[i]
            for k in range(n):
                motion[k] += gain * d.rows[i, k]
        hard += d.slack[i] == 0.0
    for i in range(n):
        for j in range(n):
            speed += motion[i] * H[i, j] * motion[j]
    most = min(BEYOND * allowed(d, lower, upper), 1.0)
    worth = (WORTH if smooth else LARGEST) * max(most * most * speed, LEAST_MOTION * size)
    whole = math.sqrt(CURVED * worth / size)
    unit, price = most / whole, worth * (1.0 + CURVED) / whole
    wide, cost = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
    low, high = np.zeros(n + 1), np.zeros(n + 1)
    put(c, cost)
    put(lower, low)
    put(upper, high)
    put_rows(H, wide)
    wide[n, n], cost[n], high[n] = size, -price, whole
    rows, rates, row, at = np.zeros((hard, n + 1)), np.zeros(hard), np.zeros(n + 1), 0
    for i in range(m):
        phi = weakness(d, i)
        put(d.rows[i], row)
        row[n] = -(1.0 - phi) * d.rate[i] * unit
        if d.slack[i] > 0.0:
            weight = cost_along(H, d, i) / d.slack[i]
            add_weak_row(row, phi * d.rate[i], weight, wide, cost)
        else:
            put(row, rows[at])
            rates[at] = phi * d.rate[i]
            at += 1
    wider = np.zeros((len(g), n + 1))
    put_rows(G, wider)
    found = solve(wide, cost, rows, rates, wider, g, low, high)
    return found, min(found.x[n] * unit, 1.0), unit / price


@inner
def relaxed_program(H, c, d, G, g, lower, upper):
    """The result of the program in which all directions yield."""
    largest = 0.0
    for i in range(len(d.rate)):
        largest = max(largest, d.square[i])
    softer, cost = H.copy(), c.copy()
    for i in range(len(d.rate)):
        slack = d.slack[i] + SOFT * max(largest, 1e-12)
        add_weak_row(d.rows[i], d.rate[i], cost_along(H, d, i) / slack, softer, cost)
    none = np.zeros((0, len(c)))
    return solve(softer, cost, none, np.zeros(0), G, g, lower, upper)


@plain
def _progress(d, scaled, relaxed):
    """p_s/p_r: what a scaled solution makes of the task beside the relaxed one."""
    slow, free, whole = 0.0, 0.0, 0.0
    for i in range(len(d.rate)):
        along = (1.0 - weakness(d, i)) * d.rate[i]
        whole += d.rate[i] * d.rate[i]
        for k in range(d.rows.shape[1]):
            slow += along * d.rows[i, k] * scaled[k]
            free += along * d.rows[i, k] * relaxed[k]
    return slow / max(slow, free, STILL * whole, 1e-300)


@inner
def _at_scale(H, c, d, scaled, scale, per, G, g, lower, upper):
    """The result at the largest scale less a share of 1e-8, clear of the very edge.

    Of the multipliers those of the scale remain: what the cost alone would make of them is no more
    than its own gradient.
    """
    slope = 0.0
    for i in range(len(c)):
        total = c[i]
        for j in range(len(c)):
            total += H[i, j] * scaled.x[j]
        slope = max(slope, abs(total) * per)
    for i in range(len(c)):
        scaled.box[i] = scaled.box[i] if abs(scaled.box[i]) > OF_COSTS * slope else 0.0
    for row in range(len(g)):
        scaled.lam[row] = scaled.lam[row] if scaled.lam[row] > OF_COSTS * slope else 0.0
    slower = scale * (1.0 - SCALE_BACKOFF)
    found = posed_program(H, c, d, slower, G, g, lower, upper)
    if found.status == OPTIMAL:
        put(found.x, scaled.x)
        scale = slower
    return scaled, scale, 0.0


@inner
def first_level(H, c, d, G, g, lower, upper, whole, scales, smooth):
    """Solve a first level: its result, s, and the share of the relaxed result in it.

    ``whole``: whether it has not been solved as posed before; ``smooth``: whether weak directions
    are damped. If not, a level that does not fit at any scale is to be solved in order.

    The result's status is ``EMPTY`` if no velocity keeps the limits. Multipliers of a scaled one
    are those of s.
    """
    if whole:
        posed = posed_program(H, c, d, 1.0, G, g, lower, upper)
        if posed.status == OPTIMAL:
            return posed, 1.0, 0.0
    scaled, scale = Result(EMPTY, c, c, g, c), 0.0
    if scales:
        scaled, scale, per = scaled_program(H, c, d, G, g, lower, upper, smooth)
        if scaled.status == OPTIMAL:
            for i in range(len(scaled.box)):
                scaled.box[i] *= per
            for row in range(len(g)):
                scaled.lam[row] *= per
            if not smooth:
                return _at_scale(H, c, d, scaled, scale, per, G, g, lower, upper)
            if scale >= DEAD:
                return scaled, scale, 0.0
    if not smooth:
        return scaled, 1.0, 1.0
    relaxed = relaxed_program(H, c, d, G, g, lower, upper)
    if scaled.status != OPTIMAL:
        return relaxed, 1.0, 1.0
    share = 1.0 - max(scale, _progress(d, scaled.x, relaxed.x)) / DEAD
    if share <= 0.0 or relaxed.status != OPTIMAL:
        return scaled, scale, 0.0
    for i in range(len(c)):
        x = scaled.x[i] + share * (relaxed.x[i] - scaled.x[i])
        relaxed.x[i] = min(max(x, lower[i]), upper[i])
    return relaxed, 1.0, share
