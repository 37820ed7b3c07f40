"""How far a run along a plan is from the least mean z that there is.

    python benchmarks/plan_optimality.py [--samples 40] [--first 0] [--jobs 2] [--roll-step 1]
                                         [--out optimality.json] [--markdown table.md]

Places the deburring part as a study does, plans from the best start, follows the plan with
qp_planned, and compares the run's mean z with the shortest way through all in-limit joint positions
at rolls so many degrees apart. That search shares nothing with the plan: it has the inverse
kinematics of examples/placements.py, every waypoint, every branch, every full turn. A way on a grid
is never better than the best motion, so the ratio can be below 1.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

import numpy as np
from placements import MAX_STEP, InverseKinematics
from scipy.spatial import cKDTree

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.files import write_atomically
from qp_twist.studies.judge import Judge
from qp_twist.studies.sample import draw_sample, section_of

CELL = np.radians(2.0)
"""Of joint positions this near to each other the one of least z stands for all."""


def least_mean_z(task: qt.PathTask, roll_step: float) -> float:
    """Mean z of the grid's best way, no joint moving more than 15° to the next waypoint."""
    arm = InverseKinematics(task)
    rolls = np.radians(np.arange(0.0, 360.0, roll_step))
    before: Array | None = None
    sums = np.zeros(0)
    for pose in task.waypoints:
        layer = arm.layer(pose, rolls)
        z = arm.ranges.centring(layer)
        layer, z = layer[np.argsort(z)], np.sort(z)
        _, first = np.unique(np.round(layer / CELL), axis=0, return_index=True)
        layer, z = layer[first], z[first]
        if before is None:
            sums = z
        else:
            near = cKDTree(layer).query_ball_tree(cKDTree(before), MAX_STEP, p=np.inf)
            counts = np.array([len(rows) for rows in near])
            layer, z = layer[counts > 0], z[counts > 0]
            begins = np.cumsum(counts[counts > 0]) - counts[counts > 0]
            if not len(layer):
                return np.nan
            sums = z + np.minimum.reduceat(sums[np.concatenate(near).astype(np.intp)], begins)
        before = layer
    return float(sums.min()) / len(task.waypoints)


def measure(index: int, roll_step: float) -> dict[str, Any]:
    """One sample."""
    task = qt.load_task("deburring")
    task = draw_sample(task, ("placement",), index, start="best", methods=("qp_planned",)).path_task
    plan = qt.plan(task)
    if plan.q is None:
        return {"sample": index, "feasible": False}
    run = qt.follow(task, "qp_planned", plan=plan)
    return {
        "sample": index,
        "feasible": True,
        "fault": str(Judge(task, section_of(task)).fault(run) or ""),
        "mean_z": float(run.z.mean()),
        "plan": plan.value,
        "bound": plan.bound,
        "grid": least_mean_z(task, roll_step),
    }


def table(found: list[dict[str, Any]], roll_step: float) -> str:
    """Ratios of the run's mean z, as Markdown."""
    runs = [row for row in found if row["feasible"]]
    lines = [
        f"{len(runs)} runs. Mean z of the run, divided by …",
        "",
        "| | median | 90 % | largest | at most 1.02 |",
        "| :-- | --: | --: | --: | --: |",
    ]
    for key, what in (
        ("plan", "the plan's value"),
        ("grid", f"an independent search's, rolls {roll_step:g}° apart"),
        ("bound", "the plan's bound: every waypoint for itself"),
    ):
        ratios = np.array([row["mean_z"] / row[key] for row in runs])
        middle, most, largest = np.percentile(ratios, [50, 90, 100])
        share = 100.0 * (ratios <= 1.02).mean()
        lines.append(f"| {what} | {middle:.4f} | {most:.4f} | {largest:.4f} | {share:.0f} % |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure the samples and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--roll-step", type=float, default=1.0, help="degrees")
    parser.add_argument("--out", type=Path, help="write the rows here, as JSON")
    parser.add_argument("--markdown", type=Path, help="write the table here, too")
    args = parser.parse_args()
    indices = range(args.first, args.first + args.samples)
    found = []
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for row in pool.imap(partial(measure, roll_step=args.roll_step), indices):
            found.append(row)
            print(json.dumps(row), file=sys.stderr, flush=True)
    print(table(found, args.roll_step))
    if args.out:
        write_atomically(args.out, json.dumps(found, indent=2) + "\n")
    if args.markdown:
        write_atomically(args.markdown, table(found, args.roll_step))


if __name__ == "__main__":
    main()
