"""The best way through layers of configurations, by dynamic programming."""

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
"""Times that the best edge to each node is asked for; then all that are left."""


class Edges(NamedTuple):
    """Pairs of configurations of two layers that a motion can connect."""

    start: Indices
    """Number in the first layer, (E,)."""
    end: Indices
    """Number in the second layer, (E,)."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way through the layers, or how far there is one.

    Attributes:
        nodes: Number of the configuration in each layer; ends before the first layer that none of
            those reached before leads to.
        value: Of the whole way; infinite if it ends early.
    """

    nodes: list[int]
    value: float


Connections = Callable[[int, Indices], Edges]
"""Makes the edges from some nodes of a layer to the next layer; all at once would fill memory."""
Valid = Callable[[int, Edges], Mask]
"""Which edges to the next layer can be gone, (E,): asked of the best edge to each node only."""


def edges(q: Array, after: Array, largest_step: Array, period: Array) -> Edges:
    """Which of the configurations q (K, nv) and ``after`` (M, nv) are one step apart.

    Args:
        q: Configurations.
        after: Configurations at the next waypoint.
        largest_step: Of each joint, rad or m, (nv,).
        period: 2π for joints of which whole turns do not matter, 0 for others, (nv,).
    """
    if not len(q) or not len(after):
        none = np.zeros(0, dtype=np.intp)
        return Edges(none, none)
    # What is further from all of q than a step in some joint need not be looked at.
    near = (after >= q.min(axis=0) - largest_step) & (after <= q.max(axis=0) + largest_step)
    kept = np.flatnonzero((near | (period > 0.0)).all(axis=1))
    box = period / largest_step
    trees = [KDTree(boxed(points / largest_step, box), boxsize=box) for points in (q, after[kept])]
    found = trees[0].sparse_distance_matrix(trees[1], 1.0 + 1e-9, p=np.inf, output_type="ndarray")
    return Edges(found["i"], kept[found["j"]])


def shortest_way(
    node_costs: Sequence[Array],
    connections: Connections,
    edge_cost: Callable[[int, Edges], Array],
    *,
    at_most: float = np.inf,
    valid: Valid | None = None,
) -> Way:
    """The way of least Σ node costs + Σ edge costs.

    Args:
        node_costs: For each layer, (K,); infinite where a node is not allowed.
        connections: Makes the edges.
        edge_cost: Costs (E,) of the edges from the layer of a number to the next.
        at_most: A value that is known to be possible. A node is given up as soon as what leads to
            it and the least costs of the layers ahead are more.
        valid: Says which edges can be gone, where that is not known of all beforehand.
    """
    least = np.array([cost.min(initial=np.inf) for cost in node_costs])
    ahead = np.append(np.cumsum(least[::-1])[::-1][1:], 0.0)
    best = [_within(node_costs[0], at_most - ahead[0])]
    came: list[Indices] = []
    for number in range(len(node_costs) - 1):
        edge = connections(number, np.flatnonzero(np.isfinite(best[-1])))
        values = best[-1][edge.start] + edge_cost(number, edge)
        reached, before = _least(values, edge, len(node_costs[number + 1]), number, valid)
        came.append(before)
        best.append(_within(reached + node_costs[number + 1], at_most - ahead[number + 1]))
        if not np.isfinite(best[-1]).any():
            break
    return _back(best, came, len(node_costs), smallest=True)


def widest_way(
    node_widths: Sequence[Array],
    connections: Connections,
    *,
    at_least: float = -np.inf,
    valid: Valid | None = None,
) -> Way:
    """The way whose smallest node width is largest.

    Args:
        node_widths: For each layer, (K,).
        connections: Makes the edges.
        at_least: A width that is known to be possible; narrower nodes are given up.
        valid: As for :func:`shortest_way`.
    """
    best = [-_within(-node_widths[0], -at_least)]
    came: list[Indices] = []
    for number in range(len(node_widths) - 1):
        edge = connections(number, np.flatnonzero(np.isfinite(best[-1])))
        values = -best[-1][edge.start]
        least, before = _least(values, edge, len(node_widths[number + 1]), number, valid)
        most = -least
        came.append(before)
        best.append(-_within(-np.minimum(most, node_widths[number + 1]), -at_least))
        if not np.isfinite(best[-1]).any():
            break
    return _back(best, came, len(node_widths), smallest=False)


def _within(costs: Array, most: float) -> Array:
    """The costs, infinite where they are above ``most`` by more than rounding."""
    within: Array = np.where(costs <= most + 1e-9 * max(abs(most), 1.0), costs, np.inf)
    return within


def _least(
    values: Array, edge: Edges, count: int, number: int, valid: Valid | None
) -> tuple[Array, Indices]:
    """Least value (count,) of the valid edges to each node of the second layer, and their starts.

    To ask of every edge whether it is valid would take too long: only the best to each node is
    asked about, and where it is not, the next best.
    """
    asked = np.zeros(len(values), dtype=bool)
    values = values.copy()
    for attempt in itertools.count():
        reached = np.full(count, np.inf)
        np.minimum.at(reached, edge.end, values)
        before = np.zeros(count, dtype=np.intp)
        giving = values == reached[edge.end]
        before[edge.end[giving]] = edge.start[giving]
        if valid is None:
            break
        chosen = giving & np.isfinite(values) & (edge.start == before[edge.end]) & ~asked
        if attempt >= _ROUNDS:  # all edges to the nodes whose best ones could not be gone
            failing = np.zeros(count, dtype=bool)
            failing[edge.end[chosen]] = True
            chosen = failing[edge.end] & np.isfinite(values) & ~asked
        asked |= chosen
        which = np.flatnonzero(chosen)
        ok = valid(number, Edges(edge.start[which], edge.end[which]))
        values[which[~ok]] = np.inf
        if ok.all():
            break
    return reached, before


def _back(best: list[Array], came: list[Indices], count: int, *, smallest: bool) -> Way:
    """From the best node of the last layer that is reached to the first layer."""
    if len(best[-1]) == 0 or not np.isfinite(best[-1]).any():
        best = best[:-1]
    if not best:
        return Way([], np.inf)
    values = best[-1]
    node = int(np.argmin(values) if smallest else np.argmax(values))
    value = float(values[node]) if len(best) == count else np.inf
    nodes = [node]
    for before in reversed(came[: len(best) - 1]):
        node = int(before[node])
        nodes.append(node)
    return Way(nodes[::-1], value)
