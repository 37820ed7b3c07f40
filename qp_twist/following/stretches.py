"""Follow a path in stretches, with joint moves between them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following.trajectory import Trajectory
from qp_twist.following.walk import walk
from qp_twist.paths import MethodSettings, PathTask, stretches
from qp_twist.planning import EFFORT, JointMoves, NoJointMove
from qp_twist.planning.central import best_of_each_branch, central_configurations
from qp_twist.planning.starts import what_forbids

_STARTS = 12
"""Largest number of starts that are tried for a stretch."""
_FIRST_EFFORT = 300
"""Random configurations of a joint move to each start at first; then all starts get ``EFFORT``."""


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
    start: Array | None = None,
    plan: Array | None = None,
    **options: Any,
) -> Trajectory:
    """As :func:`~qp_twist.following.walk.walk`, also for a task with joint moves.

    Each stretch of the path between joint moves is followed by itself. It begins at the start to
    which the joints move soonest, of those from which the method keeps the whole stretch: the
    branch may change on a joint move. Candidates are the configuration nearest to the end of the
    stretch before, and local minima of z on the stretch's first waypoint, of every branch.

    Args:
        path_task: The task, without via points, with a start.
        method: Name of the method.
        settings: Of the method.
        start: In place of the task's, (nq,).
        plan: Rows of the reference of the secondary "plan", one for each waypoint.
        options: Other arguments of ``walk``.

    Returns:
        The trajectory, with the rows of the joint moves. If a stretch cannot be reached by a joint
        move, it ends before, with the reason as ``failure``.
    """

    def walked(run: range, start: Array | None) -> Trajectory:
        rows = None if plan is None else plan[run.start : run.stop]
        s = np.array(run, dtype=np.float64)
        return walk(path_task, method, settings, s=s, start=start, plan=rows, **options)

    runs = stretches(path_task)
    parts = [walked(runs[0], start)]
    if len(runs) == 1:
        return parts[0]
    moves = JointMoves(path_task)
    found: list[Move] = []
    for before, run in itertools.pairwise(runs):
        end = parts[-1].q[-1]
        if parts[-1].s[-1] < before[-1] or parts[-1].diverged_at is not None:
            break  # it was stopped
        tried: list[Trajectory] = []
        for candidate in _starts(path_task, run, end, plan, method, moves):
            with contextlib.suppress(InvalidInput):  # the start cannot be corrected
                tried.append(walked(run, candidate))
        tried.sort(key=lambda t: float(moves.seconds(np.array([end, t.q[0]]))[0]))
        move = _soonest(end, tried, run[-1], moves) if tried else what_forbids(path_task, run.start)
        if isinstance(move, str):
            failure = f"no joint move from waypoint {run.start} to {run.start + 1}: {move}"
            parts[-1] = dataclasses.replace(parts[-1], failure=parts[-1].failure or failure)
            break
        number, rows = move
        parts.append(tried[number])
        found.append(Move(run.start, rows, moves.seconds(rows)))
    return _joined(parts, found)


def _starts(
    path_task: PathTask, run: range, end: Array, plan: Array | None, method: str, moves: JointMoves
) -> Iterator[Array]:
    """Starts of a stretch (nv,): that of a plan; else candidates."""
    if plan is not None:
        yield plan[run.start]
        return
    yield end
    for found in best_of_each_branch(central_configurations(path_task, run.start), _STARTS):
        yield moves.nearest_turn(found.q[None], end)[0]


def _soonest(
    end: Array, tried: Sequence[Trajectory], last: int, moves: JointMoves
) -> tuple[int, Array] | str:
    """The first run that a joint move leads to, a complete one if possible, and its rows.

    Or why there is none.
    """
    why = ""
    whole = [t.s[-1] == last and t.keeps_rows for t in tried]
    for complete, effort in itertools.product((True, False), (_FIRST_EFFORT, EFFORT)):
        for number, trajectory in enumerate(tried):
            if whole[number] != complete:
                continue
            try:
                return number, moves.found(end, trajectory.q[0], effort)
            except NoJointMove as error:
                why = why or error.why
    return why


def _joined(parts: Sequence[Trajectory], moves: Sequence[Move]) -> Trajectory:
    """One trajectory of stretches and the joint moves between them."""

    def chained(name: str) -> tuple[Any, ...]:
        return tuple(itertools.chain.from_iterable(getattr(part, name) for part in parts))

    stacked: dict[str, Any] = {n: np.concatenate([getattr(part, n) for part in parts]) for n in
               ("q", "s", "scale", "iterations")}  # fmt: skip
    joined = dataclasses.replace(
        parts[-1],
        binding=chained("binding"),
        statuses=chained("statuses"),
        failure=next((part.failure for part in parts if part.failure), ""),
        seconds=sum(part.seconds for part in parts),
        compiled=sum(part.compiled for part in parts),
        **stacked,
    )
    durations = None
    if parts[0].durations is not None:
        times = [part.durations[bool(k) :] for k, part in enumerate(parts)]  # type: ignore[index]
        pairs = itertools.zip_longest(times, (move.seconds for move in moves), fillvalue=())
        durations = np.concatenate(list(itertools.chain.from_iterable(pairs)))
    if not moves:
        return joined
    begins = np.cumsum([len(part.q) for part in parts[:-1]], dtype=np.intp)
    rows, places = np.concatenate([m.q[1:-1] for m in moves]), np.concatenate([m.s for m in moves])
    at = np.repeat(begins, [len(move.q) - 2 for move in moves])
    return joined.with_rows(at, rows, places, durations)
