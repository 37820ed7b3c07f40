"""``qp-twist tasks``."""

from __future__ import annotations

import json

from qp_twist.cli.app import Json, app, say
from qp_twist.shipped import shipped_tasks, task_title


@app.command
def tasks(json_: Json = False) -> None:
    """List the shipped task files, one per line.

    Args:
        json_: Print names, titles and files as JSON.
    """
    paths = shipped_tasks()
    if json_:
        facts = [{"task": p.stem, "title": task_title(p), "file": str(p.resolve())} for p in paths]
        print(json.dumps(facts, ensure_ascii=False, indent=2))
        return
    width = max(len(path.stem) for path in paths)
    for path in paths:
        say(f"{path.stem:<{width}}  {task_title(path)}")
