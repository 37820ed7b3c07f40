"""Search from coarse to fine: the best path through the layers, then moved off the grid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.paths import PathTask
from qp_twist.planning.bound import pointwise_bound
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.hard_constraints import BETWEEN, SHARES, WITHIN
from qp_twist.planning.layer import TURN, Layer, centred, forbidding_bands
from qp_twist.planning.manifold_net import BOUNDED, COVERED
from qp_twist.planning.objective import Objective
from qp_twist.planning.path_constraints import PathConstraints, Violation
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.prescribed_pairs import TooNear, too_near
from qp_twist.planning.refine import ITERATIONS, RefinedPath, judged, refine
from qp_twist.planning.roadmap import Grid, Roadmap
from qp_twist.planning.shortest_path import (
    Candidates,
    Edges,
    LayerPath,
    LayerSearch,
    Record,
    edges,
    widest_path,
)

Progress = Callable[[str, float], None]
Slower = Callable[[float], PathConstraints]
"""The constraints of a path that takes so many times as long."""
Trials = Callable[[PathTask, Array | None], list[Array]]
"""Joint paths (N, nv) of other methods for a task from a start (nv,); its own if ``None``."""

COARSEST = np.radians(15.0)
"""Largest spacing of configurations in a joint, rad or m."""
_PRICE, _PRICE_OF_TRAVEL = 1.0, 50.0
"""Price of a step twice as long as allowed: in z at a waypoint, and in degrees of travel."""
_ROUNDED, _ROUNDED_TRAVEL = 0.02, 0.3
"""Possible loss by the grid, as a share of the objective: travel includes its zigzag."""
_PROOFS = 12
"""Largest number of waypoints without a configuration that are searched on the finest grid."""
_TRIED, _SEEDING = 16, 2000
"""Numbers of random configurations that are corrected onto each waypoint, and of those found that
are further seeds of waypoints without one."""
_TRIAL = 4, 4
"""Iterations after which a seed far from the best value is dropped, and then one not near it."""
_FAR = 0.1
"""Loss above which a value counts as far, as a share of the objective."""
_SAME = 0.1
"""A path that is nowhere further from the best one than this leads to it, rad or m: the first trust
region of the programs."""
_HOPELESS, _HOPELESS_CLEARANCE = 0.1, 0.01
"""Violation by a grid's path above which no program is tried before it is searched again, rad; and
with a clearance, rad or m: programs do not pass obstacles on the other side."""
_ABOUT = 20
"""Number of waypoints on either side of a violation that are searched again."""
_LOOKED_WITHIN = (0.05, 0.2, 0.6)
"""Shares above the layers' least mean z, or below their largest margin, within which a path is
searched first: few nodes are."""
_DETOUR_WITHIN = (0.02, 0.2)
"""The same for a detour around what the path touches, beside the path through coarser layers."""
_DETOUR = 0.05
"""Loss by a detour up to which no finer grid is searched for a shorter one."""
_REPAIRED = 0.05
"""Share of the waypoints that come too near up to which a path is repaired, not searched anew."""
_TOUCHED = 0.1
"""Share of a grid's path that comes too near above which the path off the grid, which is near it,
does so at more than :data:`_REPAIRED`."""
_POINTS = 6
"""Number of times that points of violations between waypoints are added."""
_CLOSE, _LOOKS = tuple((np.arange(1, 16) / 16.0).tolist()), 10
"""Shares of an interval at which edges are evaluated where a path met something between others, and
how often a path is searched with further ones."""
_UNKNOWN = -1
_AT_ONCE = 50
"""Number of configurations of a layer that are looked at before any others."""
_SLOWER = (3.0, 30.0)
"""How many times slower a path is tried that has no motion in its time."""
_HALVINGS = 2
"""How often the range between the two is halved, in which the least such factor lies."""
_STRICTNESS = (1.0, 1e3)
"""Factors of the price, in turn: first for the best path, then for a feasible one."""
_LOOSE = {"rad": np.radians([3.0, 1.0]), "m": np.array([5e-3, 1e-3])}
"""Violation of a band allowed along an edge of the grid: the programs smooth the path later."""


@dataclass(frozen=True)
class SearchStage:
    """Resolution of a stage.

    Attributes:
        motion: Motion of a joint between the selected waypoints, rad.
        longest_stride: Largest number of waypoints from one of them to the next.
        roll: Spacing of rolls, rad.
        joints: Least spacing of configurations in any joint, rad or m.
        resolution: The same as a share of the joint's motion, up to :data:`COARSEST`.
        most: Largest motion of a joint from one selected waypoint to the next, rad or m.
    """

    motion: float
    longest_stride: int
    roll: float
    joints: float
    resolution: float
    most: float = np.inf


_COARSE = SearchStage(np.radians(30.0), 10, np.radians(8.0), np.radians(8.0), 0.5, np.radians(30.0))
"""Comes first with two free degrees, where each of the next takes minutes."""
_FEWEST = 40
"""Number of selected waypoints beyond which it skips up to ``longest_stride`` of them."""
_STAGES = (
    SearchStage(np.radians(30.0), 10, np.radians(4.0), np.radians(4.0), 0.25),
    SearchStage(np.radians(10.0), 4, np.radians(2.0), np.radians(2.0), 0.25),
    SearchStage(0.0, 1, np.radians(1.0), np.radians(1.0), 0.25),
)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome of a search.

    Attributes:
        path: The best feasible path, if there is one.
        certificate: Why there is one, or none.
        layers: Layers of the last stage.
        waypoints: Waypoints of those layers, from 0.
        bound: Bound of the value of any path; NaN if a waypoint has no configuration, and for
            centering and margin if one leaves more than three degrees free.
        interrupted: Whether Ctrl-C ended the search, and the path is the best by then.
        of_grid: Value of the best path through the layers of the stage; NaN if there is none.
    """

    path: RefinedPath | None
    certificate: Certificate
    layers: list[Layer]
    waypoints: list[int]
    bound: float = np.nan
    interrupted: bool = False
    of_grid: float = np.nan


class PlanSearch:
    """A search for one task, objective and start.

    The stages use more and more waypoints and finer and finer grids. In each, steps may exceed
    their limits by the grid's resolution; the quadratic programs that then move the path off the
    grid satisfy the limits exactly. The search ends at the first stage with a feasible path.

    The paths of other methods find passages near a singularity that are narrower than the grid.
    With a fixed start they run first, and bound the search of the stages. With a free start they
    run only if the stages' path is not close to the bound, from its start.
    """

    def __init__(
        self,
        path_task: PathTask,
        objective: Objective,
        limits: PathConstraints,
        start: Array | None,
        runs: Trials | None = None,
        progress: Progress | None = None,
        slower: Slower | None = None,
    ) -> None:
        """Prepare.

        Args:
            path_task: The path.
            objective: The objective.
            limits: Constraints at and between the waypoints.
            start: The first configuration, on the first waypoint, (nv,), or ``None``.
            runs: Returns the paths of other methods, as further initial paths.
            progress: Called with the current phase and its share done.
            slower: Returns the constraints of a slower path, to see whether its speed alone
                prevents a motion.
        """
        self.path_task, self.slower = path_task, slower
        self.objective = objective
        self.limits = limits
        self.start = start
        self.runs = runs or (lambda path_task, start: [])
        self.rows = PathRows(path_task)
        self._progress = progress or (lambda what, share: None)
        ranges = limits.ranges
        self._cleared = bool(path_task.clearances)
        #: The task and its rows without clearance, of which layers are made.
        self._free_task = path_task.without_clearance()
        self._free_rows = PathRows(self._free_task) if self._cleared else self.rows
        #: With a clearance the layers of each stage, for the searches without and with it.
        self._layers: dict[SearchStage, dict[int, Layer]] | None = {} if self._cleared else None
        #: Layers of the intervals that are searched again, which may be several times.
        self._windows: dict[tuple[int, int], list[Layer]] = {}
        #: Of configurations of layers: 1 where they keep the clearance, 0 where not, or unknown.
        self._known_clear: WeakKeyDictionary[Layer, Array] = WeakKeyDictionary()
        #: Paths that may be the best when the search is interrupted: the last that a program ended
        #: with, and the best.
        self._kept: dict[str, Array] = {}
        #: The last stage's layers, when they are complete.
        self._begun: SearchResult | None = None
        #: First and last waypoint of stretches that a stage's grid has no path through, and layers
        #: there on the finest grid.
        self._ends: list[tuple[int, int]] = []
        self._finest: dict[int, Layer] = {}
        #: Shares of intervals in which a strict path violated a constraint, of its edges.
        self._shares: dict[int, tuple[float, ...]] = {}
        #: The search without clearance, and its bound, which holds with it, too.
        self._free: PlanSearch | None = None
        self._known_bound: float | None = None
        #: Its best path through the first stage's layers, and the value of that path.
        self._first_way: LayerPath | None = None
        self._expected = 0.0
        #: Share of the configurations of that path that come too near.
        self._touched = 0.0
        #: Further paths through these layers, among which one with clearance is searched first.
        self._candidates: Candidates | None = None
        #: Hinges without limits: their whole turns do not matter.
        self._period = np.where(ranges.hinge & ~np.isfinite(ranges.upper - ranges.lower), TURN, 0.0)

    def run(self) -> SearchResult:
        """Search the best motion.

        Raises:
            KeyboardInterrupt: If it is interrupted before there is a motion; later, the result is
                the best by then.
        """
        try:
            return self._paced(self._run())
        except KeyboardInterrupt:
            result = self._by_now()
            if result is None:
                raise
            return result

    def _paced(self, result: SearchResult) -> SearchResult:
        """The result; where speed limits prevent a motion, with how much slower there is one."""
        certificate, slower = result.certificate, self.slower
        if result.path is not None or certificate.kind != "speed" or slower is None:
            return result
        try:
            return replace(result, certificate=self._with_pace(certificate, slower))
        except KeyboardInterrupt:  # the result itself is known
            return result

    def _with_pace(self, certificate: Certificate, slower: Slower) -> Certificate:
        """The certificate with what slower searches find."""

        def at(times: float) -> RefinedPath | None:
            search = PlanSearch(
                self.path_task, self.objective, slower(times), self.start, self.runs, self._progress
            )
            return search.run().path

        without, path = 1.0, None
        for times in _SLOWER:
            path = at(times)
            if path is not None:
                break
            without = times
        if path is None:
            note = f"nor was one found for the path {without:g} times slower"
            return replace(certificate, note=note)
        needed, number, joint = self.limits.pace(path.q)
        for _ in range(_HALVINGS):
            times = float(np.sqrt(without * needed))
            path = at(times)
            if path is None:
                without = times
            else:
                needed, number, joint = self.limits.pace(path.q)
        note = (
            f"only its speed prevents one: {needed:.3g} times slower the path has a motion, which "
            f"needs that after waypoint {number + 1}, for {joint}"
        )
        if without > 1.0:
            note += f"; {without:.3g} times slower none was found"
        return replace(certificate, slower=needed, note=note)

    def _by_now(self) -> SearchResult | None:
        """The best motion of an interrupted search that satisfies all constraints."""
        best: RefinedPath | None = None
        for q in self._kept.values():
            path = judged(q, self.limits, self.objective)
            beyond = self.limits.beyond_between(q)[0] if path.feasible and self.rows.hard else None
            if beyond is None or not (beyond > 0.0).any():
                best = self._better(best, path)
        if best is None:
            return None
        begun = self._begun
        grid = self._grid(_STAGES[0]) if begun is None else begun.certificate.grid
        certificate = Certificate(
            "path", grid, bands=self.rows.hard.names,
            detail="the search was interrupted: this is the best motion by then",
        )  # fmt: skip
        bound = np.nan
        try:
            if begun is not None:
                bound = self._stated(self._bound(begun, best))
        except KeyboardInterrupt:  # once more: without a bound
            pass
        return SearchResult(best, certificate, [], [], bound, interrupted=True)

    def _run(self) -> SearchResult:
        """First without clearance, which most paths keep anyway.

        Where the best path through the first layers touches something, it is not moved off the
        grid, but searched again with clearance at once.
        """
        if not self._cleared:
            return self._searched(None)
        for clearance in self.path_task.clearances:
            near = too_near(self.path_task, clearance)
            if near is not None:
                return self._prescribed(near)
        inner = self._free = self._without_clearance()
        if inner._impossible is not None:
            return inner._impossible
        blocked = None
        if self.start is None and self._obstructed(inner):
            blocked = self._searched(None)
            if blocked.path is not None or self._touched > _TOUCHED:
                return blocked
        free = inner._run()
        self._begun = inner._begun
        if free.path is None:  # nor is there a motion with it
            return free
        self._known_bound = free.bound
        best = self._repaired(free.path.q)
        if best is not None and _alike(free.path.value, best.value):
            names = self.rows.hard.names
            certificate = Certificate("path", free.certificate.grid, bands=names)
            return replace(free, path=best, certificate=certificate)
        return self._searched(best) if blocked is None or best is not None else blocked

    def _prescribed(self, near: TooNear) -> SearchResult:
        """The verdict where the task itself brings a pair too near."""
        at = tuple(index + 1 for index in near.waypoints)
        note = (
            "there the task alone decides their distance: at most "
            f"{1e3 * near.distance:.3g} mm at waypoint {at[0]}, whatever the roll"
        )
        names = tuple(f"clearance, {pair}" for pair in near.pairs)
        certificate = Certificate(
            "band", self._grid(_STAGES[0]), at, bands=names, note=note
        )  # fmt: skip
        return SearchResult(None, certificate, [], [])

    def _obstructed(self, inner: PlanSearch) -> bool:
        """Whether the best path through the first layers, without clearance, does not keep it."""
        stage = self._stages[0]
        grid, _, waypoints, layers = inner._opened(stage)
        if not all(len(layer.q) for layer in layers):
            return False
        record = Record()
        way = inner._layer_path(
            layers, waypoints, grid, _STRICTNESS[0], np.inf, most=stage.most, record=record
        )
        inner._first_way = way
        if len(way.nodes) < len(layers):
            return False
        self._expected = way.value
        nodes = [layer.q[node] for layer, node in zip(layers, way.nodes, strict=True)]
        self._touched = 1.0 - float(self._clears(np.array(nodes)).mean())
        if not self._touched:
            return False
        self._candidates = Candidates(record) if record.is_complete else None
        return True

    def _repaired(self, q: Array) -> RefinedPath | None:
        """The path if it keeps its distance, else with a detour where it does not, if one is found.

        Where it comes too near in many places, the search of the whole path takes less time.
        """
        path = judged(q, self.limits, self.objective)
        broken = self.limits.broken(q)
        if not len(broken):
            beyond = self.limits.beyond_between(q)[0]
            if not (beyond > 0.0).any():
                return path
        if len(broken) > _REPAIRED * len(q):
            return None
        return self._better(None, self._mended(path) if len(broken) else self._refined(q))

    def _without_clearance(self) -> PlanSearch:
        """The same search for the task without clearance."""
        limits = replace(self.limits, hard=self._free_rows.hard)
        search = PlanSearch(
            self._free_task, self.objective, limits, self.start, self.runs, self._progress
        )
        search._layers, search._windows = self._layers, self._windows
        search._kept = self._kept  # they are judged with clearance
        return search

    def _clears(self, q: Array) -> Mask:
        """Which configurations q (K, nv) keep the clearance, (K,)."""
        clears = np.ones(len(q), dtype=bool)
        for clearance in self.path_task.clearances:
            clears[clears] = clearance.inside(q[clears], WITHIN)
        return clears

    def _clear_nodes(self, layer: Layer, nodes: Indices) -> Mask:
        """Which configurations of a layer, by their indices (K,), keep the clearance, (K,).

        Each is looked at once: a layer is searched several times, and most of it never reached.
        """
        known = self._known_clear.setdefault(layer, np.full(len(layer.q), _UNKNOWN, dtype=np.int8))
        new = nodes[known[nodes] == _UNKNOWN]
        known[new] = self._clears(layer.q[new])
        clear: Mask = known[nodes] == 1
        return clear

    def _is_blocked(self, layer: Layer) -> bool:
        """Whether no configuration of a layer keeps the clearance, at whatever cost."""
        count = len(layer.q)
        parts = 1 + count // _AT_ONCE  # one that does is mostly among the first
        return self._cleared and not any(
            self._clear_nodes(layer, np.arange(part, count, parts)).any() for part in range(parts)
        )

    def _cleared_layer(self, layer: Layer, index: int) -> Layer:
        """The configurations of a waypoint's layer that keep the clearance."""
        if not self._cleared or not len(layer.q):
            return layer
        kept = self._clear_nodes(layer, np.arange(len(layer.q)))
        bands = () if kept.any() else forbidding_bands(layer.q, self.rows.hard, index)[0]
        return replace(layer, q=layer.q[kept], branch=layer.branch[kept], bands=bands)

    def _searched(self, best: RefinedPath | None) -> SearchResult:
        """Search with all constraints, beside the best motion known."""
        impossible = self._impossible if best is None and not self._cleared else None
        if impossible is not None:
            return impossible
        tried = self._tried(self.start) if self.start is not None and best is None else []
        for trial in tried:
            best = self._better(best, trial)
        for stage in self._stages:
            found = self._stage(stage, best)
            best = self._better(best, found.path)
            if found.path is not None and not self._is_long_detour(found.path, found.of_grid):
                break
            if best is None and not all(len(layer.q) for layer in found.layers):
                # Layers that are empty on the finest grid are empty on any grid: stop here.
                proven = self._proven_empty(found)
                if proven is not None:
                    return proven
        first, bound = best, self._bound(found, best)
        # With a clearance the bound, which knows of none, says little.
        settled = best is not None and (self._cleared or _alike(bound, best.value))
        if self.start is None and not settled:
            tried = self._tried(None if best is None else best.q[0], best)
        for trial in tried:
            if best is None or self._may_become(trial, best):
                best = self._better(best, self._refined(trial.q))
        if best is None:
            return replace(found, bound=self._stated(bound))
        certificate = Certificate("path", found.certificate.grid, bands=self.rows.hard.names)
        if best is not first:
            bound = self._bound(found, best)
        return replace(found, path=best, certificate=certificate, bound=self._stated(bound))

    def _is_long_detour(self, path: RefinedPath, of_grid: float) -> bool:
        """Whether a path is much worse than the grid's, which touches something between waypoints.

        A finer grid may have a shorter one.
        """
        is_better = self._cleared and self.objective.better(of_grid, path.value)
        return is_better and not _alike(path.value, of_grid, _DETOUR)

    @property
    def _stages(self) -> tuple[SearchStage, ...]:
        many = int(self.rows.freedom.max()) >= COVERED
        return (_COARSE, *_STAGES) if many else _STAGES

    def _may_become(self, trial: RefinedPath, best: RefinedPath) -> bool:
        """Whether a seed may lead to a better path: not if it is far, or leads to the same one."""
        if self.objective.better(trial.value, best.value):
            return True
        apart = np.abs(self._unwound(trial.q - best.q)).max()
        return bool(apart > _SAME and _alike(trial.value, best.value))

    def _tried(self, start: Array | None, best: RefinedPath | None = None) -> list[RefinedPath]:
        """The runs of other methods, corrected onto their waypoints and improved a little.

        Without those that stay far from the best path.
        """
        tried, at = [], np.arange(len(self.path_task.waypoints))
        for run in self.runs(self.path_task, start):
            on_path, arrived = self.rows.correct(run, at)
            if arrived.all():
                on_path[0] = run[0]
                trial = self._improved(on_path, iterations=_TRIAL[0])
                far = best is not None and not _alike(trial.value, best.value, _FAR)
                if best is None or not far or self.objective.better(trial.value, best.value):
                    tried.append(self._improved(trial.q, iterations=_TRIAL[1]))
        return tried

    def _bound(self, found: SearchResult, best: RefinedPath | None) -> float:
        free = self._free
        if best is None and not all(len(layer.q) for layer in found.layers):
            return np.nan
        if self._known_bound is None and free is not None and free._begun:
            self._known_bound = free._known_bound = free._bound(free._begun, best)
        if self._known_bound is not None and best is None:
            return self._known_bound
        if self._known_bound is not None and best is not None:
            worse = max if self.objective.margin else min
            return worse(self._known_bound, best.value)
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
        """The bound, if the layers cover all minima of z and maxima of the margin."""
        pointwise = self.objective.centering > 0.0 or self.objective.margin
        return np.nan if pointwise and int(self.rows.freedom.max()) > BOUNDED else bound

    def _better(self, a: RefinedPath | None, b: RefinedPath | None) -> RefinedPath | None:
        if b is None or not b.feasible:
            return a
        best = b if a is None or self.objective.better(b.value, a.value) else a
        self._kept["best"] = best.q
        return best

    def _laid(self, stage: SearchStage) -> tuple[Grid, Roadmap, list[int]]:
        """The grid and the roadmap of a stage, and its waypoints."""
        count = len(self.path_task.waypoints)
        stride = int(np.clip(round(stage.motion / self._typical_step()), 1, stage.longest_stride))
        if stage is _COARSE:
            stride = int(np.clip(count // _FEWEST, stride, stage.longest_stride))
        grid = self._grid(stage, stride)
        return (
            grid, Roadmap(self._free_task, self._free_rows, grid), self._waypoints(stride, count)
        )  # fmt: skip

    def _layers_at(
        self, stage: SearchStage, grid: Grid, roadmap: Roadmap, waypoints: list[int]
    ) -> list[Layer]:
        """The layers of a stage at some waypoints; with a clearance each is made once."""
        made = {} if self._layers is None else self._layers.setdefault(stage, {})
        new = [index for index in waypoints if index not in made]
        if new:
            found = roadmap.layers(
                new, lambda done: self._progress(f"{grid}: layers", done / len(new))
            )
            if self.start is not None and not all(map(roadmap.samples_all, new)):
                found = [self._followed(k, layer) for k, layer in zip(new, found, strict=True)]
            made.update(zip(new, found, strict=True))
        layers = [self._finest.get(index, made[index]) for index in waypoints]
        if waypoints[0] == 0:
            if self.start is not None:
                layers[0] = Layer(self.start[None], np.full(1, -1), 1)
            cleared = self._cleared_layer(layers[0], 0)
            if not len(cleared.q):
                layers[0] = cleared
        return layers

    def _followed(self, index: int, layer: Layer) -> Layer:
        """A sampled layer with the configuration to which least-norm steps lead from the start."""
        q = self._from_start[index][None]
        if (
            not self.limits.ranges.inside(q).all()
            or not self._free_rows.hard.inside(q, np.array([index])).all()
        ):
            return layer
        branch = np.append(layer.branch, -1)
        return Layer(np.vstack([layer.q, q]), branch, layer.solutions + 1)

    @cached_property
    def _from_start(self) -> Array:
        """Least-norm steps from the start, waypoint by waypoint, (N, nv); NaN where they end."""
        assert self.start is not None
        path = np.full((len(self.path_task.waypoints), len(self.start)), np.nan)
        path[0] = self.start
        for index in range(1, len(path)):
            q, inside = self._free_rows.correct_inside(path[index - 1 : index], np.array([index]))
            if not inside[0]:
                break
            path[index] = q[0]
        return path

    def _opened(self, stage: SearchStage) -> tuple[Grid, Roadmap, list[int], list[Layer]]:
        """The grid and the roadmap of a stage, its waypoints and their layers."""
        grid, roadmap, waypoints = self._laid(stage)
        layers = self._layers_at(stage, grid, roadmap, waypoints)
        if all(len(layer.q) for layer in layers):
            self._begun = SearchResult(None, Certificate("path", grid), layers, waypoints)
        return grid, roadmap, waypoints, layers

    def _still_ended(self, stage: SearchStage, best: RefinedPath | None) -> SearchResult | None:
        """The verdict of a stage if its grid, too, has no path past where a coarser one ended.

        Only the layers near these places are made.
        """
        if not self._ends or not self._cleared:
            return None
        grid, roadmap, waypoints = self._laid(stage)
        if not all(map(roadmap.is_independent, waypoints)):
            return None
        for first, last in self._ends:
            own = [index for index in waypoints if first <= index <= last]
            layers = self._layers_at(stage, grid, roadmap, own) if own else []
            if not all(len(layer.q) for layer in layers):
                return None
            way = self._ended_at((first, last), layers, own, grid, _STRICTNESS[0], stage.most)
            if way is None:
                continue
            self._ends.append((first, last))
            if best is not None:
                return SearchResult(best, Certificate("path", grid), layers, own)
            return self._ended(way, layers, own, grid, roadmap)
        return None

    def _stage(self, stage: SearchStage, best: RefinedPath | None) -> SearchResult:
        ended = self._still_ended(stage, best)
        if ended is not None:
            return ended
        grid, roadmap, waypoints, layers = self._opened(stage)
        covered = self._covers(roadmap, waypoints)
        empty = [i for i, layer in zip(waypoints, layers, strict=True) if not len(layer.q)]
        if empty:
            certificate = _empty(waypoints, layers, grid, roadmap, covered)
            return SearchResult(None, certificate, layers, waypoints)
        # The grid's path may be a little worse than the best one between its nodes.
        rounded = _ROUNDED_TRAVEL if self.objective.travel else _ROUNDED
        known = np.inf if best is None else best.value * (1.0 + rounded)
        if self.objective.margin:
            known = -np.inf if best is None else best.value - _ROUNDED * abs(best.value)
        nearest, before, of_grid = None, None, np.nan
        coarse = stage is not _STAGES[-1]
        again = _LOOKS if self._cleared and not coarse else 0
        for strictness in (*_STRICTNESS, *_STRICTNESS[-1:] * again):
            way, self._first_way = self._first_way, None
            among, self._candidates = self._candidates, None
            way = way or self._ended_again(layers, waypoints, grid, strictness, stage.most)
            way = way or self._layer_path(
                layers, waypoints, grid, strictness, known, self._expected, stage.most, among=among
            )
            if len(way.nodes) < len(layers):
                self._ends.append(way.impassable or self._about(way, waypoints))
                if best is not None:  # the grid has no better path
                    return SearchResult(best, Certificate("path", grid), layers, waypoints)
                if self._shares and nearest is not None:  # its violation says more
                    break
                return self._ended(way, layers, waypoints, grid, roadmap)
            if way.nodes == before:  # what failed
                break
            of_grid = way.value if before is None else of_grid
            before = way.nodes
            nodes = [layer.q[node] for layer, node in zip(layers, way.nodes, strict=True)]
            path = self._interpolated(np.array(nodes), waypoints)
            refined = None if path is None else self._off_the_grid(path, coarse=coarse)
            if again and strictness > _STRICTNESS[0] and path is not None:
                self._look_between(path)
            if refined is not None and refined.feasible:
                certificate = Certificate("path", grid)
                return SearchResult(refined, certificate, layers, waypoints, of_grid=of_grid)
            if nearest is None or (refined is not None and refined.excess < nearest.excess):
                nearest = refined
        return SearchResult(None, self._too_fast(nearest, grid, covered), layers, waypoints)

    def _ended(
        self,
        way: LayerPath,
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        roadmap: Roadmap,
    ) -> SearchResult:
        """The verdict where no path goes on, from the layers alone if clearance empties one."""
        covered = self._covers(roadmap, waypoints)
        cleared = [
            self._cleared_layer(layer, index) if self._is_blocked(layer) else layer
            for layer, index in zip(layers, waypoints, strict=True)
        ]
        if not all(len(layer.q) for layer in cleared):
            certificate = _empty(waypoints, cleared, grid, roadmap, covered)
            return SearchResult(None, certificate, cleared, waypoints)
        certificate = self._blocked(way, layers, waypoints, grid, covered)
        return SearchResult(None, certificate, layers, waypoints)

    def _covers(self, roadmap: Roadmap, waypoints: list[int]) -> bool:
        """Whether layers prove what they show: between configurations no clearance is proved."""
        return not self._cleared and all(roadmap.covers(index) for index in waypoints)

    def _off_the_grid(self, path: Array, *, coarse: bool) -> RefinedPath:
        """The grid's path (N, nv) corrected into the limits, if that is worth a try."""
        refined = judged(path, self.limits, self.objective)
        soon = int(self.rows.freedom.max()) < COVERED  # layers are made in less time
        most = _HOPELESS_CLEARANCE if self._cleared else _HOPELESS
        if not (coarse and soon and refined.excess > most):
            refined = self._refined(path)
        if not refined.feasible and coarse:
            refined = self._mended(refined) or refined
        return refined

    def _grid(self, stage: SearchStage, stride: int = 1) -> Grid:
        step = stride * np.median(self.limits.steps, axis=0)
        joints = np.clip(stage.resolution * step, stage.joints, COARSEST)
        return Grid(max(stage.roll, 0.5 * joints.max()), joints)

    def _mended(self, path: RefinedPath) -> RefinedPath | None:
        """Search the path again on the finest grid around the waypoints where it violates limits.

        These are mostly passages near a singularity; the rest of the path is kept. With a clearance
        the strict search comes first.
        """
        best = None
        for strictness in _STRICTNESS[::-1] if self._cleared else _STRICTNESS[:1]:
            found = self._mended_at(path, strictness)
            if found is not None and found.feasible:
                return found
            if best is None or (found is not None and found.excess < best.excess):
                best = found
        return best

    def _window(self, first: int, last: int, grid: Grid) -> list[Layer]:
        """Layers of all waypoints between two, on the finest grid."""
        if (first, last) not in self._windows:
            roadmap = Roadmap(self._free_task, self._free_rows, grid)
            self._windows[first, last] = roadmap.layers(range(first, last + 1))
        return list(self._windows[first, last])

    def _mended_at(self, path: RefinedPath, strictness: float) -> RefinedPath | None:
        whole, count = path.q.copy(), len(path.q)
        grid = self._grid(_STAGES[-1])
        broken = self.limits.broken(whole)
        if not len(broken):  # the violation is between waypoints
            return None
        for first, last in _stretches(broken, count):
            waypoints = list(range(first, last + 1))
            layers = self._window(first, last, grid)
            for end, held in ((0, first > 0 or self.start is not None), (-1, last < count - 1)):
                if held:
                    layers[end] = Layer(whole[waypoints[end]][None], np.full(1, -1), 1)
            if not all(len(layer.q) for layer in layers):
                return None
            known = -np.inf if self.objective.margin else np.inf
            expected = self.objective.value(whole[waypoints])
            within = _DETOUR_WITHIN if self._cleared else _LOOKED_WITHIN
            way = self._layer_path(
                layers, waypoints, grid, strictness, known, expected, within=within
            )
            if len(way.nodes) < len(layers):
                return None
            nodes = np.array([layer.q[n] for layer, n in zip(layers, way.nodes, strict=True)])
            nodes[1:] = nodes[0] + np.cumsum(self._unwound(np.diff(nodes, axis=0)), axis=0)
            whole[last:] += nodes[-1] - whole[last]
            whole[first : last + 1] = nodes
        return self._refined(whole)

    def _proven_empty(self, found: SearchResult) -> SearchResult | None:
        """Confirm a negative verdict on the finest grid, at some of its waypoints."""
        # The empty ones, and the waypoints skipped on either side of them.
        ends = [found.waypoints[0] - 1, *found.waypoints, found.waypoints[-1] + 1]
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
        layers = _reached(waypoints, roadmap.layers(waypoints), roadmap)
        if all(len(layer.q) for layer in layers):
            if any(layer.nearby for layer in layers):  # so the others may be, too
                waypoints = open_
                layers = _reached(waypoints, roadmap.layers(waypoints), roadmap)
            self._finest.update(zip(waypoints, layers, strict=True))
            return None
        certificate = _empty(waypoints, layers, grid, roadmap, not self._cleared)
        return SearchResult(None, certificate, layers, waypoints)

    @cached_property
    def _impossible(self) -> SearchResult | None:
        """Waypoints that no random configuration reaches, before layers are made of all others.

        For arms without a closed form: an empty layer of theirs is empty whatever the spacing, and
        the configurations found at all waypoints are further seeds.
        """
        count, nv = len(self.path_task.waypoints), self.path_task.model.nv
        grid = Grid(_STAGES[-1].roll, np.full(nv, COARSEST))
        roadmap = Roadmap(self._free_task, self._free_rows, grid)
        if roadmap.arm is not None or int(self.rows.freedom.max()) > COVERED:
            return None
        ranges, rng = self.limits.ranges, np.random.default_rng(0)
        at = np.repeat(np.arange(count), _TRIED)
        q, arrived = self._free_rows.correct(ranges.random(len(at), rng), at)
        q = centred(q, ranges)
        inside = arrived & ranges.inside(q)
        missed = np.setdiff1d(np.arange(count), at[inside])
        if not len(missed):
            return None
        known = rng.permutation(q[inside])[:_SEEDING]
        seeds = Layer(known, np.zeros(len(known), dtype=np.intp), len(known))
        chosen = np.unique(np.linspace(0, len(missed) - 1, _PROOFS).round().astype(int))
        waypoints = [int(missed[k]) for k in chosen]
        layers = [roadmap.seeded(index, seeds) for index in waypoints]
        if all(len(layer.q) for layer in layers):
            return None
        certificate = _empty(waypoints, layers, grid, roadmap, covered=True)
        return SearchResult(None, certificate, layers, waypoints)

    def _typical_step(self) -> float:
        """Largest motion of each joint between two waypoints."""
        return float(np.median(self.limits.steps))

    def _waypoints(self, stride: int, count: int) -> list[int]:
        """Every ``stride``-th waypoint, the last, and those at which the projector changes."""
        in_force = self.path_task.in_force
        changes = {
            at for k in range(1, count) if in_force[k] is not in_force[k - 1] for at in (k - 1, k)
        }
        return sorted({*range(0, count, stride), count - 1, *changes})

    def _layer_path(
        self,
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        strictness: float,
        known: float,
        expected: float = 0.0,
        most: float = np.inf,
        within: Sequence[float] = _LOOKED_WITHIN,
        record: Record | None = None,
        among: Candidates | None = None,
    ) -> LayerPath:
        """The best path, with steps that may exceed limits by the grid's resolution, at a price.

        Without the price the path would jump between branches where a longer step just reaches, and
        could not be corrected into the limits. First a path is searched ``among`` some candidates,
        then one that is little worse than the value ``expected``, by the shares ``within`` in turn.
        No joint moves by more than ``most`` from layer to layer, rad or m. The edges that are
        searched go to the ``record``, if there is one.
        """
        objective = self.objective
        steps = self._between(layers, waypoints, grid, strictness, most)
        weight = (objective.centering + objective.margin) / len(layers)
        centering = [weight * objective.ranges.centring(layer.q) for layer in layers]
        is_clear = np.ones(len(layers[0].q), dtype=bool)
        if self._cleared:
            is_clear = self._clear_nodes(layers[0], np.arange(len(is_clear)))
        centering[0] = np.where(is_clear, centering[0], np.inf)

        def cheapest(costs: list[Array], known: float) -> LayerPath:
            if among is not None:
                way = among.cheapest(costs[0], steps.allowed, steps.valid)
                if len(way.nodes) == len(layers):
                    return way
            least, before = max(expected, sum(float(cost.min()) for cost in costs)), 0
            for share in within:
                at_most = least * (1.0 + share)
                if 0.0 < at_most < known:
                    way = steps.cheapest(costs, at_most, record)
                    number = len(way.nodes)
                    if number == len(layers) or self._is_blocked(layers[number]):
                        return way
                    again = number == before
                    ended = self._ended_about(
                        way, layers, waypoints, grid, strictness, most, far=again
                    )
                    if ended is not None:
                        return ended
                    before = number
            return steps.cheapest(costs, known, record)

        if not objective.margin:
            return cheapest(centering, known)
        margins = [objective.margins(layer.q) for layer in layers]
        margins[0] = np.where(is_clear, margins[0], -np.inf)
        # No path is wider than the narrowest layer.
        top = min(float(margin.max()) for margin in margins)
        for share in (*_LOOKED_WITHIN, np.inf):
            at_least = max(known, top * (1.0 - share)) if share < np.inf else known
            widest = widest_path(
                margins, steps.connections,
                at_least=at_least, allowed=steps.allowed, valid=steps.valid,
            )  # fmt: skip
            if np.isfinite(widest.value):
                break
        else:
            return widest
        # Of many paths of equal width, take the most central.
        narrow = [margin < widest.value for margin in margins]
        centering = [np.where(n, np.inf, cost) for n, cost in zip(narrow, centering, strict=True)]
        return cheapest(centering, np.inf)

    def _between(
        self,
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        strictness: float,
        most: float,
    ) -> LayerSearch:
        """The steps from each layer to the next, as :meth:`_layer_path` searches them."""
        objective = self.objective
        allowed = [
            np.minimum(self.limits.steps[a:b].sum(axis=0), np.maximum(most, self.limits.steps[a]))
            for a, b in itertools.pairwise(waypoints)
        ]
        weight = (objective.centering + objective.margin) / len(layers)
        price = _PRICE * weight + _PRICE_OF_TRAVEL * objective.travel
        bands, attempt = self.rows.hard, _STRICTNESS.index(strictness)
        loose = {unit: allowed[attempt] for unit, allowed in _LOOSE.items()}
        if bands.lazy and attempt:  # no program leads around what an edge has passed through
            loose["m"] = BETWEEN["m"]

        def connections(number: int, alive: Indices) -> Edges:
            self._progress(f"{grid}: steps", (number + 1) / len(layers))
            step = allowed[number] + grid.joints
            found = edges(layers[number].q[alive], layers[number + 1].q, step, self._period)
            return Edges(alive[found.start], found.end)

        def along(number: int, edge: Edges) -> Array:
            apart = layers[number + 1].q[edge.end] - layers[number].q[edge.start]
            apart = np.abs(self._unwound(apart))
            share = (apart / allowed[number]).T.copy()  # the largest of columns takes less time
            beyond = np.maximum(share.max(axis=0) - 1.0, 0.0)
            cost: Array = strictness * price * beyond
            if objective.travel:
                cost += objective.travel * np.degrees(apart @ objective.joints)
            return cost

        def kept(number: int, edge: Edges) -> Mask:
            """Whether the bands are kept between the waypoints, to the grid's resolution."""
            at = waypoints[number]
            if waypoints[number + 1] > at + 1:  # joints are not interpolated linearly there
                return np.ones(len(edge.start), dtype=bool)
            begin = layers[number].q[edge.start]
            end = begin + self._unwound(layers[number + 1].q[edge.end] - begin)
            shares = self._shares.get(at, SHARES)
            return bands.kept_between(begin, end, np.full(len(begin), at), loose, shares)

        def clear(number: int, nodes: Indices) -> Mask:
            return self._clear_nodes(layers[number], nodes)

        valid, keeps = kept if bands else None, clear if self._cleared else None
        # Edges between all waypoints are validated. Of a long stretch these would be too many to be
        # recorded.
        every = len(waypoints) == waypoints[-1] - waypoints[0] + 1
        records = self._cleared and bands.lazy and every and not _is_long(waypoints)
        return LayerSearch(connections, along, keeps, valid, records)

    def _ended_about(
        self,
        way: LayerPath,
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        strictness: float,
        most: float,
        *,
        far: bool,
    ) -> LayerPath | None:
        """A path that ends around the place where another has, whatever it costs.

        What no path passes at whatever cost is not searched again at a higher one. Looks ``far``
        back, too, twice as far each time: a branch on which it is passed may have begun there.
        """
        if not (self._cleared and _is_long(waypoints) and way.nodes):
            return None
        first, last = self._about(way, waypoints)
        ended = self._ended_at((first, last), layers, waypoints, grid, strictness, most)
        while ended is None and far and first > 0:
            first -= last - first
            ended = self._ended_at((first, last), layers, waypoints, grid, strictness, most)
        return ended

    def _look_between(self, path: Array) -> None:
        """Have edges evaluated at more places where a path (N, nv) is outside between waypoints.

        An obstacle's corner passes between the shares at which all edges are evaluated.
        """
        beyond, share = self.limits.beyond_between(path)
        for at in np.flatnonzero((beyond > 0.0).any(axis=1)).tolist():
            self._shares[at] = (float(share[at]), *self._shares.get(at, _CLOSE))

    def _ended_again(
        self, layers: list[Layer], waypoints: list[int], grid: Grid, strictness: float, most: float
    ) -> LayerPath | None:
        """A path that ends where another search did; ``None`` if these places are passed."""
        for stretch in self._ends:
            way = self._ended_at(stretch, layers, waypoints, grid, strictness, most)
            if way is not None:
                return way
        return None

    def _about(self, way: LayerPath, waypoints: list[int]) -> tuple[int, int]:
        """First and last waypoint around the place where a path has ended."""
        number = max(len(way.nodes), 1)
        return waypoints[number - 1] - _ABOUT, waypoints[number] + _ABOUT

    def _ended_at(
        self,
        stretch: tuple[int, int],
        layers: list[Layer],
        waypoints: list[int],
        grid: Grid,
        strictness: float,
        most: float,
    ) -> LayerPath | None:
        """A path that ends in a stretch of waypoints; ``None`` if that is passed.

        It is searched from every configuration at the first of them, which takes a fraction of the
        search of the whole path.
        """
        first, last = stretch
        near = [k for k, index in enumerate(waypoints) if first <= index <= last]
        if len(near) < 2:  # of a coarser stage
            return None
        part = slice(near[0], near[-1] + 1)
        known = -np.inf if self.objective.margin else np.inf
        way = self._layer_path(
            layers[part], waypoints[part], grid, strictness, known, most=most, within=()
        )
        if len(way.nodes) == len(near):
            return None
        return LayerPath([0] * near[0] + way.nodes, np.inf, stretch)

    def _unwound(self, difference: Array) -> Array:
        """Differences of configurations, modulo whole turns that do not matter."""
        if not self._period.any():
            return difference
        unwound: Array = difference - self._period * np.round(difference / TURN)
        return unwound

    def _interpolated(self, corners: Array, waypoints: list[int]) -> Array | None:
        """Interpolate a configuration on every waypoint between those of the grid."""
        steps = self._unwound(np.diff(corners, axis=0))
        corners = corners[0] + np.vstack([np.zeros(corners.shape[1]), np.cumsum(steps, axis=0)])
        at = np.arange(len(self.path_task.waypoints))
        between = np.array([np.interp(at, waypoints, joint) for joint in corners.T]).T
        path, arrived = self.rows.correct(between, at)
        if self.start is not None:
            path[0] = self.start
        return path if arrived.all() else None

    def _refined(self, path: Array) -> RefinedPath:
        return self._improved(path, lambda share: self._progress("off the grid", share))

    def _improved(
        self,
        path: Array,
        progress: Callable[[float], None] | None = None,
        iterations: int = ITERATIONS,
    ) -> RefinedPath:
        """The best path nearby that satisfies the constraints at and between the waypoints.

        If a band is violated between two waypoints beyond the tolerance, the point of the largest
        violation is added to the programs.
        """
        limits, begun, again = self.limits.evaluated_along(path), path, False

        def keep(q: Array) -> None:
            self._kept["last"] = q

        for _ in range(1 + _POINTS):
            found = refine(path, self.rows, limits, self.objective, progress, iterations, keep)
            if found.feasible:
                keep(found.q)
            if not self.rows.hard or not (found.feasible or again):
                break
            if not found.feasible:  # the way to it led too far inside
                path, again = begun, False
                continue
            path = found.q
            beyond, share = limits.beyond_between(path)
            left = np.flatnonzero((beyond > 0.0).any(axis=1))
            if not len(left):
                break
            found = replace(found, excess=float(beyond.max()))
            again = True
            limits = limits.with_points(left, share[left])
        return found

    def _blocked(
        self, way: LayerPath, layers: list[Layer], waypoints: list[int], grid: Grid, covered: bool
    ) -> Certificate:
        """The constraints that block the motion between the last reached layer and the next."""
        number = max(len(way.nodes), 1)
        before, after = waypoints[number - 1], waypoints[number]
        at = before + 1, after + 1
        here, there = layers[number - 1].q[way.nodes[-1]], layers[number].q
        step = self.limits.steps[before:after].sum(axis=0)
        apart = self._unwound(there - here)
        share = np.abs(apart) / step
        best = int(np.argmin(share.max(axis=1)))
        names: tuple[str, ...] = ()
        if share[best].max() <= 1.0 and self.rows.hard and after == before + 1:
            # The speed limits allow a connection, bands or constraints do not.
            shares = np.array((0.0, *_CLOSE, 1.0))
            begin, end = (np.tile(q, (len(shares), 1)) for q in (here, here + apart[best]))
            at_begin = np.full(len(shares), before)
            margins = self.rows.hard.margins_between(begin, end, at_begin, shares).min(axis=0)
            names = tuple(self.rows.hard.names[k] for k in np.flatnonzero(margins < -WITHIN))
        if names:
            allowed = self.limits.step_limit
            detail = f"between {_pair(at)} no connection was found that keeps {allowed}, too"
            return Certificate("band", grid, at, (), covered, detail, names)
        # A sampled layer may lack the configurations near this one: it says nothing about joints.
        beyond = zip(self.limits.ranges.names, share[best], strict=True)
        joints = tuple(name for name, of_step in beyond if of_step > 1.0) if covered else ()
        return self._too_long(grid, at, joints, covered)

    def _too_fast(self, path: RefinedPath | None, grid: Grid, covered: bool) -> Certificate:
        """Certificate if no correction brings the grid's path inside the constraints."""
        if path is None:
            return self._too_long(grid, (), (), covered, "the grid's way leaves the path")
        worst = self.limits.worst(path.q)
        if worst.kind == "band":
            return _left(worst, grid, covered)
        if worst.kind == "position":
            at, amount = worst.waypoint + 1, _amount(worst.excess, worst.unit)
            detail = f"at waypoint {at} the best has {worst.name} outside by {amount}"
            return Certificate("limits", grid, (at,), (worst.name,), covered, detail)
        times, number, name = self.limits.pace(path.q)
        at = number + 1
        detail = (
            f"between waypoints {at} and {at + 1} the best needs {times:.3g} times the step that "
            f"{name} may do"
        )
        return self._too_long(grid, (at, at + 1), (name,), covered, detail)

    def _too_long(
        self,
        grid: Grid,
        waypoints: tuple[int, ...],
        joints: tuple[str, ...],
        covered: bool,
        detail: str = "",
    ) -> Certificate:
        """Certificate if steps between waypoints are longer than the joints may make."""
        allowed = self.limits.step_limit
        return Certificate("speed", grid, waypoints, joints, covered, detail, step_limit=allowed)


def _pair(at: tuple[int, int]) -> str:
    return f"waypoints {at[0]} and {at[1]}"


def _amount(excess: float, unit: str) -> str:
    return f"{1e3 * excess:.3g} mm" if unit == "m" else f"{np.degrees(excess):.3g}°"


def _left(worst: Violation, grid: Grid, covered: bool) -> Certificate:
    """Certificate if the best path found violates a band."""
    amount = _amount(worst.excess, worst.unit)
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


def _is_long(waypoints: Sequence[int]) -> bool:
    """Whether waypoints reach far beyond a place that is searched by itself."""
    return waypoints[-1] - waypoints[0] > 4 * _ABOUT


def _alike(value: float, best: float, share: float = _ROUNDED) -> bool:
    return abs(value - best) <= share * abs(best)


def _stretches(broken: Indices, count: int) -> list[tuple[int, int]]:
    """First and last waypoint of the intervals around some waypoints, without overlap."""
    found: list[tuple[int, int]] = []
    for index in broken:
        first, last = max(0, int(index) - _ABOUT), min(count - 1, int(index) + _ABOUT)
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found


def _reached(waypoints: Sequence[int], layers: Sequence[Layer], roadmap: Roadmap) -> list[Layer]:
    """The layers, with what is within the tolerances of a check where nothing is exact."""
    return [
        layer if layer.solutions else roadmap.within_tolerance(index)
        for index, layer in zip(waypoints, layers, strict=True)
    ]


def _empty(
    waypoints: Sequence[int],
    layers: Sequence[Layer],
    grid: Grid,
    roadmap: Roadmap,
    covered: bool,
) -> Certificate:
    """Waypoints out of reach; if none, those outside the limits, or else outside the bands."""
    pairs = list(zip(waypoints, layers, strict=True))
    unreached = [index for index, layer in pairs if layer.solutions == 0]
    sampled = all(roadmap.samples_all(index) for index in waypoints)
    if unreached:
        at = tuple(index + 1 for index in unreached)
        return Certificate("unreachable", grid, at, (), sampled, roadmap.missed(unreached))
    outside = [(index + 1, layer.outside) for index, layer in pairs if layer.outside]
    if outside:
        joints = tuple(dict.fromkeys(name for _, names in outside for name in names))
        at = tuple(index for index, _ in outside)
        return Certificate("limits", grid, at, joints, sampled)
    barred = [(index, layer.bands) for index, layer in pairs if not len(layer.q)]
    names = tuple(dict.fromkeys(name for _, bands in barred for name in bands))
    proven = covered and all(roadmap.covers(index) for index, _ in barred)
    return Certificate("band", grid, tuple(k + 1 for k, _ in barred), (), proven, bands=names)
