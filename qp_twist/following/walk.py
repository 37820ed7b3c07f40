"""One method along a path, row by row."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, clause
from qp_twist.control import Status
from qp_twist.following.blending import resolvers_along
from qp_twist.following.resolver import LARGEST_JOINT, Resolver
from qp_twist.following.sampling import fine_rows, plan_at
from qp_twist.following.slowing import Pace
from qp_twist.following.trajectory import Trajectory
from qp_twist.kernel import COMPILED
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
    compiled = _compiled(path_task, path, method, settings, solver, plan, slow_down)
    run = _Run(path_task, path, method, settings, solver, plan, slow_down, first, progress, stop)
    began = time.perf_counter()
    while run.unfinished:
        if compiled is not None and run.at_feed:
            run.extend(*compiled.on_from(run.q[-1], len(run.q)))
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


def _compiled(
    path_task: PathTask,
    path: Waypoints,
    method: str,
    settings: MethodSettings,
    solver: str,
    plan: Array | None,
    slow_down: bool,
) -> CompiledWalk | None:
    """The compiled walk, if requested and supported."""
    if solver != COMPILED:
        return None
    from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

    if not walk_known(path_task, method, settings, accelerations=not slow_down):
        return None
    return CompiledWalk(path_task, method, settings, path, plan)


class _Run:
    """Moves a robot from row to row by the method's resolvers, and records the rows."""

    def __init__(
        self,
        path_task: PathTask,
        path: Waypoints,
        method: str,
        settings: MethodSettings,
        solver: str,
        plan: Array | None,
        slow_down: bool,
        start: Array,
        progress: Callable[[int], None] | None,
        stop: Callable[[Array, float, float], bool] | None,
    ) -> None:
        self.path_task, self.path, self.method, self.settings = path_task, path, method, settings
        self.solver, self.plan, self.slow_down = solver, plan, slow_down
        self.configuration = mink.Configuration(path_task.model, start)
        self.pace = Pace() if slow_down and METHODS[method].holds_limits else None
        self.progress, self.stop, self.stopped = progress, stop, False
        durations = path.durations
        self.feed = np.zeros(len(path.s)) if durations is None else durations
        self.q, self.durations = [start], [0.0]
        self.scales, self.iterations = [1.0], [0]
        self.binding, self.statuses = list[tuple[str, ...]]([()]), [Status.SOLVED]
        self.diverged_at: int | None = None
        self.failure = ""
        self.blocked_by: tuple[str, ...] | None = None
        self.compiled = 0
        self._measured = lru_cache(partial(twist_task, path_task))

    @property
    def unfinished(self) -> bool:
        """Whether there are rows left, and nothing ended the run."""
        return len(self.q) < len(self.path.s) and not self.stopped

    @property
    def going(self) -> bool:
        """Whether every row so far had a step, and it was finite."""
        return self.diverged_at is None and not self.failure

    @property
    def at_feed(self) -> bool:
        """Whether the next row is approached in the task's own duration."""
        return self.going and (self.pace is None or self.pace.at_feed)

    @cached_property
    def resolvers(self) -> list[Resolver]:
        """The resolver of each row."""
        return resolvers_along(
            self.path_task, self.path, self.method, self.settings, self.solver,
            accelerations=not self.slow_down,
        )  # fmt: skip

    def extend(self, q: Array, iterations: npt.NDArray[np.int64], errors: Array) -> None:
        """Record rows of the compiled walk: those before the first that needs more time."""
        kept = len(q)
        if self.pace is not None:
            missed = (errors > self.path_task.iteration.tolerances).any(axis=1)
            kept = int(np.argmax(missed)) if missed.any() else kept
            if kept:
                self.pace.factor = 1.0
        for k in range(kept):
            self.compiled += 1
            duration, count = float(self.feed[len(self.q)]), int(iterations[k])
            self._record(q[k].copy(), duration, errors[k], iterations=count)
            if self.stopped:
                break
        self.configuration.update(self.q[-1])

    def next_row(self) -> None:
        """Approach the next row and record the result."""
        index = len(self.q)
        duration = float(self.feed[index])
        self._scale, self._count, self._status = 1.0, 0, Status.SOLVED
        self._names = dict[str, None]()
        waypoint = int(np.ceil(self.path.s[index])) + 1
        if self.going:
            resolver = self.resolvers[index]
            resolver.task.set_target(self.path.target(index))
            if self.plan is not None:
                resolver.aim(self.plan, index)
            try:
                duration = self._approach(resolver, duration)
            except NoSolutionFound as error:
                self.failure = f"no step at waypoint {waypoint}: {clause(error)}"
        if self.diverged_at is None and not _sane(self.configuration.q):
            self.diverged_at = waypoint
            self.configuration.update(self.q[-1])
        if self.slow_down and not self.going:
            self.stopped = True
        elif self._blocked():
            self.blocked_by, self.stopped = tuple(self._names), True
        else:
            self._record(
                self.configuration.q.copy(), duration, None, self._scale, self._count,
                tuple(self._names), self._status,
            )  # fmt: skip

    def _approach(self, resolver: Resolver, duration: float) -> float:
        """Move to the resolver's target; return the duration, s."""

        def attempt(allowed: float | None) -> float:
            self._scale, self._count, self._status = 1.0, 0, Status.SOLVED
            resolver.begin_waypoint(self.configuration, allowed)
            self._iterate(resolver)
            if self.pace is None or not _sane(self.configuration.q):
                return np.inf
            return missed_by(self.path_task, resolver.task, self.configuration)

        if self.pace is not None and self.path.feed_times is not None:
            return self.pace.approach(attempt, self.configuration, duration)
        attempt(None if self.path.feed_times is None else duration)
        return duration

    def _iterate(self, resolver: Resolver) -> None:
        """Iterate to the row that is the resolver's target."""
        configuration = self.configuration
        lead = resolver.lead(configuration)
        if lead is not None:
            configuration.integrate_inplace(lead, 1.0)
        held = resolver.limits is not None
        for iteration in range(self.settings.iterations):
            first = iteration == 0
            if not first and reached(self.path_task, resolver.task, configuration, held=held):
                break
            move = resolver.displacement(configuration, first=first)
            if not np.isfinite(move.dq).all():
                configuration.update(np.full(configuration.model.nq, np.inf))
                break
            configuration.integrate_inplace(move.dq, 1.0)
            self._scale = min(self._scale, move.scale)
            self._count += 1
            self._names.update(dict.fromkeys(move.binding))
            self._status = max(self._status, move.status, key=lambda status: status.severity)
            # Blocked by limits: further iterations would not move it either.
            if np.abs(move.dq).max(initial=0.0) < 1e-13 or not _sane(configuration.q):
                break

    def _blocked(self) -> bool:
        """Whether the limits, or a singularity, keep the run from the next row at any speed."""
        if self.pace is None or METHODS[self.method].peer:
            return False
        if self._status in (Status.SOLVED, Status.PRIORITIZED):
            return False
        return not self.path_task.tolerances.met(*self._errors(len(self.q)))

    def _errors(self, index: int) -> tuple[float, float]:
        """Lengths of the task error at a row, in the path's projector there, m and rad."""
        task = self._measured(self.path.projectors[index])
        task.set_target(self.path.target(index))
        error = task.state(self.configuration).error
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def _record(
        self,
        q: Array,
        duration: float,
        errors: Array | None,
        scale: float = 1.0,
        iterations: int = 0,
        binding: tuple[str, ...] = (),
        status: Status = Status.SOLVED,
    ) -> None:
        """Record a finished row, and call ``progress`` and ``stop`` with its errors, m and rad."""
        index = len(self.q)
        self.q.append(q)
        self.durations.append(duration)
        self.scales.append(scale)
        self.iterations.append(iterations)
        self.binding.append(binding)
        self.statuses.append(status)
        if self.progress is not None and self.path.s[index].is_integer():
            self.progress(int(self.path.s[index]))
        if self.stop is not None:
            apart, turned = self._errors(index) if errors is None else errors.tolist()
            self.stopped = self.stop(q, apart, turned)

    def trajectory(self, seconds: float) -> Trajectory:
        """The recorded trajectory."""
        return Trajectory(
            path_task=self.path_task,
            method=self.method,
            q=np.array(self.q),
            s=self.path.s[: len(self.q)],
            scale=np.array(self.scales),
            iterations=np.array(self.iterations),
            binding=tuple(self.binding),
            statuses=tuple(self.statuses),
            durations=None if self.path.feed_times is None else np.array(self.durations),
            seconds=seconds,
            diverged_at=self.diverged_at,
            failure=self.failure,
            compiled=self.compiled,
            blocked_by=self.blocked_by,
        )


def _sane(q: Array) -> bool:
    return bool(np.isfinite(q).all() and np.abs(q).max() < LARGEST_JOINT)
