"""Charts: curves with their limits, alone or one for each joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.drawing.figures import SVG_RC, ShownFigure, inline_svg
from qp_twist.drawing.palette import BLUE, GRID, INK, RC, RED
from qp_twist.kinematics import JointRanges

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FLOOR = 1e-9
"""Smaller errors (mm, degrees) are drawn at this value."""
_SMALL: Any = SVG_RC | {
    "font.size": 7.5, "axes.linewidth": 0.6, "axes.edgecolor": INK, "axes.grid": False,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5,
    "ytick.major.size": 2.5, "xtick.major.pad": 2.0, "ytick.major.pad": 2.0,
}  # fmt: skip


class Curve(NamedTuple):
    """A curve, x ascending, and Matplotlib's keywords of its line."""

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

    The ends of the vertical axis are those of the curves where they are ``None``.
    """
    for begin, end in shaded:
        panel.axvspan(begin, end, color=GRID, linewidth=1.0, zorder=0)
    for x, y, style in curves:
        panel.plot(x, y, **style)
    panel.margins(x=0.0)
    if log:
        panel.set_yscale("log")
    for limit in limits:
        panel.axhline(limit, color=RED, linewidth=1.2)
    panel.set_ylim(bottom, top)


def small_chart(
    curves: Sequence[Curve],
    unit: str,
    x_label: str,
    bottom: float,
    top: float,
    *,
    key: str,
    description: str,
    x_range: tuple[float, float] | None = None,
    limit: float | None = None,
    shaded: Sequence[tuple[float, float]] = (),
) -> str:
    """A chart that stands with others in a page, as an ``<svg>`` element.

    The unit stands above the vertical axis, from ``bottom`` to ``top``; ``key`` begins the ids in
    it, and ``description`` is for readers who do not see it.
    """
    with mpl.rc_context(_SMALL):
        figure = Figure(figsize=(3.6, 1.55))
        panel = figure.add_axes((0.115, 0.2, 0.87, 0.66))
        limits = [] if limit is None else [limit]
        draw_chart(panel, curves, limits=limits, shaded=shaded, bottom=bottom, top=top)
        if x_range is not None:
            panel.set_xlim(*x_range)
        panel.text(0.0, 1.05, unit, transform=panel.transAxes)
        if limits:
            panel.text(1.0, 1.05, "— limit", transform=panel.transAxes, ha="right", color=RED)
        panel.set_xlabel(x_label, labelpad=1.0)
        panel.xaxis.set_label_coords(1.0, -0.16)
        panel.xaxis.label.set_horizontalalignment("right" if len(x_label) > 8 else "center")
        panel.locator_params(axis="y", nbins=4)
        panel.locator_params(axis="x", nbins=6)
    return inline_svg(figure, key, description)


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

    ``below`` is the number of rows of two more panels below them.
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

    Configurations (N, nq), errors (N,) and the tolerances of a check in m and rad.
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
