"""One step as it is posed to another library, and the interface of those who take it."""

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
"""An axis is one of the frame's own if its other two entries are below this."""


Priority = Literal["hard", "soft", "scaled"]


@dataclass(frozen=True, eq=False)
class PeerFrame:
    """A frame of the robot, and what of its pose counts.

    Other libraries weigh the error of a pose along the frame's own axes, or align one axis of the
    frame with a direction. Not every twist projector can be expressed like that.

    Attributes:
        name: Of the frame.
        type: ``"site"``, ``"body"`` or ``"geom"``.
        projector: Its twist projector.
        operational: In which directions the robot can move the frame.
        refused: Begins the message where a library cannot express the projector.
    """

    name: str
    type: str
    projector: TwistProjector
    operational: TwistProjector
    refused: str = "peers: another library"

    @cached_property
    def linear(self) -> Projector:
        """The linear block; full where that leaves free only what the robot cannot do."""
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
        """Along which of the frame's own axes the position counts, 0 or 1, (3,).

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
        """About which of the frame's own axes the orientation counts, 0 or 1, (3,).

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
        """Whether the free axis is fixed to the world: its place in the frame then changes."""
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
        """The waypoint where the whole orientation counts; else with the roll that the frame has.

        An error of the pose then contains nothing of the roll, however far that has turned.
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
    """Which of a frame's axes ``axis`` (3,) is, either way round; ``None`` for an oblique one."""
    index = int(np.argmax(np.abs(axis)))
    return index if np.abs(np.delete(axis, index)).max() < _ALONG else None


@dataclass(frozen=True, eq=False)
class Posed:
    """One step as any library is handed it: frames, a posture, limits of position and speed.

    Attributes:
        model: The robot, hinges and slides only.
        frames: What has to follow, each at cost 1.
        posture: The configuration to which the free motion goes, (nq,).
        costs: Of the posture, one for all joints or (nv,).
        speeds: Velocity limits, rad/s or m/s, (nv,), ∞ where there is none; ``None`` for none.
        priority: Of the frames: costs, equality constraints, or constraints that are scaled down
            together where they do not fit; :attr:`Peer.priorities` says who has which.
        damping: Levenberg–Marquardt's, of the frame tasks of mink and pink.
        aligned: Whether mink leaves an axis free by its ``AxisAlignTask``, which takes any axis, or
            by a ``FrameTask`` without a cost about it.
        limit_gain: Which share of the way to the end of its range a joint may go in a step, for
            mink and pink; ``None`` for their own default.
        solver: Backend of mink and pink.
        settings: Its options.
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
    """Tasks and limits of a library: what a program that uses it makes once and calls again.

    Attributes:
        setters: Functions that take the :meth:`Peer.goals` of a step, one each.
        scale: Share of the task that the last step kept.
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
        """Change the velocity limits, rad/s or m/s, (nv,); they must have been posed."""

    @abc.abstractmethod
    def velocity(self, dt: float) -> Array:
        """The library's own step, rad/s or m/s, (nv,)."""


class Peer(abc.ABC):
    """A robot as a library reads it; what is converted here is no part of a step.

    Attributes:
        posed: The step.
        failures: What the library raises where it has no step.
        needs: Its modules, each with the package that brings it.
        priorities: Which priorities of the frames it has.
    """

    failures: tuple[type[Exception], ...] = ()
    needs: ClassVar[tuple[tuple[str, str], ...]] = ()
    priorities: ClassVar[tuple[Priority, ...]] = ("soft",)

    def __init__(self, posed: Posed) -> None:
        """Read the robot.

        Raises:
            InvalidInput: If the library is not installed or cannot express the step.
        """
        if posed.priority not in self.priorities:
            raise InvalidInput(
                f"{type(self).__name__}: its frames can be {' or '.join(self.priorities)}, not "
                f"{posed.priority}."
            )
        self.posed = posed

    @classmethod
    def modules(cls) -> list[Any]:
        """Those of :attr:`needs`.

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
            gain: Share of the way to the posture, 0 to 1.
            here: Where the frames are now; where they are close to the targets these will do.
        """
        goals: list[Any] = []
        for frame, target, pose in zip(self.posed.frames, targets, here or targets, strict=True):
            goals += self.frame_goals(frame, target, pose)
        return goals + self.posture_goals(q, gain)

    @abc.abstractmethod
    def frame_goals(self, frame: PeerFrame, target: mink.SE3, here: mink.SE3) -> list[Any]:
        """Those of a frame."""

    def posture_goals(self, q: Array, gain: float) -> list[Any]:
        """Those of the posture."""
        return [gain]

    @abc.abstractmethod
    def step(self) -> PeerStep:
        """Make tasks and limits."""


def peer_module(name: str, package: str) -> Any:
    """A module of a library that need not be there.

    Raises:
        InvalidInput: If it is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pinocchio's import warns of its own parts
            return importlib.import_module(name)
    except ImportError as error:
        raise InvalidInput(
            f"{name} cannot be imported ({error}); install it: pip install {package}."
        ) from None
