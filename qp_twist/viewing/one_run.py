"""One run of a method along the path, with its state at each waypoint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.comparison.metrics import metrics
from qp_twist.following import Trajectory, follow, with_start
from qp_twist.kinematics import frame_pose
from qp_twist.paths import PathTask
from qp_twist.viewing.projectors import Roll, with_projector
from qp_twist.viewing.settings import PageSettings, without_limits

Progress = Callable[[float, str], None]
"""Called with the share done, from 0 to 1, and the current phase."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The data of one configuration that the page shows.

    Attributes:
        q: The configuration, rad or m, (nq,).
        scale: Scale s of the task.
        position_error: Length of the linear task error, m.
        axis_error: Length of the angular task error, in the rows of the task, rad.
        sigma_min: Smallest singular value of the task rows.
        z: z = ½‖W(θ̄ − θ)‖².
        margins: 1 − |θ − θ̄|/half-range of each joint, (nv,); negative outside.
        binding: The active limits, by name.
        roll: Rotation about the tool's axis, rad; ``None`` without such an axis.
        sentence: Status of the step; empty for a waypoint, whose run has a status.
    """

    q: Array
    scale: float
    position_error: float
    axis_error: float
    sigma_min: float
    z: float
    margins: Array
    binding: tuple[str, ...] = ()
    roll: float | None = None
    sentence: str = ""


@dataclass(frozen=True, eq=False)
class Run:
    """A trajectory with the data that the page shows.

    Attributes:
        settings: Settings of the run.
        trajectory: Result of :func:`~qp_twist.follow`. Its task has the robot's limits, even if
            they were switched off.
        status: The run in a sentence.
        roll: Roll at each waypoint, rad, (N,); ``None`` without a roll axis.
        trace: Positions of the frame's origin, m, (N, 3).
    """

    settings: PageSettings
    trajectory: Trajectory
    status: str
    roll: Array | None
    trace: Array

    def __len__(self) -> int:
        return len(self.trajectory.q)

    def __repr__(self) -> str:
        return f"Run({self.trajectory!r}, {self.status!r})"

    def moment(self, index: int) -> Moment:
        """The run at a waypoint, counted from 0."""
        run = self.trajectory
        return Moment(
            q=run.q[index],
            scale=float(run.scale[index]),
            position_error=float(run.position_error[index]),
            axis_error=float(run.axis_error[index]),
            sigma_min=float(run.sigma_min[index]),
            z=float(run.z[index]),
            margins=run.margins[index],
            binding=run.binding[index],
            roll=None if self.roll is None else float(self.roll[index]),
        )


def run_once(path_task: PathTask, settings: PageSettings, progress: Progress | None = None) -> Run:
    """Follow a task with the settings of the page.

    Raises:
        InvalidInput: If the method cannot follow the task; with the reason.
    """
    report: Progress = progress or (lambda share, what: None)
    steps = max(1, len(path_task.waypoints) - 1)
    chosen = with_projector(path_task, settings.projector) if settings.has_projector else path_task
    chosen = with_start(chosen, lambda what, share: report(share, f"looking for a start: {what}"))
    task, method = chosen, settings.applied(chosen)
    if settings.has_limits and not settings.limits:
        task, method = without_limits(chosen, method)
    trajectory = follow(
        dataclasses.replace(task, methods={**task.methods, settings.method: method}),
        settings.method,
        solver=settings.solver,
        progress=lambda done: report(done / steps, f"{settings.method}: {done} of {steps} steps"),
        planning=lambda what, share: report(share, f"planning: {what}"),
    )
    trajectory = dataclasses.replace(trajectory, path_task=chosen)
    return Run(settings, trajectory, metrics(trajectory)["status"], *_rolls(trajectory))


def _rolls(trajectory: Trajectory) -> tuple[Array | None, Array]:
    """The roll at each waypoint, (N,), and the frame's positions, (N, 3)."""
    task = trajectory.path_task
    roll, configuration = Roll(task), mink.Configuration(task.model)
    rolls, trace = [], []
    for q, waypoint in zip(trajectory.q, task.waypoints, strict=False):
        configuration.update(q)
        rolls.append(roll.at(configuration, waypoint))
        trace.append(frame_pose(configuration, task.frame_name, task.frame_type)[1])
    known = [angle for angle in rolls if angle is not None]
    return (np.array(known) if len(known) == len(rolls) else None), np.array(trace)
