"""``qp-twist run``."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import failure, load, program_joints, with_secondary
from qp_twist.cli.progress import load_machine_code, method_progress, working
from qp_twist.comparison.metrics import status_of_rows
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory
from qp_twist.paths import DEFAULT_METHOD, PathTask, check_method
from qp_twist.trajectories import ENDINGS, Check, TaskRun, TimedPath, check_program, run_task

_OTHERWISE = "qp_planned"
"""The method where none is named, and the default one does not pass."""
_STRETCHES = 8
"""Largest number of slowed stretches that are listed."""


@cli.command
def run(
    task: cli.Task,
    out: cli.File,
    method: cli.OptionalMethod = None,
    solver: cli.Solver = None,
    path: cli.OptionalFile = None,
    gain: cli.Gain = None,
    weight: cli.Weight = None,
    report: cli.Folder = None,
    robot: cli.RobotName = None,
    as_modelled: cli.Flag = False,
    external: cli.External = None,
    feed: cli.FeedMode = None,
    max_dip: cli.Share = None,
    calls: cli.Calls = None,
    force: cli.Flag = False,
    json_: cli.Json = False,
) -> None:
    """Follow a task with one method, time it, write the joint trajectory and check the file.

    The path is kept: where limits require it, it is followed more slowly, and the output says
    where. Exit code 1: the motion does not pass; the output says what fails, and where. A robot
    program is not written then; another file is.

    Args:
        method: Method name; if omitted, qp_gradient, and where it does not pass, qp_planned
            (without --gain and --weight, which are the method's own); with a [preference] at once.
        out: File to write: trajectory.csv, .npz, or .json in the fields of ROS' JointTrajectory; a
            ROS 2 bag (.mcap); a robot program (.script, .mod, .src, .ls). A missing folder is
            created, with a note.
        report: Folder for the motion's report, the page of qp-twist report.
    """
    path_task = load(task, path, feed, max_dip, calls)
    stated = gain is not None or weight is not None
    methods = [method] if method is not None else _methods(path_task, stated=stated)
    path_task = with_secondary(path_task, [check_method(methods[0])], gain, weight)
    cli.check_file(out)
    if report is not None:
        cli.check_folder(report, "--report")
    if out.suffix.lower() not in ENDINGS:
        raise InvalidInput(f"--out {out}: expected a file that ends in {', '.join(ENDINGS)}.")
    joints = program_joints(out, path_task, robot, as_modelled, external)
    if joints is not None:
        check_program(out, joints, path_task)
    elif force:
        raise InvalidInput("--force is for programs; other files are always written.")
    cli.only_json(json_)
    load_machine_code(path_task, methods, solver)
    with method_progress(methods, len(path_task.waypoints) - 1) as progress:

        def followed(method: str) -> TaskRun:
            return run_task(
                path_task,
                method,
                out,
                solver=solver,
                joints=joints,
                force=force,
                progress=lambda waypoints: progress.done(method, waypoints),
                planning=progress.planning,
                timing=lambda: progress.says("timing and checking"),
            )

        done, before = _first_that_passes(methods, followed)
    trajectory, rows, timed, check = done.trajectory, done.rows, done.timed, done.check
    method, how = trajectory.method, [*before, *_how(trajectory, stated=stated)]
    if done.remark:
        how.append(f"{method}: {done.remark}")
    if rows is None or check is None:
        cli.say(*how)
        cli.fail(f"{out}: not written: {method} {trajectory.ending}")
    what = f"wrote {out}" if done.written else f"did not write {out}"
    count = int(trajectory.at_waypoints.sum())
    cli.say(f"{what}: {count} waypoints, {method}: {trajectory.summary}", *how)
    if len(rows.q) > count:
        more = len(rows.q) - count
        left = "path, or the tool its speed" if path_task.constant_speed else "path"
        cli.say(f"{more} rows more between waypoints, where the joints would have left the {left}")
    cli.say(*_timing(timed, rows), *check.notes)
    if report is not None:
        from qp_twist.pages import write_report  # with what draws

        with working("drawing the report"):
            made = write_report(trajectory.path_task, check, report, file=out.name)
        cli.say(*filter(None, (f"wrote {made.path}", made.remark)))
    if json_:
        cli.show_json(_facts(out, done, check))
    if not check.passes:
        cli.fail(failure(out, check, done.written))
    cli.say(check.verdict)


def _methods(path_task: PathTask, *, stated: bool) -> list[str]:
    """The methods that are tried where none is named; only one with its settings ``stated``."""
    if path_task.preference is not None:
        return [_OTHERWISE]  # which weighs it
    return [DEFAULT_METHOD] if stated else [DEFAULT_METHOD, _OTHERWISE]


def _facts(out: Path, done: TaskRun, check: Check) -> dict[str, Any]:
    """What ``--json`` prints."""
    trajectory, timed = done.trajectory, done.timed
    at_feed = trajectory.path_task.feed_time if timed is not None else None
    return {
        "file": str(out),
        "written": done.written,
        "method": trajectory.method,
        "seconds": float(timed.motion.times[-1]) if at_feed is not None and timed else None,
        "seconds_at_feed": at_feed,
        "planning_interrupted": trajectory.interrupted_plan is not None,
        "check": check.to_dict(),
    }


def _first_that_passes(
    methods: Sequence[str], followed: Callable[[str], TaskRun]
) -> tuple[TaskRun, list[str]]:
    """The run of the first method that passes, or else of the last; and a line for each before.

    A method that refuses the task, or has no plan, is no reason to lose the run before.
    """
    done, lines = followed(methods[0]), list[str]()
    for before, method in itertools.pairwise(methods):
        if done.passes:
            break
        why = done.check.verdict if done.check else done.trajectory.ending
        lines.append(f"{before}: {why}")
        try:
            done = followed(method)
        except InvalidInput as error:
            lines.append(f"{method}: {error}")
    return done, lines


def _timing(timed: TimedPath | None, rows: Trajectory) -> list[str]:
    """Lines about times: what was added, how long, where slower than the feed."""
    if timed is None or timed.trajectory is None or rows.path_task.durations is None:
        return []
    lines, more = [], len(timed.q) - len(rows.q)
    if more:
        lines.append(
            f"{more} rows more where speeds change, and beside corners, which are rounded within "
            "the tolerances"
        )
    moves, total = timed.trajectory.path.moves, f"{timed.motion.times[-1]:.4g} s"
    whole = "" if rows.ended else "the whole path takes "
    if moves.any():
        durations = np.diff(timed.motion.times[timed.path_rows])
        total += f", {durations[moves].sum():.4g} s of it in joint moves"
        whole = whole or "the path takes "
    lines.append(f"{total}; {whole}{rows.path_task.feed_time:.4g} s at the feed")
    if rows.path_task.constant_speed:  # the check names its dips
        return lines
    lines += [f"slower at {stretch}" for stretch in timed.slowed[:_STRETCHES]]
    if len(timed.slowed) > _STRETCHES:
        lines.append(f"slower at {len(timed.slowed) - _STRETCHES} more stretches")
    return lines


def _how(trajectory: Trajectory, *, stated: bool) -> list[str]:
    """The method's settings, ``stated`` in the command or not, and what was unusual."""
    path_task, method = trajectory.path_task, trajectory.method
    own = path_task.methods.get(method)
    in_file = own is not None and own.model_fields_set & {"secondary", "weight", "gain"}
    source = "of the command" if stated else "of the task file" if in_file else "default"
    lines = [f"{method}: {path_task.settings(method)} ({source})"]
    if (plan := trajectory.interrupted_plan) is not None:
        lines.insert(0, f"{method}: planning was interrupted; the best plan by then: {plan.result}")
    elif (plan := trajectory.plan) is not None and (plan.cuts or plan.certificate.slower > 1.0):
        lines.append(f"{method}: {plan.certificate}")
    if plan is not None and plan.preferred:
        lines.append(f"{method}: {plan.preferred}")
    elif path_task.preference is not None:
        lines.append(f"{method}: does not weigh [preference], as {_OTHERWISE} does")
    status = status_of_rows(trajectory)
    return [*lines, f"{method}: {status}"] if status else lines
