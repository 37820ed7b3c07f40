"""A step's program in the null space of its equality rows, which has few unknowns."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain
from qp_twist.kernel.dual_active_set import NO_ROOM, ROUNDING, SOLVED, active_set
from qp_twist.kernel.null_space import reflect, times_q, times_q_transposed

DEPENDENT = 4
"""The rows of a program depend on each other: see :func:`reduced_program`."""
_RANK = 1e-9
"""Rows whose smallest pivot is below this share of the largest are not taken as independent."""
_FIXED = 1e-8
"""A constraint is fixed by the equality rows if its null-space part is below this share of it."""


@plain
def reduced_program(w):
    r"""Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper.

    With :math:`\mathbf H^{-1} = \mathbf S\mathbf S^T` and :math:`(\mathbf{AS})^T = \mathbf{QR}` the
    solutions of the rows are :math:`\mathbf x = \mathbf{SQ}(\mathbf R^{-T}\mathbf b, z)`, and the
    cost is half the squared distance of z from that of :math:`-\mathbf S^T\mathbf c`. That z is
    nearly always feasible, and then it is the result. Otherwise ``active_set`` finds the nearest
    feasible z: a problem in n − m unknowns without equalities.

    Args:
        w: ``step_record.Program``: A, b, c, lower, upper, G, g and either h, the diagonal of H, or
            S in J, upper triangular. Results are x, y, lam and box with Hx + c + Aᵀy + Gᵀλ + μ = 0.
            The first ``active_count`` entries of ``active`` are the initial active set (warm
            start); they are replaced by the final one.

    Returns:
        ``SOLVED``; ``NO_ROOM`` if no solution of the rows lies inside the limits, or none was
        found; ``DEPENDENT`` if the rows are linearly dependent.
    """
    m, n = w.A.shape
    before, w.active_count[0] = w.active_count[0], 0
    _scale(w)
    if m > 0 and not reflect(w.scaled, w.V, w.R) >= _RANK:
        return DEPENDENT
    begin(w)
    for i in range(n):
        w.box[i] = 0.0
    for row in range(len(w.g)):
        w.lam[row] = 0.0
    if not is_inside(w):
        _null_basis(w)
        if not move_inside(w, before):
            return NO_ROOM
        _subtract_inequality_multipliers(w)
    for row in range(m - 1, -1, -1):
        for i in range(row + 1, m):
            w.y[row] -= w.R[row, i] * w.y[i]
        w.y[row] /= w.R[row, row]
    return SOLVED


@plain
def unlimited(w):
    """Write the solution without inequality constraints to ``w.x``; return whether there is one."""
    _scale(w)
    if len(w.b) > 0 and not reflect(w.scaled, w.V, w.R) >= _RANK:
        return False
    begin(w)
    return True


@part
def _scale(w):
    """Compute AS, and −Sᵀc into ``line``."""
    m, n = w.A.shape
    if len(w.h):
        for i in range(n):
            w.root[i] = 1.0 / math.sqrt(w.h[i])
            w.line[i] = -w.c[i] * w.root[i]
            for row in range(m):
                w.scaled[row, i] = w.A[row, i] * w.root[i]
        return
    for j in range(n):
        total = 0.0
        for i in range(j + 1):
            total -= w.J[i, j] * w.c[i]
        w.line[j] = total
    for row in range(m):
        for j in range(n):
            w.scaled[row, j] = 0.0
        for i in range(n):
            for j in range(i, n):
                w.scaled[row, j] += w.A[row, i] * w.J[i, j]


@part
def to_joints(is_diagonal, root, S, v):
    """Replace v (n,) by S v, with S diagonal or upper triangular."""
    n = len(v)
    if is_diagonal:
        for i in range(n):
            v[i] *= root[i]
        return
    for i in range(n):
        total = 0.0
        for j in range(i, n):
            total += S[i, j] * v[j]
        v[i] = total


@part
def begin(w):
    """Compute x without the inequality constraints, and the right-hand side of R y = …."""
    m, n = w.A.shape
    times_q_transposed(w.V, w.line)
    for i in range(n):
        w.x[i] = w.line[i]
    for row in range(m):
        total = w.b[row]
        for i in range(row):
            total -= w.R[i, row] * w.x[i]
        w.x[row] = total / w.R[row, row]
        w.y[row] = w.line[row] - w.x[row]
    times_q(w.V, w.x)
    to_joints(len(w.h) > 0, w.root, w.J, w.x)


@part
def is_inside(w):
    """Return whether x meets all bounds and inequality rows."""
    for i in range(len(w.x)):
        if not w.lower[i] <= w.x[i] <= w.upper[i]:
            return False
    for row in range(len(w.g)):
        total = -w.g[row]
        for i in range(len(w.x)):
            total += w.G[row, i] * w.x[i]
        if not total <= 0.0:
            return False
    return True


@plain
def _null_basis(w):
    """Compute a basis SQ e_j of the null space of A, and the length of each row of S (``root``)."""
    m, n = w.A.shape
    for j in range(n - m):
        for i in range(n):
            w.null_basis[j, i] = 0.0
        w.null_basis[j, m + j] = 1.0
        times_q(w.V, w.null_basis[j])
        to_joints(len(w.h) > 0, w.root, w.J, w.null_basis[j])
    for i in range(n if len(w.h) == 0 else 0):
        total = 0.0
        for j in range(i, n):
            total += w.J[i, j] * w.J[i, j]
        w.root[i] = math.sqrt(total)


@plain
def _cut(w):
    """Write bounds and rows as half-spaces in z, relative to x; return ``False`` if infeasible.

    A constraint that z does not change is only checked, and then left out.
    """
    n, size, room = len(w.x), 1.0, True
    for i in range(n):
        size = max(size, abs(w.x[i]))
        left = 0.0
        for j in range(len(w.z)):
            w.cuts[i, j], w.cuts[n + i, j] = -w.null_basis[j, i], w.null_basis[j, i]
            left += w.null_basis[j, i] * w.null_basis[j, i]
        w.ends[i], w.ends[n + i] = w.x[i] - w.lower[i], w.upper[i] - w.x[i]
        w.lengths[i] = w.lengths[n + i] = 1.0
        if left <= (_FIXED * w.root[i]) ** 2:
            room = room and min(w.ends[i], w.ends[n + i]) >= -ROUNDING * size
            w.ends[i] = w.ends[n + i] = math.inf
    for row in range(len(w.g)):
        at, end, square, whole, left = 2 * n + row, w.g[row], 0.0, 0.0, 0.0
        for i in range(n):
            end -= w.G[row, i] * w.x[i]
            square += w.G[row, i] * w.G[row, i]
            whole += abs(w.G[row, i]) * w.root[i]
        for j in range(len(w.z)):
            total = 0.0
            for i in range(n):
                total += w.null_basis[j, i] * w.G[row, i]
            w.cuts[at, j] = total
            left += total * total
        w.ends[at], w.lengths[at] = end, math.sqrt(square) if square > 0.0 else 1.0
        if left <= (_FIXED * whole) ** 2:
            room = room and end >= -ROUNDING * size * w.lengths[at]
            w.ends[at] = math.inf
    return room


@part
def _on_line(w):
    """Find the feasible z nearest to 0, for one unknown; return the number active, −1 if none."""
    least, most, first, last = -math.inf, math.inf, 0, 0
    for which in range(len(w.ends)):
        slope = w.cuts[which, 0]
        if slope > 0.0 and w.ends[which] < most * slope:
            most, last = w.ends[which] / slope, which
        elif slope < 0.0 and w.ends[which] < least * slope:
            least, first = w.ends[which] / slope, which
    if not least <= most:
        return -1
    w.z[0] = min(max(0.0, least), most)
    w.active[0] = first if w.z[0] > 0.0 else last
    w.u[0] = -w.z[0] / w.cuts[w.active[0], 0]
    return 0 if w.z[0] == 0.0 else 1


@plain
def _nearest(w, before):
    """Find the feasible z nearest to 0; return the number of active constraints, −1 if none."""
    p = len(w.z)
    for i in range(p):
        for j in range(p):
            w.Jz[i, j] = 0.0
        w.Jz[i, i], w.zero[i] = 1.0, 0.0
    none = w.nothing
    status, count = active_set(
        w.zero, w.no_rows, none, w.cuts, w.ends, w.lengths, none, none, w.active, min(before, p),
        w.z, w.u, w.Jz, w.Rz, w.held, w.work_z,
    )  # fmt: skip
    return count if status == SOLVED else -1


@plain
def move_inside(w, before):
    """Move x along ``null_basis`` to the nearest feasible point; return whether there is one.

    With λ and μ. A move z along the basis costs ½‖z‖²; ``root`` has the length of each row of S.
    """
    n, count = len(w.x), 0
    if not _cut(w):
        return False
    if len(w.z) == 1:
        count = _on_line(w)
    elif len(w.z) > 1:
        count = _nearest(w, before)
    if count < 0:
        return False
    w.active_count[0] = count
    for i in range(n):
        for j in range(len(w.z)):
            w.x[i] += w.null_basis[j, i] * w.z[j]
    for k in range(count):
        which = w.active[k]
        if which < n:
            w.x[which], w.box[which] = w.lower[which], w.box[which] - w.u[k]
        elif which < 2 * n:
            w.x[which - n], w.box[which - n] = w.upper[which - n], w.box[which - n] + w.u[k]
        else:
            w.lam[which - 2 * n] = w.u[k]
    return True


@plain
def _subtract_inequality_multipliers(w):
    """Subtract the first entries of QᵀSᵀ(μ + Gᵀλ) from the right-hand side of y."""
    n = len(w.x)
    for i in range(n):
        w.line[i] = w.box[i]
    for row in range(len(w.g)):
        if w.lam[row] > 0.0:
            for i in range(n):
                w.line[i] += w.lam[row] * w.G[row, i]
    if len(w.h):
        for i in range(n):
            w.line[i] *= w.root[i]
    else:
        for j in range(n - 1, -1, -1):
            total = 0.0
            for i in range(j + 1):
                total += w.J[i, j] * w.line[i]
            w.line[j] = total
    times_q_transposed(w.V, w.line)
    for row in range(len(w.b)):
        w.y[row] -= w.line[row]
