"""Pairs of geoms whose distances the task prescribes, whatever the joints do."""

from __future__ import annotations

from itertools import product

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints import Clearance
from qp_twist.geometry import ProjectorKind, rotation_matrix
from qp_twist.kinematics.frame import frame_pose, welded_to
from qp_twist.paths import PathTask
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.levels import Grid
from qp_twist.planning.path_rows import REACHED
from qp_twist.planning.roll_grid import RollGrid
from qp_twist.planning.sentence import Sentence

_ROLLS, _HALVINGS = 16, 10
"""Number of rolls that are looked at first, and how often the intervals between them are halved."""
_MOST = 12
"""Number of waypoints, too near at all of these, at which all other rolls are looked at."""
_FARTHEST = 10.0
"""Larger distances of a pair are not computed, m."""


def too_near(path_task: PathTask, clearance: Clearance, grid: Grid) -> Certificate | None:
    """Waypoints at which the task alone brings a pair nearer than a clearance; ``None`` without.

    Of a pair, one geom moves with the task's frame and the other stands still. Where the task
    prescribes the frame's position and at least one axis, their distance depends on the roll about
    this axis only. It is bounded for all rolls by subdivision, and may change by the task errors
    that a check lets pass.
    """
    model = path_task.model
    welded = model.body_weldid[model.geom_bodyid[clearance.pairs]]
    still = welded == 0
    moves = ~still & (welded == welded_to(model, path_task.frame_name, path_task.frame_type))
    # A plane has no radius about the axis; MuJoCo's planes stand still, too.
    planes = model.geom_type[clearance.pairs] == mujoco.mjtGeom.mjGEOM_PLANE
    chosen = np.flatnonzero((moves & ~planes).any(axis=1) & still.any(axis=1))
    at = [k for k in range(len(path_task.waypoints)) if RollGrid.applies(path_task, k)]
    if not len(chosen) or not at:
        return None
    moving = clearance.pairs[chosen][moves[chosen]]
    tool = _Tool(path_task, clearance.pairs[chosen], moving, clearance.distance)
    half = np.pi / _ROLLS
    rolls = np.linspace(half - np.pi, np.pi - half, _ROLLS)
    open_ = [k for k in at if not any((tool.margins(k, roll) >= 0.0).all() for roll in rolls)]
    some = np.unique(np.linspace(0, len(open_) - 1, min(_MOST, len(open_))).round().astype(int))
    blocked = [open_[n] for n in some if tool.is_blocked(open_[n], rolls, half)]
    if not blocked:
        return None
    margins = [tool.margins(blocked[0], r) - tool.slack for r in np.linspace(-np.pi, np.pi, 360)]
    best = max(margins, key=min)
    pairs = tuple(f"clearance, {clearance.names[chosen[k]]}" for k in np.flatnonzero(best < 0.0))
    distance, at_first = float(best.min()) + clearance.distance, blocked[0] + 1
    note = Sentence(
        f"there the task alone decides their distance: at most {1e3 * distance:.3g} mm",
        " at waypoint ", at_first, ", whatever the roll",
    )  # fmt: skip
    return Certificate("band", grid, tuple(k + 1 for k in blocked), bands=pairs, note=note)


class _Tool:
    """The moving geoms of some pairs, at any waypoint and roll.

    ``slack`` is the change of each distance by the task errors that a check lets pass, m, (P,).
    """

    def __init__(self, path_task: PathTask, pairs: Indices, moving: Indices, asked: float) -> None:
        self._task, self._pairs, self._asked = path_task, pairs, asked
        configuration = mink.Configuration(path_task.model)
        R, p = frame_pose(configuration, path_task.frame_name, path_task.frame_type)
        self._data = data = configuration.data
        #: Pose of each moving geom in the frame.
        self._poses = {
            geom: (R.T @ data.geom_xmat[geom].reshape(3, 3), R.T @ (data.geom_xpos[geom] - p))
            for geom in np.unique(moving).tolist()
        }
        #: Corners of a box around the moving geom of each pair, in the frame, m, (P, 8, 3).
        self._corners = np.empty((len(moving), 8, 3))
        for corners, geom in zip(self._corners, moving.tolist(), strict=True):
            turned, place = self._poses[geom]
            middle, half = np.split(path_task.model.geom_aabb[geom], 2)
            corners[:] = place + (middle + half * list(product((-1.0, 1.0), repeat=3))) @ turned.T
        reach = np.linalg.norm(self._corners, axis=2).max(axis=1)
        self.slack: Array = REACHED.position + REACHED.axis * reach

    def margins(self, index: int, roll: float) -> Array:
        """Distances less the clearance, with the slack, at a roll of a waypoint, m, (P,)."""
        model, data, waypoint = self._task.model, self._data, self._task.waypoints[index]
        turn = rotation_matrix(roll * self._axis(index))
        R, p = waypoint.rotation().as_matrix() @ turn, waypoint.translation()
        for geom, (turned, place) in self._poses.items():
            data.geom_xmat[geom], data.geom_xpos[geom] = (R @ turned).ravel(), p + R @ place
        distances = [
            mujoco.mj_geomDistance(model, data, a, b, _FARTHEST, None)
            for a, b in self._pairs.tolist()
        ]
        return np.array(distances) - self._asked + self.slack

    def is_blocked(self, index: int, rolls: Array, half: float) -> bool:
        """Whether at every roll a pair is too near, proven; the rolls are ``half`` to each side."""
        beside = np.cross(self._corners, self._axis(index))
        radius = np.linalg.norm(beside, axis=2).max(axis=1)
        for _ in range(_HALVINGS):
            margins = np.array([self.margins(index, roll) for roll in rolls])
            if (margins >= 0.0).all(axis=1).any():
                return False
            left = rolls[(margins + half * radius >= 0.0).all(axis=1)]
            if not len(left):
                return True
            half *= 0.5
            rolls = np.concatenate([left - half, left + half])
        return False

    def _axis(self, index: int) -> Array:
        """The axis of the roll in the frame; any where it is prescribed, too."""
        if self._task.in_force[index].angular.kind is ProjectorKind.FULL:
            return np.array([0.0, 0.0, 1.0])
        return RollGrid.axis(self._task, index)
