"""``qp-twist tasks``."""

from __future__ import annotations

from qp_twist.cli.app import app, say
from qp_twist.paths import shipped_tasks, task_title


@app.command
def tasks() -> None:
    """List the shipped task files, one per line."""
    paths = shipped_tasks()
    width = max(len(path.stem) for path in paths)
    for path in paths:
        say(f"{path.stem:<{width}}  {task_title(path)}")
