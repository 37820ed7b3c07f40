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
    return _fitted(points, forward, fov)


def _fitted(points: Array, forward: Array, fov: float) -> Sight:
    """The nearest camera of a direction whose square picture has all points and a margin.

    In camera axes (right, up, forward) the picture has a point at depth z beyond the camera if
    ``|x|`` and ``|y|`` are at most t z, t = tan(fov/2): in each of the two directions the extreme
    points on either side bound the camera's place, and the one farther back counts.

    Args:
        points: In the world, m, (N, 3).
        forward: The camera's direction, a unit vector, (3,).
        fov: Vertical, rad.
    """
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if not right.any():
        right = np.array([0.0, 1.0, 0.0])  # from straight above or below
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    x, y, z = axes @ points.T
    t = (1.0 - _MARGIN) * np.tan(0.5 * fov)
    above = [(float((s - t * z).max()), float((-s - t * z).max())) for s in (x, y)]
    back = min(-(one + other) / (2.0 * t) for one, other in above)
    camera = axes.T @ np.array([*(0.5 * (one - other) for one, other in above), back])
    distance = max(0.5 * float(z.min() + z.max()) - back, 0.1)
    return Sight(camera + distance * forward, forward, distance, fov)


def bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Lowest and highest corner of a box around each geom, in the world, m, (G, 3) each."""
    rotations = data.geom_xmat.reshape(-1, 3, 3)
    middles = data.geom_xpos + np.einsum("gij,gj->gi", rotations, model.geom_aabb[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(rotations), model.geom_aabb[:, 3:])
    return middles - half, middles + half
