"""The roadmap of an industrial arm: waypoint × roll, one panel per branch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.ndimage import distance_transform_edt

from qp_twist.checks import Array
from qp_twist.following import Trajectory
from qp_twist.pictures.shown_figure import ShownFigure
from qp_twist.pictures.style import LIMIT, RC, line_style, method_handles
from qp_twist.planning import RollMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Mask = npt.NDArray[np.bool_]

_MARGINS = mpl.colormaps["viridis"].resampled(16)  # bands are easier to compare than a gradient
SINGULAR = 0.1
"""Contour of σ_min of the task rows: below it joints move fast for little motion."""
_OUTSIDE, _TOUCHED, _STUCK = "#D9D9D9", "#8F9499", "#444444"
_NAMED, _ROOM = 3, 7.0
"""Largest number of pairs that are named in a panel; least radius of a named region, in nodes."""


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
            for name, way in ways.items():
                _draw_way(panel, name, way[0], way[1] == branch)
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
        figure.suptitle(
            f"Roadmap of {roll_map.path_task.name}: what each roll leaves of the joint limits"
            + (" and the clearance" if clearances else ""),
            x=0.01, ha="left", fontsize=11, fontweight="bold",
        )  # fmt: skip
        figure.legend(
            handles=[
                *method_handles(trajectories),
                Line2D([], [], color=LIMIT, linewidth=1.2, label="joint limit"),
                Line2D([], [], color="#888888", linewidth=1.2, linestyle="dotted",
                       label=f"σ min of the task rows {SINGULAR:g}"),
                Patch(color=_OUTSIDE, label="a joint outside its limits"),
                Patch(facecolor="none", edgecolor=_STUCK, hatch="....",
                      label="joints too slow to go on in this branch"),
                *(Patch(color=_TOUCHED, label=_nearer_than(roll_map, shown))
                  for _ in clearances[:1]),
            ],
            loc="outside lower center", ncols=3,
        )  # fmt: skip
    return figure


def _draw_margins(panel: Axes, roll_map: RollMap, branch: int, largest: float) -> QuadMesh:
    index, rolls = roll_map.waypoints + 1, np.degrees(roll_map.rolls)
    margins = roll_map.margins[:, :, branch].T
    outside = np.where(margins < 0.0, 0.0, np.nan)
    panel.pcolormesh(index, rolls, outside, cmap=mpl.colors.ListedColormap([_OUTSIDE]),
                     shading="nearest", rasterized=True)  # fmt: skip
    image = panel.pcolormesh(
        index, rolls, np.where(margins >= 0.0, margins, np.nan), cmap=_MARGINS, vmin=0.0,
        vmax=largest, shading="nearest", rasterized=True,
    )  # fmt: skip
    touched = roll_map.touched[:, :, branch].T
    panel.pcolormesh(index, rolls, np.where(touched >= 0, 0.0, np.nan), shading="nearest",
                     cmap=mpl.colors.ListedColormap([_TOUCHED]), rasterized=True)  # fmt: skip
    reached = np.nan_to_num(margins, nan=-1.0)
    if reached.min() < 0.0 < reached.max():
        panel.contour(index, rolls, reached, levels=[0.0], colors=[LIMIT], linewidths=1.0)
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


def _draw_way(panel: Axes, name: str, rolls: Array, here: Mask) -> None:
    """The part of a method's path in a branch; cut where the roll passes 180°."""
    degrees = np.where(here, np.degrees(rolls), np.nan)
    if np.isfinite(degrees).sum() < 2:
        return
    degrees[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    panel.plot(np.arange(1, len(degrees) + 1), degrees, color="white", linewidth=3.0, zorder=2.5)
    panel.plot(np.arange(1, len(degrees) + 1), degrees, **line_style(name))
