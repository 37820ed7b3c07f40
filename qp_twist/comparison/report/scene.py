"""The scene in 3D, with one method on the left and another on the right."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path

from qp_twist.comparison.report.section import ReportSection
from qp_twist.following import Trajectory
from qp_twist.paths import METHODS, PathTask
from qp_twist.pictures.player import player_data, still
from qp_twist.pictures.recordings import frames_of, recordings


def scene_section(
    path_task: PathTask, trajectories: Mapping[str, Trajectory], picture: Path | None
) -> ReportSection:
    """Two players with a selector each, and a still picture for print."""
    names = list(trajectories)
    left, right = _first_pair(names)
    views = _view("left", names, left) + (_view("right", names, right) if right else "")
    found = recordings(path_task, {name: frames_of(t.q) for name, t in trajectories.items()})
    picture_html = "" if picture is None else _printed(picture, path_task.name)
    lit = (
        " Orange: bodies that are near each other; red: nearer than the task allows."
        if path_task.clearances
        else ""
    )
    note = (
        '<p class="screen-only">The red line is the path. Drag to turn, scroll to come closer; the '
        "bar below a picture plays, stops and scrubs. A change of method starts both from the "
        f"beginning.{lit}</p>"
    )
    print_note = '<p class="print-only">The animated scene is in the page itself.</p>'
    body = (
        f'{note}<div class="views screen-only">{views}</div>{picture_html}{print_note}'
        f"{player_data(found)}"
    )
    return ReportSection("scene", "The arm along the path", body)


def _first_pair(names: list[str]) -> tuple[str, str | None]:
    """A closed form and its QP, the paper's own if it ran."""
    for closed in ("twa", *names):
        counterpart = METHODS[closed].counterpart
        if closed in names and counterpart in names and not METHODS[closed].constrained:
            return closed, counterpart
    return names[0], names[1] if len(names) > 1 else None


def _view(side: str, names: list[str], chosen: str) -> str:
    options = "".join(
        f'<option value="{name}"{" selected" if name == chosen else ""}>'
        f"{name} – {html.escape(METHODS[name].title)}</option>"
        for name in names
    )
    return (
        f'<div class="view"><label>Method at the {side} '
        f'<select class="view-method">{options}</select></label>'
        f'<iframe title="The arm moving along the path, {side}" loading="lazy"></iframe></div>'
    )


def _printed(picture: Path, name: str) -> str:
    text = f"The robot at the start of {name}, and the path."
    caption = html.escape(text)
    return (
        f'<figure class="print-only">{still(picture, text)}'
        f"<figcaption>{caption}</figcaption></figure>"
    )
