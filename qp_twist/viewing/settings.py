"""Settings of the page, and a task without its limits."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.paths import METHODS, MethodSettings, PathTask, check_method
from qp_twist.qp import check_solver
from qp_twist.viewing.projectors import OWN

_WIDER = 64.0
"""A power of two: scaling by it and back is exact."""


@dataclass(frozen=True)
class PageSettings:
    """Settings of a run. Runs with equal settings are equal.

    Attributes:
        method: Name of the method.
        solver: Backend of the QPs.
        projector: A name of :func:`~.projectors.projector_choices`.
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
        if check_method(method) not in path_task.method_names():
            raise InvalidInput(
                f"{path_task.name}: {method} does not apply to this task; those that do: "
                f"{', '.join(path_task.method_names())}."
            )
        stated = path_task.settings(method)
        return cls(method, check_solver(solver), gain=stated.gain, weight=stated.weight)

    def applied(self, path_task: PathTask) -> MethodSettings:
        """The task file's settings of the method, overridden by those of the page."""
        known = effective(self) & {"gain", "weight"}
        changes: dict[str, object] = {key: getattr(self, key) for key in known}
        return path_task.settings(self.method).model_copy(update=changes)


def effective(settings: PageSettings) -> set[str]:
    """The settings that change the runs of the method.

    A plan is a search inside the limits, and other libraries have their own limits.
    """
    method = METHODS[settings.method]
    secondary = method.defaults.secondary
    counts = {
        "gain": secondary != "none",
        "weight": secondary == "centering" and not method.peer,
        "projector": not method.whole_twist,
        "solver": method.constrained or bool(method.peer),
        "limits": method.holds_limits and not method.peer and secondary != "plan",
    }
    return {name for name, has_effect in counts.items() if has_effect}


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
    middle, half = model.jnt_range.mean(axis=1), 0.5 * np.ptp(model.jnt_range, axis=1)
    model.jnt_range[:] = np.stack([middle - _WIDER * half, middle + _WIDER * half], axis=1)
    unlimited = np.full(model.nv, np.inf)
    task = dataclasses.replace(
        path_task, model=model, velocity_limits=unlimited, acceleration_limits=unlimited
    )
    power = {"gradient": 2, "paper": 1}.get(settings.weight, 0)
    if settings.secondary != "centering":
        power = 0
    return task, settings.model_copy(update={"gain": settings.gain * _WIDER**power})
