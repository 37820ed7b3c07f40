"""Result of one step of the controller."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit
from qp_twist.qp import LostDirection, QuadraticProgram

NOT_THE_LIMITS = (
    "no limit is in the way: the task rows contradict each other, or the robot is singular in a "
    "direction that they need"
)
_LATER = "residuals", "binding", "problem", "sigma_min", "lost"
"""Attributes that may be computed when somebody asks for them."""


class Status(enum.Enum):
    """Status of a step; its value is a sentence."""

    SOLVED = "every level is met at full speed inside the limits"
    PRIORITIZED = (
        "the first level is met at full speed, a lower one as far as that and the limits leave room"
    )
    DEGRADED = (
        "the robot is singular, or the task contradicts itself, in a direction: others are met"
    )
    SCALED = "the task rows are met at a reduced speed, as far as the limits allow"
    RELAXED = "the task rows cannot be met: velocity comes close in least squares"

    @property
    def severity(self) -> int:
        """0 for ``SOLVED``, larger for worse outcomes."""
        return list(Status).index(self)


@dataclass(frozen=True, eq=False)
class Step:
    """A verified joint velocity with its residuals, active limits and status."""

    velocity: Array
    """q̇ in the model's tangent space, rad/s or m/s, shape (nv,)."""
    scale: float
    """s in A q̇ = s b of the first level; 1 if it is met at full speed, except in the directions
    that are ``lost``. A relaxed step has no s, and scale is 1; see its residuals."""
    residuals: tuple[Array, ...]
    """A q̇ − s b for each task (s = 1 below the first level), m/s and rad/s, in the rows of its
    basis; in the order of ``Controller.tasks``. Of a first level that is braked b is
    s_b (b − b_ff) + b_ff, since the twist of a moving target keeps its speed."""
    binding: tuple[BindingLimit, ...]
    """The active limits."""
    status: Status
    solver: str
    """The backend that computed the result."""
    problem: QuadraticProgram
    """The quadratic program; ``step.problem.save("step.npz")`` stores it."""
    sigma_min: float
    """Smallest singular value of the first level's task rows; ∞ without rows."""
    lost: tuple[LostDirection, ...] = field(default_factory=tuple)
    """Directions of the first level in which the robot is singular and is slowed down."""
    recovering: tuple[str, ...] = ()
    """Sentences about joints that are outside their limits and returning."""
    gaps: tuple[float, ...] = ()
    """Bounds of how far each level's residual is longer than at its optimum, m/s and rad/s, if the
    step was solved level by level. Empty if one program contains all rows."""
    proven: bool = True
    """Whether every gap is at most 1e-7 (longest row + max |b|) of its level. If not, rows are
    nearly dependent, and lower levels depend on rounding."""

    @staticmethod
    def with_later(later: Callable[[Any, str], Any], about: Any) -> Step:
        """A step whose ``__dict__`` is yet to be filled.

        What is not in it, of ``_LATER``, is ``later(about, name)``, when somebody asks.
        """
        step = object.__new__(Step)
        step.__dict__["_later"] = later, about
        return step

    def __getattr__(self, name: str) -> Any:
        """Compute an attribute on first access."""
        if name not in _LATER or "_later" not in self.__dict__:
            raise AttributeError(name)
        later, about = self.__dict__["_later"]
        value = self.__dict__[name] = later(about, name)
        return value

    def __getstate__(self) -> dict[str, Any]:
        """State with all attributes computed."""
        found = {name: getattr(self, name) for name in _LATER}
        return {k: v for k, v in (self.__dict__ | found).items() if k != "_later"}

    @property
    def message(self) -> str:
        """The step in a sentence, with its active limits."""
        text = f"{self.status.name.lower()}: {self.status.value}"
        if self.status is Status.SCALED:
            but = ", of all directions but the lost ones" if self.lost else ""
            text += f" (scale {self.scale:.4g}{but})"
            if not self.binding:
                text += f"; {NOT_THE_LIMITS}"
        if self.lost:
            text += "; lost: " + ", ".join(str(direction) for direction in self.lost)
        if self.binding:
            text += "; binding: " + ", ".join(str(limit) for limit in self.binding)
        if not self.proven:
            worst = max(range(len(self.gaps)), key=self.gaps.__getitem__)
            text += (
                f"; not proven to be the optimum: level {worst + 1} may be off by "
                f"{self.gaps[worst]:.2g}"
            )
        if self.recovering:
            text += "; recovering: " + ", ".join(self.recovering)
        return text

    def __repr__(self) -> str:
        return f"Step({self.message})"
