"""From coarse to fine: a way through the layers, moved off the grid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.paths import PathTask
from qp_twist.planning.bound import pointwise_bound
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.hard_constraints import SHARES
from qp_twist.planning.layer import TURN, Layer
from qp_twist.planning.manifold_net import COVERED
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_constraints import PathConstraints, Violation
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.refine import ITERATIONS, Refined, refine
from qp_twist.planning.roadmap import Grid, Roadmap
from qp_twist.planning.shortest_path import Edges, Way, edges, shortest_way, widest_way

Progress = Callable[[str, float], None]
Trials = Callable[[Array | None], list[Array]]
"""Joint paths (N, nv) of other methods from a start (nv,); from the task's own if ``None``."""

COARSEST = np.radians(15.0)
"""Largest spacing of configurations in a joint, rad or m."""
_PRICE, _PRICE_OF_TRAVEL = 1.0, 50.0
"""Of a step twice as long as allowed: in z at a waypoint, and in degrees of travel."""
_ROUNDED, _ROUNDED_TRAVEL = 0.02, 0.3
"""What the grid may cost, as a share of the objective: travel sees its zigzag."""
_PROOFS = 12
"""Waypoints without a configuration that are looked at on the finest grid."""
_TRIAL = 8
"""Iterations after which a seed that is far from the best is given up."""
_ABOUT = 30
"""Waypoints to either side of one that breaks limits, which are looked for again."""
_LOOKED_WITHIN = (0.05, 0.2, 0.6)
"""Shares above the layers' least mean z within which a way is looked for first: few nodes are."""
_POINTS = 6
"""Times that points between waypoints are added at which a band was left."""
_STRICTNESS = (1.0, 1e3)
"""Times the price, one after the other: first for the best way, then for one that is possible."""
_LOOSE = {"rad": np.radians([3.0, 1.0]), "m": np.array([5e-3, 1e-3])}
"""What an edge of the grid may leave a band on its way then: the programs make the way smooth."""


@dataclass(frozen=True)
class SearchStage:
    """How coarsely to look.

    Attributes:
        motion: Of a joint between the waypoints that are looked at, rad.
        longest_stride: Most waypoints from one of them to the next.
        roll: Spacing of rolls, rad.
        joints: Least spacing of configurations in any joint, rad or m.
        resolution: The same as a share of the joint's motion, up to :data:`COARSEST`.
    """

    motion: float
    longest_stride: int
    roll: float
    joints: float
    resolution: float


_STAGES = (
    SearchStage(np.radians(30.0), 10, np.radians(4.0), np.radians(4.0), 0.25),
    SearchStage(np.radians(10.0), 4, np.radians(2.0), np.radians(2.0), 0.25),
    SearchStage(0.0, 1, np.radians(1.0), np.radians(1.0), 0.25),
)


@dataclass(frozen=True, eq=False)
class Found:
    """The outcome of a search.

    Attributes:
        path: The best path that breaks no constraint, if there is one.
        certificate: Why, or why not.
        layers: Of the last stage.
        waypoints: Of those layers, from 0.
        bound: What no path can be better than; NaN where a waypoint has no configuration, and of
            centering and margin where one leaves more than two degrees free.
    """

    path: Refined | None
    certificate: Certificate
    layers: list[Layer]
    waypoints: list[int]
    bound: float = np.nan


class Search:
    """A search for one task, objective and start.

    The stages look at more and more waypoints on finer and finer grids. In each, steps may be
    longer by what the grid cannot resolve; the quadratic programs that move the path off the grid
    then hold the limits exactly. The first stage whose path can be brought inside them ends it.

    The paths of other methods find passages near a singularity that are narrower than the grid.
    From a given start they come first, and bound what the stages must look at. With a free start
    they begin where the stages' path does, and only where that is not close to the bound.
    """

    def __init__(
        self,
        path_task: PathTask,
        objective: Objective,
        limits: PathConstraints,
        start: Array | None,
        runs: Trials | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Prepare.

        Args:
            path_task: The path.
            objective: What to be best in.
            limits: What holds at and between the waypoints.
            start: The first configuration, on the first waypoint, (nv,), or ``None``.
            runs: Gives the paths of other methods, from which the search may also go on.
            progress: Called with what is being done and the share of it that is.
        """
        self.path_task = path_task
        self.objective = objective
        self.limits = limits
        self.start = start
        self.runs = runs or (lambda start: [])
        self.rows = PathRows(path_task)
        self._progress = progress or (lambda what, share: None)
        ranges = limits.ranges
        #: Hinges without limits: of them whole turns do not matter.
        self._period = np.where(ranges.hinge & ~np.isfinite(ranges.upper - ranges.lower), TURN, 0.0)

    def run(self) -> Found:
        """Look for the best motion."""
        best: Refined | None = None
        tried = self._tried(self.start) if self.start is not None else []
        for trial in tried:
            best = self._better(best, trial)
        for stage in _STAGES:
            found = self._stage(stage, best)
            if found.path is not None:
                break
            if best is None and not all(len(layer.q) for layer in found.layers):
                # What is empty on the finest grid stays so: no need to look at the others.
                proven = self._proven_empty(found)
                if proven is not None:
                    return proven
        best = self._better(best, found.path)
        first, bound = best, self._bound(found, best)
        if self.start is None and (best is None or not _alike(bound, best.value)):
            tried = self._tried(None if best is None else best.q[0])
        for trial in tried:
            # One that is far from the best by now does not become it.
            near = best is not None and _alike(trial.value, best.value)
            if best is None or near or self.objective.better(trial.value, best.value):
                best = self._better(best, self._refined(trial.q))
        if best is None:
            return replace(found, bound=self._stated(bound))
        certificate = Certificate("path", found.certificate.grid, bands=self.rows.hard.names)
        if best is not first:
            bound = self._bound(found, best)
        return replace(found, path=best, certificate=certificate, bound=self._stated(bound))

    def _tried(self, start: Array | None) -> list[Refined]:
        """The runs of other methods that can be brought onto their waypoints, improved a little."""
        tried, at = [], np.arange(len(self.path_task.waypoints))
        for run in self.runs(start):
            on_path, arrived = self.rows.correct(run, at)
            if arrived.all():
                on_path[0] = run[0]
                tried.append(self._improved(on_path, iterations=_TRIAL))
        return tried

    def _bound(self, found: Found, best: Refined | None) -> float:
        if not all(len(layer.q) for layer in found.layers):
            return np.nan
        return pointwise_bound(
            self.path_task,
            self.objective,
            self.rows,
            found.layers,
            found.waypoints,
            self.start,
            None if best is None else best.q,
        )

    def _stated(self, bound: float) -> float:
        """The bound, where valleys of z and of the margin have been looked for everywhere."""
        pointwise = self.objective.centering > 0.0 or self.objective.margin
        return np.nan if pointwise and int(self.rows.freedom.max()) > COVERED else bound

    def _better(self, a: Refined | None, b: Refined | None) -> Refined | None:
        if b is None or not b.feasible:
            return a
        return b if a is None or self.objective.better(b.value, a.value) else a

    def _stage(self, stage: SearchStage, best: Refined | None) -> Found:
        count = len(self.path_task.waypoints)
        stride = int(np.clip(round(stage.motion / self._typical_step()), 1, stage.longest_stride))
        grid = self._grid(stage, stride)
        roadmap = Roadmap(self.path_task, self.rows, grid)
        waypoints = self._waypoints(stride, count)
        layers = roadmap.layers(
            waypoints, lambda done: self._progress(f"{grid}: layers", done / len(waypoints))
        )
        covered = all(roadmap.covers(index) for index in waypoints)
        if self.start is not None:
            layers[0] = Layer(self.start[None], np.full(1, -1), 1)
        empty = [i for i, layer in zip(waypoints, layers, strict=True) if not len(layer.q)]
        if empty:
            certificate = _empty(waypoints, layers, grid, roadmap)
            return Found(None, certificate, layers, waypoints)
        # The grid's way may be a little worse than the best one between its nodes.
        rounded = _ROUNDED_TRAVEL if self.objective.travel else _ROUNDED
        known = np.inf if best is None else best.value * (1.0 + rounded)
        if self.objective.margin:
            known = -np.inf if best is None else best.value - _ROUNDED * abs(best.value)
        refined = None
        for strictness in _STRICTNESS:
            way = self._way(layers, waypoints, grid, strictness, known)
            if len(way.nodes) < len(layers):
                if best is not None:  # the grid has nothing better
                    return Found(best, Certificate("path", grid), layers, waypoints)
                certificate = self._blocked(way, layers, waypoints, grid, covered)
                return Found(None, certificate, layers, waypoints)
            nodes = [layer.q[node] for layer, node in zip(layers, way.nodes, strict=True)]
            path = self._interpolated(np.array(nodes), waypoints)
            refined = None if path is None else self._refined(path)
            if refined is not None and not refined.feasible and stage is not _STAGES[-1]:
                refined = self._mended(refined) or refined
            if refined is not None and refined.feasible:
                return Found(refined, Certificate("path", grid), layers, waypoints)
        return Found(None, self._too_fast(refined, grid, covered), layers, waypoints)

    def _grid(self, stage: SearchStage, stride: int = 1) -> Grid:
        step = stride * np.median(self.limits.steps, axis=0)
        joints = np.clip(stage.resolution * step, stage.joints, COARSEST)
        return Grid(max(stage.roll, 0.5 * joints.max()), joints)

    def _mended(self, path: Refined) -> Refined | None:
        """The path, looked for anew on the finest grid about the waypoints where it breaks limits.

        Mostly these are a passage near a singularity that is too fast; the rest of the path need
        not be looked for again.
        """
        whole, count = path.q.copy(), len(path.q)
        grid = self._grid(_STAGES[-1])
        roadmap = Roadmap(self.path_task, self.rows, grid)
        broken = self.limits.broken(whole)
        if not len(broken):  # what is left of a band is between the waypoints
            return None
        for first, last in _stretches(broken, count):
            waypoints = list(range(first, last + 1))
            layers = roadmap.layers(waypoints)
            for end, held in ((0, first > 0 or self.start is not None), (-1, last < count - 1)):
                if held:
                    layers[end] = Layer(whole[waypoints[end]][None], np.full(1, -1), 1)
            if not all(len(layer.q) for layer in layers):
                return None
            way = self._way(
                layers, waypoints, grid, 1.0, -np.inf if self.objective.margin else np.inf
            )
            if len(way.nodes) < len(layers):
                return None
            nodes = np.array([layer.q[n] for layer, n in zip(layers, way.nodes, strict=True)])
            nodes[1:] = nodes[0] + np.cumsum(self._unwound(np.diff(nodes, axis=0)), axis=0)
            whole[last:] += nodes[-1] - whole[last]
            whole[first : last + 1] = nodes
        return self._refined(whole)

    def _proven_empty(self, found: Found) -> Found | None:
        """The same verdict on the finest grid, from some of its waypoints, if it holds there."""
        # Those that have none, and what was left out on either side of them.
        ends = [-1, *found.waypoints, len(self.path_task.waypoints)]
        open_ = sorted(
            {
                index
                for number, layer in enumerate(found.layers, start=1)
                if not len(layer.q)
                for index in range(ends[number - 1] + 1, ends[number + 1])
            }
        )
        chosen = np.unique(np.linspace(0, len(open_) - 1, _PROOFS).round().astype(int))
        grid = Grid(_STAGES[-1].roll, np.full(self.path_task.model.nv, _STAGES[-1].joints))
        roadmap = Roadmap(self.path_task, self.rows, grid)
        waypoints = [open_[k] for k in chosen]
        layers = roadmap.layers(waypoints)
        if all(len(layer.q) for layer in layers):
            return None
        return Found(None, _empty(waypoints, layers, grid, roadmap), layers, waypoints)

    def _typical_step(self) -> float:
        """How far a joint may move between two waypoints."""
        return float(np.median(self.limits.steps))

    def _waypoints(self, stride: int, count: int) -> list[int]:
        """Every ``stride``-th, the last, and those at which the projector changes."""
        in_force = self.path_task.in_force
        changes = {
            at for k in range(1, count) if in_force[k] is not in_force[k - 1] for at in (k - 1, k)
        }
        return sorted({*range(0, count, stride), count - 1, *changes})

    def _way(
        self,
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        strictness: float,
        known: float,
    ) -> Way:
        """The best way, with steps longer by what the grid does not resolve, at a price.

        Without the price the way would jump from branch to branch where a longer step just reaches,
        which nothing brings back inside the limits.
        """
        objective = self.objective
        allowed = [self.limits.steps[a:b].sum(axis=0) for a, b in itertools.pairwise(waypoints)]

        def connections(number: int, alive: Indices) -> Edges:
            self._progress(f"{grid}: steps", (number + 1) / len(layers))
            step = allowed[number] + grid.joints
            found = edges(layers[number].q[alive], layers[number + 1].q, step, self._period)
            return Edges(alive[found.start], found.end)

        def along(number: int, edge: Edges) -> Array:
            apart = layers[number + 1].q[edge.end] - layers[number].q[edge.start]
            apart = np.abs(self._unwound(apart))
            beyond = np.maximum((apart / allowed[number]).max(axis=1) - 1.0, 0.0)
            cost: Array = strictness * price * beyond
            if objective.travel:
                cost += objective.travel * np.degrees(apart.sum(axis=1))
            return cost

        def kept(number: int, edge: Edges) -> Mask:
            """Whether the bands are kept on the way to the next waypoint, as far as a grid can."""
            at = waypoints[number]
            if waypoints[number + 1] > at + 1:  # joints do not go straight there
                return np.ones(len(edge.start), dtype=bool)
            begin = layers[number].q[edge.start]
            end = begin + self._unwound(layers[number + 1].q[edge.end] - begin)
            inside = np.ones(len(begin), dtype=bool)
            for share in SHARES:
                here = np.full(len(begin), at), np.full(len(begin), share)
                inside &= (bands.margins_between(begin, end, *here) >= -loose).all(axis=1)
            return inside

        bands, attempt = self.rows.hard, _STRICTNESS.index(strictness)
        loose = np.array([_LOOSE[unit][attempt] for unit in bands.units])
        valid = kept if bands else None
        weight = (objective.centering + objective.margin) / len(layers)
        price = _PRICE * weight + _PRICE_OF_TRAVEL * objective.travel
        centering = [weight * objective.ranges.centring(layer.q) for layer in layers]
        if not objective.margin:
            least = sum(float(cost.min()) for cost in centering)
            for share in _LOOKED_WITHIN:
                at_most = least * (1.0 + share)
                if 0.0 < at_most < known:
                    way = shortest_way(centering, connections, along, at_most=at_most, valid=valid)
                    if len(way.nodes) == len(layers):
                        return way
            return shortest_way(centering, connections, along, at_most=known, valid=valid)
        margins = [objective.margins(layer.q) for layer in layers]
        widest = widest_way(margins, connections, at_least=known, valid=valid)
        if not np.isfinite(widest.value):
            return widest
        # Many ways are as wide; of them the most central.
        narrow = [margin < widest.value for margin in margins]
        centering = [np.where(n, np.inf, cost) for n, cost in zip(narrow, centering, strict=True)]
        return shortest_way(centering, connections, along, valid=valid)

    def _unwound(self, difference: Array) -> Array:
        """Differences of configurations less whole turns that do not matter."""
        unwound: Array = difference - self._period * np.round(difference / TURN)
        return unwound

    def _interpolated(self, corners: Array, waypoints: list[int]) -> Array | None:
        """A configuration on every waypoint, between those of the grid."""
        steps = self._unwound(np.diff(corners, axis=0))
        corners = corners[0] + np.vstack([np.zeros(corners.shape[1]), np.cumsum(steps, axis=0)])
        at = np.arange(len(self.path_task.waypoints))
        between = np.array([np.interp(at, waypoints, joint) for joint in corners.T]).T
        path, arrived = self.rows.correct(between, at)
        if self.start is not None:
            path[0] = self.start
        return path if arrived.all() else None

    def _refined(self, path: Array) -> Refined:
        return self._improved(path, lambda share: self._progress("off the grid", share))

    def _improved(
        self,
        path: Array,
        progress: Callable[[float], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> Refined:
        """The best path nearby that keeps the constraints at the waypoints and between them.

        Where the straight line in joints leaves a band between two waypoints by more than it may,
        the point where it does so most is a row of the programs from then on.
        """
        limits = self.limits
        for _ in range(1 + _POINTS):
            found = refine(path, self.rows, limits, self.objective, progress, iterations)
            if not self.rows.hard or not found.feasible:
                break
            path = found.q
            beyond, share = limits.beyond_between(path)
            left = np.flatnonzero((beyond > 0.0).any(axis=1))
            if not len(left):
                break
            found = replace(found, excess=float(beyond.max()))
            at, shares = limits.points
            points = np.concatenate([at, left]), np.concatenate([shares, share[left]])
            limits = replace(limits, points=points)
        return found

    def _blocked(
        self, way: Way, layers: list[Layer], waypoints: list[int], grid: Grid, covered: bool
    ) -> Certificate:
        """What is in the way between the last layer that is reached and the next."""
        number = max(len(way.nodes), 1)
        before, after = waypoints[number - 1], waypoints[number]
        here, there = layers[number - 1].q[way.nodes[-1]], layers[number].q
        step = self.limits.steps[before:after].sum(axis=0)
        share = np.abs(self._unwound(there - here)) / step
        nearest = share[np.argmin(share.max(axis=1))]
        joints = tuple(
            name for name, s in zip(self.limits.ranges.names, nearest, strict=True) if s > 1.0
        )
        return Certificate("speed", grid, (before + 1, after + 1), joints, covered)

    def _too_fast(self, path: Refined | None, grid: Grid, covered: bool) -> Certificate:
        """The grid has a way that cannot be brought inside the constraints."""
        if path is None:
            return Certificate("speed", grid, (), (), covered, "the grid's way leaves the path")
        worst = self.limits.worst(path.q)
        if worst.kind == "band":
            return _left(worst, grid, covered)
        step = np.abs(np.diff(path.q, axis=0)) / self.limits.steps
        number, joint = np.unravel_index(int(np.argmax(step)), step.shape)
        name = self.limits.ranges.names[int(joint)]
        first = int(number) + 1
        detail = (
            f"between waypoints {first} and {first + 1} the best needs {step.max():.3g} times the "
            f"step that {name} may do"
        )
        return Certificate("speed", grid, (first, first + 1), (name,), covered, detail)


def _left(worst: Violation, grid: Grid, covered: bool) -> Certificate:
    """The best path that was found leaves a band."""
    amount = f"{np.degrees(worst.excess):.3g}°"
    if worst.unit == "m":
        amount = f"{1e3 * worst.excess:.3g} mm"
    if worst.between:
        where: tuple[int, ...] = (worst.waypoint, worst.waypoint + 1)
        detail = (
            f"between waypoints {where[0]} and {where[1]}, where joints go straight, the best is "
            f"outside by {amount} more than what is allowed there; put more waypoints there"
        )
    else:
        where = (worst.waypoint + 1,)
        detail = f"at waypoint {where[0]} the best is outside by {amount}"
    return Certificate("band", grid, where, (), covered, detail, (worst.name,))


def _alike(value: float, best: float) -> bool:
    return abs(value - best) <= _ROUNDED * abs(best)


def _stretches(broken: Indices, count: int) -> list[tuple[int, int]]:
    """First and last waypoint of the stretches about some waypoints, without overlap."""
    found: list[tuple[int, int]] = []
    for index in broken:
        first, last = max(0, int(index) - _ABOUT), min(count - 1, int(index) + _ABOUT)
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found


def _empty(
    waypoints: Sequence[int], layers: Sequence[Layer], grid: Grid, roadmap: Roadmap
) -> Certificate:
    """Waypoints that are not reached; if all are, those outside the limits, or else the bands."""
    pairs = list(zip(waypoints, layers, strict=True))
    unreached = tuple(index + 1 for index, layer in pairs if layer.solutions == 0)
    sampled = all(roadmap.samples_all(index) for index in waypoints)
    if unreached:
        return Certificate("unreachable", grid, unreached, (), sampled)
    outside = [(index + 1, layer.outside) for index, layer in pairs if layer.outside]
    if outside:
        joints = tuple(dict.fromkeys(name for _, names in outside for name in names))
        at = tuple(index for index, _ in outside)
        return Certificate("limits", grid, at, joints, sampled)
    barred = [(index, layer.bands) for index, layer in pairs if not len(layer.q)]
    names = tuple(dict.fromkeys(name for _, bands in barred for name in bands))
    proven = all(roadmap.covers(index) for index, _ in barred)
    return Certificate("band", grid, tuple(k + 1 for k, _ in barred), (), proven, bands=names)
