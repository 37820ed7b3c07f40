"""The best path through the layers of a level, whose nodes and edges are checked when reached."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.planning.certificate import CLOSE
from qp_twist.planning.graph import Edges, LayerPath, alike, cheapest_path, edges, interrupted_path
from qp_twist.planning.hard_constraints import BETWEEN, SHARES
from qp_twist.planning.layer import Layer
from qp_twist.planning.levels import STAGES, Level, Levels, Progress, SearchStage
from qp_twist.planning.on_the_path import OnThePath
from qp_twist.planning.problem import JudgedPath, PathConstraints, Problem

STRICTNESS = (1.0, 1e3)
"""Factors of the price, in turn: first for the best path, then for a feasible one."""
_PRICE, _PRICE_OF_TRAVEL = 1.0, 50.0
"""Price of a step twice as long as allowed: in z at a waypoint, and in degrees of travel; of the
time that of the longest step."""
_OF_ALL = 1.0
"""Weight of the sum of all joints' times at full speed beside that of the slowest, within the feed:
a layer knows no accelerations, of which every joint that moves needs some. Least times without a
feed with weights of 0.05, 0.3, 1, 3: deburring 1.676, 1.672, 1.671, 1.753 s; dome_seams 3.246,
3.192, 3.189, 3.211 s; turn_tilt 0.876, 0.876, 0.754, 0.754 s."""
_WITHIN = (0.05, 0.2, 0.6)
"""Shares above the layers' least mean z, or below their largest margin, within which a path is
searched first: few nodes are."""
_DETOUR = (0.02, 0.2)
"""The same for a window, in which the path gets around what it touches."""
ABOUT = 20
"""Number of waypoints on either side of a place that is searched by itself."""
_LOOSE = {"rad": np.radians([3.0, 1.0]), "m": np.array([5e-3, 1e-3])}
"""Violation of a band allowed along an edge of the grid: the programs smooth the path later."""


class CloserLooks(NamedTuple):
    """Where edges are evaluated more closely than all are: what searches have found out by then."""

    shares: dict[int, tuple[float, ...]]
    """Shares of intervals at which they are, in place of the same few of each."""
    asked: set[int]
    """Waypoints before the intervals in which they are asked whether they stay on the path."""

    def look_between(self, limits: PathConstraints, path: Array) -> None:
        """Have edges evaluated at more places where a path (N, nv) is outside between waypoints.

        An obstacle's corner passes between the shares at which all edges are evaluated.
        """
        beyond, share = limits.beyond_between(path)
        for at in np.flatnonzero((beyond > 0.0).any(axis=1)).tolist():
            self.shares[at] = (float(share[at]), *self.shares.get(at, CLOSE))


@dataclass(frozen=True, eq=False)
class LevelSearch:
    """A search of the best path through a level.

    Steps may exceed their limits by the grid's resolution, at a price: without it the path would
    jump between branches where a longer step just reaches, and could not be corrected into the
    limits. Nodes and edges are checked when a path reaches them.

    ``strict``: the price is that of a feasible path, not of the best one. ``stage`` says how
    far joints may move from layer to layer; ``closer`` says where edges are evaluated more
    closely, and is added to; ``progress`` is called with the current phase and its share done.
    """

    problem: Problem
    levels: Levels
    level: Level
    strict: bool
    stage: SearchStage
    closer: CloserLooks
    progress: Progress

    def best(self, known: float, within: Sequence[float] = _WITHIN) -> LayerPath:
        """The best path that is better than a ``known`` value, and stays on the path if it has to.

        Few edges do not: they are asked only in intervals where the best path has met one, and
        further around each time.
        """
        on_path, around = self.problem.limits.on_path, 1
        while True:
            way = self._best(known, within)
            if on_path is None or len(way.nodes) < len(self.level.layers):
                return way
            left = self._leaving(way, on_path)
            if self.closer.asked.issuperset(left):
                return way
            self.closer.asked.update(k for at in left for k in range(at - around, at + around + 1))
            around *= 2

    def _leaving(self, way: LayerPath, on_path: OnThePath) -> list[int]:
        """Waypoints after which a path through all layers leaves the path of the task."""
        q, waypoints = self.level.corners(way.nodes), np.array(self.level.waypoints)
        each = np.flatnonzero(np.diff(waypoints) == 1)
        end = q[each] + self.problem.unwound(q[each + 1] - q[each])
        kept = on_path.kept(q[each], end, waypoints[each], self._loose)
        left: list[int] = waypoints[each][~kept].tolist()
        return left

    def _best(self, known: float, within: Sequence[float]) -> LayerPath:
        """The best path that is better than a ``known`` value.

        First those are searched that are little worse than the best of each layer by itself, by the
        shares ``within`` in turn.
        """
        if not self.problem.objective.margin:
            return self._cheapest(self._centering, known, within)
        costs = [-self.problem.objective.margins(layer.q) for layer in self.level.layers]
        costs[0] = np.where(self._first_clear, costs[0], np.inf)
        # No path is wider than the narrowest layer.
        narrowest = max(float(cost.min()) for cost in costs)
        for share in (*within, np.inf):
            at_most = -known if share == np.inf else min(-known, narrowest * (1.0 - share))
            widest = cheapest_path(
                costs, self._connections, at_most=at_most, allowed=self._allowed,
                valid=self._valid, join=np.maximum,
            )  # fmt: skip
            if np.isfinite(widest.value):
                break
        else:
            return widest
        # Of many paths of equal width, take the most central.
        pairs = zip(costs, self._centering, strict=True)
        central = [np.where(cost > widest.value, np.inf, z) for cost, z in pairs]
        return self._cheapest(central, np.inf, within)

    def _cheapest(self, costs: list[Array], known: float, within: Sequence[float]) -> LayerPath:
        least = sum(float(cost.min()) for cost in costs)
        tried = [least * (1.0 + share) for share in within]
        before = 0
        for at_most in (*(value for value in tried if 0.0 < value < known), known):
            way = cheapest_path(
                costs, self._connections, self._edge_cost, at_most=at_most, allowed=self._allowed,
                valid=self._valid,
            )  # fmt: skip
            ended, layers = len(way.nodes), self.level.layers
            if ended == len(layers) or self.levels.is_blocked(self.problem, layers[ended]):
                break
            if at_most < known:
                stopped = self._ended_about(way, far=ended == before)
                if stopped is not None:
                    return stopped
            before = ended
        return way

    def interrupted(self, prices: Array, blocked: Mask, alone: Mask) -> LayerPath:
        """The best of the paths with the fewest interruptions (:func:`interrupted_path`).

        Their number times ``prices`` counts: 1, 0 where there is one anyway, or infinite where
        there may be none. Between ``blocked`` layers there is no motion, (layers − 1,) each.
        """
        grid = self.level.grid.joints
        longest = [
            float(self._way(k, (self._steps[k] + grid)[None])[0])
            + STRICTNESS[self.strict] * self._price * float((grid / self._steps[k]).max())
            for k in np.flatnonzero(~blocked).tolist()
        ]
        if (preferred := self.problem.objective.preferred) is not None:
            longest.append(len(blocked) * preferred.largest)
        # More than two paths with equally many of them can differ by.
        one = 1.0 + sum(longest) + sum(float(cost[np.isfinite(cost)].max(initial=0.0))
                                       for cost in self._centering)  # fmt: skip

        def connections(number: int, alive: Indices) -> Edges:
            return self._connections(number, alive[: 0 if blocked[number] else None])

        return interrupted_path(
            self._centering, connections, self._edge_cost, one * prices, alone,
            allowed=self._allowed, valid=self._valid,
        )  # fmt: skip

    def _ended_about(self, way: LayerPath, *, far: bool) -> LayerPath | None:
        """A path that ends around the place where another one has, from wherever it comes.

        ``None`` if one passes, or the whole level is not much longer. Takes a fraction of the time
        of a search of the whole level at any cost. Looks ``far`` back, too, twice as far each time:
        a branch on which the place is passed may have begun there.
        """
        waypoints, ended = self.level.waypoints, len(way.nodes)
        if not (self.problem.has_clearance and ended) or waypoints[-1] - waypoints[0] <= 4 * ABOUT:
            return None
        first, last = waypoints[ended - 1] - ABOUT, waypoints[ended] + ABOUT
        while True:
            part = replace(self, level=self.level.part(first, last))
            found = part.best(-np.inf if self.problem.objective.margin else np.inf, ())
            if len(found.nodes) < len(part.level.layers):
                skipped = waypoints.index(part.level.waypoints[0])
                return LayerPath([0] * skipped + found.nodes, np.inf, skipped)
            if not far or first <= 0:
                return None
            first -= last - first

    @cached_property
    def _first_clear(self) -> Mask:
        first = self.level.layers[0]
        return self.levels.clear(self.problem, first, np.arange(len(first.q)))

    @cached_property
    def _weight(self) -> float:
        """Weight of z at a waypoint."""
        return (self.problem.objective.centering + self.problem.objective.margin) / len(
            self.level.layers
        )

    @cached_property
    def _price(self) -> float:
        """Price of a step twice as long as allowed."""
        objective = self.problem.objective
        price = _PRICE * self._weight + _PRICE_OF_TRAVEL * objective.travel
        if (pace := objective.pace) is not None:
            price += objective.time * max(float((s / pace.velocity).max()) for s in self._steps)
        return price

    @cached_property
    def _centering(self) -> list[Array]:
        ranges = self.problem.objective.ranges
        costs = [self._weight * ranges.centering(layer.q) for layer in self.level.layers]
        if (preferred := self.problem.objective.preferred) is not None:
            costs = [
                cost + preferred.costs(values, np.full(len(cost), at)) / len(costs)
                for cost, at, values in zip(
                    costs, self.level.waypoints, self._preferred, strict=True
                )
            ]
        costs[0] = np.where(self._first_clear, costs[0], np.inf)
        return costs

    @cached_property
    def _preferred(self) -> list[Array]:
        """Lead, tilt and roll of each layer's configurations, rad, (K, 3) each."""
        preferred = self.problem.objective.preferred
        if preferred is None:
            return []
        layers = zip(self.level.layers, self.level.waypoints, strict=True)
        return [preferred.of_layer(layer, at) for layer, at in layers]

    @cached_property
    def _steps(self) -> list[Array]:
        """Largest step of each joint from each layer to the next, (nv,) each."""
        steps, stride = self.problem.limits.steps, self.level.stride
        steps, most = np.minimum(steps, self.stage.longest), self.stage.most
        return [
            np.minimum(steps[a : min(b, a + stride)].sum(axis=0), np.maximum(most, steps[a]))
            for a, b in itertools.pairwise(self.level.waypoints)
        ]

    def _connections(self, number: int, alive: Indices) -> Edges:
        level, grid = self.level, self.level.grid
        self.progress(f"{grid}: steps", (number + 1) / len(level.layers))
        here, after = level.layers[number : number + 2]
        return edges(here, alive, after, self._steps[number] + grid.joints, self.problem.period)

    def _edge_cost(self, number: int, edge: Edges) -> Array:
        layers = self.level.layers
        apart = layers[number + 1].q[edge.end] - layers[number].q[edge.start]
        apart = np.abs(self.problem.unwound(apart))
        share = (apart / self._steps[number]).T.copy()  # the largest of columns takes less time
        beyond = np.maximum(share.max(axis=0) - 1.0, 0.0)
        cost: Array = STRICTNESS[self.strict] * self._price * beyond + self._way(number, apart)
        if (preferred := self.problem.objective.preferred) is not None:
            rolls = [values[:, 2] for values in self._preferred[number : number + 2]]
            turned = rolls[1][edge.end] - rolls[0][edge.start]
            cost += preferred.change_costs(turned, *self.level.waypoints[number : number + 2])
        return cost

    def _way(self, number: int, apart: Array) -> Array:
        """Cost (E,) of displacements (E, nv) to the next layer: travel, and time at full speed."""
        objective, cost = self.problem.objective, np.zeros(len(apart))
        if objective.travel:
            cost += objective.travel * np.degrees(apart @ objective.joints)
        if (pace := objective.pace) is not None:
            first, last = self.level.waypoints[number : number + 2]
            seconds = apart / pace.velocity
            slowest = np.maximum(seconds.max(axis=1, initial=0.0), pace.feed[first:last].sum())
            cost += objective.time * (slowest + _OF_ALL * seconds.sum(axis=1))
        return cost

    @property
    def _allowed(self) -> Callable[[int, Indices], Mask] | None:
        if not self.problem.has_clearance:
            return None
        return lambda k, nodes: self.levels.clear(self.problem, self.level.layers[k], nodes)

    @property
    def _valid(self) -> Callable[[int, Edges], Mask] | None:
        limits = self.problem.limits
        return self._keeps_bands if limits.hard or limits.on_path else None

    def _keeps_bands(self, number: int, edge: Edges) -> Mask:
        """Which edges keep bands and constraints between waypoints, to the grid's resolution."""
        at, after = self.level.waypoints[number : number + 2]
        if after > at + 1:  # joints are not interpolated linearly there
            return np.ones(len(edge.start), dtype=bool)
        hard, on_path = self.problem.rows.hard, self.problem.limits.on_path
        here, there = self.level.layers[number : number + 2]
        begin = here.q[edge.start]
        end = begin + self.problem.unwound(there.q[edge.end] - begin)
        where, shares = np.full(len(begin), at), self.closer.shares.get(at, SHARES)
        first, which = alike(here, edge, there) if hard.of_bodies else (slice(None), slice(None))
        kept = hard.kept_between(begin[first], end[first], where[first], self._loose, shares)[which]
        if on_path is not None and at in self.closer.asked:
            kept[kept] = on_path.kept(begin[kept], end[kept], where[kept], self._loose)
        return kept

    @cached_property
    def _loose(self) -> dict[str, float]:
        """Violations that edges may have."""
        loose = {unit: allowed[int(self.strict)] for unit, allowed in _LOOSE.items()}
        if self.problem.rows.hard.lazy and self.strict:
            # No program leads around what an edge has passed through.
            loose["m"] = BETWEEN["m"]
        return loose


def search_windows(
    problem: Problem,
    levels: Levels,
    path: JudgedPath,
    violated: Indices,
    strict: bool,
    closer: CloserLooks,
    progress: Progress,
) -> Array | None:
    """The path with others on the finest grid around some waypoints; ``None`` if one has none."""
    q, count = path.q.copy(), len(path.q)
    windows = _windows(violated, count)
    if not windows:  # the violation is between waypoints
        return None
    for first, last in windows:
        waypoints = list(range(first, last + 1))
        level = levels.at(STAGES[-1], problem.limits.steps, waypoints)
        layers = list(level.layers)
        for end, held in ((0, first > 0 or problem.start is not None), (-1, last < count - 1)):
            if held:
                layers[end] = Layer.alone(q[waypoints[end]])
        level = replace(level, layers=layers)
        if level.has_gaps:
            return None
        way = LevelSearch(problem, levels, level, strict, STAGES[-1], closer, progress).best(
            -np.inf if problem.objective.margin else np.inf,
            _DETOUR if problem.has_clearance else _WITHIN,
        )
        if len(way.nodes) < len(layers):
            return None
        nodes = level.corners(way.nodes)
        nodes[1:] = nodes[0] + np.cumsum(problem.unwound(np.diff(nodes, axis=0)), axis=0)
        q[last:] += nodes[-1] - q[last]
        q[first : last + 1] = nodes
    return q


def _windows(violated: Indices, count: int) -> list[tuple[int, int]]:
    """First and last waypoint of the intervals around some waypoints, without overlap."""
    found: list[tuple[int, int]] = []
    for index in violated.tolist():
        first, last = max(0, index - ABOUT), min(count - 1, index + ABOUT)
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found
