"""``qp-twist new``."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, Optional

import numpy as np
import tyro

from qp_twist.authoring import NewTask, Request, new_task
from qp_twist.cli import app as cli
from qp_twist.cli.progress import note_compiling, progress_bar
from qp_twist.cli.toolpath import given, name_option, options_of
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import ToolpathOptions

Text = Annotated[Optional[str], tyro.conf.arg(metavar="NAME")]
Pose = Annotated[Optional[str], tyro.conf.arg(metavar="X,Y,Z[,ROLL_DEG,PITCH_DEG,YAW_DEG]")]
Files = tyro.conf.UseAppendAction[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE")]]
Folders = tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=DIR")]]
Values = tyro.conf.UseAppendAction[Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME:=VALUE")]]

_Options: Any = options_of(ToolpathOptions)
_AS_THE_FILE_SAYS = _Options()
Toolpath = Annotated[Any, tyro.conf.arg(constructor=_Options, name=""), tyro.conf.OmitArgPrefixes]


@cli.command
def new(
    robot: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="ROBOT")],
    path: cli.File,
    frame: Text = None,
    frame_type: Literal["auto", "site", "body", "geom"] = "auto",
    out: cli.File = Path("task.toml"),
    toolpath: Toolpath = _AS_THE_FILE_SAYS,
    roll: Literal["auto", "fixed", "free"] = "auto",
    transfer: Literal["straight", "joint"] = "straight",
    tool: Annotated[str, tyro.conf.arg(metavar="{into,out,FILE}")] = "into",
    place: Pose = None,
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.05,
    angular_speed: Annotated[Optional[float], tyro.conf.arg(metavar="DEG/S")] = None,
    search_time: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0,
    tcp: Pose = None,
    part: cli.OptionalFile = None,
    fixture: Files = (),
    relative_to: Annotated[Optional[str], tyro.conf.arg(metavar="BODY")] = None,
    tool_at: Pose = None,
    mesh_units: Annotated[Optional[Literal["mm", "m"]], tyro.conf.arg(metavar="{mm,m}")] = None,
    package: Folders = (),
    arg: Values = (),
    controller: Text = None,
    force: cli.Flag = False,
    json_: cli.Json = False,
) -> None:
    """Write a commented task file for a robot and a toolpath; it runs without edits.

    Args:
        robot: MJCF, URDF or xacro file, or a shipped scene.
        path: Toolpath: table, point cloud, poses, APT-CL, G-code, Klartext or program of a robot.
        frame: The robot's frame that follows it; if omitted, the only possible one.
        frame_type: Kind of the frame, if two frames have the same name.
        out: Task file to write.
        toolpath: How the toolpath is read.
        roll: Whether the roll about the tool's axis is fixed to the toolpath's, or free and drawn
            to it; if omitted, fixed where the toolpath states whole orientations.
        transfer: From one curve to the next: straight lines of the tool; or joint, moves of the
            joints at their full speed, clear of what is in the way.
        tool: Whether the frame's z points into the part or out of it; or the mesh of a tool (STL,
            OBJ or DAE) in the axes of the robot's frame, whose tip's z points into the part: a
            scene is then written beside the task file.
        place: Pose of the toolpath's frame in the robot's world: origin in m, roll, pitch and yaw
            in degrees (R = Rz Ry Rx), e.g. 0.5,0,0.2 or 0.5,0,0.2,0,0,90; if omitted, the world's
            origin, or elsewhere if the robot cannot reach it there.
        speed: Speed along the path where the toolpath has no feed, m/s.
        angular_speed: Largest speed at which the tool turns, degrees/s; if omitted, 90 for a path
            on which it turns in place, and no bound for others.
        search_time: Longest search for a start and a placement, s of processor time, without that
            of making machine code; Ctrl-C ends it with the best so far.
        tcp: Pose of the tool's tip in the robot's frame: m, roll, pitch and yaw in degrees
            (R = Rz Ry Rx); the task's frame is then the tip.
        part: Mesh of the part, in the toolpath's frame.
        fixture: Mesh of what stands around the part, in the toolpath's frame; may be repeated.
        relative_to: Body of the robot file that carries the part and is moved by joints, such as
            the plate of a turn table: toolpath, part, fixtures and --place are in its frame.
        tool_at: Pose in the robot's world of a tool that is fixed in the cell, as --place. The
            robot's frame then holds the part: --place is the pose of the toolpath's frame in it;
            --tool is a mesh in the tool's frame, --tcp its tip there; fixtures are in the world.
        mesh_units: Unit of the meshes, mm or m; required with a mesh.
        package: Folder of a ROS package of a URDF or xacro file; may be repeated.
        arg: Value of an argument of a xacro file; may be repeated.
        controller: How the robot's controller counts the joints in programs: the robot's name in
            the table of known robots, a file with a table of its own (.toml), or "as modelled".
        force: Overwrite the task file, and the folder of its scene.
    """
    task = _written(
        out, given(toolpath), force=force, tool=tool, place=place, tcp=tcp, tool_at=tool_at,
        package=package, arg=arg, robot=robot, toolpath=path, frame=frame, transfer=transfer,
        frame_type=None if frame_type == "auto" else frame_type,
        roll=None if roll == "auto" else roll, speed=speed, angular_speed_deg=angular_speed,
        search_seconds=search_time, part_mesh=part, fixture_meshes=fixture, mesh_unit=mesh_units,
        relative_to=relative_to, controller=controller,
    )  # fmt: skip
    cli.only_json(json_)
    if json_:
        cli.show_json(_facts(task))
    _say_what_is_next(task, out, path)
    if not task.runs:
        raise SystemExit(1)


def _written(
    out: Path, reading: dict[str, Any], *, force: bool, tool: str, place: str | None,
    tcp: str | None, tool_at: str | None, package: tuple[str, ...], arg: tuple[str, ...],
    **options: Any,
) -> NewTask:  # fmt: skip
    """The new task, of options whose texts are read here; what is refused has its option's name."""
    at = _pose("--place", place)
    try:
        request = Request(
            **reading,
            **options,
            tool="out" if tool == "out" else "into",
            tool_mesh=None if tool in ("into", "out") else Path(tool),
            place=None if at is None else at[:3],
            place_rpy_deg=(0.0, 0.0, 0.0) if at is None else at[3:],
            tcp=_pose("--tcp", tcp),
            tool_at=_pose("--tool-at", tool_at),
            packages={name: Path(at) for name, at in _named("--package", package, "=").items()},
            arguments=_named("--arg", arg, ":="),
        )
        cli.check_file(out)
        note_compiling()
        with progress_bar(1.0) as report:
            return new_task(
                request, out, force=force,
                progress=lambda what, share: report(
                    share, f"{what}; Ctrl-C ends the search with the best so far"
                ),
            )  # fmt: skip
    except InvalidInput as error:
        name_option(error, Request)
        raise


def _say_what_is_next(task: NewTask, out: Path, path: Path) -> None:
    """Print what was written, and the commands that go on with it."""
    cli.say(f"wrote {out}: {task.path_task.title}", *(f"  {note}" for note in task.notes))
    name = quote(str(out) if len(out.parts) > 1 else f"./{out}")
    motion = f"{quote(out.stem)}_joints.csv"
    if not task.runs:
        cli.say("  the robot does not come to the end of the path; the notes above say why.")
    else:
        cli.say(f"next: qp-twist run {name} --method {task.method} --out {motion}")
        if not task.path_task.joint_moves:
            cli.say(f"or, all methods side by side: qp-twist compare {name}")
    cli.say(f"the toolpath alone, as it was read: qp-twist show {quote(str(path))}")


def _facts(task: NewTask) -> dict[str, Any]:
    """What was written, ready for JSON."""
    ranges, start = JointRanges.of(task.path_task.model), None
    if task.start is not None:
        start = dict(zip(ranges.names, ranges.positions(task.start.q).tolist(), strict=True))
    return {
        "file": str(task.path),
        "title": task.path_task.title,
        "waypoints": len(task.path_task.waypoints),
        "start": start,
        "notes": list(task.notes),
        "runs": task.runs,
        "method": task.method,
        "check": None if task.check is None else task.check.to_dict(),
    }


def _named(option: str, texts: tuple[str, ...], mark: str) -> dict[str, str]:
    """Values by name of a repeated option."""
    found: dict[str, str] = {}
    for text in texts:
        name, given, value = text.partition(mark)
        if not name or not given:
            raise InvalidInput(
                f"{option} {text!r}: expected a name and a value, e.g. {option} name{mark}value."
            )
        if name in found:
            raise InvalidInput(f"{option}: {name!r} is given twice.")
        found[name] = value
    return found


def _pose(option: str, text: str | None) -> tuple[float, ...] | None:
    """Position in m, and roll, pitch and yaw in degrees."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all():
        known = len(numbers) in (3, 6)
        got = f"; got {'one that is not finite' if known else len(numbers)}" if numbers else ""
        raise InvalidInput(
            f"{option} {text!r}: expected three numbers in metres, e.g. {option} 0.5,0,0.2, or "
            f"six, the last three roll, pitch and yaw in degrees, e.g. {option} 0.5,0,0.2,0,0,90 "
            f"(with a negative first one {option}=-0.5,0,0.2){got}."
        )
    return tuple([*numbers, 0.0, 0.0, 0.0][:6])
