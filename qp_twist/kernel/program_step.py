"""Solve and verify a quadratic program whose arrays the caller provides, compiled."""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import kernel, plain
from qp_twist.kernel.directions import directions, free_of
from qp_twist.kernel.one_program import EMPTY, OPTIMAL, first_level, solve
from qp_twist.kernel.step_kernel import take
from qp_twist.kernel.step_record import read_program
from qp_twist.kernel.verified_program import (
    DONE,
    INFEASIBLE,
    REFUSED,
    SCALED,
    well_conditioned,
)


@plain
def _take_costs(H, c, lift, steepest, dt, w):
    """Write H + lift·1 and c/dt; return whether they are finite and c is small enough."""
    hardest, largest, finite = 0.0, 0.0, True
    for i in range(len(c)):
        w.c[i] = c[i] / dt
        largest = max(largest, abs(w.c[i]))
        finite &= abs(w.c[i]) < math.inf  # false for NaN
        for j in range(len(c)):
            w.H[i, j] = H[i, j]
            hardest = max(hardest, abs(H[i, j]))
            finite &= abs(H[i, j]) < math.inf
        w.H[i, i] += lift
        hardest = max(hardest, abs(w.H[i, i]))
        finite &= abs(w.H[i, i]) < math.inf
    return finite and largest <= steepest * hardest


@plain
def _take_box(box, unlimited, w):
    """Write the bounds, ±∞ beyond ``unlimited``; return whether they are feasible."""
    for i in range(len(w.x)):
        low, high = box[0, i], box[1, i]
        if not low <= high or low > unlimited or high < -unlimited:
            return False
        w.lower[i] = low if low >= -unlimited else -math.inf
        w.upper[i] = high if high <= unlimited else math.inf
        w.lower_kind[i], w.upper_kind[i] = box[2, i], box[3, i]
    return True


@kernel
def program_step(
    H, c, lift, steepest, dt, A, b, box, rows, ends, unlimited, floats, integers, level_ends,
    threshold, tolerances,
):  # fmt: skip
    """Copy a program into ``floats``, solve and verify it.

    Args:
        H: Quadratic cost, (nv, nv), positive definite once ``lift`` is added to its diagonal.
        c: Linear cost of a displacement, (nv,).
        lift: Damping.
        steepest: Largest linear cost, relative to the largest quadratic one.
        dt: Length of the step, s.
        A: Equality rows, (≥ m, nv), with m of the program's sizes.
        b: Their right-hand side, (≥ m,), m/s or rad/s.
        box: Lower and upper bounds and the kind of each, (4, nv): see ``gather_bounds_and_rows``.
        rows: Inequality rows, (≥ k, nv).
        ends: Their right-hand side, (≥ k,).
        unlimited: A bound beyond it counts as infinite.
        floats: Memory of ``step_record.Program``.
        integers: The same; its table comes first.
        level_ends: Number of rows of the only level, (1,).
        threshold: Singular value of the equality rows below which the reference slows a direction
            down; 0 for never. Dependent rows that are consistent count once.
        tolerances: Of the verification.

    Returns:
        ``DONE``, ``INFEASIBLE``, or ``REFUSED`` if the step is not solved inside all
        limits for any other reason.
    """
    w = read_program(floats, integers, integers)
    w.sensitivity[0] = 1.0
    w.braking[0], w.braking[1] = 1.0, 0.0
    if not (_take_box(box, unlimited, w) and _take_costs(H, c, lift, steepest, dt, w)):
        return REFUSED
    for row in range(len(w.b)):
        w.b[row], w.eased[row] = b[row], 0.0
        for j in range(len(w.x)):
            w.A[row, j] = A[row, j]
    for row in range(len(w.g)):
        w.g[row] = ends[row]
        for j in range(len(w.x)):
            w.G[row, j] = rows[row, j]
    if threshold > 0.0 and not well_conditioned(w.A, level_ends, threshold, w.R, w.J):
        return REFUSED
    found = solve(w.H, w.c, w.A, w.b, w.G, w.g, w.lower, w.upper, tolerances)
    if found.status != OPTIMAL:
        return INFEASIBLE if found.status == EMPTY and len(w.b) > 0 else REFUSED
    take(w, found)
    return DONE


@kernel
def scaled_step(floats, integers, tolerances):
    """Scale, solve and verify a program for which :func:`program_step` returned ``INFEASIBLE``.

    Returns:
        ``SCALED`` or ``REFUSED``.
    """
    w = read_program(floats, integers, integers)
    m, c = len(w.b), w.c.copy()
    d = directions(w.A, w.b, np.zeros(m), np.zeros((m, 0)), 0.0, 1.0, 0.0, False)
    for i in range(m):
        # Rows contradict each other: the reference meets their consistent part.
        if d.square[i] == 0.0 and abs(d.rate[i]) > tolerances.equality:
            return REFUSED
    free_of(d, c)
    found, scale, relaxed = first_level(
        w.H.copy(), c, d, w.G, w.g, w.lower, w.upper, False, True, False, tolerances
    )
    if found.status != OPTIMAL or relaxed > 0.0:
        return REFUSED
    w.sensitivity[0] = scale
    for i in range(len(w.x)):
        w.x[i], w.sensitivity[1 + i] = found.x[i], found.box[i]
    for row in range(len(w.g)):
        w.sensitivity[1 + len(w.x) + row] = found.lam[row]
    for i in range(len(w.b)):
        w.b[i] *= scale
    return SCALED
