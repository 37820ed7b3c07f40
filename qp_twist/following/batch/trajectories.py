"""Many runs of a path at once: from other starts, or with other placements of the workpiece."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance
from qp_twist.errors import InvalidInput, QpTwistError
from qp_twist.following.batch.arrays import pose_of, rigid_motions, shared
from qp_twist.following.follow import follow as follow_one
from qp_twist.following.follow import with_options
from qp_twist.following.walk import start_of
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import (
    DEFAULT_METHOD,
    PathTask,
    check_method,
    refuse_joint_moves,
)

Counts = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
_RUNS = 64
"""Number of runs whose waypoints are in memory at a time, on each thread."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Results of K runs along N waypoints.

    The numbers of a run that ends before the last waypoint cover the waypoints it reached; those
    of a run without a start are NaN.

    Attributes:
        q: Configurations, rad or m, (K, N, nq), NaN after a run's end; ``None`` if not kept.
        waypoints: Number of waypoints that each run has done, (K,).
        position_error: Largest linear task error of each run, m, (K,).
        axis_error: Largest angular task error, in the rows of the task, rad, (K,).
        min_margin: Smallest margin of a joint, as :meth:`~qp_twist.JointRanges.margins`, (K,).
        mean_z: Mean of z = ½‖W(θ̄ − θ)‖², (K,).
        max_step: Largest displacement of a joint between two waypoints, rad or m, (K,).
        steps: Number of steps, (K,).
        by_reference: Which runs were completed by the uncompiled reference, (K,).
        failures: Why a run has no start or no step, by the run's index.
    """

    q: Array | None
    waypoints: Counts
    position_error: Array
    axis_error: Array
    min_margin: Array
    mean_z: Array
    max_step: Array
    steps: Counts
    by_reference: Mask
    failures: dict[int, str]


def follow(
    path_task: PathTask,
    method: str = DEFAULT_METHOD,
    *,
    starts: npt.ArrayLike | None = None,
    moves: Sequence[mink.SE3] | npt.ArrayLike | None = None,
    keep: bool = True,
    threads: int | None = None,
    **options: Any,
) -> Trajectories:
    """:func:`qp_twist.follow` for many runs: the same trajectories, to 1e-9.

    Runs of the closed forms ``rmr``, ``rmr_flipped``, ``minimum_norm`` and ``gradient_projection``
    and of this package's QPs run as machine code on all cores; every QP step is verified. A run
    with a waypoint where a limit scales the task, or at a singularity, is computed by
    :func:`qp_twist.follow` instead, which takes longer.

    Memory: with ``keep=False`` a few numbers per run, for any number of waypoints.

    Args:
        path_task: The task.
        method: Name of the method.
        starts: Configurations (K, nq), or one (nq,) for all; the task's by default. They are
            corrected onto the first waypoint.
        moves: Rigid motions of the workpiece in the world, one per run: :class:`mink.SE3`, or
            matrices (K, 4, 4). They move the waypoints with their roll; the roll rule is not
            applied again.
        keep: Whether to return the configurations.
        threads: Number of threads; all cores by default.
        **options: Settings that replace those of the task file, as in :func:`qp_twist.follow`.

    Raises:
        InvalidInput: If an argument is wrong, or the method or the path has no compiled form
            (tolerance bands, acceleration limits, ball joints).
    """
    from qp_twist.following.compiled_walk import STILL, walk_known

    instance("batch.follow(path_task, …)", path_task, PathTask)
    refuse_joint_moves(path_task, "batch.follow")
    path_task = with_options(
        path_task, [check_method(method)], options, f"batch.follow({method!r})"
    )
    settings = path_task.settings(method)
    if settings.secondary == "plan" or not walk_known(path_task, method, settings):
        kept = sorted({constraint.kind for constraint in path_task.stated_constraints})
        reason = f", since the task has to keep its {' and its '.join(kept)}" if kept else ""
        raise InvalidInput(
            f"batch.follow: {method} on {path_task.name} has no compiled form{reason}; follow the "
            "runs one by one with qp_twist.follow."
        )
    motions = STILL if moves is None else rigid_motions("batch.follow(moves=…)", moves)
    q0 = _starts(path_task, method, starts, len(motions))
    motions = np.ascontiguousarray(np.broadcast_to(motions, (len(q0), 12)))
    return _Batch(path_task, method, q0, motions).run(keep, threads)


class _Batch:
    """The runs of one call: by the kernel, and what it cannot complete by the reference."""

    def __init__(self, path_task: PathTask, method: str, starts: Array, moves: Array) -> None:
        from qp_twist.following.compiled_walk import CompiledWalk

        self.path_task, self.method = path_task, method
        self.walk = CompiledWalk(path_task, method, path_task.settings(method))
        self.starts, self.moves = starts.copy(), moves
        self.ranges = JointRanges.of(path_task.model)
        self.failures: dict[int, str] = {}
        self.numbers = np.zeros((len(starts), 6))
        self.ends = np.zeros(len(starts), dtype=np.int64)

    def run(self, keep: bool, threads: int | None) -> Trajectories:
        """Do all runs."""
        count, waypoints = len(self.starts), len(self.path_task.waypoints)
        kept = np.zeros((count if keep else 0, waypoints, self.starts.shape[1]))
        self._correct_starts(threads)
        shared(count, lambda part: self._by_kernel(part, kept), threads)
        by_reference = self.ends < waypoints
        by_reference[list(self.failures)] = True  # runs without a start
        for run in np.flatnonzero(by_reference).tolist():
            self._by_reference(run, kept)
        errors, axis, margin, z, step, steps = self.numbers.T
        return Trajectories(
            kept if keep else None, self.ends, errors, axis, margin, z, step,
            np.nan_to_num(steps).astype(np.int64), by_reference, self.failures,
        )  # fmt: skip

    def _by_kernel(self, part: slice, kept: Array) -> None:
        for first in range(part.start, min(part.stop, len(self.starts)), _RUNS):
            some = slice(first, min(part.stop, first + _RUNS))
            q = kept[some]
            if not len(kept):
                q = np.zeros((len(self.starts[some]), *kept.shape[1:]))
            q[:, 0] = self.starts[some]
            ends, iterations, errors = self.walk.many(self.moves[some], q)
            after = np.arange(q.shape[1]) >= ends[:, None]
            q[after], errors[after] = np.nan, np.nan
            self.ends[some] = ends
            self.numbers[some] = self._measured(q, errors, ends, iterations)

    def _measured(self, q: Array, errors: Array, ends: Counts, iterations: Counts) -> Array:
        """The numbers of runs (K, N, nq), NaN after their ends, in the order of the result."""
        return np.column_stack([
            np.fmax.reduce(errors, axis=1),
            np.fmin.reduce(self.ranges.margins(q), axis=(1, 2), initial=np.inf),
            np.nansum(self.ranges.centering(q), axis=1) / ends,
            np.fmax.reduce(np.abs(np.diff(q, axis=1)), axis=(1, 2), initial=0.0),
            iterations.sum(axis=1),
        ])  # fmt: skip

    def _correct_starts(self, threads: int | None) -> None:
        """Correct starts onto their first waypoint, as :func:`qp_twist.follow` does for one run."""
        corrected, errors = self.starts.copy(), np.zeros((len(self.starts), 2, 2))

        def correct(part: slice) -> None:
            corrected[part], errors[part] = self.walk.corrected_starts(
                self.moves[part], self.starts[part]
            )

        shared(len(self.starts), correct, threads)
        reached = np.all(errors <= self.path_task.iteration.tolerances, axis=2)
        taken = ~reached[:, 0] & reached[:, 1]
        self.starts[taken] = corrected[taken]
        for run in np.flatnonzero(~reached.any(axis=1)).tolist():
            try:
                self.starts[run] = start_of(self._task(run), self.method)
            except QpTwistError as error:
                self.failures[run] = str(error)

    def _by_reference(self, run: int, kept: Array) -> None:
        if run in self.failures:
            self.ends[run], self.numbers[run] = 0, np.nan
            kept[run : run + 1] = np.nan
            return
        try:
            done = follow_one(self._task(run), self.method, solver=COMPILED)
        except QpTwistError as error:
            self.failures[run] = str(error)
            return
        if done.failure:
            self.failures[run] = done.failure
        self.ends[run] = len(done.q)
        errors = np.column_stack([done.position_error, done.axis_error])
        of_run = done.q[None], errors[None], self.ends[run : run + 1], done.iterations[None]
        self.numbers[run] = self._measured(*of_run)[0]
        kept[run : run + 1, : len(done.q)] = done.q

    def _task(self, run: int) -> PathTask:
        """The path task of one run, with its own start and placement."""
        move, task = pose_of(self.moves[run]), self.path_task
        flipped = task.flipped_waypoints
        return dataclasses.replace(
            task,
            waypoints=tuple(move @ waypoint for waypoint in task.waypoints),
            flipped_waypoints=None if flipped is None else tuple(move @ w for w in flipped),
            start=self.starts[run],
            starts={},
            best_start=False,
        )


def _starts(path_task: PathTask, method: str, starts: npt.ArrayLike | None, moves: int) -> Array:
    """The start of each run, (K, nq)."""
    nq = path_task.model.nq
    if starts is None:
        starts = path_task.starts.get(method)
    if starts is None:
        if path_task.best_start:
            raise InvalidInput(
                "batch.follow: the task file leaves the start to a search; give starts, from "
                "qp_twist.find_starts or qp_twist.plan."
            )
        starts = path_task.start
    shape = (nq,) if np.ndim(starts) == 1 else (None, nq)
    given = finite_array("batch.follow(starts=…)", starts, shape).reshape(-1, nq)
    if len(given) == 1:
        given = np.repeat(given, moves, axis=0)
    if moves not in (1, len(given)):
        raise InvalidInput(
            f"batch.follow: {len(given)} starts and {moves} moves; give one of each for every run."
        )
    return given
