"""The recorder: a robot moving in its scene, for viser's player inside a page."""

from __future__ import annotations

import base64
import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.drawing.palette import ORANGE, RED, rgb
from qp_twist.drawing.sight import sight
from qp_twist.drawing.surroundings import coloured, floor_height, make_matte
from qp_twist.pages.near_pairs import CARRIER, LitPairs
from qp_twist.paths import PathTask, Shown, in_joint_moves

DURATION_S = 8.0
"""Playing time of a motion without times, s."""


def recorded_scene(
    path_task: PathTask,
    motions: Mapping[str, Array],
    *,
    seconds: float = DURATION_S,
    path_rgb: npt.NDArray[np.uint8] | None = None,
) -> str:
    """The :func:`recordings` of motions and the player, as elements of a page.

    The player is viser's client, a page that plays ``window.__VISER_EMBED_DATA__``. It is the same
    for all recordings and larger than they are, so a page contains it once.
    """
    return _with_player(recordings(path_task, motions, seconds=seconds, path_rgb=path_rgb))


class DrawnLines(NamedTuple):
    """Lines of a recording.

    Attributes:
        name: Of these lines.
        segments: Both ends of each, m, (M, 2, 3).
        colours: Of each, 0 to 1, (M, 3).
        thickness: In pixels.
    """

    name: str
    segments: Array
    colours: Array
    thickness: float


def recorded_lines(lines: Sequence[DrawnLines], tip: Array) -> str:
    """Lines in space, a ball that moves along them, and the player, as elements of a page.

    Args:
        lines: The lines.
        tip: The ball at equal times, m, (K, 3). The picture shows these points as large as it can.

    Its name is ``toolpath``.
    """
    low, high = tip.min(axis=0), tip.max(axis=0)
    middle, size = (low + high) / 2.0, float(np.linalg.norm(high - low)) or 1.0
    with _server() as server:
        for each in lines:
            colours = np.round(255.0 * each.colours).astype(np.uint8)
            server.scene.add_line_segments(
                f"/{each.name}",
                each.segments.astype(np.float32),
                colors=_linear(np.repeat(colours[:, None], 2, axis=1)),
                thickness=each.thickness,
                thickness_units="screen",
            )
        server.scene.add_frame(
            "/directions", axes_length=0.08 * size, axes_radius=0.002 * size, origin_radius=0.0,
            position=tuple(low.tolist()),
        )  # fmt: skip
        ball = server.scene.add_icosphere("/tip", radius=0.01 * size, color=rgb(ORANGE))
        # All of a ball around the points is seen: its radius is the sine of half the angle of view.
        server.initial_camera.fov = np.pi / 6.0
        away = 0.5 * size / np.sin(np.pi / 12.0)
        seen_from = middle + away * np.array([0.42, -0.76, 0.5])
        server.initial_camera.position = tuple(seen_from.tolist())
        server.initial_camera.look_at = tuple(middle.tolist())
        recorder = server.get_scene_serializer()
        for point in tip:
            ball.position = tuple(point.tolist())
            recorder.insert_sleep(DURATION_S / len(tip))
        return _with_player({"toolpath": base64.b64encode(recorder.serialize()).decode("ascii")})


def _with_player(found: Mapping[str, str]) -> str:
    """Recordings and viser's player, as elements of a page."""
    import viser

    data = "".join(
        f'<script type="text/plain" class="recording" data-method="{name}">{recording}</script>'
        for name, recording in found.items()
    )
    client = Path(viser.__file__).parent / "client" / "build" / "index.html"
    # Escape "</", so that nothing in the JSON script element is parsed as markup.
    player = json.dumps(client.read_text("utf-8")).replace("</", "<\\/")
    return f'{data}<script type="application/json" id="player">{player}</script>'


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
    along = ~in_joint_moves(path_task)
    if path_rgb is None:
        path_rgb = np.tile(np.array(rgb(RED), dtype=np.uint8), (len(along), 1))
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
        server.scene.add_line_segments(
            f"{CARRIER}/path",
            np.stack([points[:-1], points[1:]], axis=1)[along].astype(np.float32),
            colors=_linear(np.repeat(path_rgb[along, None], 2, axis=1)),
            thickness=5.0,
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
                    move_carrier(carrier, shown, q)
                    lit.show(q)
                recorder.insert_sleep(seconds / len(frames))
            found[name] = base64.b64encode(recorder.serialize()).decode("ascii")
    return found


def move_carrier(frame: Any, shown: Shown, q: Array) -> None:
    """Put the path's frame where its body is at a configuration q (nq,) of the task."""
    if shown.carrier is not None:
        pose = shown.carrier_pose(q)
        # Tuples of floats: a recording takes no scalars of numpy.
        frame.position = tuple(pose.translation().tolist())
        frame.wxyz = tuple(pose.rotation().wxyz.tolist())


@contextlib.contextmanager
def _server() -> Iterator[Any]:
    """A viser server that refuses every request: only a server can serialize a scene."""
    from qp_twist.pages.local_server import LocalServer

    server = LocalServer(0, names=())
    try:
        yield server
    finally:
        server.stop()


def _linear(colours: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Colours of lines as the player needs them, which takes them as linear, to show these."""
    return np.round(255.0 * (colours / 255.0) ** 2.2).astype(np.uint8)
