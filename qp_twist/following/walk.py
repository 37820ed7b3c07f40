"""One method along a path, waypoint by waypoint."""

from __future__ import annotations

import time
from collections.abc import Callable

import mink
import numpy as np

from qp_twist import closed_form
from qp_twist.checks import Array
from qp_twist.controller import Controller, Status
from qp_twist.errors import InvalidInput
from qp_twist.following.blending import resolvers_along
from qp_twist.following.resolver import Displacement, Resolver, twist_task
from qp_twist.following.slowing import Pace
from qp_twist.following.trajectory import Trajectory
from qp_twist.kinematics import TwistTask
from qp_twist.path import METHODS, MethodSettings, PathTask
from qp_twist.qp import NoSolutionFound

_LARGEST_JOINT = 1e6
"""A joint beyond this many rad has diverged; its error would only overflow."""
_START_ITERATIONS = 200


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
    """:func:`~qp_twist.follow` with its arguments checked.

    ``plan`` (N, nq) is what the secondary follows where it is a plan.
    """
    kind = METHODS[method]
    waypoints = path_task.waypoints
    if kind.flipped:
        if path_task.flipped_waypoints is None:
            raise InvalidInput(
                f"follow: {method} needs a roll rule with two signs; this task has no [roll]."
            )
        waypoints = path_task.flipped_waypoints
    resolvers = resolvers_along(path_task, waypoints, method, settings, solver)
    configuration = mink.Configuration(
        path_task.model,
        corrected_start(
            path_task, waypoints[0], task=resolvers[0].task, holds_limits=kind.holds_limits
        ),
    )
    recorder = _Recorder(path_task)
    recorder.add(configuration, waypoints[0])
    pace = Pace() if slow_down and kind.holds_limits else None
    began = time.perf_counter()
    stages = zip(waypoints[1:], resolvers[1:], strict=True)
    for index, (waypoint, resolver) in enumerate(stages, start=1):
        duration = None if path_task.durations is None else float(path_task.durations[index])
        if recorder.diverged_at is None and not recorder.failure:
            resolver.task.set_target(waypoint)
            if plan is not None:
                resolver.aim(plan, index)

            def attempt(allowed: float | None, resolver: Resolver = resolver) -> float:
                recorder.begin()
                resolver.begin_waypoint(configuration, allowed)
                _approach(resolver, configuration, settings, recorder)
                if pace is None or not _sane(configuration.q):
                    return np.inf
                return _missed_by(path_task, resolver.task, configuration)

            try:
                if pace is None or duration is None:
                    attempt(duration)
                else:
                    duration = pace.approach(attempt, configuration, duration)
            except NoSolutionFound as error:
                recorder.failure = f"no step at waypoint {index + 1}: {error}"
        if recorder.diverged_at is None and not _sane(configuration.q):
            recorder.diverged_at = index + 1
            configuration.update(recorder.q[-1])
        recorder.add(configuration, waypoint, duration)
        if progress is not None:
            progress(index)
        if stop is not None and stop(recorder.q[-1], *recorder.rows[-1][:2]):
            break
    return recorder.trajectory(method, time.perf_counter() - began)


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
        if not first and _reached(recorder.path_task, resolver.task, configuration):
            break
        move = resolver.displacement(configuration, first=first)
        if not np.isfinite(move.dq).all():
            configuration.update(np.full(configuration.model.nq, np.inf))
            break
        configuration.integrate_inplace(move.dq, 1.0)
        recorder.note(move)
        # Held by its limits: the other iterations would not move it either.
        if np.abs(move.dq).max(initial=0.0) < 1e-13 or not _sane(configuration.q):
            break


def _sane(q: Array) -> bool:
    return bool(np.isfinite(q).all() and np.abs(q).max() < _LARGEST_JOINT)


def _reached(path_task: PathTask, task: TwistTask, configuration: mink.Configuration) -> bool:
    return _missed_by(path_task, task, configuration) <= 1.0


def _missed_by(path_task: PathTask, task: TwistTask, configuration: mink.Configuration) -> float:
    """The task error in tolerances, the larger of the linear and the angular one."""
    error = task.state(configuration).error
    return max(
        float(np.linalg.norm(error[:3])) / path_task.iteration.position_tolerance,
        float(np.linalg.norm(error[3:])) / path_task.iteration.angle_tolerance,
    )


def corrected_start(
    path_task: PathTask, waypoint: mink.SE3, *, holds_limits: bool, task: TwistTask | None = None
) -> Array:
    """The start moved onto the first waypoint by the shortest steps in the method's own rows.

    Those of the path if ``task`` is ``None``. A method that holds the limits holds them here too;
    the others know nothing of them.
    """
    if task is None:
        task = twist_task(path_task, path_task.in_force[0])
    configuration = mink.Configuration(path_task.model, path_task.start)
    task.set_target(waypoint)
    controller = Controller(path_task.model, [task]) if holds_limits else None
    for _ in range(_START_ITERATIONS):
        if _reached(path_task, task, configuration):
            q: Array = configuration.q.copy()
            return q
        if controller is not None:
            dq = controller.step(configuration, 1.0).velocity
        else:
            state = task.state(configuration)
            twist = task.clamped(state.error)
            dq = closed_form.minimum_norm(state.jacobian, state.projector, twist)
        configuration.integrate_inplace(dq, 1.0)
    error = task.state(configuration).error
    raise InvalidInput(
        f"follow: the start cannot be corrected onto the first waypoint; after "
        f"{_START_ITERATIONS} steps it is {np.linalg.norm(error[:3]):.3g} m and "
        f"{np.degrees(np.linalg.norm(error[3:])):.3g} degrees away. Give a start nearer to it, or "
        "move the path into the robot's reach."
    )


class _Recorder:
    """Collects a trajectory and what the task's own rows say of it."""

    def __init__(self, path_task: PathTask) -> None:
        self.path_task = path_task
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
        self._names = dict[str, None]()
        self.begin()

    def begin(self) -> None:
        """A waypoint begins, or is repeated: then the limits that stood in its way stay named."""
        self._scale, self._count, self._status = 1.0, 0, Status.SOLVED

    def note(self, move: Displacement) -> None:
        """An iteration of the waypoint under way."""
        self._scale = min(self._scale, move.scale)
        self._count += 1
        self._names.update(dict.fromkeys(move.binding))
        self._status = max(self._status, move.status, key=lambda status: status.severity)

    def add(
        self, configuration: mink.Configuration, waypoint: mink.SE3, duration: float | None = None
    ) -> None:
        """A waypoint that is done, in ``duration`` seconds."""
        in_force = self.path_task.in_force[len(self.q)]
        if in_force is not self.task.projector:
            self.task = twist_task(self.path_task, in_force)
        self.task.set_target(waypoint)
        state = self.task.state(configuration)
        rows = state.basis.T @ state.jacobian
        sigma = np.linalg.svd(rows, compute_uv=False)
        self.q.append(configuration.q.copy())
        self.rows.append(
            (
                float(np.linalg.norm(state.error[:3])),
                float(np.linalg.norm(state.error[3:])),
                float(sigma[-1]) if len(sigma) else 0.0,
            )
        )
        if self.task.bands:
            # A flipped waypoint has another roll, but the bands stand about the path's own.
            self.task.set_target(self.path_task.waypoints[len(self.band_excess)])
        self.band_excess.append(float(self.task.band_excess(configuration).max(initial=0.0)))
        self.scales.append(self._scale)
        self.iterations.append(self._count)
        self.binding.append(tuple(self._names))
        self.statuses.append(self._status)
        self.durations.append(duration or 0.0)
        self._names.clear()
        self.begin()

    def trajectory(self, method: str, seconds: float) -> Trajectory:
        """Everything recorded."""
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
        )
