"""A disturbance: a wrench on a body for a while."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, number


class Push:
    """A constant wrench on a body, at its centre of mass, in world axes.

    Attributes:
        body: Name of the body.
        wrench: Force and torque (linear, angular), N and N m, (6,).
        start: Time at which it begins, on the loop's clock, s.
        end: Time at which it ends, s.
    """

    def __init__(
        self,
        body: str,
        *,
        force: npt.ArrayLike = (0.0, 0.0, 0.0),
        torque: npt.ArrayLike = (0.0, 0.0, 0.0),
        start: float,
        duration: float = 0.2,
    ) -> None:
        """Define a push.

        Args:
            body: Name of the body; the loop refuses one that the plant does not have.
            force: Force, N, world axes, (3,).
            torque: Torque, N m, world axes, (3,).
            start: Time at which it begins, s.
            duration: Duration, s.

        Raises:
            InvalidInput: If a number is not finite, or ``duration`` not above 0.
        """
        self.body = body
        self.wrench: Array = np.concatenate(
            [finite_array("force", force, (3,)), finite_array("torque", torque, (3,))]
        )
        self.start = number("start", start)
        self.end = self.start + number("duration", duration, above=0.0)

    def acts(self, time: float) -> bool:
        """Whether it acts in a simulation step that begins at ``time``, s."""
        return self.start <= time + 1e-9 < self.end
