"""A step whose levels do not all fit inside the limits, or of which one is near a singularity.

The readable version, with the formulas, is ``qp.one_program`` and ``control.solving``.
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import inner, plain
from qp_twist.kernel.constants import EQUALITY_TOLERANCE, WHOLE
from qp_twist.kernel.copying import put, put_rows
from qp_twist.kernel.directions import (
    Directions,
    directions,
    free_of,
    motion_of,
    rotate,
    stopping_share,
    weakness,
)
from qp_twist.kernel.levels import in_order, missed, size_of_rows
from qp_twist.kernel.null_space import row_space, times_q, times_q_transposed
from qp_twist.kernel.one_program import OPTIMAL, Result, cost_along, first_level
from qp_twist.kernel.step_kernel import costs, desired_velocities, forward_rows, stated_rows
from qp_twist.kernel.step_record import (
    BRAKED,
    BRAKED_BELOW,
    DONE,
    FADED,
    PRIORITIZED,
    REFUSED,
    RELAX,
    RELAXED,
    SCALED,
)


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
def _level(s, index, first, end, V, rank, above, dt):
    """The directions of a level, braked; the share of its speed, and the joint that decides."""
    n, size = len(above), 0.0
    A, b, ahead = s.A[first:end].copy(), s.b[first:end].copy(), s.ahead[first:end].copy()
    stated, square = np.zeros((len(b), n + 1)), np.zeros(len(b))
    put_rows(A, stated)
    put(b, stated[:, n])
    if index > 0:
        rotate(A, np.zeros((len(b), 0)), square)
        for i in range(len(b)):
            size = max(size, math.sqrt(square[i]))
        put_rows(s.A[first:end], A)
        _left_by(V, rank, A, b, above)
    damp = s.settings.damps_by_error > 0.0
    d = directions(A, b, ahead, stated, size, dt, s.settings.singularity, damp)
    share, which = 1.0, 0
    if s.settings.braking > 0.0:
        motion = np.zeros(n)
        motion_of(d, 1.0, motion)
        for k in range(n):
            motion[k] *= dt
        share, which = stopping_share(motion, s.limits, s.types, dt)
    for i in range(len(b)):
        taken = (1.0 - share) * (s.b[first + i] - s.ahead[first + i])
        s.b[first + i] -= taken
        s.eased[first + i] = taken if index > 0 else 0.0
        taken = (1.0 - share) * (d.stated[i, n] - d.ahead[i])
        d.rate[i] -= taken
        d.stated[i, n] -= taken
    return d, share, which


@inner
def _all_levels(s, dt):
    """The directions of all levels, braked, one level after the other; with s.b and s.braking."""
    n, m = len(s.x), len(s.b)
    d = Directions(
        np.zeros((m, n)), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m),
        np.zeros(m), np.zeros((m, n + 1)),
    )  # fmt: skip
    above, motion, V, rank = np.zeros(n), np.zeros(n), np.zeros((n, n)), 0
    forward_rows(s)
    s.braking[0], s.braking[1] = 1.0, 0.0
    for index in range(len(s.ends)):
        first, end = s.ends[index - 1] if index > 0 else 0, s.ends[index]
        level, share, which = _level(s, index, first, end, V, rank, above, dt)
        if index == 0:
            s.braking[0] = share
        if s.braking[1] == 0.0:
            s.braking[1] = which
        motion_of(level, 0.0, motion)
        above += motion
        put_rows(level.rows, d.rows[first:])
        put_rows(level.stated, d.stated[first:])
        put(level.rate, d.rate[first:])
        put(level.square, d.square[first:])
        put(level.floor, d.floor[first:])
        put(level.damped, d.damped[first:])
        put(level.slack, d.slack[first:])
        if len(s.ends) > 1:
            rank = row_space(d.rows[:end], V)
    return d


@inner
def edge_step(s, qpos, dt, use_secondary, twist_space, is_infeasible):
    """Compute the step that ``step_kernel.step`` found at the edge or infeasible.

    Its bounds and inequality rows are set; ``is_infeasible``: whether it was found so with regular
    rows. Any outcome but ``REFUSED`` is verified.
    """
    levels, end = len(s.ends), s.ends[0]
    stated_rows(s, dt)
    desired_velocities(s, qpos, dt, use_secondary)
    if not costs(s, twist_space):
        return REFUSED
    d, c = _all_levels(s, dt), s.c.copy()
    top = Directions(
        d.rows[:end], d.rate[:end], d.ahead[:end], d.square[:end], d.floor[:end], d.damped[:end],
        d.slack[:end], d.stated[:end],
    )  # fmt: skip
    free_of(top, c)
    found, scale, relaxed = first_level(
        s.H, c, top, s.G, s.g, s.lower, s.upper, not is_infeasible or levels > 1,
        s.settings.infeasible != RELAX, s.settings.smooth > 0.0,
    )  # fmt: skip
    closest = found.status != OPTIMAL
    if closest and s.settings.smooth > 0.0:
        return REFUSED
    if closest:
        found = Result(
            OPTIMAL, np.zeros(len(s.x)), s.b.copy(), np.zeros(len(s.g)), np.zeros(len(s.x))
        )
        for i in range(len(s.x)):
            found.x[i] = min(max(0.0, s.lower[i]), s.upper[i])
    put(found.x[: len(s.x)], s.x)
    put(found.box[: len(s.x)], s.box)
    put(found.lam, s.lam)
    outcome = RELAXED if relaxed > 0.0 else SCALED
    if relaxed == 0.0 and scale >= WHOLE:
        outcome, scale = DONE, 1.0
    if levels > 1 or closest:
        ordered = _in_order(s, d, found, outcome, scale, closest)
        if ordered.status != OPTIMAL:
            return REFUSED
        put(ordered.x[: len(s.x)], s.x)
        if outcome != SCALED:  # then the limits in the way are those of the scale
            put(ordered.box[: len(s.x)], s.box)
            put(ordered.lam, s.lam)
        if outcome == DONE and not _lower_met(s):
            outcome = PRIORITIZED
    return _described(s, top, outcome, scale)


@plain
def _lower_met(s):
    """Whether the levels below the first are met as they are stated."""
    ends = s.ends
    for level in range(1, len(ends)):
        A, b = s.A[ends[level - 1] : ends[level]], s.b[ends[level - 1] : ends[level]]
        longest, largest = size_of_rows(A, b)
        longest = longest if longest > 0.0 else 1.0
        if missed(A, b, s.x) > EQUALITY_TOLERANCE * (longest + largest):
            return False
    return True


@plain
def _described(s, top, outcome, scale):
    """Write the scale and the multipliers; return the outcome with braking and what is lost."""
    n, end = len(s.x), len(top.rate)
    for i in range(n):
        s.sensitivity[1 + i] = s.box[i]
    for row in range(len(s.g)):
        s.sensitivity[1 + n + row] = s.lam[row]
    for i in range(end):
        s.b[i] *= scale
    s.sensitivity[0] = scale * s.braking[0]
    s.lacks[0] = 1.0 if _delivers_less(top, s.A[:end], s.b[:end], s.x, scale) else 0.0
    if outcome == DONE and s.lacks[0] > 0.0:
        return FADED
    if outcome in (DONE, PRIORITIZED) and s.braking[0] < 1.0:
        return BRAKED if outcome == DONE else SCALED
    if outcome == DONE and s.braking[1] != 0.0:
        return BRAKED_BELOW
    return outcome


@plain
def _delivers_less(d, A, b, x, scale):
    """Whether x lacks a part of what a weak direction is asked for (``qp.lost_directions``)."""
    longest, largest = size_of_rows(A, b)
    tolerance = EQUALITY_TOLERANCE * ((longest if longest > 0.0 else 1.0) + largest)
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
def _in_order(s, d, found, outcome, scale, closest):
    """The levels one after the other: weak directions have slacks, as in ``control.solving``."""
    n, m, weak, c = len(s.x), len(d.rate), 0, s.c.copy()
    free_of(d, c)
    for i in range(m):
        weak += _is_weak(d, i, s.settings.singularity)
    wide, cost, start = np.zeros((n + weak, n + weak)), np.zeros(n + weak), np.zeros(n + weak)
    low, high = np.full(n + weak, -math.inf), np.full(n + weak, math.inf)
    rows, rates, G, at = np.zeros((m, n + weak)), np.zeros(m), np.zeros((len(s.g), n + weak)), n
    put_rows(s.H, wide)
    put_rows(s.G, G)
    put_rows(d.stated[:, :n], rows)
    put(c, cost)
    put(found.x[:n], start)
    put(s.lower, low)
    put(s.upper, high)
    put(d.stated[:, n], rates)
    for i in range(m):
        if _is_weak(d, i, s.settings.singularity):
            rows[i, at], wide[at, at] = -math.sqrt(d.slack[i]), cost_along(s.H, d, i)
            at += 1
    for i in range(s.ends[0]):
        phi = weakness(d, i)
        if outcome == SCALED:
            rates[i] *= phi + scale * (1.0 - phi)
        elif outcome == RELAXED and d.slack[i] == 0.0 and not closest:
            rates[i] = 0.0
            for k in range(n):
                rates[i] += d.rows[i, k] * found.x[k]
    return in_order(wide, cost, rows, rates, s.ends, G, s.g, low, high, start, s.gaps)
