"""Gather the bounds and inequality rows of mink limits for one program, compiled.

Bounds on single joints narrow one box, (4, nv): lower bounds, upper bounds, and the number of the
limit that sets each of them; of equal bounds the one with the smaller number counts. Other rows are
appended to G q̇ ≤ g:

=========  ==============  ==================================
argument   shape           content
=========  ==============  ==================================
rows       (capacity, nv)  G
ends       (capacity,)     g
which      (capacity,)     index of each row in its own limit
=========  ==============  ==================================
"""

from __future__ import annotations

import math

from qp_twist.kernel.bounds import _above, _below
from qp_twist.kernel.compiling import entry, plain

INVALID = -1
"""A bound or row is not a number, or too large to compute with."""


@plain
def _narrow(dof, low, high, number, box):
    """Narrow the bounds of one joint; return whether they are numbers."""
    box[0, dof], box[2, dof] = _above(low, number, box[0, dof], box[2, dof])
    box[1, dof], box[3, dof] = _below(high, number, box[1, dof], box[3, dof])
    return low < math.inf and high > -math.inf  # false for NaN


@entry
def narrow_box(lower, upper, number, box):
    """Narrow the box by bounds on all joints, each (nv,); return whether they are numbers."""
    fine = True
    for dof in range(len(lower)):
        fine &= _narrow(dof, lower[dof], upper[dof], number, box)
    return fine


@entry
def narrow_to_range(q, lower, upper, gain, dt, addresses, dofs, number, box):
    """Narrow the box by mink's joint ranges: a step may cover a share of the distance to an end.

    Args:
        q: Joint positions, (nq,).
        lower: θ_min, (nq,).
        upper: θ_max, (nq,).
        gain: The share.
        dt: Length of the step, s.
        addresses: Indices in q of the joints that have a range, (k,).
        dofs: Their degrees of freedom, (k,).
        number: Number of the limit.
        box: Result.

    Returns:
        Whether the bounds are numbers.
    """
    fine = True
    for k in range(len(dofs)):
        at = addresses[k]
        low, high = gain * (lower[at] - q[at]) / dt, gain * (upper[at] - q[at]) / dt
        fine &= _narrow(dofs[k], low, high, number, box)
    return fine


@entry
def append_rows(G, h, count, dt, number, unlimited, box, rows, ends, which, at):
    """Append the first ``count`` rows of G Δq ≤ h; rows with a single entry become bounds.

    Rows that hold for every velocity are left out.

    Args:
        G: Rows, (≥ count, nv).
        h: Right-hand sides, (≥ count,).
        count: Number of rows.
        dt: Length of the step, s.
        number: Number of the limit.
        unlimited: A bound beyond it counts as infinite, rad/s or m/s; larger entries of G are
            refused.
        box: Result.
        rows: Result, with room for all rows.
        ends: Result.
        which: Result.
        at: Number of rows before.

    Returns:
        Number of rows after.
    """
    for i in range(count):
        end = h[i] / dt
        entries, last = 0, 0
        for j in range(G.shape[1]):
            if G[i, j] != 0.0:
                if not abs(G[i, j]) <= unlimited:
                    return INVALID
                entries += 1
                last = j
        if not end > -math.inf:
            return INVALID
        if end > unlimited:
            end = math.inf
        if entries == 1:
            bound = end / G[i, last]
            if G[i, last] > 0.0:
                box[1, last], box[3, last] = _below(bound, number, box[1, last], box[3, last])
            else:
                box[0, last], box[2, last] = _above(bound, number, box[0, last], box[2, last])
        elif (entries > 1 and end < math.inf) or (entries == 0 and end < 0.0):
            for j in range(G.shape[1]):
                rows[at, j] = G[i, j]
            ends[at], which[at] = end, i
            at += 1
    return at
