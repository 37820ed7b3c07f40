"""What no motion can be better than: the best of every waypoint for itself."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.planning.layer import Layer
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_rows import PathRows, newton

_CANDIDATES = 6
"""Configurations of a layer, of different branches, from which a waypoint's best is looked for."""
_ROUNDS = 20
_LONGEST = 0.2
"""Largest step of a round, rad or m."""
_SETTLED = 1e-9
"""Less of z to gain by a step, to first order, is nothing."""


def pointwise_bound(
    objective: Objective,
    rows: PathRows,
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    start: Array | None,
) -> float:
    r"""The value which the objective would have if every waypoint stood alone.

    For the mean of z that of the waypoints' least z, for the margin the least of their largest.
    For travel the least that the joints must do for the task's own displacement, to first order in
    the spacing of the waypoints: with :math:`\Delta\mathbf q = (\mathbf U^T\mathbf J)^\dagger
    \mathbf U^T\Delta\mathbf t`, every joint displacement that does the same has a sum of absolute
    values of at least :math:`\lVert\Delta\mathbf q\rVert_2^2 / \lVert\Delta\mathbf q\rVert_\infty`
    (by the duality of the norms).

    Args:
        objective: The objective.
        rows: Of the path.
        layers: Of some waypoints; in each the most promising configurations are looked at.
        waypoints: Of those layers, from 0.
        start: The first configuration, if it is given.
    """
    count = len(rows.freedom)
    if objective.margin:
        q, at = _candidates(layers, waypoints, count, lambda q: -objective.margins(q))
        margins = _best(objective.margins(_climbed(q, at, rows, objective)), at, count, np.maximum)
        if start is not None:
            margins[0] = objective.margins(start)
        return float(margins.min())
    bound = 0.0
    if objective.centering:
        q, at = _candidates(layers, waypoints, count, objective.ranges.centring)
        z = _best(
            objective.ranges.centring(centred_nearby(q, at, rows, objective.ranges)),
            at,
            count,
            np.minimum,
        )
        if start is not None:
            z[0] = objective.ranges.centring(start)
        bound += objective.centering * float(z.mean())
    if objective.travel:
        bound += objective.travel * _least_travel(rows, layers, waypoints)
    return bound


def _candidates(
    layers: Sequence[Layer],
    waypoints: Sequence[int],
    count: int,
    cost: Callable[[Array], Array],
) -> tuple[Array, Indices]:
    """The best configurations of different branches, for every waypoint those of the nearest."""
    owner = np.argmin(np.abs(np.arange(count)[:, None] - np.asarray(waypoints)), axis=1)
    chosen = [best_of_branches(layer, cost) for layer in layers]
    q = np.concatenate([chosen[i] for i in owner])
    at = np.repeat(np.arange(count), [len(chosen[i]) for i in owner])
    return q, at


def best_of_branches(layer: Layer, cost: Callable[[Array], Array]) -> Array:
    """The best configurations of different branches, the best first, at most six, (K, nv)."""
    order = np.argsort(cost(layer.q), kind="stable")
    _, first = np.unique(layer.branch[order], return_index=True)
    best: Array = layer.q[order[np.sort(first)[:_CANDIDATES]]]
    return best


def centred_nearby(q: Array, at: Indices, rows: PathRows, ranges: JointRanges) -> Array:
    """Least z nearby, by Gauss and Newton's steps along the null space; NaN where it fails.

    Nothing holds the limits but z itself.
    """
    if rows.compiled is not None:
        q = np.array(q, order="C")
        rows.compiled.descend(q, at, ranges, newton(), (_ROUNDS, _LONGEST, _SETTLED))
        return q
    q, arrived = rows.correct(q, at)
    share = np.ones(len(q))
    moving = np.arange(len(q))
    for _ in range(_ROUNDS):
        here, there = q[moving], at[moving]
        basis = rows.motions(here, there)
        weighted = ranges.weight[:, None] * basis
        wish = ranges.weight * (ranges.middle - here)
        gram = weighted.transpose(0, 2, 1) @ weighted + 1e-12 * np.eye(weighted.shape[2])
        u = np.linalg.solve(gram, weighted.transpose(0, 2, 1) @ wish[:, :, None])
        step = share[moving, None] * (basis @ u)[:, :, 0]
        longest = np.abs(step).max(axis=1, initial=_LONGEST)
        moved, arrived_there = rows.correct(step * (_LONGEST / longest)[:, None] + here, there)
        gained = np.where(arrived_there, ranges.centring(here) - ranges.centring(moved), -1.0)
        q[moving[gained > 0.0]] = moved[gained > 0.0]
        share[moving[gained < 0.0]] *= 0.4
        expected = (step * ranges.weight * wish).sum(axis=1)
        moving = moving[(expected > _SETTLED) & (share[moving] > 0.01)]
        if not len(moving):
            break
    q[~arrived] = np.nan
    return q


def _climbed(q: Array, at: Indices, rows: PathRows, objective: Objective) -> Array:
    """Largest margin nearby, by trying both ways along each free direction, ever shorter."""
    q, arrived = rows.correct(q, at)
    step = np.full(len(q), _LONGEST)
    for _ in range(2 * _ROUNDS):
        basis = rows.motions(q, at)
        better = np.zeros(len(q), dtype=bool)
        for direction in range(basis.shape[2]):
            for sign in (1.0, -1.0):
                there, ok = rows.correct(q + sign * step[:, None] * basis[:, :, direction], at)
                wins = ok & (objective.margins(there) > objective.margins(q))
                q[wins] = there[wins]
                better |= wins
        step[~better] *= 0.5
    q[~arrived] = np.nan
    return q


def _best(values: Array, at: Indices, count: int, choose: np.ufunc) -> Array:
    """The best of each waypoint's values, (count,)."""
    best = np.full(count, np.inf if choose is np.minimum else -np.inf)
    finite = np.isfinite(values)
    choose.at(best, at[finite], values[finite])
    return best


def _least_travel(rows: PathRows, layers: Sequence[Layer], waypoints: Sequence[int]) -> float:
    """Degrees, over the whole path."""
    total = 0.0
    for layer, (index, after) in zip(layers, itertools.pairwise(waypoints), strict=False):
        dq = np.abs(rows.shortest(layer.q, np.full(len(layer.q), index + 1)))
        largest = dq.max(axis=1, initial=1e-300)
        total += (after - index) * float(((dq**2).sum(axis=1) / largest).min())
    return float(np.degrees(total))
