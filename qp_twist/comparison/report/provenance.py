"""Methods, versions, and the command that reproduces the report."""

from __future__ import annotations

import html
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from qp_twist.comparison.report.section import ReportSection
from qp_twist.comparison.report.swatch import swatch
from qp_twist.paths import METHODS, PathTask, shipped_tasks

_PACKAGES = ("qp_twist", "mujoco", "mink", "qpsolvers", "numpy", "scipy")


def provenance_section(
    path_task: PathTask, content: Mapping[str, Any], command: str | None
) -> ReportSection:
    """Methods with their parameters, versions, and the command that reproduces this report."""
    settings: Mapping[str, Mapping[str, Any]] = content["settings"]
    keys = list(next(iter(settings.values())))
    heads = "".join(f'<th scope="col">{key.replace("_", " ")}</th>' for key in keys)
    rows = "".join(
        f'<tr><th scope="row">{swatch(name)} {name}<br><small>{html.escape(METHODS[name].title)}'
        f"</small></th>{''.join(f'<td>{_shown(name, key, value)}</td>' for key in keys)}</tr>"
        for name, value in settings.items()
    )
    projectors = ", then ".join(str(t.rank) for t in path_task.projectors)
    facts = {
        "task": path_task.name,
        "waypoints": str(len(path_task.waypoints)),
        "rank of T": f"{projectors} of {path_task.operational.rank} operational directions",
        "joints": str(path_task.model.nv),
        "QPs solved by": content["solver"],
        **_versions(content["solver"]),
    }
    items = "".join(
        f"<dt>{html.escape(key)}</dt><dd>{html.escape(value)}</dd>" for key, value in facts.items()
    )
    again = command or _command(path_task, content)
    body = (
        f'<p>Once more:</p><pre tabindex="0"><code>{html.escape(again)}</code></pre>'
        '<div class="scroll" tabindex="0" role="region" aria-label="Parameters of the methods">'
        f'<table class="plain wide"><thead><tr><th scope="col">method</th>{heads}</tr></thead>'
        f'<tbody>{rows}</tbody></table></div><dl class="facts">{items}</dl>'
    )
    return ReportSection("methods", "Methods, parameters, versions", body)


def _shown(name: str, key: str, settings: Mapping[str, Any]) -> str:
    """A setting as text; a dash if the method does not use it."""
    secondary, peer = settings["secondary"], bool(METHODS[name].peer)
    matters = {
        "weight": secondary == "centering",
        "gain": secondary != "none",
        "objective": secondary == "plan",
        "optimal": name == "sns",
        "posture_cost": peer,
        "every_iteration": peer,
    }
    if not matters.get(key, True):
        return "–"
    value = settings[key]
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else html.escape(str(value))


def _versions(solver: str) -> dict[str, str]:
    found = {"Python": platform.python_version()}
    for package in (*_PACKAGES, solver):
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # a backend with another package name
            continue
    return found


def _command(path_task: PathTask, content: Mapping[str, Any]) -> str:
    """The command line; for a task built in Python, the call."""
    names = ",".join([*content["methods"], *content.get("not_run", {})])
    shipped = path_task.source in shipped_tasks()
    if path_task.source is None:
        return f'qt.compare(path_task, methods="{names}".split(","), solver="{content["solver"]}")'
    task = path_task.name if shipped else str(path_task.source)
    return f"qp-twist compare {task} --methods {names} --solver {content['solver']}"
