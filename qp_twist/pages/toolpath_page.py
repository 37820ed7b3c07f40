"""The page of a toolpath, before there is a robot: what a file was understood to say."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.drawing.charts import Curve, small_chart
from qp_twist.drawing.figures import ShownFigure, save_figure
from qp_twist.drawing.palette import BLUE, FAINT, QUIET, RC
from qp_twist.files import LENGTHS, write_atomically
from qp_twist.pages.page import fill_template, image_html
from qp_twist.pages.recordings import DrawnLines, recorded_lines
from qp_twist.paths import Toolpath
from qp_twist.paths.toolpath import SAME_DIRECTION
from qp_twist.paths.toolpath_summary import ToolMotion, ToolpathSummary, summarize, tool_motion

_DRAWN = 20_000
"""Largest number of lines in the moving picture: with more, a browser without a graphics card takes
more than a second for each frame."""
_FRAMES = 200
"""Number of pictures of the moving tip."""
_AXES = 300
"""Largest number of tool axes that are drawn; more of them hide the path."""
_AXIS_LENGTH = 0.06
"""Length of a drawn axis, as a share of the path's largest extent."""
_COLOURS = "viridis"
"""Of feeds, from the lowest on."""
_PARTS = {"axis": "tool axes", "normal": "surface normals", "rotation": "whole orientations",
          "none": "positions only"}  # fmt: skip


def show_toolpath(toolpath: Toolpath, file: str | Path) -> Path:
    """Write a page: curves, tool axes, feeds, rapid motions, and what was assumed.

    Args:
        toolpath: From :func:`~qp_twist.read_toolpath`.
        file: The page, ``.html``; its folder is created if necessary.
    """
    motion, summary = tool_motion(toolpath), summarize(toolpath)
    facts = toolpath_facts(toolpath, summary)
    page = fill_template(
        "toolpath", file=toolpath.source.name, lead=lead(toolpath, summary),
        feeds="" if _feed_range(toolpath) is None else facts["feed"],
        ramp=", ".join(map(mpl.colors.to_hex, mpl.colormaps[_COLOURS](np.linspace(0.0, 1.0, 9)))),
        has_axes=summary.tilt is not None,
        axes="surface normals" if toolpath.meaning == "normal" else "tool axes",
        has_rapids=summary.rapids > 0.0, picture=_still(toolpath, motion),
        scene=recorded_lines(_drawn_lines(toolpath, motion), _tip(motion)),
        thinned=len(motion.positions) > _DRAWN, charts=_charts(toolpath, motion), facts=facts,
        assumptions=toolpath.assumptions, passed_over=toolpath.passed_over,
    )  # fmt: skip
    return write_atomically(Path(file), page)


def toolpath_figure(toolpath: Toolpath) -> Figure:
    """A still picture of a toolpath: cuts coloured by feed, rapid motions grey, tool axes faint."""
    return _figure(toolpath, tool_motion(toolpath))


def save_toolpath_figure(toolpath: Toolpath, path: Path) -> Path:
    """Write that picture as a PNG."""
    return save_figure(toolpath_figure(toolpath), path)


def lead(toolpath: Toolpath, summary: ToolpathSummary) -> str:
    """One line: how much there is, and of what kind."""
    curves = f"{summary.curves:,} curve{'' if summary.curves == 1 else 's'}"
    return f"{curves}, {summary.points:,} points, {_PARTS[toolpath.meaning]}"


def toolpath_facts(toolpath: Toolpath, summary: ToolpathSummary) -> dict[str, str]:
    """What there is to know of a toolpath, in the unit of its file, by name."""
    unit, scale = toolpath.unit, LENGTHS[toolpath.unit]

    def length(metres: float) -> str:
        value = metres / scale
        return f"{value:,.4g} {unit}" if value < 1e4 else f"{value:,.0f} {unit}"

    def span(low: float, high: float, digits: int, end: str) -> str:
        return f"{low:.{digits}g}{f' to {high:.{digits}g}' if high > low else ''}{end}"

    # Without what rounding leaves of zero.
    lower, upper = (np.round(corner / scale, 9) + 0.0 for corner in (summary.low, summary.high))
    sides = " × ".join(f"{side:.4g}" for side in upper - lower)
    ranges = [
        f"{n} {low:.6g} to {high:.6g}" for n, low, high in zip("xyz", lower, upper, strict=True)
    ]
    found = {
        "unit": f"{unit}, {'as the file states' if toolpath.unit_in_file else 'not in the file'}",
        "extent": f"{sides} {unit}: {', '.join(ranges)}",
        "curves": length(summary.cut) + ("" if summary.time is None else f", {summary.time:.4g} s"),
        "ways between": length(summary.rapids),
        "feed": "none in the file",
    }
    if summary.feeds is not None:
        low, high = (60.0 * feed / scale for feed in summary.feeds)
        found["feed"] = span(low, high, 4, f" {unit}/min")
    if (step := summary.longest_step) is not None:
        found["longest step"] = f"{length(step.value)}, to line {step.line}"
    if (turn := summary.largest_turn) is not None and turn.value > SAME_DIRECTION:
        found["largest turn of the axis"] = (
            f"{np.degrees(turn.value):.3g}° from a point to the next, to line {turn.line}"
        )
    if summary.tilt is not None:
        least, largest = np.degrees(summary.tilt)
        found["axis to z"] = span(least, largest if largest - least > 0.05 else least, 3, "°")
    return found


def _feed_range(toolpath: Toolpath) -> tuple[float, float] | None:
    """The feeds between which colours are chosen; ``None`` if all are the same."""
    feeds = toolpath.feeds
    return None if feeds is None or feeds[1] <= feeds[0] else feeds


def _colours(toolpath: Toolpath, motion: ToolMotion) -> Array:
    """The colour of the motion to each point, 0 to 1, (N, 3): by feed, or blue; rapids grey."""
    feeds = _feed_range(toolpath)
    colours = np.tile(mpl.colors.to_rgb(BLUE), (len(motion.feeds), 1))
    if feeds is not None:
        known = np.isfinite(motion.feeds)
        shares = (motion.feeds[known] - feeds[0]) / (feeds[1] - feeds[0])
        colours[known] = mpl.colormaps[_COLOURS](shares)[:, :3]
    colours[~motion.cut] = mpl.colors.to_rgb(QUIET)
    return colours


def _axes_drawn(motion: ToolMotion) -> Array:
    """Some of the tool axes, from the tip on, (M, 2, 3)."""
    along = np.flatnonzero(motion.cut & np.isfinite(motion.axes[:, 0]))
    some = along[:: max(1, -(-len(along) // _AXES))]
    size = _AXIS_LENGTH * float(np.ptp(motion.positions, axis=0).max())
    tips = motion.positions[some]
    return np.stack([tips, tips + size * motion.axes[some]], axis=1)


def _drawn_lines(toolpath: Toolpath, motion: ToolMotion) -> list[DrawnLines]:
    """Lines of the moving picture."""
    keep = np.unique(np.linspace(0, len(motion.positions) - 1, _DRAWN).round().astype(int))
    points, cut = motion.positions[keep], motion.cut[keep][1:]
    colours = _colours(toolpath, motion)[keep][1:]
    segments = np.stack([points[:-1], points[1:]], axis=1)
    axes = _axes_drawn(motion)
    faint = np.tile(mpl.colors.to_rgb(FAINT), (len(axes), 1))
    lines = [
        DrawnLines("rapids", segments[~cut], colours[~cut], 1.5),
        DrawnLines("curves", segments[cut], colours[cut], 4.0),
        DrawnLines("tool", axes, faint, 1.5),
    ]
    return [line for line in lines if len(line.segments)]


def _tip(motion: ToolMotion) -> Array:
    """The tip of the tool at equal distances along its way, m, (K, 3)."""
    along = np.cumsum(motion.steps)
    at = np.linspace(0.0, along[-1], _FRAMES)
    return np.column_stack([np.interp(at, along, column) for column in motion.positions.T])


def _figure(toolpath: Toolpath, motion: ToolMotion) -> Figure:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    scale = LENGTHS[toolpath.unit]
    points = motion.positions / scale
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(8.0, 5.0))
        panel: Any = figure.add_axes((0.0, 0.02, 0.9, 0.94), projection="3d")
        for line in _drawn_lines(toolpath, motion):
            panel.add_collection3d(
                Line3DCollection(
                    line.segments / scale, colors=line.colours, linewidths=0.4 * line.thickness
                )
            )
        low, high = points.min(axis=0), points.max(axis=0)
        sides = np.maximum(high - low, 0.15 * float((high - low).max()) or 1.0)
        for axis, middle, side in zip("xyz", (low + high) / 2.0, sides, strict=True):
            getattr(panel, f"set_{axis}lim")(middle - side / 2.0, middle + side / 2.0)
            getattr(panel, f"set_{axis}label")(f"{axis} [{toolpath.unit}]")
        panel.set_box_aspect(sides)
        panel.locator_params(nbins=5)
        panel.tick_params(labelsize=7)
        feeds = _feed_range(toolpath)
        if feeds is not None:
            low_feed, high_feed = (60.0 * feed / scale for feed in feeds)
            values = mpl.cm.ScalarMappable(
                mpl.colors.Normalize(low_feed, high_feed), cmap=mpl.colormaps[_COLOURS]
            )
            bar = figure.colorbar(values, cax=figure.add_axes((0.9, 0.25, 0.015, 0.5)))
            bar.set_label(f"feed [{toolpath.unit}/min]")
    return figure


def _still(toolpath: Toolpath, motion: ToolMotion) -> str:
    """The still picture as an element of the page, for print and before the moving one is there."""
    file = io.BytesIO()
    with mpl.rc_context(RC):
        _figure(toolpath, motion).savefig(file, format="png", dpi=140)
    return image_html(file.getvalue(), "png", "The curves of the toolpath in space.")


def _charts(toolpath: Toolpath, motion: ToolMotion) -> list[dict[str, str]]:
    """Feed, length of the steps and turn of the axis, over the length of the curves."""
    unit, scale = toolpath.unit, LENGTHS[toolpath.unit]
    cut = motion.cut
    along = np.cumsum(motion.steps[cut]) / scale
    charts = []
    for title, of, values, digits in (
        ("Feed", f"{unit}/min", 60.0 * motion.feeds[cut] / scale, 4),
        ("Steps", unit, motion.steps[cut] / scale, 3),
        ("Turn of the axis in a step", "°", np.degrees(motion.turns[cut]), 3),
    ):
        high = float(np.nanmax(values, initial=0.0))
        if len(values) < 2 or high <= np.nanmin(values, initial=np.inf):
            continue
        key = title.split()[0].lower()
        svg = small_chart(
            [_of_steps(along, values)], of, f"{unit} along the curves", 0.0, 1.2 * high or 1.0,
            key=key, description=f"{title} along the curves.",
        )  # fmt: skip
        number = f"up to {high:.{digits}g} {of}"
        charts.append({"key": key, "title": title, "number": number, "svg": svg})
    return charts


def _of_steps(along: Array, values: Array) -> Curve:
    """A curve of values that belong to the whole way to their points."""
    style = {"color": BLUE, "linewidth": 1.2, "drawstyle": "steps-pre"}
    return Curve(np.insert(along, 0, 0.0), np.insert(values, 0, values[0]), style)
