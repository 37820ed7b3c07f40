"""``qp-twist export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import tyro

from qp_twist.checks import one_of
from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import equations, failure, load
from qp_twist.cli.progress import working
from qp_twist.errors import InvalidInput
from qp_twist.files import of_file
from qp_twist.kinematics import JointRanges
from qp_twist.programs import DIALECTS, Dialect, dialect_of
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import (
    Check,
    TimedPath,
    joints_of,
    read_trajectory,
    write_checked,
    write_trajectory,
)
from qp_twist.trajectories.linear_moves import LinearMotion
from qp_twist.trajectories.program_trajectory import axis_names, check_language

OptionalTask = Annotated[Optional[str], tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")]
PointsName = Annotated[Optional[str], tyro.conf.arg(metavar="joints|poses")]
MotionName = Annotated[str, tyro.conf.arg(metavar="joint|linear")]
Language = Annotated[Optional[str], tyro.conf.arg(metavar="urscript|rapid|krl|ls|mcap")]
_OF_PROGRAMS = (
    "--robot, --as-modelled, --external, --motion linear and --force are for programs; a bag has "
    "the model's joints."
)
_SUFFIX = {**{name: dialect.suffix for name, dialect in DIALECTS.items()}, "mcap": ".mcap"}


@cli.command
def export(
    trajectory: cli.TrajectoryFile,
    task: OptionalTask = None,
    to: Language = None,
    out: cli.OptionalFile = None,
    robot: cli.RobotName = None,
    as_modelled: cli.Flag = False,
    external: cli.External = None,
    feed: cli.FeedMode = None,
    max_dip: cli.Share = None,
    calls: cli.Calls = None,
    path: cli.OptionalFile = None,
    force: cli.Flag = False,
    motion: MotionName = "joint",
    tool_number: cli.OptionalCount = None,
    frame_number: cli.OptionalCount = None,
    points: PointsName = None,
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
        motion: joint, or linear: the tool moves straight through as few points as keep the path.
        tool_number: With --motion linear: the controller's tool whose TCP is the task's frame; if
            omitted, 1, or with points that are poses the tool's values.
        frame_number: With points that are poses: the controller's frame that is the world of the
            task; if omitted, its values in the robot's base. On a part that moves: that of a frame
            on the part, in LS of the tool at rest; if omitted, 1 (of joints).
        points: With --motion linear: joints or poses; if omitted, joints where the language has
            them (rapid, ls, urscript), else poses (krl).
    """
    linear = _linear(motion, tool_number, frame_number, points, checked=task is not None)
    named = out is not None
    out = _destination(trajectory, to, out)
    cli.check_file(out)
    dialect = dialect_of(out)
    if dialect is None and (robot or as_modelled or external or force or linear):
        raise InvalidInput(_OF_PROGRAMS)
    if task is None and (path is not None or force):
        raise InvalidInput("--path and --force are for the check: it needs a task; give it, too.")
    if dialect_of(trajectory) is not None:
        raise InvalidInput(
            f"{trajectory}: is a program already; export from the trajectory that it was made of."
        )
    path_task = None if task is None else load(task, path, feed, max_dip, calls)
    names = None if path_task is None else JointRanges.of(path_task.shown.model).names
    rows = read_trajectory(trajectory, names)
    joints = None
    if dialect is not None:
        joints = joints_of(
            path_task, rows.joint_names, robot=robot, as_modelled=as_modelled,
            external=equations(external),
        )  # fmt: skip
        with of_file(out if named else f"--to {to}"):
            use = f"use --to {joints.program or 'mcap (a bag)'}"
            check_language(dialect, joints, None if named else use)
        with of_file(out):
            dialect.check_name(out.stem)
    found: Check | None = None
    written = True
    if path_task is None:
        write_trajectory(rows, out, joints)
    else:
        with working("checking"):
            found, written = write_checked(
                rows, out, path_task, joints, joint_names=names, force=force, linear=linear
            )
    cli.only_json(json_)
    of = "points" if linear is None else "rows, of which it has some"
    cli.say(f"{'wrote' if written else 'did not write'} {out}: {len(rows.q)} {of}")
    axes: list[str] = []
    if joints is not None and dialect is not None:
        axes = _say_of_program(rows, dialect, joints, written=written)
    cli.say(*(("not checked: no task given",) if found is None else found.notes))
    if json_:
        cli.show_json(_facts(out, written, joints, axes, found))
    if found is not None:
        if not found.passes:
            cli.fail(failure(out, found, written))
        cli.say(found.verdict)


def _say_of_program(
    rows: TimedPath, dialect: Dialect, joints: ControllerJoints, *, written: bool
) -> list[str]:
    """Print how a program counts the joints, and what it leaves out; return its axes."""
    if rows.accelerations is not None:
        cli.say("its accelerations are left out: between points the program has own curves")
    axes = list(joints.equations(axis_names(dialect, joints)))
    cli.say(joints.origin + (f" ({joints.source})" if joints.source else ""))
    cli.say(*(f"  {axis}" for axis in axes))
    if written:
        cli.say("no controller has run it: try it slowly, without a tool, first")
    return axes


def _facts(
    out: Path, written: bool, joints: ControllerJoints | None, axes: list[str], found: Check | None
) -> dict[str, Any]:
    """What was written, ready for JSON."""
    return {
        "file": str(out),
        "written": written,
        "robot": None if joints is None else joints.robot,
        "axes": axes,
        "check": None if found is None else found.to_dict(),
    }


def _linear(
    motion: str, tool: int | None, frame: int | None, points: str | None, *, checked: bool
) -> LinearMotion | None:
    """How the tool moves straight; ``None`` for joint moves."""
    if one_of("--motion", motion, ("joint", "linear")) == "joint":
        if points is not None or frame is not None:
            raise InvalidInput("--points and --frame-number are of --motion linear.")
        if tool is not None:
            raise InvalidInput(
                "--tool-number is of --motion linear: joint moves are the same with every tool; "
                "leave it out."
            )
        return None
    if points is not None:
        one_of("--points", points, ("joints", "poses"))
    numbers = [number for number in (tool, frame) if number is not None]
    if not checked or min(numbers, default=1) < 1:
        raise InvalidInput(
            "--motion linear needs the task, whose tool moves straight, and a --tool-number from 1 "
            "(and --frame-number, of poses)."
        )
    return LinearMotion(tool, frame, points)  # type: ignore[arg-type]


def _destination(trajectory: Path, to: str | None, out: Path | None) -> Path:
    """The file to write, by its language and name."""
    suffixes = ", ".join(_SUFFIX.values())
    if to is not None:
        one_of("--to", to, tuple(_SUFFIX))
    if out is None:
        if to is None:
            raise InvalidInput(
                f"say what to write: --to {'|'.join(_SUFFIX)}, or --out with one of the suffixes "
                f"{suffixes}."
            )
        return trajectory.with_suffix(_SUFFIX[to])
    if out.suffix.lower() not in ([_SUFFIX[to]] if to else _SUFFIX.values()):
        kind = f"{_SUFFIX[to]}, for --to {to}" if to else suffixes
        raise InvalidInput(f"--out {out}: expected a file that ends in {kind}.")
    return out
