"""The figure of a run: times of the table's contenders, and how cost grows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qp_twist.bench.ratios import off_by
from qp_twist.bench.record import BenchRun, Case, Measured
from qp_twist.bench.tables import GROUPS, WRONG
from qp_twist.files import whole_file
from qp_twist.pictures.style import RC

# Okabe and Ito's palette again: a family a colour.
COLOURS = {
    "floor": "#000000",
    "step": "#0072B2",
    "solve_ik": "#56B4E9",
    "mink": "#D55E00",
    "pink": "#CC79A7",
    "placo": "#009E73",
    "closed": "#8C6D00",
    "batch": "#0072B2",
}
_OTHER = "#666666"
_SERIES: dict[str, tuple[str, str]] = {
    "step:daqp": ("#0072B2", "o"),
    "step:compiled": ("#56B4E9", "s"),
    "mink:hard": ("#D55E00", "^"),
    "batch:all_cores": ("#0072B2", "o"),
    "batch:one_thread": ("#56B4E9", "s"),
}


def draw(run: BenchRun, path: Path) -> Path:
    """Write the figure; the ending of the name says in which format."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    steps = [case for case in run.cases if case.group == "step"]
    groups = [g for g in GROUPS if any(case.group == g for case in run.cases)]
    names = list(dict.fromkeys(m.contender for case in steps for m in case.results))
    high = (0.21 * len(names) + 1.3) if steps else 0.0
    series_rows = (len(groups) + 2) // 3
    heights = ([high] if steps else []) + [2.5] * series_rows
    if not heights:
        heights = [1.0]
    # As text, words can be searched and the file stays small.
    with mpl.rc_context(RC | {"svg.fonttype": "none", "svg.hashsalt": "bench"}):
        figure = Figure(figsize=(9.6, sum(heights) + 0.4), layout="constrained")
        FigureCanvasAgg(figure)
        parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        if steps:
            _table(parts[0], steps, names)
        for row in range(series_rows):
            part = parts[row + bool(steps)]
            axes = part.subplots(1, 3)
            for ax, group in zip(axes, groups[3 * row : 3 * row + 3], strict=False):
                _series(ax, group, [case for case in run.cases if case.group == group])
            for ax in axes[len(groups[3 * row : 3 * row + 3]) :]:
                ax.set_axis_off()
        with whole_file(path) as unfinished:
            metadata = {"Date": None} if path.suffix == ".svg" else None
            figure.savefig(unfinished, format=path.suffix[1:], metadata=metadata)
    return path


def _table(part: Any, steps: list[Case], names: list[str]) -> None:
    """A row a contender, a panel a robot."""
    axes = part.subplots(1, len(steps), sharey=True, squeeze=False)[0]
    place = {name: -i for i, name in enumerate(names)}
    for ax, case in zip(axes, steps, strict=True):
        for m in case.results:
            if m.warm is None:
                continue
            y, colour = place[m.contender], colour_of(m.contender)
            ax.plot([m.warm.p10, m.warm.p90], [y, y], color=colour, linewidth=2.2, alpha=0.45)
            ax.plot(
                m.warm.median, y, marker="o", markersize=5.5, color=colour,
                markerfacecolor="white" if is_wrong(m) else colour, markeredgewidth=1.3,
            )  # fmt: skip
        ax.set_xscale("log")
        ax.set_title(f"{case.joints} joints, {case.rows} rows")
        ax.set_xlabel("µs a step")
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks([place[name] for name in names], names)
    for label in axes[0].get_yticklabels():
        label.set_color(colour_of(label.get_text()))
    axes[0].set_ylim(-len(names) + 0.4, 0.6)
    part.suptitle(
        "Median and p10–p90 of a whole step (closed forms: kinematics given).\n"
        "Filled: task, limits and, where it is asked for, the exact solution held to 1e-6; open: "
        "not.",
        fontsize=9, x=0.01, ha="left",
    )  # fmt: skip


def _series(ax: Any, group: str, cases: list[Case]) -> None:
    for name in dict.fromkeys(m.contender for case in cases for m in case.results):
        found = [(case.x, m) for case in cases if (m := case.of(name)) and m.warm]
        colour, marker = _SERIES.get(name, (colour_of(name), "."))
        x = [x for x, _ in found]
        quantiles = [m.warm for _, m in found if m.warm]
        ax.fill_between(
            x, [q.p10 for q in quantiles], [q.p90 for q in quantiles], color=colour, alpha=0.18,
            linewidth=0,
        )  # fmt: skip
        ax.plot(
            x, [q.median for q in quantiles], color=colour, marker=marker, markersize=4,
            linewidth=1.2, label=name,
        )  # fmt: skip
    ax.set_yscale("log")
    if group in ("joints", "batch"):
        ax.set_xscale("log")
    ticks = [case.x for case in cases]
    ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    ax.minorticks_off()
    ax.set_xlabel(GROUPS[group])
    ax.set_ylabel("µs a step")
    ax.set_ylim(bottom=1.0)
    ax.legend(fontsize=7.5)


def colour_of(contender: str) -> str:
    """The colour of a contender's family."""
    return COLOURS.get(contender.partition(":")[0], _OTHER)


def is_wrong(measured: Measured) -> bool:
    """Whether the answers miss the task, a limit or the solution by more than a mark."""
    off = off_by(measured)
    return off is not None and off > WRONG
