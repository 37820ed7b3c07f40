"""Where a robot may start: configurations of the first waypoint, inside the limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask
from qp_twist.planning.bound import best_of_branches, settled_nearby
from qp_twist.planning.central import as_far_as_inside, central_configurations
from qp_twist.planning.drawn import random_configurations
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.roadmap import Grid, Roadmap

_GRID = np.radians(4.0)
_AT_A_TIME = 300
"""Random configurations that are moved onto the first waypoint."""
_TIMES = 10


def least_z_start(path_task: PathTask) -> Array | None:
    """The configuration (nv,) of least z on the first waypoint; ``None`` if none is inside limits.

    Over all branches, turns, and what the task and its hard bands leave free.
    """
    found = central_configurations(path_task)
    return found[0].q if found else None


def least_mean_z(path_task: PathTask, waypoints: Sequence[int]) -> float:
    """Mean, over some waypoints, of the least z that each has for itself.

    NaN if one of them has no configuration inside the limits.
    """
    ranges = JointRanges.of(path_task.model)
    least = [
        float(ranges.centring(q[0])) if len(q) else np.nan for q in _central(path_task, waypoints)
    ]
    return float(np.mean(least))


def random_start(path_task: PathTask, rng: np.random.Generator) -> Array | None:
    """A random configuration (nv,) on the first waypoint; ``None`` if none inside limits is found.

    Configurations drawn uniformly between the limits (hinges without: over a turn) are moved onto
    the waypoint and into its hard bands by Newton's method; the first that ends inside the limits,
    too, is taken.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    for _ in range(_TIMES):
        drawn = random_configurations(ranges, _AT_A_TIME, rng)
        q, arrived = rows.correct_inside(drawn, np.zeros(_AT_A_TIME, dtype=np.intp))
        q = q[arrived & ranges.inside(q)]
        if len(q):
            start: Array = q[0]
            return start
    return None


def _central(path_task: PathTask, waypoints: Sequence[int]) -> list[Array]:
    """For each waypoint the configurations (K, nv) of least z of its branches, the least first."""
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    grid = Grid(_GRID, np.full(path_task.model.nv, 2.0 * _GRID))
    best = [
        best_of_branches(layer, ranges.centring)
        for layer in Roadmap(path_task, rows, grid).layers(waypoints)
    ]
    at = np.repeat(np.asarray(waypoints), [len(q) for q in best])
    q = np.concatenate(best)
    nearer = settled_nearby(q, at, rows, ranges)
    q = _lowered(q, np.where(np.isfinite(nearer), nearer, q), at, rows, ranges)
    q = q[np.lexsort((ranges.centring(q), at))]
    return np.split(q, np.cumsum([len(part) for part in best])[:-1])


def _lowered(q: Array, there: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """``there`` where that is inside limits and bands, else as far from q (K, nv) to it as is."""

    def inside(q: Array, at: Indices) -> Mask:
        within: Mask = ranges.inside(q) & rows.hard.inside(q, at)
        return within

    within = inside(there, at)
    last = np.where(within[:, None], there, q)
    over = np.flatnonzero(~within)
    last[over] = as_far_as_inside(
        q[over], there[over], at[over], rows, lambda middle: inside(middle, at[over])
    )
    return last
