"""What the levels of a step achieve where they do not fit inside the limits, compiled.

The readable statement is ``qp.levels``. This one takes levels of equality rows that do not depend
on each other; whatever else does not fit is left to that one.
"""

from __future__ import annotations

import math

from qp_twist.fast.compiling import plain
from qp_twist.fast.dual_active_set import SOLVED, active_set, cholesky_inverse, row_lengths
from qp_twist.fast.verified_program import (
    PRIORITIZED,
    REFUSED,
    RELAXED,
    excess_of,
    into_the_box,
    no_multipliers,
)

_PROXIMAL = 1e-4
"""ε, as a share of the longest row: so far a singular value counts less than the last point."""
_ROUNDS = 40
"""Far more than the handful in which the points settle."""
_SETTLED = 1e-15
"""A gradient that counts as none, as a share of its terms."""
_IS_MET, _GIVES_WAY, _NOT_PROVEN = 0, 1, 2
"""What comes of a level."""
_OF_A_LEVEL, _BOUND, _ROW = 0, 1, 2
"""Where a row comes from that is held."""


@plain
def _length_of_rows(A, b, first, end):
    """The longest row and the largest right-hand side of a level."""
    longest, largest = 0.0, 0.0
    for row in range(first, end):
        square = 0.0
        for i in range(A.shape[1]):
            square += A[row, i] * A[row, i]
        longest, largest = max(longest, math.sqrt(square)), max(largest, abs(b[row]))
    return longest, largest


@plain
def _residual(A, b, x, first, end, r):
    """r = A x − b of a level; its length."""
    square = 0.0
    for row in range(first, end):
        total = -b[row]
        for i in range(len(x)):
            total += A[row, i] * x[i]
        r[row] = total
        square += total * total
    return math.sqrt(square)


@plain
def _closest(w, p, first, end, longest):
    r"""Move ``p.x`` to the least squares of a level among the points that ``held`` rows leave.

    .. math::

        \mathbf x \leftarrow \arg\min \tfrac12\lVert\mathbf A\mathbf x - \mathbf b\rVert^2
        + \tfrac12\varepsilon^2\lVert\mathbf x - \mathbf x_{before}\rVert^2

    until it stays (the proximal point method; Rockafellar, SIAM J. Control Optim. 14, 1976).

    Returns:
        How many constraints are active, −1 where there is no point; what is left of the gradient.
    """
    n, weight, held = len(w.x), (_PROXIMAL * longest) ** 2, p.many[0]
    count, left, none = 0, math.inf, len(w.nothing)
    for _ in range(_ROUNDS):
        for i in range(n):
            p.c[i] = -weight * p.x[i]
            for j in range(n):
                p.H[i, j] = weight if i == j else 0.0
        for row in range(first, end):
            for i in range(n):
                p.c[i] -= w.A[row, i] * w.b[row]
                for j in range(n):
                    p.H[i, j] += w.A[row, i] * w.A[row, j]
        terms = 0.0
        for i in range(n):
            p.before[i] = p.x[i]
            terms = max(terms, abs(p.c[i]))
        if not cholesky_inverse(p.H, p.J):
            return -1, left
        status, count = active_set(
            p.c, p.E[:held], p.e[:held], w.G, w.g, p.lengths, w.lower, w.upper, p.active, none, p.x,
            p.u, p.J, p.R, p.held, p.work,
        )  # fmt: skip
        if status != SOLVED or not into_the_box(p.x, w.lower, w.upper):
            return -1, left
        left = 0.0
        for i in range(n):
            left = max(left, weight * abs(p.x[i] - p.before[i]))
        if left <= _SETTLED * terms:
            break
    return count, left


@plain
def _hold(w, p, first, end, count, dust):
    """Hold what a level achieves at ``p.x``, and what stands in its way."""
    n, k, m = len(w.x), len(w.g), p.many[0]
    held = m
    for place in range(count):
        which, multiplier = p.active[place], p.u[place]
        if which < m or not multiplier > dust:
            continue
        for i in range(n):
            p.E[held, i] = 0.0
        if which < m + k:
            at, sign = 1 + n + which - m, 1.0
            p.origins[held, 0], p.origins[held, 1] = _ROW, which - m
            for i in range(n):
                p.E[held, i] = w.G[which - m, i]
            p.e[held] = w.g[which - m]
        else:
            dof = (which - m - k) % n
            is_upper = which >= m + k + n
            at, sign = 1 + dof, 1.0 if is_upper else -1.0
            p.E[held, dof] = 1.0
            p.origins[held, 0], p.origins[held, 1] = _BOUND, dof
            p.e[held] = w.upper[dof] if is_upper else w.lower[dof]
            p.fixed[dof] = 1
        held += 1
        if w.gains[at] == 0.0:
            w.gains[at] = sign * multiplier
    for row in range(first, end):
        p.e[held] = 0.0
        p.origins[held, 0], p.origins[held, 1] = _OF_A_LEVEL, row
        for i in range(n):
            p.E[held, i] = w.A[row, i]
            p.e[held] += w.A[row, i] * p.x[i]
        held += 1
    p.many[0] = held


@plain
def _gap(w, p, left, length):
    """By how much a level's residual may be longer than at its optimum.

    ``left`` is the largest entry of the gradient of ½‖A x − b‖² that no multiplier explains.
    """
    gained = 0.0
    for i in range(len(w.x)):
        gained += left * min(w.upper[i] - w.lower[i], 2.0 * (1.0 + abs(p.x[i])))
    gap = min(length, math.sqrt(2.0 * gained))
    return min(gap, gained / length) if length > 0.0 else gap


@plain
def _with_costs(w, p):
    """The point of least cost that all levels leave into ``w``; whether there is one."""
    n, held, none = len(w.x), p.many[0], len(w.nothing)
    for i in range(n):
        for j in range(n):
            p.J[i, j] = w.J[i, j] if len(w.h) == 0 else 0.0
        if len(w.h):
            p.J[i, i] = 1.0 / math.sqrt(w.h[i])
    status, count = active_set(
        w.c, p.E[:held], p.e[:held], w.G, w.g, p.lengths, w.lower, w.upper, p.active, none, w.x,
        p.u, p.J, p.R, p.held, p.work,
    )  # fmt: skip
    if status == SOLVED:
        _take_multipliers(w, p, count)
    return status == SOLVED


@plain
def _take_multipliers(w, p, count):
    """Those of ``p.u`` into y, μ and λ.

    What is held is met whichever way it pulls, so that its multipliers may have any sign.
    """
    n, k, held = len(w.x), len(w.g), p.many[0]
    no_multipliers(w)
    for place in range(count):
        which, u = p.active[place], p.u[place]
        if which < held:
            kind, number = p.origins[which, 0], p.origins[which, 1]
            if kind == _OF_A_LEVEL:
                w.y[number] = -u
            elif kind == _BOUND:
                w.box[number] -= u
            else:
                w.lam[number] -= u
        elif which < held + k:
            w.lam[which - held] += u
        elif which < held + k + n:
            w.box[which - held - k] -= u
        else:
            w.box[which - held - k - n] += u


@plain
def _verified(w, p, tolerances):
    """The velocity into ``w.x``; whether it is the optimum on what is held, and inside all limits.

    For that look the rows ask for what they get, and bounds that are held leave no room.
    """
    n = len(w.x)
    for place in range(p.many[0]):
        if p.origins[place, 0] == _OF_A_LEVEL:
            row = p.origins[place, 1]
            p.asked[row], w.b[row] = w.b[row], p.e[place]
    for i in range(n):
        p.lower[i], p.upper[i] = w.lower[i], w.upper[i]
    found = _with_costs(w, p) and into_the_box(w.x, w.lower, w.upper)
    for i in range(n):
        if p.fixed[i]:
            w.lower[i] = w.upper[i] = w.x[i]
    found = found and excess_of(w, tolerances) <= 1.0
    for i in range(n):
        w.lower[i], w.upper[i] = p.lower[i], p.upper[i]
    for row in range(len(w.b)):
        w.b[row] = p.asked[row]
    return found


@plain
def _begin(w, p):
    """Nothing is held yet, and nothing stands in the way."""
    p.many[0] = 0
    for i in range(len(w.x)):
        p.x[i], p.fixed[i] = min(max(0.0, w.lower[i]), w.upper[i]), 0
    row_lengths(w.G, p.lengths)
    for i in range(len(w.gains)):
        w.gains[i] = 1.0 if i == 0 else 0.0


@plain
def _take_level(w, p, level, first, end, tolerances):
    """Come as close to a level as can be, and hold it; whether it is met, or not proven."""
    longest, largest = _length_of_rows(w.A, w.b, first, end)
    tolerance, furthest = tolerances.equality * (longest + largest), 0.0
    for i in range(len(w.x)):
        furthest = max(furthest, abs(p.x[i]))
    terms = longest * (1.0 + furthest) + largest
    before = _residual(w.A, w.b, p.x, first, end, p.r)
    dust = longest * (tolerances.held * before + tolerances.dust * terms)
    p.gaps[level] = 0.0
    if end == first:
        return _IS_MET
    count, left = _closest(w, p, first, end, longest)
    length = _residual(w.A, w.b, p.x, first, end, p.r)
    p.gaps[level] = _gap(w, p, left, length)
    if count < 0 or not p.gaps[level] <= 10.0 * tolerance:
        return _NOT_PROVEN
    _hold(w, p, first, end, count, dust)
    return _IS_MET if length <= tolerance else _GIVES_WAY


@plain
def closest_levels(w, ends, relaxes, tolerances):
    r"""Level after level as close as the limits and the levels above let it come, then the costs.

    .. math::

        \operatorname{lex\,min}\; \lVert\mathbf A_1\mathbf x - \mathbf b_1\rVert,\;
        \lVert\mathbf A_2\mathbf x - \mathbf b_2\rVert, \dots,\;
        \tfrac12\mathbf x^T\mathbf H\mathbf x + \mathbf c^T\mathbf x
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\;
        \mathbf G\mathbf x \le \mathbf g

    What a level achieves, and the constraints that pull on it, are held below it. Every level is
    verified by the gradient that its multipliers leave, the last program as any other.

    Args:
        w: ``step_record.Program`` as :func:`~qp_twist.fast.verified_program.solved_program` leaves
            it where there is no room. Results are those of a step, and in ``gains`` the
            multipliers of what stands in a level's way.
        ends: Where the rows of each level end, (levels,).
        relaxes: Whether the first level may give way.
        tolerances: Of the verification.

    Returns:
        ``PRIORITIZED`` or ``RELAXED``; ``REFUSED`` where the reference has to look.
    """
    p, status, all_met = w.levels, PRIORITIZED, True
    _begin(w, p)
    for level in range(len(ends)):
        outcome = _take_level(
            w, p, level, ends[level - 1] if level > 0 else 0, ends[level], tolerances
        )
        if outcome == _NOT_PROVEN or (outcome == _GIVES_WAY and level == 0 and not relaxes):
            return REFUSED
        if outcome == _GIVES_WAY:
            all_met, status = False, RELAXED if level == 0 else status
    return status if not all_met and _verified(w, p, tolerances) else REFUSED
