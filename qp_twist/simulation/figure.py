"""The figure of a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qp_twist.control import ServoState
from qp_twist.pictures.shown_figure import ShownFigure

if TYPE_CHECKING:
    from qp_twist.simulation.record import Record

# Okabe and Ito's palette, distinguishable with all common kinds of colour vision.
BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
LIMIT = "#D00000"


def draw(record: Record, title: str) -> Figure:
    """Errors, margin, joint speeds and scale over time, in four panels; a servo's states below."""
    fed = any(state is not None for state in record.states)
    figure = ShownFigure(figsize=(8.0, 8.6 if fed else 7.0), layout="constrained")
    errors, margin, speeds, scale, *more = figure.subplots(4 + fed, 1, sharex=True)
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
    for panel in more:
        _draw_states(panel, record)
    (more or [scale])[-1].set_xlabel("time, s")
    for panel in (errors, margin, speeds, scale, *more):
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="#DDDDDD", linewidth=0.5)
    figure.suptitle(title)
    return figure


def _draw_states(panel: Axes, record: Record) -> None:
    """A bar for each stretch of time in a state."""
    names = [state.name.lower().replace("_", " ") for state in ServoState]
    places = np.array([-1 if s is None else list(ServoState).index(s) for s in record.states])
    starts = np.flatnonzero(np.diff(places, prepend=-2))
    for start, end in zip(starts, [*starts[1:], len(places)], strict=True):
        place = int(places[start])
        if place >= 0:
            span = record.time[start], (end - start) * record.period
            panel.broken_barh([span], (place - 0.4, 0.8), color=BLUE, zorder=3)
    panel.set_yticks(range(len(names)), names, fontsize=8)
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.set_title("what the servo is doing", loc="left", fontsize=9)
