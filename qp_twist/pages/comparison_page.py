"""The report of a comparison: methods side by side in one self-contained page."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qp_twist import __version__
from qp_twist.drawing import Picture
from qp_twist.drawing.figures import inline_svg
from qp_twist.following.joint_speeds import OVER, peak_speed
from qp_twist.pages.comparison_charts import (
    FLOOR,
    Trajectories,
    joint_figure,
    quantities,
    quantity_html,
)
from qp_twist.pages.method_style import kind, swatch
from qp_twist.pages.page import figure_html, fill_template, still_html
from qp_twist.pages.recordings import recorded_scene
from qp_twist.pages.tables import TIME, Table
from qp_twist.paths import METHODS, PathTask

_PACKAGES = ("mujoco", "mink", "qpsolvers", "numpy", "scipy")
_KINDS = {"closed": "closed form", "peer": "another library's step", "qp": "QP"}
_FIRST_SHOWN = ("gradient_projection", "qp_gradient", "twa", "qp", "qp_planned")
"""Methods in the figures when the page opens; with fewer than three of them, all that ran."""
_JOINTS = (
    "Joint positions; the limits are the red lines. A red cross with its waypoint marks where a "
    "method first leaves a joint's limits, a triangle on the axis a step above 15°."
)
_ROADMAP = "What the limits leave of the free motion along the path, with all methods over it."
_FRAMES = 100
"""Approximate number of waypoints that the moving scene shows."""


def comparison_page(
    path_task: PathTask,
    trajectories: Trajectories,
    content: Mapping[str, Any],
    *,
    faults: Mapping[str, str],
    findings: Mapping[str, Sequence[str]],
    table: Table,
    roadmap: Figure | None = None,
    picture: Picture | None = None,
    command: str | None = None,
) -> str:
    """The report as one HTML page that needs no network.

    ``content`` is that of ``comparison.json``; ``faults`` says of each method what it did not keep,
    ``findings`` are sentences by topic; without a ``command`` an equivalent call is shown.
    """
    names = list(trajectories)
    few = [name for name in _FIRST_SHOWN if name in names]
    first = few if len(few) > 2 and len(names) > 5 else names
    charts = {
        section: "".join(quantity_html(path_task, trajectories, quantity) for quantity in drawn)
        for section, drawn in quantities(path_task, trajectories).items()
    }
    joints = joint_figure(path_task, trajectories, content["methods"])
    for key, figure, caption in (("joints", joints, _JOINTS), ("roadmap", roadmap, _ROADMAP)):
        svg = "" if figure is None else inline_svg(figure, key, caption)
        charts[key] = svg and figure_html(svg, caption)
    frames = {
        name: t.q[np.linspace(0, len(t.q) - 1, min(len(t.q), _FRAMES)).round().astype(int)]
        for name, t in trajectories.items()
    }
    return fill_template(
        "comparison", script="comparison.js", task=path_task,
        methods={name: _method(name, shown=name in first) for name in names},
        players=_first_pair(names), scene=recorded_scene(path_task, frames),
        picture="" if picture is None else still_html(picture, 800),
        picture_text="" if picture is None else picture.text, faults=faults, charts=charts,
        floor=FLOOR, pairs=sum(len(clearance.pairs) for clearance in path_task.clearances),
        asked=sorted({1e3 * clearance.distance for clearance in path_task.clearances}),
        trajectories=trajectories,
        no_speeds="no feed" if path_task.durations is None else "no joint speed limits",
        fastest={n: peak for n, t in trajectories.items() if (peak := peak_speed(t))}, over=OVER,
        times=_times(content, table), table=table,
        bodies=[list(pair) for _, pair in groupby(names, key=lambda name: METHODS[name].qp)],
        remarks={n: m["status"] for n, m in content["methods"].items() if m["status"] != "ok"},
        findings=findings,
        command=command or f"qt.compare(path_task, {[*names, *content.get('not_run', {})]})",
        settings={name: path_task.settings(name) for name in names},
        facts=_facts(path_task, content),
    )  # fmt: skip


def _method(name: str, *, shown: bool) -> dict[str, Any]:
    """What the page has of a method; ``shown``: whether it is when the page opens."""
    title, what = METHODS[name].title, _KINDS[kind(name)]
    return {
        "title": title,
        "kind": kind(name),
        "kind_title": title if title.startswith(what) else f"{title}, {what}",
        "swatch": swatch(name),
        "shown": shown,
    }


def _first_pair(names: list[str]) -> list[str]:
    """A closed form and its QP, the paper's own if it ran: what the two players show first."""
    for closed in ("twa", *names):
        counterpart = METHODS[closed].counterpart
        if closed in names and counterpart in names and not METHODS[closed].constrained:
            return [closed, counterpart]
    return names[:2]


def _times(content: Mapping[str, Any], table: Table) -> list[tuple[str, str, float]]:
    """Name, time a waypoint, and its place on a logarithmic scale, %."""
    times = {n: numbers["time_per_waypoint_us"] for n, numbers in content["methods"].items()}
    low, high = 0.5 * min(times.values()), max(times.values())
    return [
        (name, table.of(name, TIME).text, 100.0 * float(np.log(time / low) / np.log(high / low)))
        for name, time in times.items()
    ]


def _facts(path_task: PathTask, content: Mapping[str, Any]) -> dict[str, str]:
    projectors = ", then ".join(str(t.rank) for t in path_task.projectors)
    return {
        "task": path_task.name, "waypoints": str(len(path_task.waypoints)),
        "rank of T": f"{projectors} of {path_task.operational.rank} operational directions",
        "joints": str(path_task.model.nv), "QPs solved by": content["solver"],
        "Python": platform.python_version(), "qp_twist": __version__,
        **{package: version(package) for package in _PACKAGES},
    }  # fmt: skip
