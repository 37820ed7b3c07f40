"""Read a task file (TOML) into a :class:`PathTask`."""

from __future__ import annotations

import json
import os
import re
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from qp_twist.checks import Array, clause, did_you_mean, unit_vector
from qp_twist.constraints import Clearance, per_joint
from qp_twist.errors import InvalidInput, TaskFileError, about
from qp_twist.files import printable, read_text
from qp_twist.geometry import ProjectorKind, TwistProjector, task_redundancy
from qp_twist.kinematics import (
    JointRanges,
    SerialChain,
    check_bands,
    frame_id,
    frame_pose,
    largest_reach,
)
from qp_twist.paths.file_path import PlacedPath, file_segments, file_waypoints
from qp_twist.paths.file_path_schema import FilePath
from qp_twist.paths.lift_offs import LiftOffs
from qp_twist.paths.methods import METHODS
from qp_twist.paths.orientation import poses, roll_by_plane
from qp_twist.paths.path_task import FromStart, PathTask, check_carrier
from qp_twist.paths.preference import curve_numbers
from qp_twist.paths.rerooted import rerooted
from qp_twist.paths.section import problems
from qp_twist.paths.segment import Segment
from qp_twist.paths.shapes import polyline, spherical_patch_edges, with_leads
from qp_twist.paths.task_schema import (
    ClearanceSection,
    PolylinePath,
    PosesPath,
    RollSection,
    SphericalPatchPath,
    StartSection,
    TaskFile,
)
from qp_twist.paths.toolpath import Part
from qp_twist.paths.turning import turns_between
from qp_twist.robots import Robot, load_robot
from qp_twist.shipped import shipped_folder as shipped_folder  # noqa: PLC0414 (the room has it)
from qp_twist.shipped import shipped_tasks as shipped_tasks  # noqa: PLC0414

FILE_KEY = "path.file"
"""Key of a toolpath."""


def load_task(task: str | Path, *, path: str | Path | None = None) -> PathTask:
    """Load a task by the name of a shipped file, or a path to a ``.toml`` file.

    Relative paths are resolved from the file's folder; a scene that is not there is searched among
    the shipped ones.

    Args:
        task: ``"deburring"``, or ``"./mine.toml"``.
        path: A toolpath file, CSV or APT-CL, to follow instead of the task's path. If that path is
            from a file, too, its keys apply to this one.

    Raises:
        TaskFileError: If there is no such file, or it is invalid: the message names file, line and
            key.

    Example:
        >>> import qp_twist as qt
        >>> qt.load_task("deburring")
        PathTask('deburring', 401 waypoints, rank 5 of 6)
    """
    source = _find(task)
    try:
        text = read_text(source, "task file")
        table = tomllib.loads(text)
    except InvalidInput as error:
        raise TaskFileError(str(error)) from None
    except tomllib.TOMLDecodeError as error:
        raise TaskFileError(f"not valid TOML: {clause(error)}.", file=source) from error
    except (ValueError, RecursionError) as error:
        raise TaskFileError(f"cannot be read: {clause(error)}.", file=source) from error
    if table.get("start") in ("best", "central"):
        table["start"] = {table["start"]: True}
    try:
        if path is not None:
            table = _with_toolpath(source, table, path)
        # Convert to JSON: only there strict mode accepts an array for a tuple.
        file = TaskFile.model_validate_json(json.dumps(table, default=str))
        return _build(source, file)
    except ValidationError as error:
        found = [_in_file(problem, source, text) for problem in problems(error)]
        raise found[0] if len(found) == 1 else TaskFileError("\n".join(map(str, found))) from None
    except InvalidInput as error:
        if path is not None and error.key == FILE_KEY:  # that key was not read
            raise TaskFileError(error.sentence, options=error.options) from error
        raise _in_file(error, source, text) from error
    except RecursionError as error:
        raise TaskFileError("its tables are nested too deep.", file=source) from error
    except OverflowError as error:
        raise TaskFileError("a length in it is too large to compute with.", file=source) from error


def _in_file(error: InvalidInput, source: Path, text: str) -> TaskFileError:
    """The error with its place in a task file."""
    keys = [int(k) if k.isdecimal() else k for k in re.findall(r"[^.\[\]]+", error.key)]
    return TaskFileError(
        error.sentence, file=source, line=_line_of(text, keys), key=error.key, options=error.options
    )


def _find(task: str | Path) -> Path:
    if not isinstance(task, (str, Path)):
        raise TaskFileError(
            "task: expected the name of a shipped task or the path of a task file (.toml), got "
            f"{task!r}."[:300]
        )
    text = str(task)
    if text.endswith(".toml") or "/" in text or "\\" in text:
        return Path(task)
    shipped = {path.stem: path for path in shipped_tasks()}
    if text in shipped:
        return shipped[text]
    if os.path.lexists(text):
        raise TaskFileError(
            f"{text} is no task file: expected the name of a shipped task, or the path of a .toml "
            "file."
        )
    names, close, text = ", ".join(shipped), did_you_mean(text, shipped), text[:100]
    raise TaskFileError(
        f"there is no shipped task {text!r}{close} Shipped: {names}. A file of your own is "
        f"given by its path, e.g. ./{text}.toml."
    )


def _with_toolpath(source: Path, table: dict[str, Any], path: str | Path) -> dict[str, Any]:
    """The tables of a task file with another toolpath."""
    if not isinstance(path, (str, Path)) or not str(path):
        raise TaskFileError(f"load_task(path=…): expected a toolpath file, got {path!r}.")
    if table.get("segments"):
        raise InvalidInput(
            "they count the waypoints of the path in the file, so another cannot take its place; "
            "write a task with [path.approach] and [path.retreat].",
            key="segments",
        )
    section = table.get("path")
    section = section if isinstance(section, dict) else {}
    if section.get("kind") != "file":
        section = {"kind": "file", "tool": section.get("tool", "into")}
    title = f"{table.get('title', source.stem)}; along {Path(path).name}"
    here = source.parent.resolve() == Path.cwd()  # then messages have the file as it was given
    file = str(path) if here else str(Path(path).absolute())
    return {**table, "title": title, "path": {**section, "file": file}}


def _build(path: Path, file: TaskFile) -> PathTask:
    robot = load_scene(path, file.robot.scene, file.robot.packages, file.robot.arguments)
    frame = file.robot.frame, file.robot.frame_type
    model = scene = robot.model
    ranges = JointRanges.of(model)
    if not ranges.only_hinges_and_slides:
        joint = ranges.names[int(np.argmax(ranges.qpos < 0))]
        raise InvalidInput(
            f"joint {joint!r} is a ball or free joint; a path task follows "
            "arms of hinges and slides. For other robots use qp_twist.Controller step by step.",
            key="robot.scene",
        )
    start = ranges.middle if file.start.found else _start(file.start, model)
    projector, operational = file.projector.projector(), file.operational.projector()
    task_redundancy(operational, projector)
    bands = check_bands("bands", [table.band() for table in file.bands], projector)
    try:
        frame_id(model, *frame)
    except mink.InvalidFrame as error:
        raise InvalidInput(str(error), key="robot.frame") from error
    carrier = file.robot.relative_to
    if carrier is not None:
        with about("robot"):
            check_carrier(scene, *frame, carrier)
            seen = rerooted(scene, carrier)
        model, start = seen.model, seen.ordered(start)
        ranges = JointRanges.of(model)
    rotation, _ = frame_pose(mink.Configuration(model, start), *frame)
    reach = np.inf
    if projector.linear.kind is ProjectorKind.FULL:
        reach = largest_reach(SerialChain.of(model, *frame), ranges)
    built, first, segments = _waypoints(path, file, rotation, projector, operational, reach)
    durations, notes = _durations(file, built)
    toolpath = built.toolpath
    if toolpath is not None:
        toolpath = replace(toolpath, assumptions=(*toolpath.assumptions, *notes))
    timed, stated = durations is not None, file.robot.controller
    if stated is not None and stated.lower().endswith(".toml"):
        stated = str(path.parent / stated)  # a table of robots is relative to the task file
    normal = None
    if built.flipped is not None and file.roll is not None:
        normal = unit_vector("roll.plane_normal", file.roll.plane_normal)
    task = PathTask(
        name=printable(path.stem), title=file.title, source=path, scene=robot.path, model=model,
        frame_name=frame[0], frame_type=frame[1], projector=first, operational=operational,
        waypoints=poses(built.positions, built.rotations),
        flipped_waypoints=None if built.flipped is None else poses(built.positions, built.flipped),
        start=start, durations=durations,
        velocity_limits=_limits(file, ranges, "velocity", robot.velocity_limits, timed=timed),
        acceleration_limits=_limits(file, ranges, "acceleration", {}, timed=timed),
        jerk_limits=_limits(file, ranges, "jerk", {}, timed=timed) if file.limits.jerk else None,
        iteration=file.iteration,
        methods={str(name): settings for name, settings in file.methods.items()},
        segments=segments, bands=bands,
        constraints=() if file.clearance is None else (_clearance(file.clearance, scene),),
        best_start=file.start.found, roll_normal=normal, study=file.study, toolpath=toolpath,
        lines=built.lines, from_start=built.from_start, joint_moves=built.joint_moves,
        relative_to=carrier, scene_model=None if carrier is None else scene, controller=stated,
        external=file.robot.external, parts=built.parts, process=built.process,
        calls=file.program.calls,
        constant_speed=file.feed is not None and file.feed.mode == "constant",
        max_dip=None if file.feed is None else file.feed.max_dip,
        cuts="fewest" if file.plan.cuts == "fewest" else (),
        preference=None
        if file.preference is None
        else file.preference.on_curves(
            curve_numbers(built.parts, built.joint_moves, len(built.positions))
        ),
    )  # fmt: skip
    if task.preference is not None:
        task.preference.refuse_fixed(task.projectors)
    _refuse_unused(task)
    if file.plan.cuts == "fewest":
        return task
    try:
        return LiftOffs.of(task, file.plan.cuts).task
    except InvalidInput as error:
        raise InvalidInput(str(error), key="plan.cuts") from error


def _refuse_unused(task: PathTask) -> None:
    """Refuse settings of methods in the file that change nothing."""
    for name, settings in task.methods.items():
        unused = METHODS[name].unused(task.settings(name))
        for key in settings.model_fields_set & set(unused):
            raise InvalidInput(
                f"it would change nothing, since {unused[key]}; leave it out.",
                key=f"methods.{name}.{key}",
            )


def load_scene(
    path: Path,
    scene: str,
    packages: Mapping[str, str] | None = None,
    arguments: Mapping[str, str | bool | int | float] | None = None,
) -> Robot:
    """Load the robot of the MJCF, URDF or xacro file ``scene`` of the task file ``path``.

    Raises:
        TaskFileError: If there is no such file, or it is refused.
    """
    folders = {name: path.parent / folder for name, folder in (packages or {}).items()}
    for candidate in (path.parent / scene, shipped_folder("scenes") / scene):
        if os.path.lexists(candidate):
            try:
                robot = load_robot(candidate, packages=folders, arguments=arguments)
            except InvalidInput as error:
                raise TaskFileError(str(error), file=path, key="robot.scene") from error
            for sentence in robot.left_out:
                warnings.warn(f"{candidate.name}: {sentence}", stacklevel=2)
            return robot
    raise TaskFileError(
        f"there is no {scene!r} beside the task file or among the shipped scenes.",
        file=path,
        key="robot.scene",
    )


def _start(section: StartSection, model: mujoco.MjModel) -> Array:
    degrees = section.q_deg is not None
    key = "start.q_deg" if degrees else "start.q"
    values = np.array(section.q_deg if degrees else section.q, dtype=np.float64)
    if values.shape != (model.nq,):
        raise InvalidInput(
            f"the scene has {model.nq} joint coordinates, got {len(values)}.", key=key
        )
    if degrees and not (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).all():
        raise InvalidInput(
            "the scene has joints that are not hinges; give start.q in rad and m.", key=key
        )
    return np.radians(values) if degrees else values


def _waypoints(
    path: Path,
    file: TaskFile,
    held: Array,
    projector: TwistProjector,
    operational: TwistProjector,
    reach: float,
) -> tuple[PlacedPath, TwistProjector, tuple[Segment, ...]]:
    """The waypoints of the task, T of the first one, and the segments with another T.

    ``held`` (3, 3) is the frame's orientation at the start. A toolpath that exceeds the robot's
    ``reach`` (m) is refused before it is resampled.
    """
    segments = tuple(Segment(s.first - 1, s.projector(), s.blend) for s in file.segments)
    section = file.path
    if not isinstance(section, FilePath):
        no_axis = isinstance(section, PolylinePath) and section.tool_axis is None
        whole: FromStart = "orientation" if no_axis else "nothing"
        built = PlacedPath(*_poses(file, held), from_start=whole)
        steps = section.steps_per_lead if isinstance(section, SphericalPatchPath) else None
        if steps is not None:
            parts: list[Part] = ["contact"] * len(built.positions)
            parts[:steps], parts[-steps:] = ["approach"] * steps, ["retreat"] * steps
            built = replace(built, parts=tuple(parts))
        return built, projector, segments
    try:
        found = file_waypoints(path, section, held, reach)
    except InvalidInput as error:
        raise InvalidInput(str(error), key=FILE_KEY, options=error.options) from error
    if found.toolpath is not None and found.toolpath.meaning == "none":
        _refuse_held(file, "directions in the toolpath")
    first, own = file_segments(section, projector, operational, found.parts)
    if own and segments:
        raise InvalidInput(
            "[path.approach], [path.retreat] and [path.transfer] change T "
            "already; state projectors here or there.",
            key="segments",
        )
    if found.from_start == "roll" and file.roll is not None:
        rotations, flipped = _rolled(file.roll, found.rotations[:, :, 2])
        found = replace(found, rotations=rotations, flipped=flipped, from_start="nothing")
    return found, first, own or segments


def _rolled(rule: RollSection, axes: Array) -> tuple[Array, Array]:
    """Rotations (N, 3, 3) with z along axes (N, 3) by the roll rule, and by its other sign."""
    normal = np.array(rule.plane_normal)
    return roll_by_plane(axes, normal), roll_by_plane(axes, normal, flip=True)


def _refuse_held(file: TaskFile, without: str) -> None:
    """Refuse to search a start on a path whose orientation comes from the start."""
    if file.start.found and file.projector.projector().angular.rank:
        raise InvalidInput(
            f"a start is looked for on the path, and without {without} the path has "
            "its orientation from the start; give one of them.",
            key="start",
        )


def _poses(file: TaskFile, held: Array) -> tuple[Array, Array, Array | None]:
    """Positions (N, 3), rotations (N, 3, 3), and those of the roll rule's other sign."""
    section = file.path
    if isinstance(section, PosesPath):
        positions = np.array([pose.position for pose in section.poses])
        return positions, np.array([pose.rotation() for pose in section.poses]), None
    if isinstance(section, PolylinePath):
        positions = polyline(np.array(section.points), section.steps_per_segment)
        if section.tool_axis is None:
            _refuse_held(file, "path.tool_axis")
            return positions, np.broadcast_to(held, (len(positions), 3, 3)), None
        axis = unit_vector("path.tool_axis", section.tool_axis)
        axes = np.broadcast_to(axis, (len(positions), 3))
    else:
        assert isinstance(section, SphericalPatchPath)
        half_width = np.array(section.half_width)
        positions, axes = spherical_patch_edges(
            np.array(section.center), section.radius, half_width, section.steps_per_edge
        )
        if section.lead is not None and section.steps_per_lead is not None:
            positions, axes = with_leads(positions, axes, section.lead, section.steps_per_lead)
        if section.tool == "into":
            axes = -axes
    if file.roll is None:
        raise InvalidInput(
            "this path states the tool axis only; add [roll] with plane_normal, the "
            "rule by which rmr and qp_rmr fix the roll.",
            key="roll",
        )
    return positions, *_rolled(file.roll, axes)


def _durations(file: TaskFile, built: PlacedPath) -> tuple[Array | None, list[str]]:
    """Time for each waypoint, s, (N,), and notes about it.

    The slower of the linear and the angular feed counts; a joint move has the time 0. The linear
    feed is that of the toolpath; where it has none, ``feed.speed``; and without [feed] that of the
    nearest section.
    """
    feed, of_file, moves = file.feed, built.feeds, list(built.joint_moves)
    if feed is None and of_file is None:
        return None, []
    count = len(built.positions)
    durations = np.zeros(count)
    if feed is not None and feed.dt is not None:
        durations[1:] = feed.dt
        durations[moves] = 0.0
        notes = ["the feeds in the file are not used: feed.dt is the time of every waypoint."]
        return durations, notes if of_file is not None else []
    if feed is None or feed.speed is None:
        if of_file is None:
            raise InvalidInput("the path states no feeds; give speed (m/s) or dt (s).", key="feed")
        speeds = _nearest_feeds(built)
    else:
        speeds = np.full(count, feed.speed)
        if of_file is not None:
            speeds = np.where(np.isnan(of_file), speeds, of_file)
    if feed is not None and feed.rapid is not None:
        speeds[_between_curves(built)] = feed.rapid
    durations[1:] = np.linalg.norm(np.diff(built.positions, axis=0), axis=1) / speeds[1:]
    if feed is not None and feed.angular_speed_deg is not None:
        turns = turns_between(built.rotations[:-1], built.rotations[1:])
        durations[1:] = np.maximum(durations[1:], turns / np.radians(feed.angular_speed_deg))
    standing = np.setdiff1d(np.flatnonzero(durations <= 0.0)[1:], moves) - 1
    if len(standing):
        raise InvalidInput(
            f"waypoints {standing[0] + 1} and {standing[0] + 2} are at the same "
            "position, so speed alone gives them no time; add feed.angular_speed_deg, or use "
            "feed.dt.",
            key="feed",
        )
    if not np.isfinite(durations).all():
        raise InvalidInput("it is so low that the path takes no finite time.", key="feed")
    durations[moves] = 0.0  # as fast as the joints may
    return durations, []


def _between_curves(built: PlacedPath) -> npt.NDArray[np.bool_]:
    """Which waypoints are reached on the way from one curve of a toolpath to the next, (N,)."""
    if built.toolpath is None:
        raise InvalidInput(
            'it is for the ways between the curves of a path of kind "file"; this '
            "path has none. Leave it out.",
            key="feed.rapid",
        )
    between = np.array([part == "transfer" for part in built.parts])
    between[list(built.joint_moves)] = False
    if built.joint_moves and not between.any():
        raise InvalidInput(
            "it is for straight ways between the curves; here all are joint "
            "moves, which are as fast as the joints' limits permit. Leave it out.",
            key="feed.rapid",
        )
    return between


def _nearest_feeds(built: PlacedPath) -> Array:
    """The feeds of a toolpath; between its curves those of the next or last curve."""
    assert built.toolpath is not None and built.feeds is not None
    for curve in built.toolpath.curves:
        open_ = np.ones(len(curve) - 1, dtype=bool)
        if curve.feeds is not None:
            open_ = np.isnan(curve.feeds[1:])
        if open_.any():
            raise InvalidInput(
                f"{built.toolpath.source.name} states feeds, but none for line "
                f"{curve.lines[1:][open_][0]}; add [feed] with the speed (m/s) where it states "
                'none, or leave its feeds out by feeds = "task" in [path].',
                key="feed",
            )
    known = np.flatnonzero(~np.isnan(built.feeds))
    following = np.searchsorted(known, np.arange(len(built.feeds)))
    return built.feeds[known[np.minimum(following, len(known) - 1)]]


def _limits(
    file: TaskFile, ranges: JointRanges, kind: str, of_robot: dict[str, float], *, timed: bool
) -> Array:
    """Limits by joint, (nv,): those of the file; for a timed path without them, the robot's."""
    stated: dict[str, float] = getattr(file.limits, kind)
    if not stated:
        return per_joint(f"{kind} limits of the robot", of_robot if timed else {}, ranges)
    limits = per_joint(f"limits.{kind}", stated, ranges)
    if not timed:
        raise InvalidInput(
            f"{kind} limits need a clock; add [feed] with speed or dt.", key=f"limits.{kind}"
        )
    return limits


def _clearance(section: ClearanceSection, model: mujoco.MjModel) -> Clearance:
    """The constraint of [clearance]."""
    with about("clearance"):
        if not len(Clearance(model, 0.0).pairs):
            raise InvalidInput(
                "no geom of the scene can collide with another one that moves against it; give "
                "them contype and conaffinity other than 0, or remove this section."
            )
        return Clearance(model, section.distance, section.ignore)


def _line_of(text: str, keys: list[str | int]) -> int | None:
    """Line of a dotted key, by headers and assignments; the nearest parent's if it is nested."""
    table: list[str | int] = []
    best, depth = None, 0
    seen: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*(\[+)\s*([^\]]+?)\s*\]+", line)
        assignment = re.match(r"\s*([\w.\"'-]+)\s*=", line)
        if header:
            table = [part.strip(" \"'") for part in header[2].split(".")]
            if header[1] == "[[":  # the tables of an array are counted
                seen[header[2]] = seen.get(header[2], -1) + 1
                table.append(seen[header[2]])
            here = table
        elif assignment:
            here = table + [part.strip(" \"'") for part in assignment[1].split(".")]
        else:
            continue
        if keys[: len(here)] == here and len(here) > depth:
            best, depth = number, len(here)
    return best
