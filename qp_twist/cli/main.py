"""The command ``qp-twist``.

Exit codes: 0 done; 2 the input was refused (the message says why); 130 interrupted.
"""

from __future__ import annotations

import dataclasses
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, cast

import mink
import tyro
from rich.console import Console
from tyro.extras import SubcommandApp

from qp_twist.cli.progress import method_progress, sample_progress, working
from qp_twist.comparison import compare as compare_methods
from qp_twist.comparison import metrics, notes, rich_table
from qp_twist.comparison.joint_figure import save_figure
from qp_twist.comparison.roadmap_figure import check_applies, roadmap_figure
from qp_twist.comparison.table import WIDTH
from qp_twist.errors import InvalidInput
from qp_twist.following import follow
from qp_twist.path import PathTask, check_method, load_task, shipped_tasks, task_title
from qp_twist.studies import Start, Study
from qp_twist.studies import study as run_study
from qp_twist.studies.summary import rich_table as rich_study_table

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
        _console().print(str(drawn), highlight=False, markup=False, soft_wrap=True)
    names = _method_names(path_task, methods)
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
def study(
    task: Task,
    vary: Annotated[str, tyro.conf.arg(metavar="A,B,…")] = "placement",
    samples: Annotated[int, tyro.conf.arg(metavar="N")] = 1000,
    methods: Names = None,
    out: Folder = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    solver: Solver = "daqp",
    start: Annotated[str, tyro.conf.arg(metavar="HOW")] = "auto",
    certify: bool = True,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
) -> None:
    """Run methods on many samples of a task; print how often each succeeds, and why it fails.

    What varies, and in which ranges, is said by the task file's [study]. Results stream to Parquet
    files; the same command again goes on where it was stopped.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        vary: What varies, separated by commas: placement, tool, robot, gain, solver, start.
        samples: How many.
        methods: Method names separated by commas; without it all that apply.
        out: Folder to write to; without it out/TASK_study.
        seed: Instead of the task file's.
        solver: Backend of the QPs, where it does not vary.
        start: Where a sample starts: task, least_z, random, best; auto chooses.
        certify: Where no method succeeds, let a plan decide whether there is a motion.
        jobs: Processes; without it one a core.
        scheduler: Address of a Dask scheduler, e.g. tcp://host:8786; its workers are taken instead.
    """
    path_task = load_task(task)
    folder = out or Path("out") / f"{path_task.name}_study"
    with sample_progress(samples) as progress:
        found = run_study(
            path_task,
            [name.strip() for name in vary.split(",")],
            samples,
            _method_names(path_task, methods),
            out=folder,
            seed=seed,
            solver=solver,
            start=cast(Start, start),
            certify=certify,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
        )
    with working("drawing the figures"):
        lines = [str(found.folder / "results.parquet"), *found.report()]
    console = _console()
    console.print(rich_study_table(found.title, found.summary()))
    console.print(found.feasibility, highlight=False, markup=False, soft_wrap=True)
    for line in lines:
        console.print(f"wrote {line}", highlight=False, markup=False, soft_wrap=True)


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
        comparison = compare_methods(
            path_task, names, solver=solver, progress=progress.done, planning=progress.planning
        )
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
