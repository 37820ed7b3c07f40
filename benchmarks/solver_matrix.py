"""Every installed backend over the named hard problems and many random ones.

What ``qp_twist.qp.solve(problem, solver, persist=True)`` calls solved is checked by other means
(``tests/oracles/referee.py``): its feasibility by plain arithmetic, its optimality by weak duality.
Whether a problem has a solution is known by construction (``tests/oracles/problems.py``).

    python benchmarks/solver_matrix.py --jobs 2 --out matrix.json --markdown table.md

The exit status is 1 if a result called solved was refused here.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(threads, "1")  # before numpy: matrices of a step's size want one thread
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from oracles.problems import NAMED, Case, random_case
from oracles.referee import GAP, LowerBound, broken_constraint

from qp_twist.qp import QuadraticProgram, Verified, installed_solvers, solve
from qp_twist.qp import backend as backends


def judge(case: Case, solver: str, bound: LowerBound) -> tuple[str, str, float]:
    """How a backend's problem ended, what is wrong with that, and the gap."""
    result = solve(case.problem, solver, persist=True)
    if not isinstance(result, Verified):
        return ("refused, no solution", "", 0.0) if not case.feasible else ("failed", "", 0.0)
    how = "at once"
    if result.refused:
        how = "asked again" if result.solver == solver else "by another"
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
    with _each_call_once():
        return {s: judge(case, s, bound) for s in installed_solvers()}


class _each_call_once:  # noqa: N801
    """Remembers what backends return on one problem; the fallbacks are the same for each."""

    def __enter__(self) -> None:
        module, memory = sys.modules["qp_twist.qp.solve"], {}

        def remembered(problem: QuadraticProgram, solver: str, *, again: bool = False) -> Any:
            key = (id(problem), solver, again)
            if key not in memory:
                memory[key] = backends.solve_raw(problem, solver, again=again)
            return memory[key]

        module.solve_raw = remembered  # type: ignore[attr-defined]

    def __exit__(self, *_: object) -> None:
        sys.modules["qp_twist.qp.solve"].solve_raw = backends.solve_raw  # type: ignore[attr-defined]


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

    def to_dict(self) -> dict[str, Any]:
        return {
            "counts": {solver: dict(counts) for solver, counts in self.counts.items()},
            "called solved, refused by the check": self.false,
            "feasible, not solved": self.failed,
            "largest relative gap": self.gap,
        }


def random_ones(seeds: range) -> Tally:
    """A share of the random problems."""
    tally = Tally()
    for seed in seeds:
        tally.add(f"random {seed}", examine(f"random {seed}", random_case(seed)))
    return tally


COLUMNS = ("at once", "asked again", "by another", "refused, no solution", "failed")


def table(title: str, tally: Tally) -> str:
    """Markdown: a row for each backend."""
    lines = [
        f"| {title} | " + " | ".join(COLUMNS) + " | solved, but wrong |",
        "| :-- |" + " --: |" * (len(COLUMNS) + 1),
    ]
    for solver, counts in tally.counts.items():
        wrong = sum(text.startswith(f"{solver},") for text in tally.false)
        cells = [f"{counts[column]:,}" for column in COLUMNS] + [str(wrong)]
        lines.append(f"| {solver} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--random", type=int, default=100_000, help="how many random problems")
    parser.add_argument("--first", type=int, default=0, help="seed of the first of them")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--markdown", type=Path)
    options = parser.parse_args()

    started = time.perf_counter()
    named = Tally()
    for name, make in NAMED.items():
        named.add(name, examine(name, make()))
    drawn = Tally()
    last = options.first + options.random
    chunks = [range(i, min(i + 250, last)) for i in range(options.first, last, 250)]
    with multiprocessing.Pool(options.jobs) as pool:
        for done, tally in enumerate(pool.imap_unordered(random_ones, chunks), start=1):
            drawn.merge(tally)
            if done % 20 == 0 or done == len(chunks):
                print(f"{done}/{len(chunks)} {time.perf_counter() - started:.0f} s", flush=True)

    text = f"{table('named problems', named)}\n\n{table('random problems', drawn)}\n"
    print(text)
    for tally in (named, drawn):
        print(f"largest relative gap {tally.gap:.1e}")
        for complaint in [*tally.false, *tally.failed][:100]:
            print("  ", complaint)
    if options.markdown:
        options.markdown.write_text(text, encoding="utf-8")
    if options.out:
        result = {
            "named": named.to_dict() | {"problems": len(NAMED)},
            "random": drawn.to_dict() | {"problems": options.random},
            "seconds": time.perf_counter() - started,
        }
        options.out.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return 1 if named.false or drawn.false else 0


if __name__ == "__main__":
    sys.exit(main())
