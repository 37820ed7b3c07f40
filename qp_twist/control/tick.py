"""What a servo commands for one period, what it is doing, and how long its ticks took."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, number
from qp_twist.control.step import Status, Step

STILL = 1e-2
"""Speed below which a joint counts as at rest, rad/s or m/s."""
_SHORTEST, _LONGEST, _PER_DECADE = 1e-7, 1e2, 100
"""Range of the histogram, s, and its bins per decade."""
_BINS = round(_PER_DECADE * math.log10(_LONGEST / _SHORTEST))


class ServoState(enum.Enum):
    """What a servo is doing; the value says it to a person."""

    HOLDING = "holding: no target is coming"
    TRACKING = "tracking the targets"
    APPROACHING = "approaching a target that is far away"
    SLOWED = "slowed by limits"
    SINGULAR = "singular"
    AT_THE_EDGE = "at the edge of the reach"
    STOPPING = "stopping: the targets have ceased"
    BLOCKED = "stopping: no step was found"


@dataclass(frozen=True, eq=False)
class Tick:
    """What a servo commands for one period."""

    velocity: Array
    """q̇, rad/s or m/s, (nv,)."""
    state: ServoState
    """What the servo is doing."""
    step: Step | None
    """The controller's step; ``None`` if it found none."""
    failure: str = ""
    """Why it found none."""
    exit_joints: tuple[str, ...] = ()
    """Names of the joints whose motion leads out of a singularity, if it is in one."""

    @property
    def message(self) -> str:
        """The state in a sentence, with what causes it."""
        step, text = self.step, self.state.value
        if self.state is ServoState.BLOCKED:
            return f"{text}: {self.failure}"
        if step is None:
            return text
        by = ", ".join(str(limit) for limit in step.binding)
        if self.state is ServoState.SLOWED and by:
            share = f" to {100.0 * step.scale:.0f} %" if step.status is Status.SCALED else ""
            text = f"slowed{share} by {by}"
        lost = ", ".join(str(lost) for lost in step.lost)
        if self.state is ServoState.SINGULAR:
            joints = " and ".join(self.exit_joints)
            text += f": no joint moves {lost}; leaving by the motion of {joints}"
        if self.state is ServoState.AT_THE_EDGE and lost:
            text += f": {lost}"
        return text

    def __repr__(self) -> str:
        return f"Tick({self.message})"


class TickTimes:
    """A histogram of durations, the same size after a day as after a second.

    Its bins grow by 2.3 % each, so that a quantile is known to 2.3 %.

    Attributes:
        period: What a tick may take, s.
        count: Number of ticks.
        late: Deadline overruns: ticks that took longer than the period by the clock.
        late_by_itself: Those of them whose thread also used more processor time than the period;
            in the others it was waiting for the machine.
        longest: The longest, s.
    """

    def __init__(self, period: float) -> None:
        """Count nothing yet."""
        self.period = period
        self.count = self.late = self.late_by_itself = 0
        self.longest = 0.0
        self._histogram = np.zeros(_BINS, dtype=np.int64)

    def add(self, seconds: float, processor_seconds: float) -> None:
        """Count a tick by its duration and the processor time of its thread, both in s."""
        place = int(_PER_DECADE * math.log10(max(seconds, _SHORTEST) / _SHORTEST))
        self._histogram[min(place, _BINS - 1)] += 1
        self.count += 1
        self.longest = max(self.longest, seconds)
        if seconds > self.period:
            self.late += 1
            self.late_by_itself += processor_seconds > self.period

    def quantile(self, share: float) -> float:
        """The duration, s, that this share of the ticks did not exceed; NaN before the first.

        Raises:
            InvalidInput: If the share is not in [0, 1].
        """
        share = number("share", share, at_least=0.0, at_most=1.0)
        if not self.count:
            return math.nan
        ranked = np.cumsum(self._histogram)
        place = int(np.searchsorted(ranked, max(1.0, share * self.count)))
        return float(min(_SHORTEST * 10.0 ** ((place + 1) / _PER_DECADE), self.longest))

    def __repr__(self) -> str:
        if not self.count:
            return "TickTimes(none yet)"
        shown = ", ".join(
            f"{name} {1e6 * self.quantile(share):.0f} µs"
            for name, share in (("median", 0.5), ("p99", 0.99), ("p99.99", 0.9999))
        )
        return (
            f"TickTimes({self.count} ticks: {shown}, longest {1e6 * self.longest:.0f} µs; "
            f"{self.late} longer than {1e3 * self.period:g} ms, {self.late_by_itself} of them "
            "by their own work)"
        )
