"""The process that draws one picture: ``python picture_process.py FOLDER``.

The folder has ``scene.mjb``, ``settings.json`` and ``arrays.npz`` (the configuration, then the
points of each line), as written by ``picture.py``; the process writes ``picture.png`` there.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

_MOST_PX = 4096
"""Largest size that is drawn at twice its size: OpenGL's buffers end somewhere above that."""
_RADIUS = 0.0026
"""Radius of lines, in extents of the model: about 4 mm for an arm of a metre and a half."""


def draw(folder: Path) -> None:
    """Draw the picture that is described in a folder."""
    from matplotlib import image as matplotlib_image

    settings: dict[str, Any] = json.loads((folder / "settings.json").read_text())
    with np.load(folder / "arrays.npz") as stored:
        configuration, *lines = (stored[name] for name in stored.files)
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    # Drawn at twice the size and averaged: smooth edges of shapes and shadows with any driver.
    width, height = settings["width"], settings["height"]
    factor = 2 if max(width, height) <= _MOST_PX else 1
    if not model.nlight:  # a URDF has no lights; the camera's own is dim
        model.vis.headlight.ambient[:] = 0.4
        model.vis.headlight.diffuse[:] = 0.6
    if factor > 1:
        model.vis.quality.offsamples = 0  # the averaging replaces it
    coloured = list(zip(lines, settings["colours"], strict=True))
    view = View(model, factor * width, factor * height, settings["camera"], coloured)
    view.update(configuration)
    picture = view.colours()
    if not (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any():
        # MuJoCo's background is black, at the far clipping plane.
        picture[view.depth() > 0.99 * model.vis.map.zfar * model.stat.extent] = 1.0
    samples = [picture[i::factor, j::factor] for i in range(factor) for j in range(factor)]
    picture = np.clip(np.mean(samples, axis=0), 0.0, 1.0)
    matplotlib_image.imsave(folder / "picture.png", picture, format="png")


class View:
    """A model seen by one camera, with lines drawn into its scene."""

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int,
        height: int,
        camera: str,
        lines: Sequence[tuple[Array, Sequence[float]]],
    ) -> None:
        self.model, self.data, self.lines = model, mujoco.MjData(model), lines
        self.camera = mujoco.MjvCamera()
        fixed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if fixed >= 0:
            self.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.camera.fixedcamid = fixed
        else:
            mujoco.mjv_defaultFreeCamera(model, self.camera)
        frame = model.vis.global_  # pictures larger than this are refused
        frame.offwidth, frame.offheight = max(frame.offwidth, width), max(frame.offheight, height)
        # Beside the model's geoms: sites, tendons, lights and the like, and the lines.
        max_geom = 2 * model.ngeom + 1000 + sum(len(points) for points, _ in lines)
        self.renderer = mujoco.Renderer(model, height, width, max_geom=max_geom)

    def update(self, q: Array) -> None:
        """Show a configuration."""
        self.data.qpos[:] = q
        mujoco.mj_fwdPosition(self.model, self.data)
        shown = mujoco.mjtCatBit.mjCAT_ALL
        scene, option = self.renderer.scene, mujoco.MjvOption()
        mujoco.mjv_updateScene(self.model, self.data, option, None, self.camera, shown, scene)
        for points, rgba in self.lines:
            _add_tube(scene, points, _RADIUS * self.model.stat.extent, rgba)

    def colours(self) -> Image:
        """Colours of what is seen, (H, W, 3) in [0, 1]."""
        return np.asarray(self.renderer.render(), dtype=np.float32) / np.float32(255.0)

    def depth(self) -> Image:
        """Distance of what is seen in each pixel, m, (H, W)."""
        self.renderer.enable_depth_rendering()
        distance = np.array(self.renderer.render(), dtype=np.float32)
        self.renderer.disable_depth_rendering()
        return distance


def _add_tube(scene: Any, points: Array, radius: float, rgba: Sequence[float]) -> None:
    """Add a line of capsules to a mujoco.MjvScene, interrupted where a point is not finite."""
    start: Array | None = None
    for i, end in enumerate(points):
        if not np.isfinite(end).all():
            start = None
            continue
        if start is None:
            start = end
            continue
        # Points closer than the tube's thickness are indistinguishable, and each capsule costs
        # time.
        last = i + 1 == len(points) or not np.isfinite(points[i + 1]).all()
        length = np.linalg.norm(end - start)
        if length < 1e-9 or (length < 1.5 * radius and not last) or scene.ngeom == scene.maxgeom:
            continue
        geom, capsule = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
        colour = np.asarray(rgba, dtype=np.float32)
        mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
        mujoco.mjv_connector(geom, capsule, radius, start, end)
        geom.emission = 0.35  # its colour is its meaning: it stays red in the shadow
        geom.castshadow = False
        scene.ngeom += 1
        start = end


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
    # The picture is complete; some drivers crash when OpenGL is taken down at exit.
    sys.stderr.flush()
    os._exit(0)
