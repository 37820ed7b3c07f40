"""Joint limit margins over waypoint and roll, branch by branch, and what the arm would touch."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.geometry import ProjectorKind, twist_angle
from qp_twist.kinematics import JointRanges, ParametrisedArm
from qp_twist.paths import PathTask
from qp_twist.planning.layer import TURN, centred, wound
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import motion_limits
from qp_twist.planning.roll_grid import RollGrid, closed_form_arm

_REACH = np.radians(45.0)
"""Range to either side in which a roll is searched that connects to the next waypoint, rad."""


@dataclass(frozen=True, eq=False)
class RollMap:
    """Margins over waypoint, roll and branch.

    Attributes:
        path_task: The path.
        arm: Its arm.
        waypoints: The waypoints, from 0, (W,).
        rolls: Rolls relative to each waypoint's, rad, from −π on, (R,).
        margins: Distance from the nearest joint limit, for the best whole turns, degrees, (W, R,
            8): negative outside the limits, NaN out of reach.
        sigma_min: Smallest singular value of the task rows UᵀJ, (W, R, 8); NaN likewise.
        stuck: Whether no roll of the next waypoint, in the same branch, is within the task's speed
            limits, (W, R, 8).
        touched: Index in ``pairs`` of a pair of geoms that is nearer than the task allows, (W, R,
            8); −1 where none is, and where a joint is outside its limits.
        pairs: Names of the pairs of the task's clearances.
    """

    path_task: PathTask
    arm: ParametrisedArm
    waypoints: Indices
    rolls: Array
    margins: Array
    sigma_min: Array
    stuck: Mask
    touched: Indices
    pairs: tuple[str, ...]

    @classmethod
    def of(cls, path_task: PathTask, *, columns: int = 200, spacing_deg: float = 2.0) -> RollMap:
        """Evaluate the map of a path.

        Raises:
            InvalidInput: If not exactly a roll is free, or the arm has no closed-form inverse
                kinematics.
        """
        arm = roll_arm(path_task)
        if arm is None:
            raise InvalidInput(
                f"{path_task.name}: a map of rolls is for arms of six hinges with closed-form "
                "inverse kinematics whose roll about the tool is free all the way."
            )
        ranges = JointRanges.of(path_task.model)
        grid = RollGrid(path_task, arm, np.radians(spacing_deg), np.full(6, np.inf))
        count = len(path_task.waypoints)
        waypoints = np.unique(np.linspace(0, count - 1, min(columns, count)).round().astype(int))
        rolls = _wrapped(grid.rolls)
        order = np.argsort(rolls)
        q = np.array([centred(grid.branches(index)[order], ranges) for index in waypoints])
        room = ranges.room(q).min(axis=3)
        steps = motion_limits(path_task, ranges).steps
        stuck = np.zeros(room.shape, dtype=bool)
        for k, (a, b) in enumerate(itertools.pairwise(waypoints)):
            stuck[k] = ~_connected(q[k], q[k + 1], steps[a:b].sum(axis=0), grid.spacing)
        sigma_min, reached = np.full(room.shape, np.nan), np.isfinite(q).all(axis=3)
        at = np.broadcast_to(waypoints[:, None, None], reached.shape)
        sigma_min[reached] = PathRows(path_task).sigma_min(q[reached], at[reached])
        touched, pairs, inside = np.full(room.shape, -1), list[str](), room >= 0.0
        for clearance in path_task.clearances:
            first = clearance.first_violated(q[inside])
            new = (touched[inside] < 0) & (first >= 0)
            touched[inside] = np.where(new, len(pairs) + first, touched[inside])
            pairs += clearance.names
        return cls(
            path_task, arm, waypoints, rolls[order], np.degrees(room), sigma_min, stuck, touched,
            tuple(pairs),
        )  # fmt: skip

    def in_the_way(self, branches: Sequence[int] = range(8)) -> dict[str, int]:
        """Pairs that are too near in some branches, with the number of nodes, most frequent first.

        A node where several pairs are too near counts for the first of them.
        """
        touched = self.touched[:, :, list(branches)]
        counts = np.bincount(touched[touched >= 0], minlength=len(self.pairs))
        return {self.pairs[k]: int(counts[k]) for k in np.argsort(-counts) if counts[k]}

    def __repr__(self) -> str:
        waypoints, rolls, branches = self.margins.shape
        return (
            f"RollMap({self.path_task.name!r}, {waypoints} waypoints, {rolls} rolls, "
            f"{branches} branches)"
        )

    def locate(self, q: Array) -> tuple[Array, Indices]:
        """Rolls (N,), rad in [−π, π), and branches (N,) of a joint path q (N, nv).

        NaN where a configuration is not on its waypoint's axis by more than a degree.
        """
        rotations, positions = self.arm.chain.poses(q)
        apart = wound(self.arm.branches(rotations, positions) - q[:, None])
        distance = np.where(np.isfinite(apart), np.abs(apart), np.inf).max(axis=2)
        rolls = np.full(len(q), np.nan)
        for k, (rotation, target) in enumerate(
            zip(rotations, self.path_task.poses[0], strict=True)
        ):
            axis = RollGrid.axis(self.path_task, k)
            if (rotation @ axis) @ (target @ axis) > np.cos(np.radians(1.0)):
                rolls[k] = twist_angle(target.T @ rotation, axis)
        return _wrapped(rolls), distance.argmin(axis=1)


def roll_arm(path_task: PathTask) -> ParametrisedArm | None:
    """The arm of a task whose roll is free everywhere, if branches keep their index along it."""
    free = all(
        RollGrid.applies(path_task, k) and projector.angular.kind is ProjectorKind.PLANE
        for k, projector in enumerate(path_task.in_force)
    )
    arm = closed_form_arm(path_task) if free else None
    return arm if arm is not None and arm.labelled else None


def _wrapped(angles: Array) -> Array:
    """Angles in [−π, π)."""
    wrapped: Array = np.mod(angles + np.pi, TURN) - np.pi
    return wrapped


def _connected(q: Array, after: Array, step: Array, spacing: float) -> Mask:
    """Which of q (R, 8, 6) have one of ``after`` in the same branch within ``step``, (R, 8)."""
    found = np.zeros(q.shape[:2], dtype=bool)
    reach = int(_REACH / spacing)
    for shift in range(-reach, reach + 1):
        apart = wound(np.roll(after, shift, axis=0) - q)
        found |= (np.abs(apart) <= step).all(axis=2)
    return found
