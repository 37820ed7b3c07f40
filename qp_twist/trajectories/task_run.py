"""Follow a task, time it, write the trajectory and check it, as ``qp-twist run`` does."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory, follow, plan
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning import Plan
from qp_twist.planning.central import best_of_each_branch, central_configurations
from qp_twist.referee import (
    Passing,
    ToolSpeed,
    motion_limits,
    tool_speed,
    with_default_accelerations,
    with_default_jerks,
)
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories.check import Check, check_trajectory
from qp_twist.trajectories.refine_trajectory import refine_trajectory
from qp_twist.trajectories.steady_speed import steady_trajectory
from qp_twist.trajectories.time_trajectory import time_trajectory
from qp_twist.trajectories.timed_path import TimedPath
from qp_twist.trajectories.trajectory_file import write_checked

_BRANCHES = 8
"""Starts of other branches that are tried: an arm with a spherical wrist has as many branches."""
_ALSO_FAST = ("travel", False), ("centering", False), ("centering", True)
"""Objectives whose plans are timed beside one in time, and whether they are as fast as speed limits
let them. A plan's times are of steps at constant speed: they know no jerk, and no change of
speed within a step. Where waypoints are 20 mm apart, the others are up to a third faster as they
are run; of deburring's 401, 1 % slower."""
_NO_TIME = 1e-6
"""Share of the feed's times that no motion keeps."""


@dataclass(frozen=True, eq=False)
class TaskRun:
    """Result of a task.

    Attributes:
        trajectory: The trajectory as it was followed.
        rows: The same with rows inserted where its joints left the path between others.
        timed: The timed trajectory; ``None`` without a feed.
        check: Check of the file; ``None`` if the run was given up, or ended at its start.
        written: Whether the file was written.
        remark: Which plan was taken for the least time, in words; empty if there was one.
    """

    trajectory: Trajectory
    rows: Trajectory | None
    timed: TimedPath | None
    check: Check | None
    written: bool = False
    remark: str = ""

    @property
    def passes(self) -> bool:
        """Whether the whole path was followed, and the file passes its check."""
        return self.check is not None and self.check.passes

    @property
    def kept(self) -> int:
        """Number of waypoints, from the first one on, within the tolerances of the check."""
        return self.trajectory.kept

    @property
    def held_by(self) -> str:
        """What held it back (:attr:`Trajectory.held_by <qp_twist.Trajectory.held_by>`)."""
        return self.trajectory.held_by


class _Timed(NamedTuple):
    """A trajectory as it was followed, with its further rows, and timed."""

    trajectory: Trajectory
    rows: Trajectory
    timed: TimedPath

    @property
    def seconds(self) -> float:
        """Time of the whole motion, s."""
        return float(self.timed.motion.times[-1])

    @property
    def speed(self) -> ToolSpeed:
        """Of its tool."""
        run, limits = self.timed.trajectory, self.timed.limits
        assert run is not None and limits is not None
        times = self.timed.motion.times[self.timed.path_rows][run.at_waypoints]
        found = tool_speed(run.path_task, self.timed.motion, Passing(times, True, False), limits)
        assert found is not None
        return found


def _at_constant_speed(
    path_task: PathTask,
    first: Trajectory,
    timed: TimedPath,
    followed: Callable[[PathTask], Trajectory],
) -> _Timed:
    """The motion whose tool is at the programmed speed on the longest part of the path.

    The path is rounded within the tolerances, and the free motion moves
    (:func:`~qp_twist.trajectories.steady_trajectory`); if dips are left that are not
    corners of the path, and the task leaves its start open, so does the branch.
    """
    limits = timed.limits
    assert limits is not None

    def steady(trajectory: Trajectory) -> _Timed:
        rows = steady_trajectory(trajectory, limits)
        return _Timed(trajectory, rows, time_trajectory(rows, limits=limits, curved=True))

    best = _better(_Timed(first, timed.trajectory or first, timed), steady(first))
    if path_task.best_start and any("corner" not in dip.causes[0] for dip in best.speed.dips):
        for other in best_of_each_branch(central_configurations(path_task), _BRANCHES):
            with suppress(InvalidInput):  # the method has no start there
                trajectory = followed(path_task.started_at(other.q))
                if trajectory.passes and trajectory.ended:
                    best = _better(best, steady(trajectory))
    return best


def _better(best: _Timed, other: _Timed) -> _Timed:
    """The other if it passes, dips aside, and is better.

    Better is one without a dip that is too deep, then with more of it at speed, then a faster one.
    """
    task = other.trajectory.path_task

    def share(of: _Timed) -> tuple[bool, float, float]:
        shallow = of.speed.finding(task.max_dip).passes
        return shallow, of.speed.at_speed, -of.seconds

    any_dip = replace(task, max_dip=None)
    better = share(other) > share(best) and check_trajectory(other.timed, any_dip).passes
    return other if better else best


def _only_time_counts(trajectory: Trajectory) -> bool:
    """Whether a motion follows a plan for nothing but the time."""
    plan = trajectory.plan
    return plan is not None and plan.objective == "time" and plan.path_task.preference is None


def _in_least_time(
    path_task: PathTask,
    best: _Timed,
    followed: Callable[[PathTask, Plan], Trajectory],
    planning: Callable[[str, float], None] | None,
) -> tuple[_Timed, str]:
    """The fastest of the motions along a plan in time and along others; and which it is, in words.

    The others are planned without the feed, since it counts as a cap only. Ctrl-C ends the search
    with the best by then.
    """
    taken, seconds = "time", {"time": best.seconds}
    task, limits, first = best.trajectory.path_task, best.timed.limits, best.trajectory.plan
    assert task.durations is not None and first is not None
    start = None if path_task.best_start is True else task.start
    with suppress(KeyboardInterrupt):
        for objective, fast in _ALSO_FAST:
            capless = replace(task, durations=_NO_TIME * task.durations if fast else None)
            found = plan(capless, objective, start, slow_down=fast, progress=planning)
            if found.interrupted:
                break
            if found.q is None:
                continue
            along = replace(found, path_task=task)
            trajectory = followed(task.started_at(found.start), along)
            if not (trajectory.passes and trajectory.ended):
                continue
            rows = refine_trajectory(trajectory)
            other = _Timed(trajectory, rows, time_trajectory(rows, limits=limits))
            name = f"speed and {objective}" if fast else objective
            seconds[name] = other.seconds
            passes = check_trajectory(other.timed, trajectory.path_task).passes
            if other.seconds < best.seconds and passes:
                taken, best = name, other
    each = ", ".join(f"{name} {value:.4g} s" for name, value in seconds.items())
    remark = f"of the plans as they are run the one for {taken} is the fastest: {each}"
    if taken != "time" and first.cuts and path_task.cuts == "fewest":  # the others lift off there
        remark = f"{remark}. In time {first.certificate}"
    return best, remark


def run_task(
    path_task: PathTask,
    method: str,
    out: Path,
    *,
    solver: str | None = None,
    joints: ControllerJoints | None = None,
    give_up: bool = False,
    force: bool = False,
    progress: Callable[[int], None] | None = None,
    planning: Callable[[str, float], None] | None = None,
    timing: Callable[[], None] | None = None,
) -> TaskRun:
    """Follow a task, slower where limits require it; time it, write the file and check it.

    A run that cannot go on ends at the last waypoint that it reached; the file has no more.

    Args:
        path_task: The task.
        method: Name of the method.
        out: The file to write, by its suffix (:func:`~qp_twist.write_trajectory`).
        solver: Backend of the QPs.
        joints: For a program: how the robot's controller counts the joints.
        force: Write a program that does not pass, with a first line at which a controller stops.
            Without it such a program is not written.
        give_up: Whether to end at the first waypoint outside the tolerances of the check. Then
            nothing is written and there is no check.
        progress: Called with the number of waypoints done.
        planning: Called during planning with the current phase and its share done.
        timing: Called after the path was followed.

    Raises:
        InvalidInput: If the method has no start, or the file cannot be written.
    """

    def lost(q: Array, position_error: float, axis_error: float) -> bool:
        return not path_task.tolerances.met(position_error, axis_error)

    if path_task.constant_speed and path_task.durations is None:
        raise InvalidInput(
            f"{path_task.name}: a constant speed of the tool needs a speed; add [feed] with speed."
        )

    def followed(path_task: PathTask, plan: Plan | None = None) -> Trajectory:
        return follow(
            path_task,
            method,
            plan=plan,
            solver=solver,
            slow_down=True,
            fine=True,
            progress=progress,
            stop=lost if give_up else None,
            planning=planning,
        )

    trajectory = followed(path_task)
    if give_up and trajectory.interrupted_plan is not None:  # a search of many runs ends, too
        raise KeyboardInterrupt
    run = TaskRun(trajectory, None, None, None)
    if (give_up and run.kept < len(path_task.waypoints)) or len(trajectory.q) < 2:
        return run
    if timing is not None:
        timing()
    rows = refine_trajectory(trajectory)
    timed, remark = None, ""
    if path_task.durations is not None:
        ranges = JointRanges.of(path_task.model)
        limits = with_default_accelerations(motion_limits(path_task), ranges)
        timed = time_trajectory(rows, limits=with_default_jerks(limits))
        if path_task.constant_speed and trajectory.passes:
            trajectory, rows, timed = _at_constant_speed(path_task, trajectory, timed, followed)
        elif trajectory.passes and _only_time_counts(trajectory):
            fastest, remark = _in_least_time(
                path_task, _Timed(trajectory, rows, timed), followed, planning
            )
            trajectory, rows, timed = fastest
    check, written = write_checked(
        timed or rows,
        out,
        trajectory.path_task,
        joints,
        joint_names=trajectory.joint_names,
        force=force,
    )
    return TaskRun(trajectory, rows, timed, check, written, remark)
