"""The inputs of a servo, which may come from other threads: the newest of each task."""

from __future__ import annotations

import math
import threading
from collections import Counter
from dataclasses import dataclass
from typing import Any

from qp_twist.checks import Array, largest, number
from qp_twist.control.forward_time import ForwardTime
from qp_twist.kinematics import TwistTask


@dataclass(frozen=True, eq=False)
class Input:
    """One element of a stream: a pose, a twist to jog with, or a joint velocity.

    Attributes:
        stamp: When it was right, s of the servo's own time.
        pose: Unit quaternion and position, (7,).
        twist: Velocity of the pose, or what to jog with, (6,).
        in_tool: Whether a jogging twist is along the axes of the tool.
        velocity: q̇, (nv,).
    """

    stamp: float
    pose: Array | None = None
    twist: Array | None = None
    in_tool: bool = False
    velocity: Array | None = None


class NewestInputs:
    """Keeps the newest input of each task until the next tick.

    The key of an input is its task; that of joint velocities is ``None``.

    Attributes:
        refused: Number of refused inputs, by reason.
    """

    def __init__(self, time: ForwardTime, stale_after: float) -> None:
        """Start empty; an input older than ``stale_after``, s, is refused."""
        self.refused: Counter[str] = Counter()
        self._time, self._stale_after = time, stale_after
        self._waiting: dict[TwistTask | None, Input] = {}
        self._stamps: dict[TwistTask | None, float] = {}
        self._lock = threading.Lock()

    def put(self, task: TwistTask | None, at: float | None, **content: Any) -> bool:
        """Keep an input, unless it is out of date, of the future or older than the last one.

        A stop, which is a twist or a joint velocity of zero, is always kept, and counts as new. An
        input that is stamped a little ahead of the clock is as old as one of now.

        Args:
            task: Key of the input.
            at: When the input was right, s of the servo's clock; now if ``None``.
            content: The other attributes of :class:`Input`.

        Returns:
            Whether it was kept. A refused one is counted.
        """
        stops = _is_stop(**content)
        if stops and _is_no_time(at):
            at = None
        elif at is not None:
            at = number("at", at)
        with self._lock:
            stamp, now = self._time.stamped(at)
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


def _is_stop(
    pose: Array | None = None, twist: Array | None = None, velocity: Array | None = None, **_: Any
) -> bool:
    """Whether an input asks the robot to stand."""
    moving = velocity if twist is None else twist
    return pose is None and moving is not None and largest(moving) == 0.0


def _is_no_time(at: float | None) -> bool:
    """Whether a stamp is NaN or infinite, as of a clock that has failed."""
    return isinstance(at, float) and not math.isfinite(at)
