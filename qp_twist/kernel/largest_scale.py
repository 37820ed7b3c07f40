"""The largest scale s of a step's rows that is feasible within the limits, compiled."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import plain
from qp_twist.kernel.dual_active_set import NO_ROOM, SOLVED, active_set
from qp_twist.kernel.null_space import times_q
from qp_twist.kernel.reduced_program import reduced_program, to_joints
from qp_twist.kernel.verified_program import DONE, INFEASIBLE, REFUSED, SCALED, solved_program

EXCLUDED = -1.0
"""Returned instead of a scale if the limits exclude even a task at rest."""
_EPSILON = 1e-5
"""Weight of ‖z‖² in the cost: s comes out below its optimum by ½ε²‖z‖² at most."""
_CLEAR = 1e-6
"""Smallest reduction of a row that counts as scaling, m/s or rad/s."""
_OF_THE_MOTION = 10.0 * _EPSILON
"""A multiplier of at most this share of ε‖z‖ is due to the weight of z: it does not limit s."""


@plain
def largest_scale(w, backoff):
    r"""The largest s ≤ 1 for which A x = s b has a solution inside the limits.

    It is 0 where rounding decides whether such an s exists, and ``EXCLUDED`` if none exists with
    s ≥ 0.

    With the solutions :math:`\mathbf x = s\,\mathbf x_1 + \mathbf N z` of the rows it is the linear
    program of ``qp.scaling``. It is solved as the strictly convex

    .. math::

        \min_{s, z}\; \tfrac12(s - 2)^2 + \tfrac12\varepsilon^2\lVert z\rVert^2
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\; \mathbf G\mathbf x \le \mathbf g

    whose optimum is that of the linear program for every ε below some bound (Mangasarian and Meyer,
    SIAM J. Control Optim. 17, 1979), and near it above.

    Args:
        w: ``step_record.Program`` after ``reduced_program``, which sets V, R, root and null_basis.
            If s > 0, ``sensitivity[1:]`` is set.
        backoff: Share by which s is reduced, so that the scaled rows are strictly feasible.
    """
    p, n, x = w.scaling, len(w.x), w.line
    for i in range(n):
        x[i] = 0.0
    for row in range(len(w.b)):
        total = w.b[row]
        for i in range(row):
            total -= w.R[i, row] * x[i]
        x[row] = total / w.R[row, row]
    times_q(w.V, x)
    to_joints(len(w.h) > 0, w.root, w.J, x)  # x of s = 1 and z = 0
    _half_spaces(w, p.cuts, x)
    for i in range(len(p.c)):
        for j in range(len(p.c)):
            p.J[i, j] = 0.0
        p.J[i, i], p.c[i] = 1.0, 0.0
    p.c[0] = -2.0
    none = p.nothing
    status, count = active_set(
        p.c, p.no_rows, none, p.cuts, w.ends, w.lengths, none, none, p.active, len(none), p.x,
        p.u, p.J, p.R, p.held, p.work,
    )  # fmt: skip
    scale, largest = p.x[0], 0.0
    for row in range(len(w.b)):
        largest = max(largest, abs(w.b[row]))
    if status == NO_ROOM or (status == SOLVED and scale * largest < -_CLEAR):
        return EXCLUDED
    if status != SOLVED or not scale > 0.0 or not (1.0 - scale) * largest > _CLEAR:
        return 0.0
    _sensitivity(p, count, n, w.sensitivity)
    return scale * (1.0 - backoff)


@plain
def _sensitivity(p, count, n, sensitivity):
    """Set ∂s/∂(limit) of the ``count`` active limits, in ``sensitivity[1:]``, (n + k,)."""
    furthest = _EPSILON
    for j in range(1, len(p.x)):
        furthest = max(furthest, abs(p.x[j]))
    for i in range(1, len(sensitivity)):
        sensitivity[i] = 0.0
    for place in range(count):
        if p.u[place] <= _OF_THE_MOTION * furthest:
            continue
        which, gain = p.active[place], p.u[place] / (2.0 - p.x[0])
        if which < n:
            sensitivity[1 + which] -= gain
        else:
            sensitivity[1 + which - n] += gain


@plain
def _half_spaces(w, cuts, x):
    """Write bounds and rows of G as half-spaces in s and εz."""
    n, free = len(x), len(w.null_basis)
    for i in range(n):
        cuts[i, 0], cuts[n + i, 0] = -x[i], x[i]
        for j in range(free):
            along = w.null_basis[j, i] / _EPSILON
            cuts[i, 1 + j], cuts[n + i, 1 + j] = -along, along
        w.ends[i], w.ends[n + i] = -w.lower[i], w.upper[i]
        w.lengths[i] = w.lengths[n + i] = 1.0
    for row in range(len(w.g)):
        at, square = 2 * n + row, 0.0
        for j in range(1 + free):
            cuts[at, j] = 0.0
        for i in range(n):
            square += w.G[row, i] * w.G[row, i]
            cuts[at, 0] += w.G[row, i] * x[i]
            for j in range(free):
                cuts[at, 1 + j] += w.G[row, i] * w.null_basis[j, i] / _EPSILON
        w.ends[at], w.lengths[at] = w.g[row], math.sqrt(square) if square > 0.0 else 1.0


@plain
def scaled_program(w, tolerances):
    """Compute the verified solution at the largest feasible scale.

    Returns:
        ``SCALED``; ``INFEASIBLE`` where the limits exclude even a task at rest (b is then
        unchanged); else ``REFUSED``.
    """
    if reduced_program(w) != NO_ROOM:
        return REFUSED
    scale = largest_scale(w, tolerances.backoff)
    if scale == EXCLUDED:
        return INFEASIBLE
    for row in range(len(w.b)):
        w.b[row] *= scale
    if scale == 0.0 or solved_program(w, tolerances) != DONE:
        return REFUSED
    w.sensitivity[0] = scale
    return SCALED
