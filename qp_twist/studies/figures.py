"""Figures of a study: maps over the workspace, what makes methods fail, z against the least."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from qp_twist.checks import Array
from qp_twist.comparison.style import RC, line_style
from qp_twist.studies.summary import MethodSummary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Mask = npt.NDArray[np.bool_]

_MOST_BINS, _PER_BIN = 24, 6
_FEW = 400
"""Samples up to which each is a point of the map."""
_VIEWS = (("from above", "x", "y"), ("from the front", "x", "z"), ("from the side", "y", "z"))
_FAULTS = {
    "limit": "#D55E00", "jump": "#E69F00", "band": "#F0E442", "held": "#0072B2",
    "error": "#56B4E9", "no step": "#CC79A7", "diverged": "#000000", "start": "#999999",
    "no plan": "#009E73", "raised": "#661100",
}  # fmt: skip


def map_figure(title: str, columns: dict[str, Any], methods: tuple[str, ...]) -> Figure:
    """The share of successes over where the workpiece was put: a row a method, a column a view.

    The first row shows what is feasible. Each cell is the mean over the direction looked along, and
    over what else was drawn.
    """
    name = np.array(columns["method"])
    places = {axis: _numbers(columns[axis]) for axis in ("x", "y", "z")}
    first = name == methods[0]
    known = np.array([value is not None for value in columns["feasible"]])
    rows: list[tuple[str, Mask, Array]] = [
        ("feasible", first & known, _numbers(columns["feasible"]))
    ]
    rows += [(m, name == m, _numbers(columns["success"])) for m in methods]
    with mpl.rc_context(RC | {"axes.grid": False}):
        figure = Figure(figsize=(9.5, 2.1 * len(rows) + 1.2), layout="constrained")
        panels = figure.subplots(len(rows), len(_VIEWS), squeeze=False)
        for row, (label, mask, values) in zip(panels, rows, strict=True):
            for panel, (view, across, up) in zip(row, _VIEWS, strict=True):
                image = _map(panel, places[across][mask], places[up][mask], values[mask])
                panel.set_aspect("equal")
                if row is panels[0]:
                    panel.set_title(view)
                if row is panels[-1]:
                    panel.set_xlabel(f"{across}, m")
                panel.set_ylabel(f"{up}, m")
            row[0].text(-0.42, 0.5, label, transform=row[0].transAxes, rotation=90, va="center",
                        fontweight="bold")  # fmt: skip
        figure.colorbar(image, ax=list(panels.ravel()), label="share that succeeds", aspect=40,
                        pad=0.01)  # fmt: skip
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def _map(panel: Axes, across: Array, up: Array, values: Array) -> ScalarMappable:
    finite = np.isfinite(across) & np.isfinite(up) & np.isfinite(values)
    across, up, values = across[finite], up[finite], values[finite]
    if len(values) <= _FEW:
        # Those that fail on top: they are the fewer.
        order = np.argsort(-values, kind="stable")
        return panel.scatter(across[order], up[order], c=values[order], s=14, vmin=0.0, vmax=1.0,
                             cmap="viridis", edgecolors="none")  # fmt: skip
    bins = int(np.clip(np.sqrt(len(values) / _PER_BIN), 2, _MOST_BINS))
    edges = [_edges(v, bins) for v in (across, up)]
    total, *_ = np.histogram2d(across, up, edges)
    good, *_ = np.histogram2d(across, up, edges, weights=values)
    with np.errstate(invalid="ignore"):
        share = np.where(total > 0, good / total, np.nan)
    panel.set_facecolor("#EEEEEE")
    return panel.pcolormesh(*edges, share.T, vmin=0.0, vmax=1.0, cmap="viridis", rasterized=True)


def _edges(values: Array, bins: int) -> Array:
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    edges: Array = np.linspace(low, high if high > low else low + 1e-3, bins + 1)
    return edges


def fault_figure(title: str, summaries: list[MethodSummary]) -> Figure:
    """How laps of feasible samples end, a bar a method."""
    with mpl.rc_context(RC | {"axes.grid": False}):
        figure = Figure(figsize=(9.5, 0.42 * len(summaries) + 1.7), layout="constrained")
        panel = figure.subplots()
        seen = [k for k in _FAULTS if any(k in s.faults for s in summaries)]
        left = np.array([100.0 * s.feasible.count / max(1, s.feasible.of) for s in summaries])
        places = np.arange(len(summaries))
        panel.barh(places, left, color="#DDDDDD", label="succeeds")
        for kind in seen:
            share = np.array([
                100.0 * sum(s.faults.get(kind, {}).values()) / max(1, s.feasible.of)
                for s in summaries
            ])  # fmt: skip
            panel.barh(places, share, left=left, color=_FAULTS[kind], label=kind)
            left = left + share
        panel.set_yticks(places, [s.method for s in summaries])
        panel.invert_yaxis()
        panel.set_xlim(0.0, 100.0)
        panel.set_xlabel("% of the feasible samples")
        figure.legend(loc="outside lower center", ncols=6)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def z_figure(title: str, columns: dict[str, Any], methods: tuple[str, ...]) -> Figure:
    """Mean z of successful laps over the mean of each waypoint's least, as a distribution."""
    name, ratio = np.array(columns["method"]), _numbers(columns["z_over_least"])
    with mpl.rc_context(RC):
        figure = Figure(figsize=(9.5, 4.2), layout="constrained")
        panel = figure.subplots()
        for method in methods:
            mine = np.sort(ratio[(name == method) & np.isfinite(ratio)])
            if len(mine):
                share = 100.0 * np.arange(1, len(mine) + 1) / len(mine)
                panel.step(mine, share, where="post", **line_style(method))
        panel.set_xscale("log")
        for formatter in (panel.xaxis.set_major_formatter, panel.xaxis.set_minor_formatter):
            formatter(FuncFormatter(lambda x, _: f"{x:.3g}"))
        panel.set_xlabel("mean z of the lap / mean of what each of its waypoints has at least")
        panel.set_ylabel("% of the method's successful laps")
        panel.set_ylim(0.0, 100.0)
        if panel.get_legend_handles_labels()[0]:
            figure.legend(loc="outside right upper")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def _numbers(values: list[float | bool | None]) -> Array:
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
