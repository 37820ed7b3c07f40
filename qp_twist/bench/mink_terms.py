"""A problem in the terms of mink, which this package shares: tasks, targets, limits."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.bench.problem import Problem
from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges, TwistTask


class HalfSpaces(mink.Limit):
    """G q̇ ≤ g as a limit of mink, which states it for the displacement of the step.

    Attributes:
        ends: g of the step that is next, rad/s, (m,).
    """

    def __init__(self, rows: Array) -> None:
        self.rows = rows
        self.ends = np.zeros(len(rows))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """G Δq ≤ g dt."""
        return mink.Constraint(self.rows, self.ends * dt)


def twist_tasks(problem: Problem) -> list[TwistTask]:
    """A task for each frame."""
    return [TwistTask(frame.site, "site", frame.projector) for frame in problem.frames]


def half_spaces(problem: Problem) -> list[HalfSpaces]:
    """The inequality rows, if there are any."""
    return [HalfSpaces(problem.half_spaces)] if len(problem.half_spaces) else []


def mink_limits(problem: Problem, rows: list[HalfSpaces]) -> list[mink.Limit]:
    """Ranges to their ends (mink's gain of 0.95 stops short of them), speeds, and the rows."""
    names = JointRanges.of(problem.model).names
    speeds = {name: float(speed) for name, speed in zip(names, problem.speeds, strict=True)}
    return [
        mink.ConfigurationLimit(problem.model, gain=1.0),
        mink.VelocityLimit(problem.model, speeds),
        *rows,
    ]


def posture(problem: Problem, cost: float) -> mink.PostureTask:
    """The wish."""
    task = mink.PostureTask(problem.model, cost=cost, gain=problem.gain)
    task.set_target(problem.middle)
    return task


class Scene:
    """What a contender on mink's configuration does before its step."""

    def __init__(
        self,
        problem: Problem,
        tasks: Sequence[mink.FrameTask | TwistTask],
        rows: list[HalfSpaces],
    ) -> None:
        self.configuration = mink.Configuration(problem.model)
        self._problem, self._tasks, self._rows = problem, tasks, rows
        self._targets = problem.targets

    def at(self, k: int) -> mink.Configuration:
        """Kinematics at step k, its targets set."""
        self.configuration.update(self._problem.q[k])
        for task, target in zip(self._tasks, self._targets[k], strict=True):
            task.set_target(target)
        for limit in self._rows:
            limit.ends = self._problem.ends[k]
        return self.configuration
