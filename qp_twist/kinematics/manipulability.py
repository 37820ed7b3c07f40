"""Stay away from singularities of the task."""

from __future__ import annotations

from collections.abc import Iterator

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, instance, number
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.frame import body_of, frame_id, frame_pose
from qp_twist.kinematics.secondary import SecondaryObjective
from qp_twist.kinematics.twist_task import TwistTask


class Manipulability(SecondaryObjective):
    r"""Climb the logarithm of the manipulability of a task's rows.

    .. math::

        \mathbf h = k \nabla_q \log\det(\mathbf J_T \mathbf J_T^T), \qquad
        \mathbf J_T = \mathbf U^T\mathbf J, \qquad
        \frac{\partial}{\partial q_i} = 2\,\mathrm{tr}\!\left(
            \mathbf J_T^{+}\,\frac{\partial \mathbf J_T}{\partial q_i}\right)

    The derivative of J is MuJoCo's ``mj_jacDot`` along each joint; that of a basis fixed to the
    body is exact. The determinant is the square of Yoshikawa's measure (1985), for the task's rows
    only. Near a singularity the gradient is unbounded, so the displacement at gain 1 is clamped to
    the length ``longest``, rad.

    Raises:
        InvalidInput: If the task has no rows, or more rows than the robot has joints.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        task: TwistTask,
        gain: float = 1.0,
        *,
        longest: float = 1.0,
        cost: float = 1.0,
    ) -> None:
        super().__init__(model, gain, cost=cost)
        instance("task", task, TwistTask)
        frame_id(model, task.frame_name, task.frame_type)
        if not 0 < task.projector.rank <= model.nv:
            raise InvalidInput(
                f"Manipulability: the task has {task.projector.rank} rows and the robot {model.nv} "
                "degrees of freedom; the measure needs between 1 row and as many as there are."
            )
        self.task = task
        self.longest = number("longest", longest, above=0.0)
        self._scratch = mujoco.MjData(model)

    def measure(self, configuration: mink.Configuration) -> float:
        """log det(J_T J_Tᵀ); −∞ at a singularity."""
        state = self.task.state(configuration)
        singular_values = np.linalg.svd(state.basis.T @ state.jacobian, compute_uv=False)
        with np.errstate(divide="ignore"):
            return float(2.0 * np.sum(np.log(singular_values)))

    def gradient(self, configuration: mink.Configuration) -> Array:
        """∇ log det(J_T J_Tᵀ), 1/rad, shape (nv,)."""
        state, nv = self.task.state(configuration), configuration.model.nv
        inverse = np.linalg.pinv(state.basis.T @ state.jacobian)
        blocks = state.jacobian.reshape(2, 3, nv)
        gradient = np.empty(nv)
        for i, moved in enumerate(self._jacobian_derivatives(configuration)):
            turned = np.zeros((6, nv))
            if self.task.projector.frame == "body":
                # UᵀJ with U = R U_b: its derivative is Uᵀ(J̇ − [ω]× J) for both blocks.
                turned = np.cross(blocks[1, :, i], blocks, axisb=1, axisc=1).reshape(6, nv)
            gradient[i] = 2.0 * np.trace(inverse @ (state.basis.T @ (moved - turned)))
        return gradient

    def direction(self, configuration: mink.Configuration) -> Array:
        """The gradient, no longer than ``longest``, shape (nv,)."""
        gradient = self.gradient(configuration)
        length = float(np.linalg.norm(gradient))
        return gradient if length <= self.longest else gradient * (self.longest / length)

    def _jacobian_derivatives(self, configuration: mink.Configuration) -> Iterator[Array]:
        """∂J/∂q_i of the task's frame, world axes, (6, nv) for each degree of freedom i."""
        model, data = configuration.model, self._scratch
        frame = self.task.frame_name, self.task.frame_type
        _, position = frame_pose(configuration, *frame)
        data.qpos[:] = configuration.q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        J, body = np.empty((6, model.nv)), body_of(model, *frame)
        for direction in np.eye(model.nv):
            data.qvel[:] = direction
            mujoco.mj_comVel(model, data)
            mujoco.mj_jacDot(model, data, J[:3], J[3:], position, body)
            yield J
