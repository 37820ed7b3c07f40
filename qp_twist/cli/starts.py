"""``qp-twist starts``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load
from qp_twist.cli.progress import progress_bar
from qp_twist.errors import InvalidInput
from qp_twist.following import FoundStart, find_starts
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD


@cli.command
def starts(
    task: cli.Task,
    count: cli.Count = 8,
    method: cli.MethodName = DEFAULT_METHOD,
    json_: cli.Json = False,
) -> None:
    """List possible starts: the most central configurations, and how far each run gets.

    Args:
        count: Largest number of starts.
    """
    if count < 1:
        raise InvalidInput(f"--count {count}: expected a number of at least 1.")
    path_task = load(task)
    with progress_bar(count) as report:
        found = find_starts(
            path_task, count, method=method,
            progress=lambda done, of: report(count - of + done, "starts"),
        )  # fmt: skip
    # In the order of the scene's joints, which is that of the task file.
    scene = path_task.shown
    found = [replace(start, q=scene.configurations(start.q)) for start in found]
    ranges = JointRanges.of(scene.model)
    cli.only_json(json_)
    cli.show(_table(found, ranges))
    best, degrees = found[0], bool(ranges.hinge.all())
    values = np.round(np.degrees(best.q) if degrees else best.q, 4) + 0.0
    key = "q_deg" if degrees else "q"
    cli.say("[start]", f"{key} = [{', '.join(f'{value:.10g}' for value in values)}]")
    if json_:
        cli.show_json([_facts(start, ranges) for start in found])
    if not best.completed:
        held = f": {best.stopped_by}" if best.stopped_by else ""
        cli.say(
            f"none of them leads to the end; the best stops after waypoint {best.reached}{held}"
        )
        raise SystemExit(1)


def _facts(start: FoundStart, ranges: JointRanges) -> dict[str, Any]:
    """A start, ready for JSON."""
    return {
        "q": dict(zip(ranges.names, ranges.positions(start.q).tolist(), strict=True)),
        "branch": None if start.branch is None else start.branch + 1,
        "z": float(start.z),
        "min_margin": float(start.margin) if np.isfinite(start.margin) else None,
        "sigma_min": float(start.sigma_min),
        "completed": start.completed,
        "reached": start.reached,
        "waypoints": start.waypoints,
        "stopped_by": start.stopped_by,
    }


def _table(found: list[FoundStart], ranges: JointRanges) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("", "branch", "z", "margin", "σ_min", "run"):
        table.add_column(column, justify="right")
    table.add_column(f"{', '.join(ranges.names)} [{'° or m' if not ranges.hinge.all() else '°'}]")
    for number, start in enumerate(found, start=1):
        shown = [
            f"{round(np.degrees(value), 1) + 0.0:7.1f}" if hinge else f"{value + 0.0:7.3f}"
            for value, hinge in zip(start.q, ranges.hinge, strict=True)
        ]
        table.add_row(
            str(number),
            "–" if start.branch is None else str(start.branch + 1),
            f"{start.z:.4f}",
            f"{start.margin:.2f}" if np.isfinite(start.margin) else "–",
            f"{start.sigma_min:.3f}",
            f"{start.reached}/{start.waypoints}",
            "  ".join(shown),
        )
    return table
