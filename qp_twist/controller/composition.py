"""Which controllers have a prepared step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import mink
import mujoco

from qp_twist.checks import Array
from qp_twist.kinematics import SecondaryObjective, TwistTask
from qp_twist.limits import BoxLimit, DisplacementWindow, MotionLimit, PositionLimit

BOXES = (PositionLimit, MotionLimit, DisplacementWindow)


class Composition(Protocol):
    """What a :class:`~qp_twist.Controller` is composed of, as far as a prepared step reads it."""

    model: mujoco.MjModel
    twist_tasks: tuple[TwistTask, ...]
    secondary: tuple[SecondaryObjective, ...]
    secondary_space: str
    limits: list[mink.Limit]
    levels: tuple[tuple[Any, ...], ...]
    soft_tasks: tuple[mink.tasks.BaseTask, ...]
    metric: Array
    joint_weight: float
    singularity: float
    free_twist_costs: tuple[float, float]
    solver: str
    on_infeasible: str


def composition_known(levels: Sequence[Sequence[Any]], limits: Sequence[Any]) -> bool:
    """Whether a step of this composition can be prepared.

    Levels of TwistTasks whose targets stand in the world and whose bands are hard, and limits that
    are boxes of this package or rows of any class.
    """
    return all(
        type(t) is TwistTask and t.relative_to is None and not has_soft_bands(t)
        for level in levels
        for t in level
    ) and all(type(limit) in BOXES or not isinstance(limit, BoxLimit) for limit in limits)


def has_soft_bands(task: TwistTask) -> bool:
    """Whether a band of the task may be left, which takes unknowns more than the joints."""
    return any(band.weight is not None for band in task.bands)
