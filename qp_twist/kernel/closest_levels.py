"""Least-squares solution of a step's priority levels that are infeasible, compiled.

The readable version is ``qp.levels``. This one only takes levels of linearly independent equality
rows; all other infeasible steps are left to the readable version.
"""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.dual_active_set import (
    SOLVED,
    active_set,
    cholesky_inverse,
    resumed_active_set,
    row_lengths,
)
from qp_twist.kernel.verified_program import (
    PRIORITIZED,
    REFUSED,
    RELAXED,
    clear_multipliers,
    clip_to_bounds,
    excess_of,
)

_PROXIMAL = 1e-4
"""Proximal weight ε, as a share of the longest row."""
_ROUNDS, _USUAL, _SHARPEST = 40, 5, 128.0
"""Largest number of proximal iterations; after a handful, which is usual, the weight is divided by
4 in each, down to ``_SHARPEST``⁻² of it: limits may leave directions with very small singular
values, in which an iteration moves by the share σ²/(σ² + ε²) of what is left."""
_SETTLED = 1e-15
"""Share of its terms below which a gradient counts as zero."""
_IS_MET, _NOT_MET, NOT_PROVEN = 0, 1, 2
"""Outcome of a level."""
_OF_A_LEVEL, _BOUND, _ROW = 0, 1, 2
"""Origin of a held row: a higher level, an active bound or an active inequality row."""


@plain
def length_of_rows(A, b, first, end):
    """The longest row and the largest right-hand side of a level."""
    longest, largest = 0.0, 0.0
    for row in range(first, end):
        square = 0.0
        for i in range(A.shape[1]):
            square += A[row, i] * A[row, i]
        longest, largest = max(longest, math.sqrt(square)), max(largest, abs(b[row]))
    return longest, largest


@plain
def residual(A, b, x, first, end, r):
    """Compute r = A x − b of a level; return its length."""
    square = 0.0
    for row in range(first, end):
        total = -b[row]
        for i in range(len(x)):
            total += A[row, i] * x[i]
        r[row] = total
        square += total * total
    return math.sqrt(square)


@plain
def _factorised(w, p, first, end, weight):
    """Write J with JJᵀ = H⁻¹, H = AᵀA + ``weight`` · 1; return whether H is positive definite."""
    n = len(w.x)
    for i in range(n):
        for j in range(n):
            p.H[i, j] = weight if i == j else 0.0
    for row in range(first, end):
        for i in range(n):
            for j in range(n):
                p.H[i, j] += w.A[row, i] * w.A[row, j]
    return cholesky_inverse(p.H, p.J)


@part
def _rows_in(active, count, held):
    """Number of equality rows, of which there are ``held``, in an active set."""
    rows = 0
    for place in range(count):
        if active[place] < held:
            rows += 1
    return rows


@plain
def closest(w, p, first, end, longest, count):
    r"""Move ``p.x`` to the least-squares solution of a level subject to the held rows.

    .. math::

        \mathbf x \leftarrow \arg\min \tfrac12\lVert\mathbf A\mathbf x - \mathbf b\rVert^2
        + \tfrac12\varepsilon^2\lVert\mathbf x - \mathbf x_{before}\rVert^2

    until it converges (the proximal point method; Rockafellar, SIAM J. Control Optim. 14, 1976),
    with a decreasing ε. It begins with the first ``count`` constraints of ``p.active``.

    Returns:
        The number of active constraints, −1 on failure; and the remaining gradient.
    """
    n, held, left = len(w.x), p.held_count[0], math.inf
    weight = math.inf
    for turn in range(_ROUNDS):
        sharper = min(max(1.0, 2.0 ** (turn - _USUAL)), _SHARPEST)
        known, weight = weight, (_PROXIMAL / sharper * longest) ** 2
        if weight != known and not _factorised(w, p, first, end, weight):
            return -1, left
        terms = 0.0
        for i in range(n):
            p.c[i] = -weight * p.x[i]
            for row in range(first, end):
                p.c[i] -= w.A[row, i] * w.b[row]
            p.previous[i] = p.x[i]
            terms = max(terms, abs(p.c[i]))
        if weight != known:  # it begins with the constraints active in the last iteration
            status, count = active_set(
                p.c, p.E[:held], p.e[:held], w.G, w.g, p.lengths, w.lower, w.upper, p.active,
                count, p.x, p.u, p.J, p.R, p.held, p.work,
            )  # fmt: skip
        else:  # with the same H, their factors remain
            status, count = resumed_active_set(
                _rows_in(p.active, count, held), count, p.c, p.E[:held], p.e[:held], w.G, w.g,
                p.lengths, w.lower, w.upper, p.active, p.x, p.u, p.J, p.R, p.held, p.work,
            )  # fmt: skip
        if status != SOLVED or not clip_to_bounds(p.x, w.lower, w.upper):
            return -1, left
        left = 0.0
        for i in range(n):
            left = max(left, weight * abs(p.x[i] - p.previous[i]))
        if left <= _SETTLED * terms:
            break
    return count, left


@plain
def hold(w, p, first, end, count, negligible):
    """Add the level's rows at ``p.x`` and its active constraints to the held rows.

    A constraint is active if its multiplier exceeds ``negligible``.
    """
    n, k, m = len(w.x), len(w.g), p.held_count[0]
    held = m
    for place in range(count):
        which, multiplier = p.active[place], p.u[place]
        if which < m or not multiplier > negligible:
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
        if w.sensitivity[at] == 0.0:
            w.sensitivity[at] = sign * multiplier
    for row in range(first, end):
        p.e[held] = 0.0
        p.origins[held, 0], p.origins[held, 1] = _OF_A_LEVEL, row
        for i in range(n):
            p.E[held, i] = w.A[row, i]
            p.e[held] += w.A[row, i] * p.x[i]
        held += 1
    p.held_count[0] = held


@plain
def gap(w, p, left, length):
    """Bound of a level's residual length less that at its optimum.

    ``left`` is the largest entry of the gradient of ½‖A x − b‖² that no multiplier balances.
    """
    gained = 0.0
    for i in range(len(w.x)):
        gained += left * min(w.upper[i] - w.lower[i], 2.0 * (1.0 + abs(p.x[i])))
    gap = min(length, math.sqrt(2.0 * gained))
    return min(gap, gained / length) if length > 0.0 else gap


@plain
def _with_costs(w, p):
    """Write the point of least cost subject to all held rows to ``w``; return whether it exists."""
    n, held, none = len(w.x), p.held_count[0], len(w.nothing)
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
    """Distribute the multipliers ``p.u`` to y, μ and λ.

    Held rows are equality constraints, so their multipliers may have either sign.
    """
    n, k, held = len(w.x), len(w.g), p.held_count[0]
    clear_multipliers(w)
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
def verified(w, p, tolerances):
    """Write the velocity to ``w.x``; return whether it is verified.

    It must be optimal subject to the held rows, and inside all limits. The check temporarily
    replaces b by the achieved A x, and fixes the held bounds.
    """
    n = len(w.x)
    for place in range(p.held_count[0]):
        if p.origins[place, 0] == _OF_A_LEVEL:
            row = p.origins[place, 1]
            p.desired[row], w.b[row] = w.b[row], p.e[place]
    for i in range(n):
        p.lower[i], p.upper[i] = w.lower[i], w.upper[i]
    found = _with_costs(w, p) and clip_to_bounds(w.x, w.lower, w.upper)
    for i in range(n):
        if p.fixed[i]:
            w.lower[i] = w.upper[i] = w.x[i]
    found = found and excess_of(w, tolerances) <= 1.0
    for i in range(n):
        w.lower[i], w.upper[i] = p.lower[i], p.upper[i]
    for row in range(len(w.b)):
        w.b[row] = p.desired[row]
    return found


@plain
def begin(w, p):
    """Start inside the bounds, with no held rows, scale 1 and zero multipliers."""
    p.held_count[0] = 0
    for i in range(len(w.x)):
        p.x[i], p.fixed[i] = min(max(0.0, w.lower[i]), w.upper[i]), 0
    row_lengths(w.G, p.lengths)
    for i in range(len(w.sensitivity)):
        w.sensitivity[i] = 1.0 if i == 0 else 0.0


@plain
def take_level(w, p, level, first, end, tolerances, guessed):
    """Minimise a level's residual and hold the result; return the outcome.

    ``guessed``: number of constraints in ``p.active`` that are probably active.
    """
    longest, largest = length_of_rows(w.A, w.b, first, end)
    tolerance, furthest = tolerances.equality * (longest + largest), 0.0
    for i in range(len(w.x)):
        furthest = max(furthest, abs(p.x[i]))
    terms = longest * (1.0 + furthest) + largest
    before = residual(w.A, w.b, p.x, first, end, p.r)
    negligible = longest * (tolerances.held * before + tolerances.dust * terms)
    p.gaps[level] = 0.0
    if end == first:
        return _IS_MET
    count, left = closest(w, p, first, end, longest, guessed)
    length = residual(w.A, w.b, p.x, first, end, p.r)
    p.gaps[level] = gap(w, p, left, length)
    if count < 0 or not p.gaps[level] <= 10.0 * tolerance:
        return NOT_PROVEN
    hold(w, p, first, end, count, negligible)
    return _IS_MET if length <= tolerance else _NOT_MET


@plain
def closest_levels(w, ends, relaxes, tolerances):
    r"""Minimise the levels' residuals in order of priority, then the cost, inside the limits.

    .. math::

        \operatorname{lex\,min}\; \lVert\mathbf A_1\mathbf x - \mathbf b_1\rVert,\;
        \lVert\mathbf A_2\mathbf x - \mathbf b_2\rVert, \dots,\;
        \tfrac12\mathbf x^T\mathbf H\mathbf x + \mathbf c^T\mathbf x
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\;
        \mathbf G\mathbf x \le \mathbf g

    The value A x that a level achieves and its active constraints become equality rows for the
    levels below. Each level is verified by the gradient that its multipliers do not balance, the
    final program in the same way as any other.

    Args:
        w: ``step_record.Program`` that
            :func:`~qp_twist.kernel.verified_program.solved_program` found infeasible. It receives
            the results of a step; ``sensitivity`` receives the multipliers of the constraints that
            limit a level.
        ends: Index after the last row of each level, (levels,).
        relaxes: Whether the first level may be relaxed.
        tolerances: Of the verification.

    Returns:
        ``PRIORITIZED`` or ``RELAXED``; ``REFUSED`` if the reference has to compute the step.
    """
    p, status, all_met = w.levels, PRIORITIZED, True
    begin(w, p)
    for level in range(len(ends)):
        outcome = take_level(
            w, p, level, ends[level - 1] if level > 0 else 0, ends[level], tolerances, 0
        )
        if outcome == NOT_PROVEN or (outcome == _NOT_MET and level == 0 and not relaxes):
            return REFUSED
        if outcome == _NOT_MET:
            all_met, status = False, RELAXED if level == 0 else status
    return status if not all_met and verified(w, p, tolerances) else REFUSED
