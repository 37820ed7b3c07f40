"""More time for a waypoint that cannot be reached within its own."""

from __future__ import annotations

from collections.abc import Callable

import mink
import numpy as np

from qp_twist.qp import NoSolutionFound

GROWTH = 1.5
"""How much longer each further attempt may take."""
LONGEST = 1e4
"""Most that a waypoint is stretched by."""
_PATIENCE = 3
"""Attempts that come no nearer, after which time is not what is missing."""


class Pace:
    """Gives waypoints more time where the limits do not let the method reach them in their own.

    A waypoint that was missed is repeated from where it began, 1.5 times
    as long as before, until it is reached. Where longer attempts come no nearer (a position limit,
    a target out of reach) the first attempt stands, as it does without slowing down. The next
    waypoint begins with a pace that is faster by one step, so that the feed is resumed.

    Attributes:
        factor: Of the last waypoint's duration.
    """

    def __init__(self) -> None:
        self.factor = 1.0

    @property
    def at_feed(self) -> bool:
        """Whether the next waypoint begins with the time that the task gives it."""
        return self.factor <= GROWTH

    def approach(
        self,
        attempt: Callable[[float], float],
        configuration: mink.Configuration,
        duration: float,
    ) -> float:
        """Reach the resolver's target and return the time that it took, s.

        Args:
            attempt: Approaches the target within a duration, s; returns by how many times the
                tolerance it is missed, at most 1 where it is reached.
            configuration: The robot where the waypoint begins; moved.
            duration: What the waypoint may take, s.
        """
        begin = configuration.q.copy()
        factor = max(1.0, self.factor / GROWTH)
        missed = attempt(factor * duration)
        nearest, failed = missed, 0
        while missed > 1.0 and failed < _PATIENCE and factor * GROWTH <= LONGEST:
            factor *= GROWTH
            configuration.update(begin)
            try:
                missed = attempt(factor * duration)
            except NoSolutionFound:
                missed = np.inf
            failed = 0 if missed < 0.99 * nearest else failed + 1
            nearest = min(nearest, missed)
        if missed > 1.0:
            configuration.update(begin)
            factor = 1.0
            attempt(duration)
        self.factor = factor
        return factor * duration
