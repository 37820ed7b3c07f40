"""Configurations at single waypoints that weigh a preference, for the layers of a search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.planning.levels import Level
from qp_twist.planning.manifold_net import COVERED
from qp_twist.planning.problem import Problem

_BEST = 100
"""Number of configurations of each layer from which the minima are searched."""
_ROUNDS, _LONGEST, _SETTLED = 20, 0.2, 1e-3
"""Steps of a descent, the largest of them, and the one at which it ends, rad or m."""


def with_preferred(problem: Problem, level: Level) -> Level:
    """The level with minima of centering and preference at each waypoint as further configurations.

    Layers of two and more free degrees are spread over all of them, some 10° apart: the cost of a
    preference may change more between neighbours than what decides between two paths. Gauss-Newton
    steps in the null space go from the best configurations of each layer to minima beside them.
    """
    preferred = problem.objective.preferred
    if preferred is None or problem.freedom < COVERED or level.has_gaps:
        return level
    chosen = []
    for layer, at in zip(level.layers, level.waypoints, strict=True):
        values = preferred.of_layer(layer, at)
        cost = _cost(problem, layer.q, values, np.full(len(layer.q), at))
        chosen.append(np.argsort(cost)[:_BEST])
    begun = np.concatenate([layer.q[own] for layer, own in zip(level.layers, chosen, strict=True)])
    counts = [len(own) for own in chosen]
    q = _descended(problem, begun, np.repeat(level.waypoints, counts))
    layers = [
        layer.joined(more, layer.branch[own])
        for layer, own, more in zip(
            level.layers, chosen, np.split(q, np.cumsum(counts)[:-1]), strict=True
        )
    ]
    return replace(level, layers=layers)


def _cost(problem: Problem, q: Array, values: Array, at: Indices) -> Array:
    """Cost of configurations (K, nv) at their waypoints alone, without the number of these.

    ``values`` are their lead, tilt and roll, rad, (K, 3).
    """
    objective = problem.objective
    assert objective.preferred is not None
    z = objective.centering * objective.ranges.centering(q)
    cost: Array = z + objective.preferred.costs(values, at)
    return cost


def _descended(problem: Problem, q: Array, at: Indices) -> Array:
    """Configurations (K, nv) inside limits and bands, moved towards minima of the cost."""
    objective, rows, ranges = problem.objective, problem.rows, problem.objective.ranges
    preferred = objective.preferred
    assert preferred is not None
    weight, q = objective.centering * ranges.weight**2, q.copy()
    cost, radius = _cost(problem, q, preferred.values(q, at), at), np.full(len(q), _LONGEST)
    for _ in range(_ROUNDS):
        moving = np.flatnonzero(radius > _SETTLED)
        if not len(moving):
            break
        here, where = q[moving], at[moving]
        basis = rows.motions(here, where)
        A, b = preferred.slopes(here, where)
        H = weight[:, None] * np.eye(q.shape[1]) + A.swapaxes(1, 2) @ A
        g = weight * (here - ranges.middle) + (A.swapaxes(1, 2) @ b[:, :, None])[:, :, 0]
        inside = basis.swapaxes(1, 2) @ H @ basis
        damped = inside + 1e-9 * np.eye(basis.shape[2])
        u = -np.linalg.solve(damped, basis.swapaxes(1, 2) @ g[:, :, None])
        step = (basis @ u)[:, :, 0]
        length = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, radius[moving] / np.maximum(length, 1e-12))[:, None]
        there, arrived = rows.correct(here + step, where)
        kept = arrived & ranges.inside(there) & rows.hard.inside(there, where)
        lower = np.full(len(there), np.inf)
        values = preferred.values(there[kept], where[kept])
        lower[kept] = _cost(problem, there[kept], values, where[kept])
        better = lower < cost[moving]
        q[moving[better]], cost[moving[better]] = there[better], lower[better]
        radius[moving] = np.where(better, np.minimum(radius[moving], length), 0.25 * radius[moving])
    return q
