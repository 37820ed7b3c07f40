"""The 3D scene: robot, workpiece, path, the tool's trace and the two drag handles."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import viser

from qp_twist.checks import Array
from qp_twist.drawing.palette import BLUE, RED, rgb
from qp_twist.drawing.sight import sight
from qp_twist.pages.task_scene import CARRIER, TaskScene, add_lines
from qp_twist.paths import PathTask

_WIDTH_PX = 4.0
_FURTHER = 1.4
"""Factor of the camera distance, since the panels leave a narrow picture."""


class Stage:
    """The scene of one task in the browser.

    Handles and lines are in the path's frame, which moves with the body that carries the path.

    Attributes:
        server: The page's server.
        scene: The robot and its surroundings.
        target: Handle at the tool; hidden until needed.
        workpiece: Handle at the workpiece, likewise.
        waypoint: The axes of a waypoint.
    """

    def __init__(self, server: viser.ViserServer, path_task: PathTask, point: Array) -> None:
        """Draw the scene; the workpiece's handle is at a point (3,), m."""
        self.server = server
        with server.atomic():
            self.scene = TaskScene(server, path_task, recorded=False)
            self._sight, camera = sight(self.scene.shown), server.initial_camera
            away = _FURTHER * self._sight.distance * self._sight.forward
            camera.position = self._sight.look_at - away
            extent = float(self.scene.model.stat.extent)
            self.target, self.workpiece = (
                server.scene.add_transform_controls(
                    f"{CARRIER}/{name}", scale=size * extent, depth_test=False, visible=False
                )
                for name, size in (("target", 0.22), ("workpiece", 0.29))
            )
            self.workpiece.position = point
            self.waypoint = server.scene.add_frame(
                f"{CARRIER}/waypoint", axes_length=0.06 * extent, axes_radius=0.003 * extent
            )
        server.on_client_connect(self._fit_upright)
        self.draw_path(path_task)

    def _fit_upright(self, client: viser.ClientHandle) -> None:
        """Show the whole scene on a page that is higher than wide, above the sheet of controls.

        The field of view is vertical, and the sheet covers the lower half of such a page.
        """
        camera, seen = client.camera, self._sight
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

    def draw_path(self, path_task: PathTask) -> None:
        """Show the path and the workpiece at their place in a task."""
        scene = self.scene
        scene.place(path_task)
        self._draw_line("path", path_task.positions, RED, _WIDTH_PX)
        if scene.shown.carrier is not None:  # no body of the scene moves with the path's placement
            return
        mujoco.mj_kinematics(scene.model, scene.data)
        place = mujoco.MjData(path_task.model)
        mujoco.mj_kinematics(path_task.model, place)
        for body in np.flatnonzero(scene.model.body_weldid == 0)[1:].tolist():
            name = scene.model.body(body).name or f"body_{body}"
            frame = self.server.scene.get_handle_by_name(f"/fixed_bodies/{name}")
            if frame is None:  # a body without shapes
                continue
            # The shapes are children of this frame at their pose in the scene.
            moved = _pose(place, body) @ _pose(scene.data, body).inverse()
            frame.position, frame.wxyz = moved.translation(), moved.rotation().wxyz

    def draw_trace(self, points: Array | None) -> None:
        """Show the tool's positions, (N, 3), beside the path."""
        if points is None:
            self.server.scene.remove_by_name(f"{CARRIER}/trace")
        else:
            self._draw_line("trace", points, BLUE, 0.5 * _WIDTH_PX)

    def mark(self, waypoint: mink.SE3) -> None:
        """Show the current waypoint with its axes."""
        self.waypoint.position = waypoint.translation()
        self.waypoint.wxyz = waypoint.rotation().wxyz

    def _draw_line(self, name: str, points: Array, colour: str, pixels: float) -> None:
        if len(points) > 1:
            segments = np.stack([points[:-1], points[1:]], axis=1)
            rgb_255 = np.array(rgb(colour), dtype=np.uint8)
            add_lines(self.server, f"{CARRIER}/{name}", segments, rgb_255, pixels)


def _pose(data: mujoco.MjData, body: int) -> mink.SE3:
    rotation = mink.SO3(data.xquat[body].copy())
    return mink.SE3.from_rotation_and_translation(rotation, data.xpos[body].copy())
