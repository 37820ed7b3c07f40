"""``qp-twist run``."""

from __future__ import annotations

from qp_twist.cli.app import File, MethodName, Solver, Task, app, say
from qp_twist.cli.progress import method_progress
from qp_twist.comparison import metrics
from qp_twist.errors import InvalidInput
from qp_twist.following import follow
from qp_twist.path import check_method, load_task


@app.command
def run(task: Task, out: File, method: MethodName = "qp", solver: Solver = "daqp") -> None:
    """Follow a task with one method and write the joint trajectory as CSV.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        out: File to write, e.g. trajectory.csv.
        method: Method name.
        solver: Backend of the QPs.
    """
    path_task = load_task(task)
    check_method(method)
    if out.suffix.lower() != ".csv":
        raise InvalidInput(f"--out {out}: expected a file that ends in .csv.")
    with method_progress([method], len(path_task.waypoints) - 1) as progress:
        trajectory = follow(
            path_task,
            method,
            solver=solver,
            progress=lambda done: progress.done(method, done),
            planning=progress.planning,
        )
    trajectory.save(out)
    said = f"wrote {out}: {len(trajectory.q)} waypoints, {method}: {trajectory.summary}"
    status = metrics(trajectory)["status"]
    for line in (said, *([f"{method}: {status}"] if status != "ok" else [])):
        say(line)
