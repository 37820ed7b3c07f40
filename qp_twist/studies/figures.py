"""Figures of a study: maps over the workspace, what makes methods fail, z against the least."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from qp_twist.checks import Array
from qp_twist.drawing.figures import ShownFigure
from qp_twist.drawing.palette import RC
from qp_twist.pages.method_style import line_style
from qp_twist.studies.summary import MethodSummary, numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Mask = npt.NDArray[np.bool_]

_MOST_BINS, _PER_BIN = 24, 6
_FEW = 400
"""Samples up to which each is a point of the map."""
_VIEWS = (("from above", "x", "y"), ("from the front", "x", "z"), ("from the side", "y", "z"))
_RATIOS = (1.0, 1.02, 1.05, 1.1, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)
_FAULTS = {
    "limit": "#D55E00", "jump": "#E69F00", "band": "#F0E442", "constraint": "#882255",
    "held": "#0072B2", "error": "#56B4E9", "no step": "#CC79A7", "diverged": "#000000",
    "start": "#999999", "no plan": "#009E73", "raised": "#661100",
}  # fmt: skip


def map_figure(title: str, columns: dict[str, Any], methods: tuple[str, ...]) -> Figure:
    """The share of successes over where the workpiece was put: a row a method, a column a view.

    The first row shows what is feasible, if that is known of all samples. Each cell is the mean
    over the direction looked along, and over what else was drawn.
    """
    name = np.array(columns["method"], dtype=object)
    places = {axis: numbers(columns[axis]) for axis in ("x", "y", "z")}
    rows: list[tuple[str, Mask, Array]] = []
    if None not in columns["feasible"]:
        rows.append(("feasible", name == methods[0], numbers(columns["feasible"])))
    rows += [(m, name == m, numbers(columns["success"])) for m in methods]
    # A view along the plane in which all placements lie shows nothing.
    flat = {axis for axis, values in places.items() if np.ptp(values[np.isfinite(values)]) < 1e-9}
    views = [view for view in _VIEWS if not flat & set(view[1:])] or list(_VIEWS[:1])
    with mpl.rc_context(RC | {"axes.grid": False}):
        figure = ShownFigure(figsize=(max(7.0, 3.0 * len(views) + 1.2), 2.2 * len(rows) + 1.0),
                        layout="constrained")  # fmt: skip
        widths = [np.ptp(_ends(places[across])) for _, across, _ in views]
        panels = figure.subplots(len(rows), len(views), squeeze=False, width_ratios=widths)
        for number, (label, mask, values) in enumerate(rows):
            for panel, (view, across, up) in zip(panels[number], views, strict=True):
                image = _map(panel, places[across], places[up], values, mask)
                panel.set_aspect("equal")
                # Beside the first panel the others may be too narrow for both.
                first = panel is panels[number, 0]
                panel.set_title(f"{label}, {view}" if first else view, pad=8.0)
                panel.set_ylabel(f"{up}, m")
                if number == len(rows) - 1:
                    panel.set_xlabel(f"{across}, m")
        figure.colorbar(image, ax=list(panels.ravel()), label="share that succeeds",
                        aspect=15 * len(rows), pad=0.01)  # fmt: skip
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def _map(panel: Axes, across: Array, up: Array, values: Array, mask: Mask) -> ScalarMappable:
    ends = [_ends(places) for places in (across, up)]
    panel.set_xlim(*ends[0])
    panel.set_ylim(*ends[1])
    mask = mask & np.isfinite(across) & np.isfinite(up) & np.isfinite(values)
    across, up, values = across[mask], up[mask], values[mask]
    if len(values) <= _FEW:
        # Those that fail on top: they are the fewer.
        order = np.argsort(-values, kind="stable")
        return panel.scatter(across[order], up[order], c=values[order], s=14, vmin=0.0, vmax=1.0,
                             cmap="viridis", edgecolors="none", clip_on=False)  # fmt: skip
    bins = int(np.clip(np.sqrt(len(values) / _PER_BIN), 2, _MOST_BINS))
    edges = [np.linspace(low, high, bins + 1) for low, high in ends]
    total, *_ = np.histogram2d(across, up, edges)
    good, *_ = np.histogram2d(across, up, edges, weights=values)
    with np.errstate(invalid="ignore"):
        share = np.where(total > 0, good / total, np.nan)
    panel.set_facecolor("#EEEEEE")
    return panel.pcolormesh(*edges, share.T, vmin=0.0, vmax=1.0, cmap="viridis", rasterized=True)


def _ends(values: Array) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    return (low, high) if high - low > 1e-9 else (low - 0.5, high + 0.5)


def fault_figure(title: str, summaries: list[MethodSummary]) -> Figure:
    """How runs of feasible samples end, a bar a method."""
    with mpl.rc_context(RC | {"axes.grid": False}):
        figure = ShownFigure(figsize=(9.5, 0.42 * len(summaries) + 1.7), layout="constrained")
        panel = figure.subplots()
        seen = [k for k in _FAULTS if any(k in s.faults for s in summaries)]
        left = np.array([100.0 * s.possible.share if s.possible.of else 0.0 for s in summaries])
        places = np.arange(len(summaries))
        panel.barh(places, left, color="#DDDDDD", label="succeeds")
        for kind in seen:
            share = np.array([
                100.0 * sum(s.faults.get(kind, {}).values()) / max(1, s.possible.of)
                for s in summaries
            ])  # fmt: skip
            panel.barh(places, share, left=left, color=_FAULTS[kind], label=kind)
            left = left + share
        panel.set_yticks(places, [s.method for s in summaries])
        panel.invert_yaxis()
        panel.set_xlim(0.0, 100.0)
        panel.set_xlabel("% of the samples that are not known to be infeasible")
        figure.legend(loc="outside lower center", ncols=6)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def z_figure(title: str, columns: dict[str, Any], methods: tuple[str, ...]) -> Figure:
    """Mean z of successful runs over the mean of each waypoint's least, as a distribution."""
    name, ratio = np.array(columns["method"]), numbers(columns["z_over_least"])
    with mpl.rc_context(RC):
        figure = ShownFigure(figsize=(9.5, 4.2), layout="constrained")
        panel = figure.subplots()
        for method in methods:
            mine = np.sort(ratio[(name == method) & np.isfinite(ratio)])
            if len(mine):
                share = 100.0 * np.arange(len(mine) + 1) / len(mine)
                panel.step(np.append(mine[0], mine), share, where="post", **line_style(method))
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(_RATIOS))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.set_xlabel("mean z of the run / mean of what each of its waypoints has at least")
        panel.set_ylabel("% of the method's successful runs")
        panel.set_ylim(0.0, 100.0)
        if panel.get_legend_handles_labels()[0]:
            figure.legend(loc="outside right upper")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure
