"""Follow a path in stretches, with joint moves between them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following.further_rows import with_rows
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
        if not before.ended or before.diverged_at is not None:
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
    counts = [len(part.q) for part in parts]
    begins = np.cumsum(counts[:-1], dtype=np.intp)
    diverged = [(run, part.diverged_at) for run, part in zip(runs, parts, strict=False)]
    stacked: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("q", "position_error", "axis_error", "sigma_min", "scale", "iterations",
                     "band_excess")
    }  # fmt: skip
    joined = dataclasses.replace(
        parts[0],
        path_task=task,
        s=np.concatenate([run.start + part.s for run, part in zip(runs, parts, strict=False)]),
        binding=tuple(itertools.chain.from_iterable(part.binding for part in parts)),
        statuses=tuple(itertools.chain.from_iterable(part.statuses for part in parts)),
        diverged_at=next((run.start + at for run, at in diverged if at is not None), None),
        failure=next((part.failure for part in parts if part.failure), ""),
        blocked_by=parts[-1].blocked_by,
        seconds=sum(part.seconds for part in parts),
        compiled=sum(part.compiled for part in parts),
        **stacked,
    )
    inner = [len(move.q) - 2 for move in moves]
    durations = None
    if task.durations is not None:
        times = [part.durations[bool(k) :] for k, part in enumerate(parts)]  # type: ignore[index]
        pairs = itertools.zip_longest(times, (move.seconds for move in moves), fillvalue=())
        durations = np.concatenate(list(itertools.chain.from_iterable(pairs)))
    if not sum(inner):
        return dataclasses.replace(joined, durations=durations)
    rows, places = np.concatenate([m.q[1:-1] for m in moves]), np.concatenate([m.s for m in moves])
    return with_rows(joined, np.repeat(begins, inner), rows, places, durations)
