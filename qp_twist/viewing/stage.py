"""The 3D scene: robot, workpiece, path, the tool's trace and the two drag handles."""

from __future__ import annotations

import copy

import mink
import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene

from qp_twist.checks import Array
from qp_twist.drawing.palette import BLUE, RED, rgb
from qp_twist.drawing.sight import sight
from qp_twist.geometry import ProjectorKind
from qp_twist.pages.near_pairs import CARRIER, LitPairs, NearPair, NearPairs
from qp_twist.pages.recordings import move_carrier
from qp_twist.paths import PathTask

PATH_RGB, TRACE_RGB = rgb(RED), rgb(BLUE)
_WIDTH_PX = 4.0
_FURTHER = 1.4
"""Factor of the camera distance, since the panels leave a narrow picture."""


class Stage:
    """The scene of one task in the browser.

    Attributes:
        target: Handle at the tool; hidden until needed.
        workpiece: Handle at the workpiece, likewise.
        near: The nearest pair of geoms that may collide, in the configuration that is shown.
    """

    def __init__(self, server: viser.ViserServer, path_task: PathTask, point: Array) -> None:
        """Draw the scene.

        Args:
            server: The page's server.
            path_task: The task.
            point: The handle point (3,) of the workpiece, m.
        """
        self.server = server
        # mjviser modifies its model.
        self._shown = path_task.shown
        self.model = copy.copy(self._shown.model)
        self.data = mujoco.MjData(self.model)
        with server.atomic():
            self.scene = ViserMujocoScene(server, self.model, num_envs=1)
            self.scene.camera_tracking_enabled = False
            self.cast_shadows(False)
            seen, camera = sight(self._shown), server.initial_camera
            camera.position = seen.look_at - _FURTHER * seen.distance * seen.forward
            camera.look_at, camera.fov = seen.look_at, seen.fov
            size = 0.22 * float(self.model.stat.extent)
            axes = _movable_axes(path_task)
            # Handles and lines are in the path's frame, which moves with what carries the path.
            self._carrier = server.scene.add_frame(CARRIER, show_axes=False)
            self.target = server.scene.add_transform_controls(
                f"{CARRIER}/target", scale=size, active_axes=axes, depth_test=False, visible=False
            )
            self.workpiece = server.scene.add_transform_controls(
                f"{CARRIER}/workpiece",
                scale=1.3 * size,
                active_axes=axes,
                depth_test=False,
                visible=False,
            )
            self.workpiece.position = point
            self.waypoint = server.scene.add_frame(
                f"{CARRIER}/waypoint",
                axes_length=0.06 * float(self.model.stat.extent),
                axes_radius=0.003 * float(self.model.stat.extent),
            )
        server.on_client_connect(self._fit_upright)
        self._lit = LitPairs(server, path_task)
        self.near: NearPair | None = None
        self._fixed = np.flatnonzero(self.model.body_weldid == 0)[1:].tolist()
        self.draw_path(path_task)

    def _fit_upright(self, client: viser.ClientHandle) -> None:
        """Show the whole scene on a page that is higher than wide, above the sheet of controls.

        The field of view is vertical, and the sheet covers the lower half of such a page.
        """
        camera, seen = client.camera, sight(self._shown)
        if camera.aspect >= 1.0:
            return
        distance = _FURTHER * seen.distance / camera.aspect
        right = np.cross(seen.forward, (0.0, 0.0, 1.0))
        up = np.cross(right, seen.forward) / max(float(np.linalg.norm(right)), 1e-9)
        centre = seen.look_at - 0.5 * distance * np.tan(0.5 * seen.fov) * up
        camera.position, camera.look_at = centre - distance * seen.forward, centre

    def cast_shadows(self, cast: bool) -> None:
        """Whether lights cast shadows: without a graphics card these take seconds per picture."""
        self.server.scene.configure_default_lights(enabled=True, cast_shadow=cast)

    def show(self, q: Array) -> None:
        """Show the robot at a configuration (nq,), and light what it is near to."""
        self.data.qpos[:] = self._shown.configurations(q)
        mujoco.mj_kinematics(self.model, self.data)
        self.scene.update_from_mjdata(self.data)
        move_carrier(self._carrier, self._shown, q)
        self.near = self._lit.show(q)

    def draw_path(self, path_task: PathTask) -> None:
        """Show the path and the workpiece."""
        if path_task is not self._lit.pairs.path_task:
            self._lit.pairs = NearPairs(path_task)
        self._draw_line(f"{CARRIER}/path", path_task.positions, PATH_RGB, _WIDTH_PX)
        if self._shown.carrier is not None:  # no body of the scene moves with the path's placement
            return
        mujoco.mj_kinematics(self.model, self.data)
        place = mujoco.MjData(path_task.model)
        mujoco.mj_kinematics(path_task.model, place)
        for body in self._fixed:
            frame = self.server.scene.get_handle_by_name(f"/fixed_bodies/{self._name(body)}")
            if frame is None:  # a body without shapes
                continue
            # The shapes are children of this frame at their pose in the scene.
            moved = _pose(place, body) @ _pose(self.data, body).inverse()
            frame.position, frame.wxyz = moved.translation(), moved.rotation().wxyz

    def draw_trace(self, points: Array | None) -> None:
        """Show the tool's positions, (N, 3), beside the path."""
        if points is None:
            self.server.scene.remove_by_name(f"{CARRIER}/trace")
        else:
            self._draw_line(f"{CARRIER}/trace", points, TRACE_RGB, 0.5 * _WIDTH_PX)

    def mark(self, waypoint: mink.SE3) -> None:
        """Show the current waypoint with its axes."""
        self.waypoint.position = waypoint.translation()
        self.waypoint.wxyz = waypoint.rotation().wxyz

    def _draw_line(self, name: str, points: Array, rgb: tuple[int, int, int], px: float) -> None:
        finite = points[np.isfinite(points).all(axis=1)]
        if len(finite) < 2:
            return
        self.server.scene.add_line_segments(
            name,
            np.stack([finite[:-1], finite[1:]], axis=1).astype(np.float32),
            rgb,
            thickness=px,
            thickness_units="screen",
        )

    def _name(self, body: int) -> str:
        return self.model.body(body).name or f"body_{body}"


def _movable_axes(path_task: PathTask) -> tuple[bool, bool, bool]:
    """The axes along which a handle can be moved: those of the robot's operational space."""
    linear = path_task.operational.linear
    if linear.kind is not ProjectorKind.PLANE or linear.axis is None:
        return (True, True, True)
    x, y, z = np.abs(linear.axis) < 0.9
    return bool(x), bool(y), bool(z)


def _pose(data: mujoco.MjData, body: int) -> mink.SE3:
    rotation = mink.SO3(data.xquat[body].copy())
    return mink.SE3.from_rotation_and_translation(rotation, data.xpos[body].copy())
