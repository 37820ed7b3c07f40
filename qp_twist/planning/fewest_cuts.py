"""Where a path is interrupted that no single motion follows: as rarely as possible."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.paths import in_joint_moves
from qp_twist.planning.layer import Layer
from qp_twist.planning.level_search import ABOUT, CloserLooks, LevelSearch
from qp_twist.planning.levels import (
    COARSE,
    SHORT,
    Grid,
    Level,
    Levels,
    Progress,
    SearchStage,
    are_far,
)
from qp_twist.planning.manifold_net import COVERED
from qp_twist.planning.problem import Problem

_GRID = SearchStage(np.radians(30.0), 10, np.radians(4.0), np.radians(4.0), 0.125)
"""The grid with one free degree or none: that of the first stage of a plan, but half as far apart,
since steps exceed their limits by it."""


class Cuts(NamedTuple):
    """The fewest interruptions of a path on a grid, without its own joint moves."""

    after: tuple[int, ...]
    """The waypoints after which they are, from 1."""
    covered: bool
    """Whether the layers contain all configurations, to the grid's spacing."""


class FewestCuts:
    """Searches the fewest interruptions of a path, and among them the best.

    In a search through layers at some of the waypoints an interruption is dearer than any
    difference of two motions. As steps may exceed their limits by the grid's resolution, no motion
    has fewer interruptions than it finds. Near each of them, and where a plan between them fails,
    layers are then made at every waypoint.

    Attributes:
        blocked: Intervals, by the waypoint before them, from 0, in which no motion goes on.
        barred: Intervals in which the tool cannot lift off.
    """

    def __init__(self, problem: Problem, progress: Progress) -> None:
        self.problem, self._progress = problem, progress
        self._levels, steps = Levels(problem, progress), problem.limits.steps
        exact = replace(_GRID, longest=SHORT.longest) if are_far(steps) else _GRID
        self._stage = COARSE if problem.freedom >= COVERED else exact
        task = problem.path_task
        self._moves, ends = in_joint_moves(task), np.array(task.joint_moves, dtype=np.intp)
        self.blocked: set[int] = set()
        # Blends lead from one projector to the next, and are not interrupted.
        self.barred = {k - 1 for of in task.segments for k in range(of.first, of.first + of.blend)}
        self._layers: dict[int, Layer] = {}
        selected = self._levels.selected(self._stage, steps)
        self._made = self._levels.at(self._stage, steps, sorted({*selected, *ends, *(ends - 1)}))
        self._layers = dict(zip(self._made.waypoints, self._made.layers, strict=True))

    @property
    def grid(self) -> Grid:
        """The grid of the layers."""
        return self._made.grid

    def found(self) -> Cuts | None:
        """The interruptions; ``None`` if a waypoint has no configuration, or nothing helps."""
        while True:
            waypoints = sorted(self._layers)
            level = Level(self._made.roadmap, waypoints, [self._layers[k] for k in waypoints])
            if level.has_gaps:
                return None
            at, last = np.array(waypoints), len(self.problem.path_task.waypoints) - 1
            near = np.diff(at) == 1
            moves, blocked, barred = (
                np.isin(at[:-1], np.array(sorted(of), dtype=np.intp)) & near
                for of in (set(np.flatnonzero(self._moves)), self.blocked, self.barred)
            )
            # A stretch has two waypoints at least: between layers there are others, or it has two.
            alone = ~np.append(near, at[-1] == last) | ~np.append(at[0] == 0, near)
            search = LevelSearch(
                self.problem, self._levels, level, True, self._stage, CloserLooks({}, set()),
                self._progress,
            )  # fmt: skip
            prices = np.where(moves, 0.0, np.where(barred, np.inf, 1.0))
            way = search.interrupted(prices, moves | blocked, alone)
            if len(way.nodes) < len(waypoints):
                return None
            cuts = [waypoints[k - 1] for k in way.cuts if not moves[k - 1]]
            new = [self.look_about(k) for k in cuts]
            if not any(new):
                after = tuple(k + 1 for k in cuts)
                covered = level.covers and not np.isfinite(self._stage.longest)
                return Cuts(after, covered and not self.problem.has_clearance)

    def look_about(self, k: int) -> bool:
        """Make layers at every waypoint near interval k; whether one beside it had none."""
        if k in self._layers and k + 1 in self._layers:
            return False
        last = len(self.problem.path_task.waypoints) - 1
        about = range(max(0, k - ABOUT), min(last, k + 2 * ABOUT) + 1)
        waypoints = [k for k in about if k not in self._layers]
        made = self._levels.at(self._stage, self.problem.limits.steps, waypoints)
        self._layers |= dict(zip(waypoints, made.layers, strict=True))
        return True
