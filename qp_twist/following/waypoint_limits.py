"""The limits shared by all steps along a path."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import (
    Box,
    BoxLimit,
    DisplacementWindow,
    Intersection,
    MotionLimit,
    PositionLimit,
)
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask

_STANDING = 1e-9
"""Smallest speed limit, rad/s or m/s: no step in practice, and no division by zero."""


class WaypointLimits:
    """The limits of a path's methods, and their state from waypoint to waypoint.

    Attributes:
        limits: The limits of the controllers.
        dt: Duration of the current waypoint, s.
    """

    def __init__(self, path_task: PathTask, *, accelerations: bool = True) -> None:
        model = path_task.model
        self.limits: list[mink.Limit] = [PositionLimit(model)]
        self.ranges = JointRanges.of(model)
        self.velocity_limits = path_task.velocity_limits
        self.window: DisplacementWindow | None = None
        self.motion: MotionWindow | None = None
        self.dt = 1.0
        timed = path_task.durations is not None
        most = path_task.acceleration_limits
        if accelerations and timed and np.isfinite(most).any():
            motion = MotionLimit(model, velocity=self.velocity_limits, acceleration=most)
            self.motion = MotionWindow(motion)
            self.limits = [self.motion]
        elif timed and np.isfinite(self.velocity_limits).any():
            self.window = DisplacementWindow(model, path_task.start, np.full(model.nv, np.inf))
            self.limits.append(self.window)
        self.limits += path_task.constraints

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Move the window in which the joints may move during the next waypoint."""
        self.dt = duration or 1.0
        self._began = self.ranges.positions(configuration.q)
        if self.motion is not None:
            self.motion.begin(configuration, self.dt)
        if self.window is not None:
            self.window.move(configuration.q, self.velocity_limits * self.dt)

    def speeds_left(self, configuration: mink.Configuration) -> Array:
        """What the iterations of the waypoint so far have left of the speed limits, (nv,)."""
        moved = np.abs(self.ranges.positions(configuration.q) - self._began) / self.dt
        left: Array = np.maximum(self.velocity_limits - moved, _STANDING)
        return left


class MotionWindow(BoxLimit):
    """A :class:`~qp_twist.MotionLimit` for the mean velocity over a waypoint.

    The bounds are those at the beginning of the waypoint, minus the motion of its previous
    iterations. The first step of a path may have any speed.
    """

    kind = "motion"

    def __init__(self, motion: MotionLimit) -> None:
        self.motion = motion
        self._boxes: tuple[Box, ...] = ()
        self._begin: Array | None = None
        self._dt = 1.0

    def begin(self, configuration: mink.Configuration, dt: float) -> None:
        """Begin a waypoint of ``dt`` seconds; the mean velocity of the last one is stored."""
        here = self.motion.ranges.positions(configuration.q)
        if self._begin is not None:
            self.motion.note((here - self._begin) / self._dt)
        boxes = self.motion.boxes(configuration, dt)
        if self._begin is None:
            boxes = tuple(box for box in boxes if box.kind != "acceleration")
        self._boxes, self._begin, self._dt = boxes, here, dt

    def boxes(self, configuration: mink.Configuration, dt: float) -> tuple[Box, ...]:
        """The boxes of the waypoint, minus the motion within it so far."""
        assert self._begin is not None
        moved = (self.motion.ranges.positions(configuration.q) - self._begin) / self._dt
        return tuple(Box(kind, lower - moved, upper - moved) for kind, lower, upper in self._boxes)

    def bounds(self, configuration: mink.Configuration, dt: float) -> tuple[Array, Array]:
        """The intersection of the boxes, rad/s or m/s, each (nv,)."""
        box = Intersection(self.boxes(configuration, dt), configuration.model)
        return box.lower, box.upper

    def recovering(self, configuration: mink.Configuration, dt: float) -> tuple[str, ...]:
        """A sentence for each joint outside its limits."""
        return self.motion.recovering(configuration, dt)
