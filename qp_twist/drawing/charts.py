"""Charts: curves with their limits, alone or one for each joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array, Indices
from qp_twist.drawing.figures import ShownFigure
from qp_twist.drawing.palette import BLUE, GRID, RC, RED
from qp_twist.kinematics import JointRanges

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 240
"""Approximate number of points of a curve."""
_FLOOR = 1e-9
"""Smaller errors (mm, degrees) are drawn at this value."""


class Curve(NamedTuple):
    """A curve and its style.

    Attributes:
        x: (N,), ascending.
        y: (N,).
        style: Matplotlib's keywords of a line.
    """

    x: Array
    y: Array
    style: Mapping[str, Any]

    @classmethod
    def of(cls, y: Array, style: Mapping[str, Any]) -> Curve:
        """A curve over the waypoints, counted from 1."""
        return cls(np.arange(1.0, len(y) + 1.0), y, style)


def draw_chart(
    panel: Axes,
    curves: Sequence[Curve],
    *,
    limits: Sequence[float] = (),
    shaded: Sequence[tuple[float, float]] = (),
    log: bool = False,
    bottom: float | None = None,
    top: float | None = None,
) -> None:
    """Draw curves into a panel, limits as red lines, and grey stretches behind them.

    Args:
        panel: The panel.
        curves: The curves, the upper ones last.
        limits: Heights of the red lines.
        shaded: Begin and end of each stretch.
        log: Whether the vertical axis is logarithmic.
        bottom: Lower end of the vertical axis; that of the curves if ``None``.
        top: Its upper end, likewise.
    """
    for begin, end in shaded:
        panel.axvspan(begin, end, color=GRID, linewidth=1.0, zorder=0)
    for x, y, style in curves:
        index = thinned(y)
        panel.plot(x[index], y[index], **style)
    panel.margins(x=0.0)
    if log:
        panel.set_yscale("log")
    for limit in limits:
        panel.axhline(limit, color=RED, linewidth=1.2)
    panel.set_ylim(bottom, top)


def thinned(y: Array) -> Indices:
    """Indices of about ``_POINTS`` points of a curve (N,): of each few the least and the largest.

    A curve through them has its ends and its extremes.
    """
    count = len(y)
    if count <= _POINTS:
        return np.arange(count)
    edges = np.linspace(0, count, _POINTS // 2 + 1).astype(np.intp)
    extremes = [
        begin + place
        for begin, end in pairwise(edges)
        for place in (np.argmin(y[begin:end]), np.argmax(y[begin:end]))
    ]
    return np.unique([0, *extremes, count - 1])


def draw_joint(panel: Axes, ranges: JointRanges, dof: int, curves: Sequence[Curve]) -> None:
    """One joint's curves (rad or m) between its limits in red, the outside shaded; name and unit.

    The axis has the limits with a margin; it is larger if a curve leaves them, but not by more than
    half the range.
    """
    unit = np.degrees(1.0) if ranges.hinge[dof] else 1.0
    curves = [curve._replace(y=unit * curve.y) for curve in curves]
    panel.set_title(ranges.names[dof])
    panel.set_ylabel("degrees" if ranges.hinge[dof] else "m")
    if not ranges.limited[dof]:
        draw_chart(panel, curves)
        return
    limits = unit * ranges.lower[dof], unit * ranges.upper[dof]
    width, seen = limits[1] - limits[0], np.concatenate([curve.y for curve in curves])
    low = np.clip(seen.min() - 0.05 * width, limits[0] - 0.5 * width, limits[0] - 0.08 * width)
    high = np.clip(seen.max() + 0.05 * width, limits[1] + 0.08 * width, limits[1] + 0.5 * width)
    draw_chart(panel, curves, limits=limits, bottom=float(low), top=float(high))
    for edge, limit in zip((low, high), limits, strict=True):
        panel.axhspan(edge, limit, color=RED, alpha=0.07, linewidth=0)


def joint_panels(
    figure: Figure, ranges: JointRanges, below: int = 0
) -> tuple[dict[int, Axes], Any]:
    """A panel for each joint, by its index, down the columns; and all panels of the figure.

    Args:
        figure: An empty figure.
        ranges: Of the joints.
        below: Number of rows of two more panels below them.
    """
    joints = [dof for dof in range(len(ranges.names)) if ranges.qpos[dof] >= 0]
    columns = 2 if len(joints) > 3 or below else 1
    rows = -(-len(joints) // columns)
    grid = figure.subplots(rows + below, columns, sharex=True, squeeze=False)
    # Down the columns, as in the paper: joints 1 to 3 at the left, 4 to 6 at the right.
    panels = list(grid[:rows].T.flat)
    for panel in panels[len(joints) :]:
        panel.set_visible(False)
    for panel in grid[-1]:
        panel.set_xlabel("waypoint")
    return dict(zip(joints, panels, strict=False)), grid


def run_figure(
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
    style = {"color": BLUE}
    rows = -(-sum(ranges.qpos >= 0) // 2) + 1
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(9.0, 1.7 * rows), layout="constrained")
        panels, grid = joint_panels(figure, ranges, below=1)
        positions = ranges.positions(q)
        for dof, panel in panels.items():
            draw_joint(panel, ranges, dof, [Curve.of(positions[:, dof], style)])
        for panel, errors, tolerance, unit, title in zip(
            grid[-1], (1e3 * position_error, np.degrees(axis_error)),
            (1e3 * tolerances[0], np.degrees(tolerances[1])), ("mm", "degrees"),
            ("position error", "axis error"), strict=True,
        ):  # fmt: skip
            curve = Curve.of(np.maximum(errors, _FLOOR), style)
            draw_chart(panel, [curve], limits=[tolerance], log=True)
            panel.set_title(title)
            panel.set_ylabel(unit)
    return figure
