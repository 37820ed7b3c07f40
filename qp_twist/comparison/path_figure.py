"""z, margin and task error of all methods along the path."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.following import Trajectory
from qp_twist.paths import PathTask
from qp_twist.pictures.shown_figure import ShownFigure
from qp_twist.pictures.style import GRID, LIMIT, RC, line_style

_FLOOR = 1e-6
"""Errors below this (mm, degrees) are within the tolerances; they are drawn here."""


def path_figure(path_task: PathTask, trajectories: Mapping[str, Trajectory]) -> Figure:
    """Four panels over the waypoint index: z, smallest margin, position error, axis error."""
    with mpl.rc_context(RC):
        angular = any(t.angular.rank > 0 for t in path_task.projectors)
        figure = ShownFigure(figsize=(10.5, 9.4 if angular else 7.4), layout="constrained")
        panels = figure.subplots(4 if angular else 3, 1, sharex=True)
        largest = 0.0
        for name, trajectory in trajectories.items():
            style = line_style(name)
            index = np.arange(1, len(trajectory.q) + 1)
            margin = trajectory.margins.min(axis=1)
            panels[0].plot(index, trajectory.z, **style)
            panels[1].plot(index, margin, **style)
            panels[2].semilogy(index, np.maximum(1e3 * trajectory.position_error, _FLOOR), **style)
            if angular:
                error = np.degrees(trajectory.axis_error)
                panels[3].semilogy(index, np.maximum(error, _FLOOR), **style)
            if margin.min() >= 0.0:
                largest = max(largest, float(trajectory.z.max()))
        for segment in path_task.segments:
            begin = segment.first + 1
            for panel in panels:
                panel.axvspan(begin, begin + segment.blend, color=GRID, linewidth=1.0, zorder=0)
        panels[0].set_title("z, distance from the middle of the joint ranges (lower is better)")
        if largest:
            # Scale the panel to methods inside the limits; others may leave it.
            panels[0].set_ylim(0.0, 1.25 * largest)
        panels[1].set_title("smallest joint margin: 1 mid-range, 0 at a limit")
        panels[1].axhline(0.0, color=LIMIT, linewidth=1.2)
        panels[1].set_ylim(bottom=-0.75)
        panels[2].set_title(f"position error, mm (drawn from {_FLOOR:g} upwards)")
        if angular:
            panels[3].set_title(f"tool axis error, degrees (drawn from {_FLOOR:g} upwards)")
        panels[-1].set_xlabel("waypoint")
        panels[-1].margins(x=0.01)
        figure.suptitle(
            "Along the path (solid: QPs of this package; broken: closed forms, other libraries"
            + ("; shaded: T changes)" if path_task.segments else ")"),
            x=0.01, ha="left", fontsize=11, fontweight="bold",
        )  # fmt: skip
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure
