"""The largest part of a step's rows that fits inside the limits, compiled."""

from __future__ import annotations

import math

from qp_twist.fast.compiling import part
from qp_twist.fast.dual_active_set import SOLVED, active_set
from qp_twist.fast.null_space import times_q
from qp_twist.fast.reduced_program import to_joints

BACKOFF = 1e-8
"""Share of a scaled task that is given up, so that its rows are not on the very edge."""
_EPSILON = 1e-5
"""Weight of the motion beside the scale: s comes out below its optimum by ½ε²‖z‖² at most."""
_CLEAR = 1e-6
"""What scaling takes from the rows has to be more, m/s or rad/s: less may count as met."""


@part
def largest_scale(w):
    r"""The largest s ≤ 1 for which A x = s b has a solution inside the limits, 0 for none.

    With the solutions :math:`\mathbf x = s\,\mathbf x_1 + \mathbf N z` of the rows it is the linear
    program of ``qp.scaling``. It is solved as the strictly convex

    .. math::

        \min_{s, z}\; \tfrac12(s - 2)^2 + \tfrac12\varepsilon^2\lVert z\rVert^2
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\; \mathbf G\mathbf x \le \mathbf g

    whose optimum is that of the linear program for every ε below some bound (Mangasarian and Meyer,
    SIAM J. Control Optim. 17, 1979), and near it above.

    Args:
        w: ``step_record.Program`` as ``reduced_program`` has left it: R and V of the rows, and what
            they leave free in ``ways``. Results are ``gain_box`` and ``gain_lam``: how much s grows
            with the room at each bound, negative at a lower one, and at each row of G.
    """
    p = len(w.c_s)
    _state(w)
    for i in range(p):
        for j in range(p):
            w.Js[i, j] = 0.0
        w.Js[i, i], w.c_s[i] = 1.0, 0.0
    w.c_s[0] = -2.0
    none = w.no_rows_s[:, 0]
    status, count = active_set(
        w.c_s, w.no_rows_s, none, w.cuts_s, w.ends, w.lengths, none, none, w.active_s, 0, w.x_s,
        w.u_s, w.Js, w.Rs, w.ints[1:], w.work_s,
    )  # fmt: skip
    scale, largest = w.x_s[0], 0.0
    for row in range(len(w.b)):
        largest = max(largest, abs(w.b[row]))
    if status != SOLVED or not scale > 0.0 or not (1.0 - scale) * largest > _CLEAR:
        return 0.0
    _gains(w, count, 1.0 / (2.0 - scale))
    return scale * (1.0 - BACKOFF)


@part
def _state(w):
    """Bounds and rows of G as half-spaces in s and εz; x of s = 1 and z = 0 is in ``line``."""
    m, n = w.A.shape
    for i in range(n):
        w.line[i] = 0.0
    for row in range(m):
        total = w.b[row]
        for i in range(row):
            total -= w.R[i, row] * w.line[i]
        w.line[row] = total / w.R[row, row]
    times_q(w.V, w.line)
    to_joints(len(w.h) > 0, w.root, w.J, w.line)
    for i in range(n):
        w.cuts_s[i, 0], w.cuts_s[n + i, 0] = -w.line[i], w.line[i]
        for j in range(n - m):
            along = w.ways[j, i] / _EPSILON
            w.cuts_s[i, 1 + j], w.cuts_s[n + i, 1 + j] = -along, along
        w.ends[i], w.ends[n + i] = -w.lower[i], w.upper[i]
        w.lengths[i] = w.lengths[n + i] = 1.0
    for row in range(len(w.g)):
        at, square = 2 * n + row, 0.0
        for j in range(1 + n - m):
            w.cuts_s[at, j] = 0.0
        for i in range(n):
            square += w.G[row, i] * w.G[row, i]
            w.cuts_s[at, 0] += w.G[row, i] * w.line[i]
            for j in range(n - m):
                w.cuts_s[at, 1 + j] += w.G[row, i] * w.ways[j, i] / _EPSILON
        w.ends[at], w.lengths[at] = w.g[row], math.sqrt(square) if square > 0.0 else 1.0


@part
def _gains(w, count, unit):
    """How much s grows with the room at each active constraint."""
    n = len(w.gain_box)
    for i in range(n):
        w.gain_box[i] = 0.0
    for row in range(len(w.gain_lam)):
        w.gain_lam[row] = 0.0
    for place in range(count):
        which, gain = w.active_s[place], unit * w.u_s[place]
        if which < n:
            w.gain_box[which] -= gain
        elif which < 2 * n:
            w.gain_box[which - n] += gain
        else:
            w.gain_lam[which - 2 * n] = gain
