"""A program with a diagonal cost, equality rows and bounds, where at most one bound is active."""

from __future__ import annotations

import math

from qp_twist.fast.compiling import plain
from qp_twist.fast.null_space import reflect, times_q, times_q_transposed

NOBODY = -1
"""No bound is active."""
UNDECIDED = -2
"""More than one bound may be active, or there is no room: another method has to look at it."""
_RANK = 1e-9
"""Rows whose smallest pivot is below this share of the largest are not taken as independent."""


@plain
def box_program(h, c, A, b, lower, upper, x, y, box, scaled, V, R, root, line):
    r"""Minimise ½xᵀHx + cᵀx subject to Ax = b, lower ≤ x ≤ upper, with H = diag h.

    In the coordinates :math:`\mathbf H^{1/2}\mathbf x` the least is the point of the rows that is
    nearest to :math:`-\mathbf H^{-1/2}\mathbf c`. Where one direction is left, bounds cut a piece
    off that line; where more are left and a bound is in the way, nothing is decided.

    Args:
        h: Above 0, (n,).
        c: (n,).
        A: Rows, (m, n).
        b: (m,).
        lower: (n,), −∞ where there is none.
        upper: (n,), ∞ where there is none.
        x: Result, (n,).
        y: Result, (m,), with Hx + c + Aᵀy + μ = 0.
        box: Result, μ, (n,).
        scaled: Workspace, (m, n).
        V: Workspace, (m, n).
        R: Workspace, (m, m).
        root: Workspace, (n,).
        line: Workspace, (n,).

    Returns:
        The active bound, lower ones from 0 and upper ones from n on, ``NOBODY`` or ``UNDECIDED``.
    """
    m, n = A.shape
    for i in range(n):
        root[i] = 1.0 / math.sqrt(h[i])
        line[i] = -c[i] * root[i]
        box[i] = 0.0
        for row in range(m):
            scaled[row, i] = A[row, i] * root[i]
    if m > 0 and not reflect(scaled, V, R) >= _RANK:
        return UNDECIDED
    _nearest(b, V, R, line, x, y)
    outside = False
    for i in range(n):
        x[i] *= root[i]
        outside = outside or not lower[i] <= x[i] <= upper[i]
    which = NOBODY
    if outside:
        which = _cut(lower, upper, x, V, root, line) if m + 1 == n else UNDECIDED
        if which == UNDECIDED:
            return UNDECIDED
        _hold(which, lower, upper, V, root, line, x, y, box)
    for row in range(m - 1, -1, -1):
        for i in range(row + 1, m):
            y[row] -= R[row, i] * y[i]
        y[row] /= R[row, row]
    return which


@plain
def _nearest(b, V, R, wish, x, y):
    """The point of the rows nearest to ``wish``, which is lost; the right-hand side of R y = …."""
    m = len(b)
    times_q_transposed(V, wish)
    for i in range(len(x)):
        x[i] = wish[i]
    for row in range(m):
        total = b[row]
        for i in range(row):
            total -= R[i, row] * x[i]
        x[row] = total / R[row, row]
        y[row] = wish[row] - x[row]
    times_q(V, x)


@plain
def _hold(which, lower, upper, V, root, line, x, y, box):
    """Move x along ``line`` onto a bound, with μ, and its share in the right-hand side of y."""
    n = len(x)
    held = which % n
    bound = lower[held] if which < n else upper[held]
    t = (bound - x[held]) / line[held]
    for i in range(n):
        x[i] += t * line[i]
    x[held] = bound
    box[held] = -t / line[held]  # against the pull back along the line
    for i in range(n):
        line[i] = 0.0
    line[held] = root[held] * box[held]
    times_q_transposed(V, line)
    for row in range(len(y)):
        y[row] -= line[row]


@plain
def _cut(lower, upper, x, V, root, line):
    """The bound that x meets first on its way into the box; its direction into ``line``."""
    n = len(x)
    for i in range(n):
        line[i] = 0.0
    line[n - 1] = 1.0
    times_q(V, line)
    least, most, first, last = -math.inf, math.inf, NOBODY, NOBODY
    for i in range(n):
        line[i] *= root[i]
        if line[i] == 0.0:
            if not lower[i] <= x[i] <= upper[i]:
                return UNDECIDED
            continue
        low, high = (lower[i] - x[i]) / line[i], (upper[i] - x[i]) / line[i]
        enters, leaves = i, n + i
        if line[i] < 0.0:
            low, high, enters, leaves = high, low, leaves, enters
        if low > least:
            least, first = low, enters
        if high < most:
            most, last = high, leaves
    if not least <= most:
        return UNDECIDED
    return first if least > 0.0 else last
