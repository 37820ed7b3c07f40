"""The roadmap of a run as pixels."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from qp_twist.pages.roadmap import roadmap_figure
from qp_twist.viewing.one_run import Run

_DPI = 100


def roadmap_pixels(run: Run) -> npt.NDArray[np.uint8]:
    """Picture of the roadmap with the run, (height, width, 3).

    For the present placement of the workpiece and the run's projector.
    """
    trajectory = run.trajectory
    buffer = io.BytesIO()
    roadmap_figure(trajectory.path_task, {trajectory.method: trajectory}).savefig(
        buffer, format="png", dpi=_DPI
    )
    return np.asarray(Image.open(buffer).convert("RGB"))
