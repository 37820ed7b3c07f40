"""The search of a plan: layers, a path through them, smoothed and proved; then finer ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.paths import PathTask
from qp_twist.planning.bound import pointwise_bound
from qp_twist.planning.certificate import (
    Certificate,
    empty_layers,
    ended_path,
    violating_path,
)
from qp_twist.planning.graph import LayerPath
from qp_twist.planning.impossible import find_impossible, prove_gaps
from qp_twist.planning.kept_paths import KeptPaths
from qp_twist.planning.layer import Layer, forbidding_bands
from qp_twist.planning.level_search import (
    ABOUT,
    STRICTNESS,
    CloserLooks,
    LevelSearch,
    search_windows,
)
from qp_twist.planning.levels import (
    COARSE,
    SHORT,
    STAGES,
    Level,
    Levels,
    Progress,
    SearchStage,
    are_far,
)
from qp_twist.planning.manifold_net import BOUNDED, COVERED
from qp_twist.planning.on_the_path import OnThePath
from qp_twist.planning.preferred_nodes import with_preferred
from qp_twist.planning.problem import JudgedPath, PathConstraints, Problem
from qp_twist.planning.sentence import Sentence
from qp_twist.planning.single_steps import impossible_step
from qp_twist.planning.smooth import ITERATIONS, smooth

Slower = Callable[[float], PathConstraints]
"""The constraints of a path that takes so many times as long."""
Trials = Callable[[PathTask, Array | None], list[Array]]
"""Joint paths (N, nv) of other methods for a task from a start (nv,); its own if ``None``."""

_ROUNDED, _ROUNDED_TRAVEL = 0.02, 0.3
"""Possible loss by the grid, as a share of the objective: travel includes its zigzag."""
_TRIAL = 4
"""Iterations after which a seed far from the best value is dropped; as many follow for others."""
_FAR = 0.1
"""Loss above which a value counts as far, as a share of the objective."""
_SAME = 0.1
"""A path that is nowhere further from the best one than this leads to it, rad or m: the first trust
region of the programs."""
_HOPELESS, _HOPELESS_CLEARANCE = 0.1, 0.01
"""Violation by a grid's path above which no program is tried before it is searched again, rad; and
with a clearance, rad or m: programs do not pass obstacles on the other side."""
_DETOUR = 0.05
"""Loss by a detour up to which no finer grid is searched for a shorter one."""
_LOOKS = 10
"""How often a path is searched with further places on its edges where one has met something."""
_SLOWER, _HALVINGS = (3.0, 30.0), 2
"""How many times slower a path is tried that has no motion in its time; how often the range between
the two is halved, in which the least such factor lies."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome of a search: the best feasible path, or why there is none, and a bound.

    The bound is NaN if a waypoint has no configuration, and for centering and margin if one leaves
    more than three degrees free. If Ctrl-C ended the search, the path is the best by then.
    """

    path: JudgedPath | None
    certificate: Certificate
    bound: float = np.nan
    interrupted: bool = False


@dataclass(frozen=True, eq=False)
class _Found:
    """What a level has led to: a path, with the value of the grid's best, or why there is none.

    ``ends``: no finer grid has one either.
    """

    level: Level
    certificate: Certificate
    path: JudgedPath | None = None
    of_grid: float = np.nan
    ends: bool = False


class PlanSearch:
    """A search of the best motion of a problem.

    The stages use more and more waypoints and finer and finer grids. In each, the cheapest path
    through the layers may exceed the limits by the grid's resolution; the quadratic programs that
    then move it off the grid satisfy them exactly, and a proof between the waypoints follows. Where
    that fails, a window of the finest grid is searched around it. The search ends at the first
    stage with a feasible path.

    The paths of other methods find passages that are narrower than the grid. With a fixed start
    they run first; with a free one only if the stages' path is not close to the bound.
    """

    def __init__(
        self,
        problem: Problem,
        runs: Trials = lambda path_task, start: [],
        progress: Progress = lambda what, share: None,
        slower: Slower | None = None,
        *,
        may_slow: bool = False,
    ) -> None:
        """Prepare.

        ``runs`` returns the paths of other methods, ``slower`` the constraints of a slower path, to
        see whether its speed alone prevents a motion. ``may_slow``: a slower motion is searched if
        none is found, so that the reason is not looked for without the clearance, nor on finer
        grids where layers are samples, which prove nothing.
        """
        self.problem, self.runs, self.slower, self.progress = problem, runs, slower, progress
        self._may_slow = may_slow
        self.levels, self._kept = Levels(problem, progress), KeptPaths(problem)
        #: The last level without gaps.
        self._level: Level | None = None
        #: First and last waypoints of stretches that no path passes on a coarser grid.
        self._ends: list[tuple[int, int]] = []
        #: Where a strict path violated a constraint between waypoints, or left the task's path.
        self._closer = CloserLooks({}, set())

    def run(self) -> SearchResult:
        """Search the best motion.

        Raises:
            KeyboardInterrupt: If it is interrupted before there is a motion; later, the result is
                the best by then.
        """
        try:
            result = self._searched(self.problem)
            if result.path is None and self.problem.has_clearance and not self._may_slow:
                proven = result.certificate.covered
                free = result if proven else self._searched(self.problem.free)
                if free.path is None:  # the clearance is not the reason
                    result = free
        except KeyboardInterrupt:
            by_now = _by_now(self)
            if by_now is None:
                raise
            return by_now
        if result.path is not None:
            return self._on_path(self.problem, result)
        if result.certificate.kind != "speed" or self.slower is None:
            return result
        try:
            return _how_much_slower(self, result, self.slower)
        except KeyboardInterrupt:  # the result itself is known
            return result

    def near(self, found: SearchResult) -> SearchResult:
        """The best motion near one that was found with other limits, or that if there is none."""
        path = found.path and self._smooth(self.problem, found.path.q)
        if path is None or not path.feasible:
            return found
        again = self._on_path(self.problem, replace(found, path=path))
        return found if again.path is None else again

    def _on_path(self, problem: Problem, found: SearchResult) -> SearchResult:
        """What was found, or another motion if its joints do not stay on the path in between."""
        if found.path is None:
            return found
        on_path = OnThePath(problem.path_task)
        asked, jumps = replace(problem, limits=replace(problem.limits, on_path=on_path)), False
        try:
            beyond = asked.limits.beyond_between(found.path.q)[0].max(axis=1)
            left = np.flatnonzero(beyond > 0.0)
            if not len(left):
                return found
            jumps = bool(np.isinf(beyond).any())
            self._closer.asked.update(left.tolist())
            ways = [
                partial(_kept_on_path, self, asked, found, found.path, left),
                partial(self._searched, asked),
            ]
            # With two free degrees a window of the finest grid takes longer than coarse ones.
            for way in ways if problem.freedom < COVERED else reversed(ways):
                again = way()
                if again.path is not None:
                    return again
        except KeyboardInterrupt:
            if jumps:  # no motion
                raise
            return replace(found, interrupted=True)
        return _left_path(asked, found, beyond)

    def _searched(self, problem: Problem) -> SearchResult:
        certificate = find_impossible(problem, self.levels)
        if certificate is not None:
            return SearchResult(None, certificate)
        best: JudgedPath | None = None
        for trial in () if problem.start is None else self._tried(problem, problem.start):
            best = self._kept.better(best, trial)
        stages = _stages(problem)
        for stage in stages[:1] if self._may_slow and problem.freedom > COVERED else stages:
            found = self._stage(problem, stage, best)
            best = self._kept.better(best, found.path)
            if found.ends or (found.path is not None and not _is_long_detour(problem, found)):
                break
            if best is None and found.level.has_gaps:
                # Layers that are empty on the finest grid are empty on any grid: stop here.
                certificate = prove_gaps(problem, found.level, self.levels)
                if certificate is not None:
                    return SearchResult(None, certificate)
        first, bound = best, _bound(problem, found.level, best)
        # With a clearance the bound, which knows of none, says little.
        settled = best is not None and (problem.has_clearance or _alike(bound, best.value))
        settled = settled and (problem.stated is None or problem.has_clearance)  # of another unit
        if problem.start is None and not settled:
            for trial in self._tried(problem, None if best is None else best.q[0], best):
                if best is None or _may_become(problem, trial, best):
                    best = self._kept.better(best, self._smooth(problem, trial.q))
        if best is None:
            return SearchResult(None, found.certificate, _stated(problem, bound))
        if best is not first:
            bound = _bound(problem, found.level, best)
        certificate = Certificate("path", found.level.grid, bands=problem.rows.hard.names)
        return SearchResult(best, certificate, _stated(problem, bound))

    # ------------------------------------------------------------------ a stage

    def _stage(self, problem: Problem, stage: SearchStage, best: JudgedPath | None) -> _Found:
        """The best path of a stage's level, or why there is none."""
        waypoints = self.levels.selected(stage, problem.limits.steps)
        ended = self._ended_again(problem, stage, waypoints, best)
        if ended is not None:
            return ended
        level = self.levels.at(stage, problem.limits.steps, waypoints)
        covered = not problem.has_clearance and level.covers
        if level.has_gaps:
            return _Found(level, empty_layers(level, covered))
        self._level, level = level, with_preferred(problem, level)
        nearest, before, of_grid = None, None, np.nan
        coarse = stage is not STAGES[-1]
        again = _LOOKS if problem.has_clearance and not coarse else 0
        for attempt in range(len(STRICTNESS) + again):
            search = self._search(problem, level, stage, strict=attempt > 0)
            way = search.best(_attainable(problem, best))
            if len(way.nodes) < len(level.layers):
                if self._closer.shares and nearest is not None:  # its violation says more
                    break
                return self._ended(problem, level, way, best)
            if way.nodes == before:  # what failed
                break
            before = way.nodes
            path = problem.interpolated(level.corners(way.nodes), waypoints)
            if path is None:
                continue
            of_grid = problem.objective.value(path) if np.isnan(of_grid) else of_grid
            soon = coarse and problem.freedom < COVERED  # layers are made in less time
            found = self._smooth(problem, path, only_near=soon)
            if not found.feasible and coarse:
                why = impossible_step(problem, found.q, self.progress) if best is None else None
                if why is not None:
                    return _Found(level, why, ends=True)
                found = self._mended(problem, found) or found
            if found.feasible:
                return _Found(level, Certificate("path", level.grid), found, of_grid)
            if again and attempt:
                self._closer.look_between(problem.limits, path)
            if nearest is None or found.excess < nearest.excess:
                nearest = found
        return _Found(level, violating_path(problem, nearest, level.grid, covered))

    def _ended_again(
        self, problem: Problem, stage: SearchStage, waypoints: list[int], best: JudgedPath | None
    ) -> _Found | None:
        """The verdict if a stretch that no path passed on a coarser grid has none again."""
        for first, last in self._ends if problem.has_clearance else ():
            near = [index for index in waypoints if first <= index <= last]
            if len(near) < 2:
                continue
            level = self.levels.at(stage, problem.limits.steps, near)
            way = self._search(problem, level, stage, strict=False).best(
                _attainable(problem, None), ()
            )
            if not level.has_gaps and len(way.nodes) < len(near):
                return self._ended(problem, level, way, best)
        return None

    def _search(
        self, problem: Problem, level: Level, stage: SearchStage, *, strict: bool
    ) -> LevelSearch:
        return LevelSearch(problem, self.levels, level, strict, stage, self._closer, self.progress)

    def _ended(
        self, problem: Problem, level: Level, way: LayerPath, best: JudgedPath | None
    ) -> _Found:
        """The verdict where no path goes on, from the layers alone if clearance empties one."""
        if best is not None:  # the grid has no better path
            return _Found(level, Certificate("path", level.grid), best)
        if way.nodes:
            before, after = level.waypoints[len(way.nodes) - 1], level.waypoints[len(way.nodes)]
            first = level.waypoints[way.first] if way.first else before - ABOUT
            self._ends.append((first, after + ABOUT))
        covered = not problem.has_clearance and level.covers

        def cleared(layer: Layer, index: int) -> Layer:
            """The layer, or an empty one that names what none of its configurations keeps."""
            if not problem.has_clearance or not self.levels.is_blocked(problem, layer):
                return layer
            return layer.emptied(forbidding_bands(layer.q, problem.rows.hard, index)[0])

        without = replace(level, layers=list(map(cleared, level.layers, level.waypoints)))
        if without.has_gaps:
            return _Found(without, empty_layers(without, covered))
        return _Found(level, ended_path(problem, level, way, covered))

    def _smooth(
        self, problem: Problem, q: Array, iterations: int = ITERATIONS, *, only_near: bool = False
    ) -> JudgedPath:
        """The best path nearby; rows of the clearance are added if it comes too near.

        ``only_near``: not from where a program seldom leads inside.
        """

        def progress(share: float) -> None:
            if iterations == ITERATIONS:
                self.progress("off the grid", share)

        for of in (problem.free, problem) if problem.has_clearance else (problem,):
            most = _HOPELESS_CLEARANCE if of.has_clearance else _HOPELESS
            if only_near and of.judged(q).excess > most:
                continue
            path = smooth(of, q, iterations=iterations, progress=progress, keep=self._kept.last)
            if of is problem:
                return path
            found = problem.judged(path.q)
            if found.feasible and not (problem.limits.beyond_between(path.q)[0] > 0.0).any():
                return found
        return problem.judged(q)

    def _mended(self, problem: Problem, path: JudgedPath) -> JudgedPath | None:
        """Search the path again on the finest grid around the waypoints where it violates limits.

        These are mostly passages near a singularity; the rest of the path is kept. With a clearance
        the strict search comes first.
        """
        if self._may_slow and problem.freedom > COVERED:
            return None  # on the finest grid, too, layers are samples: the motion is slower instead
        best, at = None, problem.limits.violated(path.q)
        for strict in (True, False) if problem.has_clearance else (False,):
            q = search_windows(problem, self.levels, path, at, strict, self._closer, self.progress)
            found = None if q is None else self._smooth(problem, q)
            if found is not None and found.feasible:
                return found
            if best is None or (found is not None and found.excess < best.excess):
                best = found
        return best

    # ------------------------------------------------------------------ other methods

    def _tried(
        self, problem: Problem, start: Array | None, best: JudgedPath | None = None
    ) -> list[JudgedPath]:
        """The runs of other methods, corrected onto their waypoints and improved a little.

        Without those that stay far from the best path.
        """
        tried, at = [], np.arange(len(problem.path_task.waypoints))
        for run in self.runs(problem.path_task, start):
            on_path, arrived = problem.rows.correct(run, at)
            if arrived.all():
                on_path[0] = run[0]
                trial = self._smooth(problem, on_path, _TRIAL)
                if (
                    best is None
                    or _alike(trial.value, best.value, _FAR)
                    or problem.objective.better(trial.value, best.value)
                ):
                    tried.append(self._smooth(problem, trial.q, _TRIAL))
        return tried


def _by_now(search: PlanSearch) -> SearchResult | None:
    """The best motion of an interrupted search that satisfies all constraints."""
    best, problem, level = search._kept.best(), search.problem, search._level
    if best is None:
        return None
    grid = search.levels.grid(STAGES[0], problem.limits.steps) if level is None else level.grid
    detail = Sentence("the search was interrupted: this is the best motion by then")
    certificate = Certificate("path", grid, bands=problem.rows.hard.names, detail=detail)
    bound = np.nan
    try:
        if level is not None:
            bound = _stated(problem, _bound(problem, level, best))
    except KeyboardInterrupt:  # once more: without a bound
        pass
    return SearchResult(best, certificate, bound, interrupted=True)


def _how_much_slower(search: PlanSearch, result: SearchResult, slower: Slower) -> SearchResult:
    """The result that only speeds prevent a motion, with how much slower there is one."""

    def slowed(times: float) -> JudgedPath | None:
        slow = replace(search.problem, limits=slower(times))
        return search._on_path(slow, search._searched(slow)).path

    certificate = _with_pace(result.certificate, search.problem.limits, slowed)
    return replace(result, certificate=certificate)


def _kept_on_path(
    search: PlanSearch, problem: Problem, result: SearchResult, path: JudgedPath, left: Indices
) -> SearchResult:
    """The path, searched again around the waypoints (K,) after which it has ``left`` the task's.

    Programs may lead back to where it does: then it is the grid's. None if that leaves it, too, or
    costs more than a search of everything is worth.
    """
    asked = search._closer._replace(shares={})
    q = search_windows(problem, search.levels, path, left + 1, True, asked, search.progress)
    for found in () if q is None else (search._smooth(problem, q), problem.judged(q)):
        beyond = problem.limits.beyond_between(found.q)[0]
        if found.feasible and _alike(found.value, path.value) and not (beyond > 0.0).any():
            return replace(result, path=found)
    return replace(result, path=None)


def _left_path(problem: Problem, found: SearchResult, beyond: Array) -> SearchResult:
    """The result where no motion on the path was found: none, or that with a note.

    ``beyond`` are the violations between waypoints, rad or m, (N − 1,): ∞ where it jumps.
    """
    certificate = found.certificate
    if np.isinf(beyond).any():
        none = violating_path(problem, found.path, certificate.grid, certificate.covered)
        return replace(found, path=None, certificate=none)
    at = int(np.argmax(beyond)) + 1
    note = Sentence(
        "where its joints are corrected onto the path, between waypoints ", at, " and ", at + 1,
        ", it breaks a band or constraint; no motion was found that does not",
    )  # fmt: skip
    return replace(found, certificate=replace(certificate, note=note))


def _with_pace(
    certificate: Certificate, limits: PathConstraints, slowed: Callable[[float], JudgedPath | None]
) -> Certificate:
    """The certificate of a path that is too fast, with how much slower it has a motion.

    ``slowed`` returns the best motion of the path that takes so many times as long, if any.
    """
    without = 1.0
    for times in _SLOWER:
        path = slowed(times)
        if path is not None:
            break
        without = times
    else:
        none = Sentence(f"nor was one found for the path {without:g} times slower")
        return replace(certificate, note=none)
    needed, number, joint = limits.pace(path.q)
    for _ in range(_HALVINGS):
        times = float(np.sqrt(without * needed))
        path = slowed(times)
        if path is None:
            without = times
        else:
            needed, number, joint = limits.pace(path.q)
    bracket = f"; {without:.3g} times slower none was found" if without > 1.0 else ""
    note = Sentence(
        f"only its speed prevents one: {needed:.3g} times slower the path has a motion, which "
        "needs that after waypoint ", number + 1, f", for {joint}{bracket}",
    )  # fmt: skip
    return replace(certificate, slower=needed, note=note)


def _stages(problem: Problem) -> tuple[SearchStage, ...]:
    """The stages of a search."""
    if problem.freedom >= COVERED:
        return COARSE, *STAGES
    return (SHORT, *STAGES) if are_far(problem.limits.steps) else STAGES


def _alike(value: float, best: float, share: float = _ROUNDED) -> bool:
    return abs(value - best) <= share * abs(best)


def _attainable(problem: Problem, best: JudgedPath | None) -> float:
    """The value up to which a grid's path is searched: a little worse than that of ``best``.

    It may be a little worse than the best one between its nodes.
    """
    if best is None:
        return -np.inf if problem.objective.margin else np.inf
    if problem.objective.margin:
        return best.value - _ROUNDED * abs(best.value)
    return best.value * (1.0 + (_ROUNDED_TRAVEL if problem.objective.travel else _ROUNDED))


def _may_become(problem: Problem, trial: JudgedPath, best: JudgedPath) -> bool:
    """Whether a seed may lead to a better path: not if it is far, or leads to the same one."""
    if problem.objective.better(trial.value, best.value):
        return True
    apart = np.abs(problem.unwound(trial.q - best.q)).max()
    return bool(apart > _SAME and _alike(trial.value, best.value))


def _is_long_detour(problem: Problem, found: _Found) -> bool:
    """Whether a path is much worse than the grid's, which touches something between waypoints.

    A finer grid may have a shorter one.
    """
    if found.path is None or not problem.has_clearance:
        return False
    is_better = problem.objective.better(found.of_grid, found.path.value)
    return is_better and not _alike(found.path.value, found.of_grid, _DETOUR)


def _bound(problem: Problem, level: Level, best: JudgedPath | None) -> float:
    """The bound of the value from a level, without clearances; NaN if the level has gaps."""
    if level.has_gaps:
        return np.nan
    q, free = None if best is None else best.q, problem.free
    return pointwise_bound(
        free.path_task,
        free.stated or free.objective,
        free.rows,
        level.layers,
        level.waypoints,
        free.start,
        q,
    )


def _stated(problem: Problem, bound: float) -> float:
    """The bound, if the layers cover all minima of z and maxima of the margin."""
    objective = problem.stated or problem.objective
    pointwise = objective.centering > 0.0 or objective.margin
    return np.nan if pointwise and problem.freedom > BOUNDED else bound
