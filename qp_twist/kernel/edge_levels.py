"""Levels that give way below others in a smooth step, compiled.

The readable version is ``control.edge_step``. This one takes regular levels, of which the first is
met; all other steps of several levels are left to the readable version.
"""

from __future__ import annotations

import math

from qp_twist.kernel.closest_levels import begin, closest, hold, length_of_rows, residual, verified
from qp_twist.kernel.closest_levels import gap as gap_of
from qp_twist.kernel.compiling import plain
from qp_twist.kernel.dual_active_set import SOLVED, active_set, cholesky_inverse
from qp_twist.kernel.edge_rows import BEND, rotate
from qp_twist.kernel.edge_step import NULL_SHARE, excess, joint_cost, largest_cost, relaxed_cost
from qp_twist.kernel.null_space import row_space, times_q, times_q_transposed
from qp_twist.kernel.verified_program import PRIORITIZED, REFUSED, SCALED, clip_to_bounds

_MET, _GIVES_WAY, _FAILED = 0, 1, 2
_BELOW = 2.0
"""ℓ of a level below others, in units of that of a first one: they bend the motion they leave."""
_BALANCED = 1e-9
"""Largest gradient that counts as zero, as a share of its terms."""


@plain
def _rotated(w, e, first, end):
    """Rotate the level's rows in ``e.rows`` and ``e.rate``; return the largest singular value."""
    rotate(e.rows[first:end], e.rate[first:end], e.forward[first:end], e.square[first:end])
    largest = 0.0
    for row in range(first, end):
        largest = max(largest, e.square[row])
    return math.sqrt(largest)


@plain
def _below(w, e, x, first, end, singularity):
    """Write the level's rows on what the levels above leave, rotated, and what is left of b.

    ``e.scaled`` receives the part of x that the levels above decide.

    Returns:
        The largest singular value of the rows as they are stated.
    """
    n = len(x)
    for row in range(first, end):
        e.rate[row] = e.forward[row] = 0.0
        for k in range(n):
            e.rows[row, k] = w.A[row, k]
    size = _rotated(w, e, first, end)
    rank = row_space(w.A[:first], e.project)
    V = e.project[:rank]
    for k in range(n):
        e.scaled[k] = x[k]
    times_q_transposed(V, e.scaled)
    for k in range(rank, n):
        e.scaled[k] = 0.0
    times_q(V, e.scaled)
    for row in range(first, end):
        e.rate[row] = w.b[row]
        for k in range(n):
            e.rows[row, k] = w.A[row, k]
            e.rate[row] -= w.A[row, k] * e.scaled[k]
        times_q_transposed(V, e.rows[row])
        for k in range(rank):
            e.rows[row, k] = 0.0
        times_q(V, e.rows[row])
    _rotated(w, e, first, end)
    for row in range(first, end):
        e.floor[row] = e.damped[row] = max(e.square[row], singularity * singularity)
    return size


@plain
def _is_balanced(w, p, count):
    """Whether the multipliers ``p.u`` balance the gradient of the cost in p at ``p.x``."""
    n, k, held = len(w.x), len(w.g), p.held_count[0]
    terms = 0.0
    for i in range(n):
        total = p.c[i]
        for j in range(n):
            total += p.H[i, j] * p.x[j]
            terms = max(terms, abs(p.H[i, j] * p.x[j]))
        p.previous[i] = total
        terms = max(terms, abs(p.c[i]))
    for place in range(count):
        which, u = p.active[place], p.u[place]
        if which < held:
            for i in range(n):
                p.previous[i] -= u * p.E[which, i]
        elif which < held + k:
            for i in range(n):
                p.previous[i] += u * w.G[which - held, i]
        elif which < held + k + n:
            p.previous[which - held - k] -= u
        else:
            p.previous[which - held - k - n] += u
    left = 0.0
    for i in range(n):
        left = max(left, abs(p.previous[i]))
    return left <= _BALANCED * terms


@plain
def _give_way(w, e, first, end, short, largest, singularity):
    """Move ``p.x`` to the damped least squares of a level; return whether that is verified."""
    p, none = w.levels, len(w.nothing)
    size = _below(w, e, e.start, first, end, singularity)
    more = _BELOW * BEND * size * short
    weight = NULL_SHARE * excess(more, size) / largest
    for k in range(len(w.x)):
        e.motion[k] = e.scaled[k]
    relaxed_cost(e, w.c, e.rate, first, end, more, weight, p.H, p.c)
    if not cholesky_inverse(p.H, p.J):
        return False
    held = p.held_count[0]
    status, count = active_set(
        p.c, p.E[:held], p.e[:held], w.G, w.g, p.lengths, w.lower, w.upper, p.active, none, p.x,
        p.u, p.J, p.R, p.held, p.work,
    )  # fmt: skip
    return status == SOLVED and _is_balanced(w, p, count) and clip_to_bounds(p.x, w.lower, w.upper)


@plain
def _take_level(w, e, first, end, dt, largest, singularity, tolerances):
    """Meet a level, or relax it, and hold the result."""
    p = w.levels
    longest, speed = length_of_rows(w.A, w.b, first, end)
    tolerance, furthest = tolerances.equality * (longest + speed), 0.0
    for i in range(len(w.x)):
        e.start[i] = p.x[i]
        furthest = max(furthest, abs(p.x[i]))
    terms = longest * (1.0 + furthest) + speed
    before = residual(w.A, w.b, p.x, first, end, p.r)
    negligible = longest * (tolerances.held * before + tolerances.dust * terms)
    count, left = closest(w, p, first, end, longest, 0)
    length = residual(w.A, w.b, p.x, first, end, p.r)
    if count < 0 or not gap_of(w, p, left, length) <= 10.0 * tolerance:
        return _FAILED
    held = p.held_count[0]
    for i in range(len(w.x)):
        e.fixed[i] = p.fixed[i]
    hold(w, p, first, end, count, negligible)
    if length <= tolerance:
        return _MET
    p.held_count[0] = held
    for i in range(len(w.x)):
        p.fixed[i] = int(e.fixed[i])
    if not _give_way(w, e, first, end, dt * length, largest, singularity):
        return _FAILED
    hold(w, p, first, end, 0, negligible)
    return _GIVES_WAY


@plain
def edge_levels(g, w, e, dt):
    """Compute a step whose first level is met and a lower one is not.

    Args:
        g: Inputs of the step.
        w: Its program, which ``step_kernel.step`` found infeasible; it receives the result.
        e: ``edge_rows.EdgeArrays``.
        dt: Length of the step, s.

    Returns:
        ``PRIORITIZED``, verified, or ``SCALED`` if the first level is braked; ``REFUSED`` if the
        reference has to compute the step.
    """
    p, tolerances, outcome, gave_way = w.levels, g.tolerances, _MET, False
    begin(w, p)
    joint_cost(w, e)
    largest = largest_cost(w)
    for level in range(len(g.ends)):
        first, end = g.ends[level - 1] if level > 0 else 0, g.ends[level]
        if end == first:
            continue
        outcome = _take_level(
            w, e, first, end, dt, largest, g.settings.singularity, tolerances
        )  # fmt: skip
        if outcome == _FAILED or (outcome == _GIVES_WAY and level == 0):
            return REFUSED
        if gave_way:  # the limits in the way of the first level that gives way are named
            for i in range(len(w.sensitivity)):
                w.sensitivity[i] = e.sensitivity[i]
        elif outcome == _GIVES_WAY:
            gave_way = True
            for i in range(len(w.sensitivity)):
                e.sensitivity[i] = w.sensitivity[i]
    if not gave_way:
        return REFUSED
    if outcome == _MET and not verified(w, p, tolerances):
        return REFUSED
    if outcome == _GIVES_WAY:
        for i in range(len(w.x)):
            w.x[i] = p.x[i]
    w.sensitivity[0] = w.braking[0]
    return SCALED if w.braking[0] < 1.0 else PRIORITIZED
