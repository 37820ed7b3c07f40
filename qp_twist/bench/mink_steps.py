"""mink's own step."""

from __future__ import annotations

from collections.abc import Callable

import mink
import numpy as np

from qp_twist.bench.contender import Asked, Contender, Parted, StepOf, one_level, tool_axes
from qp_twist.bench.mink_terms import (
    Scene,
    half_spaces,
    mink_limits,
    posture,
    twist_tasks,
)
from qp_twist.bench.problem import DT, Problem

FREE_Z = (1.0, 1.0, 0.0)
"""Costs about the frame's own axes: z, the tool's, is free."""
POSTURE_COST = 1e-2
"""Of the soft task's posture, as in mink's examples of arms."""


def mink_steps() -> list[Contender]:
    """The tasks as constraints, and as costs."""
    return [
        Contender(
            "mink:hard",
            "mink.solve_ik, daqp, the tasks as constraints",
            Asked.COMMON,
            _hard,
            applies=one_level,
        ),
        Contender(
            "mink:soft",
            "mink.solve_ik, daqp, FrameTasks as costs",
            Asked.OTHER,
            _soft,
            applies=tool_axes,
        ),
    ]


def _hard(problem: Problem) -> Callable[[], StepOf]:
    problem.targets  # noqa: B018  (made once, and not timed)

    def make() -> StepOf:
        tasks, rows = twist_tasks(problem), half_spaces(problem)
        limits, wish = mink_limits(problem, rows), [posture(problem, 1.0)]
        scene = Scene(problem, tasks, rows)
        return Parted(
            scene.at,
            lambda configuration: np.asarray(
                mink.solve_ik(configuration, wish, DT, "daqp", limits=limits, constraints=tasks)
            ),
        )

    return make


def _soft(problem: Problem) -> Callable[[], StepOf]:
    problem.targets  # noqa: B018

    def make() -> StepOf:
        tasks = [
            mink.FrameTask(
                frame.site,
                "site",
                position_cost=1.0,
                orientation_cost=FREE_Z,
                lm_damping=1.0,
            )
            for frame in problem.frames
        ]
        limits, every = mink_limits(problem, []), [*tasks, posture(problem, POSTURE_COST)]
        scene = Scene(problem, tasks, [])
        return Parted(
            scene.at,
            lambda configuration: np.asarray(
                mink.solve_ik(configuration, every, DT, "daqp", limits=limits)
            ),
        )

    return make
