"""Stay near a given posture."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, checked, finite_array, read_only
from qp_twist.kinematics.secondary import SecondaryObjective


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
        difference = np.empty(configuration.model.nv)
        mujoco.mj_differentiatePos(
            configuration.model, difference, 1.0, configuration.q, self.q_ref
        )
        return difference
