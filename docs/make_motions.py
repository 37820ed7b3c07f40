"""Draw moving pictures of two public problems, for docs/plan.md.

    MUJOCO_GL=egl python docs/make_motions.py --cppflow DIR --jrl DIR [--plans DIR] [--out FOLDER]

DIR are the checkouts that benchmarks/cartesian_paths.py reads; ``--plans`` is a folder that it has
written, so that nothing is planned again. Needs OpenGL without a screen. About half a minute.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from cartesian_paths import STEP_DEG, Problem, read_problem

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.drawing.palette import RED, rgb
from qp_twist.drawing.picture_process import View

DOCS = Path(__file__).parent
VIEWS = {"panda__2cubes": (150.0, -18.0, 1.7), "fetch__hello": (-60.0, -20.0, 2.4)}
"""Azimuth and elevation of the camera, degrees, and its distance, m."""
WIDTH, HEIGHT, FRAMES, SECONDS = 360, 300, 60, 6.0
_COLOURS = 32
_ROBOT, _BOX = (0.55, 0.62, 0.70, 1.0), (0.93, 0.68, 0.28, 1.0)


def main() -> None:
    """Write PROBLEM.gif for each of the two."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for folder in ("cppflow", "jrl"):
        parser.add_argument(f"--{folder}", type=Path, required=True)
    parser.add_argument("--plans", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=DOCS / "figures")
    given = parser.parse_args()
    for name in VIEWS:
        problem = read_problem(given.cppflow, given.jrl, name)
        if given.plans is None:
            q = qt.plan(problem.task, "travel", max_step_deg=STEP_DEG).motion()
        else:
            q = np.loadtxt(given.plans / f"{name}.csv", delimiter=",")
        file = given.out / f"{name}.gif"
        draw(problem, q, file)
        print(f"wrote {file}: {file.stat().st_size // 1000} kB")


def draw(problem: Problem, q: Array, file: Path) -> None:
    """The motion q (N, nq) from the first pose to the last, on white."""
    model, path = problem.task.model, problem.task.positions
    for geom in range(model.ngeom):
        boxed = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        model.geom_rgba[geom] = _BOX if boxed else _ROBOT
    light = model.vis.headlight
    light.ambient[:], light.diffuse[:], light.specular[:] = 0.45, 0.6, 0.1
    red = [*(channel / 255.0 for channel in rgb(RED)), 1.0]
    view = View(model, WIDTH, HEIGHT, "", [(path, red)])
    azimuth, elevation, distance = VIEWS[problem.task.name]
    view.camera.azimuth, view.camera.elevation, view.camera.distance = azimuth, elevation, distance
    view.camera.lookat[:] = 0.5 * (path.mean(axis=0) + np.array([0.0, 0.0, 0.4]))
    frames = []
    for k in np.linspace(0, len(q) - 1, FRAMES).round().astype(int):
        frames.append(Image.fromarray((255.0 * view.image(q[k])).astype(np.uint8)))
    palette = _palette([frames[0], frames[-1]])
    few = [frame.quantize(_COLOURS, palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(
        file,
        save_all=True,
        append_images=few[1:],
        duration=int(1e3 * SECONDS / FRAMES),
        loop=0,
        optimize=True,
    )


def _palette(frames: list[Image.Image]) -> Image.Image:
    """Few colours for all frames; the path's is among them, which has few pixels."""
    sheet = Image.new("RGB", (WIDTH, (len(frames) + 1) * HEIGHT), rgb(RED))
    for k, frame in enumerate(frames):
        sheet.paste(frame, (0, k * HEIGHT))
    return sheet.quantize(_COLOURS)


if __name__ == "__main__":
    main()
