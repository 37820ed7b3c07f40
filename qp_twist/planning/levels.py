"""Levels of a search: layers at some waypoints, on a grid; each is made once."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.bound import least_displacements
from qp_twist.planning.layer import Layer, inside_limits
from qp_twist.planning.manifold_net import COVERED, ManifoldNet
from qp_twist.planning.path_rows import REACHED, PathRows
from qp_twist.planning.problem import Problem
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm
from qp_twist.planning.sentence import Sentence

Progress = Callable[[str, float], None]

COARSEST = np.radians(15.0)
"""Largest spacing of configurations in a joint, rad or m."""
_NEAREST, _LOOKED_AT = 200, 5
"""Numbers of random configurations from which the nearest one to a waypoint out of reach is
searched, and of such waypoints that are looked at."""
_AT_ONCE = 50
"""Number of configurations of a layer of which the clearance is evaluated before all others."""
_UNKNOWN = -1
_DENSE = 1.0 / 30.0
"""Share of a stage's motion up to which the joints may have to move between selected waypoints that
are further apart than its stride."""


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
        skips: Number of selected waypoints beyond which more of them are skipped; 0: none.
        longest: Largest motion of a joint even to the next waypoint, rad or m.
    """

    motion: float
    longest_stride: int
    roll: float
    joints: float
    resolution: float
    most: float = np.inf
    skips: int = 0
    longest: float = np.inf


COARSE = SearchStage(
    np.radians(30.0), 10, np.radians(8.0), np.radians(8.0), 0.5, np.radians(30.0), 40
)
"""Comes first with two free degrees, where each of the next takes minutes."""
_FIRST = SearchStage(np.radians(30.0), 10, np.radians(4.0), np.radians(4.0), 0.25)
SHORT = replace(_FIRST, longest=np.radians(45.0))
"""Comes first where joints may mostly move by more than :data:`_FAR` to the next waypoint. Almost
all longer motions jump to another branch, and there are millions of them between a UR5e's layers of
12,288. Deburring in steps of 25 and 17 mm takes 0.8 and 0.5 s so, at most 2 % above the bound; with
longer motions 4.3 and 4.6 s."""
_FAR = np.radians(60.0)
"""rad or m; up to it there are few longer motions."""
STAGES = (
    _FIRST,
    SearchStage(np.radians(10.0), 4, np.radians(2.0), np.radians(2.0), 0.25),
    SearchStage(0.0, 1, np.radians(1.0), np.radians(1.0), 0.25),
)


def are_far(steps: Array) -> bool:
    """Whether joints may mostly move far to the next waypoint, by ``steps`` (N − 1, nv)."""
    return bool(np.median(steps) > _FAR)


@dataclass(frozen=True, eq=False)
class Grid:
    """Sampling of the free coordinates.

    Attributes:
        roll: Spacing of rolls, for closed-form inverse kinematics, rad.
        joints: Largest distance of neighbours in each joint, rad or m, (nv,).
    """

    roll: float
    joints: Array

    def __str__(self) -> str:
        roll, joints = np.degrees(self.roll), np.degrees(self.joints.max())
        return f"rolls {roll:.3g}° apart, joints {joints:.3g}°"


class Roadmap:
    """The layers of a path on a ``grid``, made on request.

    ``arm`` is the closed-form inverse kinematics, if the robot has one; ``kept`` are the rows
    with the clearance (:class:`~qp_twist.planning.manifold_net.ManifoldNet`).
    """

    def __init__(
        self, path_task: PathTask, rows: PathRows, grid: Grid, kept: PathRows | None = None
    ) -> None:
        self.path_task, self.rows, self.grid = path_task, rows, grid
        self.ranges = JointRanges.of(path_task.model)
        self.arm = closed_form_arm(path_task)
        self._net = ManifoldNet(path_task, rows, grid.joints, kept=kept)
        self._rolls = (
            None if self.arm is None else RollGrid(path_task, self.arm, grid.roll, grid.joints)
        )

    def rolls(self, index: int) -> RollGrid | None:
        """The grid of rolls that is the layer of a waypoint, if it is one."""
        return self._rolls if RollGrid.applies(self.path_task, index) else None

    def covers(self, index: int) -> bool:
        """Whether the layer of a waypoint is complete, to the grid's spacing.

        Hard bands may cut a self-motion manifold into pieces without a seed; for rolls the ends of
        the bands are found.
        """
        rolls = self.rolls(index)
        if rolls is not None:
            return rolls.settled(index)
        return self.samples_all(index) and not self.rows.hard.cuts

    def samples_all(self, index: int) -> bool:
        """The same for layers without hard bands."""
        return self.rolls(index) is not None or int(self.rows.freedom[index]) <= COVERED

    def layers(
        self, waypoints: Sequence[int], progress: Callable[[int], None] = lambda done: None
    ) -> list[Layer]:
        """The layers of some waypoints, in the order of the path: a net has seeds of the last."""
        found: list[Layer] = []
        for done, index in enumerate(waypoints, start=1):
            rolls, before = self.rolls(index), found[-1] if found else None
            layer = self._net.layer(index, before) if rolls is None else rolls.layer(index)
            if rolls is not None and not rolls.arm.labelled:
                layer = replace(layer, branch=self._net.pieces(layer.q))
            found.append(layer)
            progress(done)
        return found

    def seeded(self, index: int, seeds: Layer | None = None) -> Layer:
        """What a net at a waypoint would grow from: empty if no configuration is found there."""
        return self._net.layer(index, seeds, grow=False)

    def within_tolerance(self, index: int) -> Layer:
        """Configurations that miss a waypoint by no more than the tolerances of a check."""
        q, arrived = self.rows.correct_inside(self._random(), np.full(_NEAREST, index))
        q = q[arrived]
        layer = inside_limits(q, np.arange(len(q)), self.ranges)
        return replace(layer, nearby=bool(len(layer.q)))

    def missed(self, waypoints: Sequence[int]) -> Sentence:
        """By how much the arm misses waypoints out of reach, of some of them the furthest."""
        chosen = np.unique(np.linspace(0, len(waypoints) - 1, _LOOKED_AT).round().astype(int))
        found = {waypoints[k]: self.rows.nearest(waypoints[k], self._random()) for k in chosen}
        worst = max(found, key=lambda index: found[index][0])
        return Sentence(
            "the nearest configuration that was found misses waypoint ", worst + 1,
            f" by {found[worst][1]}, where a check lets {1e3 * REACHED.position:g} mm and "
            f"{np.degrees(REACHED.axis):g}° pass",
        )  # fmt: skip

    def _random(self) -> Array:
        return self.ranges.random(_NEAREST, np.random.default_rng(0))


@dataclass(frozen=True, eq=False)
class Level:
    """Layers at some waypoints of a path, from 0, and the roadmap that made them.

    Joints move from one layer to the next as far as in ``stride`` steps, if there are more between.
    """

    roadmap: Roadmap
    waypoints: list[int]
    layers: list[Layer]
    stride: int = sys.maxsize

    @property
    def grid(self) -> Grid:
        """Sampling of the free coordinates."""
        return self.roadmap.grid

    @property
    def has_gaps(self) -> bool:
        """Whether a waypoint has no configuration."""
        return not all(len(layer.q) for layer in self.layers)

    @property
    def covers(self) -> bool:
        """Whether the layers are complete, to the grid's spacing."""
        return all(map(self.roadmap.covers, self.waypoints))

    def part(self, first: int, last: int) -> Level:
        """The level from one waypoint to another."""
        near = [k for k, index in enumerate(self.waypoints) if first <= index <= last]
        part = slice(near[0], near[-1] + 1) if near else slice(0)
        return replace(self, waypoints=self.waypoints[part], layers=self.layers[part])

    def corners(self, nodes: Sequence[int]) -> Array:
        """The configurations of a path through the layers, (W, nv)."""
        return np.array([layer.q[node] for layer, node in zip(self.layers, nodes, strict=True)])


class Levels:
    """The levels of a problem without its clearance, and what is known of their clearance.

    ``found`` has layers of waypoints whose layers on coarser grids are empty.
    """

    def __init__(self, problem: Problem, progress: Progress) -> None:
        self.problem = problem.free
        self._kept = problem.rows if problem.has_clearance else None
        self.found: dict[int, Layer] = {}
        self._progress = progress
        self._made: dict[tuple[float, bytes, tuple[int, ...]], list[Layer]] = {}
        #: Of the first copies in layers: 1 where they keep the clearance, 0 where not, or unknown.
        self._clear: dict[Layer, np.ndarray] = {}

    def selected(self, stage: SearchStage, steps: Array) -> list[int]:
        """Waypoints of a stage: at its stride, the last, and where the projector changes.

        More are skipped where they are dense: while they alone move the joints little. ``steps``
        are the largest ones of the joints, (N − 1, nv).
        """
        count, in_force = len(self.problem.path_task.waypoints), self.problem.path_task.in_force
        changes = {
            at for k in range(1, count) if in_force[k] is not in_force[k - 1] for at in (k - 1, k)
        }
        at = np.arange(0, count, self._stride(stage, steps))
        if stage.motion:
            least = self.moved[at] // (_DENSE * stage.motion)
            at = at[np.append(True, np.diff(least) > 0)]
        return sorted({*at.tolist(), count - 1, *changes})

    @cached_property
    def moved(self) -> Array:
        """How far the joints at least move up to each waypoint, about, rad or m, (N,)."""
        least = least_displacements(self.problem.path_task, self.problem.rows.chain, np.zeros(2))
        return np.append(0.0, np.cumsum(least.turned + least.travelled))

    def at(self, stage: SearchStage, steps: Array, waypoints: list[int]) -> Level:
        """The level of a stage at some waypoints."""
        grid, start = self.grid(stage, steps), self.problem.start
        roadmap = Roadmap(self.problem.path_task, self.problem.rows, grid, self._kept)
        key = (grid.roll, grid.joints.tobytes(), tuple(waypoints))
        if key not in self._made:
            layers = roadmap.layers(
                waypoints, lambda done: self._progress(f"{grid}: layers", done / len(waypoints))
            )
            if start is not None and not all(map(roadmap.samples_all, waypoints)):
                layers = [self._followed(k, of) for k, of in zip(waypoints, layers, strict=True)]
            self._made[key] = layers
        made = zip(waypoints, self._made[key], strict=True)
        layers = [self.found.get(index, layer) for index, layer in made]
        if start is not None and waypoints[0] == 0:
            layers[0] = Layer.alone(start)
        return Level(roadmap, waypoints, layers, self._stride(stage, steps))

    def grid(self, stage: SearchStage, steps: Array) -> Grid:
        """The grid of a stage."""
        step = self._stride(stage, steps) * np.median(steps, axis=0)
        joints = np.clip(stage.resolution * step, stage.joints, COARSEST)
        return Grid(max(stage.roll, 0.5 * joints.max()), joints)

    def _stride(self, stage: SearchStage, steps: Array) -> int:
        longest = stage.longest_stride
        stride = int(np.clip(round(stage.motion / float(np.median(steps))), 1, longest))
        if stage.skips:
            stride = int(np.clip(len(self.problem.rows.freedom) // stage.skips, stride, longest))
        return stride

    def clear(self, problem: Problem, layer: Layer, nodes: Indices) -> Mask:
        """Which configurations of a layer, by their indices (K,), keep the clearance, (K,).

        Each is looked at once: a layer is searched several times, and most of it never reached.
        """
        if not problem.has_clearance:
            return np.ones(len(nodes), dtype=bool)
        first, which = layer.copies
        unknown = np.full(len(first), _UNKNOWN, dtype=np.int8)
        known = self._clear.setdefault(layer, unknown)
        which = which[nodes]
        asked = np.zeros(len(first), dtype=bool)
        asked[which] = True
        new = np.flatnonzero(asked & (known == _UNKNOWN))
        known[new] = problem.clear(layer.q[first[new]])
        clear: Mask = known[which] == 1
        return clear

    def is_blocked(self, problem: Problem, layer: Layer) -> bool:
        """Whether no configuration of a layer keeps the clearance."""
        count = len(layer.q)
        parts = 1 + count // _AT_ONCE  # one that does is mostly among the first
        return not any(
            self.clear(problem, layer, np.arange(part, count, parts)).any() for part in range(parts)
        )

    def _followed(self, index: int, layer: Layer) -> Layer:
        """A sampled layer with the configuration to which least-norm steps lead from the start."""
        q, at = self._from_start[index][None], np.array([index])
        limits = self.problem.limits
        if not limits.ranges.inside(q).all() or not self.problem.rows.hard.inside(q, at).all():
            return layer
        return replace(layer.joined(q, np.full(1, -1)), solutions=layer.solutions + 1)

    @cached_property
    def _from_start(self) -> Array:
        """Least-norm steps from the start, waypoint by waypoint, (N, nv); NaN where they end."""
        start = self.problem.start
        assert start is not None
        path = np.full((len(self.problem.path_task.waypoints), len(start)), np.nan)
        path[0] = start
        for index in range(1, len(path)):
            q, inside = self.problem.rows.correct_inside(path[[index - 1]], np.array([index]))
            if not inside[0]:
                break
            path[index] = q[0]
        return path
