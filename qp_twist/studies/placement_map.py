"""A map of placements: which have a plan, and of which value."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from qp_twist.checks import Array
from qp_twist.drawing.figures import ShownFigure
from qp_twist.drawing.palette import INK, RC, RED
from qp_twist.studies.placement_search import LARGEST

if TYPE_CHECKING:
    from qp_twist.studies.placement_search import BestPlacement

_NAMES = ("x, m", "y, m", "z, m", "turn about x, °", "turn about y, °", "turn about z, °")


def placement_figure(found: BestPlacement) -> Figure:
    """The placements that were tried, a panel for each pair of shifts and of turns that vary.

    The colour is the value of a plan of some waypoints, a cross has none, the ring is the best.
    """
    shown = np.hstack([found.offsets[:, :3], np.degrees(found.offsets[:, 3:])])
    free = np.flatnonzero(np.ptp(shown, axis=0) > 0.0).tolist()
    groups = [[k for k in free if k < 3], [k for k in free if k >= 3]]
    pairs = [pair for group in groups for pair in combinations(group, 2)]
    alone = [k for group in groups if len(group) == 1 for k in group]
    if len(alone) == 2:
        pairs, alone = [(alone[0], alone[1])], []
    label = {"centering": "mean z", "travel": "travel, °", "margin": "margin, °", "time": "time, s",
             "clearance": "least distance, m"}.get(str(found.objective), "value")  # fmt: skip
    panels = [*pairs, *((k, None) for k in alone)]
    with mpl.rc_context(RC):
        columns = min(3, len(panels))
        rows = -(-len(panels) // columns)
        size = (3.6 * columns + 1.2, 3.3 * rows + 0.6)
        figure = ShownFigure(figsize=size, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for panel, (across, up) in zip(axes, panels, strict=False):
            image = _panel(panel, found, shown, across, up, label)
        for panel in axes[len(panels) :]:
            panel.set_axis_off()
        if pairs and np.isfinite(found.values).any():
            figure.colorbar(image, ax=list(axes), label=label, pad=0.01)
        what = "the part" if found.moves == "part" else "the robot's base"
        share = f"a plan at {found.reachable:.0%} of {found.spread} places"
        figure.suptitle(
            f"{what} moved by ({share})" if columns > 1 else f"{what} moved by\n({share})",
            x=0.01, ha="left", fontsize=11, fontweight="bold",
        )  # fmt: skip
        figure.legend(
            *axes[0].get_legend_handles_labels(),
            loc="outside lower left",
            ncols=min(4, columns + 1),
        )
    return figure


def _panel(
    panel: Any, found: BestPlacement, shown: Array, across: int, up: int | None, label: str
) -> Any:
    """Placements over two of their coordinates, or their values over one."""
    values = found.values
    good = np.isfinite(values)
    most = found.objective in LARGEST  # the larger, the better
    better = values if most else -values
    order = np.flatnonzero(good)[np.argsort(better[good])]  # the best on top
    # A few very bad ones would leave one colour for all others.
    shares = (0.1, 1.0) if most else (0.0, 0.9)
    ends = np.quantile(values[good], shares) if good.any() else shares
    y = values if up is None else shown[:, up]
    # Those of the descents, which crowd around the best, are small.
    sizes = np.where(np.arange(len(values)) < found.spread, 26.0, 7.0)
    image = panel.scatter(
        shown[order, across], y[order], c=values[order], s=sizes[order], zorder=3,
        vmin=ends[0], vmax=ends[1], cmap="viridis" if most else "viridis_r",
        label="has a plan (small: on a descent)",
    )  # fmt: skip
    if up is not None:
        panel.scatter(
            shown[~good, across], y[~good], marker="x", s=20, lw=0.8, color=RED, label="has none"
        )
    if found.offset is not None and found.plan is not None:
        best = [*found.offset[:3], *np.degrees(found.offset[3:])]
        at = found.value if up is None else best[up]
        panel.scatter(
            best[across], at, s=110, facecolors="none", edgecolors=INK, lw=1.4, zorder=4,
            label="best whole plan",
        )  # fmt: skip
    panel.set(xlabel=_NAMES[across], ylabel=label if up is None else _NAMES[up])
    if up is not None and (across < 3) == (up < 3):
        panel.set_aspect("equal", adjustable="datalim")
    return image
