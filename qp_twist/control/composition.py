"""What follows from the tasks and limits that a controller is composed of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from qp_twist.constraints import BoxLimit, DisplacementWindow, MotionLimit, PositionLimit, kind_of
from qp_twist.kinematics import TwistTask

BOXES = (PositionLimit, MotionLimit, DisplacementWindow)


def composition_known(levels: Sequence[Sequence[Any]], limits: Sequence[Any]) -> bool:
    """Whether a step of this composition can be prepared.

    It can with levels of TwistTasks, and limits that are boxes of this package or rows of any
    class.
    """
    return all(isinstance(t, TwistTask) for level in levels for t in level) and all(
        type(limit) in BOXES or not isinstance(limit, BoxLimit) for limit in limits
    )


def rows_known(task: TwistTask) -> bool:
    """Whether the kernel computes the task's rows; otherwise the task states them in Python.

    It does for TwistTasks whose targets stand in the world, but not for classes derived from it.
    """
    return type(task) is TwistTask and task.relative_to is None


def damps_by_error(limits: Sequence[Any], on_infeasible: str) -> bool:
    """Whether weak directions are damped by the length of the error (``qp/directions.py``).

    Without a limit of the joints' speed a step is that of the closed form, whatever its length.
    """
    limited = any(
        bool(np.isfinite(v.max_velocity).any())
        if isinstance(v, MotionLimit)
        else kind_of(v) == "velocity"
        for v in limits
    )
    return limited and on_infeasible != "raise"
