"""One motion in one figure: its joints against their limits, and its errors."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.pictures.joint_limits import draw_limits
from qp_twist.pictures.shown_figure import ShownFigure
from qp_twist.pictures.style import LIMIT, RC

_CURVE = "#0072B2"
_FLOOR = 1e-9
"""Smaller errors (mm, degrees) are drawn at this value."""


def joints_and_errors(
    ranges: JointRanges,
    q: Array,
    position_error: Array,
    axis_error: Array,
    tolerances: tuple[float, float],
) -> Figure:
    """Each joint between its limits over the waypoints, then both errors, logarithmic.

    Args:
        ranges: Of the joints.
        q: Configurations, (N, nq).
        position_error: m, (N,).
        axis_error: rad, (N,).
        tolerances: Largest errors that a check lets through, m and rad.
    """
    joints = [dof for dof in range(len(ranges.names)) if ranges.qpos[dof] >= 0]
    waypoints = np.arange(1, len(q) + 1)
    rows = -(-len(joints) // 2) + 1
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(9.0, 1.7 * rows), layout="constrained")
        grid = figure.subplots(rows, 2, sharex=True, squeeze=False)
        panels = list(grid[:-1].T.flat)
        positions = ranges.positions(q)
        for panel, dof in zip(panels, joints, strict=False):
            curve = positions[:, dof] * (np.degrees(1.0) if ranges.hinge[dof] else 1.0)
            panel.plot(waypoints, curve, color=_CURVE)
            draw_limits(panel, ranges, dof, [curve])
        for panel in panels[len(joints) :]:
            panel.set_visible(False)
        for panel, errors, tolerance, unit, title in zip(
            grid[-1], (1e3 * position_error, np.degrees(axis_error)),
            (1e3 * tolerances[0], np.degrees(tolerances[1])), ("mm", "degrees"),
            ("position error", "axis error"), strict=True,
        ):  # fmt: skip
            panel.semilogy(waypoints, np.maximum(errors, _FLOOR), color=_CURVE)
            panel.axhline(tolerance, color=LIMIT, linewidth=1.2)
            panel.set_title(title)
            panel.set_ylabel(unit)
            panel.set_xlabel("waypoint")
    return figure
