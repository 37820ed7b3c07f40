"""Views of a step's numbers in its two arrays, one of floats and one of integers."""

from __future__ import annotations

from typing import Any, NamedTuple

from qp_twist.fast.compiling import plain
from qp_twist.fast.step_layout import SETTINGS, TOLERANCES
from qp_twist.fast.views import matrix, stack, vector


class Given(NamedTuple):
    """What a step is given; the arrays are those of ``twist_rows`` and ``bounds``."""

    settings: Any
    tolerances: Any
    free_costs: Any
    middle: Any
    pull: Any
    wish: Any
    metric: Any
    shapes: Any
    poses: Any
    targets: Any
    jacobians: Any
    limits: Any
    quadratic: Any
    """H of other tasks, (nv, nv), or (0, nv)."""
    linear: Any
    """Their c, (nv,), or (0,)."""
    kinds: Any
    ends: Any
    """Where the rows of each level end, (levels,)."""
    addresses: Any
    types: Any


class Program(NamedTuple):
    """What a step reads and writes: the program and its result, as ``Numbers`` has it; a workspace.

    The two kinds of costs, three kinds of rows and their ends and multipliers have names of their
    own here.
    """

    c: Any
    x: Any
    lower_kind: Any
    upper_kind: Any
    h: Any
    """Diagonal of H where it has no other entries, (nv,); else (0,)."""
    dense: Any
    """H where it has, (nv, nv); else (0, nv)."""
    A: Any
    G: Any
    upper: Any
    b: Any
    g: Any
    lower: Any
    box: Any
    y: Any
    lam: Any
    """λ of the rows of G, (k,)."""
    q: Any
    root: Any
    line: Any
    J: Any
    """S of H⁻¹ = SSᵀ where H has entries off its diagonal, (nv, nv)."""
    scaled: Any
    V: Any
    R: Any
    ways: Any
    """What the rows leave free, (p, nv), p = nv − m."""
    cuts: Any
    """Bounds and rows of G on it, (2 nv + k, p)."""
    ends: Any
    lengths: Any
    zero: Any
    z: Any
    u: Any
    three: Any
    Jz: Any
    Rz: Any
    no_rows: Any
    free: Any
    active: Any
    """Those active last time, (nv,), as many as ``ints[0]`` says."""
    ints: Any


@plain
def given(floats, integers, at, size):
    """Views of what a step is given."""
    nv, count, limits = size.nv, size.tasks, size.limits
    costs = nv if size.costs else 0
    return Given(
        vector(floats, 0, SETTINGS), vector(floats, SETTINGS, TOLERANCES),
        vector(floats, at.free_costs, 2), vector(floats, at.middle, nv),
        vector(floats, at.pull, nv), vector(floats, at.wish, nv), vector(floats, at.metric, nv),
        matrix(floats, at.shapes, count, 27), matrix(floats, at.poses, count, 12),
        matrix(floats, at.targets, count, 18), stack(floats, at.jacobians, count, 6, nv),
        stack(floats, at.limits, limits, nv, 7), matrix(floats, at.costs, costs, nv),
        vector(floats, at.costs + costs * nv, costs), matrix(integers, at.kinds, count, 3),
        vector(integers, at.ends, size.levels), vector(integers, at.addresses, nv),
        vector(integers, at.types, limits),
    )  # fmt: skip


@plain
def program_at(floats, first, integers, active, size):
    """Views of a program; ``entries`` says how long it is."""
    nv, m, k = size.nv, size.m, size.k
    is_dense = size.twist_space or size.costs
    square, cost = nv * nv, first + 4 * nv
    diagonal, whole = 0 if is_dense else nv, nv if is_dense else 0
    A = cost + (square if is_dense else nv)
    G = A + m * nv
    upper = G + k * nv
    lower = upper + nv + m + k
    box = lower + nv + m + k
    p, cuts = max(nv - m, 0), 2 * nv + k
    J = A + (m + size.room) * (nv + 3) + 3 * nv  # the workspace
    q = J + square
    scaled = q + 3 * nv
    V = scaled + m * nv
    R = V + m * nv
    ways = R + m * m
    z = ways + p * nv
    Jz = z + 6 * p + 4
    ends = Jz + 2 * p * p
    free = ends + (2 * nv + size.room) * (2 + p)
    free_rows = 6 * size.tasks if size.twist_space else 0
    return Program(
        vector(floats, first, nv), vector(floats, first + nv, nv),
        vector(floats, first + 2 * nv, nv), vector(floats, first + 3 * nv, nv),
        vector(floats, cost, diagonal), matrix(floats, cost, whole, nv),
        matrix(floats, A, m, nv), matrix(floats, G, k, nv),
        vector(floats, upper, nv), vector(floats, upper + nv, m),
        vector(floats, upper + nv + m, k), vector(floats, lower, nv), vector(floats, box, nv),
        vector(floats, box + nv, m), vector(floats, box + nv + m, k), vector(floats, q, nv),
        vector(floats, q + nv, nv), vector(floats, q + 2 * nv, nv),
        matrix(floats, J, nv, nv), matrix(floats, scaled, m, nv), matrix(floats, V, m, nv),
        matrix(floats, R, m, m), matrix(floats, ways, p, nv),
        matrix(floats, ends + 2 * cuts, cuts, p), vector(floats, ends, cuts),
        vector(floats, ends + cuts, cuts), vector(floats, z, p),
        vector(floats, z + p, p), vector(floats, z + 2 * p, p + 1),
        matrix(floats, z + 3 * p + 1, 3, p + 1), matrix(floats, Jz, p, p),
        matrix(floats, Jz + p * p, p, p), matrix(floats, ends, 0, p),
        matrix(floats, free, free_rows, nv),
        vector(integers, active, nv), vector(integers, active + nv, 1 + cuts),
    )  # fmt: skip
