"""Tasks made of the waypoints of another one: parts of it, or with some of them repeated."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from qp_twist.checks import Indices
from qp_twist.paths.segment import Segment

if TYPE_CHECKING:
    from qp_twist.paths.path_task import PathTask


def with_waypoints(path_task: PathTask, source: Indices) -> PathTask:
    """The task of waypoints at indices (M,) of a path, each with the projector it has there.

    It begins at its own first waypoint, from the same start. The time to a waypoint is that from
    the one before it, also over those that are left out; a joint move leads to a waypoint that one
    leads to. A projector is blended in where the path is passed in its direction.
    """
    firsts = np.array([segment.first for segment in path_task.segments], dtype=np.intp)
    number = np.searchsorted(firsts, source, side="right") - 1
    segments = []
    for j in np.flatnonzero(np.diff(number)) + 1:
        if number[j] < 0:  # back at the beginning
            projector, blend = path_task.projector, 0
        else:
            of = path_task.segments[number[j]]
            projector, blend = of.projector, of.blend if source[j - 1] < of.first else 0
        segments.append(Segment(int(j), projector, blend))
    flipped, times = path_task.flipped_waypoints, None
    if path_task.durations is not None:
        times = np.append(0.0, path_task.durations[source[1:]])
        for j in np.flatnonzero(np.diff(source) > 1) + 1:
            times[j] = path_task.durations[source[j - 1] + 1 : source[j] + 1].sum()
    moves = np.flatnonzero(np.isin(source[1:], path_task.joint_moves)) + 1
    return replace(
        path_task, waypoints=tuple(path_task.waypoints[k] for k in source),
        flipped_waypoints=None if flipped is None else tuple(flipped[k] for k in source),
        best_start=False, starts={}, durations=times, projector=path_task.projectors[number[0] + 1],
        segments=tuple(segments), joint_moves=tuple(moves.tolist()),
        lines=None if path_task.lines is None else path_task.lines[source],
        parts=tuple(path_task.parts[k] for k in source) if path_task.parts else (),
        process=tuple(
            (max(int(np.searchsorted(source, at, side="right")) - 1, 0), text)
            for at, text in path_task.process
        ),
        from_start="nothing" if source[0] else path_task.from_start,
        preference=path_task.preference and path_task.preference.part(source),
    )  # fmt: skip
