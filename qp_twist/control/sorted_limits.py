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
        following: Those that have to know the joints' velocity.
    """

    def __init__(self, limits: Sequence[mink.Limit]) -> None:
        """Sort the limits."""
        self.limits = list(limits)
        self.clearances = [limit for limit in limits if isinstance(limit, Clearance)]
        self.following = [
            v for v in limits if isinstance(v, BoxLimit) and type(v).note is not BoxLimit.note
        ]
        self._motions = [limit for limit in limits if isinstance(limit, MotionLimit)]
        self._revisions: list[int] = []
        self._least: tuple[Array | None, Array | None] = None, None

    def note(self, velocity: Array) -> None:
        """Store the joint velocity (nv,) in the limits that have to know it."""
        for limit in self.following:
            if type(limit) is MotionLimit:
                limit.velocity = velocity.copy()  # its own method checks it once more
            else:
                limit.note(velocity)

    def least(self) -> tuple[Array | None, Array | None]:
        """The least acceleration and velocity limit of each joint, (nv,); ``None`` without any.

        The arrays stay the same objects until a limit changes.
        """
        revisions = [limit.revision for limit in self._motions]
        if revisions != self._revisions:
            self._revisions = revisions
            self._least = (
                _least([limit.max_acceleration for limit in self._motions]),
                _least([limit.max_velocity for limit in self._motions]),
            )
        return self._least

    def motion(self) -> tuple[Array | None, Array | None, Array | None]:
        """Velocity, accelerations and speeds of the joints, (nv,), for what has to stop in time."""
        hardest, fastest = self.least()
        if hardest is None:
            return None, None, fastest
        return max((v.velocity for v in self._motions), key=largest), hardest, fastest


def _least(limits: Sequence[Array]) -> Array | None:
    """The least of the limits of each joint, (nv,); ``None`` where there is none."""
    if not any(np.isfinite(limit).any() for limit in limits):
        return None
    least: Array = np.min(limits, axis=0)
    return least
