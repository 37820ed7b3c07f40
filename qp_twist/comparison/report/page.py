"""The sections put together into one page."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from qp_twist.comparison.findings import MethodRun, by_topic
from qp_twist.comparison.report.along_path import (
    centring_section,
    error_section,
    singular_section,
    speed_section,
)
from qp_twist.comparison.report.clearance import clearance_section
from qp_twist.comparison.report.joints import joints_section
from qp_twist.comparison.report.numbers import glance_section, table_section, times_section
from qp_twist.comparison.report.provenance import provenance_section
from qp_twist.comparison.report.scene import scene_section
from qp_twist.comparison.report.section import Choice, ReportSection, shown_first
from qp_twist.comparison.report.swatch import swatch
from qp_twist.following import Trajectory
from qp_twist.paths import METHODS, PathTask
from qp_twist.pictures.figure_html import figure_html
from qp_twist.pictures.player import SCRIPT
from qp_twist.pictures.svg import inline_svg
from qp_twist.pictures.template import filled

_FOLDER = Path(__file__).parent


def report_page(
    path_task: PathTask,
    content: Mapping[str, Any],
    trajectories: Mapping[str, Trajectory],
    *,
    roadmap: Figure | None = None,
    picture: Path | None = None,
    command: str | None = None,
) -> str:
    """The report as one HTML page that needs no network.

    Args:
        path_task: The task.
        content: Content of ``comparison.json``.
        trajectories: Trajectories by method name.
        roadmap: The roadmap figure, if there is one.
        picture: A PNG file of the scene, for print.
        command: Command that reproduces the report; if ``None``, an equivalent one.
    """
    names = list(trajectories)
    first = shown_first(names)
    numbers = content["methods"]
    runs = [MethodRun.of(trajectory) for trajectory in trajectories.values()]
    found = by_topic(runs, content.get("not_run"), content.get("mean_z_bound"))
    clearance = clearance_section(path_task, trajectories)
    sections = [
        scene_section(path_task, trajectories, picture),
        glance_section(content),
        joints_section(path_task, trajectories, numbers),
        error_section(path_task, trajectories),
        *([] if clearance is None else [clearance]),
        centring_section(path_task, trajectories),
        singular_section(path_task, trajectories),
        speed_section(path_task, trajectories),
        times_section(content),
        *([] if roadmap is None else [_roadmap_section(roadmap)]),
        table_section(content),
        _shows_section(found, names),
        provenance_section(path_task, content, command),
    ]
    return filled(
        _FOLDER / "page.html.j2",
        task=path_task.name,
        title=path_task.title,
        waypoints=len(path_task.waypoints),
        sections=sections,  # HTML already, which have escaped their input
        choices=[Choice(name, METHODS[name].title, swatch(name), name in first) for name in names],
        constrained={name: METHODS[name].constrained for name in names},
        style=(_FOLDER / "page.css").read_text("utf-8"),
        script=(_FOLDER / "page.js").read_text("utf-8") + SCRIPT.read_text("utf-8"),
    )


def _shows_section(found: Mapping[str, Sequence[str]], names: list[str]) -> ReportSection:
    """The sentences that are computed from the numbers, by topic."""
    items = ""
    for topic, sentences in found.items():
        marked = [_marked(sentence, names) for sentence in sentences]
        said = f"<p>{marked[0]}</p>"
        if len(marked) > 1:
            said = f"<ul>{''.join(f'<li>{sentence}</li>' for sentence in marked)}</ul>"
        items += f"<dt>{html.escape(topic)}</dt><dd>{said}</dd>"
    return ReportSection("shows", "What this shows", f'<dl class="findings">{items}</dl>')


def _roadmap_section(figure: Figure) -> ReportSection:
    caption = "What the limits leave of the free motion along the path, with all methods over it."
    svg = inline_svg(figure, "roadmap", caption)
    return ReportSection("roadmap", "Roadmap", figure_html(svg, caption))


def _marked(sentence: str, names: list[str]) -> str:
    """A sentence as HTML, with the methods' names marked."""
    words = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    return re.sub(rf"(?<![\w-])({words})(?![\w-])", r"<code>\1</code>", html.escape(sentence))
