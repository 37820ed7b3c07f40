"""Layers of an arm with closed-form inverse kinematics, on a grid of rolls."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.constraints import JointCouplings
from qp_twist.geometry import ProjectorKind, TwistProjector, rotation_matrix
from qp_twist.kinematics import JointRanges, ParametrisedArm, SerialChain
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import WITHIN, HardConstraints
from qp_twist.planning.layer import TURN, Layer, distances, empty_layer, inside_limits, wound

FINEST = 16
"""Largest number of parts of a grid interval in which the joints move fast."""
_HINGES = 6
"""Number of joints of an arm with closed-form inverse kinematics."""
_HALVINGS, _MOST_STRETCHES = 12, 20_000
"""Number of times that a grid interval with a possible end of a band is halved, and the number of
intervals beyond which none is."""


def closed_form_arm(path_task: PathTask) -> ParametrisedArm | None:
    """The task's arm, if it has closed-form inverse kinematics and is the whole robot.

    With further joints (fingers, a track) the task leaves more free than a roll; and almost no
    solution of the closed form satisfies joint couplings.
    """
    model = path_task.model
    if any(isinstance(c, JointCouplings) for c in path_task.constraints):
        return None
    chain = SerialChain.of(model, path_task.frame_name, path_task.frame_type)
    if len(chain.screws) != model.nv or model.nv != _HINGES:
        return None
    exact = [arm for arm in ParametrisedArm.recognise(chain) if arm.exact]
    return exact[0] if exact else None


def rolled(path_task: PathTask, index: int, rolls: Array) -> tuple[Array, Array]:
    """Poses (K, 3, 3) and (K, 3) of the frame at a waypoint with rolls (K,), if they are free."""
    waypoint = path_task.waypoints[index]
    rotations = np.tile(waypoint.rotation().as_matrix(), (len(rolls), 1, 1))
    if path_task.in_force[index].angular.kind is ProjectorKind.PLANE:
        rotations @= rotation_matrix(rolls[:, None] * RollGrid.axis(path_task, index))
    return rotations, np.tile(waypoint.translation(), (len(rolls), 1))


def roll_axis(projector: TwistProjector, rotation: Array) -> Array:
    """Axis of the roll that a projector leaves free at a rotation (3, 3), in its axes, (3,)."""
    axis = projector.angular.axis
    assert axis is not None
    return rotation.T @ axis if projector.frame == "world" else axis


class RollGrid:
    """All branches of the inverse kinematics at every roll of a grid, relative to a waypoint."""

    def __init__(
        self, path_task: PathTask, arm: ParametrisedArm, spacing: float, joints: Array
    ) -> None:
        """Lay the grid, with rolls at most ``spacing`` apart, rad.

        An interval in which a joint changes by more than ``joints`` (6,), rad, is divided: near a
        straight wrist they move faster than the roll.
        """
        self.path_task = path_task
        self.arm = arm
        self.ranges = JointRanges.of(path_task.model)
        count = max(4, int(np.ceil(TURN / spacing)))
        self.spacing = TURN / count
        self.rolls = np.linspace(0.0, TURN, count, endpoint=False)
        self._joints = joints
        self._known: dict[int, tuple[Array, bool]] = {}
        self.hard = HardConstraints(path_task, arm.chain)

    @staticmethod
    def applies(path_task: PathTask, index: int) -> bool:
        """Whether a waypoint leaves at most the roll free."""
        projector = path_task.in_force[index]
        return projector.linear.kind is ProjectorKind.FULL and projector.angular.kind in (
            ProjectorKind.FULL,
            ProjectorKind.PLANE,
        )

    @staticmethod
    def axis(path_task: PathTask, index: int) -> Array:
        """Axis of the roll at a waypoint, in the axes of the frame, (3,)."""
        rotation = path_task.waypoints[index].rotation().as_matrix()
        return roll_axis(path_task.in_force[index], rotation)

    def layer(self, index: int) -> Layer:
        """The configurations at a waypoint."""
        rolls = np.zeros(1)
        found = self._branches(index, rolls)
        if self.path_task.in_force[index].angular.kind is not ProjectorKind.FULL:
            rolls, found = self._divided(index)
        inside = self._margins(index, rolls) >= -WITHIN
        reached = np.isfinite(found).all(axis=2)
        row, branch = np.nonzero(reached & inside[:, None])
        layer = inside_limits(found[row, branch], branch, self.ranges)
        if self.hard.constraints:
            kept = self.hard.inside(layer.q, np.full(len(layer.q), index))
            layer = layer.of(kept)
        if self.hard and not len(layer.q):
            return empty_layer(found[reached], self.ranges, self.hard, index)
        return layer

    def settled(self, index: int) -> bool:
        """Whether all rolls of a waypoint are covered in spite of hard bands and constraints.

        The rolls at which bands begin and end are found; those of constraints are not.
        """
        if not self.hard or self.path_task.in_force[index].angular.kind is ProjectorKind.FULL:
            return True
        return not self.hard.constraints and self._edges(index)[1]

    def branches(self, index: int) -> Array:
        """Joint positions at the rolls of the grid, (R, B, 6), NaN where out of reach."""
        return self._branches(index, self.rolls)

    def _branches(self, index: int, rolls: Array) -> Array:
        return self.arm.branches(*rolled(self.path_task, index, rolls))

    def _divided(self, index: int) -> tuple[Array, Array]:
        """The grid, with more rolls where joints move fast and bands end: rolls and branches."""
        grid = self.branches(index)
        after = np.roll(grid, -1, axis=0)
        if self.arm.labelled:
            times = np.nan_to_num(np.abs(wound(after - grid)) / self._joints).max(axis=(1, 2))
        else:
            distance = distances(grid, after, lambda a, b: wound(b - a) / self._joints)
            there, here = np.isfinite(after[:, :, 0]), np.isfinite(grid[:, :, 0])
            times = np.maximum(
                np.where(here, distance.min(axis=2), 0.0).max(axis=1),
                np.where(there, distance.min(axis=1), 0.0).max(axis=1),
            )
        parts = np.clip(np.ceil(times), 1, FINEST).astype(int)
        number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        rolls = np.repeat(self.rolls, parts) + self.spacing * number / np.repeat(parts, parts)
        found = np.repeat(grid, parts, axis=0)
        between = number > 0
        found[between] = self._branches(index, rolls[between])
        if not self.hard.bands:
            return rolls, found
        edges, _ = self._edges(index)
        return np.append(rolls, edges), np.concatenate([found, self._branches(index, edges)])

    def _edges(self, index: int) -> tuple[Array, bool]:
        """The rolls just inside the bands' ends, and whether all others are classified.

        Intervals with one end inside are halved, and those with both ends outside until the margins
        cannot rise to 0 before their middle. So bands narrower than the grid's spacing are found,
        too.
        """
        if index in self._known:
            return self._known[index]
        width = self.spacing
        ends = np.stack([self.rolls, self.rolls + width])
        first = self._margins(index, self.rolls) >= 0.0
        inside = np.stack([first, np.roll(first, -1)])
        for _ in range(_HALVINGS):
            kept = self._open(index, ends, inside, width)
            ends, inside = ends[:, kept], inside[:, kept]
            if not 0 < ends.shape[1] < _MOST_STRETCHES:
                break
            width *= 0.5
            middle = ends[0] + width
            within = self._margins(index, middle) >= 0.0
            ends = np.hstack([[ends[0], middle], [middle, ends[1]]])
            inside = np.hstack([[inside[0], within], [within, inside[1]]])
        mixed = inside[0] != inside[1]
        edges = np.unique(np.where(inside[0], ends[0], ends[1])[mixed])
        # Next to an end of a band no interval is decided, however short.
        left = ends[0, ~mixed & self._open(index, ends, inside, width)]
        beside = np.abs(left[:, None] - edges).min(axis=1, initial=np.inf) < 3.0 * width
        self._known[index] = edges, bool(beside.all())
        return self._known[index]

    def _margins(self, index: int, rolls: Array) -> Array:
        """Least margin of the bands at some rolls, rad or m, (K,)."""
        at = np.full(len(rolls), index)
        margins = self.hard.band_margins(*rolled(self.path_task, index, rolls), at)
        least: Array = margins.min(axis=1, initial=np.inf)
        return least

    def _open(self, index: int, ends: Array, inside: Mask, width: float) -> Mask:
        """Which intervals of rolls, with ends (2, C), contain or may contain an end of a band."""
        open_: Mask = inside[0] != inside[1]
        outside = ~inside.any(axis=0)
        if outside.any():
            poses = [rolled(self.path_task, index, rolls) for rolls in ends[:, outside]]
            at = np.full(int(outside.sum()), index)
            open_[outside] = self.hard.may_keep_bands((poses[0], poses[1]), at, width)
        return open_
