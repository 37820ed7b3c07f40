"""Row space and null space of rows, by Householder reflections."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part, plain

INDEPENDENT = 1e-8
"""A row depends on others if the length of what they leave of it is below this share."""


@part
def reflection(v, first, length):
    """Replace v by that of the reflection 1 − vvᵀ which maps v[first:] onto its first entry.

    ``length`` is the length of v[first:]; if it is 0 there is nothing to reflect. Returned is the
    first entry after the reflection.
    """
    if length == 0.0:
        return 0.0
    head = v[first]
    end = -length if head > 0.0 else length
    # ‖v‖² = 2 for v = (x ± ‖x‖e₁) / √(‖x‖(‖x‖ + |x₁|)).
    scale = 1.0 / math.sqrt(length * (length + abs(head)))
    v[first] = head - end
    for i in range(first, len(v)):
        v[i] *= scale
    return end


@part
def times_q(V, x):
    """Replace x (n,) by Q x."""
    m, n = V.shape
    for row in range(m - 1, -1, -1):
        along = 0.0
        for i in range(row, n):
            along += V[row, i] * x[i]
        for i in range(row, n):
            x[i] -= along * V[row, i]


@part
def times_q_transposed(V, x):
    """Replace x (n,) by Qᵀ x."""
    m, n = V.shape
    for row in range(m):
        along = 0.0
        for i in range(row, n):
            along += V[row, i] * x[i]
        for i in range(row, n):
            x[i] -= along * V[row, i]


@plain
def null_space(V, N):
    """Write an orthonormal basis of the null space of A to the rows of N (n − m, n)."""
    m, n = V.shape
    for column in range(n - m):
        for i in range(n):
            N[column, i] = 0.0
        N[column, m + column] = 1.0
        times_q(V, N[column])


@plain
def row_space(A, V):
    """Reduce the rows of A (m, n), which may be dependent, to a triangle by reflections.

    V (n, n) receives for each independent row the vector v of a reflection 1 − vvᵀ; their product
    is Q of Aᵀ = QR. Returned is the number of independent rows.
    """
    m, n = A.shape
    rank = 0
    for row in range(m):
        if rank == n:
            break
        v, whole, left = V[rank], 0.0, 0.0
        for i in range(n):
            v[i] = A[row, i]
            whole += v[i] * v[i]
        times_q_transposed(V[:rank], v)
        for i in range(rank):
            v[i] = 0.0
        for i in range(rank, n):
            left += v[i] * v[i]
        if not left > INDEPENDENT * INDEPENDENT * whole:
            continue
        reflection(v, rank, math.sqrt(left))
        rank += 1
    return rank
