"""Where a step's numbers lie in its two arrays, one of floats and one of integers.

Runs with and without numba: the step without it lies the same way.
"""

from __future__ import annotations

from typing import NamedTuple

from qp_twist.fast.compiling import plain

HEADER = 9
"""Entries of the integers that say how long everything is, in the order of :class:`Sizes`."""
SETTINGS = 8
"""Entries of the settings: see ``prepared_step.settings_of``."""
TOLERANCES = 6
"""Entries of the tolerances of the verification."""


class Sizes(NamedTuple):
    """How long everything in a step is."""

    nv: int
    m: int
    """Equality rows of all tasks together."""
    tasks: int
    levels: int
    limits: int
    twist_space: bool
    costs: bool
    """Whether other tasks add their costs."""
    room: int
    """Inequality rows that there is room for."""
    k: int
    """Inequality rows that there are."""


class Places(NamedTuple):
    """First entries of what a step is given and leaves behind.

    In the floats: settings and tolerances, costs of the free rows (2), θ̄, pull, wish and metric (nv
    each), then of each task shape (27), pose (12), target (18), its pose as quaternion and position
    (7), which ``live_step`` turns into the former, and Jacobian (6, nv), of each limit
    its table (nv, 7), the costs of other tasks (nv + 1, nv), the program, which is what the step
    leaves behind, and its workspace. In the integers: the header, kinds of the tasks (3 each),
    where the rows of each level end, addresses of the joints in q (nv), kinds of the limits, of
    each task how its frame hangs on the joints (nv), where MuJoCo's numbers are (3 and 2 for each
    task) and how many (2), and the active set. ``live_step`` reads what is between the kinds and
    the active set.
    """

    free_costs: int
    middle: int
    pull: int
    wish: int
    metric: int
    shapes: int
    poses: int
    targets: int
    aims: int
    jacobians: int
    limits: int
    costs: int
    program: int
    work: int
    floats: int
    kinds: int
    ends: int
    addresses: int
    types: int
    links: int
    sources: int
    active: int
    integers: int


@plain
def header(integers):
    """What the integers say of how long everything is."""
    return Sizes(
        integers[0], integers[1], integers[2], integers[3], integers[4], integers[5] != 0,
        integers[6] != 0, integers[7], integers[8],
    )  # fmt: skip


@plain
def entries(size: Sizes) -> tuple[int, int, int]:
    """Of the program with all the inequality rows there is room for, its workspace, its ints."""
    nv, m, room = size.nv, size.m, size.room
    square = nv * nv
    dense = size.twist_space or size.costs
    program = 7 * nv + (square if dense else nv) + (m + room) * (nv + 3)
    p, cuts = max(nv - m, 0), 2 * nv + room
    work = square + 3 * nv + 2 * m * nv + m * m + p * nv + 6 * p + 4 + 2 * p * p
    work += cuts * (2 + p) + (6 * size.tasks * nv if size.twist_space else 0)
    return program, work, 1 + cuts + nv


@plain
def places(size: Sizes) -> Places:
    """The places of a step of such sizes."""
    nv, count = size.nv, size.tasks
    program, work, ints = entries(size)
    free_costs = SETTINGS + TOLERANCES
    middle = free_costs + 2
    shapes = middle + 4 * nv
    poses = shapes + 27 * count
    targets = poses + 12 * count
    aims = targets + 18 * count
    jacobians = aims + 7 * count
    table = jacobians + 6 * nv * count
    costs = table + 7 * nv * size.limits
    first = costs + (nv * (nv + 1) if size.costs else 0)
    ends = HEADER + 3 * count
    addresses = ends + size.levels
    types = addresses + nv
    links = types + size.limits
    sources = links + nv * count
    active = sources + 5 + 2 * count
    return Places(
        free_costs, middle, middle + nv, middle + 2 * nv, middle + 3 * nv, shapes, poses, targets,
        aims, jacobians, table, costs, first, first + program, first + program + work, HEADER, ends,
        addresses, types, links, sources, active, active + ints,
    )  # fmt: skip
