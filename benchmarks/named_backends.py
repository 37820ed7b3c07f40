"""What a step with a backend by name takes beside ``mink.solve_ik`` with the same backend.

    python benchmarks/named_backends.py [--rounds 5] [--markdown FILE]

Robots and trajectories are those of ``qp-twist bench``: 6, 7 and 14 joints, tool positions and axes
as constraints, ranges and speeds as limits, of which some are active. At every step both get the
next configuration and target and solve, in turns one or the other first, so that a whole step
stands beside a whole step. *Ours* has ``MotionLimit`` and ``PostureReference``, *mink's* the very
limits and the ``PostureTask`` that mink has. mink's backends run at their defaults, ours at
settings at which their results can be verified; *same settings* hands these to mink, too. Medians
of the wall clock, one thread; two minutes.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import mink
from publishing import command

import qp_twist as qt
from qp_twist.bench.contenders import hard_posed, mink_step, own_step
from qp_twist.bench.problem import STEPS, Problem
from qp_twist.bench.problems import table
from qp_twist.qp.backend import SETTINGS

SOLVERS = ("daqp", "quadprog", "proxqp", "osqp")
Whole = Callable[[int], Any]


def minks(problem: Problem, solver: str, **settings: Any) -> Whole:
    """mink's step."""
    return mink_step(lambda p: replace(hard_posed(p), solver=solver, settings=settings), problem)()


def minks_terms(problem: Problem, solver: str) -> Whole:
    """This package's step, by mink's limits and cost."""

    def solve(configuration: Any, costs: Any, dt: float, solver: str, **kwargs: Any) -> Any:
        nonlocal controller
        if controller is None:
            tasks, limits = [*kwargs["constraints"], *costs], kwargs["limits"]
            controller = qt.Controller(problem.model, tasks, limits=limits, solver=solver)
        return controller.step(configuration, dt).velocity

    controller: qt.Controller | None = None
    return mink_step(lambda p: replace(hard_posed(p), solver=solver), problem, solve)()


def timed(steps: dict[str, Whole], rounds: int) -> dict[str, float]:
    """Median time of each, s, along the trajectory, taken in turns."""
    names = list(steps)
    took: dict[str, list[float]] = {name: [] for name in names}
    for number in range(-1, rounds):
        for k in range(STEPS):
            shift = (k + number) % len(names)
            for name in names[shift:] + names[:shift]:
                began = time.perf_counter()
                try:
                    steps[name](k)
                except mink.NoSolutionFound:  # mink has no more to say of some steps
                    continue
                if number >= 0:
                    took[name].append(time.perf_counter() - began)
    return {name: median(times) for name, times in took.items() if times}


def page(rounds: int, solvers: str) -> list[str]:
    installed = qt.qp.installed_solvers()
    lines = [
        "| backend | joints | `mink.solve_ik`, µs | same settings | ours | mink's terms "
        "| ours : mink | mink's terms : mink | mink's terms : same settings |",
        "| :-- | --: | --: | --: | --: | --: | --: | --: | --: |",
    ]
    problems = [planned.make(range(0, STEPS, 20))[0] for planned in table(0)]
    for solver in solvers.split(","):
        if solver not in installed:
            continue
        for problem in problems:
            took = timed(
                {
                    "mink": minks(problem, solver),
                    "settings": minks(problem, solver, **SETTINGS.get(solver, {})),
                    "ours": own_step(solver, "joint", problem)(),
                    "terms": minks_terms(problem, solver),
                },
                rounds,
            )
            ratios = (
                took["ours"] / took["mink"],
                took["terms"] / took["mink"],
                took["terms"] / took["settings"],
            )
            times = (took[name] for name in ("mink", "settings", "ours", "terms"))
            lines.append(
                f"| {solver} | {problem.model.nv} | "
                + " | ".join(f"{1e6 * seconds:.0f}" for seconds in times)
                + " | "
                + " | ".join(f"{ratio:.2f}" for ratio in ratios)
                + " |"
            )
            print(lines[-1], file=sys.stderr)
    return lines


if __name__ == "__main__":
    command(__doc__, page, rounds=5, solvers=",".join(SOLVERS))
