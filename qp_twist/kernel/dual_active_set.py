"""Goldfarb and Idnani's dual active-set method in the null space of the equations, compiled."""

from __future__ import annotations

import math
from collections import namedtuple

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.null_space import null_space, reflection, times_q, times_q_transposed

SOLVED, NO_ROOM, NOT_CONVEX, ENDLESS = 0, 1, 2, 3
"""Status of the method: solved; the constraints are infeasible; H is not positive definite; the
iteration limit was reached."""
_PARALLEL = 1e-14
"""A normal depends on the active ones if the squared length of its remainder is below this
share."""
_RANK = 1e-9
"""An equality row depends on the others if the length of its remainder is below this share."""
_APART = 1e-8
"""The same, squared, for an inequality of the initial active set."""
_MET = 1e-12
"""Largest violation that counts as met, as a share of the largest |x|, or of 1."""
ROUNDING = 1e-9
"""The same, if the active constraints leave no direction to reduce it."""
_MOST = 50
"""Iteration limit, as a multiple of the number of unknowns and rows."""


Program = namedtuple("Program", "H c A b G g lower upper")
"""Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper. The inequalities are
numbered: k rows of G, n lower bounds, n upper bounds."""
Work = namedtuple("Work", "x u active held L start V rows N R vectors lengths")
"""Result and workspace of the method, allocated by the caller.

With H = LLᵀ and L⁻¹Aᵀ = Q [R₁; 0], the equations leave x = x₀ + Nᵀz with NHNᵀ = 1 and ANᵀ = 0.

=========  ==========  ============================================================================
x          (n,)        the solution
u, active  (n + 1,)    multipliers and numbers of the active inequalities
held       (k + 2n,)   of each inequality: 1 if it is active, 3 if the active ones imply it
L, start   (n, n)      L, which is often diagonal, and the column of the first entry in each row
V, rows    (m, n)      reflections of Q (``null_space``) and, left of them, R₁ᵀ; their rows of A
N          (n, n + 1)  N, rotated so that R is triangular, and in the last column Nc
R          (n, n)      its column i is N a of the i-th active normal a
vectors    (6, n + 1)  x₀, R₁⁻ᵀb, the diagonal of R₁, and workspace
lengths    (k,)        of the rows of G, 1 for zero rows: the unit of their violation
=========  ==========  ============================================================================
"""


@plain
def cholesky(S, n):
    """Replace the lower triangle of S, n rows of it, by L of S = LLᵀ; return whether S ≻ 0."""
    for k in range(n):
        if not S[k, k] > 0.0:
            return False
        S[k, k] = math.sqrt(S[k, k])
        for i in range(k + 1, n):
            S[i, k] /= S[k, k]
            if S[i, k] != 0.0:  # many matrices are diagonal
                for j in range(k + 1, i + 1):
                    S[i, j] -= S[i, k] * S[j, k]
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


@part
def lower_solve(L, start, x):
    """Replace x (n,) by L⁻¹x."""
    for i in range(len(start)):
        for j in range(start[i], i):
            x[i] -= L[i, j] * x[j]
        x[i] /= L[i, i]


@part
def _upper_solve(L, start, x):
    """Replace x (n,) by L⁻ᵀx."""
    for i in range(len(start) - 1, -1, -1):
        x[i] /= L[i, i]
        for j in range(start[i], i):
            x[j] -= L[i, j] * x[i]


@plain
def factorise(H, G, L, start, lengths):
    """Compute L and the lengths of the rows of G; return whether H is positive definite."""
    n = len(start)
    for row in range(len(lengths)):
        square = 0.0
        for i in range(n):
            square += G[row, i] * G[row, i]
        lengths[row] = math.sqrt(square) if square > 0.0 else 1.0
    for i in range(n):
        start[i] = i
        for j in range(i, -1, -1):
            L[i, j] = H[i, j]
            if L[i, j] != 0.0:
                start[i] = j
    return cholesky(L, n)


@part
def _squares(v, first):
    """Squared lengths of v and of v[first:]."""
    whole, left = 0.0, 0.0
    for j in range(len(v)):
        whole += v[j] * v[j]
        if j >= first:
            left += v[j] * v[j]
    return whole, left


@plain
def hold_rows(A, b, L, start, V, rows, N, vectors):
    """Eliminate the independent rows of A: compute x₀ and N; return the number of its rows."""
    m, n, rank, x, t, ends = len(b), len(start), 0, vectors[0], vectors[1], vectors[2]
    for row in range(m):
        for j in range(n):
            V[row, j] = A[row, j]
        lower_solve(L, start, V[row])
    for row in range(m):
        v = V[row]
        whole, left = _squares(v, rank)
        if not left > _RANK * _RANK * whole:
            continue
        t[rank], rows[rank] = b[row], row
        for j in range(rank):
            t[rank] -= v[j] * t[j]
        ends[rank] = reflection(v, rank, math.sqrt(left))
        t[rank] /= ends[rank]
        for other in range(row + 1, m):
            along = 0.0
            for j in range(rank, n):
                along += v[j] * V[other, j]
            for j in range(rank, n):
                V[other, j] -= along * v[j]
        for j in range(n if row > rank else 0):
            V[rank, j] = v[j]
        rank += 1
    for j in range(n):
        x[j] = t[j] if j < rank else 0.0
    times_q(V[:rank], x[:n])
    _upper_solve(L, start, x)
    null_space(V[:rank], N[: n - rank, :n])
    for i in range(n - rank):
        _upper_solve(L, start, N[i])
    return n - rank


@plain
def multipliers(count, free, p, w, y, lam, box):
    """Write y (m,), λ (k,) and μ (n,): Hx + c + Aᵀy + Gᵀλ + μ = 0."""
    n, k, rank, pull, ends = len(p.c), len(p.g), len(p.c) - free, w.vectors[3], w.vectors[2]
    for row in range(len(y)):
        y[row] = 0.0
    for row in range(k):
        lam[row] = 0.0
    for j in range(n):
        pull[j], box[j] = p.c[j], 0.0
    for place in range(count):
        which, multiplier = w.active[place], w.u[place]
        if which < k:
            lam[which] = multiplier
            for j in range(n):
                pull[j] += multiplier * p.G[which, j]
        else:  # a bound, or both of a joint that cannot move
            dof, signed = (which - k) % n, multiplier if which >= k + n else -multiplier
            box[dof] += signed
            pull[dof] += signed
    lower_solve(w.L, w.start, pull)
    times_q_transposed(w.V[:rank], pull[:n])
    for i in range(rank - 1, -1, -1):
        found = -(w.vectors[1, i] + pull[i]) / ends[i]
        y[w.rows[i]] = found
        for j in range(i):
            pull[j] += found * w.V[i, j]


@plain
def _add(q, free, N, R, d, along):
    """Make the normal with d = N a the q-th active one; reflect the free rows of N accordingly."""
    square, columns = 0.0, N.shape[1]
    for j in range(q, free):
        square += d[j] * d[j]
    end = reflection(d[:free], q, math.sqrt(square))
    if end != 0.0:
        for i in range(columns):
            along[i] = 0.0
            for j in range(q, free):
                along[i] += d[j] * N[j, i]
        for j in range(q, free):
            for i in range(columns):
                N[j, i] -= d[j] * along[i]
    for i in range(q):
        R[i, q] = d[i]
    R[q, q] = end


@plain
def _missing(which, G, g, lower, upper, x):
    """What is missing at x of an inequality aᵀx ≥ side; negative inside."""
    k, n = len(g), len(lower)
    if which >= k + n:
        return x[which - k - n] - upper[which - k - n]
    if which >= k:
        return lower[which - k] - x[which - k]
    missing = -g[which]
    for i in range(n):
        missing += G[which, i] * x[i]
    return missing


@plain
def _normal(which, q, free, G, L, start, N, d, a):
    """Compute d = N a for the normal a of an inequality.

    Returned are its squared length outside the q active normals, and that of the whole L⁻¹a.
    """
    n, k, outside, whole = len(start), len(G), 0.0, 0.0
    for i in range(n):
        a[i] = -G[which, i] if which < k else 0.0
    if which >= k:
        a[(which - k) % n] = 1.0 if which < k + n else -1.0
    for j in range(free):
        d[j] = 0.0
        for i in range(n):
            d[j] += N[j, i] * a[i]
        if j >= q:
            outside += d[j] * d[j]
    lower_solve(L, start, a)
    for i in range(n):
        whole += a[i] * a[i]
    return outside, whole


@plain
def hold_initial(before, free, p, w):
    """Make those of the first ``before`` active ones active again that fit; return how many do."""
    q, d, a = 0, w.vectors[3], w.vectors[4]
    for i in range(len(w.held)):
        w.held[i] = 0
    for i in range(before):  # q ≤ i
        which = w.active[i]
        if q == free or not math.isfinite(_missing(which, p.G, p.g, p.lower, p.upper, w.x)):
            continue
        outside, whole = _normal(which, q, free, p.G, w.L, w.start, w.N, d, a)
        if outside > _APART * whole:
            _add(q, free, w.N, w.R, d, a)
            w.active[q], w.held[which] = which, 1
            q += 1
    return q


@plain
def _drop(place, q, N, R, active, held):
    """Remove column ``place`` of R (q columns) and make R triangular again."""
    held[active[place]] = 0
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
            for i in range(N.shape[1]):
                above, below = N[j, i], N[j + 1, i]
                N[j, i] = c * above + s * below
                N[j + 1, i] = c * below - s * above


@part
def _triangle(q, R, u):
    """Replace u (q,) by R⁻¹u."""
    for j in range(q - 1, -1, -1):
        u[j] /= R[j, j]
        for i in range(j):
            u[i] -= R[i, j] * u[j]


@part
def _solve_held(q, free, active, G, g, lower, upper, vectors, R, N, x, u):
    """Compute x that minimises the cost with the active inequalities as equations, and u.

    With N₁ the first q rows of N, N₂ the others, and s what is missing of the active ones at x₀:
    x = x₀ + N₁ᵀR⁻ᵀs − N₂ᵀN₂c and u = R⁻¹(R⁻ᵀs + N₁c).
    """
    n, start, t = len(x), vectors[0], vectors[3]
    for i in range(q):
        t[i] = _missing(active[i], G, g, lower, upper, start)
    for j in range(q):
        t[j] /= R[j, j]
        u[j] = t[j] + N[j, n]
        for i in range(j + 1, q):
            t[i] -= R[j, i] * t[j]
    _triangle(q, R, u)
    for j in range(q, free):
        t[j] = -N[j, n]
    for i in range(n):
        x[i] = start[i]
        for j in range(free):
            x[i] += t[j] * N[j, i]


@part
def _size(x):
    """Largest |x_i|, at least 1."""
    size = 1.0
    for value in x:
        size = max(size, abs(value))
    return size


@part
def _worst(G, g, lengths, lower, upper, x, held):
    """Index of the most violated inequality, in units of its normal's length, or −1."""
    k, n, worst, most = len(g), len(x), -1, _MET * _size(x)
    for i in range(n):
        if lower[i] - x[i] > most and held[k + i] == 0:
            most, worst = lower[i] - x[i], k + i
        if x[i] - upper[i] > most and held[k + n + i] == 0:
            most, worst = x[i] - upper[i], k + n + i
    for row in range(k):
        if held[row] == 0:
            missing = _missing(row, G, g, lower, upper, x) / lengths[row]
            if missing > most:
                most, worst = missing, row
    return worst


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


@part
def _blocking(u, r, q, active):
    """Longest step before a multiplier turns negative, and the index of that one, or −1."""
    longest, place = math.inf, -1
    for i in range(q):
        if r[i] > 0.0:
            length = max(u[i], 0.0) / r[i]
            if length < longest or (length == longest and active[i] < active[place]):
                longest, place = length, i
    return longest, place


@plain
def _enter(which, q, free, p, w):
    """Add a violated inequality and drop blocking ones; return status and number active."""
    N, R, x, u, d, r = w.N, w.R, w.x, w.u, w.vectors[3], w.vectors[4]
    for _ in range(q + 1):
        outside, whole = _normal(which, q, free, p.G, w.L, w.start, N, d, r)
        # Decrease of the other multipliers per unit of the new one: r = R⁻¹d₁.
        for i in range(q):
            r[i] = d[i]
        _triangle(q, R, r)
        longest, place = _blocking(u, r, q, w.active)
        full = math.inf
        excess = max(_missing(which, p.G, p.g, p.lower, p.upper, x), 0.0)
        if outside > _PARALLEL * whole:
            full = excess / outside
        step = min(longest, full)
        if step == math.inf:
            if excess > ROUNDING * _size(x) * (w.lengths[which] if which < len(p.g) else 1.0):
                return NO_ROOM, q
            # The active ones imply this one up to rounding: it cannot be met any better.
            w.held[which] = 3
            return SOLVED, q
        if full <= longest:
            _add(q, free, N, R, d, r)
            w.active[q], w.held[which] = which, 1
            return SOLVED, q + 1
        for i in range(q):
            u[i] -= step * r[i]
        if full != math.inf:
            for j in range(q, free):
                for i in range(len(x)):
                    x[i] += step * d[j] * N[j, i]
        for i in range(place, q - 1):
            u[i] = u[i + 1]
        _drop(place, q, w.N, w.R, w.active, w.held)
        q -= 1
    return ENDLESS, q


@plain
def active_set(q, free, p, w):
    r"""Solve a program from the factors of the equations and of q active inequalities.

    Goldfarb and Idnani, Mathematical Programming 27 (1983): one at a time the most violated
    inequality enters, each with the longest step that keeps all multipliers non-negative. The dual
    cost grows with every one that enters, so no active set occurs twice; of several blocking ones
    the one with the lowest number leaves. After each change, x and the multipliers are recomputed
    from the factors, so that rounding does not accumulate.

    Dependent rows of A are left out, and checked at the end. The initial active set may be that of
    another linear cost. Returned are the status and the number of active inequalities; the solution
    and their multipliers are in ``w``.
    """
    n, N, G, g, lower, upper, dual_feasible = len(p.c), w.N, p.G, p.g, p.lower, p.upper, False
    for i in range(len(w.held)):
        if w.held[i] == 3:  # implied by the active ones, up to rounding, for the cost before
            w.held[i] = 0
    for i in range(free):
        N[i, n] = 0.0
        for j in range(n):
            N[i, n] += N[i, j] * p.c[j]
    for _ in range(_MOST * (n + len(p.g) + 1)):
        _solve_held(q, free, w.active, G, g, lower, upper, w.vectors, w.R, N, w.x, w.u)
        if not dual_feasible:  # drop those with negative multipliers, most negative first
            place = -1
            for i in range(q):
                if w.u[i] < (w.u[place] if place >= 0 else 0.0):
                    place = i
            if place >= 0:
                _drop(place, q, w.N, w.R, w.active, w.held)
                q -= 1
                continue
            dual_feasible = True
        which = _worst(G, g, w.lengths, lower, upper, w.x, w.held)
        if which < 0:
            met = n - free == len(p.b) or _rows_met(p.A, p.b, w.x)
            return (SOLVED if met else NO_ROOM), q
        status, q = _enter(which, q, free, p, w)
        if status != SOLVED:
            return status, q
    return ENDLESS, q
