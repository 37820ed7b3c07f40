"""More time for a waypoint that cannot be reached within its own."""

from __future__ import annotations

from collections.abc import Callable

import mink
import numpy as np

from qp_twist.following.resolver import Resolver
from qp_twist.following.waypoint_limits import WaypointLimits
from qp_twist.qp import NoSolutionFound

GROWTH = 1.5
"""How much longer each further attempt may take."""
LONGEST = 1e4
"""Most that a waypoint is stretched by."""
_PATIENCE = 3
"""Attempts that come no nearer, after which time is not what is missing."""


class Pace:
    """Gives waypoints more time where the limits do not let the method reach them in their own.

    A waypoint that was missed is repeated from where it began, with its state restored, 1.5 times
    as long as before, until it is reached. Where longer attempts come no nearer (a position limit,
    a target out of reach) the first attempt stands, as it does without slowing down. The next
    waypoint begins with a pace that is faster by one step, so that the feed is resumed.

    Attributes:
        factor: Of the last waypoint's duration.
    """

    def __init__(self) -> None:
        self.factor = 1.0

    def approach(
        self,
        attempt: Callable[[float], float],
        configuration: mink.Configuration,
        resolver: Resolver,
        duration: float,
    ) -> float:
        """Reach the resolver's target and return the time that it took, s.

        Args:
            attempt: Approaches the target within a duration, s; returns by how many times the
                tolerance it is missed, at most 1 where it is reached.
            configuration: The robot where the waypoint begins; moved.
            resolver: Its limits' state is restored with the configuration.
            duration: What the waypoint may take, s.
        """
        begin, state = configuration.q.copy(), _state(resolver.limits)
        factor = max(1.0, self.factor / GROWTH)
        missed = attempt(factor * duration)
        nearest, failed = missed, 0
        while missed > 1.0 and failed < _PATIENCE and factor * GROWTH <= LONGEST:
            factor *= GROWTH
            configuration.update(begin)
            _restore(resolver.limits, state)
            try:
                missed = attempt(factor * duration)
            except NoSolutionFound:
                missed = np.inf
            failed = 0 if missed < 0.99 * nearest else failed + 1
            nearest = min(nearest, missed)
        if missed > 1.0:
            configuration.update(begin)
            _restore(resolver.limits, state)
            factor = 1.0
            attempt(duration)
        self.factor = factor
        return factor * duration


def _state(limits: WaypointLimits | None) -> dict[str, object]:
    """What :meth:`WaypointLimits.begin_waypoint` makes of the waypoint before.

    The window of velocity limits is set anew from the configuration; only that of accelerations
    remembers.
    """
    if limits is None or limits.motion is None:
        return {}
    return {**vars(limits.motion), "velocity": limits.motion.motion.velocity}


def _restore(limits: WaypointLimits | None, state: dict[str, object]) -> None:
    if limits is not None and limits.motion is not None:
        kept = dict(state)
        velocity = kept.pop("velocity")
        assert isinstance(velocity, np.ndarray)
        vars(limits.motion).update(kept)
        limits.motion.motion.velocity = velocity
