"""``qt.solve_ik`` beside ``mink.solve_ik``, on every kind of mink task and limit.

Both with daqp, on the problems of ``tests/oracles/mink_problems.py`` (a cart with two arms,
fingers, a neck, a drone and a crank) at random configurations. The oracle is the program that
mink builds, solved by an interior-point method as closely as it can.

    python benchmarks/drop_in_optimum.py [--seeds 20] [--markdown docs/generated/drop_in_optimum.md]
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import mink
import qpsolvers
from oracles import mink_problems
from publishing import command

import qp_twist as qt


def page(seeds: int) -> list[str]:
    warnings.simplefilter("ignore", qpsolvers.warnings.SparseConversionWarning)
    worst: dict[str, list[float]] = {}
    for seed in range(seeds):
        for name, problem in mink_problems.named(seed).items():
            entry = worst.setdefault(name, [0.0] * 4)
            arguments = problem.configuration, problem.tasks, problem.dt, "daqp"
            options = {"limits": problem.limits, "constraints": problem.constraints}
            for offset, solve_ik in ((0, qt.solve_ik), (2, mink.solve_ik)):
                velocity = solve_ik(*arguments, **options)
                found = mink_problems.difference(problem, velocity)
                entry[offset] = max(entry[offset], abs(found.value))
                entry[offset + 1] = max(entry[offset + 1], found.excess)
    lines = [
        "| task or limit | `qt.solve_ik`: optimum | rows | `mink.solve_ik`: optimum | rows |",
        "| :-- | --: | --: | --: | --: |",
    ]
    for name, entry in worst.items():
        lines.append(f"| {name} | " + " | ".join(f"{value:.0e}" for value in entry) + " |")
    return lines


if __name__ == "__main__":
    command(__doc__, page, seeds=20)
