"""Settings of the page, and a method without its limits."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, MethodSettings, PathTask, check_method
from qp_twist.qp import check_solver, installed_solvers
from qp_twist.viewing.projectors import OWN

WEIGHTS = ("gradient", "paper", "natural")
_WIDER = 64.0
"""A power of two: scaling by it and back is exact."""


@dataclass(frozen=True)
class PageSettings:
    """Settings of a run. Runs with equal settings are equal.

    Attributes:
        method: Name of the method.
        solver: Backend of the QPs.
        projector: A name of :func:`projector_choices`.
        gain: Gain of the secondary, per waypoint.
        weight: Weight of centering: ``"gradient"``, ``"paper"`` or ``"natural"``.
        limits: Whether the limits hold, for methods with limits.
    """

    method: str
    solver: str = "daqp"
    projector: str = OWN
    gain: float = MethodSettings().gain
    weight: str = MethodSettings().weight
    limits: bool = True

    @classmethod
    def of(cls, path_task: PathTask, method: str, solver: str | None = None) -> PageSettings:
        """Settings of a method as in the task file.

        Raises:
            InvalidInput: If the method is unknown or does not apply to the task.
            UnknownSolver: If the backend is not installed.
        """
        if check_method(method) not in method_choices(path_task):
            raise InvalidInput(
                f"{path_task.name}: {method} does not apply to this task; those that do: "
                f"{', '.join(method_choices(path_task))}."
            )
        stated = path_task.settings(method)
        return cls(method, check_solver(solver), gain=stated.gain, weight=stated.weight)

    @property
    def has_gain(self) -> bool:
        """Whether the method has a secondary with a gain."""
        return METHODS[self.method].defaults.secondary != "none"

    @property
    def has_weight(self) -> bool:
        """Whether its secondary is centering with a selectable weight."""
        kind = METHODS[self.method]
        return kind.defaults.secondary == "centering" and not kind.peer

    @property
    def has_projector(self) -> bool:
        """Whether the method has a null space: the others fix the whole pose."""
        return not METHODS[self.method].whole_twist

    @property
    def has_solver(self) -> bool:
        """Whether the method solves a quadratic program."""
        kind = METHODS[self.method]
        return kind.constrained or bool(kind.peer)

    @property
    def has_limits(self) -> bool:
        """Whether the limits can be switched off."""
        return can_drop_limits(self.method)

    def applied(self, path_task: PathTask) -> MethodSettings:
        """The task file's settings of the method, overridden by those of the page."""
        stated = path_task.settings(self.method)
        changes: dict[str, object] = {}
        if self.has_gain:
            changes["gain"] = self.gain
        if self.has_weight:
            changes["weight"] = self.weight
        return stated.model_copy(update=changes)


def method_choices(path_task: PathTask) -> list[str]:
    """The methods that apply to a task."""
    return path_task.method_names()


def solver_choices() -> list[str]:
    """The installed backends."""
    return sorted(installed_solvers())


def can_drop_limits(method: str) -> bool:
    """Whether the method has limits that can be switched off.

    A plan is a search inside the limits, and other libraries have their own limits.
    """
    kind = METHODS[method]
    planned = kind.defaults.secondary == "plan"
    return kind.holds_limits and not kind.peer and not planned


def without_limits(
    path_task: PathTask, settings: MethodSettings
) -> tuple[PathTask, MethodSettings]:
    r"""The task with unreachable limits, and settings that centre as before.

    The joint ranges are widened about their middles by a factor c, and speeds and accelerations are
    unlimited. With the ranges :math:`\mathbf W = \mathrm{diag}\,1/(\theta_{max}-\theta_{min})`
    falls to W/c, so that the gain grows by c² for h = k WᵀW(θ̄ − θ), and by c for the paper's
    h = k W(θ̄ − θ). That of h = k(θ̄ − θ) stays: its metric WᵀW is scaled as a whole.
    """
    model = copy.copy(path_task.model)
    for joint in np.flatnonzero(model.jnt_limited):
        lower, upper = model.jnt_range[joint]
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        model.jnt_range[joint] = middle - _WIDER * half, middle + _WIDER * half
    unlimited = np.full(len(JointRanges.of(model).names), np.inf)
    powers = {"gradient": 2, "paper": 1}
    power = powers.get(settings.weight, 0) if settings.secondary == "centering" else 0
    return (
        dataclasses.replace(
            path_task, model=model, velocity_limits=unlimited, acceleration_limits=unlimited
        ),
        settings.model_copy(update={"gain": settings.gain * _WIDER**power}),
    )
