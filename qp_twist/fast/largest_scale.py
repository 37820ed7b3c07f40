"""The largest part of a level's rows that fits inside the limits, compiled."""

from __future__ import annotations

import math

from qp_twist.fast.compiling import plain
from qp_twist.fast.dual_active_set import SOLVED, active_set
from qp_twist.fast.verified_program import DONE, REFUSED, SCALED, solved_program

_EPSILON = 1e-5
"""Weight of the motion beside the scale: s comes out below its optimum by ½ε²‖x‖² at most."""
_OF_THE_MOTION = 100.0 * _EPSILON * _EPSILON
"""A multiplier below this share of the motion may be what its weight makes of none."""
_CLEAR = 1e-6
"""What scaling takes from the rows has to be more, m/s or rad/s: less may count as met."""


@plain
def _pose(w, m):
    """The program in (s, x); the largest of the first m right-hand sides."""
    p, n, largest = w.scaling, len(w.x), 0.0
    for row in range(m):
        p.zero[row], p.A[row, 0] = 0.0, -w.b[row]
        largest = max(largest, abs(w.b[row]))
        for i in range(n):
            p.A[row, 1 + i] = w.A[row, i]
    for row in range(len(w.g)):
        p.G[row, 0], square = 0.0, 0.0
        for i in range(n):
            p.G[row, 1 + i] = w.G[row, i]
            square += w.G[row, i] * w.G[row, i]
        p.lengths[row] = math.sqrt(square) if square > 0.0 else 1.0
    for i in range(n + 1):
        for j in range(n + 1):
            p.J[i, j] = 0.0
        p.J[i, i], p.c[i] = 1.0 / _EPSILON, 0.0
        p.lower[i] = w.lower[i - 1] if i > 0 else -math.inf
        p.upper[i] = w.upper[i - 1] if i > 0 else math.inf
    p.J[0, 0], p.c[0] = 1.0, -2.0
    return largest


@plain
def largest_scale(w, m, backoff):
    r"""The largest s ≤ 1 for which A x = s b has a solution inside the limits, 0 for none.

    It is the linear program of ``qp.scaling``, solved as the strictly convex

    .. math::

        \min_{s, \mathbf x}\; \tfrac12(s - 2)^2
        + \tfrac12\varepsilon^2\lVert\mathbf x\rVert^2
        \quad\text{s.t.}\quad \mathbf A\mathbf x = s\,\mathbf b,\;
        lower \le \mathbf x \le upper,\; \mathbf G\mathbf x \le \mathbf g

    whose optimum is that of the linear program for every ε below some bound (Mangasarian and Meyer,
    SIAM J. Control Optim. 17, 1979), and near it above.

    Args:
        w: ``step_record.Program``. Result, where s > 0: ``gains``, but for the first.
        m: How many rows of A are scaled: those of the first level.
        backoff: Share that is given up, so that the scaled rows are not on the very edge.
    """
    p, n, k, largest = w.scaling, len(w.x), len(w.g), _pose(w, m)
    status, count = active_set(
        p.c, p.A[:m], p.zero[:m], p.G, w.g, p.lengths, p.lower, p.upper, p.active, len(w.nothing),
        p.x, p.u, p.J, p.R, p.held, p.work,
    )  # fmt: skip
    scale = p.x[0]
    if status != SOLVED or not scale > 0.0 or not (1.0 - scale) * largest > _CLEAR:
        return 0.0
    for i in range(1, len(w.gains)):
        w.gains[i] = 0.0
    furthest = 1.0
    for i in range(1, n + 1):
        furthest = max(furthest, abs(p.x[i]))
    for place in range(count):
        if not p.u[place] > _OF_THE_MOTION * furthest:
            continue
        which, gain = p.active[place] - m, p.u[place] / (2.0 - scale)
        if which >= k + n + 1:
            w.gains[which - k - n - 1] += gain
        elif which >= k:
            w.gains[which - k] -= gain
        elif which >= 0:
            w.gains[1 + n + which] += gain
    return scale * (1.0 - backoff)


@plain
def scaled_program(w, tolerances):
    """The verified solution at the largest speed that fits: ``SCALED``, else ``REFUSED``."""
    scale = largest_scale(w, len(w.b), tolerances.backoff)
    for row in range(len(w.b)):
        w.b[row] *= scale
    if scale == 0.0 or solved_program(w, tolerances) != DONE:
        return REFUSED
    w.gains[0] = scale
    return SCALED
