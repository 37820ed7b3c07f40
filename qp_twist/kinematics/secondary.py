"""Secondary objectives for the null-space motion: a joint displacement h for one step."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Literal

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import (
    Array,
    Revised,
    checked,
    finite_array,
    float_array,
    instance,
    number,
    one_of,
    read_only,
)
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.joint_ranges import JointRanges

_POWERS = {"gradient": 2, "paper": 1, "natural": 0}
"""Power of W in each form of joint centering."""


class SecondaryObjective(Revised, mink.Task):
    r"""Base of the secondary objectives: a desired displacement **h** of the joints in one step.

    In :class:`~qp_twist.Controller` the null-space motion follows the sum of all objectives' h. As
    a plain :class:`mink.Task` an objective is the soft cost
    :math:`\tfrac12\lVert \mathrm{diag}(cost)\,(\Delta\mathbf q - \mathbf h)\rVert^2`.

    Args:
        model: The robot.
        gain: k in h = k · :meth:`direction`, per step, as mink's and the paper's gains. Unlike in
            mink it may exceed 1, since a direction such as a gradient has its own scale.
        cost: Weight if the objective is used as a plain mink task.
    """

    def __init__(self, model: mujoco.MjModel, gain: float = 1.0, *, cost: float = 1.0) -> None:
        instance("model", model, mujoco.MjModel)
        super().__init__(cost=np.full(model.nv, number("cost", cost, at_least=0.0)))
        self.gain = number("gain", gain, at_least=0.0)
        self.model = model

    @abc.abstractmethod
    def direction(self, configuration: mink.Configuration) -> Array:
        """The desired displacement at gain 1, rad or m, shape (nv,)."""

    def displacement(self, configuration: mink.Configuration) -> Array:
        """h = gain · direction, rad or m, shape (nv,)."""
        return self.gain * self.direction(configuration)

    def compute_error(self, configuration: mink.Configuration) -> Array:
        """−direction: mink's Δq = −gain · error is then h, shape (nv,)."""
        return -self.direction(configuration)

    def compute_jacobian(self, configuration: mink.Configuration) -> Array:
        """The identity: the cost is on the displacement itself, shape (nv, nv)."""
        return np.eye(configuration.model.nv)


class JointCentering(SecondaryObjective):
    r"""Move towards the middle θ̄ of the joint ranges (paper, eq. *z*).

    .. math::

        \mathbf h = k\,\mathbf W^T\mathbf W(\bar\theta - \theta) = -k\nabla z
        \quad(\texttt{"gradient"}), \qquad
        \mathbf h = k\,\mathbf W(\bar\theta - \theta) \quad(\texttt{"paper"}), \qquad
        \mathbf h = k(\bar\theta - \theta) \quad(\texttt{"natural"})

    The paper defines z with WᵀW but steps along W(θ̄ − θ), and calls that −∇z. It is not the
    gradient, but a good direction. ``"natural"`` is −∇z in the metric WᵀW: with that as
    ``Controller(metric=…)`` the QP descends z itself, with a gain below 2: above, the arm
    oscillates. Unlimited joints do not move.

    Example:
        >>> import numpy as np, mink, qp_twist as qt
        >>> model = qt.load_task("planar_line").model
        >>> centering = qt.JointCentering(model, weight="paper")
        >>> at_zero = mink.Configuration(model, np.zeros(3))
        >>> centering.displacement(at_zero)      # W(θ̄ − 0): half of every range
        array([0.5, 0.5, 0.5])
    """

    weight: str = checked(
        lambda _, name, value: one_of(f"JointCentering({name}=…)", value, (*_POWERS,))
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
        return self.stiffness * (self.ranges.middle - self.ranges.positions(configuration.q))

    @property
    def stiffness(self) -> Array:
        """Diagonal of WᵀW, W or 1 in :meth:`direction`; 0 for unlimited joints, shape (nv,)."""
        power = _POWERS[self.weight]
        return np.where(self.ranges.limited, self.ranges.weight**power, 0.0)


class PostureReference(SecondaryObjective):
    r"""Move towards a reference, :math:`\mathbf h = k\,(\mathbf q_{ref} - \mathbf q)`.

    The difference is MuJoCo's, so ball and free joints are handled. Keep the gain small along a
    path: with a gain of 1 a step covers the whole displacement.

    Attributes:
        q_ref: Reference configuration, rad or m, (nq,); read-only, assign another array to change
            it.

    Raises:
        InvalidInput: If ``q_ref`` has the wrong shape or is not finite.
    """

    q_ref: Array = checked(
        lambda objective, name, value: read_only(
            finite_array(f"PostureReference({name}=…)", value, (objective.model.nq,))
        )
    )

    def __init__(
        self, model: mujoco.MjModel, q_ref: npt.ArrayLike, gain: float = 1.0, *, cost: float = 1.0
    ) -> None:
        super().__init__(model, gain, cost=cost)
        self.q_ref = q_ref  # type: ignore[assignment]  # anything is taken, and made an array

    def direction(self, configuration: mink.Configuration) -> Array:
        """q_ref − q in the tangent space, rad or m, shape (nv,)."""
        model, difference = configuration.model, np.empty(configuration.model.nv)
        mujoco.mj_differentiatePos(model, difference, 1.0, configuration.q, self.q_ref)
        return difference


def total_displacement(
    objectives: Sequence[SecondaryObjective], configuration: mink.Configuration
) -> Array:
    """Sum of the objectives' h, shape (nv,); zero for none."""
    total = np.zeros(configuration.model.nv)
    for objective in objectives:
        total += checked_displacement(objective, configuration)
    return total


def checked_displacement(objective: SecondaryObjective, configuration: mink.Configuration) -> Array:
    """h of an objective of any class, shape (nv,); a result of another shape is refused."""
    name, nv = f"{type(objective).__name__}: its displacement", configuration.model.nv
    displacement = float_array(name, objective.displacement(configuration))
    if displacement.shape != (nv,):
        raise InvalidInput(f"{name}: expected shape ({nv},), got {displacement.shape}.")
    return displacement
