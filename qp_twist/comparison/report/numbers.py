"""The table of metrics, each closed form beside its QP, and the step times."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from qp_twist.comparison.metrics import (
    BAND_LEFT,
    EXCESSES,
    TASK_MET_M,
    TASK_MET_RAD,
    too_near,
)
from qp_twist.comparison.report.section import ReportSection, kind
from qp_twist.comparison.report.swatch import swatch
from qp_twist.comparison.table import significant, time_in_code, whole
from qp_twist.paths import METHODS
from qp_twist.pictures.figure_html import figure_html
from qp_twist.pictures.style import line_style, pair_of
from qp_twist.pictures.svg import SVG_RC, inline_svg

_COLUMNS = (
    "method", "joint limits", "min margin", "mean z", "position error mm", "axis error °",
    "travel °", "max step °", "σ min", "µs per waypoint",
)  # fmt: skip
_KINDS = {"closed": "closed form", "peer": "another library's step", "qp": "QP"}


def table_section(content: Mapping[str, Any]) -> ReportSection:
    """The table, from the content of ``comparison.json``."""
    methods: Mapping[str, Any] = content["methods"]
    more = [key for key in EXCESSES if any(key in numbers for numbers in methods.values())]
    headings = (f"{key.removesuffix('_max').replace('_', ' ')} m or rad" for key in more)
    columns = [*_COLUMNS, *headings]
    if any("min_clearance_m" in numbers for numbers in methods.values()):
        columns.append("clearance mm")
    heads = "".join(f'<th scope="col">{name}</th>' for name in columns)
    compiled = content["compiled"]
    bodies = "".join(
        f"<tbody>{''.join(_row(n, methods[n], compiled[n], more) for n in pair)}</tbody>"
        for _, pair in groupby(methods, key=pair_of)
    )
    notes = [
        f"<li><code>{name}</code>: {html.escape(numbers['status'])}</li>"
        for name, numbers in methods.items()
        if numbers["status"] != "ok"
    ]
    remarks = f'<h3>Remarks</h3><ul class="remarks">{"".join(notes)}</ul>' if notes else ""
    body = (
        "<p>A closed form stands above the QP that is its constrained counterpart. ✗ marks what "
        "was not kept: a limit, with the first waypoint outside it, or the task to 0.01 mm and "
        "10⁻⁵ rad. The margin is 1 in the middle of a joint's range, 0 at a limit, negative "
        "outside; z = ½‖W(θ̄ − θ)‖²; errors are the largest, in the task's rows; travel is the sum "
        "of all hinges' displacements; σ min is that of the task's rows; times are wall times, "
        "kinematics included, of compiled code where they have a *, else of Python.</p>"
        '<div class="scroll" tabindex="0" role="region" aria-label="Table of metrics">'
        f'<table class="metrics"><thead><tr>{heads}</tr></thead>{bodies}</table></div>{remarks}'
    )
    return ReportSection("table", "The numbers", body)


def glance_section(content: Mapping[str, Any]) -> ReportSection:
    """One line for each method: whether it kept the limits and the task, and what it did not."""
    methods: Mapping[str, Any] = content["methods"]
    items = ""
    for name, numbers in methods.items():
        left = _not_kept(numbers)
        mark, words = ("good", "✓ kept limits and task") if not left else ("bad", f"✗ {left}")
        said = f"<span>{html.escape(words)}</span>"
        items += f'<li class="{mark}">{swatch(name)} <b>{name}</b> {said}</li>'
    return ReportSection("glance", "At a glance", f'<ul class="glance">{items}</ul>')


def _not_kept(numbers: Mapping[str, Any]) -> str:
    """What a method did not keep, in a few words; empty if it kept all."""
    first = numbers["first_violation"]
    found = [f"left the limits of {', '.join(first)}"] if first else []
    off = numbers["position_error_max_m"] > TASK_MET_M
    if off or numbers["axis_error_max_rad"] > TASK_MET_RAD:
        found.append("left the path")
    found += [
        f"left a {key.removesuffix('_excess_max').replace('_', ' ')}"
        for key in EXCESSES
        if numbers.get(key, 0.0) > BAND_LEFT
    ]
    if "min_clearance_m" in numbers and too_near(numbers):
        found.append("came too near to something")
    return ", ".join(found)


def times_section(content: Mapping[str, Any]) -> ReportSection:
    """Wall time per waypoint, one point per method, logarithmic."""
    methods: Mapping[str, Any] = content["methods"]
    times = {name: numbers["time_per_waypoint_us"] for name, numbers in methods.items()}
    names, compiled = list(times), content["compiled"]
    with mpl.rc_context(SVG_RC):
        height = 0.22 * len(names) + 0.75
        figure = Figure(figsize=(8.6, height))
        panel = figure.add_axes((0.2, 0.5 / height, 0.68, 1.0 - 0.55 / height))
        panel.set_xscale("log")
        low = 0.5 * min(times.values())
        for row, name in enumerate(names):
            colour = line_style(name)["color"]
            hollow = {"qp": colour, "closed": "white", "peer": "#CCCCCC"}[kind(name)]
            panel.plot([low, times[name]], [row, row], color=colour, linewidth=1.0)
            panel.plot(times[name], row, "o", color=colour, markerfacecolor=hollow, ms=6, zorder=3)
            panel.annotate(
                time_in_code(times[name], compiled[name]), (times[name], row), va="center",
                xytext=(7, 0), textcoords="offset points", fontsize=8,
            )  # fmt: skip
        panel.set_xlim(low, 2.0 * max(times.values()))
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set_yticks(np.arange(len(names)), names)
        panel.set_ylim(len(names) - 0.4, -0.6)
        panel.grid(visible=False, axis="y")
        panel.set_xlabel("µs a waypoint")
    caption = (
        "Wall time for each waypoint, all its iterations and the kinematics included: filled for "
        "QPs of this package, open for closed forms, grey for other libraries' steps. Times with a "
        "* are of compiled code, the others of Python; only those of one kind compare. One run on "
        "one machine; the plan of qp_planned is made before and not counted."
    )
    svg = inline_svg(figure, "times", caption)
    return ReportSection("times", "Step times", figure_html(svg, caption))


def _row(name: str, numbers: Mapping[str, Any], compiled: float, more: Sequence[str]) -> str:
    first = numbers["first_violation"]
    where = ", ".join(f"{joint} at {waypoint}" for joint, waypoint in first.items())
    margin = numbers["min_margin"]
    position, axis = numbers["position_error_max_m"], numbers["axis_error_max_rad"]
    cells = [
        _cell(f"left: {where}" if first else "kept", bad=bool(first), good=not first),
        _cell("–" if margin is None else f"{margin:.3f}", bad=margin is not None and margin < 0.0),
        _cell(significant(numbers["mean_z"])),
        _cell(significant(1e3 * position), bad=position > TASK_MET_M),
        _cell(significant(math.degrees(axis)), bad=axis > TASK_MET_RAD),
        _cell(whole(numbers["travel_deg"])),
        _cell(significant(numbers["max_step_deg"], digits=2)),
        _cell(significant(numbers["sigma_min"])),
        _cell(time_in_code(numbers["time_per_waypoint_us"], compiled)),
    ]
    for excess in (numbers.get(key, 0.0) for key in more):
        cells.append(_cell(significant(excess), bad=excess > BAND_LEFT))
    if "min_clearance_m" in numbers:
        clearance = f"{1e3 * numbers['min_clearance_m']:.1f}"
        cells.append(_cell(clearance, bad=too_near(numbers)))
    title, what = METHODS[name].title, _KINDS[kind(name)]
    if not title.startswith(what):
        title = f"{title}, {what}"
    return (
        f'<tr class="{kind(name)}"><th scope="row">{swatch(name)} {name}'
        f"<br><small>{html.escape(title)}</small></th>"
        f"{''.join(cells)}</tr>"
    )


def _cell(text: str, *, bad: bool = False, good: bool = False) -> str:
    if bad:
        return f'<td class="bad">✗ {html.escape(text)}</td>'
    if good:
        return f'<td class="good">✓ {html.escape(text)}</td>'
    return f"<td>{html.escape(text)}</td>"
