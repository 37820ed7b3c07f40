"""Layers of an arm with closed-form inverse kinematics, on a grid of rolls."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges, OrthoParallelArm
from qp_twist.kinematics.serial_chain import turns
from qp_twist.path import PathTask
from qp_twist.planning.layer import TURN, Layer, inside_bands, inside_limits

FINEST = 16
"""Most parts of a grid interval in which the joints run fast."""


class RollGrid:
    """All branches of the inverse kinematics at every roll of a grid.

    Attributes:
        arm: The inverse kinematics.
        spacing: Of the grid, rad.
        rolls: Of the grid, against each waypoint's own, rad.
    """

    def __init__(
        self, path_task: PathTask, arm: OrthoParallelArm, spacing: float, joints: Array
    ) -> None:
        """Prepare.

        Args:
            path_task: The task.
            arm: Its arm.
            spacing: Of the grid of rolls, rad.
            joints: Change of each joint between two rolls of the grid above which the interval is
                divided, rad, (6,): near a straight wrist the joints run faster than the roll.
        """
        self.path_task = path_task
        self.arm = arm
        self.ranges = JointRanges.of(path_task.model)
        count = max(4, int(np.ceil(TURN / spacing)))
        self.spacing = TURN / count
        self.rolls = np.linspace(0.0, TURN, count, endpoint=False)
        self._joints = joints

    @staticmethod
    def applies(path_task: PathTask, index: int) -> bool:
        """Whether at a waypoint only the roll is free, or nothing."""
        projector = path_task.in_force[index]
        return projector.linear.kind is ProjectorKind.FULL and projector.angular.kind in (
            ProjectorKind.FULL,
            ProjectorKind.PLANE,
        )

    def layer(self, index: int) -> Layer:
        """The configurations at a waypoint."""
        if self.path_task.in_force[index].angular.kind is ProjectorKind.FULL:
            return self._inside(index, np.zeros(1), self._branches(index, np.zeros(1)))
        grid = self.branches(index)
        change = np.diff(grid, axis=0, append=grid[:1])
        change -= TURN * np.round(change / TURN)
        times = np.nan_to_num(np.abs(change) / self._joints).max(axis=(1, 2))
        parts = np.clip(np.ceil(times), 1, FINEST).astype(int)
        number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        rolls = np.repeat(self.rolls, parts) + self.spacing * number / np.repeat(parts, parts)
        found = np.repeat(grid, parts, axis=0)
        between = number > 0
        found[between] = self._branches(index, rolls[between])
        return self._inside(index, rolls, found)

    def branches(self, index: int) -> Array:
        """Joint positions at the rolls of the grid, (R, 8, 6), NaN where out of reach."""
        return self._branches(index, self.rolls)

    @staticmethod
    def axis(path_task: PathTask, index: int) -> Array:
        """Axis of the roll at a waypoint, in the axes of the frame, (3,)."""
        projector = path_task.in_force[index]
        axis = projector.angular.axis
        assert axis is not None
        if projector.frame == "world":
            axis = path_task.waypoints[index].rotation().as_matrix().T @ axis
        return axis

    def _inside(self, index: int, rolls: Array, found: Array) -> Layer:
        waypoint = self.path_task.waypoints[index]
        positions = np.broadcast_to(waypoint.translation(), (len(rolls), 3))
        rotations = self._rotations(index, rolls)
        found = found[inside_bands(self.path_task.bands, rotations, positions, waypoint)]
        row, branch = np.nonzero(np.isfinite(found).all(axis=2))
        return inside_limits(found[row, branch], branch, self.ranges)

    def _branches(self, index: int, rolls: Array) -> Array:
        rotations = self._rotations(index, rolls)
        position = self.path_task.waypoints[index].translation()
        return self.arm.branches(rotations, np.broadcast_to(position, (len(rolls), 3)))

    def _rotations(self, index: int, rolls: Array) -> Array:
        """Of the frame at a waypoint with some rolls more than the waypoint's, (K, 3, 3)."""
        rotation = self.path_task.waypoints[index].rotation().as_matrix()
        if self.path_task.in_force[index].angular.axis is None:
            return rotation[None]
        turned: Array = rotation @ turns(self.axis(self.path_task, index), rolls)
        return turned
