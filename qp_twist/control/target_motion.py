"""A target between the poses of a stream: interpolated, approached, or brought to rest."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from qp_twist.checks import Array

AT_ONCE = 1.5
"""Poses that come at least every 1.5 ticks are the reference as they are."""


def twist_between(start: Array, end: Array) -> Array:
    r"""The twist that takes one pose to another in unit time, (6,).

    .. math::

        \mathbf v = \mathbf p_1 - \mathbf p_0, \qquad
        \boldsymbol\omega = \log(\mathbf R_1\mathbf R_0^T)

    Args:
        start: Unit quaternion and position, (7,).
        end: The same.

    Returns:
        Linear and angular part, along the axes in which the poses are given.
    """
    twist, body = np.empty(6), np.empty(3)
    twist[:3] = end[4:] - start[4:]
    mujoco.mju_subQuat(body, end[:4], start[:4])  # along the axes of the start
    mujoco.mju_rotVecQuat(twist[3:], body, start[:4])
    return twist


def moved(pose: Array, twist: Array, seconds: float) -> Array:
    """The pose (7,) after a constant twist (6,), the inverse of :func:`twist_between`."""
    after, conjugate, body = pose.copy(), np.empty(4), np.empty(3)
    after[4:] += seconds * twist[:3]
    mujoco.mju_negQuat(conjugate, pose[:4])
    mujoco.mju_rotVecQuat(body, twist[3:], conjugate)
    mujoco.mju_quatIntegrate(after[:4], body, seconds)
    mujoco.mju_normalize4(after[:4])
    return after


class TargetMotion:
    r"""A moving reference pose.

    Poses of a stream come less often than the ticks of a controller. If each were the target at
    once, the arm would jump to it and stand until the next. The reference follows them smoothly
    instead, as a critically damped filter whose horizon h is the time between two poses:

    .. math::

        \mathbf t^\star = \mathbf t_{goal} + \frac{1}{h}\,\Delta\mathbf t, \qquad
        \mathbf t \leftarrow \mathbf t + (1 - e^{-4\,dt/h})\,(\mathbf t^\star - \mathbf t)

    with Δt the twist from the reference to the goal. If poses come at every tick, the reference is
    the goal.

    Attributes:
        pose: Unit quaternion and position, (7,).
        twist: Its velocity over the present tick, m/s and rad/s, (6,).
    """

    def __init__(self, pose: Array) -> None:
        """Stand at a pose (7,)."""
        self.stand(pose)

    def stand(self, pose: Array) -> None:
        """Be at rest at a pose (7,)."""
        self.pose, self.twist = np.array(pose), np.zeros(6)

    def follow(self, goal: Array, velocity: Array, horizon: float, dt: float) -> None:
        """Move for one tick after a goal whose next pose is due within the horizon.

        Args:
            goal: Unit quaternion and position, (7,).
            velocity: Twist of the goal, (6,).
            horizon: h, s.
            dt: Length of the tick, s.
        """
        wanted = twist_between(self.pose, goal) / max(horizon, dt) + velocity
        share = 1.0 if horizon <= AT_ONCE * dt else -math.expm1(-4.0 * dt / horizon)
        self.along(self.twist + share * (wanted - self.twist), dt)

    def approach(
        self,
        goal: Array,
        velocity: Array,
        horizon: float,
        dt: float,
        *,
        fastest: tuple[float, float],
        within: float,
    ) -> bool:
        r"""Move for one tick towards a goal that is far away; return whether it is near.

        With δ the time to the goal at full speed, the speed is the share
        :math:`\min(1, \sqrt{\delta/T})` of it, and changes by at most dt/T in a tick: it takes T
        from rest to full speed, and to rest again.

        Args:
            goal: Unit quaternion and position, (7,).
            velocity: Twist of the goal, (6,).
            horizon: h, s, of the stream.
            dt: Length of the tick, s.
            fastest: Full speed beside the goal's own, m/s and rad/s.
            within: T, s.
        """
        left = twist_between(self.pose, goal)
        seconds = time_at(left, fastest)
        if seconds * within <= max(horizon, dt) ** 2:
            return True
        wanted = left * (min(1.0, math.sqrt(seconds / within)) / seconds) + velocity
        change = wanted - self.twist
        excess = time_at(change, fastest) * within / dt
        self.along(self.twist + change / max(excess, 1.0), dt)
        return False

    def along(self, twist: Array, dt: float) -> None:
        """Move for one tick at a twist (6,)."""
        self.twist, self.pose = twist, moved(self.pose, twist, dt)


def time_at(twist: Array, speeds: tuple[float, float]) -> float:
    """How long a displacement (6,) takes at a linear and an angular speed."""
    linear, angular = math.hypot(*twist[:3].tolist()), math.hypot(*twist[3:].tolist())
    return max(linear / speeds[0], angular / speeds[1])
