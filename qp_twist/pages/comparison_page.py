"""The report of a comparison: methods side by side in one self-contained page."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qp_twist import __version__
from qp_twist.checks import Array
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
from qp_twist.pages.tables import TIME, Cell, Table
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

    Args:
        path_task: The task.
        trajectories: Trajectories by method name.
        content: Content of ``comparison.json``.
        faults: What each method did not keep, in a few words; empty if it kept all.
        findings: What the comparison shows: sentences by topic.
        table: The table of metrics.
        roadmap: The roadmap figure, if there is one.
        picture: The scene, for print.
        command: Command that reproduces the report; if ``None``, an equivalent one.
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
    return fill_template(
        "comparison",
        script="comparison.js",
        task=path_task,
        methods={name: _method(name, shown=name in first) for name in names},
        players=_first_pair(names),
        scene=recorded_scene(path_task, {name: _frames(t.q) for name, t in trajectories.items()}),
        picture="" if picture is None else still_html(picture, 800),
        picture_text="" if picture is None else picture.text,
        faults=faults,
        charts=charts,
        floor=FLOOR,
        pairs=sum(len(clearance.pairs) for clearance in path_task.clearances),
        asked=sorted({1e3 * clearance.distance for clearance in path_task.clearances}),
        nearest=_nearest_table(trajectories),
        no_speeds="no feed" if path_task.durations is None else "no joint speed limits",
        fastest=_fastest_table(trajectories),
        times=_times(content, table),
        table=table,
        bodies=[list(pair) for _, pair in groupby(names, key=lambda name: METHODS[name].qp)],
        remarks={n: m["status"] for n, m in content["methods"].items() if m["status"] != "ok"},
        findings=findings,
        command=command or f"qt.compare(path_task, {[*names, *content.get('not_run', {})]})",
        settings=_settings_table(path_task, content),
        facts=_facts(path_task, content),
    )


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


def _frames(q: Array) -> Array:
    """About ``_FRAMES`` of the configurations (N, nq), the first and the last included."""
    frames: Array = q[np.linspace(0, len(q) - 1, min(len(q), _FRAMES)).round().astype(int)]
    return frames


def _times(content: Mapping[str, Any], table: Table) -> list[tuple[str, str, float]]:
    """Name, time a waypoint, and its place on a logarithmic scale, %."""
    times = {n: numbers["time_per_waypoint_us"] for n, numbers in content["methods"].items()}
    low, high = 0.5 * min(times.values()), max(times.values())
    return [
        (name, table.of(name, TIME).text, 100.0 * float(np.log(time / low) / np.log(high / low)))
        for name, time in times.items()
    ]


def _nearest_table(trajectories: Trajectories) -> Table:
    """The nearest pair of each method, at and between waypoints."""
    rows = {}
    for name, trajectory in trajectories.items():
        if trajectory.nearest is None:
            continue
        clearance, (distance, at, pair) = trajectory.nearest
        kept = trajectory.path_task.tolerances.keeps_clear(distance, clearance.distance)
        words = "kept" if kept else "overlap" if distance < 0.0 else "too near"
        rows[name] = [
            Cell(pair), Cell(f"{1e3 * distance:.1f}".replace("-", "−")), Cell(f"{at + 1.0:.1f}"),
            Cell(words, "good" if kept else "bad"),
        ]  # fmt: skip
    return Table(["pair", "distance mm", "waypoint", "clearance"], rows)


def _fastest_table(trajectories: Trajectories) -> Table:
    """The joint of each method that is nearest to its speed limit."""
    peaks = {name: peak_speed(trajectory) for name, trajectory in trajectories.items()}
    rows = {
        name: [
            Cell(peak.joint), Cell(str(peak.waypoint)), Cell(f"{100.0 * peak.share:.3g} %"),
            Cell("too fast", "bad") if peak.share > OVER else Cell("yes", "good"),
        ]
        for name, peak in peaks.items()
        if peak is not None
    }  # fmt: skip
    return Table(["joint", "waypoint", "speed ÷ limit", "within limit"], rows)


def _settings_table(path_task: PathTask, content: Mapping[str, Any]) -> Table:
    """The settings of each method; a dash for what it does not use."""
    settings: Mapping[str, Mapping[str, Any]] = content["settings"]
    keys = list(next(iter(settings.values())))
    rows = {}
    for name, values in settings.items():
        unused = METHODS[name].unused(path_task.settings(name))
        rows[name] = [Cell("–" if key in unused else _text(values[key])) for key in keys]
    return Table([key.replace("_", " ") for key in keys], rows)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _facts(path_task: PathTask, content: Mapping[str, Any]) -> dict[str, str]:
    projectors = ", then ".join(str(t.rank) for t in path_task.projectors)
    facts = {
        "task": path_task.name,
        "waypoints": str(len(path_task.waypoints)),
        "rank of T": f"{projectors} of {path_task.operational.rank} operational directions",
        "joints": str(path_task.model.nv),
        "QPs solved by": content["solver"],
        "Python": platform.python_version(),
        "qp_twist": __version__,
    }
    for package in (*_PACKAGES, content["solver"]):
        try:
            facts[package] = version(package)
        except PackageNotFoundError:  # a backend with another package name
            continue
    return facts
