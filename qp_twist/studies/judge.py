"""Criterion of success: the first fault of a joint path at its waypoints, if any.

Between waypoints only the length of the joints' steps is judged: a study counts at how many
placements a method meets its waypoints. Use :func:`~qp_twist.check_trajectory` to check a
trajectory for a robot between them, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from qp_twist.checks import Array
from qp_twist.comparison.metrics import BAND_LEFT, OUTSIDE
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.paths.task_schema import StudySection
from qp_twist.planning import motion_limits

Kind = Literal[
    "limit",
    "jump",
    "band",
    "constraint",
    "held",
    "error",
    "no step",
    "diverged",
    "start",
    "no plan",
    "raised",
]

_AT = 1e-4
"""A joint is at its limit, of position or of speed, within this, rad or m."""
_ROUNDING = 1e-9
"""Longer by less is rounding, rad or m."""


@dataclass(frozen=True)
class Fault:
    """Why a run is no success.

    Attributes:
        kind: ``limit``: a joint left its range; ``jump``: it moved further than it may from a
            waypoint to the next; ``band``: a tolerance band was left; ``constraint``: a constraint
            was; ``held``: the task's error is too large, with joints at their limits; ``error``:
            the same, with none; ``no step``: a step had no result; ``diverged``: it was not finite;
            ``start``: there is no configuration to start from; ``no plan``: there is no plan to
            follow; ``raised``: something was raised, or the process died.
        joint: The joints that it is about, or the margin of a constraint: of a clearance the names
            of two geoms.
        waypoint: Where, counted from 1.
        message: What else there is to say.
    """

    kind: Kind
    joint: str = ""
    waypoint: int = 1
    message: str = ""


class Judge:
    """Looks at the waypoints of a path, one after the other or all at once."""

    def __init__(self, path_task: PathTask, section: StudySection) -> None:
        self.ranges = JointRanges.of(path_task.model)
        self._position_error = section.position_error
        self._axis_error = np.radians(section.axis_error_deg)
        self._steps = motion_limits(path_task, self.ranges, None, fixed_start=False).steps
        self._before: Array | None = None
        self._waypoint = 1

    def stop(self, q: Array, position_error: float, axis_error: float) -> bool:
        """Whether the run has a fault; for :func:`~qp_twist.follow`, after the first waypoint."""
        self._waypoint += 1
        fault = self._at(self._waypoint, self._before, q, position_error, axis_error)
        self._before = q.copy()
        return fault is not None

    def fault(self, trajectory: Trajectory) -> Fault | None:
        """The first fault of a whole run; ``None`` if it is a success."""
        count, before = len(trajectory.path_task.waypoints), None
        left = trajectory.constraint_excess
        for index, q in enumerate(trajectory.q):
            errors = trajectory.position_error[index], trajectory.axis_error[index]
            fault = self._at(index + 1, before, q, *map(float, errors))
            if index + 1 == trajectory.diverged_at:
                return Fault("diverged", waypoint=index + 1)
            if fault is None and trajectory.band_excess[index] > BAND_LEFT:
                return Fault("band", waypoint=index + 1)
            if fault is None and left[index] > BAND_LEFT:
                name = _violated(trajectory.path_task, q)
                return Fault("constraint", name, waypoint=index + 1)
            if fault is not None:
                if trajectory.failure:
                    return Fault("no step", waypoint=index + 1, message=trajectory.failure)
                return fault
            before = q
        if trajectory.failure:
            return Fault("no step", waypoint=len(trajectory.q), message=trajectory.failure)
        return None if len(trajectory.q) == count else Fault("error", waypoint=len(trajectory.q))

    def _at(
        self,
        waypoint: int,
        before: Array | None,
        q: Array,
        position_error: float,
        axis_error: float,
    ) -> Fault | None:
        if not np.isfinite([*q, position_error, axis_error]).all():
            return Fault("diverged", waypoint=waypoint)
        room = self.ranges.room(q)
        if (room < -OUTSIDE).any():
            return Fault("limit", self.ranges.names[int(np.argmin(room))], waypoint)
        left = np.full(len(q), np.inf)
        if before is not None:
            left = self._steps[waypoint - 2] - np.abs(q - before)
        if (left < -_ROUNDING).any():
            return Fault("jump", self.ranges.names[int(np.argmin(left))], waypoint)
        if position_error > self._position_error or axis_error > self._axis_error:
            at_limit = (room < _AT) | (left < _AT)
            held = [n for n, at in zip(self.ranges.names, at_limit, strict=True) if at]
            return Fault("held" if held else "error", "+".join(held), waypoint)
        return None


def _violated(path_task: PathTask, q: Array) -> str:
    """Name of the margin of the constraints that a configuration q (nq,) violates most."""
    margins = {
        name: float(margin)
        for constraint in path_task.stated_constraints
        for name, margin in zip(constraint.names, constraint.bounded(q[None], 0.0)[0], strict=True)
    }
    return min(margins, key=lambda name: margins[name])
