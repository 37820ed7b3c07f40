"""One run of a method along the path, with its state at each waypoint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.comparison.metrics import metrics
from qp_twist.following import Trajectory, follow, with_start
from qp_twist.kinematics import JointRanges, frame_pose
from qp_twist.paths import PathTask
from qp_twist.viewing.projectors import roll, with_projector
from qp_twist.viewing.settings import PageSettings, effective, without_limits

Progress = Callable[[float, str], None]
"""Called with the share done, from 0 to 1, and the current phase."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The data of one configuration that the page shows.

    Attributes:
        q: The configuration, rad or m, (nq,).
        z: z = ½‖W(θ̄ − θ)‖².
        margins: 1 − |θ − θ̄|/half-range of each joint, (nv,); negative outside.
        roll: Rotation about the tool's axis, rad; ``None`` without such an axis.
        scale: Scale s of the task.
        position_error: Length of the linear task error, m.
        axis_error: Length of the angular task error, in the rows of the task, rad.
        sigma_min: Smallest singular value of the task rows.
        binding: The active limits, by name.
        sentence: Status of the step; empty for a waypoint, whose run has a status.
        solved: Whether the step is as desired; likewise.
    """

    q: Array
    z: float
    margins: Array
    roll: float | None
    scale: float = 1.0
    position_error: float = 0.0
    axis_error: float = 0.0
    sigma_min: float = 0.0
    binding: tuple[str, ...] = ()
    sentence: str = ""
    solved: bool = True

    @classmethod
    def at(cls, path_task: PathTask, q: Array, target: mink.SE3, **others: Any) -> Moment:
        """A configuration with the attributes that follow from it, and the others."""
        ranges = JointRanges.of(path_task.model)
        angle = roll(path_task, mink.Configuration(path_task.model, q), target)
        return cls(q, float(ranges.centering(q)), ranges.margins(q), angle, **others)


@dataclass(frozen=True, eq=False)
class Run:
    """A trajectory with the data that the page shows.

    Attributes:
        trajectory: Result of :func:`~qp_twist.follow`. Its task has the robot's limits, even if
            they were switched off.
        status: The run in a sentence.
        trace: Positions of the frame's origin, m, (N, 3).
    """

    trajectory: Trajectory
    status: str
    trace: Array

    def moment(self, index: int) -> Moment:
        """The run at a waypoint, counted from 0."""
        run = self.trajectory
        numbers = ("scale", "position_error", "axis_error", "sigma_min")
        return Moment.at(
            run.path_task, run.q[index], run.path_task.waypoints[index],
            **{name: float(getattr(run, name)[index]) for name in numbers},
            binding=run.binding[index],
        )  # fmt: skip


def run_once(path_task: PathTask, settings: PageSettings, progress: Progress | None = None) -> Run:
    """Follow a task with the settings of the page.

    Raises:
        InvalidInput: If the method cannot follow the task; with the reason.
    """
    report: Progress = progress or (lambda share, what: None)
    steps, changeable = max(1, len(path_task.waypoints) - 1), effective(settings)
    task = with_projector(path_task, settings.projector) if "projector" in changeable else path_task
    task = with_start(task, lambda what, share: report(share, f"looking for a start: {what}"))
    followed, method = task, settings.applied(task)
    if "limits" in changeable and not settings.limits:
        followed, method = without_limits(task, method)
    trajectory = follow(
        dataclasses.replace(followed, methods={**task.methods, settings.method: method}),
        settings.method,
        solver=settings.solver,
        progress=lambda done: report(done / steps, f"{settings.method}: {done} of {steps} steps"),
        planning=lambda what, share: report(share, f"planning: {what}"),
    )
    trajectory = dataclasses.replace(trajectory, path_task=task)
    configuration, trace = mink.Configuration(task.model), []
    for q in trajectory.q:
        configuration.update(q)
        trace.append(frame_pose(configuration, task.frame_name, task.frame_type)[1])
    return Run(trajectory, metrics(trajectory)["status"], np.array(trace))
