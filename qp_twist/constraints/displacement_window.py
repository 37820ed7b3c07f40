"""A window around a configuration: how far each joint may move before the next waypoint."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, float_array, number
from qp_twist.constraints.box_limit import BoxLimit, one_by_one
from qp_twist.constraints.constraint import Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges


class DisplacementWindow(BoxLimit, Constraint):
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
        self.ranges = JointRanges.of(model)
        self.names, self.units = self.ranges.names, self.ranges.units
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

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """(θ_ref ∓ w − θ)/dt, rad/s or m/s, each (nv,)."""
        dt = number("dt", dt, above=0.0)
        moved = self.reference - self.ranges.positions(configuration.q)
        # Rounding may leave the joint an ulp outside its window: standing still is always allowed.
        lower = np.minimum((moved - self.half_width) / dt, 0.0)
        upper = np.maximum((moved + self.half_width) / dt, 0.0)
        return lower, upper

    def margins(self, q: Array) -> Array:
        """Distance of each joint from the window's nearer end, rad or m, (N, nv)."""
        margins: Array = self.half_width - np.abs(self.ranges.positions(q) - self.reference)
        return margins

    def gradients(self, q: Array) -> Array:
        """1 below the reference, −1 above it, (N, nv, nv)."""
        return one_by_one(np.where(self.ranges.positions(q) < self.reference, 1.0, -1.0))

    def change(self, q: Array, travel: Array) -> Array:
        """The travel of each joint, (N, nv)."""
        return travel
