"""A task's scene as it stands, for pictures: there a path may lie on a body that moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges

if TYPE_CHECKING:
    from qp_twist.paths.path_task import PathTask


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
    def of(cls, task: PathTask) -> Shown:
        """What a picture of a task shows."""
        if task.relative_to is None or task.scene_model is None:
            order = np.arange(task.model.nq)
            return cls(task.model, task.start, task.positions, None, order, task.joint_moves)
        scene, carrier = task.scene_model, task.relative_to
        own = {name: k for k, name in enumerate(JointRanges.of(task.model).names)}
        order = np.array([own[name] for name in JointRanges.of(scene).names], dtype=np.intp)
        still = cls(scene, task.start[order], task.positions, carrier, order, task.joint_moves)
        pose = still.carrier_pose(task.start)
        turned = task.positions @ pose.rotation().as_matrix().T + pose.translation()
        return replace(still, positions=turned)

    def configurations(self, q: Array) -> Array:
        """Configurations (…, nq) of the task as those of the scene's model, (…, nq)."""
        return q[..., self.order]

    def carrier_pose(self, q: Array) -> mink.SE3:
        """Pose of the path's frame in the scene's world at a configuration q (nq,) of the task."""
        if self.carrier is None:
            return mink.SE3.identity()
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.configurations(q)
        mujoco.mj_kinematics(self.model, data)
        body = data.body(self.carrier)
        return mink.SE3.from_rotation_and_translation(mink.SO3(body.xquat.copy()), body.xpos.copy())
