"""The exceptions of a step that has no result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mink

from qp_twist.errors import QpTwistError
from qp_twist.qp.problem import QuadraticProgram


class NoSolutionFound(QpTwistError, mink.NoSolutionFound):
    """A step has no result to hand on.

    Attributes:
        problem: The quadratic program that was posed (save it with ``problem.save("step.npz")``).
        binding: The limits that stand in the way, as whoever raises it names them (a controller:
            as :class:`~qp_twist.constraints.BindingLimit`); empty where they are not known.
    """

    def __init__(
        self, message: str, problem: QuadraticProgram | None = None, binding: Sequence[Any] = ()
    ) -> None:
        Exception.__init__(self, message)
        self.problem = problem
        self.binding = tuple(binding)


class InfeasibleStep(NoSolutionFound):
    """The task rows cannot be met inside the limits, and ``on_infeasible="raise"`` was asked."""


class SolverInaccurate(NoSolutionFound):
    """The solver called a result solved that does not satisfy the problem; it was not handed on."""
