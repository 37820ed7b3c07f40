"""Lost directions in words: the task, and the part of its twist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import TwistTask
from qp_twist.qp import LostDirection


def in_words(
    lost: Sequence[LostDirection], tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> tuple[LostDirection, ...]:
    """Lost directions of tasks with the bases U of their rows, each with its place in words."""
    return tuple([replace(d, where=_where(d, tasks, bases)) for d in lost])


def _where(
    lost: LostDirection, tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> str:
    """The task that a direction takes most from, and the part of its twist."""
    parts = np.split(lost.direction, np.cumsum([basis.shape[1] for basis in bases])[:-1])
    most = int(np.argmax([np.linalg.norm(part) for part in parts]))
    task = tasks[most]
    if not isinstance(task, TwistTask):
        return f"{type(task).__name__} row {int(np.argmax(np.abs(parts[most])))}"
    twist = bases[most] @ parts[most]
    # The sign of a singular vector is arbitrary: make the largest entry positive.
    twist *= np.sign(twist[np.argmax(np.abs(twist))])
    texts = [
        f"{block} ({', '.join(f'{value:.2f}' for value in entries.round(2) + 0.0)})"
        for block, entries in (("linear", twist[:3]), ("angular", twist[3:]))
        if np.abs(entries).max() > 0.005
    ]
    return f"{task.name} {', '.join(texts)}"
