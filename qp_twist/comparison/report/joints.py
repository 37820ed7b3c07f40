"""Each joint between its limits, all methods in one figure, shown and hidden by the selector."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.comparison.joint_figure import joint_view
from qp_twist.comparison.report.curves import draw_curves
from qp_twist.comparison.report.section import Section, figure_html
from qp_twist.comparison.report.svg import METHOD, SVG_RC, inline_svg
from qp_twist.comparison.style import LIMIT, line_style
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def joints_section(
    path_task: PathTask, trajectories: Mapping[str, Trajectory], numbers: Mapping[str, Any]
) -> Section:
    """One panel a joint, with a cross where a method first leaves its limits."""
    ranges = JointRanges.of(path_task.model)
    joints = [dof for dof in range(path_task.model.nv) if ranges.qpos[dof] >= 0]
    columns = 2 if len(joints) > 3 else 1
    rows = -(-len(joints) // columns)
    with mpl.rc_context(SVG_RC):
        figure = Figure(figsize=(8.6, 1.75 * rows + 0.3), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        panels = list(grid.T.flat)
        for panel, dof in zip(panels, joints, strict=False):
            _draw_joint(panel, ranges, dof, trajectories, numbers)
            panel.set_xlim(1, len(path_task.waypoints))
        for panel in panels[len(joints) :]:
            panel.set_visible(False)
        for panel in grid[-1]:
            panel.set_xlabel("waypoint")
    caption = (
        "Joint positions; the limits are the red lines. A red cross with its waypoint marks where "
        "a method first leaves a joint's limits, a triangle on the axis a step above 15°."
    )
    svg = inline_svg(figure, "joints", caption)
    return Section("joints", "Joints between their limits", figure_html(svg, caption))


def _draw_joint(
    panel: Axes,
    ranges: JointRanges,
    dof: int,
    trajectories: Mapping[str, Trajectory],
    numbers: Mapping[str, Any],
) -> None:
    unit = np.degrees(1.0) if ranges.hinge[dof] else 1.0
    curves: dict[str, Array] = {
        name: unit * ranges.positions(t.q)[:, dof] for name, t in trajectories.items()
    }
    draw_curves(panel, curves)
    for name, theta in curves.items():
        colour = line_style(name)["color"]
        first = numbers[name]["first_violation"].get(ranges.names[dof])
        if first is not None:
            panel.plot(
                first, theta[first - 1], "x", color=LIMIT, ms=8, mew=2, zorder=6,
                gid=f"{METHOD}{name}",
            )  # fmt: skip
            below = theta[first - 1] > unit * ranges.middle[dof]
            panel.annotate(
                str(first), (first, theta[first - 1]), textcoords="offset points",
                xytext=(6, -11 if below else 5), color=LIMIT, fontweight="bold",
                gid=f"{METHOD}{name}",
            )  # fmt: skip
        steps = numbers[name]["reconfigurations"]
        if steps:
            panel.plot(
                steps, [0.0] * len(steps), "^", color=colour, ms=5, clip_on=False, zorder=6,
                transform=panel.get_xaxis_transform(), gid=f"{METHOD}{name}",
            )  # fmt: skip
    if ranges.limited[dof]:
        lower, upper = unit * ranges.lower[dof], unit * ranges.upper[dof]
        low, high = joint_view(lower, upper, list(curves.values()))
        panel.set_ylim(low, high)
        for edge, limit in ((low, lower), (high, upper)):
            panel.axhline(limit, color=LIMIT, linewidth=1.2)
            panel.axhspan(edge, limit, color=LIMIT, alpha=0.07, linewidth=0)
    panel.set_title(ranges.names[dof])
    panel.set_ylabel("degrees" if ranges.hinge[dof] else "m")
