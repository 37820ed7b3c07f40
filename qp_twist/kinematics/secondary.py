"""Secondary objectives for the null-space motion: a joint displacement h for one step."""

from __future__ import annotations

import abc
from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, float_array, instance, number
from qp_twist.errors import InvalidInput


class SecondaryObjective(mink.Task):
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


def total_displacement(
    objectives: Sequence[SecondaryObjective], configuration: mink.Configuration
) -> Array:
    """Sum of the objectives' h, shape (nv,); zero for none."""
    total = np.zeros(configuration.model.nv)
    for objective in objectives:
        total += checked_displacement(objective, configuration)
    return total


def checked_displacement(objective: SecondaryObjective, configuration: mink.Configuration) -> Array:
    """h of an objective of any class, checked, shape (nv,).

    Raises:
        InvalidInput: If it is not such an array.
    """
    name, nv = f"{type(objective).__name__}: its displacement", configuration.model.nv
    displacement = float_array(name, objective.displacement(configuration))
    if displacement.shape != (nv,):
        raise InvalidInput(f"{name}: expected shape ({nv},), got {displacement.shape}.")
    return displacement
