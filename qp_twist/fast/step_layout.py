"""Where a step's numbers lie in its two arrays, one of floats and one of integers.

Runs with and without numba: the step without it lies the same way.
"""

from __future__ import annotations

from typing import NamedTuple

from qp_twist.fast.compiling import plain

HEADER = 5
"""Entries of the integers that say how long everything is: nv, rows, tasks, limits, twist space."""
SETTINGS = 7
"""Entries of the settings: see ``prepared_step.settings_of``."""
TOLERANCES = 5
"""Entries of the tolerances of the verification."""


class Places(NamedTuple):
    """First entries of what a step is given and leaves behind.

    In the floats: settings and tolerances, costs of the free rows (2), θ̄, pull, wish and metric (nv
    each), then of each task shape (27), pose (12), target (18) and Jacobian (6, nv), of each limit
    its table (nv, 7), the program, which is what the step leaves behind, and its workspace. In the
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


@plain
def sizes(nv: int, m: int, count: int, twist_space: bool) -> tuple[int, int, int]:
    """Entries of the program of ``count`` tasks with m rows together, its workspace, its ints."""
    square = nv * nv
    program = m * nv + m + 7 * nv + (square if twist_space else nv)
    work = 3 * square + 5 * nv + 4 + m + 2 * m * nv + m * m + (6 * count * nv if twist_space else 0)
    return program, work, 1 + m + 3 * nv


@plain
def places(nv: int, m: int, count: int, limits: int, twist_space: bool) -> Places:
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
