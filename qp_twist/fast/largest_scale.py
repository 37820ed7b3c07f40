"""The largest part of a step's rows that fits inside the limits, compiled."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from qp_twist.fast.compiling import part, plain
from qp_twist.fast.dual_active_set import SOLVED, active_set
from qp_twist.fast.null_space import times_q
from qp_twist.fast.record import Floats, Record, reader
from qp_twist.fast.reduced_program import to_joints
from qp_twist.fast.step_record import Sizes

BACKOFF = 1e-8
"""Share of a scaled task that is given up, so that its rows are not on the very edge."""
_EPSILON = 1e-5
"""Weight of the motion beside the scale: s comes out below its optimum by ½ε²‖z‖² at most."""
_CLEAR = 1e-6
"""What scaling takes from the rows has to be more, m/s or rad/s: less may count as met."""


class ScaleProgram(NamedTuple):
    """The program in s and what the rows leave free, with its workspace."""

    cuts: Annotated[Floats, "2 * nv + k", "max(nv - m, 0) + 1"]
    c: Annotated[Floats, "max(nv - m, 0) + 1"]
    x: Annotated[Floats, "max(nv - m, 0) + 1"]
    u: Annotated[Floats, "max(nv - m, 0) + 2"]
    J: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    R: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    work: Annotated[Floats, 3, "max(nv - m, 0) + 2"]
    no_rows: Annotated[Floats, 0, "max(nv - m, 0) + 1"]


_read = reader(Record(ScaleProgram, Sizes))


@plain
def largest_scale(
    b, G, g, lower, upper, V, R, diagonal, root, S, ways, x, ends, lengths, gains, room, ints
):  # fmt: skip
    r"""The largest s ≤ 1 for which A x = s b has a solution inside the limits, 0 for none.

    With the solutions :math:`\mathbf x = s\,\mathbf x_1 + \mathbf N z` of the rows it is the linear
    program of ``qp.scaling``. It is solved as the strictly convex

    .. math::

        \min_{s, z}\; \tfrac12(s - 2)^2 + \tfrac12\varepsilon^2\lVert z\rVert^2
        \quad\text{s.t.}\quad lower \le \mathbf x \le upper,\; \mathbf G\mathbf x \le \mathbf g

    whose optimum is that of the linear program for every ε below some bound (Mangasarian and Meyer,
    SIAM J. Control Optim. 17, 1979), and near it above.

    Args:
        b: Right-hand side of the rows, (m,).
        G: (k, n).
        g: (k,).
        lower: (n,).
        upper: (n,).
        V: Of the rows, as ``reduced_program`` has left them, like R, root, S and ways.
        R: (m, m).
        diagonal: Whether H is diagonal.
        root: (n,).
        S: (n, n).
        ways: What the rows leave free, (n − m, n).
        x: Workspace, (n,).
        ends: Workspace, (2n + k,), as ``lengths``.
        lengths: Workspace.
        gains: Result, (1 + n + k,), but for the first: how much s grows with the room at each
            bound, negative at a lower one, and at each row of G.
        room: For ``ScaleProgram``.
        ints: Workspace, (2 + 3n + k,).
    """
    n, k = len(x), len(g)
    p, _, _ = _read(room, 0, ints, 0, Sizes(n, len(b), 0, 0, 0, 0, 0, 0, k))
    for i in range(n):
        x[i] = 0.0
    for row in range(len(b)):
        total = b[row]
        for i in range(row):
            total -= R[i, row] * x[i]
        x[row] = total / R[row, row]
    times_q(V, x)
    to_joints(diagonal, root, S, x)  # x of s = 1 and z = 0
    _half_spaces(p.cuts, x, ways, G, g, lower, upper, ends, lengths)
    for i in range(len(p.c)):
        for j in range(len(p.c)):
            p.J[i, j] = 0.0
        p.J[i, i], p.c[i] = 1.0, 0.0
    p.c[0] = -2.0
    none, active = p.no_rows[:, 0], ints[1 + 2 * n + k :]
    status, count = active_set(
        p.c, p.no_rows, none, p.cuts, ends, lengths, none, none, active, 0, p.x, p.u, p.J, p.R,
        ints[1 : 1 + 2 * n + k], p.work,
    )  # fmt: skip
    scale, largest = p.x[0], 0.0
    for row in range(len(b)):
        largest = max(largest, abs(b[row]))
    if status != SOLVED or not scale > 0.0 or not (1.0 - scale) * largest > _CLEAR:
        return 0.0
    for i in range(1, len(gains)):
        gains[i] = 0.0
    for place in range(count):
        which, gain = active[place], p.u[place] / (2.0 - scale)
        if which < n:
            gains[1 + which] -= gain
        else:
            gains[1 + which - n] += gain
    return scale * (1.0 - BACKOFF)


@part
def _half_spaces(cuts, x, ways, G, g, lower, upper, ends, lengths):
    """Bounds and rows of G as half-spaces in s and εz."""
    n, free = len(x), len(ways)
    for i in range(n):
        cuts[i, 0], cuts[n + i, 0] = -x[i], x[i]
        for j in range(free):
            along = ways[j, i] / _EPSILON
            cuts[i, 1 + j], cuts[n + i, 1 + j] = -along, along
        ends[i], ends[n + i] = -lower[i], upper[i]
        lengths[i] = lengths[n + i] = 1.0
    for row in range(len(g)):
        at, square = 2 * n + row, 0.0
        for j in range(1 + free):
            cuts[at, j] = 0.0
        for i in range(n):
            square += G[row, i] * G[row, i]
            cuts[at, 0] += G[row, i] * x[i]
            for j in range(free):
                cuts[at, 1 + j] += G[row, i] * ways[j, i] / _EPSILON
        ends[at], lengths[at] = g[row], math.sqrt(square) if square > 0.0 else 1.0
