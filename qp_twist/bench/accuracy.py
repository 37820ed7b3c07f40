"""How right an answer is, beside how fast it came."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict

from qp_twist.bench.contender import Asked
from qp_twist.bench.exact import exact_solution
from qp_twist.bench.problem import Truth
from qp_twist.bench.program import Program
from qp_twist.checks import Array


class Accuracy(BaseModel):
    """The worst of a contender's answers.

    Attributes:
        residual: Largest ‖Uᵀ(J q̇ − t)‖, m/s and rad/s.
        excess: Farthest beyond a bound or an inequality row, rad/s.
        error: Largest |q̇ − q̇*| of a joint, rad/s, from the exact solution of the program that it
            was asked; ``None`` where it solves another one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    residual: float
    excess: float
    error: float | None

    @classmethod
    def of(cls, asked: Asked, velocities: Mapping[int, Array], truth: Truth) -> Accuracy | None:
        """Judge answers by step; ``None`` if there are none."""
        if not velocities:
            return None
        programs = truth.programs
        return cls(
            residual=max(programs[k].residual(v) for k, v in velocities.items()),
            excess=max(programs[k].excess(v) for k, v in velocities.items()),
            error=_error(asked, velocities, truth),
        )


def _error(asked: Asked, velocities: Mapping[int, Array], truth: Truth) -> float | None:
    if asked is Asked.OTHER:
        return None
    worst = 0.0
    for k, velocity in velocities.items():
        if asked is Asked.COMMON:
            right = truth.solutions[k].velocity
        else:
            right = exact_solution(unlimited(truth.programs[k], asked)).velocity
        worst = max(worst, float(np.abs(velocity - right).max()))
    return worst


def unlimited(program: Program, asked: Asked) -> Program:
    """A program without its limits, and without the wish where the shortest step is asked."""
    free = np.full(len(program.wish), np.inf)
    wish = np.zeros_like(program.wish) if asked is Asked.SHORTEST else program.wish
    return replace(program, wish=wish, lower=-free, upper=free, G=program.G[:0], g=program.g[:0])
