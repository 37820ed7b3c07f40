"""A still picture that a notebook displays."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from qp_twist.drawing import scene_picture
from qp_twist.drawing.sight import Drawn, overview
from qp_twist.drawing.surroundings import framed
from qp_twist.errors import QpTwistError
from qp_twist.files import write_atomically


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


def picture_of(drawn: Drawn, text: str, *, width: int = 960, height: int = 720) -> Picture:
    """The robot at its start, what is around it, and the path in red.

    Args:
        drawn: The task.
        text: What it shows.
        width: px.
        height: px.

    Raises:
        QpTwistError: If there is no OpenGL; the message says what to install.
    """
    with tempfile.TemporaryDirectory() as temporary:
        scene, out = Path(temporary) / "scene.mjb", Path(temporary) / "scene.png"
        mujoco.mj_saveModel(framed(drawn), str(scene), None)
        path = np.insert(drawn.positions, drawn.joint_moves, np.nan, axis=0)  # gaps
        sentence = scene_picture.draw_scene(
            scene, [drawn.start], path, out,
            width=width, height=height, camera=overview(drawn.model),
        )  # fmt: skip
        if sentence is not None:
            raise QpTwistError(sentence)
        return Picture(out.read_bytes(), text)
