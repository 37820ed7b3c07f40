"""The best path through layers of configurations, by dynamic programming."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from qp_twist.checks import Array, Indices
from qp_twist.planning.layer import boxed

Mask = npt.NDArray[np.bool_]
_ROUNDS = 4
"""Rounds in which only the best edge to each node is validated; then all remaining ones."""
_WIDER = (1.0 / 16.0, 0.25, 1.0)
"""Shares of the range of recorded values within which an allowed path is searched, in turn."""
_MOST_EDGES = 5_000_000
"""Number of edges beyond which nothing is recorded: it would fill memory."""
_UNKNOWN = -1


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
        impassable: First and last waypoint of a stretch that no path passes, whatever comes before
            it, if only that was searched.
    """

    nodes: list[int]
    value: float
    impassable: tuple[int, int] | None = None


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


@dataclass(eq=False)
class Record:
    """The edges of a search that has not asked which nodes are allowed and which edges are valid.

    Attributes:
        node_costs: For each layer, (K,).
        at_most: The value up to which it has searched.
        edges: Those from each layer to the next that may belong to a path of that value.
        costs: Their costs, (E,).
        reached: The least cost of a path to each node of the layer, (K,).
        is_complete: Whether the last layer was reached, and all edges were recorded.
    """

    node_costs: Sequence[Array] = ()
    at_most: float = np.inf
    edges: list[Edges] = field(default_factory=list)
    costs: list[Array] = field(default_factory=list)
    reached: list[Array] = field(default_factory=list)
    is_complete: bool = False
    _count: int = 0

    def begin(self, node_costs: Sequence[Array], at_most: float) -> None:
        """Forget another search."""
        self.node_costs, self.at_most, self._count = node_costs, at_most, 0
        self.edges, self.costs, self.reached = [], [], []

    def add(self, edge: Edges, cost: Array, reached: Array) -> None:
        """Add the edges to the next layer."""
        self._count += len(cost)
        if self._count > _MOST_EDGES:
            self.edges, self.costs, self.reached = [], [], []
            return
        self.edges.append(edge)
        self.costs.append(cost)
        self.reached.append(reached)

    def end(self) -> None:
        """The search has ended."""
        self.is_complete = len(self.edges) == len(self.node_costs) - 1


class Candidates:
    """All paths up to a value, of which the best is searched that is allowed.

    Which nodes are allowed and which edges are valid takes much longer to evaluate than to find the
    paths. Of a recorded search the least cost from each node to the last layer is known, too. So
    nodes and edges of paths that cost little more than the least are evaluated first, and never any
    others than those of paths up to the value.
    """

    def __init__(self, record: Record) -> None:
        """Keep the edges of a complete record that belong to a path of at most its value."""
        self._node_costs, self._at_most = record.node_costs, record.at_most
        self._edges: list[Edges] = []
        self._costs: list[Array] = []
        self._ahead = [np.zeros(len(self._node_costs[-1]))]
        for number in range(len(record.edges) - 1, -1, -1):
            edge, reached = record.edges[number], record.reached[number]
            rest = record.costs[number] + (self._node_costs[number + 1] + self._ahead[-1])[edge.end]
            ahead = np.full(len(reached), np.inf)
            np.minimum.at(ahead, edge.start, rest)
            kept = np.flatnonzero(np.isfinite(_within(reached[edge.start] + rest, self._at_most)))
            kept = kept[np.lexsort((edge.end[kept], edge.start[kept]))]
            self._ahead.append(ahead)
            self._edges.append(Edges(edge.start[kept], edge.end[kept]))
            self._costs.append(record.costs[number][kept])
        for parts in (self._ahead, self._edges, self._costs):
            parts.reverse()
        self._is_valid = [np.full(len(cost), _UNKNOWN, dtype=np.int8) for cost in self._costs]
        self._least = float((self._node_costs[0] + self._ahead[0]).min())

    def cheapest(self, first: Array, allowed: Allowed | None, valid: Valid | None) -> LayerPath:
        """The path of least value whose nodes are allowed and edges valid; incomplete if none is.

        ``first`` has the costs of the first layer's nodes, (K,), infinite where not allowed.
        """
        costs = [first, *self._node_costs[1:]]
        way = LayerPath([], np.inf)
        for share in _WIDER:
            way = cheapest_path(
                costs,
                self._connections,
                lambda number, edge: self._costs[number][self._rows(number, edge)],
                at_most=self._least + share * (self._at_most - self._least),
                allowed=allowed,
                valid=None if valid is None else self._each_once(valid),
                ahead=self._ahead,
            )
            if len(way.nodes) == len(costs):
                break
        return way

    def _connections(self, number: int, alive: Indices) -> Edges:
        edge = self._edges[number]
        chosen = np.zeros(len(self._node_costs[number]), dtype=bool)
        chosen[alive] = True
        kept = np.flatnonzero(chosen[edge.start])
        return Edges(edge.start[kept], edge.end[kept])

    def _rows(self, number: int, edge: Edges) -> Indices:
        """Rows of edges among those of a layer, which are sorted."""
        count = len(self._node_costs[number + 1])
        own = self._edges[number]
        return np.searchsorted(own.start * count + own.end, edge.start * count + edge.end)

    def _each_once(self, valid: Valid) -> Valid:
        """The same decision about edges, each of which is looked at once."""

        def known(number: int, edge: Edges) -> Mask:
            rows, is_valid = self._rows(number, edge), self._is_valid[number]
            new = np.flatnonzero(is_valid[rows] == _UNKNOWN)
            is_valid[rows[new]] = valid(number, Edges(edge.start[new], edge.end[new]))
            found: Mask = is_valid[rows] == 1
            return found

        return known


@dataclass(frozen=True, eq=False)
class LayerSearch:
    """What is searched: edges, their costs, and which nodes and edges are allowed.

    Attributes:
        connections: Computes the edges.
        edge_cost: As for :func:`cheapest_path`.
        allowed: Likewise.
        valid: Likewise.
        records: Whether paths are searched without ``allowed`` and ``valid`` first: where these
            take longer than all else.
    """

    connections: Connections
    edge_cost: Callable[[int, Edges], Array]
    allowed: Allowed | None
    valid: Valid | None
    records: bool

    def cheapest(
        self, node_costs: Sequence[Array], at_most: float, record: Record | None = None
    ) -> LayerPath:
        """The path of least cost, as far as it is ``at_most`` that; edges go to a ``record``."""
        if self.records and np.isfinite(at_most):
            found = Record()
            way = cheapest_path(
                node_costs, self.connections, self.edge_cost, at_most=at_most, record=found
            )
            if len(way.nodes) < len(node_costs):
                return way
            if found.is_complete:
                return Candidates(found).cheapest(node_costs[0], self.allowed, self.valid)
        return cheapest_path(
            node_costs, self.connections, self.edge_cost,
            at_most=at_most, allowed=self.allowed, valid=self.valid, record=record,
        )  # fmt: skip


def cheapest_path(
    node_costs: Sequence[Array],
    connections: Connections,
    edge_cost: Callable[[int, Edges], Array],
    *,
    at_most: float = np.inf,
    allowed: Allowed | None = None,
    valid: Valid | None = None,
    ahead: Sequence[Array] | None = None,
    record: Record | None = None,
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
        ahead: For each layer a lower bound of the cost from each node to the last layer, (K,);
            the least costs of the remaining layers if ``None``.
        record: Gets the edges; without ``allowed`` and ``valid``.
    """
    if ahead is None:
        least = np.array([cost.min(initial=np.inf) for cost in node_costs])
        sums = np.append(np.cumsum(least[::-1])[::-1][1:], 0.0)
        ahead = [np.broadcast_to(a, len(c)) for a, c in zip(sums, node_costs, strict=True)]
    if record is not None:
        record.begin(node_costs, at_most)
    in_reach = np.isfinite(_within(node_costs[0] + ahead[0], at_most))
    best = [np.where(in_reach, node_costs[0], np.inf)]
    came: list[Indices] = []
    for number in range(len(node_costs) - 1):
        edge = connections(number, np.flatnonzero(np.isfinite(best[-1])))
        along = edge_cost(number, edge)
        values = best[-1][edge.start] + along
        costs = node_costs[number + 1]
        rest = costs + ahead[number + 1]
        kept = np.flatnonzero(np.isfinite(_within(values + rest[edge.end], at_most)))
        values, edge = values[kept], Edges(edge.start[kept], edge.end[kept])
        if record is not None:
            record.add(edge, along[kept], best[-1])
        values, edge = _to_allowed(values, edge, len(costs), number, allowed)
        reached, before = _least(values, edge, len(costs), number, valid)
        came.append(before)
        best.append(reached + costs)
        if not np.isfinite(best[-1]).any():
            break
    way = _back(best, came, len(node_costs), smallest=True)
    if record is not None and len(way.nodes) == len(node_costs):
        record.end()
    return way


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
