"""pink's own step."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following.peer import PeerResolver, peer_module
from qp_twist.following.peer_terms import facing, own_axis
from qp_twist.following.resolver import Displacement
from qp_twist.following.urdf import FRAME, UNLIMITED, chain_urdf
from qp_twist.path import PathTask


class PinkResolver(PeerResolver):
    """``pink.solve_ik``, which reads the robot from URDF."""

    def set_up(self, path_task: PathTask) -> None:
        """A frame task with no cost about the free axis, a posture; the limits of the URDF."""
        self.pin = peer_module("pinocchio", "pin-pink")
        self.pink = peer_module("pink", "pin-pink")
        self.failures = (self.pink.exceptions.PinkError,)
        model = self.pin.buildModelFromXML(chain_urdf(path_task))
        self.robot = self.pink.Configuration(model, model.createData(), path_task.start)
        self.pose = self.pink.FrameTask(
            FRAME, position_cost=self.rows.position(), orientation_cost=self._orientation()
        )
        self.pull = self.pink.PostureTask(cost=self.posture.costs)
        self.pull.set_target(self.posture.target)
        self.own_limits = [self.pink.limits.ConfigurationLimit(model)]
        if self.timed:
            self.speed = self.pink.limits.VelocityLimit(model)
            self.own_limits.append(self.speed)

    def _orientation(self) -> Array:
        """Costs about the frame's own axes, (3,)."""
        axis = self.rows.angular.axis
        if axis is None:
            return np.full(3, 1.0 if self.rows.angular.rank else 0.0)
        own = None if self.rows.projector.frame == "world" else own_axis(axis)
        if own is None:
            raise InvalidInput(
                f"follow({self.method.name!r}): pink weighs orientations about the frame's own "
                "axes, and the free axis is none of these; use one of the QPs of this package."
            )
        orientation = np.ones(3)
        orientation[own] = 0.0
        return orientation

    def step(self, configuration: mink.Configuration, gain: float) -> Displacement:
        """One call of ``pink.solve_ik`` over the time of the waypoint."""
        self.robot.update(configuration.q)
        goal = facing(configuration, self.task, self.rows)
        self.pose.set_target(self.pin.SE3(goal.rotation().as_matrix(), goal.translation()))
        if self.timed:
            self.speed.velocity_limit = np.minimum(self.limits.speeds(configuration), UNLIMITED)
        self.pull.gain = gain
        dt = self.limits.dt
        velocity = self.pink.solve_ik(
            self.robot, [self.pose, self.pull], dt, self.solver, limits=self.own_limits,
            safety_break=False, **self.solver_settings,
        )  # fmt: skip
        return Displacement(velocity * dt)
