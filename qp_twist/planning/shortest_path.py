"""The best path through layers of configurations, by dynamic programming."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from qp_twist.checks import Array, Indices
from qp_twist.planning.layer import boxed

Mask = npt.NDArray[np.bool_]
_ROUNDS = 4
"""Rounds in which only the best edge to each node is validated; then all remaining ones."""


class Edges(NamedTuple):
    """Edges between the configurations of two layers."""

    start: Indices
    """Index in the first layer, (E,)."""
    end: Indices
    """Index in the second layer, (E,)."""


@dataclass(frozen=True, eq=False)
class LayerPath:
    """A path through the layers, possibly incomplete.

    Attributes:
        nodes: Index of the configuration in each layer; ends before the first layer that cannot be
            reached.
        value: Value of the whole path; infinite if it is incomplete.
    """

    nodes: list[int]
    value: float


Connections = Callable[[int, Indices], Edges]
"""Computes the edges from some nodes of a layer to the next layer; all at once would fill
memory."""
Allowed = Callable[[int, Indices], Mask]
"""Which nodes (K,) of a layer are allowed: evaluated only for those that a path may reach."""
Valid = Callable[[int, Edges], Mask]
"""Which edges to the next layer are valid, (E,): evaluated for the best edge to each node only."""


def edges(q: Array, after: Array, largest_step: Array, period: Array) -> Edges:
    """Edges between configurations q (K, nv) and ``after`` (M, nv) that are one step apart.

    Args:
        q: Configurations.
        after: Configurations at the next waypoint.
        largest_step: Largest step of each joint, rad or m, (nv,).
        period: 2π for joints whose whole turns do not matter, 0 for others, (nv,).
    """
    if not len(q) or not len(after):
        none = np.zeros(0, dtype=np.intp)
        return Edges(none, none)
    # Skip configurations that are further than a step from all of q in some joint.
    near = (after >= q.min(axis=0) - largest_step) & (after <= q.max(axis=0) + largest_step)
    kept = np.flatnonzero((near | (period > 0.0)).all(axis=1))
    box = period / largest_step
    trees = [KDTree(boxed(points / largest_step, box), boxsize=box) for points in (q, after[kept])]
    found = trees[0].sparse_distance_matrix(trees[1], 1.0 + 1e-9, p=np.inf, output_type="ndarray")
    return Edges(found["i"], kept[found["j"]])


def cheapest_path(
    node_costs: Sequence[Array],
    connections: Connections,
    edge_cost: Callable[[int, Edges], Array],
    *,
    at_most: float = np.inf,
    allowed: Allowed | None = None,
    valid: Valid | None = None,
) -> LayerPath:
    """The path of least Σ node costs + Σ edge costs.

    Args:
        node_costs: For each layer, (K,); infinite where a node is not allowed.
        connections: Computes the edges.
        edge_cost: Costs (E,) of the edges from a layer, by its index, to the next.
        at_most: A value known to be attainable. A node is dropped if the cost up to it plus the
            least costs of the remaining layers exceed it.
        allowed: Decides about nodes lazily, if not all of them are allowed; about those of the
            first layer their costs do.
        valid: Validates edges lazily, if not all of them are valid.
    """
    least = np.array([cost.min(initial=np.inf) for cost in node_costs])
    ahead = np.append(np.cumsum(least[::-1])[::-1][1:], 0.0)
    best = [_within(node_costs[0], at_most - ahead[0])]
    came: list[Indices] = []
    for number in range(len(node_costs) - 1):
        edge = connections(number, np.flatnonzero(np.isfinite(best[-1])))
        values = best[-1][edge.start] + edge_cost(number, edge)
        costs = node_costs[number + 1]
        kept = np.isfinite(_within(values + costs[edge.end], at_most - ahead[number + 1]))
        values, edge = values[kept], Edges(edge.start[kept], edge.end[kept])
        values, edge = _to_allowed(values, edge, len(costs), number, allowed)
        reached, before = _least(values, edge, len(costs), number, valid)
        came.append(before)
        best.append(reached + costs)
        if not np.isfinite(best[-1]).any():
            break
    return _back(best, came, len(node_costs), smallest=True)


def widest_path(
    node_widths: Sequence[Array],
    connections: Connections,
    *,
    at_least: float = -np.inf,
    allowed: Allowed | None = None,
    valid: Valid | None = None,
) -> LayerPath:
    """The path whose smallest node width is largest.

    Args:
        node_widths: For each layer, (K,).
        connections: Makes the edges.
        at_least: A width known to be attainable; narrower nodes are dropped.
        allowed: As for :func:`cheapest_path`.
        valid: Likewise.
    """
    best = [-_within(-node_widths[0], -at_least)]
    came: list[Indices] = []
    for number in range(len(node_widths) - 1):
        edge = connections(number, np.flatnonzero(np.isfinite(best[-1])))
        values, widths = -best[-1][edge.start], node_widths[number + 1]
        kept = np.isfinite(_within(-widths[edge.end], -at_least))
        values, edge = values[kept], Edges(edge.start[kept], edge.end[kept])
        values, edge = _to_allowed(values, edge, len(widths), number, allowed)
        least, before = _least(values, edge, len(widths), number, valid)
        came.append(before)
        best.append(np.minimum(-least, widths))
        if not np.isfinite(best[-1]).any():
            break
    return _back(best, came, len(node_widths), smallest=False)


def _within(costs: Array, most: float) -> Array:
    """The costs, infinite where they exceed ``most`` by more than rounding."""
    within: Array = np.where(costs <= most + 1e-9 * max(abs(most), 1.0), costs, np.inf)
    return within


def _to_allowed(
    values: Array, edge: Edges, count: int, number: int, allowed: Allowed | None
) -> tuple[Array, Edges]:
    """The edges that end at allowed nodes of the next layer, with their values (E,)."""
    if allowed is None:
        return values, edge
    ends = np.zeros(count, dtype=bool)
    ends[edge.end] = True
    nodes = np.flatnonzero(ends)
    ends[nodes] = allowed(number + 1, nodes)
    kept = ends[edge.end]
    return values[kept], Edges(edge.start[kept], edge.end[kept])


def _least(
    values: Array, edge: Edges, count: int, number: int, valid: Valid | None
) -> tuple[Array, Indices]:
    """Least value (count,) over the valid edges to each node of the second layer, and their starts.

    Validating every edge would take too long: only the best one to each node is validated, and if
    it is invalid, the next best.
    """
    validated = np.zeros(len(values), dtype=bool)
    values = values.copy()
    for attempt in itertools.count():
        reached = np.full(count, np.inf)
        np.minimum.at(reached, edge.end, values)
        before = np.zeros(count, dtype=np.intp)
        giving = values == reached[edge.end]
        before[edge.end[giving]] = edge.start[giving]
        if valid is None:
            break
        chosen = giving & np.isfinite(values) & (edge.start == before[edge.end]) & ~validated
        if attempt >= _ROUNDS:  # all edges to the nodes whose best edges are invalid
            failing = np.zeros(count, dtype=bool)
            failing[edge.end[chosen]] = True
            chosen = failing[edge.end] & np.isfinite(values) & ~validated
        validated |= chosen
        which = np.flatnonzero(chosen)
        ok = valid(number, Edges(edge.start[which], edge.end[which]))
        values[which[~ok]] = np.inf
        if ok.all():
            break
    return reached, before


def _back(best: list[Array], came: list[Indices], count: int, *, smallest: bool) -> LayerPath:
    """Trace back from the best node of the last reached layer to the first layer."""
    if len(best[-1]) == 0 or not np.isfinite(best[-1]).any():
        best = best[:-1]
    if not best:
        return LayerPath([], np.inf)
    values = best[-1]
    node = int(np.argmin(values) if smallest else np.argmax(values))
    value = float(values[node]) if len(best) == count else np.inf
    nodes = [node]
    for before in reversed(came[: len(best) - 1]):
        node = int(before[node])
        nodes.append(node)
    return LayerPath(nodes[::-1], value)
