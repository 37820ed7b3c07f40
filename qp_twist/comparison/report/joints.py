"""Each joint between its limits, all methods in one figure, shown and hidden by the selector."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.comparison.joint_figure import mark_violation
from qp_twist.comparison.report.curves import draw_curves
from qp_twist.comparison.report.section import ReportSection
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.pictures.figure_html import figure_html
from qp_twist.pictures.joint_limits import draw_limits
from qp_twist.pictures.style import line_style
from qp_twist.pictures.svg import METHOD, SVG_RC, inline_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def joints_section(
    path_task: PathTask, trajectories: Mapping[str, Trajectory], numbers: Mapping[str, Any]
) -> ReportSection:
    """One panel per joint, with a cross where a method first leaves its limits."""
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
    return ReportSection("joints", "Joints between their limits", figure_html(svg, caption))


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
            mark_violation(
                panel, first, theta[first - 1], unit * ranges.middle[dof], size=(8.0, 2.0),
                gid=f"{METHOD}{name}",
            )  # fmt: skip
        steps = numbers[name]["reconfigurations"]
        if steps:
            panel.plot(
                steps, [0.0] * len(steps), "^", color=colour, ms=5, clip_on=False, zorder=6,
                transform=panel.get_xaxis_transform(), gid=f"{METHOD}{name}",
            )  # fmt: skip
    draw_limits(panel, ranges, dof, list(curves.values()))
