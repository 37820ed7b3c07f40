"""A task in the terms of other libraries: costs along a frame's axes, an axis, a posture."""

from __future__ import annotations

from dataclasses import dataclass

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector
from qp_twist.kinematics import JointRanges, TwistTask
from qp_twist.path import Method, MethodSettings, PathTask

_ALONG = 1e-9
"""An axis is one of the frame's own if its other two entries are below this."""


@dataclass(frozen=True, eq=False)
class PeerRows:
    """What of the pose counts.

    Other libraries weigh the error of a pose along the frame's own axes, or align one axis of the
    frame with a direction. Not every twist projector can be said so.

    Attributes:
        method: The method that asks, for its messages.
        projector: The twist projector that they stand for.
        linear: Its linear block; full where that leaves free only what the robot cannot do.
        angular: Its angular block, likewise.
        minimal: The projector without the rows in which the robot cannot move.
    """

    method: Method
    projector: TwistProjector
    linear: Projector
    angular: Projector
    minimal: TwistProjector

    @classmethod
    def of(cls, path_task: PathTask, projector: TwistProjector, method: Method) -> PeerRows:
        """The rows of a projector.

        Raises:
            InvalidInput: If the peer has no words for the projector, or the task has bands or
                constraints.
        """
        if path_task.bands:
            raise InvalidInput(
                f"follow({method.name!r}): tolerance bands are not put into the words of "
                f"{method.peer} here; leave [[bands]] out, or use one of the QPs of this package."
            )
        if path_task.constraints:
            raise InvalidInput(
                f"follow({method.name!r}): the task's constraints are not handed to {method.peer}; "
                "leave them out, or use one of the QPs of this package."
            )
        operational = path_task.operational
        same_frame = projector.frame == operational.frame
        rows = cls(
            method,
            projector,
            _widened(projector.linear, operational.linear, same_frame),
            _widened(projector.angular, operational.angular, same_frame),
            projector.intersection(operational),
        )
        if rows.angular.kind is ProjectorKind.LINE:
            raise InvalidInput(
                f"follow({method.name!r}): {method.peer} cannot hold the turn about one axis alone "
                "(angular = a line); use one of the QPs of this package."
            )
        return rows

    def position(self) -> Array:
        """Which of the frame's own axes the position counts along, 0 or 1, (3,).

        Raises:
            InvalidInput: If the linear block has another axis.
        """
        linear, frame = self.linear, self.projector.frame
        if linear.axis is None:
            return np.full(3, 1.0 if linear.rank else 0.0)
        own = own_axis(linear.axis)
        if own is None or not (frame == "body" or (frame == "target" and self._held(linear.axis))):
            raise InvalidInput(
                f"follow({self.method.name!r}): {self.method.peer} weighs positions along the "
                f"frame's own axes, and {np.round(linear.axis, 6).tolist()} fixed to the {frame} "
                "does not stay one of them; use one of the QPs of this package."
            )
        position = np.full(3, 1.0 if linear.kind is ProjectorKind.PLANE else 0.0)
        position[own] = 1.0 - position[own]
        return position

    def _held(self, axis: Array) -> bool:
        """Whether the task keeps an axis of the waypoint on that of the frame."""
        angular = self.angular
        return angular.kind is ProjectorKind.FULL or (
            angular.axis is not None and np.abs(np.cross(angular.axis, axis)).max() < _ALONG
        )

    def axis(self, target: Array) -> tuple[Array, Array]:
        """The axis in the frame and its direction in the world, each (3,), of an angular plane.

        ``target`` is the rotation of the waypoint, (3, 3). An axis e that is fixed to the frame or
        to the waypoint is the same vector in both; one in the world is that of the waypoint.
        """
        T = self.projector if self.projector.angular.axis is not None else self.minimal
        e = T.angular.axis
        assert e is not None
        return (target.T @ e, e) if T.frame == "world" else (e, target @ e)


def _widened(block: Projector, operational: Projector, same_frame: bool) -> Projector:
    """Full, if a block holds all that the robot can do."""
    if operational.kind is ProjectorKind.FULL or not (same_frame and block.rank):
        return block
    left: Array = operational.basis - block.basis @ (block.basis.T @ operational.basis)
    return Projector.full() if np.abs(left).max(initial=0.0) < _ALONG else block


def own_axis(axis: Array) -> int | None:
    """Which of a frame's axes ``axis`` (3,) is, either way round; ``None`` for an oblique one."""
    index = int(np.argmax(np.abs(axis)))
    return index if np.abs(np.delete(axis, index)).max() < _ALONG else None


@dataclass(frozen=True, eq=False)
class Posture:
    """What the free motion is spent on.

    Attributes:
        target: Reference configuration, (nq,).
        costs: Of its joints, beside 1 for the task's rows, (nv,).
        gain: Share of the way to it that a step is asked for, 0 to 1.
        repeated: Whether it acts in every iteration of a waypoint.
    """

    target: Array
    costs: Array
    gain: float
    repeated: bool

    @classmethod
    def of(cls, path_task: PathTask, settings: MethodSettings, method: Method) -> Posture:
        """The posture of a method's settings; without a secondary its gain is zero.

        Then its costs remain: they keep the program strictly convex.

        Raises:
            InvalidInput: If the settings cannot be said with a posture.
        """
        ranges = JointRanges.of(path_task.model)
        if ranges.qpos.min(initial=0) < 0:
            raise InvalidInput(
                f"follow({method.name!r}): peers run robots of hinges and slides only."
            )
        if settings.secondary not in ("none", "centering", "posture"):
            raise InvalidInput(
                f"follow({method.name!r}): secondary {settings.secondary!r} cannot be said with a "
                "posture task; give none, centering or posture."
            )
        if settings.gain > 1.0:
            raise InvalidInput(
                f"follow({method.name!r}): a posture's gain is 0 to 1, got {settings.gain:g}."
            )
        if settings.posture_cost == 0.0:
            raise InvalidInput(
                f"follow({method.name!r}): posture_cost is 0, which leaves the free motion to "
                "rounding; give a small number above 0."
            )
        costs = np.full(path_task.model.nv, settings.posture_cost)
        target = path_task.start.copy()
        if settings.secondary == "centering":
            if settings.weight not in ("natural", "equal"):
                raise InvalidInput(
                    f"follow({method.name!r}): weight {settings.weight!r} cannot be said with a "
                    "posture task; give natural (costs in the ratio of the ranges) or equal."
                )
            target[ranges.qpos] = ranges.middle
            if settings.weight == "natural":
                costs *= in_ratio(ranges)
        gain = 0.0 if settings.secondary == "none" else settings.gain
        return cls(target, costs, gain, settings.every_iteration)


def in_ratio(ranges: JointRanges) -> Array:
    """Costs of the joints in the ratio of W, the widest range 1, (nv,).

    A joint without a range, which W leaves out, costs a hundredth of that.
    """
    weight = ranges.weight
    widest = weight[weight > 0.0].min(initial=np.inf)
    ratio: Array = np.where(weight > 0.0, weight / widest, 1e-2)
    return ratio


def facing(configuration: mink.Configuration, task: TwistTask, rows: PeerRows) -> mink.SE3:
    """The waypoint where the whole orientation counts; else with the roll that the frame has.

    An error of the pose has then nothing of the roll in it, however far that has turned.
    """
    target = task.target
    assert target is not None
    if rows.angular.kind is ProjectorKind.FULL:
        return target
    pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
    turn = mink.SO3.exp(task.state(configuration).error[3:])
    return mink.SE3.from_rotation_and_translation(turn @ pose.rotation(), target.translation())
