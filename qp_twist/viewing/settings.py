"""Settings of the page."""

from __future__ import annotations

from dataclasses import dataclass

from qp_twist.errors import InvalidInput
from qp_twist.paths import METHODS, MethodSettings, PathTask, check_method
from qp_twist.qp import check_solver, installed_solvers
from qp_twist.viewing.projectors import OWN
from qp_twist.viewing.unlimited import can_drop_limits

WEIGHTS = ("gradient", "paper", "natural")


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
