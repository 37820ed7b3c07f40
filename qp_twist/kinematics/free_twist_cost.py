"""The cost on the twist that the task leaves free: (1 − T)(J Δq − J h)."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.checks import Array, instance, number
from qp_twist.kinematics.secondary import SecondaryObjective, total_displacement
from qp_twist.kinematics.twist_task import TwistTask


class FreeTwistCost(mink.Task):
    r"""The paper's secondary term as a quadratic cost in twist space (paper, eq. *liguo*).

    .. math::

        \tfrac12 \lVert (\mathbf 1-\mathbf T)(\mathbf J\Delta\mathbf q - \mathbf J\mathbf h)
        \rVert_{\mathbf w}^2

    A :class:`mink.Task` with 6 − r rows VᵀJ, where V spans the range of 1 − T. Beside its
    :class:`~qp_twist.TwistTask` as an equality it makes the QP whose solution, while no limit is
    active, is J†TΔt + J†(1 − T)Jh for a regular square J.

    Args:
        task: The task whose complement 1 − T is used.
        objectives: The secondary objectives whose h is followed; none for zero free twist.
        linear_cost: Square root of w for the linear rows, 1/m.
        angular_cost: Square root of w for the angular rows, 1/rad.

    Raises:
        InvalidInput: If ``task`` is not a TwistTask or a cost is negative.
    """

    def __init__(
        self,
        task: TwistTask,
        objectives: Sequence[SecondaryObjective] = (),
        *,
        linear_cost: float = 1.0,
        angular_cost: float = 1.0,
    ) -> None:
        instance("FreeTwistCost(task=…)", task, TwistTask)
        instance("FreeTwistCost(objectives=…)", objectives, Sequence)
        for objective in objectives:
            instance("FreeTwistCost(objectives=…)", objective, SecondaryObjective)
        free = task.projector.complement
        cost = np.concatenate(
            [
                np.full(free.linear.rank, number("linear_cost", linear_cost, at_least=0.0)),
                np.full(free.angular.rank, number("angular_cost", angular_cost, at_least=0.0)),
            ]
        )
        super().__init__(cost=cost)
        self.task = task
        self.objectives = tuple(objectives)

    def compute_jacobian(self, configuration: mink.Configuration) -> Array:
        """VᵀJ, shape (6 − r, nv)."""
        state = self.task.state(configuration)
        return state.projector.complement.basis.T @ state.jacobian

    def compute_error(self, configuration: mink.Configuration) -> Array:
        """−VᵀJh, shape (6 − r,)."""
        rows = self.compute_jacobian(configuration)
        return -rows @ total_displacement(self.objectives, configuration)
