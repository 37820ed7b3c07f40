"""A task with its part, or the robot's base, displaced."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.paths import PathTask, base_moved, placed


class Placing(NamedTuple):
    """How an offset changes a task."""

    path_task: PathTask
    moves: Literal["part", "base"]
    body: str | None
    about: Array

    def __call__(self, x: Sequence[float] | Array) -> PathTask:
        """The task at an offset (6,)."""
        shift, turn = np.array(x[:3]), mink.SO3.exp(np.array(x[3:]))
        if self.moves == "base":
            return base_moved(self.path_task, turn, shift)
        return placed(self.path_task, turn, self.about, self.about + shift, self.body)


def placing(
    task: PathTask,
    moves: Literal["part", "base"] = "part",
    body: str | None = None,
    about: npt.ArrayLike | None = None,
) -> Placing:
    """How an offset changes a task, with the body and the point of ``[study.placement]``."""
    if moves == "base":
        if body is not None or about is not None:
            raise InvalidInput("moves = 'base': body and about are of the part; leave them out.")
        return Placing(task, moves, None, np.zeros(3))
    table = None if task.study is None else task.study.placement
    if table is not None:
        body = table.body if body is None else body
        about = table.point if about is None else about
    if about is None:
        about = 0.5 * (task.positions.min(axis=0) + task.positions.max(axis=0))
    return Placing(task, moves, body, finite_array("about", about, (3,)))
