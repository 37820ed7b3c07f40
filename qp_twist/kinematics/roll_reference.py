"""Draw the free roll of a task to the one of its target."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, number
from qp_twist.geometry import ProjectorKind, twist_angle
from qp_twist.kinematics.secondary import SecondaryObjective
from qp_twist.kinematics.twist_task import TwistTask, frames_of, jacobian_of

_SINGULAR = 1e-2
"""Singular values of J below this share of the largest do not count."""


class RollReference(SecondaryObjective):
    r"""Turn the frame about the axis a that the task leaves free, to the roll of the target.

    .. math:: \mathbf h = -k\,\mathbf J^{+} \begin{bmatrix} \mathbf 0 \\ \varphi\,\mathbf a
        \end{bmatrix}

    φ is the roll of the frame against the target (:class:`~qp_twist.RollBand`), at most ``longest``
    to either side. The joints keep the task to first order. A task whose angular block leaves no
    single axis free has h = 0.

    Args:
        model: The robot.
        task: The task whose target has the roll.
        gain: k; at 1 a step turns all the way.
        longest: Largest turn of a step at gain 1, rad.
        cost: Weight if it is used as a plain mink task.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        task: TwistTask,
        gain: float = 1.0,
        *,
        longest: float = np.pi,
        cost: float = 1.0,
    ) -> None:
        super().__init__(model, gain, cost=cost)
        self.task = task
        self.longest = number("longest", longest, above=0.0)

    def direction(self, configuration: mink.Configuration) -> Array:
        """h at gain 1, shape (nv,)."""
        angular, pair = self.task.projector.angular, frames_of(self.task, configuration)
        if angular.kind is not ProjectorKind.PLANE or angular.axis is None:
            return np.zeros(configuration.model.nv)
        a = pair.axes(self.task.projector.frame) @ angular.axis
        roll = np.clip(twist_angle(pair.error, a), -self.longest, self.longest)
        inverse = np.linalg.pinv(jacobian_of(self.task, configuration), rcond=_SINGULAR)
        return np.asarray(-inverse[:, 3:] @ (roll * a))
