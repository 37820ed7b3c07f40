"""Which controllers the compiled kernel knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from qp_twist.kinematics import TwistTask
from qp_twist.limits import DisplacementWindow, MotionLimit, PositionLimit

KNOWN_LIMITS = (PositionLimit, MotionLimit, DisplacementWindow)


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
