"""The limits shared by the QPs of a path."""

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
from qp_twist.paths import PathTask


class WaypointLimits:
    """The limits of a path's QPs, and their state from waypoint to waypoint.

    Shared by all resolvers of a path: the state does not depend on the resolver or the number of
    iterations.

    Attributes:
        limits: The limits of the controllers.
        dt: Duration of the current waypoint, s.
    """

    def __init__(self, path_task: PathTask, *, accelerations: bool = True) -> None:
        model = path_task.model
        self.limits: list[mink.Limit] = [PositionLimit(model)]
        self.velocity_limits = path_task.velocity_limits
        self.window: DisplacementWindow | None = None
        self.motion: MotionWindow | None = None
        timed = path_task.durations is not None
        if accelerations and timed and np.isfinite(path_task.acceleration_limits).any():
            self.motion = MotionWindow(
                MotionLimit(
                    model,
                    velocity=path_task.velocity_limits,
                    acceleration=path_task.acceleration_limits,
                )
            )
            self.limits = [self.motion]
        elif timed and np.isfinite(self.velocity_limits).any():
            unbounded = np.full(model.nv, np.inf)
            self.window = DisplacementWindow(model, path_task.start, unbounded)
            self.limits.append(self.window)
        self.limits += path_task.constraints
        self.dt = 1.0

    def begin_waypoint(self, configuration: mink.Configuration, duration: float | None) -> None:
        """Move the window in which the joints may move during the next waypoint."""
        if self.motion is not None:
            self.motion.begin(configuration, duration or 1.0)
        if self.window is not None:
            self.window.move(configuration.q, self.velocity_limits * (duration or 1.0))
        self.dt = duration or 1.0


class MotionWindow(BoxLimit):
    r"""A :class:`~qp_twist.MotionLimit` for the mean velocity over a waypoint.

    The bounds are those of the motion limit at the beginning of the waypoint, minus the motion of
    its previous iterations. The first step of a path may have any speed: accelerations are limited
    from the second step on.
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
        entered = self._begin is not None
        if self._begin is not None:
            self.motion.note((here - self._begin) / self._dt)
        self._boxes = tuple(
            box
            for box in self.motion.boxes(configuration, dt)
            if entered or box.kind != "acceleration"
        )
        self._begin, self._dt = here, dt

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
