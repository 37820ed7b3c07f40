"""A window around a configuration: how far each joint may move before the next waypoint."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, float_array, number
from qp_twist.constraints.position_limit import JointRangeLimit
from qp_twist.errors import InvalidInput


class DisplacementWindow(JointRangeLimit):
    r"""Keep :math:`|\theta - \theta_{ref}| \le w` for each joint.

    With w = v_max · Δt it is the velocity limit for a whole waypoint: all iterations of a waypoint
    together move a joint by at most w.
    """

    kind = "velocity"

    def __init__(
        self, model: mujoco.MjModel, q_ref: npt.ArrayLike, half_width: npt.ArrayLike
    ) -> None:
        """Open the window.

        Args:
            model: The robot.
            q_ref: Configuration at the last waypoint, shape (nq,).
            half_width: w for each degree of freedom, rad or m, shape (nv,); ``inf`` for no limit.

        Raises:
            InvalidInput: If a shape is wrong or a width is negative or NaN.
        """
        super().__init__(model)
        self._nq = model.nq
        self.move(q_ref, half_width)

    def move(self, q_ref: npt.ArrayLike, half_width: npt.ArrayLike) -> None:
        """Move the window to ``q_ref``, for the next waypoint; arguments as above."""
        self.reference = self.ranges.positions(finite_array("q_ref", q_ref, (self._nq,)))
        self.half_width = float_array("half_width", half_width)
        if self.half_width.shape != self.reference.shape or not (self.half_width >= 0.0).all():
            raise InvalidInput(
                f"DisplacementWindow: half_width needs {len(self.reference)} numbers of at least "
                f"0, got {half_width!r}."
            )
        self.lower = self.reference - self.half_width
        self.upper = self.reference + self.half_width

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """(θ_ref ∓ w − θ)/dt, rad/s or m/s, each (nv,)."""
        below, above = self._room(configuration.q) / number("dt", dt, above=0.0)
        # Rounding may leave the joint an ulp outside its window: standing still is always allowed.
        return np.minimum(-below, 0.0), np.maximum(above, 0.0)
