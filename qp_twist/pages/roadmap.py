"""Roadmaps: what limits and clearances leave of the free motion along a path.

For an industrial arm waypoint × roll, one panel per branch; for a planar arm the self-motion
manifolds, one panel per joint, as in the paper's Fig. 4.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.collections import QuadMesh
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.ndimage import distance_transform_edt

from qp_twist.checks import Array, Mask
from qp_twist.drawing.charts import draw_joint
from qp_twist.drawing.figures import ShownFigure
from qp_twist.drawing.palette import RC, RED
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.pages.method_style import entitle, line_style, method_curves, method_handles
from qp_twist.paths import PathTask
from qp_twist.planning import RollMap, roll_arm
from qp_twist.planning.layer import centred
from qp_twist.planning.manifold_net import ManifoldNet
from qp_twist.planning.path_rows import PathRows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARGINS = mpl.colormaps["viridis"].resampled(16)  # bands are easier to compare than a gradient
SINGULAR = 0.1
"""Contour of σ_min of the task rows: below it joints move fast for little motion."""
_OUTSIDE, _TOUCHED, _STUCK = "#D9D9D9", "#8F9499", "#444444"
_KEPT, _LEFT = "#333333", "#C8C8C8"
"""Parts of manifolds inside all limits, and outside."""
_NAMED, _ROOM = 3, 7.0
"""Largest number of pairs that are named in a panel; least radius of a named region, in nodes."""
_DRAWN, _SPACING = 50, np.radians(3.0)
"""Approximate number of waypoints whose manifolds are drawn; distance of their points, rad."""


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


def roadmap_figure(path_task: PathTask, trajectories: Mapping[str, Trajectory]) -> Figure:
    """The configurations inside the limits along the path, with each method.

    For six hinges with a closed form and a free roll :func:`roll_figure`. For a planar arm one
    panel a joint: manifolds as vertical lines, limits in red. A manifold's part is dark where the
    whole configuration is inside its limits and clear of what it must not touch, light elsewhere.

    Raises:
        InvalidInput: If the figure cannot be drawn for the task.
    """
    check_applies(path_task)
    if not _is_planar(path_task):
        return roll_figure(RollMap.of(path_task), trajectories)
    ranges, count = JointRanges.of(path_task.model), len(path_task.waypoints)
    drawn = range(0, count, max(1, count // _DRAWN))
    found = manifolds(path_task, drawn)
    waypoints = np.repeat([index + 1.0 for index in drawn], [len(own) for own in found])
    q = centred(np.concatenate(found), ranges)
    kept = ranges.inside(q)
    for clearance in path_task.clearances:
        kept &= clearance.inside(q, 0.0)
    positions = {name: ranges.positions(t.q) for name, t in trajectories.items()}
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(10.5, 3.0 * path_task.model.nv + 1.2))
        panels = figure.subplots(path_task.model.nv, 1, sharex=True, squeeze=False)[:, 0]
        for dof, panel in enumerate(panels):
            runs = method_curves({name: run[:, dof] for name, run in positions.items()})
            draw_joint(panel, ranges, dof, runs)
            _draw_manifolds(panel, dof, waypoints, q, kept)
            if ranges.limited[dof]:
                low, high = np.degrees((ranges.lower[dof], ranges.upper[dof]))
                panel.set_ylim(low - 0.35 * (high - low), high + 0.35 * (high - low))
        panels[-1].set_xlabel("waypoint")
        panels[-1].set_xlim(0, count + 1)
        near = bool(path_task.clearances)
        entitle(
            figure,
            f"Roadmap of {path_task.name}: self-motion manifolds (vertical) and the methods",
            [
                *method_handles(trajectories),
                Line2D([], [], color=RED, linewidth=1.4, label="joint limit"),
                Line2D([], [], color=_KEPT, linewidth=1.6, label="manifold, all joints inside "
                       "limits" + near * ", and clear"),
                Line2D([], [], color=_LEFT, linewidth=1.0, label="manifold, some joint outside"
                       + near * ", or too near"),
            ],
        )  # fmt: skip
    return figure


def manifolds(path_task: PathTask, indices: Sequence[int]) -> list[Array]:
    """Configurations (K, nv) on some waypoints that cover the self-motion, whatever the limits."""
    model = copy.copy(path_task.model)
    model.jnt_limited[:] = 0
    free = dataclasses.replace(path_task.without_clearance(), model=model)
    net = ManifoldNet(free, PathRows(free), _SPACING)
    return [net.layer(index).q for index in indices]


def _draw_manifolds(panel: Axes, dof: int, waypoints: Array, q: Array, kept: Mask) -> None:
    """One joint of configurations (K, nv) above their waypoints (K,), dark where they are kept."""
    for which, colour, width, order in ((~kept, _LEFT, 0.8, 1), (kept, _KEPT, 1.2, 2)):
        panel.scatter(waypoints[which], np.degrees(q[which, dof]), color=colour, marker="|",
                      s=16.0, linewidths=width, zorder=order, rasterized=True)  # fmt: skip


def roll_figure(roll_map: RollMap, trajectories: Mapping[str, Trajectory]) -> Figure:
    """Margin by colour, red at the joint limits, grey outside; each method's roll over it.

    Dark grey where a pair of geoms is nearer than the task allows, with the names of the pairs. One
    panel for each branch of which more than 0.5 % is free, or that a method uses.
    """
    ways = {name: roll_map.locate(t.q) for name, t in trajectories.items()}
    margins = roll_map.margins
    shown = [
        branch
        for branch in range(margins.shape[2])
        if ((margins > 0.0) & (roll_map.touched < 0))[:, :, branch].mean() > 0.005
        or any((found == branch).mean() > 0.02 for _, found in ways.values())
    ]
    largest = float(np.nanmax(margins, initial=1.0))
    with mpl.rc_context(RC | {"axes.grid": False}):
        rows = (len(shown) + 1) // 2
        figure = ShownFigure(figsize=(10.5, 2.5 * rows + 1.6), layout="constrained")
        panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).ravel()
        for panel, branch in zip(panels, shown, strict=False):
            image = _draw_margins(panel, roll_map, branch, largest)
            for name, (rolls, branches) in ways.items():
                _draw_way(panel, name, np.where(branches == branch, np.degrees(rolls), np.nan))
            panel.set_title(f"branch {branch + 1}")
            panel.set_ylim(-180.0, 180.0)
            panel.set_yticks([-180, -90, 0, 90, 180])
        for panel in panels[len(shown) :]:
            panel.set_visible(False)
        for panel in panels[-2:]:
            panel.set_xlabel("waypoint")
            panel.tick_params(labelbottom=True)
        for panel in panels[::2]:
            panel.set_ylabel("roll, degrees")
        figure.colorbar(image, ax=list(panels), label="distance from the nearest limit, degrees",
                        aspect=40, pad=0.01)  # fmt: skip
        clearances = roll_map.path_task.clearances
        handles = [
            *method_handles(trajectories),
            Line2D([], [], color=RED, linewidth=1.2, label="joint limit"),
            Line2D([], [], color="#888888", linewidth=1.2, linestyle="dotted",
                   label=f"σ min of the task rows {SINGULAR:g}"),
            Patch(color=_OUTSIDE, label="a joint outside its limits"),
            Patch(facecolor="none", edgecolor=_STUCK, hatch="....",
                  label="joints too slow to go on in this branch"),
        ]  # fmt: skip
        if clearances:
            handles.append(Patch(color=_TOUCHED, label=_nearer_than(roll_map, shown)))
        entitle(
            figure, f"Roadmap of {roll_map.path_task.name}: what each roll leaves of the joint "
            f"limits{' and the clearance' if clearances else ''}", handles,
        )  # fmt: skip
    return figure


def _draw_margins(panel: Axes, roll_map: RollMap, branch: int, largest: float) -> QuadMesh:
    index, rolls = roll_map.waypoints + 1, np.degrees(roll_map.rolls)
    margins = roll_map.margins[:, :, branch].T
    touched = roll_map.touched[:, :, branch].T

    def fill(where: Mask, colour: str) -> None:
        panel.pcolormesh(index, rolls, np.where(where, 0.0, np.nan), shading="nearest",
                         cmap=ListedColormap([colour]), rasterized=True)  # fmt: skip

    fill(margins < 0.0, _OUTSIDE)
    image = panel.pcolormesh(
        index, rolls, np.where(margins >= 0.0, margins, np.nan), cmap=_MARGINS, vmin=0.0,
        vmax=largest, shading="nearest", rasterized=True,
    )  # fmt: skip
    fill(touched >= 0, _TOUCHED)
    reached = np.nan_to_num(margins, nan=-1.0)
    if reached.min() < 0.0 < reached.max():
        panel.contour(index, rolls, reached, levels=[0.0], colors=[RED], linewidths=1.0)
    singular = np.nan_to_num(roll_map.sigma_min[:, :, branch].T, nan=1.0)
    if singular.min() < SINGULAR < singular.max():
        panel.contour(index, rolls, singular, levels=[SINGULAR], colors=["white"],
                      linestyles=["dotted"], linewidths=1.2)  # fmt: skip
    stuck = roll_map.stuck[:, :, branch].T & (margins >= 0.0) & (touched < 0)
    if stuck.any():
        with mpl.rc_context({"hatch.color": _STUCK, "hatch.linewidth": 0.5}):
            panel.contourf(index, rolls, stuck.astype(float), levels=[0.5, 1.5], colors="none",
                           hatches=["...."])  # fmt: skip
    _name_pairs(panel, roll_map, branch)
    return image


def _name_pairs(panel: Axes, roll_map: RollMap, branch: int) -> None:
    """Name the most frequent pairs, each in the middle of its largest region."""
    touched = roll_map.touched[:, :, branch]
    for name in list(roll_map.in_the_way([branch]))[:_NAMED]:
        own = np.pad(touched == roll_map.pairs.index(name), 1)
        depth = distance_transform_edt(own)[1:-1, 1:-1]
        if depth.max() < _ROOM:
            continue
        k, roll = np.unravel_index(int(depth.argmax()), depth.shape)
        panel.annotate(
            name.replace(" to ", "\nto "),
            (roll_map.waypoints[k] + 1, np.degrees(roll_map.rolls[roll])), fontsize=7,
            ha="center", va="center", zorder=6, linespacing=1.0,
            path_effects=[withStroke(linewidth=2.0, foreground=_TOUCHED)],
        )  # fmt: skip


def _nearer_than(roll_map: RollMap, shown: list[int]) -> str:
    """What the dark grey stands for."""
    asked = sorted({1e3 * clearance.distance for clearance in roll_map.path_task.clearances})
    distances = " or ".join(f"{distance:g}" for distance in asked)
    found = roll_map.in_the_way(shown)
    most = f", most often {next(iter(found))}" if found else ""
    return f"a pair nearer than {distances} mm{most}"


def _draw_way(panel: Axes, name: str, degrees: Array) -> None:
    """The part of a method's path in a branch; cut where the roll passes 180°."""
    if np.isfinite(degrees).sum() < 2:
        return
    degrees[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    waypoints = np.arange(1, len(degrees) + 1)
    panel.plot(waypoints, degrees, color="white", linewidth=3.0, zorder=2.5)
    panel.plot(waypoints, degrees, **line_style(name))
