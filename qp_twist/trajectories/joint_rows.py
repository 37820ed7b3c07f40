"""Contents of a trajectory file: rows of joint positions, by joint name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.referee import JointMotion, Tolerances
from qp_twist.trajectories.metadata import metadata_of

if TYPE_CHECKING:
    from qp_twist.following import Trajectory
    from qp_twist.trajectories.time_trajectory import TimedTrajectory


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of a joint trajectory, with or without times and velocities.

    Attributes:
        joint_names: Names of the columns.
        q: Positions, rad or m, (N, n).
        times: s, (N,), increasing; ``None`` without times.
        velocities: rad/s or m/s, (N, n); ``None`` if joints are interpolated linearly.
        metadata: Data of the task of these rows, if the file has them.
        accelerations: rad/s² or m/s², (N, n); ``None`` if joints move on cubics. With accelerations
            they move on quintics (:class:`~qp_twist.trajectories.JointMotion`).
        notes: What else the file has, and what of it is not looked at.
        sources: Whose figures the positions depend on, e.g. the zero positions of a known robot.
        own_ramps: Whether joints move straight between the rows of a program, whose controller
            makes ramps of its own: the rows say nothing of its accelerations.
    """

    joint_names: tuple[str, ...]
    q: Array
    times: Array | None = None
    velocities: Array | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    accelerations: Array | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    own_ramps: bool = False

    def __post_init__(self) -> None:
        count = len(self.joint_names)
        if len(set(self.joint_names)) < count:
            raise InvalidInput(f"joint_names: a name stands twice in {list(self.joint_names)}.")
        finite_array("q", self.q, (None, count))
        if self.times is not None:
            finite_array("times", self.times, (len(self.q),))
        if self.velocities is not None:
            finite_array("velocities", self.velocities, self.q.shape)
        if self.accelerations is not None:
            finite_array("accelerations", self.accelerations, self.q.shape)
            if self.velocities is None:
                raise InvalidInput(
                    "the rows have accelerations, but no velocities: no curve between them is "
                    "defined. Add the velocities, or leave the accelerations out."
                )

    def __repr__(self) -> str:
        clock = "untimed" if self.times is None else f"{self.times[-1] - self.times[0]:.6g} s"
        return f"JointRows({len(self.q)} rows of {list(self.joint_names)}, {clock})"

    @classmethod
    def of(cls, trajectory: Trajectory | TimedTrajectory) -> JointRows:
        """The rows of a trajectory, its joints in the order of the scene.

        With times and velocities if it is timed.
        """
        from qp_twist.following import Trajectory  # and all planners
        from qp_twist.trajectories.time_trajectory import TimedTrajectory

        if isinstance(trajectory, TimedTrajectory):
            run, motion = trajectory.trajectory, trajectory.motion
            metadata = metadata_of(run, trajectory)
            rows = cls(run.joint_names, motion.q, motion.times, motion.velocities, metadata)
            return rows.of_joints(JointRanges.of(run.path_task.shown.model).names)
        if not isinstance(trajectory, Trajectory):
            raise InvalidInput(
                "trajectory: expected a Trajectory, as follow returns it, a TimedTrajectory, or "
                f"what read_trajectory has read; got {type(trajectory).__name__}."
            )
        ranges = JointRanges.of(trajectory.path_task.model)
        metadata = metadata_of(trajectory)
        rows = cls(ranges.names, ranges.positions(trajectory.q), metadata=metadata)
        return rows.of_joints(JointRanges.of(trajectory.path_task.shown.model).names)

    def of_joints(self, names: Sequence[str]) -> JointRows:
        """The rows with the columns of these joints, in this order.

        A joint that is left out has to stand still, and gets a note.

        Raises:
            InvalidInput: If a joint is missing, or one that is left out moves.
        """
        missing = [name for name in names if name not in self.joint_names]
        if missing:
            raise InvalidInput(
                f"the trajectory has no column for {', '.join(missing)}; it has "
                f"{', '.join(self.joint_names)}."
            )
        others = [name for name in self.joint_names if name not in names]
        resting = []
        if others and len(self.q) > 1:
            lowest, highest = self._of(others).motion().extremes()
            travels = highest.max(axis=0) - lowest.min(axis=0)
            resting = [resting_axis(*pair) for pair in zip(others, travels, strict=True)]
        return replace(self._of(names), notes=(*self.notes, *resting))

    def _of(self, names: Sequence[str]) -> JointRows:
        columns = [self.joint_names.index(name) for name in names]
        rates = (self.velocities, self.accelerations)
        velocities, accelerations = (None if x is None else x[:, columns] for x in rates)
        return replace(
            self,
            joint_names=tuple(names),
            q=self.q[:, columns],
            velocities=velocities,
            accelerations=accelerations,
        )

    def motion(self) -> JointMotion:
        """The motion through the rows; without times one row per second."""
        times = np.arange(len(self.q), dtype=np.float64) if self.times is None else self.times
        rates = () if self.times is None else (self.velocities, self.accelerations)
        return JointMotion(times, self.q, *rates)


_CARTESIAN = re.compile(
    r"""((actual|target|desired|commanded|measured)_)?
    (tcp|eef|end_effector|cartesian)
    (_(pose|position|orientation|speed|velocity|force|torque))?
    _([xyz]|r[xyz]|q[wxyz]|roll|pitch|yaw|[0-5])""",
    re.IGNORECASE | re.VERBOSE,
)
"""Names of a component of the tool centre point's pose, speed or force, which no axis has."""


def resting_axis(name: str, travel: float) -> str:
    """A note about an axis that the file has and the robot's model lacks.

    What is named as a component of the tool centre point (``tcp_x``) is no axis, and may change.

    Args:
        name: Of the axis.
        travel: How far it moves, rad or m.

    Raises:
        InvalidInput: If it moves: then the motion is not that of the model.
    """
    if _CARTESIAN.fullmatch(re.sub(r"[\s./:-]+", "_", name)):
        return f"{name} is of the tool centre point, no joint of the robot: not looked at"
    if travel > Tolerances().joint_range:
        raise InvalidInput(
            f"{name} moves by {travel:.4g} (rad or m), but the robot's model has no such joint, so "
            "that the motion cannot be judged. Give a robot that has it; if it is no axis, leave "
            "its column out of the file."
        )
    return f"{name} stands still in the file, and the robot's model has no such joint"
