"""``qp-twist compare``."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Optional

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
    from_: Annotated[Optional[Path], tyro.conf.arg(name="from", metavar="DIR")] = None,
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
    cli.only_json(json or csv)
    if sample is not None and from_ is not None:
        drawn = Study.open(from_, path_task).sample(sample)
        path_task, solver = drawn.path_task, solver or drawn.solver
        path_task = dataclasses.replace(path_task, name=f"{path_task.name}_{sample}")
        methods = methods or ",".join(drawn.methods)
        cli.say(str(drawn))
    names = method_names(path_task, methods)
    path_task = with_secondary(path_task, names, gain, weight)
    folder = out or (None if json or csv else Path("out") / path_task.name)
    if folder is not None:
        cli.check_folder(folder)
    load_machine_code(path_task, names, solver)
    interrupted: Interrupted | None = None
    with method_progress(names, len(path_task.waypoints) - 1) as progress:
        try:
            comparison = compare_methods(
                path_task, names, solver=solver, progress=progress.done, planning=progress.planning
            )
        except Interrupted as ended:
            interrupted, comparison = ended, ended.comparison
    content = comparison.to_dict()
    if json or csv:
        sys.stdout.write(comparison.to_json() if json else csv_table(content))
    cli.show(rich_table(content))
    cli.say(*notes(content))
    if interrupted is not None:
        written = [] if folder is None else comparison.save(folder)
        cli.say(*_kept(comparison, len(names)), *(f"wrote {line}" for line in written))
        raise interrupted
    if folder is not None:
        with working("drawing the figures, writing the report"):
            lines = comparison.report(folder, command=cli.typed.get())
        cli.say(*(f"wrote {line}" if Path(line).exists() else line for line in lines))


def _kept(comparison: Comparison, count: int) -> list[str]:
    """What an interrupted comparison of so many methods has, in sentences."""
    done = comparison.trajectories
    return [
        *(
            f"{name}: planning was interrupted; followed is the best plan by then: "
            f"{run.interrupted_plan.result}"
            for name, run in done.items()
            if run.interrupted_plan is not None
        ),
        f"interrupted: this is what {len(done)} of {count} methods came to",
    ]
