"""Joints between their limits over the waypoint index: the layout of the paper's Fig. 3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qp_twist.comparison.metrics import metrics
from qp_twist.files import whole_file
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, PathTask
from qp_twist.pictures.joint_limits import draw_limits
from qp_twist.pictures.shown_figure import ShownFigure
from qp_twist.pictures.style import LIMIT, RC, line_style, method_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def joint_figures(path_task: PathTask, trajectories: Mapping[str, Trajectory]) -> dict[str, Figure]:
    """The paper's figure (``joints``) and one for each closed form with its QP counterpart."""
    figures = {}
    paper = [name for name in ("twa", "rmr") if name in trajectories]
    if paper:
        figures["joints"] = joint_figure(
            path_task, {name: trajectories[name] for name in paper},
            "Joint positions between their limits: twist decomposition and resolved motion rate",
        )  # fmt: skip
    for name, method in METHODS.items():
        if not method.constrained or name not in trajectories:
            continue
        pair = [n for n, m in METHODS.items() if m.counterpart == name and n in trajectories]
        closed = [n for n in pair if not METHODS[n].peer]
        beside = {0: "", 1: " and its closed form"}.get(len(closed), " and its closed forms")
        beside += "".join(f", {n}" for n in pair if METHODS[n].peer)
        figures[f"joints_{name}"] = joint_figure(
            path_task, {n: trajectories[n] for n in [*pair, name]},
            f"Joint positions between their limits: {name}{beside}",
        )  # fmt: skip
    return figures


def joint_figure(path_task: PathTask, trajectories: Mapping[str, Trajectory], title: str) -> Figure:
    """One panel per joint: limits in red, violations and reconfigurations marked.

    A red cross marks a joint's first waypoint outside its limits, a triangle on the axis a
    waypoint that was reached by a step above 15° in some joint.
    """
    ranges = JointRanges.of(path_task.model)
    numbers = {name: metrics(trajectory) for name, trajectory in trajectories.items()}
    joints = [dof for dof in range(path_task.model.nv) if ranges.qpos[dof] >= 0]
    columns = 2 if len(joints) > 3 else 1
    rows = -(-len(joints) // columns)
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(10.5, 2.0 * rows + 1.1), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        # Down the columns, as in the paper: joints 1 to 3 at the left, 4 to 6 at the right.
        panels = list(grid.T.flat)
        for panel, dof in zip(panels, joints, strict=False):
            _draw_joint(panel, ranges, dof, trajectories, numbers)
        for panel in panels[len(joints) :]:
            panel.set_visible(False)
        for panel in grid[-1]:
            panel.set_xlabel("waypoint")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
        figure.legend(handles=_legend(numbers), loc="outside lower center", ncols=3)
    return figure


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG under a temporary name and rename it: a failure leaves no partial file."""
    with whole_file(path) as unfinished, mpl.rc_context(RC):
        figure.savefig(unfinished, format="png")
    return path


def _draw_joint(
    panel: Axes,
    ranges: JointRanges,
    dof: int,
    trajectories: Mapping[str, Trajectory],
    numbers: Mapping[str, dict[str, Any]],
) -> None:
    # Degrees for hinges, metres for slides.
    unit = np.degrees(1.0) if ranges.hinge[dof] else 1.0
    curves = [unit * ranges.positions(t.q)[:, dof] for t in trajectories.values()]
    for name, theta in zip(trajectories, curves, strict=True):
        index = np.arange(1, len(theta) + 1)
        panel.plot(index, theta, **line_style(name))
        first = numbers[name]["first_violation"].get(ranges.names[dof])
        if first is not None:
            mark_violation(panel, first, theta[first - 1], unit * ranges.middle[dof])
        _mark_reconfigurations(panel, numbers[name]["reconfigurations"], line_style(name)["color"])
    draw_limits(panel, ranges, dof, curves)
    panel.margins(x=0.01)


def mark_violation(
    panel: Axes,
    waypoint: int,
    value: float,
    middle: float,
    *,
    size: tuple[float, float] = (9.0, 2.2),
    gid: str | None = None,
) -> None:
    """A red cross of some size and line width, with its waypoint beside it."""
    panel.plot(
        waypoint, value, "x", color=LIMIT, ms=size[0], mew=size[1], zorder=6, gid=gid,
    )  # fmt: skip
    # Towards the inside of the limits.
    panel.annotate(
        str(waypoint), (waypoint, value), textcoords="offset points",
        xytext=(6, -11 if value > middle else 5), color=LIMIT, fontweight="bold", gid=gid,
    )  # fmt: skip


def _mark_reconfigurations(panel: Axes, waypoints: Sequence[int], colour: str) -> None:
    if not waypoints:
        return
    for waypoint in waypoints:
        panel.axvline(waypoint, color=colour, linewidth=0.6, alpha=0.6, zorder=1)
    panel.plot(
        waypoints, [0.0] * len(waypoints), "^", color=colour, ms=6, clip_on=False,
        transform=panel.get_xaxis_transform(), zorder=6,
    )  # fmt: skip


def _legend(numbers: Mapping[str, dict[str, Any]]) -> list[Line2D]:
    handles = method_handles(numbers)
    handles.append(Line2D([], [], color=LIMIT, linewidth=1.2, label="joint limit"))
    if any(found["first_violation"] for found in numbers.values()):
        handles.append(
            Line2D([], [], color=LIMIT, marker="x", ms=8, mew=2, ls="", label="first violation")
        )
    if any(found["reconfigurations"] for found in numbers.values()):
        handles.append(
            Line2D([], [], color="black", marker="^", ls="", label="reconfiguration (step > 15°)")
        )
    return handles
