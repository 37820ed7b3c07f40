"""One method along a path, row by row."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, clause
from qp_twist.control import Status
from qp_twist.following.blending import resolvers_along
from qp_twist.following.resolver import LARGEST_JOINT, Iteration, Job, Resolver
from qp_twist.following.sampling import fine_rows, plan_at
from qp_twist.following.trajectory import RowSteps, Trajectory
from qp_twist.geometry import twist_error
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import frame_pose
from qp_twist.paths import METHODS, MethodSettings, PathTask, Waypoints, twist_task
from qp_twist.planning.starts import corrected_start, missed_by, reached
from qp_twist.qp import NoSolutionFound

if TYPE_CHECKING:
    from qp_twist.following.compiled_walk import CompiledWalk

_GROWTH = 1.5
"""Factor of a row's duration from one attempt to the next."""
_LONGEST = 1e4
"""Largest factor of a row's duration."""
_PATIENCE = 3
"""Number of attempts without improvement after which it gives up."""


def walk(
    path_task: PathTask,
    method: str,
    settings: MethodSettings,
    *,
    s: Array | None = None,
    start: Array | None = None,
    solver: str = "daqp",
    plan: Array | None = None,
    slow_down: bool = False,
    fine: bool = False,
    progress: Callable[[int], None] | None = None,
    stop: Callable[[Array, float, float], bool] | None = None,
) -> Trajectory:
    """The implementation of :func:`~qp_twist.follow`, after its arguments are checked.

    The rows are at parameters ``s`` (K,) of the path, without joint moves between them; ``None``: a
    row for each waypoint; with ``fine``, others as well (:func:`fine_rows`). ``start`` (nq,) takes
    the place of the task's, and ``plan`` (K, nq) is the reference of the secondary "plan".

    With ``slow_down`` acceleration limits are left to :func:`~qp_twist.time_trajectory`: a robot
    that enters a curve too fast cannot stay on the path within its acceleration limits. With more
    time it can, and the time it needs is known only for the whole path. Then the run also ends at
    the last row that the limits let it reach, or that has a step.
    """
    kind = METHODS[method]
    path = path_task.at(s, flipped=kind.flipped)
    first = start_of(path_task, method, path, start)
    if fine:
        rows = fine_rows(path_task, path.s, first)
        plan = None if plan is None else plan_at(path_task, plan, path.s, rows)
        path = path_task.at(rows, flipped=kind.flipped)
    job = Job(path_task, path, kind, settings, solver, plan, slow_down)
    compiled = _compiled(job)
    run = _Run(job, first, progress, stop)
    began = time.perf_counter()
    while run.unfinished:
        if compiled is not None and run.at_feed:
            run.extend(*compiled.on_from(run.rows[-1].q, len(run.rows)))
        if run.unfinished:
            run.next_row()
    return run.trajectory(time.perf_counter() - began)


def start_of(
    path_task: PathTask, method: str, path: Waypoints | None = None, start: Array | None = None
) -> Array:
    """The start, corrected onto the method's first row of the path, in the method's rows.

    Raises:
        InvalidInput: If the correction does not converge, or the method has no waypoints.
    """
    kind = METHODS[method]
    path = path_task.at(np.zeros(1), flipped=kind.flipped) if path is None else path
    projector = path_task.operational if kind.whole_twist else path.projectors[0]
    return corrected_start(
        path_task,
        path.target(0),
        holds_limits=kind.holds_limits,
        task=twist_task(path_task, projector),
        start=start,
    )


def _compiled(job: Job) -> CompiledWalk | None:
    """The compiled walk, if requested and supported."""
    if job.solver != COMPILED:
        return None
    from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

    what = job.path_task, job.method.name, job.settings
    if not walk_known(*what, accelerations=not job.slow_down):
        return None
    return CompiledWalk(*what, job.path, job.plan)


class _Row(NamedTuple):
    """A recorded row: its configuration, how long the way to it takes, and how it was reached."""

    q: Array
    duration: float = 0.0
    steps: RowSteps = RowSteps()


class _Run:
    """Moves a robot from row to row by the method's resolvers, and records the rows."""

    def __init__(
        self,
        job: Job,
        start: Array,
        progress: Callable[[int], None] | None,
        stop: Callable[[Array, float, float], bool] | None,
    ) -> None:
        self.job, self._progress, self._stop = job, progress, stop
        self._configuration = mink.Configuration(job.path_task.model, start)
        self._slows = job.slow_down and job.method.holds_limits
        self._factor = 1.0  # of the last row's duration
        self.rows = [_Row(start)]
        self.stopped = False
        self._diverged_at: int | None = None
        self._failure = ""
        self._blocked_by: tuple[str, ...] | None = None
        self._compiled = 0

    @property
    def unfinished(self) -> bool:
        """Whether there are rows left, and nothing ended the run."""
        return len(self.rows) < len(self.job.path.s) and not self.stopped

    @property
    def going(self) -> bool:
        """Whether every row so far had a step, and it was finite."""
        return self._diverged_at is None and not self._failure

    @property
    def at_feed(self) -> bool:
        """Whether the next row is approached in the task's own duration."""
        return self.going and self._factor <= _GROWTH

    @cached_property
    def _resolvers(self) -> list[Resolver]:
        return resolvers_along(self.job)

    @cached_property
    def _feed(self) -> Array:
        """Durations of the ways to the rows at the feed, s; 0 without one."""
        durations = self.job.path.durations
        return np.zeros(len(self.job.path.s)) if durations is None else durations

    def extend(self, q: Array, iterations: npt.NDArray[np.int64], errors: Array) -> None:
        """Record rows of the compiled walk: those before the first that needs more time."""
        if self._slows:
            missed = (errors > self.job.path_task.iteration.tolerances).any(axis=1)
            q = q[: np.argmax(missed)] if missed.any() else q
            self._factor = 1.0 if len(q) else self._factor
        for k in range(len(q)):
            self._compiled += 1
            duration = float(self._feed[len(self.rows)])
            steps = RowSteps(iterations=int(iterations[k]))
            self._record(_Row(q[k].copy(), duration, steps), errors[k])
            if self.stopped:
                break
        self._configuration.update(self.rows[-1].q)

    def next_row(self) -> None:
        """Approach the next row and record the result."""
        index, job, q = len(self.rows), self.job, self.rows[-1].q
        row = _Row(q, float(self._feed[index]))
        waypoint = int(np.ceil(job.path.s[index])) + 1
        if self.going:
            self._resolvers[index].aim(index)
            try:
                row = self._approach(self._resolvers[index], row)
            except NoSolutionFound as error:
                self._failure = f"no step at waypoint {waypoint}: {clause(error)}"
        if self._diverged_at is None and not _sane(self._configuration.q):
            self._diverged_at = waypoint
            self._configuration.update(q)
        if job.slow_down and not self.going:
            self.stopped = True
        elif self._is_blocked(row):
            self._blocked_by, self.stopped = row.steps.binding, True
        else:
            self._record(row._replace(q=self._configuration.q.copy()), None)

    def _approach(self, resolver: Resolver, row: _Row) -> _Row:
        """Move to the resolver's target, in as much time as the way to it needs.

        A run that may slow down repeats a missed row with 1.5 times the duration until it is
        reached. If longer attempts do not improve it (a position limit, a target out of reach), the
        first attempt is kept. The next row starts with a duration one factor shorter, so that the
        feed is resumed.
        """
        timed = self.job.path.feed_times is not None
        if not (self._slows and timed):
            return self._attempt(resolver, row, row.duration if timed else None)[0]
        begin = self._configuration.q.copy()
        factor = max(1.0, self._factor / _GROWTH)
        found, missed = self._attempt(resolver, row, factor * row.duration)
        nearest, failed = missed, 0
        while missed > 1.0 and failed < _PATIENCE and factor * _GROWTH <= _LONGEST:
            factor *= _GROWTH
            self._configuration.update(begin)
            try:
                found, missed = self._attempt(resolver, found, factor * row.duration)
            except NoSolutionFound:
                missed = np.inf
            failed = 0 if missed < 0.99 * nearest else failed + 1
            nearest = min(nearest, missed)
        if missed > 1.0:
            self._configuration.update(begin)
            factor = 1.0
            found, _ = self._attempt(resolver, found, row.duration)
        self._factor = factor
        return found._replace(duration=factor * row.duration)

    def _attempt(
        self, resolver: Resolver, before: _Row, duration: float | None
    ) -> tuple[_Row, float]:
        """Iterate to the resolver's target; the row, and its error relative to the tolerance.

        What held the faster attempts back is why this one is slower: their limits stay named.
        """
        configuration, task = self._configuration, self.job.path_task
        resolver.limits.begin_waypoint(configuration, duration)
        lead = resolver.lead(configuration)
        if lead is not None:
            configuration.integrate_inplace(lead, 1.0)
        held = self.job.method.holds_limits
        moves = list[Iteration]()
        for iteration in range(self.job.settings.iterations):
            first = iteration == 0
            if not first and reached(task, resolver.task, configuration, held=held):
                break
            move = resolver.displacement(configuration, first=first)
            if not np.isfinite(move.dq).all():
                configuration.update(np.full(configuration.model.nq, np.inf))
                break
            configuration.integrate_inplace(move.dq, 1.0)
            moves.append(move)
            # Blocked by limits: further iterations would not move it either.
            if np.abs(move.dq).max(initial=0.0) < 1e-13 or not _sane(configuration.q):
                break
        names = dict.fromkeys((*before.steps.binding, *(name for m in moves for name in m.binding)))
        row = before._replace(steps=RowSteps(
            min((move.scale for move in moves), default=1.0),
            len(moves),
            tuple(names),
            max((m.status for m in moves), default=Status.SOLVED, key=lambda s: s.severity),
        ))  # fmt: skip
        if not self._slows or not _sane(configuration.q):
            return row, np.inf
        return row, missed_by(task, resolver.task, configuration)

    def _is_blocked(self, row: _Row) -> bool:
        """Whether the limits, or a singularity, keep the run from the next row at any speed."""
        if not self._slows or self.job.method.peer:
            return False
        if row.steps.status in (Status.SOLVED, Status.PRIORITIZED):
            return False
        return not self.job.path_task.tolerances.met(*self._errors(len(self.rows)))

    def _errors(self, index: int) -> tuple[float, float]:
        """Lengths of the task error at a row, in the path's projector there, m and rad."""
        task, path = self.job.path_task, self.job.path
        R, p = frame_pose(self._configuration, task.frame_name, task.frame_type)
        target = path.rotations[index], path.positions[index]
        error = twist_error(R, p, *target, path.projectors[index])
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def _record(self, row: _Row, errors: Array | None) -> None:
        """Record a finished row, and call ``progress`` and ``stop`` with its errors, m and rad."""
        index = len(self.rows)
        s = self.job.path.s[index]
        self.rows.append(row)
        if self._progress is not None and s.is_integer():
            self._progress(int(s))
        if self._stop is not None:
            apart, turned = self._errors(index) if errors is None else errors.tolist()
            self.stopped = self._stop(row.q, apart, turned)

    def trajectory(self, seconds: float) -> Trajectory:
        """The recorded trajectory."""
        job, rows = self.job, self.rows
        q, durations, steps = zip(*rows, strict=True)
        return Trajectory(
            path_task=job.path_task,
            method=job.method.name,
            q=np.array(q),
            s=job.path.s[: len(rows)],
            steps=steps,
            durations=None if job.path.feed_times is None else np.array(durations),
            seconds=seconds,
            diverged_at=self._diverged_at,
            failure=self._failure,
            compiled=self._compiled,
            blocked_by=self._blocked_by,
        )


def _sane(q: Array) -> bool:
    return bool(np.isfinite(q).all() and np.abs(q).max() < LARGEST_JOINT)
