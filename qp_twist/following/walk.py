"""One method along a path, waypoint by waypoint."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, clause
from qp_twist.control import Status
from qp_twist.following.blending import resolvers_along
from qp_twist.following.resolver import (
    LARGEST_JOINT,
    Iteration,
    Resolver,
    waypoints_of,
)
from qp_twist.following.slowing import Pace
from qp_twist.following.trajectory import Trajectory
from qp_twist.kernel import COMPILED
from qp_twist.kinematics.twist_task import TaskState
from qp_twist.paths import METHODS, MethodSettings, PathTask, twist_task
from qp_twist.planning.starts import corrected_start, missed_by, reached
from qp_twist.qp import NoSolutionFound

if TYPE_CHECKING:
    from qp_twist.following.compiled_walk import CompiledWalk


def walk(
    path_task: PathTask,
    method: str,
    settings: MethodSettings,
    *,
    solver: str = "daqp",
    plan: Array | None = None,
    slow_down: bool = False,
    progress: Callable[[int], None] | None = None,
    stop: Callable[[Array, float, float], bool] | None = None,
) -> Trajectory:
    """The implementation of :func:`~qp_twist.follow`, after its arguments are checked.

    ``plan`` (N, nq) is the reference of the secondary "plan". With ``slow_down`` acceleration
    limits are left to :func:`~qp_twist.time_trajectory`: a robot that enters a curve too fast
    cannot stay on the path within its acceleration limits. With more time it can, and the time it
    needs is known only for the whole path. Then the run also ends at the last waypoint that the
    limits let it reach, or that has a step.
    """
    walked = path_task
    if slow_down and np.isfinite(path_task.acceleration_limits).any():
        free = np.full(path_task.model.nv, np.inf)
        walked = dataclasses.replace(path_task, acceleration_limits=free)
    waypoints = waypoints_of(path_task, method)
    compiled = _compiled(walked, method, settings, solver, plan)
    start = start_of(walked, method)
    recorder = _Recorder(path_task, progress, stop)
    steps = _Steps(walked, method, settings, solver, plan, slow_down, start, recorder)
    recorder.add(steps.configuration, waypoints[0])
    began = time.perf_counter()
    while len(recorder.q) < len(waypoints) and not recorder.stopped:
        if compiled is not None and steps.at_feed:
            recorder.extend(*steps.kept(*compiled.on_from(recorder.q[-1], len(recorder.q))))
            steps.configuration.update(recorder.q[-1])
        if len(recorder.q) < len(waypoints) and not recorder.stopped:
            steps.next_waypoint(waypoints)
    return recorder.trajectory(method, time.perf_counter() - began)


class _Steps:
    """Moves a robot from waypoint to waypoint by the method's resolvers."""

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        solver: str,
        plan: Array | None,
        slow_down: bool,
        start: Array,
        recorder: _Recorder,
    ) -> None:
        self.path_task = path_task
        self.configuration = mink.Configuration(path_task.model, start)
        self._method, self._settings, self._solver, self._plan = method, settings, solver, plan
        self._slow_down = slow_down
        self._pace = Pace() if slow_down and METHODS[method].holds_limits else None
        self._may_be_blocked = not METHODS[method].peer
        self._recorder = recorder
        self._resolvers: list[Resolver] = []

    @property
    def going(self) -> bool:
        """Whether every waypoint so far had a step, and it was finite."""
        return self._recorder.diverged_at is None and not self._recorder.failure

    @property
    def at_feed(self) -> bool:
        """Whether the next waypoint is approached in the task's own duration."""
        return self.going and (self._pace is None or self._pace.at_feed)

    def kept(
        self, q: Array, iterations: npt.NDArray[np.int64], errors: Array, sigma_min: Array
    ) -> tuple[Array, npt.NDArray[np.int64], Array, Array]:
        """Drop the waypoints from the first one that was missed and so needs more time."""
        count = len(q)
        if self._pace is not None:
            missed = (errors > self.path_task.iteration.tolerances).any(axis=1)
            count = int(np.argmax(missed)) if missed.any() else count
            if count:
                self._pace.factor = 1.0
        return q[:count], iterations[:count], errors[:count], sigma_min[:count]

    def next_waypoint(self, waypoints: Sequence[mink.SE3]) -> None:
        """Approach the next waypoint and record the result."""
        recorder, path_task = self._recorder, self.path_task
        index = len(recorder.q)
        duration = None if path_task.durations is None else float(path_task.durations[index])
        if self.going:
            if not self._resolvers:
                self._resolvers = resolvers_along(
                    path_task, waypoints, self._method, self._settings, self._solver
                )
            resolver = self._resolvers[index]
            resolver.task.set_target(waypoints[index])
            if self._plan is not None:
                resolver.aim(self._plan, index)
            try:
                duration = self._approach(resolver, duration)
            except NoSolutionFound as error:
                recorder.failure = f"no step at waypoint {index + 1}: {clause(error)}"
        if recorder.diverged_at is None and not _sane(self.configuration.q):
            recorder.diverged_at = index + 1
            self.configuration.update(recorder.q[-1])
        if self._slow_down and not self.going:
            recorder.stopped = True
            return
        if self._pace is not None and self._may_be_blocked:
            recorder.end_if_blocked(self.configuration, waypoints[index])
            if recorder.stopped:
                return
        recorder.add(self.configuration, waypoints[index], duration)

    def _approach(self, resolver: Resolver, duration: float | None) -> float | None:
        """Move to the resolver's target; return the duration, s."""

        def attempt(allowed: float | None) -> float:
            self._recorder.begin()
            resolver.begin_waypoint(self.configuration, allowed)
            _approach(resolver, self.configuration, self._settings, self._recorder)
            if self._pace is None or not _sane(self.configuration.q):
                return np.inf
            return missed_by(self.path_task, resolver.task, self.configuration)

        if self._pace is not None and duration is not None:
            return self._pace.approach(attempt, self.configuration, duration)
        attempt(duration)
        return duration


def _compiled(
    path_task: PathTask, method: str, settings: MethodSettings, solver: str, plan: Array | None
) -> CompiledWalk | None:
    """The compiled walk, if requested and supported."""
    if solver != COMPILED:
        return None
    from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

    if not walk_known(path_task, method, settings):
        return None
    compiled = CompiledWalk(path_task, method, settings)
    if plan is not None:
        compiled.toward(plan)
    return compiled


def _approach(
    resolver: Resolver,
    configuration: mink.Configuration,
    settings: MethodSettings,
    recorder: _Recorder,
) -> None:
    """Iterate to the waypoint that is the resolver's target."""
    lead = resolver.lead(configuration)
    if lead is not None:
        configuration.integrate_inplace(lead, 1.0)
    for iteration in range(settings.iterations):
        first = iteration == 0
        held = resolver.limits is not None
        if not first and reached(recorder.path_task, resolver.task, configuration, held=held):
            break
        move = resolver.displacement(configuration, first=first)
        if not np.isfinite(move.dq).all():
            configuration.update(np.full(configuration.model.nq, np.inf))
            break
        configuration.integrate_inplace(move.dq, 1.0)
        recorder.note(move)
        # Blocked by limits: further iterations would not move it either.
        if np.abs(move.dq).max(initial=0.0) < 1e-13 or not _sane(configuration.q):
            break


def _sane(q: Array) -> bool:
    return bool(np.isfinite(q).all() and np.abs(q).max() < LARGEST_JOINT)


def start_of(path_task: PathTask, method: str) -> Array:
    """The task's start, corrected onto the method's first waypoint in the method's rows.

    Raises:
        InvalidInput: If the correction does not converge, or the method has no waypoints.
    """
    kind = METHODS[method]
    return corrected_start(
        path_task,
        waypoints_of(path_task, method)[0],
        holds_limits=kind.holds_limits,
        task=twist_task(
            path_task, path_task.operational if kind.whole_twist else path_task.projector
        ),
    )


class _Recorder:
    """Collects a trajectory and its errors in the task's rows.

    It calls ``progress`` and ``stop`` after every waypoint but the first.
    """

    def __init__(
        self,
        path_task: PathTask,
        progress: Callable[[int], None] | None,
        stop: Callable[[Array, float, float], bool] | None,
    ) -> None:
        self.path_task = path_task
        self._progress, self._stop = progress, stop
        self.stopped = False
        self.task = twist_task(path_task, path_task.projector)
        self.q: list[Array] = []
        self.rows: list[tuple[float, float, float]] = []
        self.scales: list[float] = []
        self.iterations: list[int] = []
        self.binding: list[tuple[str, ...]] = []
        self.band_excess: list[float] = []
        self.statuses: list[Status] = []
        self.durations: list[float] = []
        self.diverged_at: int | None = None
        self.failure = ""
        self.blocked_by: tuple[str, ...] | None = None
        self.compiled = 0
        self._names = dict[str, None]()
        self.begin()

    def begin(self) -> None:
        """Begin a waypoint, or repeat it; then the names of its binding limits are kept."""
        self._scale, self._count, self._status = 1.0, 0, Status.SOLVED

    def note(self, move: Iteration) -> None:
        """Record an iteration of the current waypoint."""
        self._scale = min(self._scale, move.scale)
        self._count += 1
        self._names.update(dict.fromkeys(move.binding))
        self._status = max(self._status, move.status, key=lambda status: status.severity)

    def end_if_blocked(self, configuration: mink.Configuration, waypoint: mink.SE3) -> None:
        """End the run before a waypoint that the limits, or a singularity, keep it from."""
        if self._status in (Status.SOLVED, Status.PRIORITIZED):
            return
        error = self._state(configuration, waypoint).error
        met = self.path_task.tolerances.met(np.linalg.norm(error[:3]), np.linalg.norm(error[3:]))
        if not met:
            self.blocked_by, self.stopped = tuple(self._names), True

    def _state(self, configuration: mink.Configuration, waypoint: mink.SE3) -> TaskState:
        """The path's rows at the next waypoint."""
        in_force = self.path_task.in_force[len(self.q)]
        if in_force is not self.task.projector:
            self.task = twist_task(self.path_task, in_force)
        self.task.set_target(waypoint)
        return self.task.state(configuration)

    def add(
        self, configuration: mink.Configuration, waypoint: mink.SE3, duration: float | None = None
    ) -> None:
        """Record a finished waypoint that took ``duration`` seconds."""
        state = self._state(configuration, waypoint)
        rows = state.basis.T @ state.jacobian
        sigma = np.linalg.svd(rows, compute_uv=False)
        if self.task.bands:
            # A flipped waypoint has another roll, but the bands refer to the path's own waypoint.
            self.task.set_target(self.path_task.waypoints[len(self.band_excess)])
        self.band_excess.append(float(self.task.band_excess(configuration).max(initial=0.0)))
        self.scales.append(self._scale)
        self.iterations.append(self._count)
        self.binding.append(tuple(self._names))
        self.statuses.append(self._status)
        self.durations.append(duration or 0.0)
        self._names.clear()
        self.begin()
        self._done(
            configuration.q.copy(),
            float(np.linalg.norm(state.error[:3])),
            float(np.linalg.norm(state.error[3:])),
            float(sigma[-1]) if len(sigma) else 0.0,
        )

    def extend(
        self, q: Array, iterations: npt.NDArray[np.int64], errors: Array, sigma_min: Array
    ) -> None:
        """Record waypoints that the compiled walk has done, until ``stop`` returns true."""
        durations = self.path_task.durations
        numbers = zip(q, iterations.tolist(), errors.tolist(), sigma_min.tolist(), strict=True)
        for here, count, (apart, turned), sigma in numbers:
            self.scales.append(1.0)
            self.iterations.append(count)
            self.binding.append(())
            self.statuses.append(Status.SOLVED)
            self.durations.append(0.0 if durations is None else float(durations[len(self.q)]))
            self.band_excess.append(0.0)
            self.compiled += 1
            self._done(here.copy(), apart, turned, sigma)
            if self.stopped:
                return

    def _done(self, q: Array, apart: float, turned: float, sigma: float) -> None:
        """Store a finished waypoint and call ``progress`` and ``stop``."""
        self.q.append(q)
        self.rows.append((apart, turned, sigma))
        index = len(self.q) - 1
        if index and self._progress is not None:
            self._progress(index)
        if index and self._stop is not None:
            self.stopped = self._stop(q, apart, turned)

    def trajectory(self, method: str, seconds: float) -> Trajectory:
        """The recorded trajectory."""
        position_error, axis_error, sigma_min = np.array(self.rows).T
        return Trajectory(
            path_task=self.path_task,
            method=method,
            q=np.array(self.q),
            position_error=position_error,
            axis_error=axis_error,
            sigma_min=sigma_min,
            scale=np.array(self.scales),
            iterations=np.array(self.iterations),
            binding=tuple(self.binding),
            seconds=seconds,
            statuses=tuple(self.statuses),
            diverged_at=self.diverged_at,
            failure=self.failure,
            band_excess=np.array(self.band_excess),
            durations=None if self.path_task.durations is None else np.array(self.durations),
            compiled=self.compiled,
            blocked_by=self.blocked_by,
        )
