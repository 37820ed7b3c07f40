"""Steps of other libraries as methods: conversion of a path's task and settings."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import mink
import numpy as np
import qpsolvers

from qp_twist.checks import Array
from qp_twist.control import Status
from qp_twist.errors import InvalidInput
from qp_twist.following.resolver import Iteration, Resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, Method, MethodSettings, PathTask, twist_task
from qp_twist.peers import PEERS, PeerFrame, PeerProblem
from qp_twist.peers.mink_peer import MinkStep
from qp_twist.peers.peer import Priority
from qp_twist.qp import NoSolutionFound
from qp_twist.qp.backend import SETTINGS

_STANDING = 1e-9
"""Smallest speed limit, rad/s or m/s: pink treats zero as no limit."""
_SCALE_ROUNDING = 1e-6
"""A scale below 1 by less than this is PlaCo's rounding."""

_PRIORITIES: dict[str, Priority] = {"placo_hard": "hard", "placo_scaled": "scaled"}


class PeerLimits(WaypointLimits):
    """Duration of a waypoint, and the speed limits that remain for its iterations.

    A peer's speed limit holds for one step. The iterations of a waypoint share its duration, so
    each may use what the previous ones left of |q̇| Δt.
    """

    def __init__(self, path_task: PathTask) -> None:
        super().__init__(path_task)
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


class PeerResolver(Resolver):
    """One step of another library, neither verified nor repaired.

    Iterations and tolerances are the same as for all methods, and the posture task acts in the
    first iteration of a waypoint unless the settings differ. A step is reported as solved if the
    library says so; an exception of the library ends the run with its name.

    Attributes:
        limits: Duration of the waypoint and the speed limits; peers have their own limits.
        peer: The library, with its robot model.
        step: Its tasks and limits.
    """

    limits: PeerLimits

    def __init__(
        self,
        path_task: PathTask,
        method: str,
        settings: MethodSettings,
        projector: TwistProjector,
        solver: str,
        limits: PeerLimits,
    ) -> None:
        """Set up the step in the library.

        Raises:
            InvalidInput: If it cannot express the task or the settings, or is not installed.
        """
        self.method = METHODS[method]
        problem = posed_step(path_task, settings, projector, self.method, solver)
        self.peer = PEERS[self.method.peer](problem)
        self.step = self.peer.step()
        self.task = twist_task(path_task, projector)
        self.limits = limits
        self._gain = 0.0 if settings.secondary == "none" else settings.gain
        self._every_iteration = settings.every_iteration

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Iteration:
        """The library's step over the time of the waypoint."""
        gain = self._gain if first or self._every_iteration else 0.0
        failures: tuple[type[Exception], ...] = (
            *self.peer.failures,
            qpsolvers.exceptions.QPError,
            qpsolvers.exceptions.SolverNotFound,
        )
        try:
            with warnings.catch_warnings():
                # qpsolvers warns about dense matrices that it converts for a sparse solver.
                warnings.simplefilter("ignore")
                self._aim(configuration, gain)
                velocity = self.step.velocity(self.limits.dt)
        except failures as error:
            raise NoSolutionFound(f"{self.method.peer}: {error}") from error
        scale, status = self.step.scale, Status.SCALED
        if scale >= 1.0 - _SCALE_ROUNDING:
            scale, status = 1.0, Status.SOLVED
        return Iteration(velocity * self.limits.dt, scale, (), status)

    def _aim(self, configuration: mink.Configuration, gain: float) -> None:
        """Set configuration, target, posture and remaining speeds in the library."""
        target, task = self.task.target, self.task
        assert target is not None
        here = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        if isinstance(self.step, MinkStep):
            self.step.configuration = configuration  # its kinematics is computed
        else:
            self.step.update(self.peer.state(configuration.q))
        self.step.aim(self.peer.goals(configuration.q, [target], gain, [here]))
        if self.peer.problem.speeds is not None:
            self.step.limit_speeds(self.limits.speeds(configuration))


def posed_step(
    path_task: PathTask,
    settings: MethodSettings,
    projector: TwistProjector,
    method: Method,
    solver: str,
) -> PeerProblem:
    """A method's step for its library.

    Without a secondary the posture's costs remain: they keep the program strictly convex.

    Raises:
        InvalidInput: If other libraries cannot express the task or the settings.
    """
    frame, ranges = peer_frame(path_task, projector, method), JointRanges.of(path_task.model)
    weight, centering = settings.weight, settings.secondary == "centering"
    _refuse(method, {
        "peers run robots of hinges and slides only.": ranges.qpos.min(initial=0) < 0,
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
    # Other libraries do not have this package's compiled method.
    solver = "daqp" if solver == COMPILED else solver
    # For a fair comparison use the tolerances of this package's QPs. Without polishing: OSQP prints
    # a message if there is nothing to polish.
    tuned = {} if method.name == "mink_default" else SETTINGS.get(solver, {})
    return PeerProblem(
        path_task.model,
        (frame,),
        target,
        costs,
        path_task.velocity_limits if path_task.durations is not None else None,
        _PRIORITIES.get(method.name, "soft"),
        solver=solver,
        settings={key: value for key, value in tuned.items() if key != "polishing"},
    )


def peer_frame(path_task: PathTask, projector: TwistProjector, method: Method) -> PeerFrame:
    """The controlled frame with one of the path's projectors.

    Raises:
        InvalidInput: If the task has bands or constraints, or holds a turn about one axis alone.
    """
    peer = method.peer
    frame = PeerFrame(
        path_task.frame_name,
        path_task.frame_type,
        projector,
        path_task.operational,
        f"follow({method.name!r}): {peer}",
    )
    _refuse(method, {
        f"tolerance bands are not put into the words of {peer} here; leave [[bands]] out, or use "
        "one of the QPs of this package.": bool(path_task.bands),
        f"the task's constraints are not handed to {peer}; leave them out, or use one of the QPs "
        "of this package.": bool(path_task.stated_constraints),
        f"{peer} cannot hold the turn about one axis alone (angular = a line); use one of the QPs "
        "of this package.": frame.angular.kind is ProjectorKind.LINE,
    })  # fmt: skip
    return frame


def _refuse(method: Method, reasons: Mapping[str, bool]) -> None:
    for sentence, wrong in reasons.items():
        if wrong:
            raise InvalidInput(f"follow({method.name!r}): {sentence}")
