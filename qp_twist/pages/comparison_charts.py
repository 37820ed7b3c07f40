"""Charts of several methods on one path."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import mink
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qp_twist.checks import Array
from qp_twist.drawing.charts import draw_chart, draw_joint, joint_panels
from qp_twist.drawing.figures import METHOD, SVG_RC, ShownFigure, inline_svg
from qp_twist.drawing.palette import RC, RED
from qp_twist.following import Trajectory
from qp_twist.following.joint_speeds import has_speed_limits, speed_shares
from qp_twist.kinematics import JointRanges, frame_jacobian
from qp_twist.pages.method_style import entitle, line_style, method_curves, method_handles
from qp_twist.pages.page import figure_html
from qp_twist.paths import METHODS, PathTask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FLOOR = 1e-6
"""Smaller errors (mm, degrees) are drawn at this value: they are within the tolerances."""
_TOUCHING = "#FBE3E3"

Trajectories = Mapping[str, Trajectory]
Metrics = Mapping[str, Mapping[str, Any]]
"""The metrics of each method, as in ``comparison.json``."""


class Quantity(NamedTuple):
    """A quantity of each method along the path."""

    key: str
    label: str
    caption: str
    values: dict[str, Array]
    """At each waypoint, (N,)."""
    limits: Sequence[float] = ()
    log: bool = False
    bottom: float | None = None
    top: float | None = None


def quantities(path_task: PathTask, trajectories: Trajectories) -> dict[str, list[Quantity]]:
    """What is drawn along the path, by the section of the page; a section may be empty."""
    return {
        "error": _errors(path_task, trajectories),
        "clearance": _clearances(path_task, trajectories) if path_task.clearances else [],
        "z": _centering(trajectories),
        "sigma": [
            Quantity("sigma-task", "σ min of TJ", "Smallest singular value of the task's rows "
                     "UᵀJ, with T = UUᵀ, at each waypoint.",
                     {name: t.sigma_min for name, t in trajectories.items()}, bottom=0.0),
            Quantity("sigma-whole", "σ min of J", "Smallest singular value of all operational "
                     "rows of J, at each waypoint.",
                     {name: _whole_sigma(t) for name, t in trajectories.items()}, bottom=0.0),
        ],
        "speed": _speeds(trajectories) if has_speed_limits(path_task) else [],
    }  # fmt: skip


def _errors(path_task: PathTask, trajectories: Trajectories) -> list[Quantity]:
    """Position error and, if the task holds an angle, orientation error."""
    position = {n: np.maximum(1e3 * t.position_error, FLOOR) for n, t in trajectories.items()}
    axis = {n: np.maximum(np.degrees(t.axis_error), FLOOR) for n, t in trajectories.items()}
    words = "error at each waypoint, in the rows of the task only, logarithmic."
    found = [
        Quantity("error-position", "position error, mm", f"Position {words}", position, log=True),
        Quantity("error-axis", "orientation error, °", f"Orientation {words}", axis, log=True),
    ]
    angular = any(t.angular.rank > 0 for t in path_task.projectors)
    return found if angular else found[:1]


def _centering(trajectories: Trajectories) -> list[Quantity]:
    """z, and the smallest joint margin; nothing if no joint has limits."""
    z = {name: t.z for name, t in trajectories.items()}
    margins = {name: t.margins.min(axis=1, initial=np.inf) for name, t in trajectories.items()}
    if not all(np.isfinite(m).all() for m in margins.values()):
        return []
    # Scaled to methods inside the limits; others may leave the panel.
    inside = max((float(z[n].max()) for n, m in margins.items() if m.min() >= 0.0), default=0.0)
    least = min(float(m.min()) for m in margins.values())
    return [
        Quantity(
            "z", "z", "z at each waypoint; lower is better. A line that leaves the panel at the "
            "top belongs to a method that left the limits.", z, bottom=0.0,
            top=1.15 * inside if inside else None,
        ),
        Quantity(
            "margin", "smallest margin of any joint",
            "Smallest joint margin at each waypoint; below the red line at 0 a joint is outside.",
            margins, limits=[0.0], bottom=max(min(least, 0.0) - 0.05, -0.5), top=1.0,
        ),
    ]  # fmt: skip


def _whole_sigma(trajectory: Trajectory) -> Array:
    """Smallest singular value of the operational rows of J at each waypoint, (N,)."""
    task = trajectory.path_task
    configuration, rows = mink.Configuration(task.model), []
    for q in trajectory.q:
        configuration.update(q)
        jacobian = frame_jacobian(configuration, task.frame_name, task.frame_type)
        # T_O is fixed to the base: its axes are those of the world.
        rows.append(task.operational.basis.T @ jacobian)
    return np.linalg.svd(np.stack(rows), compute_uv=False)[:, -1]


def _speeds(trajectories: Trajectories) -> list[Quantity]:
    """Speed of the fastest joint, as a share of its limit."""
    shares = {name: speed_shares(t).max(axis=1) for name, t in trajectories.items()}
    low = min(float(s[1:].min(initial=1.0)) for s in shares.values())
    high = max(float(s.max()) for s in shares.values())
    return [Quantity(
        "speed", "speed ÷ limit, fastest joint",
        "Speed of the fastest joint between waypoints over its limit, logarithmic; above the red "
        "line at 1 it is too fast.", {name: np.maximum(s, 1e-6) for name, s in shares.items()},
        limits=[1.0], log=True, bottom=max(0.5 * low, 1e-3), top=max(2.0, 1.3 * high),
    )]  # fmt: skip


def _clearances(path_task: PathTask, trajectories: Trajectories) -> list[Quantity]:
    """Distance of the nearest pair that may collide, mm."""
    asked = sorted({1e3 * clearance.distance for clearance in path_task.clearances})
    values = {
        name: 1e3 * np.min([c.closest(t.q)[0] for c in t.path_task.clearances], axis=0)
        for name, t in trajectories.items()
    }
    least = min(float(v.min()) for v in values.values())
    high = max(*(1.05 * float(v.max()) for v in values.values()), 2.0 * asked[-1])
    return [Quantity(
        "clearance", "nearest pair, mm",
        "Distance of the nearest pair at each waypoint. Red: the distance that is asked for; "
        "shaded: bodies overlap, by the depth shown. A dot marks the least distance of a method, "
        "at or between waypoints.", values, limits=asked,
        bottom=min(1.05 * least, -0.1 * high), top=high,
    )]  # fmt: skip


def quantity_html(path_task: PathTask, trajectories: Trajectories, quantity: Quantity) -> str:
    """The chart of a quantity."""
    with mpl.rc_context(SVG_RC):
        figure = Figure(figsize=(8.6, 2.7))
        panel = figure.add_axes((0.085, 0.18, 0.905, 0.77))
        _draw_quantity(panel, path_task, quantity)
        if quantity.key == "clearance":
            panel.axhspan(panel.get_ylim()[0], 0.0, color=_TOUCHING, linewidth=0.0, zorder=0)
            panel.text(0.008, 0.03, "bodies overlap", color=RED, fontsize=8,
                       transform=panel.transAxes)  # fmt: skip
            for name, trajectory in trajectories.items():
                if trajectory.nearest is not None:
                    near = trajectory.nearest[1]
                    panel.plot(near.at + 1.0, 1e3 * near.distance, "o", ms=4, zorder=6,
                               color=line_style(name)["color"], clip_on=False,
                               gid=f"{METHOD}{name}")  # fmt: skip
        panel.set_xlabel("waypoint")
        panel.set_ylabel(quantity.label)
    caption = quantity.caption + (" Shaded: T changes." if path_task.segments else "")
    return figure_html(inline_svg(figure, quantity.key, caption), caption)


def path_figure(path_task: PathTask, trajectories: Trajectories) -> Figure:
    """z, smallest margin and the task errors over the waypoint index, a panel each."""
    drawn = _centering(trajectories) + _errors(path_task, trajectories)
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(10.5, 2.0 * len(drawn) + 1.4))
        panels = figure.subplots(len(drawn), 1, sharex=True, squeeze=False)[:, 0]
        for panel, quantity in zip(panels, drawn, strict=True):
            _draw_quantity(panel, path_task, quantity)
            panel.set_title(quantity.label)
        panels[-1].set_xlabel("waypoint")
        shaded = "; shaded: T changes" if path_task.segments else ""
        title = (
            "Along the path (solid: QPs of this package; broken: closed forms, other "
            f"libraries{shaded})"
        )
        entitle(figure, title, method_handles(trajectories))
    return figure


def _draw_quantity(panel: Axes, path_task: PathTask, quantity: Quantity) -> None:
    blends = [(s.first + 1.0, s.first + 1.0 + s.blend) for s in path_task.segments]
    draw_chart(
        panel, method_curves(quantity.values), limits=quantity.limits, shaded=blends,
        log=quantity.log, bottom=quantity.bottom, top=quantity.top,
    )  # fmt: skip
    panel.set_xlim(1, len(path_task.waypoints))


def joint_figures(
    path_task: PathTask, trajectories: Trajectories, numbers: Metrics
) -> dict[str, Figure]:
    """The paper's figure (``joints``) and one for each QP with its closed forms."""
    title = "Joint positions between their limits: "
    groups = {"joints": (["twa", "rmr"], f"{title}twist decomposition and resolved motion rate")}
    for name, method in METHODS.items():
        if method.constrained and name in trajectories:
            pair = [n for n, m in METHODS.items() if m.counterpart == name and n in trajectories]
            names = [*pair, name]
            groups[f"joints_{name}"] = (names, title + ", ".join(reversed(names)))
    return {
        key: joint_figure(path_task, found, numbers, title)
        for key, (names, title) in groups.items()
        if (found := {n: trajectories[n] for n in names if n in trajectories})
    }


def joint_figure(
    path_task: PathTask, trajectories: Trajectories, numbers: Metrics, title: str = ""
) -> Figure:
    """One panel per joint: limits in red, violations and reconfigurations marked.

    A red cross marks a joint's first waypoint outside its limits, a triangle on the axis a
    waypoint that was reached by a step above 15° in some joint. Without a title it has no legend
    either, and is as wide as a page.
    """
    ranges = JointRanges.of(path_task.model)
    positions = {name: ranges.positions(t.q) for name, t in trajectories.items()}
    joints = int((ranges.qpos >= 0).sum())
    rows = -(-joints // 2) if joints > 3 else joints
    with mpl.rc_context(RC if title else SVG_RC):
        size = (10.5, 2.0 * rows + 1.1) if title else (8.6, 1.75 * rows + 0.3)
        figure = ShownFigure(figsize=size, layout=None if title else "constrained")
        for dof, panel in joint_panels(figure, ranges)[0].items():
            curves = {name: q[:, dof] for name, q in positions.items()}
            draw_joint(panel, ranges, dof, method_curves(curves))
            panel.set_xlim(1, len(path_task.waypoints))
            _mark_joint(panel, ranges, dof, curves, numbers)
        if title:
            entitle(figure, title, [*method_handles(trajectories), *_marks(trajectories, numbers)])
    return figure


def _mark_joint(
    panel: Axes, ranges: JointRanges, dof: int, curves: Mapping[str, Array], numbers: Metrics
) -> None:
    """First violations, and waypoints reached by large steps."""
    unit = np.degrees(1.0) if ranges.hinge[dof] else 1.0
    for name, theta in curves.items():
        gid = f"{METHOD}{name}"
        first = numbers[name]["first_violation"].get(ranges.names[dof])
        if first is not None:
            at = (first, unit * theta[first - 1])
            panel.plot(*at, "x", color=RED, ms=8, mew=2, zorder=6, gid=gid)
            # Towards the inside of the limits.
            below = theta[first - 1] > ranges.middle[dof]
            panel.annotate(str(first), at, textcoords="offset points", color=RED, gid=gid,
                           xytext=(6, -11 if below else 5), fontweight="bold")  # fmt: skip
        steps = numbers[name]["reconfigurations"]
        if steps:
            panel.plot(steps, [0.0] * len(steps), "^", color=line_style(name)["color"], ms=5,
                       clip_on=False, zorder=6, transform=panel.get_xaxis_transform(),
                       gid=gid)  # fmt: skip


def _marks(names: Iterable[str], numbers: Metrics) -> list[Line2D]:
    """Legend entries of limits and marks."""
    found = [Line2D([], [], color=RED, linewidth=1.2, label="joint limit")]
    few = [numbers[name] for name in names]
    cross, triangle = (
        Line2D([], [], color=RED, marker="x", ms=8, mew=2, ls="", label="first violation"),
        Line2D([], [], color="black", marker="^", ls="", label="reconfiguration (step > 15°)"),
    )
    found += [cross] if any(one["first_violation"] for one in few) else []
    return found + ([triangle] if any(one["reconfigurations"] for one in few) else [])
