"""What takes part: a name, and a function that makes its step for a problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from qp_twist.bench.problem import Problem
from qp_twist.bench.program import Asked
from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind

StepOf = Callable[[int], Array | None]
"""Takes the k-th step of a problem, kinematics included: q̇, rad/s, (nv,); ``None`` of the floor."""


@dataclass(frozen=True)
class Parted:
    """A step whose call is timed alone, too: kinematics and targets come before it.

    Attributes:
        before: What is done at step k; it returns what the call takes.
        call: The step itself.
    """

    before: Callable[[int], Any]
    call: Callable[[Any], Array]

    def __call__(self, k: int) -> Array:
        """The whole step."""
        return self.call(self.before(k))


@dataclass(frozen=True)
class Contender:
    """One way to take a step.

    Attributes:
        name: FAMILY:VARIANT, as ``--only`` takes it.
        asked: Its program.
        prepare: What is not timed: the robot as the library reads it, targets in its types. It
            returns what makes the step: controller, tasks, limits. None of these is shared.
        missing: A sentence where it cannot take part at all; ``None`` where it can.
        applies: Whether it can take part in a problem.
    """

    name: str
    asked: Asked
    prepare: Callable[[Problem], Callable[[], StepOf]]
    missing: Callable[[], str | None] = lambda: None
    applies: Callable[[Problem], bool] = lambda problem: True

    @property
    def family(self) -> str:
        """What stands before the colon."""
        return self.name.partition(":")[0]


def one_level(problem: Problem) -> bool:
    """Whether a problem has no strict priorities."""
    return len(problem.levels) <= 1


def tool_axes(problem: Problem) -> bool:
    """Whether every frame has to keep its position and its z axis, and there is nothing else.

    The contenders of other libraries are set up for that, and one formula an arm says no more.
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
