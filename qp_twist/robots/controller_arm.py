"""An arm as its controller sees it: base and flange, poses of the tool, joints at a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.parametrised_arm import ParametrisedArm
from qp_twist.robots.configurations import angles_of, configuration, has_configuration
from qp_twist.robots.known_robots import KnownRobot
from qp_twist.robots.tool_chain import Poses, ToolChain, se3

FLANGES: dict[str, tuple[Sequence[float], bool]] = {
    "rapid": ((0.0, 90.0, 0.0), False),
    "krl": ((0.0, 90.0, 0.0), False),
    "ls": ((180.0, -90.0, 0.0), True),
    "urscript": ((90.0, 0.0, 0.0), False),
}
"""By language: the flange in the base where the controller shows zero for all axes, as roll, pitch,
yaw, degrees, and whether the base's origin is at the height of the second axis: ``tool0`` and
``base`` of ros-industrial's abb, kuka_experimental and fanuc; of Universal Robots the last frame of
Denavit and Hartenberg's parameters. The flange's origin is the point of the last axis in the table.
"""


@dataclass(frozen=True, eq=False)
class ControllerArm:
    """A known robot in a model.

    Attributes:
        robot: The robot.
        tool: The chain of the task's frame.
        signs: s of θ = s q + o, in the order of the chain, (6,).
        offsets: o, rad, (6,).
        base: The controller's base in the world.
        tool_in_flange: The task's frame in the controller's flange.
    """

    robot: KnownRobot
    tool: ToolChain
    signs: Array
    offsets: Array
    base: mink.SE3
    tool_in_flange: mink.SE3

    @classmethod
    def of(
        cls, robot: KnownRobot, tool: ToolChain, signs: Array, offsets: Array
    ) -> ControllerArm | None:
        r"""The arm whose axes are best those of the robot.

        At θ = 0 the rotation turns the directions of the robot's axes into those of the model's
        (least squares; Kabsch 1976), and the origin is where

        .. math:: \textstyle\sum_i (1 - \mathbf a_i \mathbf a_i^T)
            (\mathbf R \mathbf p_i + \mathbf t - \mathbf m_i) = 0

        with the points p of the robot's axes, and directions a and points m of the model's.
        ``None`` for a robot whose language has no flange here.
        """
        from scipy.spatial.transform import Rotation  # imported on demand: 0.1 s

        if robot.program not in FLANGES or len(robot.lines) != len(signs):
            return None
        (roll, pitch, yaw), raised = FLANGES[robot.program]
        zero = (-signs * offsets)[None]
        axes = tool.axes(zero)
        directions = signs[:, None] * np.array([axis[0] for axis, _ in axes])
        turn, _ = Rotation.align_vectors(directions, np.array([x.axis for x in robot.lines]))
        across = np.eye(3) - directions[:, :, None] * directions[:, None]
        pairs = zip(axes, robot.lines, strict=True)
        apart = np.array([point[0] - turn.apply(line.point) for (_, point), line in pairs])
        move = np.linalg.solve(across.sum(axis=0), (across @ apart[..., None]).sum(axis=0)[:, 0])
        root = se3(turn.as_matrix(), move)
        flange = root @ se3(
            Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix(),
            robot.lines[-1].point,
        )
        height = np.array([0.0, 0.0, robot.lines[1].point[2] if raised else 0.0])
        now = tool.poses(zero)
        own = flange.inverse() @ se3(now.rotations[0], now.positions[0])
        return cls(robot, tool, signs, offsets, root @ se3(np.eye(3), height), own)

    def theta(self, q: Array) -> Array:
        """θ at joint positions q (…, 6) of the chain, rad."""
        return self.signs * q + self.offsets

    def configuration(self, q: Array) -> tuple[int, ...]:
        """The configuration data at joint positions q (6,).

        Raises:
            InvalidInput: If no rule is known for the robot.
        """
        return configuration(self.robot, self.theta(q))

    def check_configuration(self, q: Array, data: Sequence[int]) -> None:
        """Refuse joint positions q (6,) at which a controller shows other configuration data.

        Raises:
            InvalidInput: With both.
        """
        if not has_configuration(self.robot, self.theta(q), data):
            raise InvalidInput(
                f"the robot arrives with the configuration {list(self.configuration(q))}, and the "
                f"program states {list(data)}."
            )

    def joints_at(self, pose: mink.SE3, data: Sequence[int], near: Array | None = None) -> Array:
        """Joint positions (6,) at a pose of the task's frame in the world, by configuration data.

        ``near`` (6,) decides what the data leave open.

        Raises:
            InvalidInput: If there are none, or several.
        """
        if self._closed_form is None:
            raise InvalidInput(
                f"the {self.robot.name} of this model has no closed form of its inverse kinematics."
            )
        arm = self._closed_form
        R, p = pose.rotation().as_matrix()[None], pose.translation()[None]
        given = np.zeros((1, len(arm.parameters)))
        found = arm.branches(R, p, given)[0][:, list(self.tool.chain.qpos)]
        found = found[np.isfinite(found).all(axis=1)]
        if not arm.exact:
            corrected = [self.tool.beside(q[None], Poses(R, p)) for q in found]
            found = np.array([q[0] for q in corrected if q is not None]).reshape(-1, 6)
        theta = None if near is None else self.theta(near)
        angles = angles_of(self.robot, self.theta(found), data, theta)
        return (angles - self.offsets) * self.signs

    @cached_property
    def _closed_form(self) -> ParametrisedArm | None:
        return next(iter(ParametrisedArm.recognise(self.tool.chain)), None)

    def world_pose(self, pose: mink.SE3, tool: mink.SE3 | None, frame: mink.SE3 | None) -> mink.SE3:
        """The pose of the task's frame in the world at which a program's tool has a pose.

        ``tool`` in the flange and ``frame`` in the base as the program states them; ``None``: the
        tool is the task's frame, the frame is the world.
        """
        at = pose if frame is None else self.base @ frame @ pose
        return at if tool is None else at @ tool.inverse() @ self.tool_in_flange
