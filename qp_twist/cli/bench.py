"""``qp-twist bench``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from qp_twist.checks import whole_number
from qp_twist.cli.app import Folder, Json, Names, OptionalFile, app, check_folder, quiet, say, show
from qp_twist.cli.progress import share_progress, working
from qp_twist.files import write_atomically


@app.command
def bench(
    out: Folder = None,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    only: Names = None,
    parts: Names = None,
    compare: OptionalFile = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    json_: Json = False,
) -> None:
    """Time steps of this package, mink, pink and PlaCo, and measure their errors; print tables.

    The contenders take turns on the same robots and trajectories. Duration: about three minutes,
    with --quick half a minute. For comparable times set OMP_NUM_THREADS=1 and run nothing else.

    Args:
        out: Folder to write to; if omitted, out/bench.
        quick: Time only a few steps.
        only: Contenders by name, or by family (step, mink, placo …), separated by commas.
        parts: Parts (steps, growth, batch), separated by commas; if omitted, all.
        compare: bench.json of an earlier run; ratios to it are printed.
        seed: Seed of the trajectories and of the order of the contenders.
        json_: Print the content of bench.json instead of the tables.
    """
    # Imported here: no other command needs it.
    from qp_twist.bench import PARTS, read_run, write_run
    from qp_twist.bench import bench as run_bench
    from qp_twist.bench.figure import draw
    from qp_twist.bench.ratios import differences
    from qp_twist.bench.tables import compared, document, sheets

    whole_number("--seed", seed, at_least=0)
    folder = out or Path("out") / "bench"
    check_folder(folder)
    before = None if compare is None else read_run(compare)
    with share_progress() as progress:
        run = run_bench(
            parts=_names(parts) if parts is not None else PARTS,
            only=None if only is None else _names(only),
            quick=quick,
            seed=seed,
            progress=progress,
        )
    shown = quiet.set(quiet.get() or json_)
    for sheet in sheets(run):
        show(sheet.rich())
    say(*run.skipped)
    if before is not None:
        show(compared(before, run).rich())
        say(*differences(before, run))
    with working("drawing the figure"):
        files = [
            write_run(run, folder / "bench.json"),
            write_atomically(folder / "bench.md", document(run)),
            draw(run, folder / "bench.svg"),
        ]
    say(*(f"wrote {file}" for file in files))
    quiet.reset(shown)
    if json_:
        print(run.model_dump_json(indent=2))


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]
