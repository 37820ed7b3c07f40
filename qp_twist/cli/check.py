"""``qp-twist check``."""

from __future__ import annotations

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load, read_motion
from qp_twist.cli.progress import working
from qp_twist.trajectories import check_trajectory


@cli.command
def check(
    trajectory: cli.TrajectoryFile,
    task: cli.Task,
    path: cli.OptionalFile = None,
    position_tolerance: cli.Metres = None,
    axis_tolerance_deg: cli.Degrees = None,
    robot: cli.RobotName = None,
    as_modelled: cli.Flag = False,
    external: cli.External = None,
    feed: cli.FeedMode = None,
    max_dip: cli.Share = None,
    calls: cli.Calls = None,
    json_: cli.Json = False,
) -> None:
    """Verify a joint trajectory, of this package or another tool, against a task.

    Exit code 0: it passes; 1: it fails, and the output says what and where; 2: it cannot be read.
    """
    path_task = load(task, path, feed, max_dip, calls)
    rows = read_motion(trajectory, path_task, robot, as_modelled, external)
    with working("checking"):
        found = check_trajectory(
            rows,
            path_task,
            position_tolerance=position_tolerance,
            axis_tolerance_deg=axis_tolerance_deg,
        )
    if json_:
        cli.show_json(found.to_dict())
    else:
        cli.say(f"{trajectory}: {found.rows} rows, {found.waypoints} waypoints, {found.matched}")
        cli.say(found.table().rstrip("\n"), *found.notes)
        if found.passes:
            cli.say(found.verdict)
    if not found.passes:
        cli.fail(f"{trajectory}: {found.verdict}")
