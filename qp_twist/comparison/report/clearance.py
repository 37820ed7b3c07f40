"""The least clearance along the path: a figure, and where each method is nearest to what."""

from __future__ import annotations

import html
from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.comparison.report.curves import draw_curves, label_ends
from qp_twist.comparison.report.section import ReportSection
from qp_twist.following import Trajectory
from qp_twist.paths import PathTask
from qp_twist.pictures.figure_html import figure_html
from qp_twist.pictures.style import GRID, LIMIT, line_style
from qp_twist.pictures.svg import METHOD, SVG_RC, inline_svg
from qp_twist.referee import POSITION_TOLERANCE

_TOUCHING = "#FBE3E3"


def clearance_section(
    path_task: PathTask, trajectories: Mapping[str, Trajectory]
) -> ReportSection | None:
    """Distance of the nearest pair at each waypoint, and the least of each method.

    ``None`` without pairs that may collide.
    """
    if not path_task.clearances:
        return None
    asked = sorted({clearance.distance for clearance in path_task.clearances})
    caption = (
        "Distance of the nearest pair at each waypoint. Red: the distance that is asked for; "
        "shaded: bodies overlap, by the depth shown. A dot marks the least distance of a method, "
        "at or between waypoints."
    )
    distances = ", ".join(f"{1e3 * distance:g}" for distance in asked)
    pairs = sum(len(clearance.pairs) for clearance in path_task.clearances)
    note = (
        f"<p>Of {pairs} pairs of geoms that may collide, each has to keep {distances} mm. "
        "Closed forms take no account of it.</p>"
    )
    drawing = inline_svg(_figure(path_task, trajectories, asked), "clearance", caption)
    body = note + figure_html(drawing, caption) + _table(trajectories)
    return ReportSection("clearance", "Clearance", body)


def _figure(
    path_task: PathTask, trajectories: Mapping[str, Trajectory], asked: list[float]
) -> Figure:
    curves = {name: 1e3 * _closest(t) for name, t in trajectories.items()}
    with mpl.rc_context(SVG_RC):
        height = max(3.0, 0.155 * len(curves) + 0.9)
        figure = Figure(figsize=(8.6, height))
        panel = figure.add_axes((0.085, 0.52 / height, 0.735, 1.0 - 0.7 / height))
        draw_curves(panel, curves)
        for name, trajectory in trajectories.items():
            near = trajectory.nearest
            if near is not None:
                colour = line_style(name)["color"]
                panel.plot(near[1].at + 1.0, 1e3 * near[1].distance, "o", color=colour, ms=4,
                           zorder=6, clip_on=False, gid=f"{METHOD}{name}")  # fmt: skip
        low, high = panel.get_ylim()
        low, high = min(low, -0.1 * high), max(high, 2e3 * asked[-1])
        panel.axhspan(low, 0.0, color=_TOUCHING, linewidth=0.0, zorder=0)
        panel.text(0.008, 0.03, "bodies overlap", color=LIMIT, fontsize=8,
                   transform=panel.transAxes)  # fmt: skip
        for distance in asked:
            panel.axhline(1e3 * distance, color=LIMIT, linewidth=1.2)
        for segment in path_task.segments:
            begin = segment.first + 1
            panel.axvspan(begin, begin + segment.blend, color=GRID, linewidth=1.0, zorder=0)
        panel.set_ylim(low, high)
        panel.set_xlim(1, len(path_task.waypoints))
        label_ends(panel, curves)
        panel.set_xlabel("waypoint")
        panel.set_ylabel("nearest pair, mm")
    return figure


def _closest(trajectory: Trajectory) -> Array:
    """Distance of the nearest pair at each waypoint, m, (N,)."""
    every = [c.closest(trajectory.q)[0] for c in trajectory.path_task.clearances]
    least: Array = np.min(every, axis=0)
    return least


def _table(trajectories: Mapping[str, Trajectory]) -> str:
    rows = ""
    for name, trajectory in trajectories.items():
        near = trajectory.nearest
        if near is None:
            continue
        clearance, (distance, at, pair) = near
        mark, words = "good", "✓ kept"
        if distance < clearance.distance - POSITION_TOLERANCE:
            mark, words = "bad", "✗ overlap" if distance < 0.0 else "✗ too near"
        rows += (
            f'<tr><th scope="row">{name}</th><td>{html.escape(pair)}</td>'
            f"<td>{_number(1e3 * distance)}</td><td>{at + 1.0:.1f}</td>"
            f'<td class="{mark}">{words}</td></tr>'
        )
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Nearest pair of each method">'
        '<table class="plain"><caption>Nearest pair of each method, at and between waypoints'
        '</caption><thead><tr><th scope="col">method</th><th scope="col">pair</th>'
        '<th scope="col">distance mm</th><th scope="col">waypoint</th>'
        f'<th scope="col">clearance</th></tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _number(value: float) -> str:
    return f"{value:.1f}".replace("-", "−")
