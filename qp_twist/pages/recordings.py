"""The recorder: moving scenes, played by viser's client inside a page."""

from __future__ import annotations

import base64
import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.drawing.palette import ORANGE, RED, rgb
from qp_twist.pages.local_server import LocalServer
from qp_twist.paths import PathTask, in_joint_moves

DURATION_S = 8.0
"""Playing time of a motion without times, s."""


class DrawnLines(NamedTuple):
    """Lines by both ends, m, (M, 2, 3), with colours, 0 to 1, (M, 3), so many pixels thick."""

    name: str
    segments: Array
    colours: Array
    thickness: float


def recorded_scene(
    path_task: PathTask,
    motions: Mapping[str, Array],
    *,
    seconds: float = DURATION_S,
    path_rgb: npt.NDArray[np.uint8] | None = None,
) -> str:
    """Motions of a robot in its scene, and the player, as elements of a page.

    Motions are configurations at equal times, (K, nq), by name; ``path_rgb`` is the colour of the
    path from each waypoint to the next, (N − 1, 3), red if ``None``.
    """
    from qp_twist.pages.task_scene import CARRIER, TaskScene, add_lines

    along, points, found = ~in_joint_moves(path_task), path_task.positions, {}
    colours = np.array(rgb(RED), dtype=np.uint8) if path_rgb is None else path_rgb[along]
    with _server() as server:
        scene = TaskScene(server, path_task, recorded=True)
        segments = np.stack([points[:-1], points[1:]], axis=1)[along]
        add_lines(server, f"{CARRIER}/path", segments, colours, 5.0)
        for name, frames in motions.items():
            scene.prepare(frames)
            recorder = server.get_scene_serializer()
            for q in frames:
                with server.atomic():
                    scene.show(q)
                recorder.insert_sleep(seconds / len(frames))
            found[name] = recorder.serialize()
    return _with_player(found)


def recorded_lines(lines: Sequence[DrawnLines], tip: Array) -> str:
    """Lines, a ball at ``tip`` (K, 3) at equal times, m, and the player, as elements of a page.

    The picture shows the tip's points as large as it can; its name is ``toolpath``.
    """
    from qp_twist.pages.task_scene import add_lines

    low, high = tip.min(axis=0), tip.max(axis=0)
    middle, size = (low + high) / 2.0, float(np.linalg.norm(high - low)) or 1.0
    with _server() as server:
        for each in lines:
            colours = np.round(255.0 * each.colours).astype(np.uint8)
            add_lines(server, f"/{each.name}", each.segments, colours, each.thickness)
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
        return _with_player({"toolpath": recorder.serialize()})


def _with_player(recordings: Mapping[str, bytes]) -> str:
    """Recordings, and viser's client, a page that plays ``window.__VISER_EMBED_DATA__``.

    It is the same for all of them, and larger than they are.
    """
    import viser

    data = "".join(
        f'<script type="text/plain" class="recording" data-method="{name}">'
        f"{base64.b64encode(recording).decode('ascii')}</script>"
        for name, recording in recordings.items()
    )
    client = Path(viser.__file__).parent / "client" / "build" / "index.html"
    # Escape "</", so that nothing in the JSON script element is parsed as markup.
    player = json.dumps(client.read_text("utf-8")).replace("</", "<\\/")
    return f'{data}<script type="application/json" id="player">{player}</script>'


@contextlib.contextmanager
def _server() -> Iterator[Any]:
    """A viser server that refuses every request: only a server can serialize a scene."""
    server = LocalServer(names=())
    try:
        yield server
    finally:
        server.stop()
