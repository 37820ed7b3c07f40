"""Follow or plan a path in stretches, with joint moves between them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following.trajectory import Trajectory
from qp_twist.following.walk import walk
from qp_twist.paths import MethodSettings, PathTask, stretches
from qp_twist.planning import EFFORT, JointMoveSearch, NoJointMove, Plan
from qp_twist.planning.central import best_of_each_branch, central_configurations
from qp_twist.planning.objective import Objective
from qp_twist.planning.plan import slower_than_feed
from qp_twist.planning.preferred import PreferredPoses
from qp_twist.planning.sentence import Sentence
from qp_twist.planning.starts import what_forbids

_STARTS = 12
"""Largest number of starts that are tried for a stretch that is followed."""
_FIRST_EFFORT = 300
"""Random configurations of a joint move to each start at first; then all starts get ``EFFORT``."""
_OTHERS = 3
"""Number of other starts from which a stretch is planned if its best plan cannot be reached."""


class _Move(NamedTuple):
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


# ---------------------------------------------------------------- followed


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
    stretch before, and local minima of z on the stretch's first waypoint, of every branch; with a
    ``plan``, a row for each waypoint, its own.

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
    moves = JointMoveSearch(path_task)
    found: list[_Move] = []
    for before, run in itertools.pairwise(runs):
        end = parts[-1].q[-1]
        if parts[-1].s[-1] < before[-1] or parts[-1].diverged_at is not None:
            break  # it was stopped
        starts = [plan[run.start]] if plan is not None else _starts(path_task, run, end, moves)
        tried: list[Trajectory] = []
        for candidate in starts:
            with contextlib.suppress(InvalidInput):  # the start cannot be corrected
                tried.append(walked(run, candidate))
        tried.sort(key=lambda t: float(moves.seconds(np.array([end, t.q[0]]))[0]))
        reached = _soonest(end, tried, run, moves) if tried else what_forbids(path_task, run.start)
        if isinstance(reached, str):
            failure = f"no joint move from waypoint {run.start} to {run.start + 1}: {reached}"
            parts[-1] = dataclasses.replace(parts[-1], failure=parts[-1].failure or failure)
            break
        parts.append(reached[0])
        found.append(reached[1])
    return _joined_runs(parts, found)


def _starts(path_task: PathTask, run: range, end: Array, moves: JointMoveSearch) -> Iterator[Array]:
    """Candidates for the start of a stretch, (nv,)."""
    yield end
    for found in best_of_each_branch(central_configurations(path_task, run.start), _STARTS):
        yield moves.nearest_turn(found.q[None], end)[0]


def _soonest(
    end: Array, tried: Sequence[Trajectory], run: range, moves: JointMoveSearch
) -> tuple[Trajectory, _Move] | str:
    """The first run that a joint move leads to, complete if possible; or why there is none."""
    why = ""
    whole = [t.s[-1] == run[-1] and t.keeps_rows for t in tried]
    for complete, effort in itertools.product((True, False), (_FIRST_EFFORT, EFFORT)):
        for trajectory in itertools.compress(tried, (w == complete for w in whole)):
            try:
                rows = moves.found(end, trajectory.q[0], effort)
            except NoJointMove as error:
                why = why or error.why
            else:
                return trajectory, _Move(run.start, rows, moves.seconds(rows))
    return why


def _joined_runs(parts: Sequence[Trajectory], moves: Sequence[_Move]) -> Trajectory:
    """One trajectory of stretches and the joint moves between them."""
    if not moves:
        return parts[0]

    joined = dataclasses.replace(
        parts[-1],
        q=np.concatenate([part.q for part in parts]),
        s=np.concatenate([part.s for part in parts]),
        steps=tuple(itertools.chain.from_iterable(part.steps for part in parts)),
        failure=next((part.failure for part in parts if part.failure), ""),
        seconds=sum(part.seconds for part in parts),
        compiled=sum(part.compiled for part in parts),
    )
    durations = None
    if parts[0].durations is not None:
        times = [part.durations[bool(k) :] for k, part in enumerate(parts)]  # type: ignore[index]
        pairs = itertools.zip_longest(times, (move.seconds for move in moves), fillvalue=())
        durations = np.concatenate(list(itertools.chain.from_iterable(pairs)))
    begins = np.cumsum([len(part.q) for part in parts[:-1]], dtype=np.intp)
    rows, places = np.concatenate([m.q[1:-1] for m in moves]), np.concatenate([m.s for m in moves])
    at = np.repeat(begins, [len(move.q) - 2 for move in moves])
    return joined.with_rows(at, rows, places, durations)


# ---------------------------------------------------------------- planned


def plan_stretches(
    path_task: PathTask,
    goal: Objective,
    start: Array | None,
    planned: Callable[[PathTask, Array | None], Plan],
) -> Plan:
    """The plan of a task, with joint moves or none, without via points; see :func:`qp_twist.plan`.

    ``planned`` plans a stretch from a start (nv,), or from any if it is ``None``.

    Raises:
        KeyboardInterrupt: On Ctrl-C before the last stretch has a motion.
    """
    if not path_task.joint_moves:
        return planned(path_task, start)
    moves, runs = JointMoveSearch(path_task), stretches(path_task)
    # After lift-offs, which may be anywhere, the best motion on the path is taken if it can be.
    lifted = path_task.joint_moves if path_task.cuts else ()
    plans: list[Plan] = []
    found: list[_Move] = []
    for run in runs:
        if plans and plans[-1].interrupted:
            raise KeyboardInterrupt
        task = path_task.part(run)
        best = planned(task, None if plans else start)
        if best.q is None:
            return _none(path_task, best, run, "")
        if not plans:
            plans.append(best)
            continue
        end, why = plans[-1].motion()[-1], ""
        candidates: Iterable[Plan] = itertools.chain([best], _other_plans(task, planned, end))
        if goal.travel and run.start not in lifted:  # the way to a stretch counts, too
            at_end = end[None]
            candidates = sorted(
                candidates, key=lambda plan: goal.value(np.vstack([at_end, plan.motion()]))
            )
        for plan in candidates:
            q = moves.nearest_turn(plan.motion(), end)
            try:
                rows = moves.found(end, q[0], EFFORT)
            except NoJointMove as error:
                why = why or error.why
                continue
            plans.append(dataclasses.replace(plan, q=q))
            found.append(_Move(run.start, rows, moves.seconds(rows)))
            break
        else:
            return _none(path_task, best, run, why)
    return _joined_plans(path_task, goal, runs, plans, found)


def _other_plans(
    task: PathTask, planned: Callable[[PathTask, Array | None], Plan], end: Array
) -> Iterator[Plan]:
    """Plans of a stretch from other starts than the best plan's, those nearest to ``end`` first."""
    others = [found.q for found in best_of_each_branch(central_configurations(task), 4 * _OTHERS)]
    others.sort(key=lambda q: float(np.abs(q - end).max()))
    yield from (plan for q in others[:_OTHERS] if (plan := planned(task, q)).q is not None)


def _none(path_task: PathTask, plan: Plan, run: range, why: str) -> Plan:
    """A plan without a motion, for the reason of one stretch or of the move to it."""
    certificate = plan.certificate.later(run.start)
    if why:
        certificate = dataclasses.replace(
            certificate,
            kind="move",
            waypoints=(run.start, run.start + 1),
            detail=Sentence(why),
        )
    return dataclasses.replace(
        plan, path_task=path_task, q=None, value=np.nan, bound=np.nan, certificate=certificate
    )


def _joined_plans(
    path_task: PathTask, goal: Objective, runs: list[range], plans: list[Plan], moves: list[_Move]
) -> Plan:
    """One plan of the stretches' plans and the joint moves between them."""
    rows, places = [plans[0].motion()], [np.array(runs[0], dtype=np.float64)]
    for run, plan, move in zip(runs[1:], plans[1:], moves, strict=True):
        rows += [move.q[1:-1], plan.motion()]
        places += [move.s, np.array(run, dtype=np.float64)]
    q, s = np.concatenate(rows), np.concatenate(places)
    counts = np.array([len(run) for run in runs])
    bounds = np.array([plan.bound for plan in plans])
    value, bound = goal.value(q), np.nan
    if goal.margin:
        bound = float(bounds.min())
    elif not (goal.travel or goal.time):
        bound = float(counts @ bounds / counts.sum())
    elif not goal.centering:
        bound = float(bounds.sum())
    if goal.centering:  # of the waypoints, not of the joint moves' rows
        z = goal.ranges.centering
        value += goal.centering * float(z(q[s == np.floor(s)]).mean() - z(q).mean())
    preferred = PreferredPoses.of(path_task)
    if preferred is not None:
        value += preferred.cost(q[s == np.floor(s)])
    slowest = int(np.argmax([np.nan_to_num(plan.certificate.slower) for plan in plans]))
    certificate = plans[slowest].certificate.later(runs[slowest].start)
    timed = [
        (run.start, plan.path_task, plan.motion()) for run, plan in zip(runs, plans, strict=True)
    ]
    factor, where = slower_than_feed(timed, goal)
    if factor > 1.0:
        certificate = dataclasses.replace(certificate, slower=factor, note=where)
    joined = dataclasses.replace(
        plans[-1], path_task=path_task, q=q, s=s, value=value, bound=bound, certificate=certificate
    )
    if goal.time and joined.durations is not None:
        joined = dataclasses.replace(joined, value=value + goal.time * joined.durations.sum())
    return joined
