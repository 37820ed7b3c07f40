"""Time that only goes forward, from a clock that may go back, stand still or return no number."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable


class ForwardTime:
    r"""The time τ in which a servo measures the age of its inputs and how long it has braked.

    A simulation that is reset sets its clock back; a clock may stand still, or return NaN once. If
    ages were differences of its readings, an input could then count as fresh for ever. From tick to
    tick

    .. math::

        \tau \leftarrow \tau + \begin{cases}
            c - c_{before} & \text{if the clock } c \text{ has advanced} \\
            0 & \text{if it stands still, for at most \textit{patience}} \\
            dt & \text{otherwise}
        \end{cases}

    so that τ never goes back, and goes on while ticks are computed.

    Attributes:
        clock: Time, s, as it is given to the servo.
    """

    def __init__(self, clock: Callable[[], float], period: float, patience: float) -> None:
        """Begin at 0.

        Args:
            clock: Function that returns seconds.
            period: dt, s.
            patience: For how many seconds of ticks the clock may stand still, as coarse clocks do.
        """
        self._period, self._patience = period, patience
        self._time, self._still = 0.0, 0.0
        self._lock = threading.Lock()
        self.take(clock)

    def take(self, clock: Callable[[], float]) -> None:
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
            elif elapsed == 0.0 and self._still < self._patience:
                self._still += self._period
            else:
                elapsed = self._period
            self._time += elapsed
            return self._time

    def stamped(self, at: float | None) -> tuple[float, float]:
        """τ of a time ``at`` of the clock, s, and τ now; for ``None`` both are now.

        Any thread may call it, between two ticks.
        """
        reading = self.clock()
        with self._lock:
            if not math.isfinite(reading):
                reading = self._reading
            elapsed = reading - self._reading
            now = self._time + (elapsed if elapsed > 0.0 else 0.0)
            age = 0.0 if at is None else reading - at
            return now - (age if math.isfinite(age) else 0.0), now
