"""One interface for all methods: a configuration and a target in, a joint displacement out."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass

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
from qp_twist.paths import METHODS, MethodSettings, PathTask, twist_task

LARGEST_JOINT = 1e6
"""A joint beyond this many rad has diverged; its error would only overflow."""


@dataclass(frozen=True, eq=False)
class Iteration:
    """Result of one iteration.

    Attributes:
        dq: Joint displacement, rad or m, (nv,).
        scale: Scale s of the task.
        binding: Names of the binding limits.
        status: Status of the step; always ``SOLVED`` for closed forms without limits.
    """

    dq: Array
    scale: float = 1.0
    binding: tuple[str, ...] = ()
    status: Status = Status.SOLVED


class Resolver(abc.ABC):
    """A method, prepared for one task.

    Attributes:
        task: The twist task; the caller sets its target at every waypoint.
        limits: The limits that the method enforces, shared by all resolvers of a run.
        objectives: Its secondary objectives.
    """

    task: TwistTask
    limits: WaypointLimits | None = None
    objectives: Sequence[SecondaryObjective] = ()

    @abc.abstractmethod
    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """Compute one iteration; on the waypoint's ``first`` one the secondary is active."""

    def aim(self, plan: Array, index: int) -> None:
        """Set the reference of the secondary to the plan's (N, nq) row of the next waypoint."""
        for objective in self.objectives:
            if isinstance(objective, PostureReference):
                objective.q_ref = plan[index]

    def lead(self, configuration: mink.Configuration) -> Array | None:
        """When following a plan, a displacement (nv,) to apply before the first iteration."""
        return None

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Begin a waypoint from the configuration at the last one, ``duration`` seconds before."""
        if self.limits is not None:
            self.limits.begin_waypoint(configuration, duration)


class ClosedFormResolver(Resolver):
    """The closed forms without hard limits or time."""

    def __init__(
        self, path_task: PathTask, method: str, settings: MethodSettings, projector: TwistProjector
    ) -> None:
        self.method = METHODS[method]
        self.task = twist_task(path_task, projector)
        self.operational = path_task.operational
        self.objectives = secondary_objectives(path_task, self.task, settings)
        self.ranges = JointRanges.of(path_task.model)
        self._weights = np.ones(path_task.model.nv)
        self._gradient: Array | None = None

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The method's formula at the configuration."""
        state = self.task.state(configuration)
        twist = self.task.clamped(state.error)
        h = np.zeros(configuration.model.nv)
        if first:
            h = total_displacement(self.objectives, configuration)
        J, T = state.jacobian, state.projector
        if self.method.name == "weighted_least_norm":
            if first:
                self._weigh(configuration.q)
            return Iteration(closed_form.weighted_least_norm(J, T, twist, self._weights))
        return Iteration(BY_METHOD[self.method.name](J, T, twist, h, self.operational))

    def _weigh(self, q: Array) -> None:
        """Compute the joint weights for a waypoint.

        Whether a joint approaches its limit is decided by the change since the last waypoint; the
        small corrections between iterations would decide it arbitrarily.
        """
        at = (self.ranges.positions(q), self.ranges.lower, self.ranges.upper)
        self._weights = closed_form.joint_limit_weights(*at, self._gradient)
        self._gradient = closed_form.joint_limit_gradient(*at)


class SaturationResolver(Resolver):
    """Saturation in the null space: a closed form that enforces position and velocity limits."""

    limits: WaypointLimits

    def __init__(
        self,
        path_task: PathTask,
        settings: MethodSettings,
        projector: TwistProjector,
        limits: WaypointLimits,
    ) -> None:
        self.task = twist_task(path_task, projector)
        self.optimal = settings.optimal
        self.limits = limits
        self.names = JointRanges.of(path_task.model).names

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The shortest step inside the limits, which are widened to include zero velocity.

        So a joint outside its range may stay or return, and a joint that an acceleration limit
        would keep moving may stop.
        """
        state = self.task.state(configuration)
        dt = self.limits.dt
        limits = gather_limits(self.limits.limits, configuration, dt)
        lower, upper = _with_rest(limits, dt)
        result = closed_form.saturation_in_null_space(
            state.jacobian, state.projector, self.task.clamped(state.error), lower, upper,
            optimal=self.optimal,
        )  # fmt: skip
        dq = result.displacement
        names = []
        for dof in np.flatnonzero(result.saturated) if result.scale < 1.0 else ():
            above = upper[dof] - dq[dof] < dq[dof] - lower[dof]
            kind = (limits.upper_kind if above else limits.lower_kind)[dof]
            side = "upper" if above else "lower"
            names.append(str(BindingLimit(self.names[dof], kind, side, 0.0)))
        status = Status.SCALED if result.scale < 1.0 else Status.SOLVED
        return Iteration(dq, result.scale, tuple(names), status)


class QpResolver(Resolver):
    """The constrained counterparts: the controller's QP with the task's limits."""

    limits: WaypointLimits

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        projector: TwistProjector,
        solver: str,
        limits: WaypointLimits,
    ) -> None:
        self.method = METHODS[method]
        self.task = twist_task(path_task, projector)
        self.limits = limits
        model = path_task.model
        self.objectives = secondary_objectives(path_task, self.task, settings)
        self._planned = settings.secondary == "plan"
        self.controller = Controller(
            model,
            tasks=[self.task],
            secondary=self.objectives,
            secondary_space=self.method.space,
            solver=solver,
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
        dt = self.limits.dt
        limits = gather_limits(self.limits.limits, configuration, dt)
        desired = total_displacement(self.objectives, configuration)
        lower, upper = _with_rest(limits, dt)
        lead: Array = np.clip(desired, lower, upper)
        return lead

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """One step of the controller, over the whole duration of the waypoint.

        A plan is followed in every iteration: it meets the task, so that the motion towards it does
        not violate the task by curvature.
        """
        dt = self.limits.dt
        step = self.controller.step(configuration, dt, use_secondary=first or self._planned)
        names: tuple[str, ...] = ()
        if step.status is not Status.SOLVED:
            names = tuple(str(limit) for limit in step.binding)
        return Iteration(step.velocity * dt, step.scale, names, step.status)


def _with_rest(limits: GatheredLimits, dt: float) -> tuple[Array, Array]:
    """Bounds of a displacement, (nv,) each, widened to include zero."""
    return np.minimum(limits.lower * dt, 0.0), np.maximum(limits.upper * dt, 0.0)


def make_resolver(
    path_task: PathTask,
    method: str,
    settings: MethodSettings,
    projector: TwistProjector,
    solver: str,
    limits: WaypointLimits,
) -> Resolver:
    """Make the resolver of a method, by name, for one projector."""
    if METHODS[method].constrained:
        return QpResolver(path_task, method, settings, projector, solver, limits)
    if method == "sns":
        if path_task.stated_constraints:
            raise InvalidInput(
                "follow('sns'): saturation in the null space takes bounds on single joints only, "
                f"and {path_task.name} has constraints ({path_task.stated_constraints[0].kind}); "
                "use one of the QPs of this package."
            )
        return SaturationResolver(path_task, settings, projector, limits)
    return ClosedFormResolver(path_task, method, settings, projector)


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
