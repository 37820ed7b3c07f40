"""Which controllers have a compiled step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from qp_twist.constraints import BoxLimit, DisplacementWindow, MotionLimit, PositionLimit
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
