"""mink's own step."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.following.peer import PeerResolver
from qp_twist.following.peer_terms import Posture, facing
from qp_twist.following.resolver import Displacement
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask


class MinkResolver(PeerResolver):
    """``mink.solve_ik`` with mink's own tasks and limits."""

    failures = (mink.MinkError,)

    def set_up(self, path_task: PathTask) -> None:
        """A frame task, an axis to align, a posture; limits of position and velocity."""
        frame = (path_task.frame_name, path_task.frame_type)
        angular = self.rows.angular.kind
        whole = 1.0 if angular is ProjectorKind.FULL else 0.0
        self.pose = mink.FrameTask(
            *frame, position_cost=self.rows.position(), orientation_cost=whole
        )
        self.tasks: list[mink.Task] = [self.pose]
        self.align: mink.AxisAlignTask | None = None
        if angular is ProjectorKind.PLANE:
            self.align = mink.AxisAlignTask(*frame, cost=1.0)
            self.tasks.append(self.align)
        self.pull = mink_posture(path_task, self.posture)
        self.own_limits = mink_limits(path_task)
        speeds = [limit for limit in self.own_limits if isinstance(limit, mink.VelocityLimit)]
        self.speed = speeds[0] if speeds else None

    def step(self, configuration: mink.Configuration, gain: float) -> Displacement:
        """One call of ``mink.solve_ik`` over the time of the waypoint."""
        self.pose.set_target(facing(configuration, self.task, self.rows))
        if self.align is not None:
            assert self.task.target is not None
            axis, direction = self.rows.axis(self.task.target.rotation().as_matrix())
            self.align.set_axis(axis)
            self.align.set_target(direction)
        if self.speed is not None:
            self.speed.limit = self.limits.speeds(configuration)[self.speed.indices]
        self.pull.gain = gain
        dt = self.limits.dt
        velocity = mink.solve_ik(
            configuration, [*self.tasks, self.pull], dt, self.solver, limits=self.own_limits,
            **self.solver_settings,
        )  # fmt: skip
        return Displacement(velocity * dt)


def mink_posture(path_task: PathTask, posture: Posture) -> mink.PostureTask:
    """The posture as a task of mink."""
    task = mink.PostureTask(path_task.model, cost=posture.costs, gain=posture.gain)
    task.set_target(posture.target)
    return task


def mink_limits(path_task: PathTask) -> list[mink.Limit]:
    """Limits of mink: the joint ranges and, on a timed path, the speeds that the task states.

    It has none of acceleration.
    """
    model, speeds = path_task.model, path_task.velocity_limits
    limits: list[mink.Limit] = [mink.ConfigurationLimit(model)]
    if path_task.durations is not None and np.isfinite(speeds).any():
        names = JointRanges.of(model).names
        limits.append(
            mink.VelocityLimit(
                model,
                {n: float(s) for n, s in zip(names, speeds, strict=True) if np.isfinite(s)},
            )
        )
    return limits
