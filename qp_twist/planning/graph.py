"""The cheapest path through layers of configurations, by dynamic programming."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # which loads its parts when they are first used

from qp_twist.checks import Array, Indices, Mask
from qp_twist.planning.layer import TURN, Layer, boxed


class Edges(NamedTuple):
    """Edges between the configurations of two layers."""

    start: Indices
    """Index in the first layer, (E,)."""
    end: Indices
    """Index in the second layer, (E,)."""

    def at(self, which: Indices | Mask) -> Edges:
        """Some of the edges."""
        return Edges(self.start[which], self.end[which])


@dataclass(frozen=True, eq=False)
class LayerPath:
    """A path through the layers, by the configuration in each layer; possibly incomplete.

    Then it ends before the first layer that cannot be reached, and its value is infinite; it was
    searched from the layer ``first``, whatever comes before. ``cuts`` are the layers before which
    it is interrupted.
    """

    nodes: list[int]
    value: float
    first: int = 0
    cuts: tuple[int, ...] = ()


Connections = Callable[[int, Indices], Edges]
"""Computes the edges from some nodes of a layer, by its index, to the next layer; all at once would
fill memory."""
Allowed = Callable[[int, Indices], Mask]
"""Which nodes (K,) of a layer are allowed: evaluated only for those that a path may reach."""
Valid = Callable[[int, Edges], Mask]
"""Which edges to the next layer are valid, (E,): evaluated for the best edge to each node only."""


def edges(here: Layer, nodes: Indices, after: Layer, largest_step: Array, period: Array) -> Edges:
    """Edges from some nodes (K,) of a layer to those of the next that are a step apart.

    Both are given by joint, (nv,): the largest step, rad or m, and the ``period``, 2π for joints
    whose whole turns do not matter, 0 for others.

    A hinge with a wide range makes copies of each configuration, which differ by whole turns: 64
    where six joints turn by 360° to either side. What is a step apart is found without the turns,
    and each copy is then connected with the one copy that is as far from it. Where a joint may turn
    by half a turn and more at once, more than one is: copies by its turns are configurations of
    their own.
    """
    turning = (here.turns.any(axis=0) | after.turns.any(axis=0)) & (largest_step < 0.5 * TURN)
    if not turning.any():
        found = _near(here.q[nodes], after.q, largest_step, period)
        return Edges(nodes[found.start], found.end)
    start, end = _Unturned.of(here, turning), _Unturned.of(after, turning)
    most = 1 + max(np.abs(start.turns).max(initial=0), np.abs(end.turns).max(initial=0))
    # One number for the turns of all joints, with a digit for each, from −most to most.
    base = 2 * int(most) + 1
    digits, size = np.zeros(len(turning), dtype=np.intp), base ** int(turning.sum())
    digits[turning] = base ** np.arange(turning.sum())
    codes = start.turns @ digits
    keys = end.which * size + end.turns @ digits
    order = np.argsort(keys)
    nodes = nodes[np.lexsort((codes[nodes], start.which[nodes]))]
    begun, begin, count = np.unique(start.which[nodes], return_index=True, return_counts=True)
    found = _near(start.q[begun], end.q, largest_step, np.where(turning, TURN, period))
    turned = np.rint((end.q[found.end] - start.q[begun[found.start]]) / TURN).astype(np.intp)
    # Each pair for all nodes at its start, and the node where its end has the turns for that.
    count = count[found.start]
    skipped = np.cumsum(count) - count
    node = nodes[np.repeat(begin[found.start] - skipped, count) + np.arange(count.sum())]
    wanted = np.repeat(found.end * size - turned @ digits, count) + codes[node]
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(order) - 1)
    other = order[place]
    is_there = keys[other] == wanted
    return Edges(node[is_there], other[is_there])


def alike(here: Layer, edge: Edges, after: Layer) -> tuple[Indices, Indices]:
    """Edges along which the bodies move alike: they differ by the same whole turns at both ends.

    Returns:
        The first of each such edges, (B,), and which of these each edge is like, (E,).
    """
    turned = after.turns[edge.end] - here.turns[edge.start]
    one, other = here.copies[1], after.copies[1]
    key = one[edge.start] * (1 + other.max(initial=0)) + other[edge.end]
    for joint in turned.T:
        least = joint.min(initial=0)
        key = key * (1 + joint.max(initial=0) - least) + joint - least
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    return first, which


class _Unturned(NamedTuple):
    """The configurations of a layer without whole turns of some joints.

    ``q`` are they, (B, nv), each of these joints within half a turn of 0; each node of the layer is
    one of them, ``which`` (K,), with so many ``turns`` of its joints, (K, nv).
    """

    q: Array
    which: Indices
    turns: Indices

    @classmethod
    def of(cls, layer: Layer, turning: Mask) -> _Unturned:
        """Those of a layer; copies by turns of joints not ``turning`` (nv,) are their own."""
        first, which = layer.copies
        if (layer.turns.any(axis=0) & ~turning).any():
            distinct = np.column_stack([which, layer.turns[:, ~turning]])
            _, first, which = np.unique(distinct, axis=0, return_index=True, return_inverse=True)
        turns = np.where(turning, np.rint(layer.q[first] / TURN), 0.0).astype(np.intp)
        since = layer.turns - layer.turns[first][which]
        return cls(layer.q[first] - TURN * turns, which, since + turns[which])


def _near(q: Array, after: Array, largest_step: Array, period: Array) -> Edges:
    """Pairs of configurations, (K, nv) and (M, nv), no joint of which is more than a step apart."""
    if not len(q) or not len(after):
        none = np.zeros(0, dtype=np.intp)
        return Edges(none, none)
    # Skip configurations that are further than a step from all of q in some joint.
    near = (after >= q.min(axis=0) - largest_step) & (after <= q.max(axis=0) + largest_step)
    kept = np.flatnonzero((near | (period > 0.0)).all(axis=1))
    box = period / largest_step
    trees = [
        scipy.spatial.KDTree(boxed(points / largest_step, box), boxsize=box)
        for points in (q, after[kept])
    ]
    found = trees[0].sparse_distance_matrix(trees[1], 1.0 + 1e-9, p=np.inf, output_type="ndarray")
    return Edges(found["i"], kept[found["j"]])


def cheapest_path(
    node_costs: Sequence[Array],
    connections: Connections,
    edge_cost: Callable[[int, Edges], Array] | None = None,
    *,
    at_most: float = np.inf,
    allowed: Allowed | None = None,
    valid: Valid | None = None,
    join: np.ufunc = np.add,
) -> LayerPath:
    """The path of least cost: the sum of its nodes' and edges' costs, or the largest of them.

    Args:
        node_costs: For each layer, (K,); infinite where a node is not allowed.
        connections: Computes the edges.
        edge_cost: Costs (E,) of the edges from a layer to the next; none if ``None``.
        at_most: A value known to be attainable: what exceeds it with the least costs of the
            remaining layers is dropped.
        allowed: Decides about nodes lazily; about those of the first layer their costs do.
        valid: Validates edges lazily.
        join: ``np.add`` for the sum of the costs, ``np.maximum`` for the largest one.
    """
    least = [cost.min(initial=np.inf) for cost in node_costs]
    ahead = join.accumulate(np.array([*least, 0.0 if join is np.add else -np.inf])[:0:-1])[::-1]
    graph = _Graph(node_costs, connections, edge_cost, allowed, valid, join)
    best = [_within(node_costs[0], join(node_costs[0], ahead[0]), at_most)]
    came: list[Indices] = []
    for layer in range(len(node_costs) - 1):
        values, before = graph.advanced(layer, best[-1], ahead[layer + 1], at_most)
        came.append(before)
        best.append(values)
        if not np.isfinite(best[-1]).any():
            break
    return _traced(best, came, len(node_costs))


def interrupted_path(
    node_costs: Sequence[Array],
    connections: Connections,
    edge_cost: Callable[[int, Edges], Array] | None,
    prices: Array,
    alone: Mask,
    *,
    allowed: Allowed | None = None,
    valid: Valid | None = None,
) -> LayerPath:
    """The path of least cost that may be interrupted, and then goes on from any allowed node.

    As :func:`cheapest_path`. ``prices`` are those of an interruption between each layer and the
    next, (layers − 1,), infinite where there may be none. Layers that are not ``alone`` (layers,)
    are not between two interruptions, nor between one and an end of the path.
    """
    graph = _Graph(node_costs, connections, edge_cost, allowed, valid, np.add)
    count = len(node_costs)
    reached = node_costs[0] if alone[0] else np.full(len(node_costs[0]), np.inf)
    here, left = node_costs[0], [reached]
    came, entered = list[Indices](), [np.zeros(len(here), dtype=bool)]
    for layer in range(count - 1):
        reached, before = graph.advanced(layer, here)
        costs = node_costs[layer + 1]
        after = left[-1].min() + prices[layer] + costs
        better = np.flatnonzero(after < reached)
        if allowed is not None and len(better):
            better = better[allowed(layer + 1, better)]
        here = reached.copy()
        here[better] = after[better]
        came.append(before)
        entered.append(here < reached)
        left.append(here if alone[layer + 1] else reached)
        if not np.isfinite(here).any():
            return LayerPath([], np.inf)
    value = float(left[-1].min())
    if not np.isfinite(value):
        return LayerPath([], np.inf)
    nodes, cuts = [int(np.argmin(left[-1]))], list[int]()
    by_edge = not alone[-1]
    for layer in range(count - 1, 0, -1):
        if entered[layer][nodes[-1]] and not by_edge:
            cuts.append(layer)
            nodes.append(int(np.argmin(left[layer - 1])))
            by_edge = not alone[layer - 1]
        else:
            nodes.append(int(came[layer - 1][nodes[-1]]))
            by_edge = False
    return LayerPath(nodes[::-1], value, cuts=tuple(cuts[::-1]))


@dataclass(frozen=True, eq=False)
class _Graph:
    """Layers and what connects them, as :func:`cheapest_path` takes them."""

    node_costs: Sequence[Array]
    connections: Connections
    edge_cost: Callable[[int, Edges], Array] | None
    allowed: Allowed | None
    valid: Valid | None
    join: np.ufunc

    def advanced(
        self, layer: int, here: Array, ahead: float = 0.0, at_most: float = np.inf
    ) -> tuple[Array, Indices]:
        """Least values at the nodes of the next layer from those ``here`` (K,), and where from.

        Those that exceed ``at_most`` with the least cost ``ahead`` are infinite.
        """
        join, costs = self.join, self.node_costs[layer + 1]
        edge = self.connections(layer, np.flatnonzero(np.isfinite(here)))
        values = here[edge.start]
        if self.edge_cost is not None:
            values = join(values, self.edge_cost(layer, edge))
        rest = join(costs, ahead)
        kept = np.isfinite(_within(values, join(values, rest[edge.end]), at_most))
        values, edge = values[kept], edge.at(kept)
        if self.allowed is not None:
            ends = np.zeros(len(costs), dtype=bool)
            ends[edge.end] = True
            nodes = np.flatnonzero(ends)
            ends[nodes] = self.allowed(layer + 1, nodes)
            kept = ends[edge.end]
            values, edge = values[kept], edge.at(kept)
        reached, before = _least(values, edge, len(costs), layer, self.valid)
        return np.where(np.isfinite(reached), join(reached, costs), np.inf), before


def _within(values: Array, costs: Array, most: float) -> Array:
    """The values, infinite where the costs exceed ``most`` by more than rounding."""
    within: Array = np.where(costs <= most + 1e-9 * max(abs(most), 1.0), values, np.inf)
    return within


def _least(
    values: Array, edge: Edges, count: int, layer: int, valid: Valid | None
) -> tuple[Array, Indices]:
    """Least value (count,) over the valid edges to each node of the second layer, and their starts.

    Validating every edge would take too long: only the best one to each node is validated, and if
    it is invalid, the next one, the next two, four and so on. Edges from places beside each other
    are invalid together, so that one by one takes many rounds, while most of all are valid.
    """
    reached, before = _minima(values, edge, count)
    if valid is None:
        return reached, before
    left = np.flatnonzero(np.isfinite(values))
    end = edge.end[left]
    next_ = (values[left] == reached[end]) & (edge.start[left] == before[end])
    found, size = np.full(len(values), np.inf), 1
    while True:
        chosen, left = left[next_], left[~next_]
        ok = chosen[valid(layer, edge.at(chosen))]
        found[ok] = values[ok]
        missing = np.ones(count, dtype=bool)
        missing[edge.end[ok]] = False
        left = left[missing[edge.end[left]]]
        if not len(left):
            return _minima(found, edge, count)
        if size == 1:
            left = left[np.lexsort((values[left], edge.end[left]))]
        first = np.flatnonzero(np.diff(edge.end[left], prepend=-1))
        rank = np.arange(len(left)) - np.repeat(first, np.diff(first, append=len(left)))
        next_, size = rank < size, 2 * size


def _minima(values: Array, edge: Edges, count: int) -> tuple[Array, Indices]:
    """Least of the values (E,) of the edges to each node, (count,), and where that begins."""
    reached, before = np.full(count, np.inf), np.zeros(count, dtype=np.intp)
    np.minimum.at(reached, edge.end, values)
    least = values == reached[edge.end]
    before[edge.end[least]] = edge.start[least]
    return reached, before


def _traced(best: list[Array], came: list[Indices], count: int) -> LayerPath:
    """Trace back from the best node of the last reached layer to the first layer."""
    if not np.isfinite(best[-1]).any():
        best = best[:-1]
    if not best:
        return LayerPath([], np.inf)
    node = int(np.argmin(best[-1]))
    value = float(best[-1][node]) if len(best) == count else np.inf
    nodes = [node]
    for before in reversed(came[: len(best) - 1]):
        nodes.append(int(before[nodes[-1]]))
    return LayerPath(nodes[::-1], value)
