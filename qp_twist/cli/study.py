"""``qp-twist study``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional, cast

import tyro

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load, method_names
from qp_twist.cli.progress import load_machine_code, progress_bar, working
from qp_twist.errors import InvalidInput
from qp_twist.paths import PathTask
from qp_twist.studies import Start, Study
from qp_twist.studies import study as run_study
from qp_twist.studies.summary import rich_table as rich_study_table


@cli.command
def study(
    task: cli.Task,
    vary: Annotated[str, tyro.conf.arg(metavar="A,B,…")] = "placement",
    samples: cli.Count = 1000,
    methods: cli.Names = None,
    out: cli.Folder = None,
    seed: cli.OptionalCount = None,
    solver: cli.Solver = None,
    start: Annotated[str, tyro.conf.arg(metavar="HOW")] = "auto",
    certify: bool = True,
    jobs: cli.OptionalCount = None,
    scheduler: Annotated[Optional[str], tyro.conf.arg(metavar="ADDRESS")] = None,
    json_: cli.Json = False,
) -> None:
    """Run methods on many samples of a task; print how often each succeeds, and why it fails.

    The task file's [study] defines what varies, and its ranges. Results are added to a SQLite
    file; repeating the command continues an interrupted study.

    Args:
        vary: What varies, separated by commas: placement, tool, robot, gain, solver, start.
        samples: Number of samples.
        out: Folder to write to; if omitted, out/TASK_study.
        seed: Seed; if omitted, the task file's.
        solver: Backend of the QPs, if it does not vary; if omitted, machine code.
        start: Start of a sample: task, least_z, random, best; auto chooses.
        certify: If no method succeeds, let a plan decide whether the task is feasible.
        jobs: Number of processes; if omitted, one per core.
        scheduler: Address of a Dask scheduler, e.g. tcp://host:8786, whose workers are used
            instead.
    """
    path_task = load(task)
    folder = out or Path("out") / f"{path_task.name}_study"
    names = method_names(path_task, methods)
    load_machine_code(path_task, names, solver)  # once, and not in every process
    try:
        with progress_bar(samples) as report:
            found = run_study(
                path_task,
                [name.strip() for name in vary.split(",")],
                samples,
                names,
                out=folder,
                seed=seed,
                solver=solver,
                start=cast(Start, start),
                certify=certify,
                jobs=jobs,
                scheduler=scheduler,
                progress=lambda done: report(done, "samples"),
            )
    except KeyboardInterrupt:
        if not json_:
            _say_kept(folder, path_task)
        raise
    with working("drawing the figures"):
        lines = [str(found.folder / "results.sqlite"), *found.report()]
    cli.only_json(json_)
    cli.show(rich_study_table(found.title, found.summary()))
    cli.say(found.feasibility, *found.failures)
    for line in lines:
        cli.say(f"wrote {line}")
    if json_:
        cli.show_json({"files": lines, **found.to_dict()})


def _say_kept(folder: Path, path_task: PathTask) -> None:
    """What an interrupted study has."""
    try:
        kept = Study.open(folder, path_task)
        done = kept.count - len(kept.missing())
    except InvalidInput:  # it had not begun
        return
    if done:
        cli.show(rich_study_table(kept.title, kept.summary()))
        cli.say(kept.feasibility, *kept.failures)
    cli.say(
        f"interrupted: {done:,} of {kept.count:,} samples are kept in {folder}; the same command "
        "goes on from there"
    )
