"""One interface for all methods: a configuration and a target in, a joint displacement out."""

from __future__ import annotations

import abc
from dataclasses import dataclass

import mink
import numpy as np

from qp_twist import closed_form
from qp_twist.checks import Array
from qp_twist.controller import Controller, Status
from qp_twist.kinematics import (
    JointCentering,
    JointRanges,
    Manipulability,
    PostureReference,
    SecondaryObjective,
    TwistTask,
    total_displacement,
)
from qp_twist.limits import DisplacementWindow, PositionLimit
from qp_twist.path import METHODS, MethodSettings, PathTask


@dataclass(frozen=True, eq=False)
class Displacement:
    """What one iteration does.

    Attributes:
        dq: Joint displacement, rad or m, (nv,).
        scale: Share of the task that was kept.
        binding: Names of the limits that scaled it.
    """

    dq: Array
    scale: float = 1.0
    binding: tuple[str, ...] = ()


class Resolver(abc.ABC):
    """A method, made ready for one task.

    Attributes:
        task: The twist task whose target the caller sets, waypoint by waypoint.
    """

    task: TwistTask

    @abc.abstractmethod
    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Displacement:
        """Displacement of one iteration; ``first``: the waypoint's first, with the secondary."""

    def begin_waypoint(self, q: Array, duration: float | None) -> None:  # noqa: B027
        """Called with the configuration at the last waypoint and the time to the next, s."""


class ClosedFormResolver(Resolver):
    """The closed forms of the paper; they know nothing of limits or time."""

    def __init__(self, path_task: PathTask, method: str, settings: MethodSettings) -> None:
        self.method = METHODS[method]
        self.task = twist_task(path_task, whole_twist=self.method.whole_twist)
        self.operational = path_task.operational
        self.objectives = secondary_objectives(path_task, self.task, settings)

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Displacement:
        """The method's formula at the configuration."""
        state = self.task.state(configuration)
        twist = self.task.clamped(state.error)
        h = np.zeros(configuration.model.nv)
        if first:
            h = total_displacement(self.objectives, configuration)
        J, T = state.jacobian, state.projector
        match self.method.name:
            case "rmr" | "rmr_flipped":
                dq = closed_form.resolved_motion_rate(J, twist, self.operational)
            case "minimum_norm":
                dq = closed_form.minimum_norm(J, T, twist)
            case "gradient_projection":
                dq = closed_form.gradient_projection(J, T, twist, h)
            case "twa":
                dq = closed_form.twa(J, T, twist, h, operational=self.operational)
            case name:
                raise AssertionError(f"no closed form is called {name}")
        return Displacement(dq)


class QpResolver(Resolver):
    """The constrained counterparts: the controller's QP with the task's limits."""

    def __init__(
        self, path_task: PathTask, method: str, settings: MethodSettings, solver: str
    ) -> None:
        self.method = METHODS[method]
        self.task = twist_task(path_task, whole_twist=self.method.whole_twist)
        self.model = path_task.model
        self.velocity_limits = path_task.velocity_limits
        metric = None
        if settings.secondary == "centering" and settings.weight == "natural":
            metric = range_metric(JointRanges.of(self.model))
        self.controller = Controller(
            self.model,
            tasks=[self.task],
            secondary=secondary_objectives(path_task, self.task, settings),
            secondary_space=self.method.space,
            solver=solver,
            metric=metric,
            limits=[PositionLimit(self.model)],
        )
        self.window: DisplacementWindow | None = None
        if path_task.durations is not None and np.isfinite(self.velocity_limits).any():
            unbounded = np.full(self.model.nv, np.inf)
            self.window = DisplacementWindow(self.model, path_task.start, unbounded)
            self.controller.limits.append(self.window)
        self.dt = 1.0

    def begin_waypoint(self, q: Array, duration: float | None) -> None:
        """Open the window in which the joints may move until the next waypoint is due."""
        self.dt = 1.0 if duration is None else duration
        if self.window is not None:
            self.window.move(q, self.velocity_limits * self.dt)

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Displacement:
        """One step of the controller, over the whole duration of the waypoint."""
        step = self.controller.step(configuration, self.dt, use_secondary=first)
        names: tuple[str, ...] = ()
        if step.status is not Status.SOLVED:
            names = tuple(str(limit) for limit in step.binding)
        return Displacement(step.velocity * self.dt, step.scale, names)


def make_resolver(
    path_task: PathTask, method: str, settings: MethodSettings, solver: str
) -> Resolver:
    """The resolver of a method by name."""
    if METHODS[method].constrained:
        return QpResolver(path_task, method, settings, solver)
    return ClosedFormResolver(path_task, method, settings)


def range_metric(ranges: JointRanges) -> Array:
    """Diagonal of WᵀW, (nv,), as a metric: unlimited joints get a small weight instead of none."""
    weight = ranges.weight
    smallest = weight[weight > 0.0].min(initial=1.0)
    metric: Array = np.where(weight > 0.0, weight, 1e-2 * smallest) ** 2
    return metric


def twist_task(path_task: PathTask, *, whole_twist: bool = False) -> TwistTask:
    """The task of a path: its own projector and bands, or the whole operational one without."""
    return TwistTask(
        path_task.frame_name,
        path_task.frame_type,
        path_task.operational if whole_twist else path_task.projector,
        max_linear_step=path_task.iteration.max_linear_step,
        max_angular_step=path_task.iteration.max_angular_step,
        bands=() if whole_twist else path_task.bands,
    )


def secondary_objectives(
    path_task: PathTask, task: TwistTask, settings: MethodSettings
) -> list[SecondaryObjective]:
    """The secondary objective that a method's settings name, as a list."""
    model = path_task.model
    match settings.secondary:
        case "centering":
            return [JointCentering(model, settings.weight, settings.gain)]
        case "posture":
            return [PostureReference(model, path_task.start, settings.gain)]
        case "manipulability":
            return [Manipulability(model, task, settings.gain)]
        case _:
            return []
