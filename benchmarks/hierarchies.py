"""Random priority levels against the textbook cascade of quadratic programs.

``qp_twist.solve_levels`` and an oracle (``tests/oracles/hierarchies.py``) solve the same levels;
compared are the lengths of each level's residual, from the first level on, and the point that is
left. The oracle says how well its own conditions of optimality hold; no result is left out.

    python benchmarks/hierarchies.py [--problems 10000] [--first 0] [--jobs 2]

The exit status is 1 if a level differs by more than 1e-7, or the oracle cannot be trusted.
"""

from __future__ import annotations

from page import command, in_processes

# isort: split
import json
import sys
from dataclasses import dataclass, field

import numpy as np
from oracles.hierarchies import cascade, random_hierarchy, residual

import qp_twist as qt

LARGEST = 1e-7
TRUSTED = 1e-9
"""Largest violation of the conditions of optimality at which the oracle is believed."""


@dataclass
class Comparison:
    """What is found on some of the hierarchies."""

    levels: int = 0
    difference: float = 0.0
    point: float = 0.0
    oracle: float = 0.0
    wrong: list[str] = field(default_factory=list)

    def merge(self, other: Comparison) -> None:
        self.levels += other.levels
        self.difference = max(self.difference, other.difference)
        self.point = max(self.point, other.point)
        self.oracle = max(self.oracle, other.oracle)
        self.wrong += other.wrong


def compare(seeds: range) -> Comparison:
    """Solve the hierarchies of these seeds twice."""
    result = Comparison()
    for seed in seeds:
        hierarchy = random_hierarchy(seed)
        n = len(hierarchy.lower)
        try:
            solution = qt.solve_levels(
                hierarchy.levels, hierarchy.lower, hierarchy.upper,
                on_infeasible="relax", reference=hierarchy.reference,
            )  # fmt: skip
        except qt.QpTwistError as error:
            result.wrong.append(f"seed {seed}: {error}")
            continue
        if (solution.x < hierarchy.lower).any() or (solution.x > hierarchy.upper).any():
            result.wrong.append(f"seed {seed}: outside the bounds")
        last = (np.eye(n), hierarchy.reference, np.zeros((0, n)), np.zeros(0))
        levels = [*hierarchy.levels, last]
        oracle = cascade(hierarchy, levels)
        if oracle.stationarity > TRUSTED:
            result.wrong.append(f"seed {seed}: the oracle is off by {oracle.stationarity:.1e}")
        differences = [
            residual(level, solution.x) - reached
            for level, reached in zip(levels, oracle.residuals, strict=True)
        ]
        for k, difference in enumerate(differences):
            if abs(difference) > LARGEST:
                result.wrong.append(f"seed {seed}, level {k + 1}: {difference:+.1e}")
                break  # the levels below it solve another problem
            result.difference = max(result.difference, abs(difference))
        result.levels += len(levels)
        result.point = max(result.point, float(np.abs(solution.x - oracle.x).max()))
        result.oracle = max(result.oracle, oracle.stationarity)
    return result


def hierarchies(problems: int, first: int, jobs: int) -> tuple[str, int]:
    """Solve the problems from this seed on."""
    total, last = Comparison(), first + problems
    chunks = [range(i, min(i + 100, last)) for i in range(first, last, 100)]
    for part in in_processes(compare, chunks, jobs):
        total.merge(part)
    result = {
        "hierarchies": problems,
        "levels": total.levels,
        "largest difference of a residual": total.difference,
        "largest difference of a point": total.point,
        "largest violation of optimality by the oracle": total.oracle,
        "wrong": total.wrong,
    }
    return json.dumps(result, indent=1), len(total.wrong)


if __name__ == "__main__":
    parts = {"hierarchies": hierarchies}
    sys.exit(command(__doc__, parts, problems=10_000, first=0, jobs=2))
