"""Task error, z, margin and singular values along the path: one figure each."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import matplotlib as mpl
import mink
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.comparison.joint_speeds import OVER, has_speed_limits, peak_speed, speed_shares
from qp_twist.comparison.report.curves import draw_curves, label_ends
from qp_twist.comparison.report.section import ReportSection
from qp_twist.following import Trajectory
from qp_twist.kinematics import frame_jacobian
from qp_twist.paths import PathTask
from qp_twist.pictures.figure_html import figure_html
from qp_twist.pictures.style import GRID, LIMIT
from qp_twist.pictures.svg import SVG_RC, inline_svg

_FLOOR = 1e-6
"""Smaller errors (mm, degrees) are drawn at this value: they are within the tolerances."""

Trajectories = Mapping[str, Trajectory]
View = Callable[[mpl.axes.Axes], None]


def error_section(path_task: PathTask, trajectories: Trajectories) -> ReportSection:
    """Position and axis error on a logarithmic scale."""
    body = _figure(
        path_task, "error-position",
        {n: np.maximum(1e3 * t.position_error, _FLOOR) for n, t in trajectories.items()},
        "position error, mm", "Position error at each waypoint, logarithmic.", scale="log",
    )  # fmt: skip
    if any(t.angular.rank > 0 for t in path_task.projectors):
        body += _figure(
            path_task, "error-axis",
            {n: np.maximum(np.degrees(t.axis_error), _FLOOR) for n, t in trajectories.items()},
            "orientation error, degrees",
            "Orientation error at each waypoint, in the rows of the task only, logarithmic.",
            scale="log",
        )  # fmt: skip
    note = (
        "<p>Task error after the iterations of each waypoint. Values below "
        f"{_FLOOR:g} mm or ° are drawn at the bottom.</p>"
    )
    return ReportSection("error", "Task error", note + body)


def centring_section(path_task: PathTask, trajectories: Trajectories) -> ReportSection:
    """z, and the smallest joint margin."""
    z = {name: t.z for name, t in trajectories.items()}
    margins = {name: t.margins.min(axis=1, initial=np.inf) for name, t in trajectories.items()}
    if not all(np.isfinite(m).all() for m in margins.values()):
        return ReportSection(
            "z", "z and margin", "<p>No joint has limits: there is nothing to show.</p>"
        )
    inside = [float(z[n].max()) for n, m in margins.items() if m.min() >= 0.0]
    top = 1.15 * max(inside) if inside and max(inside) > 0.0 else None

    def view_z(panel: mpl.axes.Axes) -> None:
        # Scale the panel to methods inside the limits; others may leave it.
        panel.set_ylim(0.0, top)

    def view_margin(panel: mpl.axes.Axes) -> None:
        panel.axhline(0.0, color=LIMIT, linewidth=1.2)
        panel.set_ylim(bottom=max(panel.get_ylim()[0], -0.5), top=1.0)

    body = _figure(
        path_task, "z", z, "z", "z at each waypoint; lower is better. A line that leaves the "
        "panel at the top belongs to a method that left the limits.", view=view_z,
    ) + _figure(
        path_task, "margin", margins, "smallest margin of any joint",
        "Smallest joint margin at each waypoint; below the red line at 0 a joint is outside.",
        view=view_margin,
    )  # fmt: skip
    note = (
        "<p>z = ½‖W(θ̄ − θ)‖² measures how far the joints are from the middle of their ranges. The "
        "margin is 1 in the middle of a range, 0 at a limit and negative outside.</p>"
    )
    return ReportSection("z", "z and margin", note + body)


def singular_section(path_task: PathTask, trajectories: Trajectories) -> ReportSection:
    """σ_min of the task rows, and of all operational rows."""
    whole = {name: _whole_sigma(t) for name, t in trajectories.items()}
    task = {name: t.sigma_min for name, t in trajectories.items()}

    def view(panel: mpl.axes.Axes) -> None:
        panel.set_ylim(bottom=0.0)

    body = _figure(
        path_task, "sigma-task", task, "σ min of TJ",
        "Smallest singular value of the task's rows UᵀJ, with T = UUᵀ, at each waypoint.",
        view=view,
    ) + _figure(
        path_task, "sigma-whole", whole, "σ min of J",
        "Smallest singular value of all operational rows of J, at each waypoint.", view=view,
    )  # fmt: skip
    note = (
        "<p>Near 0 a small motion of the tool needs large joint speeds. The first figure concerns "
        "methods that invert only the task's rows, the second those that invert all of J. Linear "
        "rows (m) and angular rows (rad) are not weighted against each other.</p>"
    )
    return ReportSection("sigma", "Singular values of TJ and J", note + body)


def speed_section(path_task: PathTask, trajectories: Trajectories) -> ReportSection:
    """The fastest joint, as a share of its limit."""
    title = "Joint speeds over their limits"
    if not has_speed_limits(path_task):
        missing = "no feed" if path_task.durations is None else "no joint speed limits"
        return ReportSection(
            "speed", title, f"<p>The task has {missing}: there is nothing to show.</p>"
        )
    shares = {name: speed_shares(t).max(axis=1) for name, t in trajectories.items()}

    def view(panel: mpl.axes.Axes) -> None:
        panel.axhline(1.0, color=LIMIT, linewidth=1.2)
        low = min(float(s[1:].min(initial=1.0)) for s in shares.values())
        panel.set_ylim(bottom=max(0.5 * low, 1e-3), top=max(2.0, panel.get_ylim()[1]))

    drawn = {name: np.maximum(s, 1e-6) for name, s in shares.items()}
    body = _figure(
        path_task, "speed", drawn, "speed ÷ limit, fastest joint",
        "Speed of the fastest joint between waypoints over its limit, logarithmic; above the red "
        "line at 1 it is too fast.", scale="log", view=view,
    )  # fmt: skip
    rows = ""
    for name, trajectory in trajectories.items():
        peak = peak_speed(trajectory)
        if peak is not None:
            mark = "✗ too fast" if peak.share > OVER else "✓"
            rows += (
                f'<tr><th scope="row">{name}</th><td>{peak.joint}</td><td>{peak.waypoint}</td>'
                f"<td>{100.0 * peak.share:.3g} %</td><td>{mark}</td></tr>"
            )
    table = (
        '<div class="scroll" tabindex="0" role="region" aria-label="Fastest joint of each method">'
        '<table class="plain"><caption>Fastest joint of each method</caption><thead><tr>'
        '<th scope="col">method</th><th scope="col">joint</th><th scope="col">waypoint</th>'
        '<th scope="col">speed ÷ limit</th><th scope="col">within limit</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )
    note = "<p>At the task's feed; mean speed from the previous waypoint.</p>"
    return ReportSection("speed", title, note + body + table)


def _figure(
    path_task: PathTask,
    key: str,
    curves: Mapping[str, Array],
    label: str,
    caption: str,
    *,
    scale: str = "linear",
    view: View | None = None,
) -> str:
    with mpl.rc_context(SVG_RC):
        height = max(2.6, 0.155 * len(curves) + 0.9)
        figure = Figure(figsize=(8.6, height))
        panel = figure.add_axes((0.085, 0.52 / height, 0.735, 1.0 - 0.7 / height))
        panel.set_yscale(scale)
        draw_curves(panel, curves)
        for segment in path_task.segments:
            begin = segment.first + 1
            panel.axvspan(begin, begin + segment.blend, color=GRID, linewidth=1.0, zorder=0)
        if view is not None:
            view(panel)
        panel.set_xlim(1, len(path_task.waypoints))
        label_ends(panel, curves)
        panel.set_xlabel("waypoint")
        panel.set_ylabel(label)
    if path_task.segments:
        caption += " Shaded: T changes."
    return figure_html(inline_svg(figure, key, caption), caption)


def _whole_sigma(trajectory: Trajectory) -> Array:
    """Smallest singular value of the operational rows of J at each waypoint, (N,)."""
    task = trajectory.path_task
    configuration = mink.Configuration(task.model)
    sigma = np.empty(len(trajectory.q))
    for index, q in enumerate(trajectory.q):
        configuration.update(q)
        jacobian = frame_jacobian(configuration, task.frame_name, task.frame_type)
        # T_O is fixed to the base: its axes are those of the world.
        rows = task.operational.basis.T @ jacobian
        sigma[index] = np.linalg.svd(rows, compute_uv=False)[-1]
    return sigma
