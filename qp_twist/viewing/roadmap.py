"""The roadmap of a lap as pixels."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from qp_twist.comparison.roadmap_figure import roadmap_figure
from qp_twist.viewing.lap import Lap

_DPI = 100


def roadmap_pixels(lap: Lap) -> npt.NDArray[np.uint8]:
    """What the limits leave of the free motion, with the lap over it, (height, width, 3).

    Where the workpiece stands now, with the projector that the lap was run with.
    """
    run = lap.trajectory
    buffer = io.BytesIO()
    roadmap_figure(run.path_task, {run.method: run}).savefig(buffer, format="png", dpi=_DPI)
    return np.asarray(Image.open(buffer).convert("RGB"))
