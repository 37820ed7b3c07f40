"""Joint moves from rest to rest, as scripts state them by a speed and an acceleration."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array

_LOOKS = 16
"""Places at which each ramp is looked at: there the speed is within 1/32 of its end's."""


class RestToRest(NamedTuple):
    """A joint move whose joint that goes farthest comes to a speed v, and to rest, by ±a.

    If the way is too short for v, it slows down halfway. The other joints are in proportion.

    Attributes:
        way: Of that joint, rad.
        speed: v, rad/s.
        acceleration: a, rad/s².
    """

    way: float
    speed: float
    acceleration: float

    @classmethod
    def in_time(cls, way: float, seconds: float, fastest: float, acceleration: float) -> RestToRest:
        """The slowest that takes no longer than a time T, or the fastest within both limits.

        T = way / v + v / a is a quadratic equation for v.
        """
        root = math.sqrt(max(seconds**2 - 4.0 * way / acceleration, 0.0))
        speed = min(2.0 * way / (seconds + root), math.sqrt(acceleration * way), fastest)
        return cls(way, speed, acceleration)

    @property
    def ramp(self) -> float:
        """Time of each ramp, s."""
        return min(self.speed / self.acceleration, math.sqrt(self.way / self.acceleration))

    @property
    def seconds(self) -> float:
        """Time of the move, s."""
        reached = self.acceleration * self.ramp
        return self.ramp + self.way / reached if reached else 0.0

    def samples(self) -> tuple[Array, Array]:
        """Shares of the time, (K,), and of the way then, at places on both ramps and the end."""
        if not self.seconds:
            return np.ones(1), np.ones(1)
        times = self.ramp * np.arange(1, _LOOKS + 1) / _LOOKS
        ways = 0.5 * self.acceleration * times**2 / self.way
        times /= self.seconds
        # The second ramp is the first one backwards; without a part at speed it begins where
        # the first one ends.
        back = slice(-1 if times[-1] < 0.5 * (1.0 - 1e-9) else -2, None, -1)
        return np.concatenate([times, 1.0 - times[back], [1.0]]), np.concatenate(
            [ways, 1.0 - ways[back], [1.0]]
        )
