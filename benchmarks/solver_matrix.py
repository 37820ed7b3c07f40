"""Every installed backend over the named hard problems and many random ones.

What ``qp_twist.qp.solve(problem, solver, persist=True)`` calls solved is checked here by other
means: its feasibility by plain arithmetic, its optimality by weak duality. Any multipliers give a
lower bound of the optimum, so that a bad reference can refuse a good result but never pass a bad
one. Whether a problem has a solution is known by construction.

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
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(threads, "1")  # before numpy: matrices of a step's size want one thread
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
import numpy.typing as npt
import qpsolvers
from problems import NAMED, Case, random_case
from scipy.optimize import lsq_linear

from qp_twist.qp import QuadraticProgram, Verified, solve
from qp_twist.qp import backend as backends

Array = npt.NDArray[np.float64]
Multipliers = tuple[Array, Array, Array]

EQUALITY = 1e-8
"""Largest |A x − b|, relative to 1 + max |b|; m/s and rad/s."""
INEQUALITY = 1e-8
"""Largest excess over G x ≤ g, relative to 1 + max |x|; bounds hold to the last bit."""
GAP = 1e-6
"""Largest gap between the objective and its lower bound, relative to the size of the objective."""
REFERENCES: dict[str, dict[str, Any]] = {
    "piqp": {"eps_abs": 1e-13, "eps_rel": 0.0},
    "clarabel": {"tol_feas": 1e-13, "tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13},
}


def broken_constraint(p: QuadraticProgram, x: Array) -> str:
    """What a result breaks, in words; empty if nothing."""
    if x.shape != p.c.shape or not np.isfinite(x).all():
        return "not a finite vector"
    if (x < p.lower).any() or (x > p.upper).any():
        return "outside the bounds"
    equality = np.abs(p.A @ x - p.b).max(initial=0.0) / (1.0 + np.abs(p.b).max(initial=0.0))
    if equality > EQUALITY:
        return f"equality rows missed by {equality:.1e}"
    excess = (p.G @ x - p.g).max(initial=0.0) / (1.0 + np.abs(x).max())
    if excess > INEQUALITY:
        return f"inequality rows exceeded by {excess:.1e}"
    return ""


def lower_bound(p: QuadraticProgram, multipliers: Multipliers) -> float:
    """The dual objective: no point that satisfies the constraints has a lower cost."""
    y, rows, box = multipliers
    rows = np.maximum(rows, 0.0)
    box = np.where(box > 0.0, np.where(p.upper < np.inf, box, 0.0), box)
    box = np.where(box < 0.0, np.where(p.lower > -np.inf, box, 0.0), box)
    r = p.c + p.A.T @ y + p.G.T @ rows + box
    at_box = np.where(box > 0.0, p.upper, np.where(box < 0.0, p.lower, 0.0))
    values = [-0.5 * r @ np.linalg.solve(p.H, r), *(-p.b * y), *(-p.g * rows), *(-box * at_box)]
    # What the sum may have lost by rounding is given away, or the bound would not be one.
    return float(np.sum(values) - 1e-15 * np.abs(values).sum())


def objective(p: QuadraticProgram, x: Array) -> float:
    return float(0.5 * x @ p.H @ x + p.c @ x)


def objective_size(p: QuadraticProgram, x: Array) -> float:
    length = 1.0 + float(np.linalg.norm(x))
    return float(np.linalg.norm(p.H, 2) * length**2 + np.linalg.norm(p.c) * length)


class LowerBound:
    """The best lower bound of a problem's optimum, sought no further than a result needs."""

    def __init__(self, problem: QuadraticProgram) -> None:
        self.problem = problem
        self.best = -np.inf
        self.sources: Iterator[Callable[[], Multipliers]] = iter(
            [lambda name=name: reference(problem, name) for name in REFERENCES]
        )

    def gap(self, x: Array) -> float:
        """Of a point, relative to the size of the objective."""
        p = self.problem
        size = objective_size(p, x)
        while (objective(p, x) - self.best) / size > GAP:
            source = next(self.sources, None)
            if source is None:
                self.best = max(self.best, lower_bound(p, at(p, x)))
                break
            self.best = max(self.best, lower_bound(p, source()))
        return (objective(p, x) - self.best) / size


def reference(p: QuadraticProgram, name: str) -> Multipliers:
    """The multipliers of an interior-point method, on rows of length one."""
    size = np.abs(p.H).max()
    lengths = [np.linalg.norm(rows, axis=1) for rows in (p.A, p.G)]
    a, g = (np.where(length > 0.0, length, 1.0) for length in lengths)
    none = (np.zeros(len(p.b)), np.zeros(len(p.g)), np.zeros(p.n))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            solution = qpsolvers.solve_problem(
                qpsolvers.Problem(
                    p.H / size,
                    p.c / size,
                    p.G / g[:, None] if len(g) else None,
                    p.g / g if len(g) else None,
                    p.A / a[:, None] if len(a) else None,
                    p.b / a if len(a) else None,
                    p.lower,
                    p.upper,
                ),
                name,
                **REFERENCES[name],
            )
        except Exception:
            return none
    if solution.x is None or not np.isfinite(solution.x).all():
        return none
    parts = []
    for value, empty in zip((solution.y, solution.z, solution.z_box), none, strict=True):
        usable = value is not None and len(value) == len(empty) and np.isfinite(value).all()
        parts.append(size * np.array(value) if usable else empty)
    return parts[0] / a, parts[1] / g, parts[2]


def at(p: QuadraticProgram, x: Array) -> Multipliers:
    """Multipliers that explain the gradient at a point, by bounded least squares."""
    close = 1e-5 * (1.0 + np.abs(x).max())
    lengths = np.linalg.norm(p.G, axis=1)
    touching = p.G @ x >= p.g - close * np.maximum(lengths, 1e-300)
    up, down = x >= p.upper - close, x <= p.lower + close
    identity = np.eye(p.n)
    columns = np.vstack([p.A, p.G[touching], identity[up], -identity[down]])
    m = len(p.b)
    y, rows, box = np.zeros(m), np.zeros(len(p.g)), np.zeros(p.n)
    if len(columns):
        scale = np.linalg.norm(columns, axis=1)
        scale[scale == 0.0] = 1.0
        low = np.concatenate([np.full(m, -np.inf), np.zeros(len(columns) - m)])
        found = lsq_linear(
            (columns / scale[:, None]).T, -(p.H @ x + p.c), (low, np.inf), method="bvls",
            tol=1e-15, lsq_solver="exact",
        ).x / scale  # fmt: skip
        k = int(touching.sum())
        y, rows[touching] = found[:m], found[m : m + k]
        box[up] += found[m + k : m + k + up.sum()]
        box[down] -= found[m + k + up.sum() :]
    return y, rows, box


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
        return {s: judge(case, s, bound) for s in qpsolvers.available_solvers}


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
        self.counts: dict[str, Counter[str]] = {s: Counter() for s in qpsolvers.available_solvers}
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
