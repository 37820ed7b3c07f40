"""Priority levels one after the other inside the limits, compiled.

The readable version is ``qp.levels``.
"""

from __future__ import annotations

import math

import numpy as np

from qp_twist.kernel.compiling import inner, plain
from qp_twist.kernel.constants import DUST, EQUALITY_TOLERANCE, HELD
from qp_twist.kernel.copying import put
from qp_twist.kernel.dual_active_set import (
    SOLVED,
    Program,
    active_set,
    factorise,
    hold_initial,
    hold_rows,
)
from qp_twist.kernel.one_program import FAILED, OPTIMAL, Result, allocated, excess_of, minimise

_PROXIMAL = 1e-4
"""Proximal weight ε, as a share of the longest row."""
_ROUNDS, _USUAL, _SHARPEST = 40, 5, 128.0
"""Largest number of proximal iterations; after a handful, which is usual, the weight is divided by
4 in each, down to ``_SHARPEST``⁻² of it: limits may leave directions with very small singular
values, in which an iteration moves by the share σ²/(σ² + ε²) of what is left."""
_SETTLED = 1e-15
"""Share of its terms below which a gradient counts as zero."""


@plain
def size_of_rows(A, b):
    """The longest row and the largest right-hand side."""
    longest, largest = 0.0, 0.0
    for row in range(len(b)):
        square = 0.0
        for i in range(A.shape[1]):
            square += A[row, i] * A[row, i]
        longest, largest = max(longest, math.sqrt(square)), max(largest, abs(b[row]))
    return longest, largest


@plain
def missed(A, b, x):
    """‖A x − b‖."""
    square = 0.0
    for row in range(len(b)):
        total = -b[row]
        for i in range(len(x)):
            total += A[row, i] * x[i]
        square += total * total
    return math.sqrt(square)


@inner
def _closest(A, b, E, e, G, g, lower, upper, x, active, u):
    r"""Move x to the least-squares solution of a level subject to the held rows E x = e.

    .. math::

        \mathbf x \leftarrow \arg\min \tfrac12\lVert\mathbf A\mathbf x - \mathbf b\rVert^2
        + \tfrac12\varepsilon^2\lVert\mathbf x - \mathbf x_{before}\rVert^2

    until it converges (the proximal point method; Rockafellar, SIAM J. Control Optim. 14, 1976),
    with a decreasing ε. Returned are the number of active constraints, −1 on failure, and the
    remaining gradient; ``active`` and ``u`` receive their numbers and multipliers.
    """
    n, left, weight, free, count = len(x), math.inf, math.inf, 0, 0
    H, c, before = np.empty((n, n)), np.empty(n), np.empty(n)
    w, _, _, _ = allocated(n, len(e), len(g))
    p = Program(H, c, E, e, G, g, lower, upper)
    longest, _ = size_of_rows(A, b)
    for turn in range(_ROUNDS):
        sharper = min(max(1.0, 2.0 ** (turn - _USUAL)), _SHARPEST)
        known, weight = weight, (_PROXIMAL / sharper * longest) ** 2
        terms = 0.0
        for i in range(n):
            c[i] = -weight * x[i]
            for j in range(n):
                H[i, j] = weight if i == j else 0.0
            for row in range(len(b)):
                c[i] -= A[row, i] * b[row]
                for j in range(n):
                    H[i, j] += A[row, i] * A[row, j]
            before[i] = x[i]
            terms = max(terms, abs(c[i]))
        if weight != known:  # it begins with the constraints active in the last iteration
            if not factorise(H, G, w.L, w.start, w.lengths):
                return -1, left
            free = hold_rows(E, e, w.L, w.start, w.V, w.rows, w.N, w.vectors)
            count = hold_initial(count, free, p, w)
        status, count = active_set(count, free, p, w)
        if status != SOLVED:
            return -1, left
        left = 0.0
        for i in range(n):
            x[i] = min(max(w.x[i], lower[i]), upper[i])
            if not math.isfinite(x[i]):
                return -1, left
            left = max(left, weight * abs(x[i] - before[i]))
        if left <= _SETTLED * terms:
            break
    put(w.active, active)
    put(w.u, u)
    return count, left


@plain
def _gap(x, lower, upper, left, length):
    """Bound of a level's residual length less that at its optimum.

    ``left`` is the largest entry of the gradient of ½‖A x − b‖² that no multiplier balances.
    """
    gained = 0.0
    for i in range(len(x)):
        gained += left * min(upper[i] - lower[i], 2.0 * (1.0 + abs(x[i])))
    gap = min(length, math.sqrt(2.0 * gained))
    return min(gap, gained / length) if length > 0.0 else gap


@inner
def in_order(H, c, A, b, ends, G, g, lower, upper, start, gaps):
    r"""Minimise the levels' residuals in order of priority, then the cost, inside the limits.

    .. math::

        \operatorname{lex\,min}\; \lVert\mathbf A_1\mathbf x - \mathbf b_1\rVert,\;
        \lVert\mathbf A_2\mathbf x - \mathbf b_2\rVert, \dots,\;
        \tfrac12\mathbf x^T\mathbf H\mathbf x + \mathbf c^T\mathbf x
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\;
        \mathbf G\mathbf x \le \mathbf g

    The value A x that a level achieves and its active constraints become equality rows for the
    levels below. Each level is verified by the gradient that its multipliers do not balance, the
    final program as any other.

    ``ends`` are the indices after the last row of each level in A (m, n), ``start`` is a point
    inside the bounds, ``gaps`` receive bounds of how much longer each level's residual is than at
    its optimum. Returned is the result with the multipliers of the limits in the way of the first
    level that gives way.
    """
    n, k, held = len(c), len(g), 0
    E, e = np.zeros((len(b) + n + k, n)), np.zeros(len(b) + n + k)
    low, high, x = lower.copy(), upper.copy(), start.copy()
    named = Result(FAILED, x, np.zeros(0), np.zeros(k), np.zeros(n))
    active, u, gave_way = np.zeros(n, dtype=np.int64), np.zeros(n + 1), False
    for level in range(len(ends)):
        first = ends[level - 1] if level > 0 else 0
        rows, sides = A[first : ends[level]], b[first : ends[level]]
        gaps[level] = 0.0
        if len(sides) == 0:
            continue
        tolerance, negligible = _sizes(rows, sides, x)
        count, left = _closest(rows, sides, E[:held], e[:held], G, g, lower, upper, x, active, u)
        length = missed(rows, sides, x)
        gaps[level] = _gap(x, lower, upper, left, length)
        if count < 0 or not gaps[level] <= 10.0 * tolerance:
            return named
        held = _hold(
            rows, G, g, lower, upper, x, active[:count], u, negligible, E, e, held, low, high,
            named, gave_way,
        )  # fmt: skip
        gave_way = gave_way or length > tolerance
    status = _least_cost(H, c, E[:held], e[:held], G, g, lower, upper, low, high, x)
    return Result(status, x, named.y, named.lam, named.box)


@plain
def _sizes(A, b, x):
    """The length of A x − b that counts as zero, and the multiplier that does."""
    longest, largest = size_of_rows(A, b)
    furthest = 1.0
    for i in range(len(x)):
        furthest = max(furthest, 1.0 + abs(x[i]))
    terms = longest * furthest + largest
    negligible = longest * (HELD * missed(A, b, x) + DUST * terms)
    return EQUALITY_TOLERANCE * (longest + largest), negligible


@inner
def _hold(
    A, G, g, lower, upper, x, active, u, negligible, E, e, held, low, high, named, gave_way
):  # fmt: skip
    """Add a level's rows at x, and its active constraints, to the held rows; return their number.

    A constraint is active if its multiplier exceeds ``negligible``; the multipliers of the first
    level that gives way are named.
    """
    n, k = len(x), len(g)
    for place in range(len(active)):
        which, multiplier = active[place], u[place]
        if not multiplier > negligible:
            continue
        if which < k:
            put(G[which], E[held])
            e[held] = g[which]
            if not gave_way:
                named.lam[which] = multiplier
        else:
            dof, is_upper = (which - k) % n, which >= k + n
            for i in range(n):
                E[held, i] = 1.0 if i == dof else 0.0
            e[held] = upper[dof] if is_upper else lower[dof]
            low[dof] = high[dof] = e[held]
            if not gave_way:
                named.box[dof] = multiplier if is_upper else -multiplier
        held += 1
    for row in range(len(A)):
        put(A[row], E[held])
        e[held] = 0.0
        for i in range(n):
            e[held] += A[row, i] * x[i]
        held += 1
    return held


@inner
def _least_cost(H, c, E, e, G, g, lower, upper, low, high, x):
    """Move x to the point of least cost on the held rows, verified with the held bounds fixed."""
    w, y, lam, box = allocated(len(c), len(e), len(g))
    p = Program(H, c, E, e, G, g, lower, upper)
    if minimise(p, w, y, lam, box) != SOLVED:
        return FAILED
    for i in range(len(x)):
        x[i] = min(max(w.x[i], low[i]), high[i])
    p = Program(H, c, E, e, G, g, low, high)
    return OPTIMAL if excess_of(p, w, x, y, lam, box) <= 1.0 else FAILED
