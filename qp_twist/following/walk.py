"""One method along a path, row by row."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, clause
from qp_twist.control import Status
from qp_twist.following.blending import resolvers_along
from qp_twist.following.resolver import LARGEST_JOINT, Iteration, Resolver
from qp_twist.following.sampling import fine_rows, plan_at
from qp_twist.following.slowing import Pace
from qp_twist.following.trajectory import Trajectory
from qp_twist.geometry import TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import TwistTask
from qp_twist.paths import METHODS, MethodSettings, PathTask, Waypoints, twist_task
from qp_twist.planning.starts import corrected_start, missed_by, reached
from qp_twist.qp import NoSolutionFound

if TYPE_CHECKING:
    from qp_twist.following.compiled_walk import CompiledWalk


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
    path = path_task.at(s, flipped=METHODS[method].flipped)
    first = start_of(path_task, method, path, start)
    if fine:
        rows = fine_rows(path_task, path.s, first)
        plan = None if plan is None else plan_at(path_task, plan, path.s, rows)
        path = path_task.at(rows, flipped=METHODS[method].flipped)
    job = _Job(path_task, path, method, settings, solver, plan, slow_down)
    compiled = job.compiled()
    run = _Run(job, first, progress, stop)
    began = time.perf_counter()
    while run.unfinished:
        if compiled is not None and run.at_feed:
            run.extend(*compiled.on_from(run.q, len(run.rows)))
        if run.unfinished:
            run.next_row()
    return run.trajectory(time.perf_counter() - began)


def start_of(
    path_task: PathTask,
    method: str,
    path: Waypoints | None = None,
    start: Array | None = None,
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


class _Job(NamedTuple):
    """What is followed, and how: the arguments of :func:`walk`."""

    path_task: PathTask
    path: Waypoints
    method: str
    settings: MethodSettings
    solver: str
    plan: Array | None
    slow_down: bool

    def compiled(self) -> CompiledWalk | None:
        """The compiled walk, if requested and supported."""
        if self.solver != COMPILED:
            return None
        from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

        task, method, settings = self.path_task, self.method, self.settings
        if not walk_known(task, method, settings, accelerations=not self.slow_down):
            return None
        return CompiledWalk(task, method, settings, self.path, self.plan)

    def resolvers(self) -> list[Resolver]:
        """The resolver of each row."""
        return resolvers_along(
            self.path_task, self.path, self.method, self.settings, self.solver,
            accelerations=not self.slow_down,
        )  # fmt: skip


class _Row(NamedTuple):
    """A recorded row: its configuration, how long the way to it takes, and how it was found."""

    q: Array
    duration: float = 0.0
    scale: float = 1.0
    iterations: int = 0
    binding: tuple[str, ...] = ()
    status: Status = Status.SOLVED


class _Run:
    """Moves a robot from row to row by the method's resolvers, and records the rows."""

    def __init__(
        self,
        job: _Job,
        start: Array,
        progress: Callable[[int], None] | None,
        stop: Callable[[Array, float, float], bool] | None,
    ) -> None:
        self.job, self._progress, self._stop = job, progress, stop
        self._configuration = mink.Configuration(job.path_task.model, start)
        holds_limits = METHODS[job.method].holds_limits
        self._pace = Pace() if job.slow_down and holds_limits else None
        self.rows = [_Row(start)]
        self.stopped = False
        self._diverged_at: int | None = None
        self._failure = ""
        self._blocked_by: tuple[str, ...] | None = None
        self._compiled = 0

    @property
    def q(self) -> Array:
        """The last recorded configuration, (nq,)."""
        return self.rows[-1].q

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
        return self.going and (self._pace is None or self._pace.at_feed)

    @cached_property
    def _resolvers(self) -> list[Resolver]:
        return self.job.resolvers()

    @cached_property
    def _feed(self) -> Array:
        """Durations of the ways to the rows at the feed, s; 0 without one."""
        durations = self.job.path.durations
        return np.zeros(len(self.job.path.s)) if durations is None else durations

    def extend(self, q: Array, iterations: npt.NDArray[np.int64], errors: Array) -> None:
        """Record rows of the compiled walk: those before the first that needs more time."""
        kept = len(q)
        if self._pace is not None:
            missed = (errors > self.job.path_task.iteration.tolerances).any(axis=1)
            kept = int(np.argmax(missed)) if missed.any() else kept
            if kept:
                self._pace.factor = 1.0
        for k in range(kept):
            self._compiled += 1
            duration = float(self._feed[len(self.rows)])
            row = _Row(q[k].copy(), duration, iterations=int(iterations[k]))
            self._record(row, errors[k])
            if self.stopped:
                break
        self._configuration.update(self.q)

    def next_row(self) -> None:
        """Approach the next row and record the result."""
        index, job, q = len(self.rows), self.job, self.q
        row = _Row(q, float(self._feed[index]))
        waypoint = int(np.ceil(job.path.s[index])) + 1
        if self.going:
            resolver = self._resolvers[index]
            resolver.task.set_target(job.path.target(index))
            if job.plan is not None:
                resolver.aim(job.plan, index)
            try:
                row = self._approach(resolver, row)
            except NoSolutionFound as error:
                self._failure = f"no step at waypoint {waypoint}: {clause(error)}"
        if self._diverged_at is None and not _sane(self._configuration.q):
            self._diverged_at = waypoint
            self._configuration.update(q)
        if job.slow_down and not self.going:
            self.stopped = True
        elif self._is_blocked(row):
            self._blocked_by, self.stopped = row.binding, True
        else:
            self._record(row._replace(q=self._configuration.q.copy()), None)

    def _approach(self, resolver: Resolver, row: _Row) -> _Row:
        """Move to the resolver's target, in as much time as the way to it needs."""
        found = row

        def attempt(allowed: float | None) -> float:
            nonlocal found
            resolver.begin_waypoint(self._configuration, allowed)
            tried = self._iterate(resolver, row)
            # What held the faster attempts back is why this one is slower.
            held = dict.fromkeys((*found.binding, *tried.binding))
            found = tried._replace(binding=tuple(held))
            if self._pace is None or not _sane(self._configuration.q):
                return np.inf
            return missed_by(self.job.path_task, resolver.task, self._configuration)

        timed = self.job.path.feed_times is not None
        if self._pace is not None and timed:
            duration = self._pace.approach(attempt, self._configuration, row.duration)
            return found._replace(duration=duration)
        attempt(row.duration if timed else None)
        return found

    def _iterate(self, resolver: Resolver, row: _Row) -> _Row:
        """Iterate to the row that is the resolver's target; the row with how it was found."""
        configuration = self._configuration
        lead = resolver.lead(configuration)
        if lead is not None:
            configuration.integrate_inplace(lead, 1.0)
        held = resolver.limits is not None
        moves = list[Iteration]()
        for iteration in range(self.job.settings.iterations):
            first = iteration == 0
            if not first and reached(self.job.path_task, resolver.task, configuration, held=held):
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
        return row._replace(
            scale=min((move.scale for move in moves), default=1.0),
            iterations=len(moves),
            binding=tuple(dict.fromkeys(name for move in moves for name in move.binding)),
            status=max(
                (move.status for move in moves), default=Status.SOLVED,
                key=lambda status: status.severity,
            ),
        )  # fmt: skip

    def _is_blocked(self, row: _Row) -> bool:
        """Whether the limits, or a singularity, keep the run from the next row at any speed."""
        if self._pace is None or METHODS[self.job.method].peer:
            return False
        if row.status in (Status.SOLVED, Status.PRIORITIZED):
            return False
        return not self.job.path_task.tolerances.met(*self._errors(len(self.rows)))

    @cached_property
    def _measured(self) -> Callable[[TwistProjector], TwistTask]:
        """The task that measures errors in a projector."""
        return lru_cache(partial(twist_task, self.job.path_task))

    def _errors(self, index: int) -> tuple[float, float]:
        """Lengths of the task error at a row, in the path's projector there, m and rad."""
        task = self._measured(self.job.path.projectors[index])
        task.set_target(self.job.path.target(index))
        error = task.state(self._configuration).error
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
        q, durations, scales, iterations, binding, statuses = zip(*rows, strict=True)
        return Trajectory(
            path_task=job.path_task,
            method=job.method,
            q=np.array(q),
            s=job.path.s[: len(rows)],
            scale=np.array(scales),
            iterations=np.array(iterations),
            binding=binding,
            statuses=statuses,
            durations=None if job.path.feed_times is None else np.array(durations),
            seconds=seconds,
            diverged_at=self._diverged_at,
            failure=self._failure,
            compiled=self._compiled,
            blocked_by=self._blocked_by,
        )


def _sane(q: Array) -> bool:
    return bool(np.isfinite(q).all() and np.abs(q).max() < LARGEST_JOINT)
