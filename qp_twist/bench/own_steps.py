"""This package's steps: every backend, both spaces, and the drop-in for mink's call."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import mink

from qp_twist.bench.contender import Asked, Contender, Parted, StepOf, one_level
from qp_twist.bench.mink_terms import (
    Scene,
    half_spaces,
    mink_limits,
    posture,
    twist_tasks,
)
from qp_twist.bench.problem import DT, Problem
from qp_twist.controller import Controller, solve_ik
from qp_twist.errors import UnknownSolver
from qp_twist.fast import COMPILED
from qp_twist.kinematics import PostureReference
from qp_twist.limits import MotionLimit
from qp_twist.qp import check_solver, installed_solvers

EXPECTED = ("daqp", "proxqp", "osqp", "piqp", "quadprog", "clarabel", COMPILED)
"""Backends that are named where they are missing."""


def own_steps() -> list[Contender]:
    """Every backend that is installed, and the usual ones that are not."""
    solvers = dict.fromkeys([*EXPECTED, *installed_solvers()])
    return [
        *(_controller(solver, "joint") for solver in solvers),
        *(_controller(solver, "twist") for solver in ("daqp", COMPILED)),
        Contender(
            "solve_ik:daqp",
            "qp_twist.solve_ik, the tasks as constraints",
            Asked.COMMON,
            _drop_in,
            applies=one_level,
        ),
    ]


def _controller(solver: str, space: Literal["joint", "twist"]) -> Contender:
    suffix = "" if space == "joint" else ":twist"
    return Contender(
        f"step:{solver}{suffix}",
        f"Controller.step, solver {solver}, wish in {space} space",
        Asked.COMMON if space == "joint" else Asked.OTHER,
        partial(_prepare, solver, space),
        partial(_missing, solver),
    )


def _missing(solver: str) -> str | None:
    try:
        check_solver(solver)
    except UnknownSolver as error:
        return str(error)
    return None


def _prepare(
    solver: str, space: Literal["joint", "twist"], problem: Problem
) -> Callable[[], StepOf]:
    problem.targets  # noqa: B018  (made once, and not timed)

    def make() -> StepOf:
        tasks, rows = twist_tasks(problem), half_spaces(problem)
        levels: Any = [[tasks[i] for i in level] for level in problem.levels] or None
        controller = Controller(
            problem.model,
            () if levels else tasks,
            levels=levels,
            secondary=[PostureReference(problem.model, problem.middle, gain=problem.gain)],
            secondary_space=space,
            limits=[MotionLimit(problem.model, velocity=problem.speeds), *rows],
            solver=solver,
        )
        scene = Scene(problem, tasks, rows)
        return Parted(scene.at, lambda configuration: controller.step(configuration, DT).velocity)

    return make


def _drop_in(problem: Problem) -> Callable[[], StepOf]:
    problem.targets  # noqa: B018

    def make() -> StepOf:
        tasks, rows = twist_tasks(problem), half_spaces(problem)
        limits, wish = mink_limits(problem, rows), [posture(problem, 1.0)]
        scene = Scene(problem, tasks, rows)
        constraints: list[mink.Task] = [*tasks]
        return Parted(
            scene.at,
            lambda configuration: solve_ik(
                configuration, wish, DT, "daqp", limits=limits, constraints=constraints
            ),
        )

    return make
