"""Contents of a trajectory file: rows of joint positions, by joint name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.referee import JointMotion
from qp_twist.trajectories.metadata import metadata_of
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
        accelerated: Whether the file has accelerations, too. They are not used: joints move on
            cubics here; a controller that uses accelerations interpolates differently.
        notes: What else the file has, and what of it is not looked at.
        sources: Whose figures the positions depend on, e.g. the zero positions of a known robot.
    """

    joint_names: tuple[str, ...]
    q: Array
    times: Array | None = None
    velocities: Array | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    accelerated: bool = False
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.joint_names)
        if len(set(self.joint_names)) < count:
            raise InvalidInput(f"joint_names: a name stands twice in {list(self.joint_names)}.")
        finite_array("q", self.q, (None, count))
        if self.times is not None:
            finite_array("times", self.times, (len(self.q),))
        if self.velocities is not None:
            finite_array("velocities", self.velocities, self.q.shape)

    def __repr__(self) -> str:
        clock = "untimed" if self.times is None else f"{self.times[-1] - self.times[0]:.6g} s"
        return f"JointRows({len(self.q)} rows of {list(self.joint_names)}, {clock})"

    @classmethod
    def of(cls, trajectory: Trajectory | TimedTrajectory) -> JointRows:
        """The rows of a trajectory, its joints in the order of the scene.

        With times and velocities if it is timed.
        """
        if isinstance(trajectory, TimedTrajectory):
            metadata = metadata_of(trajectory)
            run, motion = trajectory.trajectory, trajectory.motion
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

        Raises:
            InvalidInput: If a joint is missing.
        """
        missing = [name for name in names if name not in self.joint_names]
        if missing:
            raise InvalidInput(
                f"the trajectory has no column for {', '.join(missing)}; it has "
                f"{', '.join(self.joint_names)}."
            )
        columns = [self.joint_names.index(name) for name in names]
        return replace(
            self,
            joint_names=tuple(names),
            q=self.q[:, columns],
            velocities=None if self.velocities is None else self.velocities[:, columns],
        )

    def motion(self) -> JointMotion:
        """The motion through the rows; without times one row per second."""
        times = np.arange(len(self.q), dtype=np.float64) if self.times is None else self.times
        return JointMotion(times, self.q, None if self.times is None else self.velocities)
