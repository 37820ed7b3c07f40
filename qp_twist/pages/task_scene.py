"""A task in a viser scene, for the players of reports and for the live page."""

from __future__ import annotations

from typing import Any

import mjviser
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.drawing.palette import ORANGE, RED, rgb
from qp_twist.drawing.sight import sight
from qp_twist.drawing.surroundings import coloured, floor_height, make_matte
from qp_twist.pages.near_pairs import NearPair, near_geoms, nearest_pair, shape_over
from qp_twist.paths import PathTask

CARRIER = "/carrier"
"""Name of the scene's frame that moves with the body that carries the path, its children in it."""
_OPACITY = 0.55
"""Of the shapes over geoms that are near each other."""


class TaskScene:
    """The robot and what is around it; geoms near each other are orange, red if too near.

    Attributes:
        shown: The scene as it stands.
        model: Its model.
        data: Its state.
        path_task: The task; see :meth:`place`.
        near: The pair with the least margin in the configuration that is shown.
    """

    def __init__(self, server: Any, path_task: PathTask, *, recorded: bool) -> None:
        """Draw it in the scene of a viser server, with shadows if it is recorded."""
        self.server = server
        self.shown = path_task.shown
        self.model = coloured(self.shown.model)  # a copy, which mjviser modifies
        self.data = mujoco.MjData(self.model)
        self.near: NearPair | None = None
        self._shapes: dict[int, Any] = {}
        make_matte(server.scene)
        self._robot = mjviser.ViserMujocoScene(server, self.model, num_envs=1)
        self._robot.camera_tracking_enabled = False
        server.scene.configure_default_lights(enabled=True, cast_shadow=recorded)
        if recorded:  # the environment map of the sky would be most of a recording's size
            server.scene.configure_environment_map(None)
            server.scene.add_light_ambient("/ambient", intensity=1.0)
        height = floor_height(self.shown)
        if height is not None:
            server.scene.add_grid(
                "/floor", infinite_grid=True, fade_distance=50.0, shadow_opacity=0.2,
                plane_opacity=0.4, position=(0.0, 0.0, height),
            )  # fmt: skip
        self._carrier = server.scene.add_frame(CARRIER, show_axes=False)
        seen, camera = sight(self.shown), server.initial_camera
        camera.position = tuple(seen.look_at - seen.distance * seen.forward)
        camera.look_at, camera.fov = tuple(seen.look_at), seen.fov
        self.place(path_task)

    def place(self, path_task: PathTask) -> None:
        """Take distances from a task with the same geoms, whose surroundings are elsewhere."""
        self.path_task = path_task
        self._geoms = mujoco.MjData(path_task.model)

    def show(self, q: Array) -> None:
        """Show a configuration q (nq,) of the task."""
        self.data.qpos[:] = self.shown.configurations(q)
        mujoco.mj_kinematics(self.model, self.data)
        self._robot.update_from_mjdata(self.data)
        if self.shown.carrier is not None:
            pose = self.shown.carrier_pose(q)
            # Tuples of floats: a recording takes no scalars of numpy.
            self._carrier.position = tuple(pose.translation().tolist())
            self._carrier.wxyz = tuple(pose.rotation().wxyz.tolist())
        self.near = nearest_pair(self.path_task, q)
        self._light(q)

    def prepare(self, q: Array) -> None:
        """Make all shapes that q (N, nq) will light, hidden: a recording begins with these."""
        for geom in near_geoms(self.path_task, q):
            self._shape(geom)
        for shape in filter(None, self._shapes.values()):
            shape.visible = False

    def _light(self, q: Array) -> None:
        lit, geoms = near_geoms(self.path_task, q[None]), self._geoms
        geoms.qpos[:] = q
        mujoco.mj_kinematics(self.path_task.model, geoms)
        for geom in {*lit, *self._shapes}:
            shape = self._shape(geom)
            if shape is None:
                continue
            _set(shape, "visible", geom in lit)
            if geom in lit:
                _set(shape, "color", rgb(RED if lit[geom] else ORANGE))
                wxyz = np.empty(4)
                mujoco.mju_mat2Quat(wxyz, geoms.geom_xmat[geom])
                shape.position, shape.wxyz = geoms.geom_xpos[geom], wxyz

    def _shape(self, geom: int) -> Any:
        if geom not in self._shapes:
            over = shape_over(self.path_task.model, geom)
            self._shapes[geom] = over and self.server.scene.add_mesh_simple(
                f"{CARRIER}/near/{geom}", *over, color=rgb(ORANGE), opacity=_OPACITY,
                cast_shadow=False, receive_shadow=False, visible=False,
            )  # fmt: skip
        return self._shapes[geom]


def add_lines(
    server: Any, name: str, segments: Array, colours: npt.NDArray[np.uint8], pixels: float
) -> None:
    """Draw lines by both ends, m, (M, 2, 3), in colours of each or of all, (M, 3) or (3,)."""
    # The player takes colours of lines as linear.
    linear = np.round(255.0 * (np.asarray(colours) / 255.0) ** 2.2).astype(np.uint8)
    server.scene.add_line_segments(
        name,
        segments.astype(np.float32),
        colors=np.broadcast_to(linear[..., None, :], (len(segments), 2, 3)),
        thickness=pixels,
        thickness_units="screen",
    )


def _set(handle: Any, name: str, value: object) -> None:
    """Set a property only if it changes: each one is a message."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
