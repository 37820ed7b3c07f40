"""A contender of the benchmark: a name, and a function that makes its step for a problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from qp_twist.bench.problem import Problem
from qp_twist.bench.program import Variant
from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind

StepOf = Callable[[int], Array | None]
"""Computes the k-th step of a problem, kinematics included: q̇, rad/s, (nv,); ``None`` for a
contender that computes the kinematics only (``floor:…``)."""


@dataclass(frozen=True)
class SplitStep:
    """A step whose call is also timed alone, without kinematics and targets.

    Attributes:
        before: Prepares step k; returns the arguments of the call.
        call: The step itself.
    """

    before: Callable[[int], Any]
    call: Callable[[Any], Array]

    def __call__(self, k: int) -> Array:
        """The whole step."""
        return self.call(self.before(k))


@dataclass(frozen=True)
class Contender:
    """A method and library that computes a step.

    Attributes:
        name: FAMILY:VARIANT, as for ``--only``.
        variant: The program that it solves.
        prepare: Untimed preparation: the robot and targets in the library's types. Returns a
            function that makes the step's objects (controller, tasks, limits), which are never
            shared.
        missing: Why it cannot take part at all; ``None`` if it can.
        applies: Whether it can take part in a problem.
    """

    name: str
    variant: Variant
    prepare: Callable[[Problem], Callable[[], StepOf]]
    missing: Callable[[], str | None] = lambda: None
    applies: Callable[[Problem], bool] = lambda problem: True

    @property
    def family(self) -> str:
        """The part of the name before the colon."""
        return self.name.partition(":")[0]


def one_level(problem: Problem) -> bool:
    """Whether a problem has no strict priorities."""
    return len(problem.levels) <= 1


def tool_axes(problem: Problem) -> bool:
    """Whether every frame has to keep exactly its position and its z axis.

    The contenders of other libraries, and the closed forms, are set up for these rows.
    """
    return (
        one_level(problem)
        and not len(problem.half_spaces)
        and all(
            frame.projector.linear.kind is ProjectorKind.FULL
            and frame.projector.angular.kind is ProjectorKind.PLANE
            for frame in problem.frames
        )
    )
