"""Figures of a study: maps over the workspace, what makes methods fail, z against the least."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from qp_twist.drawing.figures import ShownFigure
from qp_twist.drawing.palette import RC
from qp_twist.pages.method_style import line_style
from qp_twist.studies.summary import MethodSummary, numbers

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
    success = numbers(columns["success"])
    rows = [(method, name == method, success) for method in methods]
    if None not in columns["feasible"]:
        rows.insert(0, ("feasible", name == methods[0], numbers(columns["feasible"])))
    # A view along the plane in which all placements lie shows nothing.
    flat = {axis for axis, values in places.items() if np.nanmax(values) - np.nanmin(values) < 1e-9}
    views = [view for view in _VIEWS if not flat & set(view[1:])] or list(_VIEWS[:1])
    with mpl.rc_context(RC | {"axes.grid": False}):
        figure = ShownFigure(figsize=(max(7.0, 3.0 * len(views) + 1.2), 2.2 * len(rows) + 1.0),
                        layout="constrained")  # fmt: skip
        panels = figure.subplots(len(rows), len(views), squeeze=False)
        for of_row, (label, mine, values) in zip(panels, rows, strict=True):
            for panel, (view, across, up) in zip(of_row, views, strict=True):
                shown = mine & np.isfinite(places[across] + places[up] + values)
                x, y, z = places[across][shown], places[up][shown], values[shown]
                if len(z) <= _FEW:
                    order = np.argsort(-z)  # those that fail on top: they are the fewer
                    image: Any = panel.scatter(
                        x[order], y[order], c=z[order], s=14, vmin=0.0, vmax=1.0
                    )
                else:
                    bins = int(min(np.sqrt(len(z) / _PER_BIN), _MOST_BINS))
                    image = panel.hexbin(x, y, z, gridsize=bins, vmin=0.0, vmax=1.0)
                panel.set(aspect="equal", ylabel=f"{up}, m")
                if panel in panels[-1]:
                    panel.set_xlabel(f"{across}, m")
                # Beside the first panel the others may be too narrow for both.
                panel.set_title(f"{label}, {view}" if panel is of_row[0] else view, pad=8.0)
        figure.colorbar(image, ax=list(panels.ravel()), label="share that succeeds",
                        aspect=15 * len(rows), pad=0.01)  # fmt: skip
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


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
