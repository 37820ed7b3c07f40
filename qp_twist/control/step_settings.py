"""The numbers and modes of a controller, which may change between two steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, checked, finite_array, number, one_of, read_only
from qp_twist.errors import InvalidInput
from qp_twist.qp import check_solver

TIE_BREAK = 1e-9
"""Default ρ in joint space if other mink tasks have costs; ρ then only makes the result unique."""
UNSEEN_WEIGHT = 1e-2
"""Default ρ in twist space, where it applies only to motion that the twist cost does not see."""
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12
"""Range of ρ and the entries of M: beyond it, they or other costs are lost to rounding."""
SINGULARITY = 1e-3
"""Singular value of the task rows, m/rad or 1, below which a direction is slowed down."""
SMOOTH_SINGULARITY = 5e-3
"""The same of smooth steps: an arm that is stretched stays near enough to a bent one to return."""
LARGEST_FREE_COST = 1e6
"""Largest root of w: beyond it other costs are lost to rounding."""
SMALLEST_SINGULARITY = 1e-9
"""A smaller ``singularity`` counts as 0."""


def _metric(settings: Any, name: str, value: npt.ArrayLike) -> Array:
    """The diagonal of M, read-only: only an assignment can change it, which steps detect."""
    metric = finite_array(name, value, (settings.nv,))
    if not ((metric >= SMALLEST_WEIGHT) & (metric <= LARGEST_WEIGHT)).all():
        raise InvalidInput(
            f"metric: every entry must be above 0, from {SMALLEST_WEIGHT:g} to {LARGEST_WEIGHT:g}."
        )
    return read_only(metric)


def _joint_weight(_: Any, name: str, value: Any) -> float:
    return number(name, value, at_least=SMALLEST_WEIGHT, at_most=LARGEST_WEIGHT)


def _flag(_: Any, name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidInput(f"{name}: expected True or False, got {value!r}.")
    return bool(value)


def _free_twist_costs(_: Any, name: str, value: tuple[float, float]) -> tuple[float, float]:
    """Roots of w for the linear and the angular rows of 1 − T."""
    linear, angular = finite_array(name, value, (2,)).tolist()
    if not 0.0 <= min(linear, angular) <= max(linear, angular) <= LARGEST_FREE_COST:
        raise InvalidInput(f"{name}: expected two numbers from 0 to {LARGEST_FREE_COST:g}.")
    return linear, angular


class StepSettings:
    """Numbers and modes; those without a comment :class:`~qp_twist.Controller` documents.

    Attributes:
        nv: Number of the joints' degrees of freedom.
    """

    secondary_space: str = checked(lambda _, name, value: one_of(name, value, ("joint", "twist")))
    metric: Array = checked(_metric)
    joint_weight: float = checked(_joint_weight)
    free_twist_costs: tuple[float, float] = checked(_free_twist_costs)
    solver: str = checked(lambda _, name, value: check_solver(value))
    on_infeasible: str = checked(
        lambda _, name, value: one_of(name, value, ("scale", "relax", "raise"))
    )
    smooth: bool = checked(_flag)
    braking: bool = checked(_flag)

    def __init__(self, nv: int, solver: str) -> None:
        """The defaults of a controller without a secondary in twist space."""
        self.nv, self.solver = nv, solver
        self.secondary_space, self.on_infeasible = "joint", "scale"
        self.metric, self.joint_weight = np.ones(nv), 1.0
        self.free_twist_costs = 1.0, 1.0
        self.smooth = self.braking = True
        self._singularity: float | None = None

    @property
    def singularity(self) -> float:
        """ε."""
        if self._singularity is None:
            return SMOOTH_SINGULARITY if self.smooth else SINGULARITY
        return self._singularity

    @singularity.setter
    def singularity(self, value: float) -> None:
        given = number("singularity", value, at_least=0.0, at_most=1.0)
        # What is too small to distinguish from rounding is 0.
        self._singularity = given if given >= SMALLEST_SINGULARITY else 0.0
