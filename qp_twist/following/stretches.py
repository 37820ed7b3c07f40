"""Follow a path in stretches, with joint moves between them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.control import Status
from qp_twist.errors import InvalidInput
from qp_twist.following.trajectory import Trajectory
from qp_twist.following.walk import walk
from qp_twist.paths import (
    METHODS,
    MethodSettings,
    PathTask,
    stretch_task,
    stretches,
)
from qp_twist.planning import EFFORT, JointMoves, NoJointMove
from qp_twist.planning.central import best_of_each_branch, central_configurations
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.starts import corrected_start, what_forbids

_STARTS = 12
"""Largest number of starts that are tried for a stretch."""
_FIRST_EFFORT = 300
"""Random configurations of a joint move to each start at first; then all starts get ``EFFORT``."""

Walk = Callable[[PathTask, int], Trajectory]
"""Follows a stretch; with the number of waypoints before it."""


class Move(NamedTuple):
    """A joint move between two stretches."""

    to: int
    """Index of the waypoint that it leads to."""
    q: Array
    """Its rows, both ends included, (N, nv)."""
    seconds: Array
    """Least times between them at the joints' speeds, s, (N − 1,)."""

    @property
    def s(self) -> Array:
        """Parameter of the path at its inner rows, (N − 2,): by the times."""
        times = np.cumsum(self.seconds)
        inner: Array = self.to - 1 + times[:-1] / times[-1]
        return inner


def follow_stretches(
    path_task: PathTask,
    method: str,
    settings: MethodSettings,
    *,
    plan: Array | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> Trajectory:
    """As :func:`~qp_twist.following.walk.walk`, for a task with joint moves.

    Each stretch of the path between joint moves is followed by itself. It begins at the start to
    which the joints move soonest, of those from which the method keeps the whole stretch: the
    branch may change on a joint move. Candidates are the configuration nearest to the end of the
    stretch before, and local minima of z on the stretch's first waypoint, of every branch.

    Args:
        path_task: The task, without via points, with a start.
        method: Name of the method.
        settings: Of the method.
        plan: Rows of the reference of the secondary "plan", one for each waypoint.
        progress: Called with the number of waypoints done.
        options: Other arguments of ``walk``.

    Returns:
        The trajectory, with the rows of the joint moves. If a stretch cannot be reached by a joint
        move, it ends before, with the reason as ``failure``.
    """
    moves = JointMoves(path_task)
    runs = stretches(path_task)

    def walked(run: range, start: Array) -> Trajectory:
        def report(done: int) -> None:
            if progress is not None:
                progress(run.start + done)

        return walk(
            stretch_task(path_task, run, start),
            method,
            settings,
            plan=None if plan is None else plan[run.start : run.stop],
            progress=report,
            **options,
        )

    parts = [walked(runs[0], path_task.start)]
    found: list[Move] = []
    for run in runs[1:]:
        before = parts[-1]
        if len(before.q) < len(before.path_task.waypoints) or before.diverged_at is not None:
            break  # it was stopped
        tried: list[Trajectory] = []
        for start in _starts(path_task, run, before.q[-1], plan, method, moves):
            try:
                tried.append(walked(run, start))
            except InvalidInput:  # the start cannot be corrected
                continue
        end = before.q[-1]
        apart = {id(t): float(moves.seconds(np.array([end, t.q[0]]))[0]) for t in tried}
        tried.sort(key=lambda t: apart[id(t)])
        move = (
            what_forbids(stretch_task(path_task, run, end))
            if not tried
            else _soonest(end, tried, moves)
        )
        if isinstance(move, str):
            failure = f"no joint move from waypoint {run.start} to {run.start + 1}: {move}"
            parts[-1] = dataclasses.replace(before, failure=before.failure or failure)
            break
        number, rows = move
        parts.append(tried[number])
        found.append(Move(run.start, rows, moves.seconds(rows)))
    return _joined(path_task, runs, parts, found)


def _starts(
    path_task: PathTask, run: range, end: Array, plan: Array | None, method: str, moves: JointMoves
) -> Iterator[Array]:
    """Starts of a stretch (nv,): that of a plan; else candidates."""
    if plan is not None:
        yield plan[run.start]
        return
    task = stretch_task(path_task, run, end)
    with contextlib.suppress(InvalidInput):  # it cannot be corrected
        yield corrected_start(task, task.waypoints[0], holds_limits=METHODS[method].holds_limits)
    for found in best_of_each_branch(central_configurations(task), _STARTS):
        yield moves.nearest_turn(found.q[None], end)[0]


def _soonest(end: Array, tried: Sequence[Trajectory], moves: JointMoves) -> tuple[int, Array] | str:
    """The first run that a joint move leads to, a complete one if possible, and its rows.

    Or why there is none.
    """
    why = ""
    whole = [trajectory.passes for trajectory in tried]
    for complete, effort in itertools.product((True, False), (_FIRST_EFFORT, EFFORT)):
        for number, trajectory in enumerate(tried):
            if whole[number] != complete:
                continue
            try:
                return number, moves.found(end, trajectory.q[0], effort)
            except NoJointMove as error:
                why = why or error.why
    return why


def _joined(
    task: PathTask, runs: Sequence[range], parts: Sequence[Trajectory], moves: Sequence[Move]
) -> Trajectory:
    """One trajectory of stretches and the joint moves between them."""
    first = parts[0]
    columns: dict[str, list[Array]] = {name: [] for name in _COLUMNS}
    binding: list[tuple[str, ...]] = []
    statuses: list[Status] = []
    offset, diverged_at = 0, None
    for number, part in enumerate(parts):
        if number:
            inner = _of_move(task, moves[number - 1])
            for name, column in columns.items():
                if name in inner:
                    column.append(inner[name])
            passed = len(moves[number - 1].q) - 2
            binding += [()] * passed
            statuses += [Status.SOLVED] * passed
            offset += passed
        for name, column in columns.items():
            values = getattr(part, name)
            if values is not None:
                column.append(values + runs[number].start if name == "s" else values)
        if number and part.durations is not None:
            columns["durations"][-1][0] = moves[number - 1].seconds[-1]
        binding += part.binding
        statuses += part.statuses
        if part.diverged_at is not None:
            diverged_at = offset + part.diverged_at
        offset += len(part.q)
    stacked: dict[str, Any] = {
        name: np.concatenate(column) if column else None for name, column in columns.items()
    }
    return dataclasses.replace(
        first,
        path_task=task,
        binding=tuple(binding),
        statuses=tuple(statuses),
        diverged_at=diverged_at,
        failure=next((part.failure for part in parts if part.failure), ""),
        blocked_by=parts[-1].blocked_by,
        seconds=sum(part.seconds for part in parts),
        compiled=sum(part.compiled for part in parts),
        **stacked,
    )


_COLUMNS = (
    "q",
    "s",
    "position_error",
    "axis_error",
    "sigma_min",
    "scale",
    "iterations",
    "band_excess",
    "durations",
)


def _of_move(task: PathTask, move: Move) -> dict[str, Array]:
    """The columns of a trajectory for the inner rows of a joint move."""
    count = len(move.q) - 2
    before = np.full(count, move.to - 1)
    found: dict[str, Array] = {
        "q": move.q[1:-1],
        "s": move.s,
        "scale": np.ones(count),
        "iterations": np.zeros(count, dtype=np.int64),
        "sigma_min": PathRows(task).sigma_min(move.q[1:-1], before),
    }
    for name in ("position_error", "axis_error", "band_excess"):
        found[name] = np.zeros(count)
    if task.durations is not None:
        found["durations"] = move.seconds[:-1]
    return found
