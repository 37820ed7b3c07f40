"""The inputs of a servo, which may come from other threads: the newest of each task."""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from qp_twist.checks import Array, largest, number
from qp_twist.kinematics import TwistTask


@dataclass(frozen=True, eq=False)
class Input:
    """One element of a stream: a pose, a twist to jog with, or a joint velocity."""

    stamp: float
    """When it was right, s of the servo's own time."""
    pose: Array | None = None
    """Unit quaternion and position, (7,)."""
    twist: Array | None = None
    """Velocity of the pose, or what to jog with, (6,)."""
    in_tool: bool = False
    """Whether a jogging twist is along the axes of the tool."""
    velocity: Array | None = None
    """q̇, (nv,)."""

    @property
    def stops(self) -> bool:
        """Whether it asks the robot to stand: a twist or a joint velocity of zero."""
        moving = self.velocity if self.twist is None else self.twist
        return self.pose is None and moving is not None and largest(moving) == 0.0


class NewestInputs:
    r"""Keeps the newest input of each task until the next tick, and the time of a servo.

    The key of an input is its task; that of joint velocities is ``None``. Ages are measured in a
    time τ that never goes back, although a clock may be set back, stand still, or return NaN: else
    an input could count as fresh for ever. From tick to tick

    .. math::

        \tau \leftarrow \tau + \begin{cases}
            c - c_{before} & \text{if the clock } c \text{ has advanced} \\
            0 & \text{if it stands still, for at most \textit{stale\_after}} \\
            dt & \text{otherwise}
        \end{cases}

    Attributes:
        clock: Function that returns seconds.
        refused: Number of refused inputs, by reason.
    """

    def __init__(self, clock: Callable[[], float], period: float, stale_after: float) -> None:
        """Start empty at τ = 0, with dt in s; an input older than ``stale_after``, s, is refused.

        So long may the clock stand still, too, as coarse clocks do.
        """
        self.refused: Counter[str] = Counter()
        self._period, self._stale_after = period, stale_after
        self._time, self._still = 0.0, 0.0
        self._waiting: dict[TwistTask | None, Input] = {}
        self._stamps: dict[TwistTask | None, float] = {}
        self._lock = threading.Lock()
        self.use(clock)

    def use(self, clock: Callable[[], float]) -> None:
        """Go on with another clock."""
        with self._lock:
            self.clock, self._reading = clock, clock()

    def tick(self) -> float:
        """τ of the tick that begins now, s."""
        reading = self.clock()
        with self._lock:
            elapsed = reading - self._reading
            if math.isfinite(reading):
                self._reading = reading
            if math.isfinite(elapsed) and elapsed > 0.0:
                self._still = 0.0
            elif elapsed == 0.0 and self._still < self._stale_after:
                self._still += self._period
            else:
                elapsed = self._period
            self._time += elapsed
            return self._time

    def put(self, task: TwistTask | None, at: float | None, **content: Any) -> bool:
        """Keep an input, unless it is out of date, of the future or older than the last one.

        A stop is always kept, and counts as new. An input that is stamped a little ahead of the
        clock is as old as one of now. ``at``, s of the servo's clock, is when it was right, now if
        ``None``; ``content`` are the other attributes of :class:`Input`. Any thread may call it.
        Returns whether it was kept; a refused one is counted.
        """
        stops = Input(0.0, **content).stops
        if at is not None and not (stops and isinstance(at, float) and not math.isfinite(at)):
            at = number("at", at)
        reading = self.clock()
        with self._lock:
            if not math.isfinite(reading):
                reading = self._reading
            now = self._time + max(0.0, reading - self._reading)  # 0 where it is NaN
            age = 0.0 if at is None else reading - at
            stamp = now - (age if math.isfinite(age) else 0.0)
            last, reason = self._stamps.get(task, stamp), ""
            if stops:
                stamp, last = now, max(last, min(stamp, now))
            elif stamp < now - self._stale_after:
                reason = "out of date"
            elif stamp > now + self._stale_after:
                reason = "of the future"
            elif stamp < last:
                reason = "older than the last"
            if reason:
                self.refused[reason] += 1
                return False
            self._stamps[task] = last if stops else stamp
            self._waiting.pop(task, None)  # so that the newest is the last in the dictionary
            self._waiting[task] = Input(min(stamp, now), **content)
        return True

    def take(self) -> dict[TwistTask | None, Input]:
        """Return the inputs since the last call, in the order in which they came."""
        with self._lock:
            inputs, self._waiting = self._waiting, {}
        return inputs
