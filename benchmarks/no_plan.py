"""Whether a study's samples without a plan have none by an independent search, too.

    python benchmarks/no_plan.py out/random [--jobs 2] [--roll-step 2] [--text table.txt]

Reads a study of `qp_planned` on `deburring`. For every sample that has a motion from some start
but no plan from its own, the search of examples/placements.py goes from there layer by layer
through all in-limit joint positions at rolls so many degrees apart, and says at which waypoint it
ends. It shares nothing with the plan but the task; about two seconds a sample. What it found is
kept in no_plan.json beside the results.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

from placements import InverseKinematics, dead_end
from publishing import publish

import qp_twist as qt
from qp_twist.files import write_atomically
from qp_twist.studies import Study


def ends_at(folder: Path, roll_step: float, sample: int) -> int | None:
    """Waypoint, from 1, that the search does not get to; None if it gets to all."""
    task = Study.open(folder, qt.load_task("deburring")).sample(sample).path_task
    return dead_end(task, InverseKinematics(task), task.start, roll_step=roll_step)


def rows_of(folder: Path) -> list[dict[str, Any]]:
    study = Study.open(folder, qt.load_task("deburring"))
    columns = ["sample", "method", "success", "feasible", "fault", "min_margin", "max_step_deg",
               "position_error_max_m", "z_over_least"]  # fmt: skip
    return [r for r in study.table(columns).to_pylist() if r["method"] == "qp_planned"]


def text_of(rows: list[dict[str, Any]], found: dict[int, int | None]) -> str:
    feasible = [row for row in rows if row["feasible"]]
    done = [row for row in feasible if row["success"]]
    no_plan = [row for row in feasible if row["fault"] == "no plan"]
    other = Counter(row["fault"] for row in feasible if not row["success"])
    del other["no plan"]
    none = sum(found[row["sample"]] is not None for row in no_plan)
    planned = len(feasible) - len(no_plan)
    lines = [
        f"{len(rows):5,} random placements, each with a random start inside the limits",
        f"{len(feasible):5,} of them have a motion from some start",
        f"{planned:5,} of these have a plan from their own start",
        f"{len(done):5,} of those are followed to the end: {100 * len(done) / planned:.1f} %",
        f"{len(no_plan):5,} have no plan from their own start; for {none:,} of these the "
        "independent search has no way either",
    ]
    if other:
        faults = ", ".join(f"{count} {fault}" for fault, count in other.items())
        lines.append(f"      other faults: {faults}")
    lines += [
        "",
        f"of the runs followed: least margin {min(r['min_margin'] for r in done):.1g}, largest "
        f"step {max(r['max_step_deg'] for r in done):.2f}°, largest error "
        f"{max(r['position_error_max_m'] for r in done):.0e} m",
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--roll-step", type=float, default=2.0)
    parser.add_argument("--text", type=Path)
    given = parser.parse_args()
    rows = rows_of(given.folder)
    kept = given.folder / "no_plan.json"
    found: dict[int, int | None] = {}
    if kept.exists():
        found = {int(k): v for k, v in json.loads(kept.read_text("utf-8")).items()}
    missing = [
        r["sample"] for r in rows
        if r["feasible"] and r["fault"] == "no plan" and r["sample"] not in found
    ]  # fmt: skip
    with ProcessPoolExecutor(given.jobs) as pool:
        ends = pool.map(partial(ends_at, given.folder, given.roll_step), missing)
        for number, (sample, end) in enumerate(zip(missing, ends, strict=True), start=1):
            found[sample] = end
            print(f"\r{number} of {len(missing)}", end="", file=sys.stderr, flush=True)
            write_atomically(kept, json.dumps(found))
    publish(text_of(rows, found), given.text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
