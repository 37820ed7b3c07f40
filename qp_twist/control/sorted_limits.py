"""The limits of a controller by kind, and what the joints may do at most."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.checks import Array, largest
from qp_twist.constraints import BoxLimit, Clearance, MotionLimit


class SortedLimits:
    """Limits, and those of three kinds among them.

    Attributes:
        limits: All of them.
        clearances: The clearances.
        motions: The limits of velocity and acceleration.
    """

    def __init__(self, limits: Sequence[mink.Limit]) -> None:
        """Sort the limits."""
        self.limits = list(limits)
        self.clearances = [limit for limit in limits if isinstance(limit, Clearance)]
        self.motions = [limit for limit in limits if isinstance(limit, MotionLimit)]
        self._following = [
            v for v in limits if isinstance(v, BoxLimit) and type(v).note is not BoxLimit.note
        ]

    def note(self, velocity: Array) -> None:
        """Store the joint velocity (nv,) in the limits that have to know it."""
        for limit in self._following:
            if type(limit) is MotionLimit:  # its own method checks it once more
                limit.__dict__["_velocity"] = velocity.copy()
            else:
                limit.note(velocity)

    @property
    def hardest(self) -> Array | None:
        """The least acceleration limit of each joint, (nv,); ``None`` without any."""
        return _least([limit.max_acceleration for limit in self.motions])

    @property
    def fastest(self) -> Array | None:
        """The least velocity limit of each joint, (nv,); ``None`` without any."""
        return _least([limit.max_velocity for limit in self.motions])

    def motion(self) -> tuple[Array | None, Array | None, Array | None]:
        """Velocity, accelerations and speeds of the joints, (nv,), for what has to stop in time."""
        hardest, fastest = self.hardest, self.fastest
        if hardest is None:
            return None, None, fastest
        return max((v.velocity for v in self.motions), key=largest), hardest, fastest


def _least(limits: Sequence[Array]) -> Array | None:
    """The least of the limits of each joint, (nv,); ``None`` where there is none."""
    least: Array = np.min(limits, axis=0, initial=np.inf) if limits else np.full(1, np.inf)
    return least if np.isfinite(least).any() else None
