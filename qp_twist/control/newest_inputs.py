"""The inputs of a servo, which may come from other threads: the newest of each task."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass
from typing import Any

from qp_twist.checks import Array, number
from qp_twist.kinematics import TwistTask


@dataclass(frozen=True, eq=False)
class Input:
    """One element of a stream: a pose, a twist to jog with, or a joint velocity.

    Attributes:
        stamp: When it was right, s.
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

    def __init__(self, stale_after: float) -> None:
        """Start empty; an input older than ``stale_after``, s, is refused."""
        self.refused: Counter[str] = Counter()
        self._stale_after = stale_after
        self._waiting: dict[TwistTask | None, Input] = {}
        self._stamps: dict[TwistTask | None, float] = {}
        self._lock = threading.Lock()

    def put(self, task: TwistTask | None, now: float, at: float | None, **content: Any) -> bool:
        """Keep an input, unless it is out of date, of the future or older than the last one.

        Args:
            task: Key of the input.
            now: Time of the servo's clock, s.
            at: When the input was right, s; ``now`` if ``None``.
            content: The other attributes of :class:`Input`.

        Returns:
            Whether it was kept. A refused one is counted.
        """
        stamp = now if at is None else number("at", at)
        with self._lock:
            reason = ""
            if stamp < now - self._stale_after:
                reason = "out of date"
            elif stamp > now + self._stale_after:
                reason = "of the future"
            elif stamp < self._stamps.get(task, stamp):
                reason = "older than the last"
            if reason:
                self.refused[reason] += 1
                return False
            self._stamps[task] = stamp
            self._waiting.pop(task, None)  # so that the newest is the last in the dictionary
            self._waiting[task] = Input(stamp, **content)
        return True

    def take(self) -> dict[TwistTask | None, Input]:
        """Return the inputs since the last call, in the order in which they came."""
        with self._lock:
            inputs, self._waiting = self._waiting, {}
        return inputs
