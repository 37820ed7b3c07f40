"""The methods that are other libraries' steps: a path's task and settings as they are posed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import mink
import numpy as np
import qpsolvers

from qp_twist.checks import Array
from qp_twist.control import Status
from qp_twist.errors import InvalidInput
from qp_twist.following.resolver import Displacement, Resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, Method, MethodSettings, PathTask, twist_task
from qp_twist.peers import PEERS, PeerFrame, Posed
from qp_twist.peers.mink_peer import MinkStep
from qp_twist.peers.peer import Priority
from qp_twist.qp import NoSolutionFound
from qp_twist.qp.backend import SETTINGS

_STANDING = 1e-9
"""The least speed limit, rad/s or m/s: pink takes one of zero for none."""
_SCALE_ROUNDING = 1e-6
"""A share of the task that is short of one by less than this is PlaCo's rounding."""

_PRIORITIES: dict[str, Priority] = {"placo_hard": "hard", "placo_scaled": "scaled"}


class PeerLimits(WaypointLimits):
    """The time of a waypoint, and the speeds that its iterations have left.

    A peer's speed limit holds for one step. The iterations of a waypoint share its time, so each is
    given what the ones before have left of |q̇| Δt.
    """

    def __init__(self, path_task: PathTask) -> None:
        super().__init__(path_task)
        self.ranges = JointRanges.of(path_task.model)
        self._began = self.ranges.positions(path_task.start)

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Note where the waypoint begins."""
        super().begin_waypoint(configuration, duration)
        self._began = self.ranges.positions(configuration.q)

    def speeds(self, configuration: mink.Configuration) -> Array:
        """Largest joint speeds, rad/s or m/s, (nv,); ∞ where none is stated."""
        moved = np.abs(self.ranges.positions(configuration.q) - self._began) / self.dt
        left: Array = np.maximum(self.velocity_limits - moved, _STANDING)
        return left


class PeerResolver(Resolver):
    """One step of another library, as it comes: nothing here verifies or repairs it.

    Iterations and tolerances are those of all methods, and the posture pulls in the first iteration
    of a waypoint, unless the settings say otherwise. What the library calls solved is reported as
    solved; what it raises ends the run with its name.

    Attributes:
        limits: The time of the waypoint and the speeds; the peers hold their own limits.
        peer: The library, with the robot that it has read.
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
        """Pose the step to the library.

        Raises:
            InvalidInput: If it cannot express the task or the settings, or is not installed.
        """
        self.method = METHODS[method]
        posed = posed_step(path_task, settings, projector, self.method, solver)
        self.peer = PEERS[self.method.peer](posed)
        self.step = self.peer.step()
        self.task = twist_task(path_task, projector)
        self.limits = limits
        self._gain = 0.0 if settings.secondary == "none" else settings.gain
        self._every_iteration = settings.every_iteration

    def displacement(self, configuration: mink.Configuration, *, first: bool) -> Displacement:
        """The library's step over the time of the waypoint."""
        gain = self._gain if first or self._every_iteration else 0.0
        failures: tuple[type[Exception], ...] = (
            *self.peer.failures,
            qpsolvers.exceptions.QPError,
            qpsolvers.exceptions.SolverNotFound,
        )
        try:
            with warnings.catch_warnings():
                # qpsolvers warns of each dense matrix that it converts for a sparse solver.
                warnings.simplefilter("ignore")
                self._aim(configuration, gain)
                velocity = self.step.velocity(self.limits.dt)
        except failures as error:
            raise NoSolutionFound(f"{self.method.peer}: {error}") from error
        scale, status = self.step.scale, Status.SCALED
        if scale >= 1.0 - _SCALE_ROUNDING:
            scale, status = 1.0, Status.SOLVED
        return Displacement(velocity * self.limits.dt, scale, (), status)

    def _aim(self, configuration: mink.Configuration, gain: float) -> None:
        """Hand the library where the robot is, the target, the posture and the speeds left."""
        target, task = self.task.target, self.task
        assert target is not None
        here = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
        if isinstance(self.step, MinkStep):
            self.step.configuration = configuration  # its kinematics is done
        else:
            self.step.update(self.peer.state(configuration.q))
        self.step.aim(self.peer.goals(configuration.q, [target], gain, [here]))
        if self.peer.posed.speeds is not None:
            self.step.limit_speeds(self.limits.speeds(configuration))


def posed_step(
    path_task: PathTask,
    settings: MethodSettings,
    projector: TwistProjector,
    method: Method,
    solver: str,
) -> Posed:
    """A method's step as its library is handed it.

    Without a secondary the posture's costs remain: they keep the program strictly convex.

    Raises:
        InvalidInput: If task or settings are more than other libraries can express.
    """
    frame, ranges = peer_frame(path_task, projector, method), JointRanges.of(path_task.model)
    weight, centering = settings.weight, settings.secondary == "centering"
    _refuse(method, {
        "peers run robots of hinges and slides only.": ranges.qpos.min(initial=0) < 0,
        f"secondary {settings.secondary!r} cannot be said with a posture task; give none, "
        "centering or posture.": settings.secondary not in ("none", "centering", "posture"),
        f"a posture's gain is 0 to 1, got {settings.gain:g}.": settings.gain > 1.0,
        "posture_cost is 0, which leaves the free motion to rounding; give a small number above "
        "0.": settings.posture_cost == 0.0,
        f"weight {weight!r} cannot be said with a posture task; give natural (costs in the ratio "
        "of the ranges) or equal.": centering and weight not in ("natural", "equal"),
    })  # fmt: skip
    target, costs = path_task.start.copy(), np.full(path_task.model.nv, settings.posture_cost)
    if centering:
        target[ranges.qpos] = ranges.middle
    if centering and weight == "natural":
        # In the ratio of W, the widest range 1; a joint without a range, which W leaves out, costs
        # a hundredth of that.
        W = ranges.weight
        costs *= np.where(W > 0.0, W / W[W > 0.0].min(initial=np.inf), 1e-2)
    # Our own compiled method is known to nobody else.
    solver = "daqp" if solver == COMPILED else solver
    # A peer at its best has the tolerances that our own QPs have. Polishing is left out: OSQP says
    # on standard output where there is nothing to polish.
    tuned = {} if method.name == "mink_default" else SETTINGS.get(solver, {})
    return Posed(
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
        "of this package.": bool(path_task.constraints),
        f"{peer} cannot hold the turn about one axis alone (angular = a line); use one of the QPs "
        "of this package.": frame.angular.kind is ProjectorKind.LINE,
    })  # fmt: skip
    return frame


def _refuse(method: Method, reasons: Mapping[str, bool]) -> None:
    for sentence, wrong in reasons.items():
        if wrong:
            raise InvalidInput(f"follow({method.name!r}): {sentence}")
