"""The command ``qp-twist``.

Exit codes: 0 done; 2 the input was refused (the message says why); 130 interrupted.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import mink
import tyro
from rich.console import Console
from tyro.extras import SubcommandApp

from qp_twist.cli.progress import method_progress, working
from qp_twist.comparison import compare as compare_methods
from qp_twist.comparison import metrics, notes, rich_table
from qp_twist.comparison.joint_figure import save_figure
from qp_twist.comparison.roadmap_figure import check_applies, roadmap_figure
from qp_twist.comparison.table import WIDTH
from qp_twist.errors import InvalidInput
from qp_twist.following import follow
from qp_twist.path import PathTask, check_method, load_task, shipped_tasks, task_title

app = SubcommandApp()

Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
Names = Annotated[str | None, tyro.conf.arg(metavar="A,B,…")]
MethodName = Annotated[str, tyro.conf.arg(metavar="NAME")]
Solver = Annotated[str, tyro.conf.arg(metavar="NAME")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]


@app.command
def tasks() -> None:
    """List the task files that are shipped, a line each."""
    console = _console()
    paths = shipped_tasks()
    width = max(len(path.stem) for path in paths)
    for path in paths:
        console.print(f"{path.stem:<{width}}  {task_title(path)}", highlight=False, soft_wrap=True)


@app.command
def compare(task: Task, methods: Names = None, solver: Solver = "daqp", out: Folder = None) -> None:
    """Run methods side by side on a task; print the table, write figures and comparison.json.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        methods: Method names separated by commas; without it all that apply.
        solver: Backend of the QPs, e.g. daqp, proxqp, osqp.
        out: Folder to write to; without it out/TASK.
    """
    path_task = load_task(task)
    names = _method_names(path_task, methods)
    if out is not None and out.exists() and not out.is_dir():
        raise InvalidInput(f"--out {out}: this is a file; give a folder to write to.")
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        comparison = compare_methods(path_task, names, solver=solver, progress=progress)
    console = _console()
    content = comparison.to_dict()
    console.print(rich_table(content))
    for line in notes(content):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    with working("drawing the figures"):
        lines = comparison.report(out or Path("out") / path_task.name)
    for line in lines:
        text = f"wrote {line}" if Path(line).exists() else line
        console.print(text, highlight=False, markup=False, soft_wrap=True)


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
            path_task, method, solver=solver, progress=lambda done: progress(method, done)
        )
    trajectory.save(out)
    said = f"wrote {out}: {len(trajectory.q)} waypoints, {method}: {trajectory.summary}"
    status = metrics(trajectory)["status"]
    for line in (said, *([f"{method}: {status}"] if status != "ok" else [])):
        _console().print(line, highlight=False, markup=False, soft_wrap=True)


@app.command
def roadmap(
    task: Task, methods: Names = None, solver: Solver = "daqp", out: OptionalFile = None
) -> None:
    """Draw what the limits leave of the free motion along the path, with the methods over it.

    For an industrial arm with a free roll: the margin over waypoint and roll, a panel a branch. For
    a planar arm with one free degree: its self-motion manifolds, joint by joint.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        methods: Method names separated by commas; without it all that apply.
        solver: Backend of the QPs.
        out: PNG file to write; without it out/TASK/roadmap.png.
    """
    path_task = load_task(task)
    names = _method_names(path_task, methods)
    target = out or Path("out") / path_task.name / "roadmap.png"
    check_applies(path_task)
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        comparison = compare_methods(path_task, names, solver=solver, progress=progress)
    with working("evaluating the roadmap"):
        save_figure(roadmap_figure(path_task, comparison.trajectories), target)
    _console().print(f"wrote {target}", highlight=False, markup=False, soft_wrap=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of ``qp-twist``."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal that has no θ shows a question mark instead of a stack trace.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        app.cli(
            prog="qp-twist",
            description="QP-based task-priority control for tasks of fewer than six degrees of "
            "freedom, beside its closed forms.",
            args=arguments,
        )
    except (mink.MinkError, OSError) as error:
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("qp-twist: interrupted; files that were written before are whole.", file=sys.stderr)
        raise SystemExit(130) from None


def _method_names(path_task: PathTask, methods: str | None) -> list[str]:
    if methods is None:
        return path_task.method_names()
    return [check_method(name.strip()) for name in methods.split(",")]


def _console() -> Console:
    """A console that never squeezes the table: better a wrapped line than numbers cut off."""
    console = Console()
    if not console.is_terminal:
        return Console(width=WIDTH, color_system=None)
    return console if console.width >= WIDTH else Console(width=WIDTH)
