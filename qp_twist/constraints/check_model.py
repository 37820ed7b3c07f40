"""Check that a limit or task belongs to the robot it is used with."""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np

from qp_twist.constraints.position_limit import PositionLimit
from qp_twist.errors import InvalidInput


def check_model(name: str, item: Any, nv: int) -> None:
    """Refuse an item made for a model with another number of degrees of freedom.

    Raises:
        InvalidInput: If it was.
    """
    given = _degrees_of_freedom(item)
    if given is not None and given != nv:
        raise InvalidInput(
            f"{name}: {type(item).__name__} is for a model of {given} degrees of freedom, this one "
            f"has {nv}; make it from the same model."
        )


def _degrees_of_freedom(item: Any) -> int | None:
    """Degrees of freedom of the model that an item was made with, if known."""
    if isinstance(item, PositionLimit):
        return len(item.ranges.names)
    if isinstance(item, mink.PostureTask):  # a DampingTask, too
        return len(item.cost)
    if isinstance(item, mink.VelocityLimit) and item.projection_matrix is not None:
        return int(np.shape(item.projection_matrix)[1])
    model = getattr(item, "model", None)
    return int(model.nv) if isinstance(model, mujoco.MjModel) else None
