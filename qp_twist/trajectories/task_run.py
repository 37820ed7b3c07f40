"""A task followed, timed, written to a file and checked: what ``qp-twist run`` does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.following import Trajectory, follow
from qp_twist.paths import PathTask
from qp_twist.referee import AXIS_TOLERANCE_DEG, POSITION_TOLERANCE
from qp_twist.trajectories.check import (
    Check,
    check_trajectory,
)
from qp_twist.trajectories.refine_trajectory import refine_trajectory
from qp_twist.trajectories.time_trajectory import TimedTrajectory, time_trajectory
from qp_twist.trajectories.trajectory_file import read_trajectory, write_trajectory

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TaskRun:
    """What came of a task.

    Attributes:
        trajectory: As it was followed, at the task's waypoints.
        rows: The same with rows between waypoints, where the joints would have left the path.
        timed: With its times; ``None`` without a feed.
        check: Of the file that was written; ``None`` where the run was given up.
    """

    trajectory: Trajectory
    rows: Trajectory | None
    timed: TimedTrajectory | None
    check: Check | None

    @property
    def passes(self) -> bool:
        """Whether the whole path was followed, and the file passes its check."""
        return self.check is not None and self.check.passes

    @property
    def kept(self) -> int:
        """How many waypoints from the first one on are within the tolerances of the check."""
        trajectory = self.trajectory
        off = _off(trajectory.position_error, trajectory.axis_error)
        return int(np.argmax(off)) if off.any() else len(off)

    @property
    def held_by(self) -> str:
        """What stood in the way at the first waypoint that was missed, where that is known."""
        trajectory, index = self.trajectory, self.kept
        if trajectory.failure:
            return trajectory.failure
        return ", ".join(trajectory.binding[index]) if index < len(trajectory.binding) else ""


def run_task(
    path_task: PathTask,
    method: str,
    out: Path,
    *,
    solver: str | None = None,
    give_up: bool = False,
    progress: Callable[[int], None] | None = None,
    planning: Callable[[str, float], None] | None = None,
    timing: Callable[[], None] | None = None,
) -> TaskRun:
    """Follow a task, more slowly where limits ask for it, time it, write the file and check it.

    Whoever wants to know whether a robot does a task asks this function: the verdict on a start or
    on a placement of the workpiece is the one on the trajectory that is written for them.

    Args:
        path_task: The task.
        method: Name of the method.
        out: The file to write: ``.csv``, ``.npz`` or ``.json``.
        solver: Backend of the QPs.
        give_up: Whether to end at the first waypoint that is missed by more than the check allows.
            Then nothing is written and there is no check.
        progress: Called with the number of waypoints done.
        planning: Called, while a plan is made, with what is being done and the share of it that is.
        timing: Called when the path has been followed.

    Raises:
        InvalidInput: If the method has no start, or the file cannot be written.
    """

    def lost(q: Array, position_error: float, axis_error: float) -> bool:
        return give_up and bool(_off(np.array([position_error]), np.array([axis_error]))[0])

    trajectory = follow(
        path_task,
        method,
        solver=solver,
        slow_down=True,
        progress=progress,
        stop=lost,
        planning=planning,
    )
    run = TaskRun(trajectory, None, None, None)
    if give_up and run.kept < len(path_task.waypoints):
        return run
    if timing is not None:
        timing()
    rows = refine_trajectory(trajectory)
    timed = None if path_task.durations is None else time_trajectory(rows)
    write_trajectory(timed or rows, out)
    check = check_trajectory(read_trajectory(out, trajectory.joint_names), trajectory.path_task)
    return TaskRun(trajectory, rows, timed, check)


def _off(position_error: Array, axis_error: Array) -> Mask:
    """Which waypoints are further off the path than the check allows."""
    # A NaN, of a step that was not finite, is off, too.
    kept: Mask = (position_error <= POSITION_TOLERANCE) & (
        axis_error <= np.radians(AXIS_TOLERANCE_DEG)
    )
    return ~kept
