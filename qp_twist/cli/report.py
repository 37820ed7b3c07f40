"""``qp-twist report``."""

from __future__ import annotations

from pathlib import Path

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load, read_motion
from qp_twist.cli.progress import working


@cli.command
def report(
    trajectory: cli.TrajectoryFile,
    task: cli.Task,
    out: cli.Folder = None,
    path: cli.OptionalFile = None,
    position_tolerance: cli.Metres = None,
    axis_tolerance_deg: cli.Degrees = None,
    robot: cli.RobotName = None,
    as_modelled: cli.Flag = False,
    external: cli.External = None,
    feed: cli.FeedMode = None,
    max_dip: cli.Share = None,
    calls: cli.Calls = None,
) -> None:
    """Write a page about one motion: it moves, whether it passes, its time, what it keeps.

    The page, report.html, is one file that opens without a network; it is printed on two pages of
    A4. Exit code 1: it is written, and the motion does not pass.

    Args:
        out: Folder to write to; if omitted, out/NAME_report with the trajectory's name.
        path: Toolpath to check against instead of the task's own, e.g. path.csv.
    """
    from qp_twist.pages import report as report_motion  # with what draws

    folder = out or Path("out") / f"{trajectory.stem}_report"
    cli.check_folder(folder)
    path_task = load(task, path, feed, max_dip, calls)
    rows = read_motion(trajectory, path_task, robot, as_modelled, external)
    with working("checking and drawing"):
        made = report_motion(
            rows,
            path_task,
            folder,
            file=trajectory.name,
            position_tolerance=position_tolerance,
            axis_tolerance_deg=axis_tolerance_deg,
        )
    cli.say(f"wrote {made.path}")
    if made.remark:
        cli.say(made.remark)
    if not made.check.passes:
        cli.fail(f"{trajectory}: {made.check.verdict}")
    cli.say(made.check.verdict)
