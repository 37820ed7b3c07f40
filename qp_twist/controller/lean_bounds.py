"""Bounds of a prepared step without compilation."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.fast import installed
from qp_twist.fast.bounds import POSITION_BOUND, VELOCITY_BOUND, bounds
from qp_twist.limits import MotionLimit, PositionLimit
from qp_twist.limits.position_limit import NOTICEABLE
from qp_twist.limits.stated_limit import UNLIMITED


class AnyBounds:
    """Of any limits that a prepared step knows, joint by joint."""

    is_current = True

    def __init__(self, table: Array, types: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        """From the tables that ``fast.bounds`` takes."""
        self._given = table, types
        self._kinds = np.zeros((2, table.shape[1]))

    def state(self, q: Array, dt: float, lower: Array, upper: Array) -> bool:
        """Write the bounds; whether no joint is outside and no two limits contradict."""
        ends = lower, upper, self._kinds[0], self._kinds[1]
        given = *self._given, q
        if installed():  # then it takes arrays
            return bool(bounds(*given, dt, NOTICEABLE, UNLIMITED, *ends))
        lists: list[list[float]] = [[0.0] * len(q) for _ in ends]
        inside: bool = bounds(
            *(array.tolist() for array in given), dt, NOTICEABLE, UNLIMITED, *lists
        )
        for end, numbers in zip(ends, lists, strict=True):
            end[:] = numbers
        return inside

    def keeps(self, velocity: Array) -> None:
        """Know of a velocity that it is inside the speeds."""

    def kinds(self) -> Array:
        """What the bounds come from, lower and upper ones, (2, nv)."""
        return self._kinds


class RangeBounds:
    """Of one limit alone, of positions or of positions and speeds: all joints at once."""

    def __init__(self, limit: PositionLimit) -> None:
        """Take over the limit's numbers as they are."""
        self._limit, self._revision = limit, limit.revision
        self._fastest = np.full(len(limit.lower), np.inf)
        if isinstance(limit, MotionLimit):
            self._fastest = limit.max_velocity
        # Seen from the lower end upwards, and from the upper end downwards.
        self._ends = np.array([limit.lower, -limit.upper]) + limit.hair
        self._room, self._speed = np.zeros_like(self._ends), np.zeros_like(self._ends)
        self._always_limited = float(self._fastest.max()) < UNLIMITED
        self._slow: object = None

    @property
    def is_current(self) -> bool:
        """Whether the limit's numbers are those that were taken over."""
        return self._limit.revision == self._revision

    def state(self, q: Array, dt: float, lower: Array, upper: Array) -> bool:
        """As :meth:`AnyBounds.state`."""
        room, speed, fastest = self._room, self._speed, self._fastest
        room[0] = q
        np.negative(q, out=room[1])
        room -= self._ends
        if not min(room.ravel().tolist()) >= -NOTICEABLE:
            return False
        np.maximum(room, 0.0, out=room)
        room /= dt
        if isinstance(self._limit, MotionLimit) and self._limit.velocity is not self._slow:
            if not (np.abs(self._limit.velocity) <= fastest + NOTICEABLE).all():
                return False
            self._slow = self._limit.velocity
        np.minimum(room, fastest, out=speed)
        if not self._always_limited:
            speed[speed > UNLIMITED] = np.inf
        np.negative(speed[0], out=lower)
        upper[:] = speed[1]
        return True

    def keeps(self, velocity: Array) -> None:
        """Know of a velocity that it is inside the speeds."""
        self._slow = velocity

    def kinds(self) -> Array:
        """As :meth:`AnyBounds.kinds`."""
        return np.where(self._room < self._fastest, POSITION_BOUND, VELOCITY_BOUND)


def bounds_of(
    limits: Sequence[mink.Limit], table: Array, types: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> AnyBounds | RangeBounds:
    """The bounds of a prepared step's limits, whose tables are kept up to date."""
    if len(limits) == 1 and not installed():  # then all of them take a tenth of the time
        limit = limits[0]
        if type(limit) is PositionLimit:
            return RangeBounds(limit)
        if type(limit) is MotionLimit and not np.isfinite(limit.max_acceleration).any():
            return RangeBounds(limit)
    return AnyBounds(table, types)
