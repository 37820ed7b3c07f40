"""Times of a step if many runs are followed in one call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import mink
import numpy as np

from qp_twist.bench.record import Accuracy, Case, Measured, Quantiles
from qp_twist.bench.timer import once
from qp_twist.following import follow as follow_one
from qp_twist.following.batch import follow
from qp_twist.paths import PathTask, load_task

SIZES = (1, 10, 100, 1000, 10_000)
WAYPOINTS = 21
METHOD = "qp_gradient"
THREADS: dict[str, int | None] = {"batch:all_cores": None, "batch:one_thread": 1}
NAMES = tuple(THREADS)


@cache
def piece() -> PathTask:
    """The first waypoints of the deburring run."""
    task = load_task("deburring")
    return replace(
        task,
        waypoints=task.waypoints[:WAYPOINTS],
        flipped_waypoints=None,
        durations=None if task.durations is None else task.durations[:WAYPOINTS],
    )


def moves(count: int, seed: int) -> list[mink.SE3]:
    """Placements of the workpiece: the task's for the first run, near it for the others."""
    rng = np.random.default_rng([seed, 2])
    middle = mink.SE3.from_translation(piece().positions.mean(axis=0))
    size = np.array([0.01] * 3 + [np.radians(1.0)] * 3)
    return [mink.SE3.identity()] + [
        middle @ mink.SE3.exp(size * rng.uniform(-1.0, 1.0, 6)) @ middle.inverse()
        for _ in range(count - 1)
    ]


def time_calls(
    sizes: tuple[int, ...],
    names: list[str],
    times: int,
    seed: int,
    done: Callable[[str], None],
) -> list[Case]:
    """Time calls of every size, in turns.

    The residual of a call is the largest error at a waypoint, m; its error the largest difference,
    rad, of the first run's joints from :func:`qp_twist.follow` by the reference.
    """
    task, all_moves = piece(), moves(max(sizes), seed)
    reference = follow_one(task, METHOD, solver="daqp").q
    rng = np.random.default_rng([seed, 3])
    taken: dict[tuple[int, str], list[int]] = {(n, name): [] for n in sizes for name in names}
    worst = dict.fromkeys(taken, 0.0)
    follow(task, METHOD, moves=all_moves[:1], keep=False)  # compile, or load from the cache
    for _ in range(times):
        for index in rng.permutation(len(taken)).tolist():
            count, name = key = list(taken)[index]
            options: dict[str, Any] = {"moves": all_moves[:count], "threads": THREADS[name]}
            took, runs = once(partial(follow, task, METHOD, keep=False, **options))
            taken[key].append(took // max(1, int(runs.steps.sum())))
            worst[key] = max(worst[key], float(np.nanmax(runs.position_error)))
            done(name)
    cases = []
    for count in sizes:
        kept = follow(task, METHOD, moves=all_moves[: min(count, 100)], keep=True).q
        assert kept is not None
        apart = float(np.abs(kept[0] - reference).max())
        results = tuple(
            Measured(
                contender=name,
                warm=Quantiles.of(taken[count, name]),
                accuracy=Accuracy(residual=worst[count, name], excess=0.0, error=apart),
            )
            for name in names
        )
        case = Case(
            group="batch",
            x=count,
            title=f"{count:,} runs of {WAYPOINTS} waypoints, time of a step",
            joints=int(task.model.nv),
            rows=task.projector.rank,
            steps=0,
            active_share=None,
            results=results,
        )
        cases.append(case)
    return cases
