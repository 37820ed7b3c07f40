"""A picture of the scene: the arm, the path as a red tube, traces of trajectories.

OpenGL without a screen may be missing, raise, abort or crash, depending on the machine's drivers.
The picture is therefore drawn by a separate process, which runs this file as a script: if that
fails, the caller gets a sentence instead of a picture.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Rgba = tuple[float, float, float, float]

PATH_RGBA: Rgba = (0.86, 0.07, 0.12, 1.0)
GHOST_ALPHA = 0.28
TIMEOUT_S = 60.0
MAX_DOUBLED_PX = 4096  # OpenGL's buffers end somewhere above twice this

_BAD_SCENE = 3  # exit status: the scene or its data are at fault, not OpenGL


def draw_scene(
    scene: Path,
    configurations: Sequence[npt.ArrayLike],
    path: npt.ArrayLike,
    out: Path,
    *,
    traces: Mapping[str, tuple[npt.ArrayLike, Rgba]] = {},
    width: int = 1280,
    height: int = 960,
    camera: str = "overview",
) -> str | None:
    """Draw the arm and the path into a PNG file, without a screen.

    Args:
        scene: MJCF file, or a compiled model (.mjb).
        configurations: Joint positions, each of shape (nq,) in [rad] or [m]. The first is drawn
            solid, the others as translucent ghosts.
        path: Points of the path, shape (N, 3), world frame [m]: a red tube.
        out: PNG file to write; its folder is created, an older file is replaced.
        traces: Further lines, as (points of shape (M, 3) [m], colour with alpha); the names are for
            the caller's legend. A line is interrupted where a point is not finite.
        width: Width of the picture [px].
        height: Height of the picture [px].
        camera: Camera of the scene; a scene without it is seen by MuJoCo's free camera.

    Returns:
        None when `out` is written; otherwise a sentence that says why there is no picture and what
        to install. Then there is no file at `out`: an older picture is removed.

    Raises:
        ValueError: If an array has the wrong shape.
    """
    configs = [np.asarray(q, dtype=float) for q in configurations]
    if not configs or any(q.ndim != 1 or q.shape != configs[0].shape for q in configs):
        shapes = [q.shape for q in configs]
        raise ValueError(f"configurations must be one or more arrays of shape (nq,), got {shapes}")
    lines = {"path": (_points("path", path), PATH_RGBA)}
    for name, (points, rgba) in traces.items():
        lines[f"trace {name}"] = (_points(f"trace {name!r}", points), rgba)
    if width < 1 or height < 1:
        raise ValueError(f"the picture needs a positive size, got {width} x {height}")

    out = Path(out).absolute()
    out.parent.mkdir(parents=True, exist_ok=True)
    # In the folder of `out`, since os.replace is atomic within one file system only.
    unfinished = out.with_name(f".{out.stem}-{uuid.uuid4().hex}.png")
    settings = {
        "scene": str(Path(scene).absolute()),
        "out": str(unfinished),
        "width": int(width),
        "height": int(height),
        "camera": camera,
        "colours": [[float(channel) for channel in rgba] for _, rgba in lines.values()],
    }
    arrays: dict[str, Any] = {f"line_{i}": points for i, (points, _) in enumerate(lines.values())}
    try:
        with tempfile.TemporaryDirectory(prefix="qp_twist_") as folder:
            job = Path(folder) / "job.npz"
            np.savez(job, settings=json.dumps(settings), configurations=np.stack(configs), **arrays)
            problem = _run(job)
        if problem is None:
            os.replace(unfinished, out)
        else:
            out.unlink(missing_ok=True)
    finally:
        unfinished.unlink(missing_ok=True)
    return problem


def _points(name: str, points: npt.ArrayLike) -> Array:
    """Return points as an array of shape (N, 3)."""
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    return array


def _run(job: Path) -> str | None:
    """Draw in a new process; return None or the sentence that says why there is no picture."""
    environment = dict(os.environ)
    # MuJoCo reads MUJOCO_GL once, when it is imported: too late to set it in this process.
    if sys.platform == "linux" and not environment.get("MUJOCO_GL", "").strip():
        environment["MUJOCO_GL"] = "egl"
    gl = environment.get("MUJOCO_GL", "")
    # The new process imports what this one imports, whatever the folder it starts in.
    environment["PYTHONPATH"] = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    command = [
        sys.executable,
        # As a file: `-m` would first import the package around it, which takes longer than the
        # picture. -P: the file's folder is not searched for modules.
        *("-P", __file__, str(job)),
    ]
    try:
        done = subprocess.run(
            command,
            env=environment,
            cwd=job.parent,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return _no_gl(gl, f"no picture within {TIMEOUT_S:.0f} s")
    except OSError as error:
        return f"No picture of the scene: Python could not start a process to draw it ({error})."
    if done.returncode == 0:
        return None
    output = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    reason = output[-1][:300].rstrip(".") if output else f"exit status {done.returncode}"
    if done.returncode == _BAD_SCENE:
        return f"No picture of the scene: {reason}."
    if done.returncode < 0:
        reason = f"ended by {_signal_name(-done.returncode)}"
    return _no_gl(gl, reason)


def _signal_name(number: int) -> str:
    """Return a signal's name, e.g. SIGSEGV."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _no_gl(gl: str, reason: str) -> str:
    """Return the sentence for a machine on which MuJoCo cannot draw offscreen."""
    backend = f"MUJOCO_GL={gl}" if gl else "MUJOCO_GL unset"
    advice = "On Debian/Ubuntu: apt-get install libegl1 libgl1-mesa-dri"
    if gl.lower() not in ("", "egl"):
        advice += ", and unset MUJOCO_GL"
    return (
        f"No picture of the scene: MuJoCo found no working offscreen OpenGL ({backend}: {reason}). "
        f"{advice}."
    )


# ---------------------------------------------------------------- the drawing process, from here on


class _BadSceneError(Exception):
    """The scene cannot be drawn, for a reason other than OpenGL."""


def _draw(job: Path) -> None:
    """Draw the picture that `draw_scene` described in a file."""
    import mujoco
    from matplotlib import image as matplotlib_image

    with np.load(job) as stored:
        settings: dict[str, Any] = json.loads(str(stored["settings"]))
        configurations: Array = stored["configurations"]
        lines = [(stored[f"line_{i}"], rgba) for i, rgba in enumerate(settings["colours"])]
    # Drawn at twice the size and averaged: smooth edges of shapes and shadows with any driver.
    width, height = settings["width"], settings["height"]
    factor = 2 if max(width, height) <= MAX_DOUBLED_PX else 1
    model = _load(settings["scene"], configurations.shape[1])
    if not model.nlight:  # a URDF has no lights; the camera's own is dim
        model.vis.headlight.ambient[:] = 0.4
        model.vis.headlight.diffuse[:] = 0.6
    if factor > 1:
        model.vis.quality.offsamples = 0  # the averaging replaces it
    view = _View(model, factor * width, factor * height, settings["camera"], lines)
    if view.camera.type == mujoco.mjtCamera.mjCAMERA_FREE:
        view.look_at(configurations)

    view.update(configurations[0])
    picture = view.colours()
    if not _has_sky(model):
        # MuJoCo's background is black, at the far clipping plane.
        end = 0.99 * model.vis.map.zfar * model.stat.extent
        picture[view.depth() > end] = 1.0
    if len(configurations) > 1:
        # A ghost is blended as a whole wherever it stands before the surroundings and beside the
        # solid arm. With translucent geoms, one would see the shapes that overlap inside the arm.
        margin = 1e-3 * model.stat.extent
        solid = view.depth()
        view.update(configurations[0], surroundings_only=True)
        surroundings = view.depth()
        beside = solid > surroundings - margin
        for q in configurations[1:]:
            view.update(q)
            ghost = beside & (view.depth() < surroundings - margin)
            picture[ghost] += GHOST_ALPHA * (view.colours()[ghost] - picture[ghost])
    samples = [picture[i::factor, j::factor] for i in range(factor) for j in range(factor)]
    picture = np.clip(np.mean(samples, axis=0), 0.0, 1.0)
    matplotlib_image.imsave(settings["out"], picture, format="png")


def _has_sky(model: Any) -> bool:
    import mujoco

    return bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())


def _load(scene: str, nq: int) -> Any:
    """Return the scene's mujoco.MjModel."""
    import mujoco

    try:
        compiled = scene.endswith(".mjb")
        read = mujoco.MjModel.from_binary_path if compiled else mujoco.MjModel.from_xml_path
        model = read(scene)
    except ValueError as error:
        message = " ".join(str(error).split())
        raise _BadSceneError(f"MuJoCo could not load {scene} ({message})") from error
    if nq != model.nq:
        raise _BadSceneError(
            f"{scene} has nq = {model.nq}, but the configurations have {nq} numbers"
        )
    return model


class _View:
    """A model seen by one camera, with lines drawn into its scene."""

    def __init__(
        self, model: Any, width: int, height: int, camera: str, lines: Sequence[tuple[Array, Rgba]]
    ) -> None:
        import mujoco

        self.model = model
        self.data = mujoco.MjData(model)
        self.lines = lines
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

    def look_at(self, configurations: Array) -> None:
        """Let the free camera see what joints move, and the lines, as large as there is room.

        By itself it shows the whole model, of which floor and walls may be most.
        """
        import mujoco

        model, data, seen = self.model, self.data, [points for points, _ in self.lines]
        moves = (model.body_weldid[model.geom_bodyid] > 0) & (model.geom_rbound > 0.0)
        reach = model.geom_rbound[moves, None]
        for q in configurations:
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            places = data.geom_xpos[moves]
            seen += [data.xanchor, places - reach, places + reach]
        points = np.concatenate(seen)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return
        low, high = points.min(axis=0), points.max(axis=0)
        half_angle = 0.5 * np.radians(model.vis.global_.fovy)
        self.camera.lookat[:] = 0.5 * (low + high)
        # Seen from any side the box is smaller than the ball around it.
        self.camera.distance = 0.42 * float(np.linalg.norm(high - low)) / np.sin(half_angle)

    def update(self, q: Array, *, surroundings_only: bool = False) -> None:
        """Show one configuration, or only what does not move."""
        import mujoco

        self.data.qpos[:] = q
        mujoco.mj_fwdPosition(self.model, self.data)
        category = (
            mujoco.mjtCatBit.mjCAT_STATIC if surroundings_only else mujoco.mjtCatBit.mjCAT_ALL
        )
        scene = self.renderer.scene
        option = mujoco.MjvOption()
        mujoco.mjv_updateScene(self.model, self.data, option, None, self.camera, category, scene)
        # MuJoCo's sizes follow the model's: about 4 mm for an arm of a metre and a half.
        radius = 0.0026 * self.model.stat.extent
        for i, (points, rgba) in enumerate(self.lines):
            # Traces run along the path: thinner, or the two would hide each other.
            _add_tube(scene, points, radius if i == 0 else 0.6 * radius, 1.5 * radius, rgba)

    def colours(self) -> Image:
        """Return the colours of what is seen, (H, W, 3) in [0, 1]."""
        return np.asarray(self.renderer.render(), dtype=np.float32) / np.float32(255.0)

    def depth(self) -> Image:
        """Return the distance of what is seen in each pixel, (H, W) [m]."""
        self.renderer.enable_depth_rendering()
        distance = np.array(self.renderer.render(), dtype=np.float32)
        self.renderer.disable_depth_rendering()
        return distance


def _add_tube(
    scene: Any, points: Array, radius: float, spacing: float, rgba: Sequence[float]
) -> None:
    """Add a line of capsules, at least `spacing` long, through points to a mujoco.MjvScene."""
    import mujoco

    start: Array | None = None
    for i, end in enumerate(points):
        if not np.isfinite(end).all():
            start = None
        elif start is None:
            start = end
        else:
            # Points closer than the tube's thickness are indistinguishable, and each capsule costs
            # time.
            last = i + 1 == len(points) or not np.isfinite(points[i + 1]).all()
            length = np.linalg.norm(end - start)
            if length < 1e-9 or (length < spacing and not last) or scene.ngeom == scene.maxgeom:
                continue
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_CAPSULE,
                np.zeros(3),
                np.zeros(3),
                np.eye(3).ravel(),
                np.asarray(rgba, dtype=np.float32),
            )
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
            geom.emission = 0.35  # its colour is its meaning: it stays red in the shadow
            geom.castshadow = False
            scene.ngeom += 1
            start = end


def _main(job: Path) -> int:
    """Draw one job; return the exit status."""
    try:
        _draw(job)
    except _BadSceneError as error:
        print(error, file=sys.stderr)
        return _BAD_SCENE
    return 0


if __name__ == "__main__":
    status = _main(Path(sys.argv[1]))
    sys.stderr.flush()
    # The picture is complete; some drivers crash when OpenGL is taken down at exit.
    os._exit(status)
