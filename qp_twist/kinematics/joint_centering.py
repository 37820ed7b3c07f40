"""Stay near the middle of the joint ranges: the paper's secondary objective."""

from __future__ import annotations

from typing import Literal

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, checked, one_of
from qp_twist.kinematics.joint_ranges import JointRanges
from qp_twist.kinematics.secondary import SecondaryObjective


class JointCentering(SecondaryObjective):
    r"""Move towards the middle θ̄ of the joint ranges (paper, eq. *z*).

    .. math::

        \mathbf h = k\,\mathbf W^T\mathbf W(\bar\theta - \theta) = -k\nabla z
        \quad(\texttt{"gradient"}), \qquad
        \mathbf h = k\,\mathbf W(\bar\theta - \theta) \quad(\texttt{"paper"}), \qquad
        \mathbf h = k(\bar\theta - \theta) \quad(\texttt{"natural"})

    The paper defines z with WᵀW but steps along W(θ̄ − θ), and calls that −∇z. It is not the
    gradient, but a good direction: both are available. ``"natural"`` is −∇z in the metric WᵀW: with
    ``Controller(metric=…)`` set to the diagonal of WᵀW the QP then descends z itself. Unlimited
    joints do not move.

    Keep the gain of ``"natural"`` below 2: above, a step overshoots, and the arm oscillates.

    Example:
        >>> import numpy as np, mink, qp_twist as qt
        >>> model = qt.load_task("planar_line").model
        >>> centering = qt.JointCentering(model, weight="paper")
        >>> at_zero = mink.Configuration(model, np.zeros(3))
        >>> centering.displacement(at_zero)      # W(θ̄ − 0): half of every range
        array([0.5, 0.5, 0.5])
    """

    weight: str = checked(
        lambda _, name, value: one_of(
            f"JointCentering({name}=…)", value, ("gradient", "paper", "natural")
        )
    )

    def __init__(
        self,
        model: mujoco.MjModel,
        weight: Literal["gradient", "paper", "natural"] = "gradient",
        gain: float = 1.0,
        *,
        cost: float = 1.0,
    ) -> None:
        super().__init__(model, gain, cost=cost)
        self.weight = weight
        self.ranges = JointRanges.of(model)

    def direction(self, configuration: mink.Configuration) -> Array:
        """WᵀW(θ̄ − θ), W(θ̄ − θ) or θ̄ − θ, shape (nv,)."""
        offset = self.ranges.middle - self.ranges.positions(configuration.q)
        return self.stiffness * offset

    @property
    def stiffness(self) -> Array:
        """Diagonal of WᵀW, W or 1 in :meth:`direction`; 0 for unlimited joints, shape (nv,)."""
        power = {"gradient": 2, "paper": 1, "natural": 0}[self.weight]
        stiffness: Array = np.where(self.ranges.limited, self.ranges.weight**power, 0.0)
        return stiffness
