"""placo's own step."""

from __future__ import annotations

from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.controller import Status
from qp_twist.following.peer import PeerResolver, peer_module
from qp_twist.following.resolver import Displacement
from qp_twist.following.urdf import FRAME, UNLIMITED, chain_urdf
from qp_twist.geometry import Projector, ProjectorKind
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask

KEPT = {ProjectorKind.FULL: "xyz", ProjectorKind.PLANE: "xy", ProjectorKind.LINE: "z"}
"""The axes that a block keeps, where its own is z."""
SCALE_ROUNDING = 1e-6
"""A share of the task that is short of one by less than this is placo's rounding."""


class PlacoResolver(PeerResolver):
    """``placo.KinematicsSolver``, the task either hard or scaled; it reads the robot from URDF.

    It has its own QP solver. A hard task that does not fit raises; of a scaled one it meets the
    share that it reports.
    """

    def set_up(self, path_task: PathTask) -> None:
        """Tasks of position and orientation at one priority, a posture below; limits of the URDF.

        placo weighs squares: a weight is a cost squared.
        """
        placo = peer_module("placo", "placo")
        self.failures = (RuntimeError,)
        self.scaled = self.method.name == "placo_scaled"
        priority = "scaled" if self.scaled else "hard"
        self.robot: Any = placo.RobotWrapper(
            "", placo.Flags.ignore_collisions, chain_urdf(path_task)
        )
        self.placo: Any = self.robot.make_solver()
        self.placo.mask_fbase(True)
        self.placo.enable_joint_limits(True)
        self.placo.enable_velocity_limits(self.timed)
        self.names = JointRanges.of(path_task.model).names
        # Rows in which the robot cannot move are dependent: placo refuses them in a hard task.
        linear, angular = self.rows.minimal.linear, self.rows.minimal.angular
        self.place: Any = None
        if linear.rank:
            self.place = self.placo.add_position_task(FRAME, np.zeros(3))
            self.place.mask.set_axises(KEPT[linear.kind], "custom")
            self.place.configure("position", priority, 1.0)
        self.turn: Any = None
        if angular.kind is ProjectorKind.PLANE:
            self.turn = self.placo.add_axisalign_task(FRAME, np.eye(3)[2], np.eye(3)[2])
        elif angular.rank:
            self.turn = self.placo.add_orientation_task(FRAME, np.eye(3))
            self.turn.mask.set_axises(KEPT[angular.kind], "custom")
        if self.turn is not None:
            self.turn.configure("orientation", priority, 1.0)
        self.pull = []
        for name, cost in zip(self.names, self.posture.costs, strict=True):
            joint = self.placo.add_joints_task()
            joint.set_joint(name, 0.0)
            joint.configure(f"posture of {name}", "soft", float(cost) ** 2)
            self.pull.append(joint)

    def step(self, configuration: mink.Configuration, gain: float) -> Displacement:
        """One call of ``KinematicsSolver.solve`` over the time of the waypoint."""
        q, target = configuration.q, self.task.target
        assert target is not None
        for name, joint, here, there in zip(
            self.names, self.pull, q, self.posture.target, strict=True
        ):
            self.robot.set_joint(name, float(here))
            joint.set_joint(name, float(here + gain * (there - here)))
        if self.timed:
            for name, speed in zip(self.names, self.limits.speeds(configuration), strict=True):
                self.robot.set_velocity_limit(name, float(min(speed, UNLIMITED)))
        self.robot.update_kinematics()
        rotation = target.rotation().as_matrix()
        body = configuration.get_transform_frame_to_world(
            self.task.frame_name, self.task.frame_type
        )
        world = self.rows.minimal.in_world(body.rotation().as_matrix(), rotation)
        if self.place is not None:
            self.place.target_world = target.translation()
            self.place.mask.R_custom_world = axes(world.linear)
        if world.angular.kind is ProjectorKind.PLANE:
            self.turn.axis_frame, self.turn.targetAxis_world = self.rows.axis(rotation)
        elif self.turn is not None:
            self.turn.R_world_frame = rotation
            self.turn.mask.R_custom_world = axes(world.angular)
        self.placo.dt = self.limits.dt
        self.placo.solve(True)
        dq = np.array([self.robot.get_joint(name) for name in self.names]) - q
        scale = float(self.placo.scale) if self.scaled else 1.0
        status = Status.SCALED if scale < 1.0 - SCALE_ROUNDING else Status.SOLVED
        return Displacement(dq, scale if status is Status.SCALED else 1.0, (), status)


def axes(block: Projector) -> Array:
    """Rotation (3, 3) from the world to axes of which :data:`KEPT` names those of a block."""
    if block.axis is None:
        return np.eye(3)
    z = block.axis
    x = Projector.plane(z).basis[:, 0]
    return np.array([x, np.cross(z, x), z])
