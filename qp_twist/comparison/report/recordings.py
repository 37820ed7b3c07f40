"""Recordings of the arm along the path, one per method, for viser's player in the browser."""

from __future__ import annotations

import base64
import contextlib
import copy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.comparison.lit_pairs import LitPairs
from qp_twist.comparison.sight import sight
from qp_twist.following import Trajectory
from qp_twist.paths import PathTask

FRAMES = 100
"""Approximate number of waypoints shown."""
DURATION_S = 8.0
"""Playing time of a whole path, s."""
_PATH_RGB = (219, 18, 31)


def player() -> str:
    """viser's client, a page that plays ``window.__VISER_EMBED_DATA__``.

    It is the same for all methods and larger than their recordings, so the report contains it once.
    """
    import viser

    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    return page.read_text("utf-8")


def recordings(path_task: PathTask, trajectories: Mapping[str, Trajectory]) -> dict[str, str]:
    """The recording of each method, in base64."""
    import mjviser

    # mjviser modifies its model.
    model = copy.copy(path_task.model)
    with _server() as server:
        scene = mjviser.ViserMujocoScene(server, model, num_envs=1)
        scene.camera_tracking_enabled = False
        # The environment map of the sky is most of a recording's size.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)
        server.scene.add_light_ambient("/ambient", intensity=1.0)
        points = path_task.positions
        server.scene.add_line_segments(
            "/path",
            np.stack([points[:-1], points[1:]], axis=1).astype(np.float32),
            colors=_PATH_RGB,
            thickness=3.0,
            thickness_units="screen",
        )
        seen = sight(path_task)
        server.initial_camera.position = tuple(seen.look_at - seen.distance * seen.forward)
        server.initial_camera.look_at = tuple(seen.look_at)
        server.initial_camera.fov = seen.fov
        data = mujoco.MjData(model)
        lit = LitPairs(server, path_task)
        found = {}
        for name, trajectory in trajectories.items():
            frames = _frames(trajectory.q)
            lit.prepare(frames)
            recorder = server.get_scene_serializer()
            for q in frames:
                data.qpos[:] = q
                mujoco.mj_kinematics(model, data)
                with server.atomic():
                    scene.update_from_mjdata(data)
                    lit.show(q)
                recorder.insert_sleep(DURATION_S / len(frames))
            found[name] = base64.b64encode(recorder.serialize()).decode("ascii")
    return found


@contextlib.contextmanager
def _server() -> Iterator[Any]:
    """A viser server that refuses every request: only a server can serialize a scene."""
    from qp_twist.comparison.local_server import LocalServer

    server = LocalServer(0, names=())
    try:
        yield server
    finally:
        server.stop()


def _frames(q: Array) -> Array:
    """Select about ``FRAMES`` configurations, the first and the last included."""
    index = np.linspace(0, len(q) - 1, min(len(q), FRAMES)).round().astype(int)
    frames: Array = q[index]
    return frames
