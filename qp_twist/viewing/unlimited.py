"""A method without its limits, to show their effect."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, MethodSettings, PathTask

_WIDER = 64.0
"""A power of two: scaling by it and back is exact."""


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
