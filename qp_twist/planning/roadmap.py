"""Roadmap of a path: the layers of its waypoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.layer import Layer, inside_limits
from qp_twist.planning.manifold_net import COVERED, ManifoldNet
from qp_twist.planning.path_rows import REACHED, PathRows
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm

_NEAREST, _LOOKED_AT = 200, 5
"""Numbers of random configurations from which the nearest one to a waypoint out of reach is
searched, and of such waypoints that are looked at."""


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
    """The layers of a path, computed on request.

    Attributes:
        path_task: The path.
        rows: Its task rows.
        ranges: The joint ranges.
        grid: Sampling of the free coordinates.
        arm: The closed-form inverse kinematics, if the robot has one.
    """

    def __init__(self, path_task: PathTask, rows: PathRows, grid: Grid) -> None:
        self.path_task = path_task
        self.rows = rows
        self.ranges = JointRanges.of(path_task.model)
        self.grid = grid
        self.arm = closed_form_arm(path_task)
        self._net = ManifoldNet(path_task, rows, grid.joints)
        self._rolls = (
            None if self.arm is None else RollGrid(path_task, self.arm, grid.roll, grid.joints)
        )

    def covers(self, index: int) -> bool:
        """Whether the layer of a waypoint is complete, to the grid's spacing.

        Hard bands may cut a self-motion manifold into pieces without a seed; for rolls the ends of
        the bands are found.
        """
        if self._closed_form(index):
            assert self._rolls is not None
            return self._rolls.settled(index)
        return self.samples_all(index) and not self.rows.hard.cuts

    def samples_all(self, index: int) -> bool:
        """The same layers without hard bands."""
        return self._closed_form(index) or int(self.rows.freedom[index]) <= COVERED

    def layers(
        self, waypoints: Sequence[int], progress: Callable[[int], None] | None = None
    ) -> list[Layer]:
        """The layers of some waypoints, in the order of the path."""
        found: list[Layer] = []
        for done, index in enumerate(waypoints, start=1):
            found.append(self.layer(index, found[-1] if found else None))
            if progress is not None:
                progress(done)
        return found

    def layer(self, index: int, before: Layer | None = None) -> Layer:
        """The layer of a waypoint; a net has seeds of another layer, too."""
        if self._closed_form(index):
            assert self._rolls is not None
            return self._rolls.layer(index)
        return self._net.layer(index, before)

    def is_independent(self, index: int) -> bool:
        """Whether the layer of a waypoint is the same whatever layers are made before it."""
        return self._closed_form(index)

    def seeded(self, index: int, seeds: Layer) -> Layer:
        """What a net at a waypoint would grow from: empty if no configuration is found there."""
        return self._net.layer(index, seeds, grow=False)

    def within_tolerance(self, index: int) -> Layer:
        """Configurations that miss a waypoint by no more than the tolerances of a check."""
        q, arrived = self.rows.correct_inside(self._random(), np.full(_NEAREST, index))
        q = q[arrived]
        layer = inside_limits(q, np.arange(len(q)), self.ranges)
        return replace(layer, nearby=bool(len(layer.q)))

    def missed(self, waypoints: Sequence[int]) -> str:
        """By how much the arm misses waypoints out of reach, of some of them the furthest."""
        chosen = np.unique(np.linspace(0, len(waypoints) - 1, _LOOKED_AT).round().astype(int))
        found = {waypoints[k]: self.rows.nearest(waypoints[k], self._random()) for k in chosen}
        worst = max(found, key=lambda index: float(found[index].shares.max()))
        return (
            f"the nearest configuration that was found misses waypoint {worst + 1} by "
            f"{found[worst]}, where a check lets {1e3 * REACHED.position:g} mm and "
            f"{np.degrees(REACHED.axis):g}° pass"
        )

    def _random(self) -> Array:
        return self.ranges.random(_NEAREST, np.random.default_rng(0))

    def _closed_form(self, index: int) -> bool:
        return self._rolls is not None and RollGrid.applies(self.path_task, index)
