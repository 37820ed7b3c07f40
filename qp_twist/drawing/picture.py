"""A still picture of a scene: the robot, what is around it, and lines.

OpenGL without a screen may be missing, raise, abort or crash, depending on the machine's drivers.
The picture is therefore drawn by a process of its own (``picture_process.py``): if that fails, the
caller gets a sentence instead of a picture.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.drawing.palette import RED, rgb
from qp_twist.drawing.sight import Drawn, overview
from qp_twist.drawing.surroundings import framed
from qp_twist.errors import QpTwistError
from qp_twist.files import write_atomically

TIMEOUT_S = 60.0
Line = tuple[npt.ArrayLike, str]
"""Points in the world, m, (N, 3), interrupted where one is not finite; and their colour."""


class NoPicture(QpTwistError):
    """There is no picture; the message says why, and what to install."""


@dataclass(frozen=True)
class Picture:
    """A picture in a notebook, and as a file.

    Attributes:
        png: The picture, a PNG file.
        text: What it shows.
    """

    png: bytes
    text: str

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: str | Path) -> Path:
        """Write the PNG file, under a temporary name first."""
        return write_atomically(Path(path), self.png)

    def __repr__(self) -> str:
        return f"Picture({self.text!r}, {len(self.png)} bytes)"


def picture_of(
    drawn: Drawn,
    text: str,
    *,
    lines: Sequence[Line] | None = None,
    width: int = 960,
    height: int = 720,
) -> Picture:
    """The robot at its start, what is around it, and the path in red, or other lines.

    ``text`` says what it shows; the size is in px.

    Raises:
        NoPicture: If there is no OpenGL; the message says what to install.
    """
    if lines is None:
        lines = [(np.insert(drawn.positions, drawn.joint_moves, np.nan, axis=0), RED)]
    camera = overview(drawn.model)
    png = draw_scene(framed(drawn), drawn.start, lines, width=width, height=height, camera=camera)
    return Picture(png, text)


def draw_scene(
    model: mujoco.MjModel,
    configuration: npt.ArrayLike,
    lines: Sequence[Line] = (),
    *,
    width: int = 1280,
    height: int = 960,
    camera: str = "overview",
) -> bytes:
    """Draw a configuration (nq,) of a scene without a screen, with lines as tubes; the PNG file.

    If the scene has no such camera, it is MuJoCo's free one.

    Raises:
        NoPicture: If there is no OpenGL; the message says what to install.
    """
    tubes = [
        (np.asarray(points, dtype=np.float64), [*(c / 255.0 for c in rgb(colour)), 1.0])
        for points, colour in lines
    ]
    request = (model, np.asarray(configuration, dtype=np.float64), tubes, width, height, camera)
    environment = dict(os.environ)
    # MuJoCo reads MUJOCO_GL once, when it is imported: too late to set it in this process.
    if sys.platform == "linux" and not environment.get("MUJOCO_GL", "").strip():
        environment["MUJOCO_GL"] = "egl"
    environment["PYTHONPATH"] = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    # As a file: `-m` would first import the package around it, which takes longer than the
    # picture. -P: the file's folder is not searched for modules.
    script = Path(__file__).with_name("picture_process.py")
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)], input=pickle.dumps(request), env=environment,
            capture_output=True, timeout=TIMEOUT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        reason = f"no picture within {TIMEOUT_S:.0f} s"
    else:
        if done.returncode == 0:
            return done.stdout
        said = done.stderr.decode(errors="replace").strip().splitlines()
        reason = said[-1].strip()[:300].rstrip(".") if said else f"exit status {done.returncode}"
        if done.returncode < 0:
            reason = f"ended by {signal.strsignal(-done.returncode)}"
    gl = environment.get("MUJOCO_GL", "")
    unset = "" if gl.lower() in ("", "egl") else ", and unset MUJOCO_GL"
    raise NoPicture(
        f"No picture of the scene: MuJoCo found no working offscreen OpenGL (MUJOCO_GL={gl}: "
        f"{reason}). On Debian/Ubuntu: apt-get install libegl1 libgl1-mesa-dri{unset}."
    )
