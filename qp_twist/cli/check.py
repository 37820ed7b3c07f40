"""``qp-twist check``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import tyro

from qp_twist.checks import number
from qp_twist.cli.app import Flag, Json, OptionalFile, RobotName, Task, app, fail, say
from qp_twist.cli.path_tasks import load, program_joints
from qp_twist.cli.progress import working
from qp_twist.kinematics import JointRanges
from qp_twist.trajectories import check_trajectory, read_trajectory

TrajectoryFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRAJECTORY")]
Metres = Annotated[float | None, tyro.conf.arg(metavar="M")]
Degrees = Annotated[float | None, tyro.conf.arg(metavar="DEG")]


def check_tolerances(position: float | None, axis_deg: float | None) -> None:
    """Refuse options that are not above 0, by their names on the command line.

    Raises:
        InvalidInput: If one is not.
    """
    for name, value in (("--position-tolerance", position), ("--axis-tolerance-deg", axis_deg)):
        if value is not None:
            number(name, value, above=0.0)


@app.command
def check(
    trajectory: TrajectoryFile,
    task: Task,
    path: OptionalFile = None,
    position_tolerance: Metres = None,
    axis_tolerance_deg: Degrees = None,
    robot: RobotName = None,
    as_modelled: Flag = False,
    json_: Json = False,
) -> None:
    """Verify a joint trajectory, of this package or another tool, against a task.

    Exit code 0: it passes; 1: it fails, and the output says what and where; 2: it cannot be read.

    Args:
        trajectory: File that ends in .csv, .npz, .json or .mcap, or a robot program (.script, .mod,
            .src, .ls).
        task: Name of a shipped task, or path to a .toml file.
        path: Toolpath to follow instead of the task's own, e.g. path.csv.
        position_tolerance: Largest linear task error that passes, m; if omitted, as the task file
            states it in [study], else 1e-4.
        axis_tolerance_deg: Largest angular task error that passes, degrees; likewise, else 0.05.
        robot: For a program: the robot's name in the table of known robots, or a file with a table
            of its own (.toml); if omitted, recognised by name and geometry.
        as_modelled: For a program: its angles are those of the model's joints.
        json_: Print the findings as JSON.
    """
    check_tolerances(position_tolerance, axis_tolerance_deg)
    path_task = load(task, path)
    joints = program_joints(trajectory, path_task, robot, as_modelled)
    rows = read_trajectory(trajectory, JointRanges.of(path_task.shown.model).names, joints)
    with working("checking"):
        found = check_trajectory(
            rows,
            path_task,
            position_tolerance=position_tolerance,
            axis_tolerance_deg=axis_tolerance_deg,
        )
    if json_:
        print(json.dumps(found.to_dict(), ensure_ascii=False, indent=2))
    else:
        say(f"{trajectory}: {found.rows} rows, {found.waypoints} waypoints, {found.matched}")
        say(found.table().rstrip("\n"), *found.notes)
        if found.passes:
            say(found.verdict)
    if not found.passes:
        fail(f"{trajectory}: {found.verdict}")
