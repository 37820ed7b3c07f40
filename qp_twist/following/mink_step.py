"""mink's own step as a method: a path's task and settings in mink's tasks, costs and limits.

mink weights the pose error along the frame's axes, or aligns one axis of the frame with a
direction. This cannot express every twist projector; what it cannot is refused.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import mink
import numpy as np
import qpsolvers

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following.resolver import Iteration, Job, Resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, twist_error
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import Method, MethodSettings, PathTask, twist_task
from qp_twist.qp import NoSolutionFound
from qp_twist.qp.backend import SETTINGS

_ALONG = 1e-9
"""An axis counts as one of the frame's axes if its other two entries are below this."""


class MinkResolver(Resolver):
    """``mink.solve_ik`` with mink's tasks, limits and posture, neither verified nor repaired.

    Iterations and tolerances are the same as for all methods, and the posture task acts in the
    first iteration of a waypoint unless the settings differ. mink's speed limit holds for one step;
    each iteration of a waypoint has what the previous ones left. A step is reported as solved if
    mink says so; an exception of mink ends the run with its message.

    Attributes:
        tasks: The pose, an axis to align if the roll is free, and the posture.
    """

    def __init__(self, job: Job, projector: TwistProjector, limits: WaypointLimits) -> None:
        """Create tasks and limits.

        Raises:
            InvalidInput: If mink cannot express the task or the settings.
        """
        task, settings = job.path_task, job.settings
        self.job, self.limits = job, limits
        self.frame = frame = mink_frame(task, projector, job.method)
        target, costs = posture(task, settings, job.method)
        self.task = twist_task(task, projector)
        self._aligns = frame.angular.kind is ProjectorKind.PLANE
        turns = 0.0 if self._aligns or not frame.angular.rank else 1.0
        place = task.frame_name, task.frame_type
        self._pose = mink.FrameTask(*place, frame.position_costs(), turns)
        self._axis = mink.AxisAlignTask(*place, cost=1.0)
        self._posture = mink.PostureTask(task.model, cost=costs)
        self._posture.set_target(target)
        self.tasks = [self._pose, *([self._axis] if self._aligns else []), self._posture]
        self._limits: list[mink.Limit] = [mink.ConfigurationLimit(task.model)]
        named = zip(limits.ranges.names, task.velocity_limits.tolist(), strict=True)
        finite = {name: speed for name, speed in named if np.isfinite(speed)}
        if task.durations is not None and finite:
            self._limits.append(mink.VelocityLimit(task.model, finite))
        # mink has no compiled step. For a fair comparison it gets the tolerances of this package's
        # QPs; without polishing, about which OSQP prints a message if there is nothing to polish.
        self._solver = "daqp" if job.solver == COMPILED else job.solver
        tuned = {} if job.method.name == "mink_default" else SETTINGS.get(self._solver, {})
        self._tuned = {key: value for key, value in tuned.items() if key != "polishing"}

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """mink's step over the time of the waypoint."""
        settings = self.job.settings
        self._set_targets(configuration)
        pulls = settings.secondary != "none" and (first or settings.every_iteration)
        self._posture.gain = settings.gain if pulls else 0.0
        try:
            with warnings.catch_warnings():
                # qpsolvers warns about dense matrices that it converts for a sparse solver.
                warnings.simplefilter("ignore")
                velocity = mink.solve_ik(
                    configuration, self.tasks, self.limits.dt, self._solver, limits=self._limits,
                    **self._tuned,
                )  # fmt: skip
        except (
            mink.MinkError,
            qpsolvers.exceptions.QPError,
            qpsolvers.exceptions.SolverNotFound,
        ) as error:
            raise NoSolutionFound(f"mink: {error}") from error
        return Iteration(np.asarray(velocity) * self.limits.dt)

    def _set_targets(self, configuration: mink.Configuration) -> None:
        """Set the targets and the remaining speeds."""
        target, task = self.task.target, self.task
        assert target is not None
        here = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        self._pose.set_target(self.frame.facing(target, here))
        if self._aligns:
            axis, direction = self.frame.axis(target.rotation().as_matrix())
            self._axis.set_axis(axis)
            self._axis.set_target(direction)
        for limit in self._limits:
            if isinstance(limit, mink.VelocityLimit):
                limit.limit = self.limits.speeds_left(configuration)[limit.indices]


def posture(path_task: PathTask, settings: MethodSettings, method: Method) -> tuple[Array, Array]:
    """Target (nq,) and costs (nv,) of the posture task, which stands for the secondary.

    Without a secondary the costs remain: they keep the program strictly convex.

    Raises:
        InvalidInput: If a posture task cannot express the settings.
    """
    ranges = JointRanges.of(path_task.model)
    weight, centering = settings.weight, settings.secondary == "centering"
    _refuse(method, {
        "mink's step runs robots of hinges and slides only.": ranges.qpos.min(initial=0) < 0,
        f"secondary {settings} cannot be stated as a posture task; give none, centering or "
        "posture.": settings.secondary not in ("none", "centering", "posture"),
        f"a posture's gain is 0 to 1, got {settings.gain:g}.": settings.gain > 1.0,
        "posture_cost is 0, which leaves the free motion to rounding; give a small number above "
        "0.": settings.posture_cost == 0.0,
        f"weight {weight!r} cannot be stated as a posture task; give natural (costs in the ratio "
        "of the ranges) or equal.": centering and weight not in ("natural", "equal"),
    })  # fmt: skip
    target, costs = path_task.start.copy(), np.full(path_task.model.nv, settings.posture_cost)
    if centering:
        target[ranges.qpos] = ranges.middle
    if centering and weight == "natural":
        # Costs in the ratio of W, 1 for the widest range; a hundredth of that for joints without a
        # range.
        W = ranges.weight
        costs *= np.where(W > 0.0, W / W[W > 0.0].min(initial=np.inf), 1e-2)
    return target, costs


class MinkFrame:
    """The controlled frame and its projector in mink's terms.

    Attributes:
        linear: The linear block; full if it frees only directions in which the robot cannot move.
        angular: The angular block, likewise.
    """

    def __init__(self, projector: TwistProjector, operational: TwistProjector, name: str) -> None:
        self.projector, self._name = projector, name
        self.linear, self.angular = projector.linear, projector.angular
        if projector.frame == operational.frame:
            self.linear = _widened(self.linear, operational.linear)
            self.angular = _widened(self.angular, operational.angular)
        self._minimal = projector.intersection(operational)

    def position_costs(self) -> Array:
        """Weights, 0 or 1, of the position along the frame's axes, (3,).

        Raises:
            InvalidInput: If the linear block has another axis.
        """
        linear, fixed_to = self.linear, self.projector.frame
        if linear.axis is None:
            return np.full(3, 1.0 if linear.rank else 0.0)
        own = int(np.argmax(np.abs(linear.axis)))
        oblique = np.abs(np.delete(linear.axis, own)).max() >= _ALONG
        kept = fixed_to == "body" or (fixed_to == "target" and self._keeps(linear.axis))
        if oblique or not kept:
            raise InvalidInput(
                f"follow({self._name!r}): mink weighs positions along the frame's own axes, and "
                f"{np.round(linear.axis, 6).tolist()} fixed to the {fixed_to} does not stay one of "
                "them; use one of the QPs of this package."
            )
        position = np.full(3, 1.0 if linear.kind is ProjectorKind.PLANE else 0.0)
        position[own] = 1.0 - position[own]
        return position

    def _keeps(self, axis: Array) -> bool:
        """Whether the task keeps an axis of the waypoint on that of the frame."""
        angular = self.angular
        return angular.kind is ProjectorKind.FULL or (
            angular.axis is not None and np.abs(np.cross(angular.axis, axis)).max() < _ALONG
        )

    def axis(self, target: Array) -> tuple[Array, Array]:
        """The free axis in the frame and its direction in the world, each (3,).

        ``target`` is the rotation of the waypoint, (3, 3). An axis e that is fixed to the frame or
        to the waypoint is the same vector in both; one in the world is that of the waypoint.
        """
        T = self.projector if self.projector.angular.axis is not None else self._minimal
        e = T.angular.axis
        assert e is not None
        return (target.T @ e, e) if T.frame == "world" else (e, target @ e)

    def facing(self, target: mink.SE3, here: mink.SE3) -> mink.SE3:
        """The waypoint; with a free roll it gets the frame's, so that the error contains none."""
        if self.angular.kind is ProjectorKind.FULL:
            return target
        rotation, goal = here.rotation(), target.rotation()
        error = twist_error(
            rotation.as_matrix(), here.translation(), goal.as_matrix(), target.translation(),
            self.projector,
        )  # fmt: skip
        return mink.SE3.from_rotation_and_translation(
            mink.SO3.exp(error[3:]) @ rotation, target.translation()
        )


def mink_frame(path_task: PathTask, projector: TwistProjector, method: Method) -> MinkFrame:
    """The controlled frame with one of the path's projectors.

    Raises:
        InvalidInput: If the task has bands or constraints, or holds a turn about one axis alone.
    """
    frame = MinkFrame(projector, path_task.operational, method.name)
    _refuse(method, {
        "tolerance bands are not put into the words of mink here; leave [[bands]] out, or use one "
        "of the QPs of this package.": bool(path_task.bands),
        "the task's constraints are not handed to mink; leave them out, or use one of the QPs of "
        "this package.": bool(path_task.stated_constraints),
        "mink cannot hold the turn about one axis alone (angular = a line); use one of the QPs of "
        "this package.": frame.angular.kind is ProjectorKind.LINE,
    })  # fmt: skip
    return frame


def _widened(block: Projector, operational: Projector) -> Projector:
    if operational.kind is ProjectorKind.FULL or not block.rank:
        return block
    left: Array = operational.basis - block.basis @ (block.basis.T @ operational.basis)
    return Projector.full() if np.abs(left).max(initial=0.0) < _ALONG else block


def _refuse(method: Method, reasons: Mapping[str, bool]) -> None:
    for sentence, wrong in reasons.items():
        if wrong:
            raise InvalidInput(f"follow({method.name!r}): {sentence}")
