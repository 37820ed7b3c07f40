"""Where a step's numbers lie in its two arrays, one of floats and one of integers."""

from __future__ import annotations

from typing import Any, NamedTuple

from qp_twist.fast.compiling import plain
from qp_twist.fast.views import matrix, stack, vector

HEADER = 5
"""Entries of the integers that say how long everything is: nv, rows, tasks, limits, twist space."""
SETTINGS = 7
"""Entries of the settings: see ``compiled_step.settings_of``."""
TOLERANCES = 5
"""Entries of the tolerances of the verification."""


class Places(NamedTuple):
    """First entries of what a step is given and leaves behind.

    In the floats: settings and tolerances, costs of the free rows (2), θ̄, pull, wish and metric (nv
    each), then of each task shape (27), pose (12), target (18) and Jacobian (6, nv), of each limit
    its table (7, nv), the program, which is what the step leaves behind, and its workspace. In the
    integers: the header, kinds of the tasks (3 each), addresses of the joints in q (nv), kinds of
    the limits, and the active set.
    """

    free_costs: int
    middle: int
    pull: int
    wish: int
    metric: int
    shapes: int
    poses: int
    targets: int
    jacobians: int
    limits: int
    program: int
    work: int
    floats: int
    kinds: int
    addresses: int
    types: int
    active: int
    integers: int


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
    kinds: Any
    addresses: Any
    types: Any


class Program(NamedTuple):
    """What a step reads and writes: the program, its result, and a workspace."""

    A: Any
    b: Any
    c: Any
    lower: Any
    upper: Any
    x: Any
    box: Any
    lower_kind: Any
    upper_kind: Any
    h: Any
    """Diagonal of H in joint space, (nv,); in twist space (0,)."""
    dense: Any
    """H in twist space, (nv, nv); in joint space a workspace."""
    q: Any
    y: Any
    u: Any
    three: Any
    root: Any
    line: Any
    J: Any
    R: Any
    scaled: Any
    V: Any
    square: Any
    free: Any
    no_rows: Any
    active: Any
    """Those active last time, (nv,), as many as ``ints[0]`` says."""
    ints: Any


@plain
def sizes(nv, m, count, twist_space):
    """Entries of the program of ``count`` tasks with m rows together, its workspace, its ints."""
    square = nv * nv
    program = m * nv + m + 7 * nv + (square if twist_space else nv)
    work = 3 * square + 5 * nv + 4 + m + 2 * m * nv + m * m + (6 * count * nv if twist_space else 0)
    return program, work, 1 + m + 3 * nv


@plain
def places(nv, m, count, limits, twist_space):
    """The places of a step with so many rows, tasks and limits."""
    program, work, ints = sizes(nv, m, count, twist_space)
    free_costs = SETTINGS + TOLERANCES
    middle = free_costs + 2
    shapes = middle + 4 * nv
    poses = shapes + 27 * count
    targets = poses + 12 * count
    jacobians = targets + 18 * count
    table = jacobians + 6 * nv * count
    first = table + 7 * nv * limits
    addresses = HEADER + 3 * count
    types = addresses + nv
    active = types + limits
    return Places(
        free_costs, middle, middle + nv, middle + 2 * nv, middle + 3 * nv, shapes, poses, targets,
        jacobians, table, first, first + program, first + program + work, HEADER, addresses, types,
        active, active + ints,
    )  # fmt: skip


@plain
def given(floats, integers, at):
    """Views of what a step is given."""
    nv, count, limits = integers[0], integers[2], integers[3]
    return Given(
        vector(floats, 0, SETTINGS), vector(floats, SETTINGS, TOLERANCES),
        vector(floats, at.free_costs, 2), vector(floats, at.middle, nv),
        vector(floats, at.pull, nv), vector(floats, at.wish, nv), vector(floats, at.metric, nv),
        matrix(floats, at.shapes, count, 27), matrix(floats, at.poses, count, 12),
        matrix(floats, at.targets, count, 18), stack(floats, at.jacobians, count, 6, nv),
        stack(floats, at.limits, limits, 7, nv), matrix(integers, at.kinds, count, 3),
        vector(integers, at.addresses, nv), vector(integers, at.types, limits),
    )  # fmt: skip


@plain
def program_at(floats, first, integers, active, nv, m, count, twist_space):
    """Views of the program of ``count`` tasks with m rows together; ``sizes`` says how long."""
    square, A = nv * nv, first
    b = A + m * nv
    c = b + m
    cost = c + 7 * nv
    after = cost + (square if twist_space else nv)  # the workspace
    J = after + square
    R = J + square
    three = R + square
    q = three + 3 * nv + 3
    u = q + nv
    y = u + nv + 1
    scaled = y + m
    V = scaled + m * nv
    small = V + m * nv
    return Program(
        matrix(floats, A, m, nv), vector(floats, b, m), vector(floats, c, nv),
        vector(floats, c + nv, nv), vector(floats, c + 2 * nv, nv), vector(floats, c + 3 * nv, nv),
        vector(floats, c + 4 * nv, nv), vector(floats, c + 5 * nv, nv),
        vector(floats, c + 6 * nv, nv), vector(floats, cost, 0 if twist_space else nv),
        matrix(floats, cost if twist_space else after, nv, nv), vector(floats, q, nv),
        vector(floats, y, m), vector(floats, u, nv + 1), matrix(floats, three, 3, nv + 1),
        vector(floats, three, nv), vector(floats, three + nv + 1, nv), matrix(floats, J, nv, nv),
        matrix(floats, R, nv, nv), matrix(floats, scaled, m, nv), matrix(floats, V, m, nv),
        matrix(floats, small, m, m),
        matrix(floats, small + m * m, 6 * count if twist_space else 0, nv),
        matrix(floats, first, 0, nv), vector(integers, active, nv),
        vector(integers, active + nv, 1 + m + 2 * nv),
    )  # fmt: skip
