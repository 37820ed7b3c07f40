"""Goldfarb and Idnani's dual active-set method, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.null_space import reflection

SOLVED, NO_ROOM, NOT_CONVEX, ENDLESS = 0, 1, 2, 3
"""Status of :func:`active_set`: solved; the constraints are infeasible; H is not positive
definite; the iteration limit was reached."""
_PARALLEL = 1e-14
"""A normal depends on the active ones if the squared length of its remainder is below this
share."""
_RANK = 1e-9
"""An equality row depends on the others if the length of its remainder is below this share."""
_APART = 1e-8
"""The same, squared, for a constraint of the initial active set."""
_MET = 1e-12
"""Largest violation that counts as met, as a share of the largest |x|, or of 1."""
ROUNDING = 1e-9
"""The same, if the active constraints leave no direction to reduce it."""
_MOST = 50
"""Iteration limit, as a multiple of the number of unknowns and rows."""


@plain
def cholesky(S):
    """Replace the lower triangle of S (n, n) by L of S = LLᵀ; return whether S ≻ 0."""
    for i in range(S.shape[0]):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                S[i, i] = math.sqrt(total)
            else:
                S[i, j] = total / S[j, j]
    return True


@plain
def cholesky_solve(L, b):
    """Replace b (n,) by the solution of LLᵀx = b, with L in the lower triangle of an array."""
    n = len(b)
    for i in range(n):
        for j in range(i):
            b[i] -= L[i, j] * b[j]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= L[j, i] * b[j]
        b[i] /= L[i, i]


@plain
def cholesky_inverse(H, J):
    """Compute J = L⁻ᵀ of H = LLᵀ, so JJᵀ = H⁻¹; return whether H (n, n) is positive definite."""
    n = H.shape[0]
    for i in range(n):
        for j in range(n):
            J[i, j] = H[i, j]
    if not cholesky(J):
        return False
    for i in range(n):  # L⁻¹ row by row, written as the columns of J above its diagonal
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total += J[i, k] * J[j, k]
            J[j, i] = -total / J[i, i]
        J[i, i] = 1.0 / J[i, i]
    for i in range(n):
        for j in range(i):
            J[i, j] = 0.0
    return True


@plain
def _normal_in_factor(which, m, n, k, A, G, J, d):
    """Compute d = Jᵀa for the normal a of a constraint, written as aᵀx ≥ side."""
    if which < m + k:
        for j in range(n):
            d[j] = 0.0
        for i in range(n):
            entry = A[which, i] if which < m else -G[which - m, i]
            for j in range(n):
                d[j] += J[i, j] * entry
    elif which < m + k + n:
        row = which - m - k
        for j in range(n):
            d[j] = J[row, j]
    else:
        row = which - m - k - n
        for j in range(n):
            d[j] = -J[row, j]


@part
def _side(which, m, k, b, g, lower, upper):
    """Right-hand side of a constraint aᵀx ≥ side (equality rows: =)."""
    if which < m:
        return b[which]
    if which < m + k:
        return -g[which - m]
    if which < m + k + len(lower):
        return lower[which - m - k]
    return -upper[which - m - k - len(lower)]


@plain
def _add(q, n, d, J, R):
    """Add the normal with d = Jᵀa as column q of R; reflect the free columns of J accordingly."""
    square = 0.0
    for j in range(q, n):
        square += d[j] * d[j]
    end = reflection(d[:n], q, math.sqrt(square))
    if end != 0.0:
        for i in range(n):
            along = 0.0
            for j in range(q, n):
                along += J[i, j] * d[j]
            for j in range(q, n):
                J[i, j] -= along * d[j]
    for i in range(q):
        R[i, q] = d[i]
    R[q, q] = end


@plain
def _drop(place, q, n, J, R, active):
    """Remove column ``place`` of R (q columns) and make R triangular again."""
    for j in range(place, q - 1):
        active[j] = active[j + 1]
        for i in range(j + 2):
            R[i, j] = R[i, j + 1]
    for j in range(place, q - 1):
        if R[j + 1, j] != 0.0:
            length = math.hypot(R[j, j], R[j + 1, j])
            c, s = R[j, j] / length, R[j + 1, j] / length
            R[j, j], R[j + 1, j] = length, 0.0
            for i in range(j + 1, q - 1):
                above, below = R[j, i], R[j + 1, i]
                R[j, i] = c * above + s * below
                R[j + 1, i] = c * below - s * above
            for i in range(n):
                left, right = J[i, j], J[i, j + 1]
                J[i, j] = c * left + s * right
                J[i, j + 1] = c * right - s * left
    for i in range(n):
        R[i, q - 1] = 0.0


@plain
def _solve_held(q, n, m, k, c, b, g, lower, upper, J, R, active, x, u, t):
    """Compute x that minimises the cost with the active constraints as equalities, and u.

    x = J₁R⁻ᵀs − J₂J₂ᵀc and u = R⁻¹(R⁻ᵀs + J₁ᵀc), with s the active right-hand sides.
    """
    for i in range(q):
        total = _side(active[i], m, k, b, g, lower, upper)
        for j in range(i):
            total -= R[j, i] * t[j]
        t[i] = total / R[i, i]
    for j in range(q):
        u[j] = t[j]
    for j in range(q, n):
        t[j] = 0.0
    for i in range(n):
        for j in range(q):
            u[j] += J[i, j] * c[i]
        for j in range(q, n):
            t[j] -= J[i, j] * c[i]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += J[i, j] * t[j]
        x[i] = total
    for i in range(q - 1, -1, -1):
        total = u[i]
        for j in range(i + 1, q):
            total -= R[i, j] * u[j]
        u[i] = total / R[i, i]


@part
def _size(x):
    """Largest |x_i|, at least 1."""
    size = 1.0
    for value in x:
        size = max(size, abs(value))
    return size


@plain
def _worst(n, m, k, G, g, lengths, lower, upper, x, held, tolerance):
    """Index of the most violated constraint, in units of its normal's length, or −1."""
    worst, most = -1, tolerance * _size(x)
    bounds = len(lower)
    for i in range(bounds):
        if held[m + k + i] == 0 and lower[i] - x[i] > most:
            most, worst = lower[i] - x[i], m + k + i
        if held[m + k + bounds + i] == 0 and x[i] - upper[i] > most:
            most, worst = x[i] - upper[i], m + k + bounds + i
    for row in range(k):
        if held[m + row] == 0:
            total = -g[row]
            for i in range(n):
                total += G[row, i] * x[i]
            total /= lengths[row]
            if total > most:
                most, worst = total, m + row
    return worst


@plain
def _outside(q, n, d):
    """Squared lengths of d and of its part outside the q active normals."""
    whole, outside = 0.0, 0.0
    for j in range(n):
        whole += d[j] * d[j]
        if j >= q:
            outside += d[j] * d[j]
    return whole, outside


@plain
def _hold_equalities(m, n, k, A, G, J, R, d, active):
    """Make the independent rows of A the first active constraints; return their number."""
    q = 0
    for row in range(m):
        if q == n:
            break
        _normal_in_factor(row, m, n, k, A, G, J, d)
        whole, outside = _outside(q, n, d)
        if outside > _RANK * _RANK * whole:
            _add(q, n, d, J, R)
            active[q] = row
            q += 1
    return q


@plain
def _rows_met(A, b, x):
    """Whether x also meets the dependent rows of A: then they are consistent."""
    for row in range(len(b)):
        total, length = -b[row], 0.0
        for i in range(len(x)):
            total += A[row, i] * x[i]
            length += A[row, i] ** 2
        if not abs(total) <= ROUNDING * (_size(x) * math.sqrt(length) + abs(b[row])):
            return False
    return True


@plain
def _hold_initial(q, m, n, k, A, G, b, g, lower, upper, J, R, d, active, held):
    """Add those of the initial active set (marked 2 in ``held``) that fit; return their number."""
    for which in range(m, m + k + 2 * len(lower)):
        if held[which] != 2:
            continue
        held[which] = 0
        if q == n or not math.isfinite(_side(which, m, k, b, g, lower, upper)):
            continue
        _normal_in_factor(which, m, n, k, A, G, J, d)
        whole, outside = _outside(q, n, d)
        if outside > _APART * whole:
            _add(q, n, d, J, R)
            active[q], held[which] = which, 1
            q += 1
    return q


@part
def _least(u, first, q):
    """Index of the most negative multiplier of an inequality, or −1."""
    least, place = 0.0, -1
    for i in range(first, q):
        if u[i] < least:
            least, place = u[i], i
    return place


@part
def _blocking(u, r, first, q, active):
    """Longest step before a multiplier turns negative, and the index of that one, or −1."""
    longest, place = math.inf, -1
    for i in range(first, q):
        if r[i] > 0.0:
            length = max(u[i], 0.0) / r[i]
            if length < longest or (length == longest and active[i] < active[place]):
                longest, place = length, i
    return longest, place


@part
def _violation(which, m, n, k, G, x, side):
    """Violation of a constraint, in its own units, at least 0."""
    missing = side
    if which < m + k:
        for i in range(n):
            missing += G[which - m, i] * x[i]
    elif which < m + k + n:
        missing -= x[which - m - k]
    else:
        missing += x[which - m - k - n]
    return max(missing, 0.0)


@plain
def _enter(
    which, first, q, m, n, k, A, G, b, g, lengths, lower, upper, J, R, d, r, x, u, active, held
):  # fmt: skip
    """Add a violated constraint and drop blocking ones; return status and number active."""
    side = _side(which, m, k, b, g, lower, upper)
    for _ in range(q - first + 1):
        _normal_in_factor(which, m, n, k, A, G, J, d)
        whole, outside = _outside(q, n, d)
        # Decrease of the other multipliers per unit of the new one: r = R⁻¹d₁.
        for i in range(q - 1, -1, -1):
            total = d[i]
            for j in range(i + 1, q):
                total -= R[i, j] * r[j]
            r[i] = total / R[i, i]
        longest, place = _blocking(u, r, first, q, active)
        full = math.inf
        if outside > _PARALLEL * whole and q < n:
            full = _violation(which, m, n, k, G, x, side) / outside
        step = min(longest, full)
        if step == math.inf:
            excess = _violation(which, m, n, k, G, x, side)
            if excess > ROUNDING * _size(x) * (lengths[which - m] if which < m + k else 1.0):
                return NO_ROOM, q
            # The active constraints imply this one up to rounding: it cannot be met any better.
            held[which] = 3
            return SOLVED, q
        if full <= longest:
            _add(q, n, d, J, R)
            active[q], held[which] = which, 1
            return SOLVED, q + 1
        for i in range(q):
            u[i] -= step * r[i]
        if full != math.inf:
            for i in range(n):
                total = 0.0
                for j in range(q, n):
                    total += J[i, j] * d[j]
                x[i] += step * total
        held[active[place]] = 0
        for i in range(place, q - 1):
            u[i] = u[i + 1]
        _drop(place, q, n, J, R, active)
        q -= 1
    return ENDLESS, q


@plain
def row_lengths(G, lengths):
    """Compute the length of each row of G (k, n), 1 for zero rows: the unit of its violation."""
    for row in range(len(G)):
        square = 0.0
        for i in range(G.shape[1]):
            square += G[row, i] * G[row, i]
        lengths[row] = math.sqrt(square) if square > 0.0 else 1.0


@plain
def active_set(c, A, b, G, g, lengths, lower, upper, active, before, x, u, J, R, held, work):
    r"""Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper, for a known J, JJᵀ = H⁻¹.

    Goldfarb and Idnani, Mathematical Programming 27 (1983): equality rows enter first, then one at
    a time the most violated constraint, each with the longest step that keeps all multipliers
    non-negative. The dual cost grows with every constraint that enters, so no active set occurs
    twice; of several blocking constraints the one with the lowest number leaves. After each change,
    x and the multipliers are recomputed from the factors, so that rounding does not accumulate.

    Constraints are numbered: rows of A, rows of G, lower bounds, upper bounds. ``active[:before]``
    is the initial active set (warm start); its members are used if they still fit. Dependent rows
    of A are left out, and checked at the end.

    Results are x (n,), ``active`` (n,), those of A first, their multipliers u (n + 1,), and J with
    JJᵀ = H⁻¹; ``lengths`` are those of the rows of G, in which violations are measured; workspaces
    R (n, n), ``held`` (m + k + 2n,) and ``work`` (3, n + 1). Returned are the status and the number
    of active constraints.
    """
    n, m, k, d = c.shape[0], b.shape[0], g.shape[0], work[0]
    for i in range(len(held)):
        held[i] = 0
    for i in range(before):
        held[active[i]] = 2
    q = first = _hold_equalities(m, n, k, A, G, J, R, d, active)
    if before > 0:
        q = _hold_initial(q, m, n, k, A, G, b, g, lower, upper, J, R, d, active, held)
    return resumed_active_set(
        first, q, c, A, b, G, g, lengths, lower, upper, active, x, u, J, R, held, work
    )


@plain
def resumed_active_set(
    first, q, c, A, b, G, g, lengths, lower, upper, active, x, u, J, R, held, work
):  # fmt: skip
    """:func:`active_set` from the factors of q active constraints, the ``first`` rows of A first.

    They may be those of another linear cost c.
    """
    n, m, k = c.shape[0], b.shape[0], g.shape[0]
    d, t, r = work[0], work[1], work[2]
    for i in range(len(held)):
        if held[i] == 3:  # implied by the active ones, up to rounding, for the cost before
            held[i] = 0
    _solve_held(q, n, m, k, c, b, g, lower, upper, J, R, active, x, u, t)
    while True:  # drop constraints with negative multipliers, most negative first
        place = _least(u, first, q)
        if place < 0:
            break
        held[active[place]] = 0
        _drop(place, q, n, J, R, active)
        q -= 1
        _solve_held(q, n, m, k, c, b, g, lower, upper, J, R, active, x, u, t)
    for _ in range(_MOST * (n + k) + _MOST):
        which = _worst(n, m, k, G, g, lengths, lower, upper, x, held, _MET)
        if which < 0:
            return (SOLVED if first == m or _rows_met(A, b, x) else NO_ROOM), q
        status, q = _enter(
            which, first, q, m, n, k, A, G, b, g, lengths, lower, upper, J, R, d, r, x, u, active,
            held,
        )  # fmt: skip
        if status != SOLVED:
            return status, q
        _solve_held(q, n, m, k, c, b, g, lower, upper, J, R, active, x, u, t)
    return ENDLESS, q
