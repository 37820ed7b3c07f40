"""Pairs of geoms whose distances the task prescribes, whatever the joints do."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices
from qp_twist.constraints import Clearance
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics.frame import frame_pose, welded_to
from qp_twist.paths import PathTask
from qp_twist.planning.path_rows import REACHED
from qp_twist.planning.roll_grid import RollGrid

_ROLLS, _HALVINGS = 16, 10
"""Number of rolls that are looked at first, and how often the intervals between them are halved."""
_MOST = 12
"""Number of waypoints, too near at all of these, at which all other rolls are looked at."""


class TooNear(NamedTuple):
    """Waypoints at which a pair is too near at every roll."""

    waypoints: tuple[int, ...]
    """Some of them, from 0."""
    pairs: tuple[str, ...]
    """The pairs that are too near at the roll of the largest distance that was found."""
    distance: float
    """That distance, at the first of the waypoints, m."""


def too_near(path_task: PathTask, clearance: Clearance) -> TooNear | None:
    """Where the task alone brings a pair nearer than a clearance; ``None`` if nowhere.

    Of a pair, one geom moves with the task's frame and the other stands still. Where the task
    prescribes the frame's position and at least one axis, their distance depends on the roll about
    this axis only. It is bounded for all rolls by subdivision, and may change by the task errors
    that a check lets pass.
    """
    carrier = _carriers(path_task)[clearance.pairs]
    # A plane has no radius about the axis; MuJoCo's planes stand still, too.
    planes = path_task.model.geom_type[clearance.pairs] == mujoco.mjtGeom.mjGEOM_PLANE
    moving_plane = (planes & (carrier == 1)).any(axis=1)
    between = (carrier.min(axis=1) == 0) & (carrier.max(axis=1) == 1)
    chosen = np.flatnonzero(between & ~moving_plane)
    at = [k for k in range(len(path_task.waypoints)) if RollGrid.applies(path_task, k)]
    if not len(chosen) or not at:
        return None
    axis = _axis(path_task, at[0])
    at = [k for k in at if np.allclose(_axis(path_task, k), axis, atol=1e-12)]
    copy = _Copy(path_task, axis, clearance, clearance.pairs[chosen])
    blocked = _blocked(copy, path_task, np.array(at))
    if not len(blocked):
        return None
    margins = copy.margins(path_task, blocked[:1].repeat(360), np.linspace(-np.pi, np.pi, 360))
    best = int(np.argmax(margins.min(axis=1)))
    pairs = tuple(clearance.names[chosen[k]] for k in np.flatnonzero(margins[best] < 0.0))
    distance = float(margins[best].min()) + clearance.distance
    return TooNear(tuple(int(k) for k in blocked), pairs, distance)


def _blocked(copy: _Copy, path_task: PathTask, at: Indices) -> Indices:
    """Some of the waypoints ``at`` which no roll keeps all pairs apart."""
    half = np.pi / _ROLLS
    some = half * (2.0 * np.arange(_ROLLS) + 1.0) - np.pi
    rolls, where = np.tile(some, len(at)), np.repeat(at, _ROLLS)
    for halving in range(_HALVINGS):
        margins = copy.margins(path_task, where, rolls) + copy.slack
        at = np.setdiff1d(at, where[(margins >= 0.0).all(axis=1)])
        if not halving and len(at):
            at = at[np.unique(np.linspace(0, len(at) - 1, _MOST).round().astype(int))]
        may = (margins + half * copy.radius >= 0.0).all(axis=1) & np.isin(where, at)
        half *= 0.5
        where = np.repeat(where[may], 2)
        rolls = (rolls[may, None] + half * np.array([-1.0, 1.0])).ravel()
        if not len(where):
            break
    return np.setdiff1d(at, where)


class _Copy:
    """The geoms of the pairs, on a body that stands at any pose and rolls about an axis.

    Attributes:
        radius: Largest distance from the axis of the moving geom of each pair, m, (P,).
        slack: Change of each distance by the task errors that a check lets pass, m, (P,).
    """

    def __init__(
        self, path_task: PathTask, axis: Array, clearance: Clearance, pairs: Indices
    ) -> None:
        model, carrier = path_task.model, _carriers(path_task)
        configuration = mink.Configuration(model)
        R, p = frame_pose(configuration, path_task.frame_name, path_task.frame_type)
        data = configuration.data
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        token = {"mass": 1.0, "inertia": np.ones(3), "explicitinertial": True}
        waypoint = spec.worldbody.add_body(name="waypoint", **token)
        for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            for unit in np.eye(3):
                waypoint.add_joint(type=kind, axis=unit)
        frame = waypoint.add_body(name="frame", **token)
        frame.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        for geom in np.unique(pairs).tolist():
            turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            if carrier[geom] == 1:
                turn, place = R.T @ turn, R.T @ (place - p)
            _add(spec, frame if carrier[geom] == 1 else spec.worldbody, model, geom, turn, place)
        made = spec.compile()
        own = np.array([[made.geom(f"g{geom}").id for geom in pair] for pair in pairs])
        self._clearance = Clearance(made, clearance.distance, pairs=own)
        moving = np.where(made.geom_bodyid[own[:, 0]] > 0, own[:, 0], own[:, 1])
        corners = np.array([_corners(made, int(geom)) for geom in moving])
        self.radius: Array = np.linalg.norm(np.cross(corners, axis), axis=2).max(axis=1)
        reach = np.linalg.norm(corners, axis=2).max(axis=1)
        self.slack: Array = REACHED.position + REACHED.axis * reach

    def margins(self, path_task: PathTask, at: Indices, rolls: Array) -> Array:
        """Margins of the pairs at rolls (K,) of waypoints (K,), m, (K, P)."""
        turns = np.array([path_task.waypoints[k].rotation().as_matrix() for k in at])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of several angles for one rotation any is right
            angles = Rotation.from_matrix(turns).as_euler("XYZ")
        q = np.column_stack([path_task.positions[at], angles, rolls])
        return self._clearance.bounded(q, float(self.slack.max(initial=0.0)))


def _add(
    spec: mujoco.MjSpec, on: mujoco.MjsBody, model: mujoco.MjModel, geom: int, R: Array, p: Array
) -> None:
    """Add a geom of a model to a body of another one, at a pose there."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R).ravel())
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    added = on.add_geom(name=f"g{geom}", type=kind, pos=p, quat=quat, size=model.geom_size[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        name = f"m{geom}"
        spec.add_mesh(
            name=name,
            uservert=model.mesh_vert[first : first + count].ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        added.meshname = name


def _corners(model: mujoco.MjModel, geom: int) -> Array:
    """Corners of a box around a geom, in the axes of its body, m, (8, 3)."""
    center, half = np.split(model.geom_aabb[geom], 2)
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    corners: Array = model.geom_pos[geom] + (center + signs * half) @ turn.reshape(3, 3).T
    return corners


def _carriers(path_task: PathTask) -> Indices:
    """Of each geom: 1 if it moves with the task's frame, 0 if it stands still, else 2."""
    model = path_task.model
    welded = model.body_weldid[model.geom_bodyid]
    own = welded_to(model, path_task.frame_name, path_task.frame_type)
    return np.where(welded == 0, 0, np.where(welded == own, 1, 2))


def _axis(path_task: PathTask, index: int) -> Array:
    """The axis of the roll in the frame; any where it is prescribed, too."""
    if path_task.in_force[index].angular.kind is ProjectorKind.FULL:
        return np.array([0.0, 0.0, 1.0])
    return RollGrid.axis(path_task, index)
