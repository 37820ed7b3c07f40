"""Steps that no motion makes, however the rest of the path goes: each is searched by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy  # which loads its parts when they are first used

from qp_twist.checks import Array, Mask
from qp_twist.constraints import Clearance, JointCouplings
from qp_twist.planning.certificate import Certificate
from qp_twist.planning.layer import TURN
from qp_twist.planning.levels import COARSE, Level, Levels, Progress
from qp_twist.planning.manifold_net import COVERED
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.problem import Problem
from qp_twist.planning.sentence import Sentence
from qp_twist.planning.smooth import refine

_SUSPECTS, _TRIAL, _MOST = 24, 10, 4
"""Largest number of steps of a path that are tried near it, iterations of each, and the largest
number that are searched: each takes as long as two layers."""
_PAIRS, _APART = 24, 0.15
"""Number of pairs of configurations from which programs shorten a step, and their distance in some
joint, rad or m."""
_LAWSON = 20
"""Iterations of Lawson's weights."""
_CLEARLY = 1.05
"""Share of the allowed step above which the shortest one that programs reach counts as too long:
what is closer is left to the finer grids."""


def impossible_step(problem: Problem, q: Array, progress: Progress) -> Certificate | None:
    """Why there is no motion, if a step of a path q (N, nv) that is too long has none by itself.

    Then no motion of the whole path has one. Programs shorten the step from the best pairs of
    configurations of its two layers. Bands and constraints are left out, which makes a motion
    easier. With fewer than two free degrees finer grids take seconds; with more, layers are
    samples, of which nothing follows.
    """
    if problem.freedom != COVERED:
        return None
    left, longest = [], _needed(problem, q).max(axis=1)
    for first in np.argsort(-longest)[:_SUSPECTS].tolist():
        if longest[first] <= _CLEARLY:
            break
        alone = _alone(problem, first)
        near = refine(alone, q[first : first + 2], _TRIAL).q
        if _needed(alone, near).max() > _CLEARLY:
            left.append((_needed(alone, near).max(), first, alone, near))
    for _, first, alone, near in sorted(left, key=lambda of: -of[0])[:_MOST]:
        level = Levels(alone, progress).at(COARSE, alone.limits.steps, [0, 1])
        if level.has_gaps:
            continue
        share = np.full(q.shape[1], np.inf)
        for pair in (near, *_pairs(alone, level)):
            share = min(share, _needed(alone, refine(alone, pair).q)[0], key=np.max)
            if share.max() <= _CLEARLY:
                break
        else:
            at, joint = (first + 1, first + 2), problem.limits.ranges.names[int(np.argmax(share))]
            return Certificate(
                "speed", level.grid, at, (joint,), True,
                Sentence(
                    "between waypoints ", at[0], " and ", at[1],
                    f" the best needs {share.max():.3g} times the step that {joint} may do, "
                    "wherever it comes from",
                ),
                step_limit=problem.limits.step_limit,
            )  # fmt: skip
    return None


def _needed(problem: Problem, q: Array) -> Array:
    """Steps of a path q (N, nv) as shares of the allowed ones, (N − 1, nv)."""
    share: Array = np.abs(np.diff(q, axis=0)) / problem.limits.steps
    return share


def _alone(problem: Problem, first: int) -> Problem:
    """The problem of the step from a waypoint to the next, without bands and constraints."""
    limits, pace, step = problem.limits, problem.objective.pace, slice(first, first + 1)
    task = problem.path_task.part(slice(first, first + 2)).without_clearance()
    kept = tuple(c for c in task.constraints if isinstance(c, Clearance | JointCouplings))
    task = replace(task, bands=(), constraints=kept)
    rows = PathRows(task)
    return replace(
        problem,
        path_task=task,
        rows=rows,
        objective=replace(problem.objective, pace=pace and pace.part(first, first + 1)),
        start=None if first else problem.start,
        limits=replace(
            limits, steps=limits.steps[step], durations=limits.durations[step],
            speed_changes=limits.speed_changes[:0], hard=rows.hard, on_path=None,
        ),
    )  # fmt: skip


def _pairs(alone: Problem, level: Level) -> Array:
    """Pairs of configurations with short steps from layer to layer, the best first, (K, 2, nv).

    The nearest ones of both layers, and for each of the first the shortest step. Those that differ
    by whole turns from better ones are left out.
    """
    (before, after), steps = (layer.q for layer in level.layers), alone.limits.steps[0]
    shortened, arrived = _shortened(alone, before)
    endless = alone.period > 0.0
    scaled = (np.where(endless, q % TURN, q) / steps for q in (before, after))
    tree = scipy.spatial.KDTree(next(scaled), boxsize=alone.period / steps)
    nearest = tree.query(next(scaled), p=np.inf)[1]
    begin = np.concatenate([before[arrived], before[nearest]])
    step = alone.unwound(np.concatenate([shortened[arrived], after]) - begin)
    pairs = np.stack([begin, begin + step], axis=1)
    left = pairs[np.argsort(np.abs(step / steps).max(axis=1), kind="stable")]
    found: list[Array] = []
    turn = np.where(alone.limits.ranges.hinge, TURN, np.inf)
    while len(left) and len(found) < _PAIRS:
        found.append(left[0])
        apart = np.abs(left - left[0])
        left = left[(np.minimum(apart, np.abs(apart - turn)) > _APART).any(axis=(1, 2))]
    return np.array(found)


def _shortened(alone: Problem, q: Array) -> tuple[Array, Mask]:
    """Where the shortest steps from q (K, nv) lead, (K, nv), and which arrive, (K,).

    The largest share of a joint's step, |d + N u|∞, is minimised along the null space N there by
    Lawson's algorithm: least squares in which each joint's weight is multiplied by its share.
    """
    at, steps = np.ones(len(q), dtype=np.intp), alone.limits.steps[0]
    there, _ = alone.rows.correct(q, at)
    free, share = alone.rows.motions(there, at) / steps[:, None], (there - q) / steps
    weight, rest = np.ones_like(share), share
    for _ in range(_LAWSON):
        weighted = free.swapaxes(1, 2) * weight[:, None]
        normal = weighted @ free + 1e-9 * np.eye(free.shape[2])
        rest = share - (free @ np.linalg.solve(normal, weighted @ share[:, :, None]))[:, :, 0]
        weight *= np.abs(rest)
        weight /= weight.max(axis=1, keepdims=True, initial=1e-300)
    return alone.rows.correct(q + rest * steps, at)
