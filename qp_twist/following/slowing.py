"""Extend the duration of a waypoint that cannot be reached in time."""

from __future__ import annotations

from collections.abc import Callable

import mink
import numpy as np

from qp_twist.qp import NoSolutionFound

GROWTH = 1.5
"""Factor of the duration from one attempt to the next."""
LONGEST = 1e4
"""Largest factor of a waypoint's duration."""
_PATIENCE = 3
"""Number of attempts without improvement after which it gives up."""


class Pace:
    """Extends durations of waypoints that the limits make unreachable in time.

    A missed waypoint is repeated with 1.5 times the duration until it is reached. If longer
    attempts do not improve it (a position limit, a target out of reach), the first attempt is kept.
    The next waypoint starts with a duration one factor shorter, so that the feed is resumed.

    Attributes:
        factor: Factor of the last waypoint's duration.
    """

    def __init__(self) -> None:
        self.factor = 1.0

    @property
    def at_feed(self) -> bool:
        """Whether the next waypoint starts with the task's duration."""
        return self.factor <= GROWTH

    def approach(
        self,
        attempt: Callable[[float], float],
        configuration: mink.Configuration,
        duration: float,
    ) -> float:
        """Reach the resolver's target and return the time that it took, s.

        Args:
            attempt: Approaches the target within a duration, s; returns the error in tolerances, at
                most 1 if the target is reached.
            configuration: The robot at the beginning of the waypoint; modified.
            duration: The task's duration of the waypoint, s.
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
