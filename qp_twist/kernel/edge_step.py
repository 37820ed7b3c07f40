"""A step whose levels do not all fit inside the limits, or of which one is near a singularity.

The readable version, with the formulas, is ``qp.one_program`` and ``control.solving``.
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import inner, plain
from qp_twist.kernel.directions import (
    Directions,
    directions,
    free_of,
    motion_of,
    stopping_share,
    weakness,
)
from qp_twist.kernel.levels import in_order, missed, size_of_rows
from qp_twist.kernel.null_space import row_space, times_q, times_q_transposed
from qp_twist.kernel.one_program import OPTIMAL, Result, cost_along, first_level
from qp_twist.kernel.step_kernel import (
    RELAX,
    costs,
    desired_velocities,
    forward_rows,
    stated_rows,
    take,
)
from qp_twist.kernel.verified_program import (
    BRAKED,
    BRAKED_BELOW,
    DONE,
    FADED,
    PRIORITIZED,
    REFUSED,
    RELAXED,
    SCALED,
)

WHOLE = 1.0 - 1e-8
"""As in ``control.solving``."""


@plain
def _left_by(V, rank, A, b, above):
    """Reduce rows A (m, n) to what the levels above leave, and b (m,) to what these do not do."""
    for row in range(len(b)):
        for k in range(A.shape[1]):
            b[row] -= A[row, k] * above[k]
        times_q_transposed(V[:rank], A[row])
        for k in range(rank):
            A[row, k] = 0.0
        times_q(V[:rank], A[row])


@inner
def _level(g, w, index, first, end, ahead, V, rank, above, dt):
    """The directions of a level, braked: and the share of its speed and the joint that decides."""
    n, epsilon, size = len(above), g.settings.singularity, 0.0
    A, b, front = w.A[first:end].copy(), w.b[first:end].copy(), ahead[first:end].copy()
    stated = np.zeros((len(b), n + 1 if index > 0 else 0))
    if index > 0:
        whole = directions(A, b, front, stated, 0.0, dt, epsilon, False)
        for i in range(len(b)):
            size = max(size, math.sqrt(whole.square[i]))
        _left_by(V, rank, A, b, above)
    d = directions(A, b, front, stated, size, dt, epsilon, g.settings.trusts > 0.0)
    share, which = 1.0, 0
    if g.settings.braking > 0.0:
        motion = np.zeros(n)
        motion_of(d, 1.0, motion)
        for k in range(n):
            motion[k] *= dt
        share, which = stopping_share(motion, g.limits, g.types, dt)
    for i in range(len(b)):
        asked = w.b[first + i]
        w.b[first + i] = share * (asked - ahead[first + i]) + ahead[first + i]
        w.eased[first + i] = asked - w.b[first + i] if index > 0 else 0.0
        b[i] += w.b[first + i] - asked
        if index > 0:
            stated[i, :n], stated[i, n] = w.A[first + i], w.b[first + i]
    if index > 0 or share < 1.0:  # the rotation is that of A, and so the same
        braked = directions(A, b, front, stated, size, dt, epsilon, False)
        d.rate[:] = braked.rate
        d = Directions(d.rows, d.rate, d.ahead, d.square, d.floor, d.damped, d.slack, braked.stated)
    return d, share, which


@inner
def _all_levels(g, w, dt):
    """The directions of all levels, braked, one level after the other; with w.b and w.braking."""
    n, m = len(w.x), len(w.b)
    d = Directions(
        np.zeros((m, n)), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m),
        np.zeros(m), np.zeros((m, n + 1)),
    )  # fmt: skip
    ahead, above, motion = np.zeros(m), np.zeros(n), np.zeros(n)
    V, rank = np.zeros((n, n)), 0
    forward_rows(g, ahead)
    w.braking[0], w.braking[1] = 1.0, 0.0
    for index in range(len(g.ends)):
        first, end = g.ends[index - 1] if index > 0 else 0, g.ends[index]
        level, share, which = _level(g, w, index, first, end, ahead, V, rank, above, dt)
        if index == 0:
            w.braking[0] = share
        if w.braking[1] == 0.0:
            w.braking[1] = which
        motion_of(level, 0.0, motion)
        above += motion
        for i in range(end - first):
            d.rows[first + i] = level.rows[i]
            d.rate[first + i], d.square[first + i] = level.rate[i], level.square[i]
            d.floor[first + i], d.damped[first + i] = level.floor[i], level.damped[i]
            d.slack[first + i] = level.slack[i]
            d.stated[first + i, :n] = level.rows[i] if index == 0 else level.stated[i, :n]
            d.stated[first + i, n] = level.rate[i] if index == 0 else level.stated[i, n]
        if len(g.ends) > 1:
            rank = row_space(d.rows[:end], V)
    return d


@inner
def edge_step(g, w, qpos, dt, use_secondary, twist_space, is_infeasible):
    """Compute the step that ``step_kernel.step`` found at the edge or infeasible.

    Args:
        g: Inputs of the step.
        w: Its program, whose bounds and inequality rows are set; it receives the result.
        qpos: q, (nq,).
        dt: Length of the step, s.
        use_secondary: Whether the secondary acts.
        twist_space: ``None`` for the joint-space cost.
        is_infeasible: Whether it was found infeasible with regular rows.

    Returns:
        ``DONE``, ``FADED``, ``BRAKED``, ``BRAKED_BELOW``, ``PRIORITIZED``, ``SCALED`` or
        ``RELAXED``, verified; ``REFUSED`` if the reference has to compute the step.
    """
    levels, end = len(g.ends), g.ends[0]
    stated_rows(g, dt, w.A, w.b, w.free)
    desired_velocities(
        qpos, g.addresses, g.middle, g.stiffness, g.displacement, dt, use_secondary, w.q, w.c
    )
    if not costs(w, g.metric, g.quadratic, g.linear, g.settings, twist_space):
        return REFUSED
    d, c = _all_levels(g, w, dt), w.c.copy()
    top = Directions(
        d.rows[:end], d.rate[:end], d.ahead[:end], d.square[:end], d.floor[:end], d.damped[:end],
        d.slack[:end], d.stated[:end],
    )  # fmt: skip
    free_of(top, c)
    found, scale, relaxed = first_level(
        w.H, c, top, w.G, w.g, w.lower, w.upper, not is_infeasible or levels > 1,
        g.settings.infeasible != RELAX, g.settings.smooth > 0.0, g.tolerances,
    )  # fmt: skip
    closest = found.status != OPTIMAL
    if closest and g.settings.smooth > 0.0:
        return REFUSED
    if closest:
        found = Result(OPTIMAL, np.zeros(len(w.x)), w.b.copy(), w.g * 0.0, np.zeros(len(w.x)))
        for i in range(len(w.x)):
            found.x[i] = min(max(0.0, w.lower[i]), w.upper[i])
    take(w, found)
    outcome = RELAXED if relaxed > 0.0 else SCALED
    if relaxed == 0.0 and scale >= WHOLE:
        outcome, scale = DONE, 1.0
    if levels > 1 or closest:
        ordered, _ = _in_order(g, w, d, found, outcome, scale, closest)
        if ordered.status != OPTIMAL:
            return REFUSED
        for i in range(len(w.x)):
            w.x[i] = ordered.x[i]
            w.box[i] = w.box[i] if outcome == SCALED else ordered.box[i]
        if outcome != SCALED:  # then the limits in the way are those of the scale
            w.lam[:] = ordered.lam
        if outcome == DONE and not _lower_met(w, g.ends, g.tolerances):
            outcome = PRIORITIZED
    return _described(g, w, top, outcome, scale)


@plain
def _lower_met(w, ends, tolerances):
    """Whether the levels below the first are met as they are stated."""
    for level in range(1, len(ends)):
        A, b = w.A[ends[level - 1] : ends[level]], w.b[ends[level - 1] : ends[level]]
        longest, largest = size_of_rows(A, b)
        longest = longest if longest > 0.0 else 1.0
        if missed(A, b, w.x) > tolerances.equality * (longest + largest):
            return False
    return True


@plain
def _described(g, w, top, outcome, scale):
    """Write the scale and the multipliers; return the outcome with braking and what is lost."""
    n, end = len(w.x), len(top.rate)
    for i in range(n):
        w.sensitivity[1 + i] = w.box[i]
    for row in range(len(w.g)):
        w.sensitivity[1 + n + row] = w.lam[row]
    for i in range(end):
        w.b[i] *= scale
    w.sensitivity[0] = scale * w.braking[0]
    w.lacks[0] = 1.0 if _delivers_less(top, w.A[:end], w.b[:end], w.x, scale, g.tolerances) else 0.0
    if outcome == DONE and w.lacks[0] > 0.0:
        return FADED
    if outcome in (DONE, PRIORITIZED) and w.braking[0] < 1.0:
        return BRAKED if outcome == DONE else SCALED
    if outcome == DONE and w.braking[1] != 0.0:
        return BRAKED_BELOW
    return outcome


@plain
def _delivers_less(d, A, b, x, scale, tolerances):
    """Whether x lacks a part of what a weak direction is asked for (``qp.lost_directions``)."""
    longest, largest = size_of_rows(A, b)
    tolerance = tolerances.equality * ((longest if longest > 0.0 else 1.0) + largest)
    for i in range(len(b)):
        missing = scale * d.rate[i]
        for k in range(len(x)):
            missing -= d.rows[i, k] * x[k]
        if d.slack[i] > 0.0 and abs(missing) > tolerance:
            return True
    return False


@plain
def _is_weak(d, i, singularity):
    """As ``Directions.weak`` in ``qp.directions``."""
    rounding = d.square[i] == 0.0 and d.floor[i] > singularity * singularity
    return d.slack[i] > 0.0 and not rounding


@inner
def _in_order(g, w, d, found, outcome, scale, closest):
    """The levels one after the other: weak directions have slacks, as in ``control.solving``."""
    n, m, weak, c = len(w.x), len(d.rate), 0, w.c.copy()
    free_of(d, c)
    for i in range(m):
        weak += _is_weak(d, i, g.settings.singularity)
    wide, cost, start = np.zeros((n + weak, n + weak)), np.zeros(n + weak), np.zeros(n + weak)
    low, high = np.full(n + weak, -math.inf), np.full(n + weak, math.inf)
    rows, rates, G, at = np.zeros((m, n + weak)), np.zeros(m), np.zeros((len(w.g), n + weak)), n
    wide[:n, :n], cost[:n], start[:n] = w.H, c, found.x[:n]
    low[:n], high[:n], G[:, :n], rows[:, :n] = w.lower, w.upper, w.G, d.stated[:, :n]
    rates[:] = d.stated[:, n]
    for i in range(m):
        if _is_weak(d, i, g.settings.singularity):
            rows[i, at], wide[at, at] = -math.sqrt(d.slack[i]), cost_along(w.H, d, i)
            at += 1
    for i in range(g.ends[0]):
        phi = weakness(d, i)
        if outcome == SCALED:
            rates[i] *= phi + scale * (1.0 - phi)
        elif outcome == RELAXED and d.slack[i] == 0.0 and not closest:
            rates[i] = 0.0
            for k in range(n):
                rates[i] += d.rows[i, k] * found.x[k]
    return in_order(
        wide, cost, rows, rates, g.ends, G, w.g, low, high, start, w.levels.gaps, g.tolerances
    )
