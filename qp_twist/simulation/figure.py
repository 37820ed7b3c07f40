"""The figure of a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from qp_twist.simulation.record import Record

# Okabe and Ito's palette, distinguishable with all common kinds of colour vision.
BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
LIMIT = "#D00000"


def draw(record: Record, title: str) -> Figure:
    """Errors, margin, joint speeds and scale over time, in four panels."""
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    errors, margin, speeds, scale = figure.subplots(4, 1, sharex=True)
    time = record.time
    errors.plot(time, 1e3 * record.position_error, color=BLUE, label="position, mm")
    errors.plot(time, np.degrees(record.angle_error), color=ORANGE, label="angle, degrees")
    errors.set_title("error in the rows of the task, true state", loc="left", fontsize=9)
    errors.legend(frameon=False, fontsize=8, ncols=2, loc="upper right")
    margin.plot(time, record.margin, color=GREEN)
    margin.axhline(0.0, color=LIMIT, linewidth=1.0)
    margin.set_title(
        "lowest margin of all joints (1: middle of the range, 0: limit)", loc="left", fontsize=9
    )
    speeds.step(time, record.command, where="post", linewidth=0.8)
    speeds.set_title("commanded joint velocities, rad/s or m/s", loc="left", fontsize=9)
    scale.step(time, record.scale, where="post", color=BLUE)
    scale.set_ylim(-0.05, 1.08)
    scale.set_title("scale of the task (0: no step)", loc="left", fontsize=9)
    scale.set_xlabel("time, s")
    for panel in (errors, margin, speeds, scale):
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="#DDDDDD", linewidth=0.5)
    figure.suptitle(title)
    return figure
