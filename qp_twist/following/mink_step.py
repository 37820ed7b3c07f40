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
from qp_twist.following.resolver import Iteration, Resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, twist_error
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, Method, MethodSettings, PathTask, twist_task
from qp_twist.qp import NoSolutionFound
from qp_twist.qp.backend import SETTINGS

_STANDING = 1e-9
"""Smallest speed limit, rad/s or m/s: no step in practice, and no division by zero."""
_ALONG = 1e-9
"""An axis counts as one of the frame's axes if its other two entries are below this."""


class MinkLimits(WaypointLimits):
    """Duration of a waypoint, and the speed limits that remain for its iterations.

    mink's speed limit holds for one step. The iterations of a waypoint share its duration, so each
    may use what the previous ones left of |q̇| Δt.
    """

    def __init__(self, path_task: PathTask, *, accelerations: bool = True) -> None:
        super().__init__(path_task, accelerations=accelerations)
        self.ranges = JointRanges.of(path_task.model)
        self._began = self.ranges.positions(path_task.start)

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Store the configuration at the beginning of a waypoint."""
        super().begin_waypoint(configuration, duration)
        self._began = self.ranges.positions(configuration.q)

    def speeds(self, configuration: mink.Configuration) -> Array:
        """Largest joint speeds, rad/s or m/s, (nv,); ∞ without a limit."""
        moved = np.abs(self.ranges.positions(configuration.q) - self._began) / self.dt
        left: Array = np.maximum(self.velocity_limits - moved, _STANDING)
        return left


class MinkResolver(Resolver):
    """``mink.solve_ik`` with mink's tasks, limits and posture, neither verified nor repaired.

    Iterations and tolerances are the same as for all methods, and the posture task acts in the
    first iteration of a waypoint unless the settings differ. A step is reported as solved if mink
    says so; an exception of mink ends the run with its message.

    Attributes:
        limits: Duration of the waypoint and the speed limits.
        tasks: The pose, an axis to align if the roll is free, and the posture.
    """

    limits: MinkLimits

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        projector: TwistProjector,
        solver: str,
        limits: MinkLimits,
    ) -> None:
        """Create tasks and limits.

        Raises:
            InvalidInput: If mink cannot express the task or the settings.
        """
        model, frame = path_task.model, mink_frame(path_task, projector, METHODS[method])
        target, costs = posture(path_task, settings, METHODS[method])
        self.frame, self.limits = frame, limits
        self.task = twist_task(path_task, projector)
        self._aligns = frame.angular.kind is ProjectorKind.PLANE
        turns = 0.0 if self._aligns or not frame.angular.rank else 1.0
        place = path_task.frame_name, path_task.frame_type
        self._pose = mink.FrameTask(*place, frame.position_costs(), turns)
        self._axis = mink.AxisAlignTask(*place, cost=1.0)
        self._posture = mink.PostureTask(model, cost=costs)
        self._posture.set_target(target)
        self.tasks = [self._pose, *([self._axis] if self._aligns else []), self._posture]
        self._limits: list[mink.Limit] = [mink.ConfigurationLimit(model)]
        speeds = path_task.velocity_limits
        if path_task.durations is not None and np.isfinite(speeds).any():
            named = zip(limits.ranges.names, speeds.tolist(), strict=True)
            finite = {name: speed for name, speed in named if np.isfinite(speed)}
            self._limits.append(mink.VelocityLimit(model, finite))
        # mink has no compiled step. For a fair comparison it gets the tolerances of this package's
        # QPs; without polishing, about which OSQP prints a message if there is nothing to polish.
        self._solver = "daqp" if solver == COMPILED else solver
        tuned = {} if method == "mink_default" else SETTINGS.get(self._solver, {})
        self._tuned = {key: value for key, value in tuned.items() if key != "polishing"}
        self._gain = 0.0 if settings.secondary == "none" else settings.gain
        self._every_iteration = settings.every_iteration

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """mink's step over the time of the waypoint."""
        self._aim(configuration)
        self._posture.gain = self._gain if first or self._every_iteration else 0.0
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

    def _aim(self, configuration: mink.Configuration) -> None:
        """Set the target and the remaining speeds."""
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
                limit.limit = self.limits.speeds(configuration)[limit.indices]


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
        projector: The twist projector.
        linear: Its linear block; full if it frees only directions in which the robot cannot move.
        angular: Its angular block, likewise.
    """

    def __init__(self, projector: TwistProjector, operational: TwistProjector, name: str) -> None:
        self.projector, self._name = projector, name
        same_frame = projector.frame == operational.frame
        self.linear = _widened(projector.linear, operational.linear, same_frame)
        self.angular = _widened(projector.angular, operational.angular, same_frame)
        self._minimal = projector.intersection(operational)

    def position_costs(self) -> Array:
        """Weights, 0 or 1, of the position along the frame's axes, (3,).

        Raises:
            InvalidInput: If the linear block has another axis.
        """
        linear, fixed_to = self.linear, self.projector.frame
        if linear.axis is None:
            return np.full(3, 1.0 if linear.rank else 0.0)
        own = _own_axis(linear.axis)
        kept = fixed_to == "body" or (fixed_to == "target" and self._keeps(linear.axis))
        if own is None or not kept:
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


def _widened(block: Projector, operational: Projector, same_frame: bool) -> Projector:
    if operational.kind is ProjectorKind.FULL or not (same_frame and block.rank):
        return block
    left: Array = operational.basis - block.basis @ (block.basis.T @ operational.basis)
    return Projector.full() if np.abs(left).max(initial=0.0) < _ALONG else block


def _own_axis(axis: Array) -> int | None:
    """Index of the frame's axis that is ±``axis`` (3,); ``None`` for an oblique one."""
    index = int(np.argmax(np.abs(axis)))
    return index if np.abs(np.delete(axis, index)).max() < _ALONG else None


def _refuse(method: Method, reasons: Mapping[str, bool]) -> None:
    for sentence, wrong in reasons.items():
        if wrong:
            raise InvalidInput(f"follow({method.name!r}): {sentence}")
