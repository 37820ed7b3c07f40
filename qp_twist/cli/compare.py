"""``qp-twist compare``."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load, method_names, with_secondary
from qp_twist.cli.progress import load_machine_code, method_progress, working
from qp_twist.comparison import Comparison, Interrupted, csv_table, notes, rich_table
from qp_twist.comparison import compare as compare_methods
from qp_twist.errors import InvalidInput
from qp_twist.studies import Study


@cli.command
def compare(
    task: cli.Task,
    methods: cli.Names = None,
    solver: cli.Solver = None,
    gain: cli.Gain = None,
    weight: cli.Weight = None,
    out: cli.Folder = None,
    path: cli.OptionalFile = None,
    json: cli.Flag = False,
    csv: cli.Flag = False,
    sample: cli.OptionalCount = None,
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="DIR")] = None,
) -> None:
    """Compare methods on a task; print the table, write report.html, figures and numbers.

    Args:
        solver: Backend of the QPs, e.g. proxqp, osqp; if omitted, the study's, or machine code.
        out: Folder to write to; if omitted, out/TASK, with --json or --csv none.
        json: Print only the content of comparison.json.
        csv: Print only the metrics as CSV, one row per method.
        sample: Number of a study's sample to repeat, with the study's methods and backend.
        from_: Folder of that study.
    """
    if json and csv:
        raise InvalidInput("--json and --csv: both go to standard output; give one of them.")
    path_task = load(task, path)
    if (sample is None) != (from_ is None):
        raise InvalidInput("--sample N and --from DIR belong together: a sample of a study.")
    if sample is not None and from_ is not None:
        drawn = Study.open(from_, path_task).sample(sample)
        path_task, solver = drawn.path_task, solver or drawn.solver
        path_task = dataclasses.replace(path_task, name=f"{path_task.name}_{sample}")
        methods = methods or ",".join(drawn.methods)
        if not (json or csv):
            cli.say(str(drawn))
    names = method_names(path_task, methods)
    path_task = with_secondary(path_task, names, gain, weight)
    folder = out or (None if json or csv else Path("out") / path_task.name)
    if folder is not None:
        cli.check_folder(folder)
    try:
        load_machine_code(path_task, names, solver)
        with method_progress(names, len(path_task.waypoints) - 1) as progress:
            comparison = compare_methods(
                path_task,
                names,
                solver=solver,
                progress=progress.done,
                planning=progress.planning,
            )
    except Interrupted as interrupted:
        comparison = interrupted.comparison
        _print(comparison, json=json, csv=csv)
        written = [] if folder is None else comparison.save(folder)
        if not (json or csv):
            cli.say(*_kept(comparison, len(names)), *(f"wrote {line}" for line in written))
        raise
    _print(comparison, json=json, csv=csv)
    if folder is None:
        return
    typed = _command(
        task,
        methods=methods,
        solver=solver,
        gain=gain,
        weight=weight,
        path=path,
        sample=sample,
        **{"from": from_},
        out=out,
    )
    with working("drawing the figures, writing the report"):
        lines = comparison.report(folder, command=typed)
    if not (json or csv):
        cli.say(*(f"wrote {line}" if Path(line).exists() else line for line in lines))


def _print(comparison: Comparison, *, json: bool, csv: bool) -> None:
    """Print the metrics: as JSON, as CSV, or as a table with notes."""
    content = comparison.to_dict()
    if json or csv:
        sys.stdout.write(comparison.to_json() if json else csv_table(content))
    else:
        cli.show(rich_table(content))
        cli.say(*notes(content))


def _kept(comparison: Comparison, count: int) -> list[str]:
    """What an interrupted comparison of so many methods has, in sentences."""
    done = comparison.trajectories
    plans = {name: run.interrupted_plan for name, run in done.items()}
    return [
        *(
            f"{name}: planning was interrupted; followed is the best plan by then: {plan.result}"
            for name, plan in plans.items()
            if plan is not None
        ),
        f"interrupted: this is what {len(done)} of {count} methods came to",
    ]


def _command(task: str, **options: object) -> str:
    """The command line with the options in use."""
    words = ["qp-twist", "compare", task]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name}", str(value)]
    return shlex.join(words)
