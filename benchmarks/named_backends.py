"""What a step with a backend by name takes beside ``mink.solve_ik`` with the same backend.

    python benchmarks/named_backends.py [--rounds 5] [--markdown FILE]

Robots and trajectories are those of ``qp-twist bench``: 6, 7 and 14 joints, tool positions and axes
as constraints, ranges and speeds as limits, of which some are active. At every step both get the
next configuration and target and solve, so that a whole step stands beside a whole step; they take
turns on blocks of steps, in an order drawn anew. *Ours* has ``MotionLimit`` and
``PostureReference``, *mink's* the very limits and the ``PostureTask`` that mink has. mink's
backends run at their defaults, ours at settings at which their results can be verified; *same
settings* hands these to mink, too. Medians of the wall clock, one thread; two minutes.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import sys
from dataclasses import replace
from typing import Any

import numpy as np
from publishing import command

import qp_twist as qt
from qp_twist.bench.contender import StepOf
from qp_twist.bench.contenders import hard_problem, mink_step, own_step
from qp_twist.bench.problem import STEPS, Problem
from qp_twist.bench.problems import table
from qp_twist.bench.timer import blocks_of, interleaved
from qp_twist.qp.backend import SETTINGS

SOLVERS = ("daqp", "quadprog", "proxqp", "osqp")


def minks(problem: Problem, solver: str, **settings: Any) -> StepOf:
    """mink's step."""
    return mink_step(
        lambda p: replace(hard_problem(p), solver=solver, settings=settings), problem
    )()


def minks_terms(problem: Problem, solver: str) -> StepOf:
    """This package's step, by mink's limits and cost."""

    def solve(configuration: Any, costs: Any, dt: float, solver: str, **kwargs: Any) -> Any:
        nonlocal controller
        if controller is None:
            tasks, limits = [*kwargs["constraints"], *costs], kwargs["limits"]
            controller = qt.Controller(problem.model, tasks, limits=limits, solver=solver)
        return controller.step(configuration, dt).velocity

    controller: qt.Controller | None = None
    return mink_step(lambda p: replace(hard_problem(p), solver=solver), problem, solve)()


def timed(steps: dict[str, StepOf], rounds: int) -> dict[str, float]:
    """Median time of each, s, by the bench's timer; steps without a solution do not count."""
    blocks = rounds * blocks_of(STEPS, length=16, count=12)
    found = interleaved(steps, blocks, np.random.default_rng(0))
    return {name: 1e-9 * float(np.median(of.warm)) for name, of in found.items() if of.warm}


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
