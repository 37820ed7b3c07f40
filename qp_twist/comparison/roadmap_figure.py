"""Roadmaps; for planar arms as in the paper's Fig. 4: self-motion manifolds and the methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qp_twist.checks import Array
from qp_twist.comparison.roll_figure import roll_figure
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.pictures.shown_figure import ShownFigure
from qp_twist.pictures.style import LIMIT, RC, line_style, method_handles
from qp_twist.planning import RollMap, roll_arm
from qp_twist.planning.layer import centred
from qp_twist.planning.self_motion import manifolds

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INSIDE, _OUTSIDE = "#333333", "#C8C8C8"
_DRAWN = 50
"""Approximate number of waypoints whose manifolds are drawn."""


def applies_to(path_task: PathTask) -> bool:
    """Whether the figure can be drawn: a free roll, or a planar arm with one free degree."""
    return roll_arm(path_task) is not None or _is_planar(path_task)


def _is_planar(path_task: PathTask) -> bool:
    model = path_task.model
    return bool(
        model.nv - path_task.projector.rank == 1
        and not path_task.segments
        and model.nv <= 3
        and (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).all()
    )


def check_applies(path_task: PathTask) -> None:
    """Refuse a task for which the figure cannot be drawn, with a sentence."""
    if not applies_to(path_task):
        counts = dict.fromkeys(path_task.model.nv - t.rank for t in path_task.projectors)
        free = ", then ".join(map(str, counts))
        raise InvalidInput(
            f"roadmap: {path_task.name} leaves {free} of {path_task.model.nv} joints free; the "
            "roadmap is drawn for planar arms of up to three hinges with one of them free, and for "
            "arms of six hinges with closed-form inverse kinematics with the roll free, with one "
            "projector all the way."
        )


def roadmap_figure(
    path_task: PathTask, trajectories: Mapping[str, Trajectory], *, seed: int = 0
) -> Figure:
    """The configurations inside the limits along the path, with each method.

    For six hinges with a closed form and a free roll
    :func:`~qp_twist.comparison.roll_figure.roll_figure`. For a planar arm one panel a joint:
    manifolds as vertical lines, limits in red. A manifold's part is dark where the whole
    configuration is inside its limits and clear of what it must not touch, light elsewhere.

    Raises:
        InvalidInput: If the figure cannot be drawn for the task.
    """
    check_applies(path_task)
    if not _is_planar(path_task):
        return roll_figure(RollMap.of(path_task), trajectories)
    ranges = JointRanges.of(path_task.model)
    waypoints = path_task.waypoints
    drawn = range(0, len(waypoints), max(1, len(waypoints) // _DRAWN))
    rng = np.random.default_rng(seed)
    found = manifolds(path_task, drawn, rng=rng)
    curves = [(i + 1, own) for i, own in zip(drawn, found, strict=True)]
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(10.5, 3.0 * path_task.model.nv + 1.2), layout="constrained")
        panels = figure.subplots(path_task.model.nv, 1, sharex=True, squeeze=False)[:, 0]
        for dof, panel in enumerate(panels):
            _draw_manifolds(panel, path_task, dof, curves)
            for name, trajectory in trajectories.items():
                theta = np.degrees(ranges.positions(trajectory.q)[:, dof])
                panel.plot(np.arange(1, len(theta) + 1), theta, **line_style(name))
            _frame(panel, ranges, dof)
        panels[-1].set_xlabel("waypoint")
        panels[-1].set_xlim(0, len(waypoints) + 1)
        figure.suptitle(
            f"Roadmap of {path_task.name}: self-motion manifolds (vertical) and the methods",
            x=0.01, ha="left", fontsize=11, fontweight="bold",
        )  # fmt: skip
        handles = _legend(trajectories, near=bool(path_task.clearances))
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _draw_manifolds(
    panel: Axes, path_task: PathTask, dof: int, curves: list[tuple[int, list[Array]]]
) -> None:
    ranges = JointRanges.of(path_task.model)
    inside: list[list[tuple[int, float]]] = []
    outside: list[list[tuple[int, float]]] = []
    for waypoint, found in curves:
        for curve in found:
            wrapped = centred(curve, ranges)
            ok = ranges.inside(wrapped)
            for clearance in path_task.clearances:
                ok &= clearance.inside(wrapped, 0.0)
            theta = np.degrees(wrapped[:, dof]).tolist()
            for i in range(len(theta) - 1):
                if abs(theta[i + 1] - theta[i]) < 90.0:
                    segment = [(waypoint, theta[i]), (waypoint, theta[i + 1])]
                    (inside if ok[i] and ok[i + 1] else outside).append(segment)
    # Thousands of short lines: rasterised they take a tenth of the size.
    panel.add_collection(
        LineCollection(outside, colors=_OUTSIDE, linewidths=1.0, zorder=1, rasterized=True)
    )
    panel.add_collection(
        LineCollection(inside, colors=_INSIDE, linewidths=1.6, zorder=2, rasterized=True)
    )


def _frame(panel: Axes, ranges: JointRanges, dof: int) -> None:
    panel.set_title(ranges.names[dof])
    panel.set_ylabel("degrees")
    if not ranges.limited[dof]:
        return
    lower, upper = np.degrees(ranges.lower[dof]), np.degrees(ranges.upper[dof])
    room = 0.35 * (upper - lower)
    panel.set_ylim(lower - room, upper + room)
    for limit in (lower, upper):
        panel.axhline(limit, color=LIMIT, linewidth=1.4, zorder=5)


def _legend(trajectories: Mapping[str, Trajectory], *, near: bool) -> list[Line2D]:
    inside, outside = "manifold, all joints inside limits", "manifold, some joint outside"
    if near:
        inside, outside = f"{inside}, and clear", f"{outside}, or too near"
    return [
        *method_handles(trajectories),
        Line2D([], [], color=LIMIT, linewidth=1.4, label="joint limit"),
        Line2D([], [], color=_INSIDE, linewidth=1.6, label=inside),
        Line2D([], [], color=_OUTSIDE, linewidth=1.0, label=outside),
    ]
