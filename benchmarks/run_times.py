"""What a run of `deburring` takes, method by method.

    python benchmarks/run_times.py [--markdown FILE]

Each run three times, the fastest counts. A minute.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
from publishing import command

import qp_twist as qt

METHODS = {
    "minimum_norm": "closed form",
    "gradient_projection": "closed form",
    "twa": "closed form",
    "sns": "closed form with limits",
    "mink": "mink's step, unverified",
    "qp_minimum_norm": "",
    "qp_gradient": "",
    "qp": "secondary in twist space",
}


def page() -> list[str]:
    task = qt.load_task("deburring")
    solvers = ["daqp", *(["compiled"] if "compiled" in qt.qp.installed_solvers() else [])]
    lines = [
        f"| method | steps | {' | '.join(f's a run, {solver}' for solver in solvers)} | |",
        f"| :-- | --: |{' --: |' * len(solvers)} :-- |",
    ]
    for method, words in METHODS.items():
        cells = []
        for solver in solvers:
            runs = [qt.follow(task, method, solver=solver) for _ in range(3)]
            seconds = min(run.seconds for run in runs)
            cells.append(f"{seconds:.3f}" if seconds < 0.1 else f"{seconds:.2f}")
        steps = int(runs[0].iterations.sum())
        lines.append(f"| `{method}` | {steps} | {' | '.join(cells)} | {words} |")
    return lines


if __name__ == "__main__":
    command(__doc__, page)
