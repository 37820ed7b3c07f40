"""Stretches of a path between joint moves."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from qp_twist.checks import Mask
from qp_twist.errors import InvalidInput

if TYPE_CHECKING:
    from qp_twist.paths.path_task import PathTask


def refuse_joint_moves(path_task: PathTask, what: str) -> None:
    """Refuse a task with joint moves where runs are compared waypoint by waypoint.

    Raises:
        InvalidInput: If it has any.
    """
    if path_task.joint_moves:
        raise InvalidInput(
            f"{what}: {path_task.name} has joint moves, which have other rows in each run; take "
            "one curve of it (curves in [path]), or look at one run with qp-twist report."
        )


def stretches(path_task: PathTask) -> list[range]:
    """The waypoints between the joint moves, stretch by stretch; via points belong to none."""
    ends = [0, *path_task.joint_moves, len(path_task.waypoints)]
    found = [range(begin, end) for begin, end in pairwise(ends)]
    inner = found[1:-1]
    return [run for run in found if len(run) > 1 or run not in inner]


def in_joint_moves(path_task: PathTask, count: int | None = None) -> Mask:
    """Which intervals between the first ``count`` waypoints are joint moves, (count − 1,)."""
    found = np.zeros(len(path_task.waypoints) - 1, dtype=bool)
    found[np.array(path_task.joint_moves, dtype=np.intp) - 1] = True
    return found if count is None else found[: count - 1]


def ways_between(path_task: PathTask) -> tuple[str, ...]:
    """What each interval between two waypoints is, (N − 1,); see :attr:`PathTask.ways`."""
    ways: list[str] = [
        "transfer" if "transfer" in (a, b) else b if a == "contact" else a
        for a, b in pairwise(path_task.parts or ("contact",) * len(path_task.waypoints))
    ]
    for k in path_task.joint_moves:
        ways[k - 1] = "joint move"
    return tuple(ways)


def joint_move_ends(path_task: PathTask) -> list[tuple[int, int]]:
    """The waypoints between which each joint move is, its via points not counted."""
    moves = list(path_task.joint_moves)
    first = [k for k in moves if k - 1 not in moves]
    last = [k for k in moves if k + 1 not in moves]
    return [(begin - 1, end) for begin, end in zip(first, last, strict=True)]


def without_via_points(path_task: PathTask) -> PathTask:
    """The task without the points that its joint moves only pass."""
    on_path = path_task.at().on_path
    return path_task if on_path.all() else path_task.part(np.flatnonzero(on_path))
