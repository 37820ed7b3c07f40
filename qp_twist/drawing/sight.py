"""Where a scene is seen from."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from qp_twist.checks import Array

_MARGIN = 0.08
"""Empty rim of a picture, as a share of half its height."""


class Drawn(Protocol):
    """What is drawn: a :class:`~qp_twist.PathTask`, or what has these of it."""

    @property
    def model(self) -> mujoco.MjModel:
        """The robot and what is around it."""

    @property
    def start(self) -> Array:
        """The configuration that is drawn, (nq,)."""

    @property
    def positions(self) -> Array:
        """The path in the world, m, (N, 3)."""

    @property
    def joint_moves(self) -> tuple[int, ...]:
        """Indices of the points that no path leads to."""


class Sight(NamedTuple):
    """A camera pose."""

    look_at: Array
    """m, in the world, (3,)."""
    forward: Array
    """Unit vector, (3,)."""
    distance: float
    """Distance from the camera to the point in focus, m."""
    fov: float
    """Vertical, rad."""


def overview(model: mujoco.MjModel) -> str:
    """Name of the scene's camera: the last one whose name ends in ``overview``.

    A scene that includes another one may so have its own. ``"overview"`` if there is none.
    """
    names = [str(model.camera(k).name) for k in range(model.ncam)]
    return next((name for name in reversed(names) if name.endswith("overview")), "overview")


def sight(path_task: Drawn) -> Sight:
    """The scene's camera :func:`overview`; without one, the robot at its start and the path.

    Then the direction is that of MuJoCo's free camera, and the path and everything that moves just
    fit; fixed surroundings may be as large as a hall.
    """
    model = path_task.model
    data = mujoco.MjData(model)
    data.qpos[:] = path_task.start
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)  # for cameras that track a body's centre of mass
    mujoco.mj_camlight(model, data)
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, overview(model))
    if camera >= 0:
        position, forward = data.cam_xpos[camera], -data.cam_xmat[camera].reshape(3, 3)[:, 2]
        distance = max(float(forward @ (model.stat.center - position)), 0.1)
        fov = float(np.radians(model.cam_fovy[camera]))
        return Sight(position + distance * forward, forward, distance, fov)
    view = model.vis.global_
    a, e = np.radians((view.azimuth, view.elevation))
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    moving = model.body_weldid != 0
    shapes = moving[model.geom_bodyid] & (model.geom_rbound > 0.0)
    boxes = np.stack(bounds(model, data))[:, shapes]
    corners = [boxes[[i, j, k], :, [0, 1, 2]].T for i, j, k in product((0, 1), repeat=3)]
    parents = np.setdiff1d(model.body_parentid[moving], [0])
    joints = data.xpos[[*np.flatnonzero(moving), *parents]]
    points = np.vstack([*corners, joints, path_task.positions])
    # Of an orthographic view fovy is a length.
    fov = float(np.radians(45.0 if view.orthographic else float(view.fovy)))
    # In the camera's axes, from the middle of the points, a square picture has a point beyond the
    # camera's place by z if |x| and |y| are at most z tan(fov/2).
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    axes = np.stack([right, np.cross(right, forward), forward])
    seen = points @ axes.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    x, y, z = (seen - middle).T
    across = np.maximum(np.abs(x), np.abs(y))
    distance = float((across / ((1.0 - _MARGIN) * np.tan(0.5 * fov)) - z).max())
    return Sight(axes.T @ middle, forward, max(distance, 0.1), fov)


def bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Lowest and highest corner of a box around each geom, in the world, m, (G, 3) each."""
    rotations = data.geom_xmat.reshape(-1, 3, 3)
    middles = data.geom_xpos + np.einsum("gij,gj->gi", rotations, model.geom_aabb[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(rotations), model.geom_aabb[:, 3:])
    return middles - half, middles + half
