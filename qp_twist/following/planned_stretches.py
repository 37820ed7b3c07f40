"""Plan a path in stretches, with joint moves between them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from qp_twist.checks import Array
from qp_twist.following.stretches import Move
from qp_twist.paths import PathTask, stretch_task, stretches
from qp_twist.planning import EFFORT, JointMoves, NoJointMove, Plan
from qp_twist.planning.central import best_of_each_branch, central_configurations
from qp_twist.planning.objective import Objective

_OTHERS = 3
"""Number of other starts from which a stretch is planned if its best plan cannot be reached."""

Planner = Callable[[PathTask, Array | None], Plan]
"""The plan of a stretch from a start (nv,), or from any if it is ``None``."""


def plan_stretches(
    path_task: PathTask, goal: Objective, start: Array | None, planned: Planner
) -> Plan:
    """The plan of a task with joint moves; see :func:`qp_twist.plan`.

    Args:
        path_task: The task, without via points.
        goal: The objective.
        start: On the first waypoint, (nv,); free if ``None``.
        planned: Plans a stretch.

    Raises:
        KeyboardInterrupt: On Ctrl-C before the last stretch has a motion.
    """
    moves, runs = JointMoves(path_task), stretches(path_task)
    plans: list[Plan] = []
    found: list[Move] = []
    for run in runs:
        task = stretch_task(path_task, run, path_task.start)
        if not plans:
            plans.append(planned(task, start))
            if plans[0].q is None:
                return _none(path_task, plans[0], run, "")
            continue
        if plans[-1].interrupted:
            raise KeyboardInterrupt
        end, why = plans[-1].motion()[-1], ""
        candidates = _plans(task, planned, end)
        best = next(candidates)
        if best.q is None:
            return _none(path_task, best, run, "")
        candidates = itertools.chain([best], candidates)
        if goal.travel:  # the way to a stretch counts, too
            candidates = iter(sorted(candidates, key=lambda p: _with_way(goal, end, p)))
        for plan in candidates:
            q = moves.nearest_turn(plan.motion(), end)
            try:
                rows = moves.found(end, q[0], EFFORT)
            except NoJointMove as error:
                why = why or error.why
                continue
            plans.append(dataclasses.replace(plan, q=q))
            found.append(Move(run.start, rows, moves.seconds(rows)))
            break
        else:
            return _none(path_task, best, run, why)
    return _joined(path_task, goal, runs, plans, found)


def _plans(task: PathTask, planned: Planner, end: Array) -> Iterator[Plan]:
    """The best plan of a stretch; then plans from other starts, those nearest to ``end`` first."""
    yield planned(task, None)
    others = [found.q for found in best_of_each_branch(central_configurations(task), 4 * _OTHERS)]
    others.sort(key=lambda q: float(np.abs(q - end).max()))
    yield from (plan for q in others[:_OTHERS] if (plan := planned(task, q)).q is not None)


def _with_way(goal: Objective, end: Array, plan: Plan) -> float:
    """Value of a plan with the straight way of the joints to it from ``end`` (nv,)."""
    return goal.value(np.vstack([end[None], plan.motion()]))


def _none(path_task: PathTask, plan: Plan, run: range, why: str) -> Plan:
    """A plan without a motion, for the reason of one stretch or of the move to it."""
    certificate = plan.certificate
    if why:
        certificate = dataclasses.replace(
            certificate, kind="move", waypoints=(run.start, run.start + 1), detail=why
        )
    else:
        shifted = tuple(run.start + k for k in certificate.waypoints)
        certificate = dataclasses.replace(certificate, waypoints=shifted)
    return dataclasses.replace(
        plan, path_task=path_task, q=None, value=np.nan, bound=np.nan, certificate=certificate
    )


def _joined(
    path_task: PathTask, goal: Objective, runs: list[range], plans: list[Plan], moves: list[Move]
) -> Plan:
    """One plan of the stretches' plans and the joint moves between them."""
    rows, places = [plans[0].motion()], [np.array(runs[0], dtype=np.float64)]
    for run, plan, move in zip(runs[1:], plans[1:], moves, strict=True):
        rows += [move.q[1:-1], plan.motion()]
        places += [move.s, np.array(run, dtype=np.float64)]
    q, s = np.concatenate(rows), np.concatenate(places)
    counts = np.array([len(plan.motion()) for plan in plans])
    bounds = np.array([plan.bound for plan in plans])
    value, bound = goal.value(q), np.nan
    if goal.margin:
        bound = float(bounds.min())
    elif not goal.travel:
        bound = float(counts @ bounds / counts.sum())
    elif not goal.centering:
        bound = float(bounds.sum())
    if goal.centering:  # of the waypoints, not of the joint moves' rows
        z = goal.ranges.centring
        value += goal.centering * float(z(q[s == np.floor(s)]).mean() - z(q).mean())
    return dataclasses.replace(
        plans[-1],
        path_task=path_task,
        q=q,
        s=s,
        value=value,
        bound=bound,
    )
