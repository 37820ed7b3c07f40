"""``qp-twist report``."""

from __future__ import annotations

from pathlib import Path

from qp_twist.cli.app import (
    Flag,
    Folder,
    OptionalFile,
    RobotName,
    Task,
    app,
    check_folder,
    fail,
    say,
)
from qp_twist.cli.check import Degrees, Metres, TrajectoryFile, check_tolerances
from qp_twist.cli.path_tasks import load, program_joints
from qp_twist.cli.progress import working
from qp_twist.kinematics import JointRanges
from qp_twist.trajectories import read_trajectory


@app.command
def report(
    trajectory: TrajectoryFile,
    task: Task,
    out: Folder = None,
    path: OptionalFile = None,
    position_tolerance: Metres = None,
    axis_tolerance_deg: Degrees = None,
    robot: RobotName = None,
    as_modelled: Flag = False,
) -> None:
    """Write a page about one motion: it moves, whether it passes, its time, what it keeps.

    The page, report.html, is one file that opens without a network; it is printed on two pages of
    A4. Exit code 1: it is written, and the motion does not pass.

    Args:
        trajectory: File that ends in .csv, .npz, .json or .mcap, or a robot program (.script, .mod,
            .src, .ls).
        task: Name of a shipped task, or path to a .toml file.
        out: Folder to write to; if omitted, out/NAME_report with the trajectory's name.
        path: Toolpath to check against instead of the task's own, e.g. path.csv.
        position_tolerance: Largest linear task error that passes, m; if omitted, as the task file
            states it in [study], else 1e-4.
        axis_tolerance_deg: Largest angular task error that passes, degrees; likewise, else 0.05.
        robot: For a program: the robot's name in the table of known robots, or a file with a table
            of its own (.toml); if omitted, recognised by name and geometry.
        as_modelled: For a program: its angles are those of the model's joints.
    """
    from qp_twist.pages import report as report_motion  # with what draws

    check_tolerances(position_tolerance, axis_tolerance_deg)
    folder = out or Path("out") / f"{trajectory.stem}_report"
    check_folder(folder)
    path_task = load(task, path)
    joints = program_joints(trajectory, path_task, robot, as_modelled)
    rows = read_trajectory(trajectory, JointRanges.of(path_task.shown.model).names, joints)
    with working("checking and drawing"):
        made = report_motion(
            rows,
            path_task,
            folder,
            file=trajectory.name,
            position_tolerance=position_tolerance,
            axis_tolerance_deg=axis_tolerance_deg,
        )
    say(f"wrote {made.path}")
    if made.remark:
        say(made.remark)
    if not made.check.passes:
        fail(f"{trajectory}: {made.check.verdict}")
    say(made.check.verdict)
