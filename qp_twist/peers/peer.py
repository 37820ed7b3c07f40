"""Description of a step for another library, and the interface of the libraries."""

from __future__ import annotations

import abc
import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector, twist_error

_ALONG = 1e-9
"""An axis counts as one of the frame's axes if its other two entries are below this."""


Priority = Literal["hard", "soft", "scaled"]


@dataclass(frozen=True, eq=False)
class PeerFrame:
    """A controlled frame and its projector.

    Other libraries weight the pose error along the frame's axes, or align one axis of the frame
    with a direction. This cannot express every twist projector.

    Attributes:
        name: Name of the frame.
        type: ``"site"``, ``"body"`` or ``"geom"``.
        projector: Its twist projector.
        operational: Directions in which the robot can move the frame.
        refused: Beginning of the message if a library cannot express the projector.
    """

    name: str
    type: str
    projector: TwistProjector
    operational: TwistProjector
    refused: str = "peers: another library"

    @cached_property
    def linear(self) -> Projector:
        """The linear block; full if only immovable directions are free."""
        return self._widened(self.projector.linear, self.operational.linear)

    @cached_property
    def angular(self) -> Projector:
        """The angular block, likewise."""
        return self._widened(self.projector.angular, self.operational.angular)

    @cached_property
    def minimal(self) -> TwistProjector:
        """The projector without the rows in which the robot cannot move."""
        return self.projector.intersection(self.operational)

    def _widened(self, block: Projector, operational: Projector) -> Projector:
        same_frame = self.projector.frame == self.operational.frame
        if operational.kind is ProjectorKind.FULL or not (same_frame and block.rank):
            return block
        left: Array = operational.basis - block.basis @ (block.basis.T @ operational.basis)
        return Projector.full() if np.abs(left).max(initial=0.0) < _ALONG else block

    def position_costs(self) -> Array:
        """Weights, 0 or 1, of the position along the frame's axes, (3,).

        Raises:
            InvalidInput: If the linear block has another axis.
        """
        linear, frame = self.linear, self.projector.frame
        if linear.axis is None:
            return np.full(3, 1.0 if linear.rank else 0.0)
        own = _own_axis(linear.axis)
        if own is None or not (frame == "body" or (frame == "target" and self._held(linear.axis))):
            raise InvalidInput(
                f"{self.refused} weighs positions along the frame's own axes, and "
                f"{np.round(linear.axis, 6).tolist()} fixed to the {frame} does not stay one of "
                "them; use one of the QPs of this package."
            )
        position = np.full(3, 1.0 if linear.kind is ProjectorKind.PLANE else 0.0)
        position[own] = 1.0 - position[own]
        return position

    def orientation_costs(self) -> Array:
        """Weights, 0 or 1, of the orientation about the frame's axes, (3,).

        Raises:
            InvalidInput: If the free axis is none of these.
        """
        angular = self.angular
        if angular.axis is None:
            return np.full(3, 1.0 if angular.rank else 0.0)
        own = None if self.projector.frame == "world" else _own_axis(angular.axis)
        if own is None:
            raise InvalidInput(
                f"{self.refused} weighs orientations about the frame's own axes, and the free axis "
                "is none of these; use one of the QPs of this package."
            )
        orientation = np.ones(3)
        orientation[own] = 0.0
        return orientation

    def _held(self, axis: Array) -> bool:
        """Whether the task keeps an axis of the waypoint on that of the frame."""
        angular = self.angular
        return angular.kind is ProjectorKind.FULL or (
            angular.axis is not None and np.abs(np.cross(angular.axis, axis)).max() < _ALONG
        )

    @cached_property
    def axis_in_world(self) -> bool:
        """Whether the free axis is fixed to the world: then it moves in the frame."""
        T = self.projector if self.projector.angular.axis is not None else self.minimal
        return T.frame == "world"

    def axis(self, target: Array) -> tuple[Array, Array]:
        """The free axis in the frame and its direction in the world, each (3,).

        ``target`` is the rotation of the waypoint, (3, 3). An axis e that is fixed to the frame or
        to the waypoint is the same vector in both; one in the world is that of the waypoint.
        """
        e = self.projector.angular.axis
        e = self.minimal.angular.axis if e is None else e
        assert e is not None
        return (target.T @ e, e) if self.axis_in_world else (e, target @ e)

    def facing(self, target: mink.SE3, here: mink.SE3) -> mink.SE3:
        """The waypoint; with a free roll, it gets the frame's roll.

        Then the pose error does not contain the roll.
        """
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


def _own_axis(axis: Array) -> int | None:
    """Index of the frame's axis that is ±``axis`` (3,); ``None`` for an oblique one."""
    index = int(np.argmax(np.abs(axis)))
    return index if np.abs(np.delete(axis, index)).max() < _ALONG else None


@dataclass(frozen=True, eq=False)
class PeerProblem:
    """A step for any library: frames, a posture, limits of position and speed.

    Attributes:
        model: The robot, hinges and slides only.
        frames: Controlled frames, each at cost 1.
        posture: Reference configuration of the free motion, (nq,).
        costs: Costs of the posture, one for all joints or (nv,).
        speeds: Velocity limits, rad/s or m/s, (nv,), ∞ without a limit; ``None`` for none at all.
        priority: Priority of the frames: costs, equality constraints, or constraints that are
            scaled together if infeasible; for those of a library see :attr:`Peer.priorities`.
        damping: Levenberg–Marquardt damping of the frame tasks of mink and pink.
        aligned: Whether mink frees an axis by its ``AxisAlignTask``, for any axis, or by a
            ``FrameTask`` without a cost about it.
        limit_gain: Share of the distance to the end of its range that a joint may move in a step,
            for mink and pink; ``None`` for their defaults.
        solver: Backend of mink and pink.
        settings: Options of the backend.
    """

    model: mujoco.MjModel
    frames: tuple[PeerFrame, ...]
    posture: Array
    costs: float | Array
    speeds: Array | None = None
    priority: Priority = "soft"
    damping: float = 0.0
    aligned: bool = True
    limit_gain: float | None = None
    solver: str = "daqp"
    settings: Mapping[str, Any] = field(default_factory=dict)


class PeerStep(abc.ABC):
    """Tasks and limits of a library, created once and used for many steps.

    Attributes:
        setters: Functions, one for each of the :meth:`Peer.goals` of a step.
        scale: Scale of the last step.
    """

    setters: Sequence[Callable[[Any], object]]
    scale: float = 1.0

    @abc.abstractmethod
    def update(self, state: Array) -> object:
        """Kinematics at a :meth:`Peer.state`."""

    def aim(self, goals: Sequence[Any]) -> None:
        """Set targets and posture."""
        for setter, goal in zip(self.setters, goals, strict=True):
            setter(goal)

    @abc.abstractmethod
    def limit_speeds(self, speeds: Array) -> None:
        """Change the velocity limits, rad/s or m/s, (nv,); the problem must have some."""

    @abc.abstractmethod
    def velocity(self, dt: float) -> Array:
        """The library's step, rad/s or m/s, (nv,)."""


class Peer(abc.ABC):
    """A robot in a library's types; the conversion is not part of a step.

    Attributes:
        problem: The step.
        failures: Exceptions of the library if it has no step.
        needs: Its modules, each with its package.
        priorities: Supported priorities of the frames.
    """

    failures: tuple[type[Exception], ...] = ()
    needs: ClassVar[tuple[tuple[str, str], ...]] = ()
    priorities: ClassVar[tuple[Priority, ...]] = ("soft",)

    def __init__(self, problem: PeerProblem) -> None:
        """Convert the robot.

        Raises:
            InvalidInput: If the library is not installed or cannot express the step.
        """
        if problem.priority not in self.priorities:
            raise InvalidInput(
                f"{type(self).__name__}: its frames can be {' or '.join(self.priorities)}, not "
                f"{problem.priority}."
            )
        self.problem = problem

    @classmethod
    def modules(cls) -> list[Any]:
        """The modules of :attr:`needs`.

        Raises:
            InvalidInput: If one is not installed.
        """
        return [peer_module(name, package) for name, package in cls.needs]

    @classmethod
    def missing(cls) -> str | None:
        """A sentence if the library is not installed."""
        try:
            cls.modules()
        except InvalidInput as error:
            return str(error)
        return None

    def state(self, q: Array) -> Array:
        """Configurations (..., nq) in the library's order of joints."""
        return q

    def goals(
        self,
        q: Array,
        targets: Sequence[mink.SE3],
        gain: float,
        here: Sequence[mink.SE3] | None = None,
    ) -> list[Any]:
        """Targets and posture of a step in the library's types.

        Args:
            q: The configuration, (nq,).
            targets: Pose of each frame.
            gain: Share of the displacement to the posture, 0 to 1.
            here: Present poses of the frames; may be the targets if these are close.
        """
        goals: list[Any] = []
        for frame, target, pose in zip(self.problem.frames, targets, here or targets, strict=True):
            goals += self.frame_goals(frame, target, pose)
        return goals + self.posture_goals(q, gain)

    @abc.abstractmethod
    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """Goals of a frame."""

    def posture_goals(self, q: Array, gain: float) -> list[Any]:
        """Goal of the posture."""
        return [gain]

    @abc.abstractmethod
    def step(self) -> PeerStep:
        """Create tasks and limits."""


def peer_module(name: str, package: str) -> Any:
    """Import a module of an optional library.

    Raises:
        InvalidInput: If it is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pinocchio's import warns about its own parts
            return importlib.import_module(name)
    except ImportError as error:
        raise InvalidInput(
            f"{name} cannot be imported ({error}); install it: pip install {package}."
        ) from None
