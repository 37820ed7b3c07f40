"""Recordings of the arm along the path, for viser's player in the browser."""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.drawing.sight import sight
from qp_twist.drawing.surroundings import coloured, floor_height, make_matte
from qp_twist.paths import PathTask, in_joint_moves
from qp_twist.pictures.carrier import CARRIER, put
from qp_twist.pictures.lit_pairs import LitPairs

FRAMES = 100
"""Approximate number of waypoints shown."""
DURATION_S = 8.0
"""Playing time of a whole path, s."""
_PATH_RGB = (219, 18, 31)


def recordings(
    path_task: PathTask,
    motions: Mapping[str, Array],
    *,
    seconds: float = DURATION_S,
    path_rgb: npt.NDArray[np.uint8] | None = None,
) -> dict[str, str]:
    """The recording of each motion, in base64.

    Args:
        path_task: The task.
        motions: Frames by name, at equal times: configurations, (K, nq).
        seconds: Playing time of each.
        path_rgb: Colour of the path from each waypoint to the next, (N − 1, 3); red if ``None``.
    """
    import mjviser

    shown = path_task.shown
    # mjviser modifies its model.
    model = coloured(shown.model)
    path_colours: Any = _PATH_RGB
    if path_rgb is not None:
        path_colours = _linear(np.repeat(path_rgb[~in_joint_moves(path_task), None], 2, axis=1))
    with _server() as server:
        make_matte(server.scene)
        scene = mjviser.ViserMujocoScene(server, model, num_envs=1)
        scene.camera_tracking_enabled = False
        # The environment map of the sky is most of a recording's size.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)
        server.scene.add_light_ambient("/ambient", intensity=1.0)
        height = floor_height(shown)
        if height is not None:
            server.scene.add_grid(
                "/floor", infinite_grid=True, fade_distance=50.0, shadow_opacity=0.2,
                plane_opacity=0.4, position=(0.0, 0.0, height),
            )  # fmt: skip
        # What is stated in the path's frame moves with the body that carries the path.
        carrier = server.scene.add_frame(CARRIER, show_axes=False)
        points = path_task.positions
        along = ~in_joint_moves(path_task)
        segments = np.stack([points[:-1], points[1:]], axis=1)[along].astype(np.float32)
        server.scene.add_line_segments(
            f"{CARRIER}/path",
            segments,
            colors=path_colours,
            thickness=3.0 if path_rgb is None else 5.0,
            thickness_units="screen",
        )
        seen = sight(shown)
        server.initial_camera.position = tuple(seen.look_at - seen.distance * seen.forward)
        server.initial_camera.look_at = tuple(seen.look_at)
        server.initial_camera.fov = seen.fov
        data = mujoco.MjData(model)
        lit = LitPairs(server, path_task)
        found = {}
        for name, frames in motions.items():
            lit.prepare(frames)
            recorder = server.get_scene_serializer()
            for q in frames:
                data.qpos[:] = shown.configurations(q)
                mujoco.mj_kinematics(model, data)
                with server.atomic():
                    scene.update_from_mjdata(data)
                    put(carrier, shown, q)
                    lit.show(q)
                recorder.insert_sleep(seconds / len(frames))
            found[name] = base64.b64encode(recorder.serialize()).decode("ascii")
    return found


@contextlib.contextmanager
def _server() -> Iterator[Any]:
    """A viser server that refuses every request: only a server can serialize a scene."""
    from qp_twist.pictures.local_server import LocalServer

    server = LocalServer(0, names=())
    try:
        yield server
    finally:
        server.stop()


def frames_of(q: Array) -> Array:
    """Select about ``FRAMES`` configurations, the first and the last included."""
    index = np.linspace(0, len(q) - 1, min(len(q), FRAMES)).round().astype(int)
    frames: Array = q[index]
    return frames


def _linear(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Colours of lines so that the player, which takes them as linear, shows ``rgb``."""
    return np.round(255.0 * (rgb / 255.0) ** 2.2).astype(np.uint8)
