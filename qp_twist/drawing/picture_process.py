"""The process that draws one picture: a pickled request on its input, a PNG on its output.

The request is (model, q, lines, width, height, camera), as ``picture.py`` writes it.
"""

from __future__ import annotations

import io
import os
import pickle
import sys
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Line = tuple[Array, Sequence[float]]
"""Points, m, (N, 3), interrupted where one is not finite; and the colour, 0 to 1, (4,)."""

_MOST_PX = 4096
"""Largest size that is drawn at twice its size: OpenGL's buffers end somewhere above that."""
_RADIUS = 0.0026
"""Radius of lines, in extents of the model: about 4 mm for an arm of a metre and a half."""


class View:
    """A model seen by one camera, with lines drawn into its scene."""

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, camera: str, lines: Sequence[Line]
    ) -> None:
        self.model, self.data, self.lines = model, mujoco.MjData(model), lines
        self.camera = mujoco.MjvCamera()
        fixed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if fixed >= 0:
            self.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.camera.fixedcamid = fixed
        else:
            mujoco.mjv_defaultFreeCamera(model, self.camera)
        if not model.nlight:  # a URDF has no lights; the camera's own is dim
            model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.4, 0.6
        # Drawn at twice the size and averaged: smooth edges of shapes and shadows with any driver.
        self._factor = 2 if max(width, height) <= _MOST_PX else 1
        model.vis.quality.offsamples = 0
        width, height, frame = self._factor * width, self._factor * height, model.vis.global_
        frame.offwidth, frame.offheight = max(frame.offwidth, width), max(frame.offheight, height)
        # Beside the model's geoms: sites, tendons, lights and the like, and the lines.
        max_geom = 2 * model.ngeom + 1000 + sum(len(points) for points, _ in lines)
        self._renderer = mujoco.Renderer(model, height, width, max_geom=max_geom)

    def image(self, q: Array) -> npt.NDArray[np.float32]:
        """What is seen at a configuration, (H, W, 3) in [0, 1]; white where nothing is."""
        model, scene = self.model, self._renderer.scene
        self.data.qpos[:] = q
        mujoco.mj_fwdPosition(model, self.data)
        shown, option = mujoco.mjtCatBit.mjCAT_ALL, mujoco.MjvOption()
        mujoco.mjv_updateScene(model, self.data, option, None, self.camera, shown, scene)
        for points, rgba in self.lines:
            _add_tube(scene, points, _RADIUS * model.stat.extent, rgba)
        picture = np.asarray(self._renderer.render(), dtype=np.float32) / np.float32(255.0)
        if not (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any():
            # MuJoCo's background is black, at the far clipping plane.
            self._renderer.enable_depth_rendering()
            picture[self._renderer.render() > 0.99 * model.vis.map.zfar * model.stat.extent] = 1.0
            self._renderer.disable_depth_rendering()
        few = range(self._factor)
        samples = [picture[i :: self._factor, j :: self._factor] for i in few for j in few]
        return np.asarray(np.mean(samples, axis=0), dtype=np.float32)


def _add_tube(scene: Any, points: Array, radius: float, rgba: Sequence[float]) -> None:
    """Add a line of capsules to a mujoco.MjvScene, interrupted where a point is not finite."""
    colour = np.asarray(rgba, dtype=np.float32)
    start: Array | None = None
    for i, end in enumerate(points):
        if start is None or not np.isfinite(end).all():
            start = end if np.isfinite(end).all() else None
            continue
        # Points closer than the tube's thickness are indistinguishable, and each capsule costs
        # time.
        last = i + 1 == len(points) or not np.isfinite(points[i + 1]).all()
        length = np.linalg.norm(end - start)
        if length < 1e-9 or (length < 1.5 * radius and not last) or scene.ngeom == scene.maxgeom:
            continue
        geom, capsule = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
        mujoco.mjv_connector(geom, capsule, radius, start, end)
        geom.emission = 0.35  # its colour is its meaning: it stays red in the shadow
        geom.castshadow = False
        scene.ngeom += 1
        start = end


if __name__ == "__main__":
    from matplotlib import image as matplotlib_image

    model, q, lines, width, height, camera = pickle.load(sys.stdin.buffer)
    picture = View(model, width, height, camera, lines).image(q)
    png = io.BytesIO()
    matplotlib_image.imsave(png, picture, format="png")
    sys.stdout.buffer.write(png.getvalue())
    sys.stdout.flush()
    # The picture is complete; some drivers crash when OpenGL is taken down at exit.
    os._exit(0)
