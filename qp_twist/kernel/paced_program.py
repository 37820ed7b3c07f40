"""A step's program with the scale, in the coordinates of the task's null space and the scale."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import plain
from qp_twist.kernel.dual_active_set import NO_ROOM, NOT_CONVEX, SOLVED, cholesky
from qp_twist.kernel.null_space import null_space, reflect
from qp_twist.kernel.reduced_program import is_inside, move_inside


@plain
def find_null_space(w, e):
    """Write an orthonormal basis of the null space of the rotated rows; return whether it exists.

    All programs of a step without slacks share it.
    """
    if len(e.rows) == 0:
        for i in range(len(w.x)):
            for j in range(len(w.x)):
                e.null_basis[i, j] = 1.0 if i == j else 0.0
        return True
    found = reflect(e.rows, w.V, w.R) > 0.0
    null_space(w.V, e.null_basis)
    return found


@plain
def _directions(e, p):
    """Write the solution of the rows at u = 0 to ``p.x``, and the ways that the rows leave.

    The rows B q̇ − a u = b of the program are met by q̇ = B⁺b + u B⁺a + Ny. As the rows of B are
    orthogonal, B⁺ is Bᵀ divided by σ². ``p.null_basis`` receives (B⁺a, 1) and the (N, 0).
    """
    n, ways = len(e.motion), p.null_basis
    for k in range(n + 1):
        p.x[k], ways[0, k] = 0.0, 0.0
    ways[0, n] = 1.0
    for i in range(len(p.b)):
        at_rest, pace = p.b[i] / e.square[i], -p.A[i, n] / e.square[i]
        for k in range(n):
            p.x[k] += at_rest * e.rows[i, k]
            ways[0, k] += pace * e.rows[i, k]
    for j in range(1, len(ways)):
        for k in range(n):
            ways[j, k] = e.null_basis[j - 1, k]
        ways[j, n] = 0.0


@plain
def _gradient(p, x, out):
    """H x of the joints and the scale, which have no common cost."""
    n = len(x) - 1
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += p.dense[i, j] * x[j]
        out[i] = total
    out[n] = p.dense[n, n] * x[n]


@plain
def _dot(x, y):
    """xᵀy."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@plain
def _to_the_optimum(p):
    """Move ``p.x`` along the ways to the least cost without limits; return whether there is one.

    The ways W become L⁻¹W, with W H Wᵀ = LLᵀ: the cost of a motion z along them is ½‖z‖² then.
    """
    W, L, z, n = p.null_basis, p.Jz, p.z, len(p.x)
    for i in range(len(W)):
        _gradient(p, W[i], p.line)
        z[i] = _dot(p.line, p.x) + _dot(p.c, W[i])
        for j in range(i, len(W)):
            L[j, i] = _dot(p.line, W[j])
    if not cholesky(L):
        return False
    for i in range(len(W)):
        for j in range(i):
            z[i] -= L[i, j] * z[j]
            for k in range(n):
                W[i, k] -= L[i, j] * W[j, k]
        z[i] /= L[i, i]
        for k in range(n):
            W[i, k] /= L[i, i]
    for i in range(len(W)):
        for k in range(n):
            p.x[k] -= z[i] * W[i, k]
    return True


@plain
def paced_program(e, p):
    """:func:`~qp_twist.kernel.reduced_program.reduced_program` of the joints and the scale.

    It takes a third of the time, because the rows are orthogonal and their null space is known:
    :func:`find_null_space`. The last unknown is the scale, with no cost in common with the joints.
    The joints' part of the rows is that of ``e.rows``.
    """
    n, before, p.active_count[0] = len(e.motion), p.active_count[0], 0
    _directions(e, p)
    if not _to_the_optimum(p):
        return NOT_CONVEX
    for i in range(n + 1):
        p.box[i] = 0.0
        p.root[i] = 0.0
    for row in range(len(p.g)):
        p.lam[row] = 0.0
    if not is_inside(p):
        # Which limits the rows leave no way towards is seen beside the length of the unknown's
        # own way without rows.
        for i in range(n + 1):
            p.root[i] = 1.0 / math.sqrt(p.dense[i, i])
        if not move_inside(p, before):
            return NO_ROOM
    _gradient(p, p.x, p.line)
    for i in range(n):
        p.line[i] += p.c[i] + p.box[i]
    for row in range(len(p.g)):
        if p.lam[row] > 0.0:
            for i in range(n):
                p.line[i] += p.lam[row] * p.G[row, i]
    for i in range(len(p.b)):
        p.y[i] = 0.0
        for k in range(n):
            p.y[i] -= e.rows[i, k] * p.line[k] / e.square[i]
    return SOLVED
