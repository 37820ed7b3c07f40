"""The limits that the QPs of a path share."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.limits import DisplacementWindow, PositionLimit
from qp_twist.path import PathTask


class WaypointLimits:
    """The limits of a path's QPs, and their state from waypoint to waypoint.

    All resolvers of a path share one: what the robot did last does not depend on which of them
    moved it.

    Attributes:
        limits: For the controllers.
        dt: Time of the waypoint under way, s.
    """

    def __init__(self, path_task: PathTask) -> None:
        model = path_task.model
        self.limits: list[mink.Limit] = [PositionLimit(model)]
        self.velocity_limits = path_task.velocity_limits
        self.window: DisplacementWindow | None = None
        if path_task.durations is not None and np.isfinite(self.velocity_limits).any():
            unbounded = np.full(model.nv, np.inf)
            self.window = DisplacementWindow(model, path_task.start, unbounded)
            self.limits.append(self.window)
        self.dt = 1.0

    def begin_waypoint(self, q: Array, duration: float | None) -> None:
        """Open the window in which the joints may move until the next waypoint is due."""
        self.dt = 1.0 if duration is None else duration
        if self.window is not None:
            self.window.move(q, self.velocity_limits * self.dt)
