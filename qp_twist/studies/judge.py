"""The first fault of a joint path at its waypoints, by the referee's tolerances.

Between waypoints only the length of the joints' steps is judged: a study counts at how many
placements a method meets its waypoints. Use :func:`~qp_twist.check_trajectory` to check a
trajectory for a robot between them, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from qp_twist.checks import Array
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning import motion_limits
from qp_twist.referee import EXCEEDED

Kind = Literal[
    "limit", "jump", "band", "constraint", "held", "error", "no step", "diverged", "start",
    "no plan", "raised",
]  # fmt: skip

_AT = 1e-4
"""A joint is named as held by its limit, of position or of speed, within this, rad or m."""


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

    def __init__(self, path_task: PathTask) -> None:
        self.ranges = JointRanges.of(path_task.model)
        self._tolerances = path_task.tolerances
        self._steps = motion_limits(path_task, self.ranges).steps
        self._before: Array | None = None
        self._waypoint = 1

    def stop(self, q: Array, position_error: float, axis_error: float) -> bool:
        """Whether the run has a fault; for :func:`~qp_twist.follow`, after the first waypoint."""
        self._waypoint += 1
        fault = self._at(self._waypoint, self._before, q, position_error, axis_error)
        self._before = q.copy()
        return fault is not None

    def fault(self, run: Trajectory) -> Fault | None:
        """The first fault of a whole run; ``None`` if it is a success."""
        verdict, fault = run.verdict, None
        for k, q in enumerate(run.q):
            before = None if k == 0 else run.q[k - 1]
            errors = float(run.position_error[k]), float(run.axis_error[k])
            fault = self._at(k + 1, before, q, *errors)
            if k + 1 == run.diverged_at:
                return Fault("diverged", waypoint=k + 1)
            if fault is None and verdict.band[k]:
                return Fault("band", waypoint=k + 1)
            if fault is None and verdict.constraint[k]:
                return Fault("constraint", _violated(run.path_task, q), k + 1)
            if fault is not None:
                break
        if run.failure:
            return Fault("no step", waypoint=k + 1, message=run.failure)
        if fault is None and len(run.q) < len(run.path_task.waypoints):
            return Fault("error", waypoint=k + 1)
        return fault

    def _at(
        self, waypoint: int, before: Array | None, q: Array, position_error: float,
        axis_error: float,
    ) -> Fault | None:  # fmt: skip
        if not np.isfinite([*q, position_error, axis_error]).all():
            return Fault("diverged", waypoint=waypoint)
        names, room = np.array(self.ranges.names), self.ranges.room(q)
        if (room < -self._tolerances.joint_range).any():
            return Fault("limit", str(names[np.argmin(room)]), waypoint)
        left = np.full(len(q), np.inf)
        if before is not None:
            most = self._steps[waypoint - 2]
            left = most - np.abs(q - before)
            if (left < -EXCEEDED * most).any():
                return Fault("jump", str(names[np.argmin(left)]), waypoint)
        if not self._tolerances.met(position_error, axis_error):
            held = "+".join(names[(room < _AT) | (left < _AT)])
            return Fault("held" if held else "error", held, waypoint)
        return None


def _violated(path_task: PathTask, q: Array) -> str:
    """Name of the margin of the constraints that a configuration q (nq,) violates most."""
    margins = {
        name: float(margin)
        for constraint in path_task.stated_constraints
        for name, margin in zip(constraint.names, constraint.bounded(q[None], 0.0)[0], strict=True)
    }
    return min(margins, key=lambda name: margins[name])
