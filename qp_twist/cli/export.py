"""``qp-twist export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from qp_twist.checks import did_you_mean
from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import failure, load
from qp_twist.cli.progress import working
from qp_twist.errors import InvalidInput
from qp_twist.files import of_file
from qp_twist.kinematics import JointRanges
from qp_twist.programs import DIALECTS, dialect_of
from qp_twist.trajectories import (
    Check,
    joints_of,
    read_trajectory,
    write_checked,
    write_trajectory,
)
from qp_twist.trajectories.program_trajectory import check_language

OptionalTask = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")]
Language = Annotated[str | None, tyro.conf.arg(metavar="urscript|rapid|krl|ls|mcap")]
BAG = ".mcap"
_SUFFIX = {**{name: dialect.suffix for name, dialect in DIALECTS.items()}, "mcap": BAG}


@cli.command
def export(
    trajectory: cli.TrajectoryFile,
    task: OptionalTask = None,
    to: Language = None,
    out: cli.OptionalFile = None,
    robot: cli.RobotName = None,
    as_modelled: cli.Flag = False,
    path: cli.OptionalFile = None,
    force: cli.Flag = False,
    json_: cli.Json = False,
) -> None:
    """Write a trajectory file as a robot program or a ROS 2 bag, and check what was written.

    With a task the robot is recognised by name and geometry, and the program is read back and
    checked; one that does not pass is not written. Without a task, name the robot; nothing is
    checked then. No controller has run these programs.

    Args:
        trajectory: File that ends in .csv, .npz, .json or .mcap.
        task: Name of a shipped task, or path to a .toml file: the trajectory's.
        to: urscript, rapid, krl, ls or mcap; if omitted, by the suffix of --out.
        out: File to write; if omitted, the trajectory's name with the suffix of the language.
        path: Toolpath to check against instead of the task's own.
    """
    by_name = out is not None
    out = _destination(trajectory, to, out)
    cli.check_file(out)
    dialect = dialect_of(out)
    if dialect is None and (robot is not None or as_modelled or force):
        raise InvalidInput(
            "--robot, --as-modelled and --force are for programs; a bag has the model's joints."
        )
    if task is None and (path is not None or force):
        option = "--force" if force else "--path"
        raise InvalidInput(f"{option} is for the check, which needs a task; give the task, too.")
    path_task = None if task is None else load(task, path)
    names = None if path_task is None else JointRanges.of(path_task.shown.model).names
    if dialect_of(trajectory) is not None:
        raise InvalidInput(
            f"{trajectory}: is a program already; export from the trajectory that it was made of."
        )
    rows = read_trajectory(trajectory, names)
    joints = None
    if dialect is not None:
        joints = joints_of(path_task, rows.joint_names, robot=robot, as_modelled=as_modelled)
        with of_file(out if by_name else f"--to {to}"):
            use = f"use --to {joints.program or 'mcap (a bag)'}"
            check_language(dialect, joints, None if by_name else use)
        with of_file(out):
            dialect.check_name(out.stem)
    found: Check | None = None
    written = True
    if path_task is None:
        write_trajectory(rows, out, joints)
    else:
        with working("checking"):
            found, written = write_checked(
                rows, out, path_task, joints, joint_names=names, force=force
            )
    cli.only_json(json_)
    cli.say(f"{'wrote' if written else 'did not write'} {out}: {len(rows.q)} points")
    if dialect is not None and rows.accelerations is not None:
        cli.say(
            "the trajectory's accelerations are left out: between points the program has own curves"
        )
    axes = () if joints is None or dialect is None else joints.equations(dialect.axis_names)
    if joints is not None:
        cli.say(joints.origin + (f" ({joints.source})" if joints.source else ""))
        cli.say(*(f"  {axis}" for axis in axes))
        advice = "no controller has run it: try it slowly, without a tool, first"
        cli.say(*([advice] if written else []))
    cli.say(*_findings(found))
    if json_:
        facts = {
            "file": str(out),
            "written": written,
            "robot": None if joints is None else joints.robot,
            "axes": list(axes),
            "check": None if found is None else found.to_dict(),
        }
        cli.show_json(facts)
    if found is not None and not found.passes:
        cli.fail(failure(out, found, written))


def _findings(found: Check | None) -> list[str]:
    """Lines about the check: its notes, and the verdict if it passes; else it is the error."""
    if found is None:
        return ["not checked: no task given"]
    return [*found.notes, *([found.verdict] if found.passes else [])]


def _destination(trajectory: Path, to: str | None, out: Path | None) -> Path:
    """The file to write, by its language and name."""
    if to is not None and to not in _SUFFIX:
        raise InvalidInput(
            f"--to {to}: there is no such language{did_you_mean(to, _SUFFIX)} "
            f"Known: {', '.join(_SUFFIX)}."
        )
    if out is None:
        if to is None:
            raise InvalidInput(
                f"say what to write: --to {'|'.join(_SUFFIX)}, or --out with one of the suffixes "
                f"{', '.join(_SUFFIX.values())}."
            )
        return trajectory.with_suffix(_SUFFIX[to])
    if out.suffix.lower() not in _SUFFIX.values():
        raise InvalidInput(
            f"--out {out}: expected a file that ends in {', '.join(_SUFFIX.values())}."
        )
    if to is not None and out.suffix.lower() != _SUFFIX[to]:
        raise InvalidInput(f"--out {out}: a file of --to {to} ends in {_SUFFIX[to]}.")
    return out
