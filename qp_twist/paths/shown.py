"""A task's scene as it stands, for pictures: there a path may lie on a body that moves."""

from __future__ import annotations

from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges


@dataclass(frozen=True, eq=False)
class Shown:
    """What a picture of a task shows.

    Attributes:
        model: The scene as it stands.
        start: The task's start as a configuration of that model, (nq,).
        positions: The path in the scene's world while the robot is at its start, m, (N, 3).
        carrier: Name of the body that carries the path; ``None`` for a path in the world.
        order: Index in the task's q of each coordinate of the model's q, (nq,).
        joint_moves: Indices of the waypoints that a joint move leads to.
    """

    model: mujoco.MjModel
    start: Array
    positions: Array
    carrier: str | None
    order: Indices
    joint_moves: tuple[int, ...] = ()

    @classmethod
    def of(
        cls,
        scene: mujoco.MjModel,
        carrier: str,
        model: mujoco.MjModel,
        start: Array,
        path: Array,
        joint_moves: tuple[int, ...] = (),
    ) -> Shown:
        """The scene of a path that lies on a body.

        Args:
            scene: The scene as it stands.
            carrier: Name of the body.
            model: The scene as seen from the body, in which the path is planned.
            start: A configuration of that model, (nq,).
            path: Positions in the body's frame, m, (N, 3).
            joint_moves: Indices of the waypoints that a joint move leads to.
        """
        own = {name: k for k, name in enumerate(JointRanges.of(model).names)}
        order = np.array([own[name] for name in JointRanges.of(scene).names], dtype=np.intp)
        still = cls(scene, start[order], path, carrier, order)
        pose = still.carrier_pose(start)
        turned = path @ pose.rotation().as_matrix().T + pose.translation()
        return cls(scene, still.start, turned, carrier, order, joint_moves)

    def configurations(self, q: Array) -> Array:
        """Configurations (…, nq) of the task as those of the scene's model, (…, nq)."""
        found: Array = q[..., self.order]
        return found

    def carrier_pose(self, q: Array) -> mink.SE3:
        """Pose of the path's frame in the scene's world at a configuration q (nq,) of the task."""
        if self.carrier is None:
            return mink.SE3.identity()
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.configurations(q)
        mujoco.mj_kinematics(self.model, data)
        body = data.body(self.carrier)
        return mink.SE3.from_rotation_and_translation(mink.SO3(body.xquat.copy()), body.xpos.copy())
