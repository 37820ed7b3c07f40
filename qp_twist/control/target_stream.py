"""The stream of targets of one task, and the reference that follows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.control.newest_inputs import Input
from qp_twist.kinematics import TwistTask

AT_ONCE = 1.5
"""Poses that come at least every 1.5 ticks are the reference as they are."""
_MARGIN = 1.2
"""The next pose of a stream may be late by a fifth without being missed."""
_LEASH = 0.1
"""Of the distance that counts as a jump: how far a jogged reference may be ahead of the robot."""
_AT_REST = np.zeros(6)


@dataclass(frozen=True)
class StreamSettings:
    """What all streams of a servo share; see :class:`~qp_twist.Servo`."""

    period: float
    stale_after: float
    stop_within: float
    jump: tuple[float, float]
    approach_speed: tuple[float, float]

    @property
    def share(self) -> float:
        """Share of a change of velocity that jogging takes up in a tick."""
        return -math.expm1(-4.0 * self.period / self.stop_within)

    def braking(self, elapsed: float) -> float:
        """Share of the velocity that is left in a tick ``elapsed`` s after braking began."""
        return max(0.0, 1.0 - (elapsed + self.period) / self.stop_within)


class Fade:
    """A share from 0 to 1 that takes ``stop_within`` from one end to the other.

    Attributes:
        share: The share.
    """

    def __init__(self, settings: StreamSettings) -> None:
        """Begin at 0."""
        self.share, self._change = 0.0, settings.period / settings.stop_within

    def towards(self, full: bool) -> float:
        """The share after a tick on the way to 1, or to 0."""
        self.share += min(max(float(full) - self.share, -self._change), self._change)
        return self.share


class TargetMotion:
    """A reference pose that follows the rare poses of a stream smoothly.

    It is a critically damped filter whose horizon h is the time between two poses: the docs' page
    *A stream of targets*. If poses come at every tick, the reference is the goal.

    Attributes:
        pose: Unit quaternion and position, (7,).
        twist: Its velocity over the present tick, m/s and rad/s, (6,).
    """

    def __init__(self, pose: Array, settings: StreamSettings) -> None:
        """Stand at a pose (7,)."""
        self._settings = settings
        self.stand(pose)

    def stand(self, pose: Array) -> None:
        """Be at rest at a pose (7,)."""
        self.pose, self.twist = np.array(pose), np.zeros(6)

    def follow(self, goal: Array, velocity: Array, horizon: float) -> None:
        """Move for one tick after a goal (7,) with a twist (6,), whose next is due within h, s."""
        dt = self._settings.period
        wanted = twist_between(self.pose, goal) / max(horizon, dt) + velocity
        share = 1.0 if horizon <= AT_ONCE * dt else -math.expm1(-4.0 * dt / horizon)
        self.along(self.twist + share * (wanted - self.twist))

    def approach(self, goal: Array, velocity: Array, horizon: float) -> bool:
        r"""Move for one tick towards a goal that is far away; return whether it is near.

        With δ the time to the goal at full speed, the speed is the share
        :math:`\min(1, \sqrt{\delta/T})` of it, and changes by at most dt/T in a tick: it takes T
        from rest to full speed, and to rest again. Arguments are those of :meth:`follow`; full
        speed is ``approach_speed`` beside the goal's own, and T is ``stop_within``.
        """
        dt, within = self._settings.period, self._settings.stop_within
        fastest = self._settings.approach_speed
        left = twist_between(self.pose, goal)
        seconds = time_at(left, fastest)
        if seconds * within <= max(horizon, dt) ** 2:
            return True
        wanted = left * (min(1.0, math.sqrt(seconds / within)) / seconds) + velocity
        change = wanted - self.twist
        excess = time_at(change, fastest) * within / dt
        self.along(self.twist + change / max(excess, 1.0))
        return False

    def along(self, twist: Array) -> None:
        """Move for one tick at a twist (6,)."""
        self.twist, self.pose = twist, moved(self.pose, twist, self._settings.period)


class TargetStream:
    """The reference of one task.

    Attributes:
        task: The task.
        approaching: Whether the reference is on its way to a target that is far away.
    """

    def __init__(
        self, task: TwistTask, settings: StreamSettings, configuration: mink.Configuration
    ) -> None:
        """Stand where the task's frame is."""
        self.task, self._settings = task, settings
        self._interval = settings.stale_after
        self._input: Input | None
        self._goal: Array | None
        self._stale_since: float | None
        self._motion = TargetMotion(pose_of(task, configuration), settings)
        self.stand(configuration)

    def stand(self, configuration: mink.Configuration) -> None:
        """Hold the frame where it is, until something new comes."""
        self._motion.stand(pose_of(self.task, configuration))
        self._between = self._motion.pose
        self._goal = self._input = self._stale_since = None
        self.approaching = False
        self._braked_from = self._pace = _AT_REST
        self._set_target(self._motion.pose)

    def wait(self, configuration: mink.Configuration) -> None:
        """Begin anew where the frame is, and approach what the stream asks for."""
        self._motion.stand(pose_of(self.task, configuration))
        self._between, self.approaching = self._motion.pose, self._goal is not None

    @property
    def at_rest(self) -> bool:
        """Whether the reference stands."""
        return not self._motion.twist.any()

    def take(self, given: Input) -> None:
        """Take the newest element."""
        if self._input is not None and self._stale_since is None:
            apart = given.stamp - self._input.stamp
            self._interval += 0.2 * (min(apart, self._settings.stale_after) - self._interval)
            if self._interval > 2.0 * apart:  # the first estimate was far too long
                self._interval = apart
        if given.pose is not None:
            before = self._motion.pose if self._goal is None else self._goal
            if beyond(twist_between(before, given.pose), self._settings.jump):
                self.approaching = True
            if self._goal is None:
                self._between = self._motion.pose
            self._goal = given.pose
        self._input, self._stale_since = given, None

    def advance(
        self, now: float, configuration: mink.Configuration, velocity: Array, *, behind: bool
    ) -> bool:
        """Move the reference by a tick, and set it as the task's target; whether input is fresh.

        ``velocity`` (nv,) was commanded last; ``behind``: whether the robot may be behind the
        reference by more than its last step.
        """
        before = self._motion.pose
        given, fresh = self._input, True
        if given is None:
            fresh = False
        elif now - given.stamp > self._settings.stale_after:
            before = self._stop(now, configuration, velocity)
            fresh = False
        elif given.pose is not None:
            self._follow(given, given.pose, now, configuration, behind)
        else:
            before = self._jog(given, configuration)
        self._pace = self._pace + self._settings.share * (self._motion.twist - self._pace)
        self._set_target(before)
        return fresh

    def _set_target(self, pose: Array) -> None:
        self.task.set_target(mink.SE3(pose), self._motion.twist)

    def _stop(self, now: float, configuration: mink.Configuration, velocity: Array) -> Array:
        """Brake, from where the robot is: the reference may be ahead of it."""
        motion, settings = self._motion, self._settings
        if self._stale_since is None:
            self._stale_since = now
            self._goal, self.approaching = None, False
            motion.stand(pose_of(self.task, configuration))
            ahead = mink.Configuration(
                configuration.model, configuration.integrate(velocity, settings.period)
            )
            after = pose_of(self.task, ahead)
            self._braked_from = twist_between(motion.pose, after) / settings.period
        before = motion.pose
        share = settings.braking(now - self._stale_since)
        if share > 0.0:
            motion.along(share * self._braked_from)
        elif motion.twist.any():
            motion.stand(pose_of(self.task, configuration))
            before = motion.pose
        return before

    def _follow(
        self, given: Input, goal: Array, now: float, configuration: mink.Configuration, behind: bool
    ) -> None:
        motion, settings, dt = self._motion, self._settings, self._settings.period
        twist = _AT_REST
        if given.twist is not None:  # where it is now
            twist = given.twist
            goal = moved(goal, twist, now - given.stamp)
        if behind:
            # Where the robot cannot follow, the reference waits, and is then approached.
            missing = error_of(self.task, configuration)
            outwards = float(missing @ twist_between(motion.pose, goal)) > 0.0
            if beyond(missing, settings.jump) and outwards:
                motion.along(_AT_REST)
                self._between, self.approaching = motion.pose, True
                return
        if self.approaching:
            if not motion.approach(goal, twist, self._interval):
                return
            self.approaching, self._between = False, motion.pose
        if given.twist is None and self._interval > AT_ONCE * dt:
            # On its way from the last pose, to be there when the next is due.
            left = given.stamp + _MARGIN * self._interval - now
            twist = twist_between(self._between, goal) / max(left, dt)
            goal = self._between
            self._between = moved(goal, twist, dt)
        motion.follow(goal, twist, self._interval)

    def _jog(self, given: Input, configuration: mink.Configuration) -> Array:
        settings, motion, twist = self._settings, self._motion, given.twist
        assert twist is not None
        if self._goal is not None:
            # From where the robot is, at the smoothed velocity of the poses before: a pose that was
            # followed within a tick gave the reference a velocity at which nothing should go on.
            self._goal, self.approaching = None, False
            motion.stand(pose_of(self.task, configuration))
            motion.twist = self._pace
        before = motion.pose
        if given.in_tool:
            rotation = mink.SO3(pose_of(self.task, configuration)[:4]).as_matrix()
            twist = (twist.reshape(2, 3) @ rotation.T).ravel()
        # Where the robot cannot follow, the reference waits, so that the way back begins at once.
        leash = _LEASH * settings.jump[0], _LEASH * settings.jump[1]
        missing = error_of(self.task, configuration)
        if beyond(missing, leash) and float(missing @ twist) > 0.0:
            twist = _AT_REST
        motion.along(motion.twist + settings.share * (twist - motion.twist))
        return before


def pose_of(task: TwistTask, configuration: mink.Configuration) -> Array:
    """Pose (7,) of a task's frame, in the frame that carries its target."""
    return np.array(task.pose(configuration).wxyz_xyz)


def error_of(task: TwistTask, configuration: mink.Configuration) -> Array:
    """Twist (6,) that is missing to a task's target in its rows, along the target's axes."""
    error = task.state(configuration).error
    if task.relative_to is not None:
        carrier = configuration.get_transform_frame_to_world(*task.relative_to)
        error = (error.reshape(2, 3) @ carrier.rotation().as_matrix()).ravel()
    return error


def beyond(twist: Array, most: tuple[float, float]) -> bool:
    """Whether the linear or the angular part of a twist (6,) is longer than it may be."""
    return time_at(twist, most) > 1.0


def time_at(twist: Array, speeds: tuple[float, float]) -> float:
    """How long a displacement (6,) takes at a linear and an angular speed."""
    linear, angular = math.hypot(*twist[:3].tolist()), math.hypot(*twist[3:].tolist())
    return max(linear / speeds[0], angular / speeds[1])


def twist_between(start: Array, end: Array) -> Array:
    """The twist (p₁ − p₀, log R₁R₀ᵀ) that takes one pose (7,) to another in unit time, (6,)."""
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
