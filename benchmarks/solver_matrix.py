"""Every installed backend over the named hard problems and many random ones.

What ``qp_twist.qp.solve(problem, solver)`` calls solved is checked by other means
(``tests/oracles/referee.py``): its feasibility by plain arithmetic, its optimality by weak duality.
Whether a problem has a solution is known by construction (``tests/oracles/problems.py``).

    python benchmarks/solver_matrix.py [--random 100000] [--first 0] [--jobs 2]

The exit status is 1 if a result called solved was refused here.
"""

from __future__ import annotations

from page import command, in_processes, markdown_table

# isort: split
import sys
from collections import Counter

from oracles.problems import NAMED, Case, random_case
from oracles.referee import GAP, LowerBound, broken_constraint

from qp_twist.qp import Verified, installed_solvers, solve


def judge(case: Case, solver: str, bound: LowerBound) -> tuple[str, str, float]:
    """How a backend's problem ended, what is wrong with that, and the gap."""
    result = solve(case.problem, solver)
    if not isinstance(result, Verified):
        return ("refused, no solution", "", 0.0) if not case.feasible else ("failed", "", 0.0)
    how = "solved"
    if not case.feasible:
        return how, "solved, though there is no solution", 0.0
    wrong = broken_constraint(case.problem, result.x)
    if wrong:
        return how, wrong, 0.0
    gap = bound.gap(result.x)
    return how, f"costs {gap:.1e} more than the optimum" if gap > GAP else "", gap


def examine(name: str, case: Case) -> dict[str, tuple[str, str, float]]:
    """Every backend on one problem."""
    bound = LowerBound(case.problem)
    return {s: judge(case, s, bound) for s in installed_solvers()}


class Tally:
    """Counts and complaints of each backend."""

    def __init__(self) -> None:
        self.counts: dict[str, Counter[str]] = {s: Counter() for s in installed_solvers()}
        self.false: list[str] = []
        self.failed: list[str] = []
        self.gap = 0.0

    def add(self, name: str, outcomes: dict[str, tuple[str, str, float]]) -> None:
        for solver, (how, wrong, gap) in outcomes.items():
            self.counts[solver][how] += 1
            self.gap = max(self.gap, gap)
            if wrong:
                self.false.append(f"{solver}, {name}: {wrong}")
            if how == "failed":
                self.failed.append(f"{solver}, {name}")

    def merge(self, other: Tally) -> None:
        for solver, counts in other.counts.items():
            self.counts[solver].update(counts)
        self.false += other.false
        self.failed += other.failed
        self.gap = max(self.gap, other.gap)


def random_ones(seeds: range) -> Tally:
    """A share of the random problems."""
    tally = Tally()
    for seed in seeds:
        tally.add(f"random {seed}", examine(f"random {seed}", random_case(seed)))
    return tally


COLUMNS = ("solved", "refused, no solution", "failed")


def table(title: str, tally: Tally) -> str:
    """A row for each backend, and what is wrong."""
    rows = []
    for solver, counts in tally.counts.items():
        wrong = sum(text.startswith(f"{solver},") for text in tally.false)
        rows.append((solver, *(f"{counts[column]:,}" for column in COLUMNS), wrong))
    text = markdown_table((title, *COLUMNS, "solved, but wrong"), rows)
    complaints = "".join(f"- {text}\n" for text in [*tally.false, *tally.failed][:100])
    return f"{text}\nLargest relative gap: {tally.gap:.1e}\n\n{complaints}"


def solver_matrix(random: int, first: int, jobs: int) -> tuple[str, int]:
    """The named problems, and so many random ones from this seed on."""
    named, drawn = Tally(), Tally()
    for name, make in NAMED.items():
        named.add(name, examine(name, make()))
    last = first + random
    chunks = [range(i, min(i + 250, last)) for i in range(first, last, 250)]
    for done, tally in enumerate(in_processes(random_ones, chunks, jobs), start=1):
        drawn.merge(tally)
        if done % 20 == 0 or done == len(chunks):
            print(f"{done}/{len(chunks)}", file=sys.stderr, flush=True)
    text = f"{table('named problems', named)}\n{table('random problems', drawn)}"
    return text, len(named.false) + len(drawn.false)


if __name__ == "__main__":
    parts = {"solver_matrix": solver_matrix}
    sys.exit(command(__doc__, parts, random=100_000, first=0, jobs=2))
