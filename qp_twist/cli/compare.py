"""``qp-twist compare``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from qp_twist.cli.app import Folder, Names, Task, app, method_names, say, show
from qp_twist.cli.progress import method_progress, working
from qp_twist.comparison import compare as compare_methods
from qp_twist.comparison import notes, rich_table
from qp_twist.errors import InvalidInput
from qp_twist.path import load_task
from qp_twist.studies import Study


@app.command
def compare(
    task: Task,
    methods: Names = None,
    solver: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    out: Folder = None,
    sample: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="DIR")] = None,
) -> None:
    """Run methods side by side on a task; print the table, write figures and comparison.json.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        methods: Method names separated by commas; without it all that apply.
        solver: Backend of the QPs, e.g. proxqp, osqp; without it daqp, or what the study had.
        out: Folder to write to; without it out/TASK.
        sample: A sample of a study, as it was there, with the study's methods and backend.
        from_: Folder of that study.
    """
    path_task = load_task(task)
    if (sample is None) != (from_ is None):
        raise InvalidInput("--sample N and --from DIR belong together: a sample of a study.")
    if sample is not None and from_ is not None:
        drawn = Study.open(from_, path_task).sample(sample)
        path_task, solver = drawn.path_task, solver or drawn.solver
        path_task = dataclasses.replace(path_task, name=f"{path_task.name}_{sample}")
        methods = methods or ",".join(drawn.methods)
        say(str(drawn))
    names = method_names(path_task, methods)
    if out is not None and out.exists() and not out.is_dir():
        raise InvalidInput(f"--out {out}: this is a file; give a folder to write to.")
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        comparison = compare_methods(
            path_task,
            names,
            solver=solver or "daqp",
            progress=progress.done,
            planning=progress.planning,
        )
    content = comparison.to_dict()
    show(rich_table(content))
    for line in notes(content):
        say(line)
    with working("drawing the figures"):
        lines = comparison.report(out or Path("out") / path_task.name)
    for line in lines:
        text = f"wrote {line}" if Path(line).exists() else line
        say(text)
