"""Which controllers the compiled kernel knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import mink
import mujoco

from qp_twist.checks import Array
from qp_twist.kinematics import SecondaryObjective, TwistTask
from qp_twist.limits import DisplacementWindow, MotionLimit, PositionLimit

KNOWN_LIMITS = (PositionLimit, MotionLimit, DisplacementWindow)


class Composition(Protocol):
    """What a :class:`~qp_twist.Controller` is composed of, as far as a prepared step reads it."""

    model: mujoco.MjModel
    twist_tasks: tuple[TwistTask, ...]
    secondary: tuple[SecondaryObjective, ...]
    secondary_space: str
    limits: list[mink.Limit]
    metric: Array
    joint_weight: float
    singularity: float
    free_twist_costs: tuple[float, float]
    solver: str


def composition_known(
    levels: Sequence[Sequence[Any]], soft_tasks: Sequence[Any], limits: Sequence[Any]
) -> bool:
    """Whether a step of this composition can be compiled.

    One level of TwistTasks whose targets stand in the world, without tolerance bands, no other mink
    tasks, and limits of this package that are boxes.
    """
    return (
        len(levels) == 1
        and not soft_tasks
        and all(type(t) is TwistTask and t.relative_to is None for t in levels[0])
        and all(type(limit) in KNOWN_LIMITS for limit in limits)
    )
