"""``qp-twist tasks``."""

from __future__ import annotations

from qp_twist.cli import app as cli
from qp_twist.shipped import shipped_tasks, task_title


@cli.command
def tasks(json_: cli.Json = False) -> None:
    """List the shipped task files, one per line."""
    paths = shipped_tasks()
    if json_:
        facts = [{"task": p.stem, "title": task_title(p), "file": str(p.resolve())} for p in paths]
        cli.show_json(facts)
        return
    width = max(len(path.stem) for path in paths)
    for path in paths:
        cli.say(f"{path.stem:<{width}}  {task_title(path)}")
