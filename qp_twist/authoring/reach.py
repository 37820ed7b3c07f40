"""Where a workpiece stands so that a robot reaches the whole path."""

from __future__ import annotations

from collections.abc import Iterator

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask, placed
from qp_twist.planning import random_configurations
from qp_twist.planning.path_rows import PathRows

_DRAWN = 4000
"""Random configurations whose poses are candidates for the middle of the path."""
_TRIED = 60
_LOOKED_AT = 9
"""Waypoints that have to be reachable, evenly spread."""
_LEANING = np.radians(30.0)
_ROUND = 2
"""Decimals of a placement, m."""


def placements(path_task: PathTask, *, seed: int = 0) -> Iterator[Array]:
    """Displacements of a path, m, (3,), at which the robot reaches it.

    Those above the floor, z = 0, come first, and of them those with the robot in the middle of its
    ranges where it is at the middle of the path.

    Random configurations inside the limits, whose tool is nearly oriented as the middle waypoint
    asks, say where that waypoint could be; the others are then reached from there by Newton's
    method, inside the limits or not. Orientations stay, and so does what the task asks of them.

    Args:
        path_task: The task, whose waypoints are somewhere.
        seed: Of the random configurations.
    """
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    count = len(path_task.waypoints)
    middle = count // 2
    drawn = random_configurations(ranges, _DRAWN, np.random.default_rng(seed))
    _, positions = rows.chain.poses(drawn)
    turned = _turned_away(path_task, drawn, middle) > _LEANING
    # Most robots stand on the floor of their world, and their workpieces do.
    lowest = (path_task.positions - path_task.positions[middle])[:, 2].min()
    sunk = positions[:, 2] + lowest < 0.0
    likely = drawn[np.lexsort((ranges.centring(drawn), sunk, turned))][:_TRIED]
    _, positions = rows.chain.poses(likely)
    spread = np.unique(np.linspace(0, count - 1, min(count, _LOOKED_AT)).round().astype(int))
    for q, position in zip(likely, positions, strict=True):
        shift = np.round(position - path_task.positions[middle], _ROUND)
        if _led(moved(path_task, shift), q, middle, spread):
            yield shift


def moved(path_task: PathTask, shift: Array) -> PathTask:
    """The task with its path displaced, m, (3,)."""
    return placed(path_task, mink.SO3.identity(), np.zeros(3), shift)


def _turned_away(path_task: PathTask, q: Array, index: int) -> Array:
    """By how much the task's angular rows are missed at configurations, rad, (K,)."""
    rows = PathRows(path_task)
    at = np.full(len(q), index)
    _, positions = rows.chain.poses(q)
    # With the distance left out of the norm, the orientation remains.
    errors = rows.errors(q, at) ** 2
    apart = ((positions - path_task.positions[index]) ** 2).sum(axis=1)
    left: Array = np.sqrt(np.maximum(errors - apart, 0.0))
    return left


def _led(path_task: PathTask, q: Array, middle: int, spread: Array) -> bool:
    """Whether q leads from the middle to both ends of a path without leaving a limit."""
    rows, ranges = PathRows(path_task), JointRanges.of(path_task.model)
    for way in (spread[spread >= middle], spread[spread < middle][::-1]):
        here = q
        for index in (middle, *way):
            [here], arrived = rows.correct(here[None], np.array([index]), iterations=15)
            if not arrived[0] or not ranges.inside(here):
                return False
    return True
