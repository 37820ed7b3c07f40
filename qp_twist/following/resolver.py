"""One interface for all methods: a configuration and a target in, a joint displacement out."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import NamedTuple

import mink
import numpy as np

from qp_twist import closed_form
from qp_twist.checks import Array
from qp_twist.closed_form.resolutions import BY_METHOD
from qp_twist.constraints import BindingLimit, GatheredLimits, gather_limits
from qp_twist.control import Controller, Status
from qp_twist.errors import InvalidInput
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import TwistProjector
from qp_twist.kinematics import (
    JointCentering,
    JointRanges,
    Manipulability,
    PostureReference,
    RollReference,
    SecondaryObjective,
    TwistTask,
    total_displacement,
)
from qp_twist.paths import Method, MethodSettings, PathTask, Waypoints, twist_task

LARGEST_JOINT = 1e6
"""A joint beyond this many rad has diverged; its error would only overflow."""


class Job(NamedTuple):
    """What is followed, and how."""

    path_task: PathTask
    path: Waypoints
    method: Method
    settings: MethodSettings
    solver: str
    plan: Array | None
    """Reference of the secondary "plan" at each row, (N, nq)."""
    slow_down: bool


class Iteration(NamedTuple):
    """Result of one iteration."""

    dq: Array
    """Joint displacement, rad or m, (nv,)."""
    scale: float = 1.0
    binding: tuple[str, ...] = ()
    status: Status = Status.SOLVED


class Resolver(abc.ABC):
    """A method, prepared for one projector of a path.

    Attributes:
        task: The twist task; the caller sets its target at every row.
        limits: The limits of the run, which all its resolvers share.
        objectives: The secondary objectives.
    """

    task: TwistTask
    limits: WaypointLimits
    objectives: Sequence[SecondaryObjective] = ()

    def __init__(self, job: Job, projector: TwistProjector, limits: WaypointLimits) -> None:
        self.job, self.limits = job, limits
        self.task = twist_task(job.path_task, projector)
        self.objectives = secondary_objectives(job.path_task, self.task, job.settings)

    @abc.abstractmethod
    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """Compute one iteration; on the row's ``first`` one the secondary is active."""

    def aim(self, index: int) -> None:
        """Set the target, and the reference of the secondary "plan", to a row of the path."""
        self.task.set_target(self.job.path.target(index))
        for objective in self.objectives if self.job.plan is not None else ():
            if isinstance(objective, PostureReference):
                objective.q_ref = self.job.plan[index]  # type: ignore[index]

    def lead(self, configuration: mink.Configuration) -> Array | None:
        """When following a plan, a displacement (nv,) to apply before the first iteration."""
        return None


class ClosedFormResolver(Resolver):
    """The closed forms without hard limits or time."""

    _weights: Array
    _gradient: Array | None = None

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The method's formula at the configuration."""
        state = self.task.state(configuration)
        twist = self.task.clamped(state.error)
        J, T = state.jacobian, state.projector
        if self.job.method.name == "weighted_least_norm":
            if first:
                self._weigh(configuration)
            return Iteration(closed_form.weighted_least_norm(J, T, twist, self._weights))
        h = np.zeros(configuration.model.nv)
        if first:
            h = total_displacement(self.objectives, configuration)
        operational = self.job.path_task.operational
        return Iteration(BY_METHOD[self.job.method.name](J, T, twist, h, operational))

    def _weigh(self, configuration: mink.Configuration) -> None:
        """Compute the joint weights for a waypoint.

        Whether a joint approaches its limit is decided by the change since the last waypoint; the
        small corrections between iterations would decide it arbitrarily.
        """
        ranges = JointRanges.of(configuration.model)
        at = (ranges.positions(configuration.q), ranges.lower, ranges.upper)
        self._weights = closed_form.joint_limit_weights(*at, self._gradient)
        self._gradient = closed_form.joint_limit_gradient(*at)


class SaturationResolver(Resolver):
    """Saturation in the null space: a closed form that enforces position and velocity limits."""

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The shortest step inside the limits, which are widened to include zero velocity.

        So a joint outside its range may stay or return, and a joint that an acceleration limit
        would keep moving may stop.
        """
        state, dt = self.task.state(configuration), self.limits.dt
        limits = gather_limits(self.limits.limits, configuration, dt)
        lower, upper = _with_rest(limits, dt)
        result = closed_form.saturation_in_null_space(
            state.jacobian, state.projector, self.task.clamped(state.error), lower, upper,
            optimal=self.job.settings.optimal,
        )  # fmt: skip
        dq = result.displacement
        if result.scale == 1.0:
            return Iteration(dq)
        names = []
        for dof in np.flatnonzero(result.saturated):
            above = upper[dof] - dq[dof] < dq[dof] - lower[dof]
            kind = (limits.upper_kind if above else limits.lower_kind)[dof]
            joint, side = self.limits.ranges.names[dof], "upper" if above else "lower"
            names.append(str(BindingLimit(joint, kind, side, 0.0)))
        return Iteration(dq, result.scale, tuple(names), Status.SCALED)


class QpResolver(Resolver):
    """The constrained counterparts: the controller's QP with the task's limits."""

    def __init__(self, job: Job, projector: TwistProjector, limits: WaypointLimits) -> None:
        super().__init__(job, projector, limits)
        model, settings = job.path_task.model, job.settings
        self._planned = settings.secondary == "plan"
        self.controller = Controller(
            model,
            tasks=[self.task],
            secondary=self.objectives,
            secondary_space=job.method.space,
            solver=job.solver,
            metric=None if settings.metric == "1" else JointRanges.of(model).metric,
            limits=limits.limits,
        )
        self.controller.smooth = False

    def lead(self, configuration: mink.Configuration) -> Array | None:
        """The displacement to the plan, clipped to the limits; the steps correct the task error.

        Along a limit and near a fold the linear rows are accurate only very close by: a step that
        is linearised at the last waypoint may fail where the plan, on its waypoints, succeeds.
        """
        if not self._planned:
            return None
        desired = total_displacement(self.objectives, configuration)
        limits = gather_limits(self.limits.limits, configuration, self.limits.dt)
        lead: Array = np.clip(desired, *_with_rest(limits, self.limits.dt))
        return lead

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """One step of the controller, over the whole duration of the waypoint.

        A plan is followed in every iteration: it meets the task, so that the motion towards it does
        not violate the task by curvature.
        """
        dt = self.limits.dt
        step = self.controller.step(configuration, dt, use_secondary=first or self._planned)
        solved = step.status is Status.SOLVED
        names = () if solved else tuple(str(limit) for limit in step.binding)
        return Iteration(step.velocity * dt, step.scale, names, step.status)


def _with_rest(limits: GatheredLimits, dt: float) -> tuple[Array, Array]:
    """Bounds of a displacement, (nv,) each, widened to include zero."""
    return np.minimum(limits.lower * dt, 0.0), np.maximum(limits.upper * dt, 0.0)


def secondary_objectives(
    path_task: PathTask, task: TwistTask, settings: MethodSettings
) -> list[SecondaryObjective]:
    """A list of the secondary objective in a method's settings; empty if there is none."""
    model = path_task.model
    if settings.own_secondary is not None:
        return [settings.own_secondary]
    match settings.secondary:
        case "centering":
            if settings.weight == "equal":
                raise InvalidInput(
                    "follow: weight 'equal' is for the posture tasks of other libraries; give "
                    "gradient, paper or natural."
                )
            return [JointCentering(model, settings.weight, settings.gain)]
        case "posture" | "plan":  # for a plan, aim() changes the reference at every waypoint
            return [PostureReference(model, path_task.start, settings.gain)]
        case "manipulability":
            return [Manipulability(model, task, settings.gain)]
        case "roll":
            return [RollReference(model, task, settings.gain, longest=task.max_angular_step)]
        case _:
            return []
