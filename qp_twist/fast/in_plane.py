"""The point of a polygon that is nearest to the origin."""

from __future__ import annotations

import math

from qp_twist.fast.compiling import part, plain
from qp_twist.fast.dual_active_set import MET, MOST, PARALLEL

CORNER, ALONE, CONTRARY = 0, 1, 2
"""Two lines meet in a corner that both push to; one pushes alone; they are parallel, and their
half-planes have nothing in common."""


@part
def _most_left(rows, ends, lengths, count, active, z):
    """The half-plane that z is furthest from, of those that are not held; −1 if it is in all."""
    worst, most = -1, MET * max(1.0, abs(z[0]), abs(z[1]))
    for which in range(len(ends)):
        left = (rows[which, 0] * z[0] + rows[which, 1] * z[1] - ends[which]) / lengths[which]
        if left > most:
            held = (count > 0 and active[0] == which) or (count > 1 and active[1] == which)
            if not held:
                worst, most = which, left
    return worst


@part
def _let_one_go(rows, new, active, u):
    """Of two that are held keep the one that ``new`` takes longer to relieve; how many are kept."""
    ax, ay = rows[active[0], 0], rows[active[0], 1]
    bx, by = rows[active[1], 0], rows[active[1], 1]
    det = ax * by - ay * bx
    a = (rows[new, 0] * by - rows[new, 1] * bx) / det
    b = (ax * rows[new, 1] - ay * rows[new, 0]) / det
    first = u[0] / a if a > 0.0 else math.inf
    second = u[1] / b if b > 0.0 else math.inf
    if first == math.inf and second == math.inf:
        return 0
    if first <= second:
        active[0] = active[1]
    return 1


@part
def _meet(rows, ends, one, new, z, u):
    """Take z to where two lines meet, with their multipliers; whether both push there."""
    ax, ay, bx, by = rows[one, 0], rows[one, 1], rows[new, 0], rows[new, 1]
    det = ax * by - ay * bx
    if det * det <= PARALLEL * (ax * ax + ay * ay) * (bx * bx + by * by):
        return CONTRARY if ax * bx + ay * by < 0.0 else ALONE
    x, y = (ends[one] * by - ends[new] * ay) / det, (ax * ends[new] - bx * ends[one]) / det
    u[0], u[1] = (y * bx - x * by) / det, (x * ay - y * ax) / det
    if u[0] < 0.0:
        return ALONE
    z[0], z[1] = x, y
    return CORNER


@plain
def in_plane(rows, ends, lengths, active, z, u):
    """Minimise ½‖z‖² subject to rows · z ≤ ends, for two unknowns.

    The method of ``dual_active_set`` (Goldfarb and Idnani 1983) without factors, as one or two
    lines are held: the half-plane that is left most is held next, and what then would have to pull
    instead of push is let go. The distance grows with every round, so that it ends.

    Args:
        rows: (k, 2).
        ends: (k,); infinite where there is none.
        lengths: Units of what a half-plane is left by, (k,).
        active: Result, numbers of those held, at least (2,).
        z: Result, (2,).
        u: Result, their multipliers, at least (2,).

    Returns:
        How many are held, −1 where there is no such point.
    """
    count = 0
    z[0] = z[1] = 0.0
    for _ in range(MOST * (1 + len(ends))):
        new = _most_left(rows, ends, lengths, count, active, z)
        if new < 0:
            return count
        if count == 2:
            count = _let_one_go(rows, new, active, u)
            if count == 0:
                return -1
        meeting = ALONE
        if count == 1:
            meeting = _meet(rows, ends, active[0], new, z, u)
        if meeting == CONTRARY:
            return -1
        if meeting == CORNER:
            active[1], count = new, 2
            continue
        share = ends[new] / (rows[new, 0] * rows[new, 0] + rows[new, 1] * rows[new, 1])
        z[0], z[1] = share * rows[new, 0], share * rows[new, 1]
        active[0], u[0], count = new, -share, 1
    return -1
