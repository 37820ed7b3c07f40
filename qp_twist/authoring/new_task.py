"""A task file for a robot and a toolpath, which runs as it is written."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mink
import numpy as np
from scipy.linalg import null_space

from qp_twist.authoring.frame_choice import choose_frame
from qp_twist.authoring.reach import moved, placements
from qp_twist.authoring.request import Request
from qp_twist.authoring.task_text import Parts, task_text
from qp_twist.checks import Array, number
from qp_twist.errors import InvalidInput
from qp_twist.files import whole_file
from qp_twist.following import FoundStart, NoStart, first_that_leads_on
from qp_twist.following.resolver import twist_task
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask, load_task, shipped_folder
from qp_twist.path.task_file import FILE_KEY
from qp_twist.planning import central_configurations, what_forbids
from qp_twist.robots import Robot, load_robot
from qp_twist.toolpath import ColumnChoice, Toolpath, read_toolpath

_PLACEMENTS = 5
"""Placements of the workpiece that are tried with a lap."""
_STARTS = 6
_ALONE = 1e-6
"""A unit vector this near to an axis is the motion of one joint."""
_NO_SPEEDS = (
    "limits: the robot file states no joint speeds; put those of the data sheet into "
    "[limits.velocity], or none is held."
)
_WIDE = 8.0 * np.pi
"""A hinge that turns further than this from its zero has its limits in degrees, most likely."""
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class NewTask:
    """A task file that was written.

    Attributes:
        path: The file.
        path_task: What it says.
        start: Where it starts; ``None`` if no start was found.
        notes: What was decided, a sentence each.
    """

    path: Path
    path_task: PathTask
    start: FoundStart | None
    notes: tuple[str, ...]

    @property
    def runs(self) -> bool:
        """Whether a lap from the start kept to the whole path."""
        return self.start is not None and self.start.completed


@dataclass(frozen=True, eq=False)
class _Outcome:
    """How far the robot gets with the workpiece somewhere."""

    shift: Array
    start: FoundStart | None
    why: str

    @property
    def completed(self) -> bool:
        return self.start is not None and self.start.completed


def new_task(
    request: Request, out: Path, *, force: bool = False, progress: Progress | None = None
) -> NewTask:
    """Write a task file for a robot and a toolpath.

    The frame, the projector and the workpiece's placement follow from the two files, unless they
    are given; the start is the most central one from which a lap comes to the end. Where the robot
    does not reach the path as the file has it, and no placement is given, the workpiece is moved to
    where it does.

    Args:
        request: The files, and what is given.
        out: The file to write; its paths are relative to its folder.
        force: Whether a file that is there is overwritten.
        progress: Called with what is being done.

    Raises:
        InvalidInput: If a file is refused, the frame is not clear, or ``out`` is there.
    """
    _check_out(out, force)
    number("speed", request.speed, above=0.0)
    say = progress or (lambda what: None)
    say("reading the robot")
    robot, scene = _robot(request.robot, out)
    frame = choose_frame(robot.model, request.frame, request.frame_type)
    toolpath = _toolpath(request)
    parts = Parts(
        request=request,
        title=f"{_model_name(robot)} along {request.toolpath.name}",
        scene=scene,
        toolpath_file=_relative(request.toolpath, out),
        frame=frame,
        toolpath=toolpath,
        ranges=JointRanges.of(robot.model),
        velocity_limits=robot.velocity_limits,
        left_out=robot.left_out,
        position=np.array(request.place or (0.0, 0.0, 0.0)),
    )
    with whole_file(out) as unfinished:
        path_task = _loaded(parts, unfinished, out)
        outcome = _reached(path_task, request, say)
        parts = dataclasses.replace(
            parts,
            position=parts.position + outcome.shift,
            placement_notes=_placement_notes(request, outcome),
            start=None if outcome.start is None else _rounded(outcome.start.q, parts.ranges),
            start_notes=_start_notes(outcome),
        )
        path_task = _loaded(parts, unfinished, out)
    path_task = dataclasses.replace(path_task, name=out.stem, source=out)
    notes = [
        f"frame: {frame.kind} {frame.name!r}" + (f", {frame.why}" if frame.why else ""),
        f"path: {_summary(toolpath, path_task)}",
        *(f"left out of {robot.path.name}: {sentence}" for sentence in robot.left_out),
        *(f"path: {note}" for note in toolpath.notes),
        *_wide(parts.ranges),
        *_ways(toolpath),
        *_alone(path_task),
        *([] if robot.velocity_limits else [_NO_SPEEDS]),
        *(f"workpiece: {note}" for note in parts.placement_notes),
        *(f"start: {note}" for note in parts.start_notes),
    ]
    return NewTask(out, path_task, outcome.start, tuple(notes))


def _check_out(out: Path, force: bool) -> None:
    if out.suffix.lower() != ".toml":
        raise InvalidInput(f"--out {out}: a task file ends in .toml.")
    if out.is_dir():
        raise InvalidInput(f"--out {out}: this is a folder; give a file.")
    if out.exists() and not force:
        raise InvalidInput(
            f"--out {out}: there is such a file already; give another name, or --force to "
            "overwrite it."
        )


def _robot(file: Path, out: Path) -> tuple[Robot, str]:
    """The robot, and how the task file names it."""
    if not file.exists() and file.name == str(file):
        shipped = shipped_folder("scenes") / file
        if shipped.is_file():
            return load_robot(shipped), file.name
    return load_robot(file), _relative(file, out)


def _model_name(robot: Robot) -> str:
    """What the model calls itself, or else the name of its file."""
    name = bytes(robot.model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    return name if name not in ("", "MuJoCo Model") else robot.path.stem


def _relative(file: Path, out: Path) -> str:
    """A path as a file ``out`` says it."""
    try:
        return Path(os.path.relpath(file.resolve(), out.resolve().parent)).as_posix()
    except ValueError:  # on another drive
        return file.resolve().as_posix()


def _toolpath(request: Request) -> Toolpath:
    columns = None
    if request.columns is not None:
        columns = ColumnChoice(**request.columns.model_dump())
    try:
        return read_toolpath(
            request.toolpath,
            columns=columns,
            length_unit=request.length_unit,
            angle_unit=request.angle_unit,
            orientation=request.orientation,
        )
    except InvalidInput as error:
        options = {
            "add length_unit": "--unit mm, --unit m or --unit inch",
            "add angle_unit": "--angle-unit deg or --angle-unit rad",
            "orientation =": "--orientation normal, axis, rpy or none",
            "path.columns": '--columns "position=1,2,3;normal=4,5,6"',
        }
        said = [option for words, option in options.items() if words in str(error)]
        hint = f" For qp-twist new: {' or '.join(said)}." if said else ""
        raise InvalidInput(f"{error}{hint}") from error


def _loaded(parts: Parts, unfinished: Path, out: Path) -> PathTask:
    """The task that the parts make, written to a file that gets its name later."""
    unfinished.write_text(task_text(parts), encoding="utf-8")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is left out of the robot is in the file
            task = load_task(str(unfinished))
    except InvalidInput as error:
        # There is no task file that could be looked at; of a toolpath its own message says where.
        _, found, of_toolpath = str(error).partition(FILE_KEY)
        said = of_toolpath if found else str(error).replace(str(unfinished), str(out))
        raise InvalidInput(said) from error
    return dataclasses.replace(task, name=out.stem)


def _summary(toolpath: Toolpath, path_task: PathTask) -> str:
    points = sum(map(len, toolpath.curves))
    directions = {
        "axis": "with the tool's axis",
        "normal": "with surface normals",
        "rotation": "with whole orientations",
        "none": "without directions",
    }[toolpath.meaning]
    length = float(np.linalg.norm(np.diff(path_task.positions, axis=0), axis=1).sum())
    return (
        f"{points} points {directions}, {1e3 * length:.4g} mm, {len(path_task.waypoints)} "
        f"waypoints, rank {path_task.projector.rank} of {path_task.operational.rank}"
    )


def _ways(toolpath: Toolpath) -> list[str]:
    """What was added between curves."""
    if len(toolpath.curves) < 2:
        return []
    return [
        f"ways: {len(toolpath.curves)} curves; between them the tool goes away from the part, "
        "across, and back. Change [path.approach] and [path.retreat], or join the curves in the "
        "file."
    ]


def _wide(ranges: JointRanges) -> list[str]:
    """Limits that are degrees where radians were meant."""
    furthest = np.maximum(np.abs(ranges.lower), np.abs(ranges.upper))
    wide = ranges.hinge & ranges.limited & (furthest > _WIDE)
    if not wide.any():
        return []
    names = ", ".join(name for name, is_wide in zip(ranges.names, wide, strict=True) if is_wide)
    return [
        f"limits: {names} may turn by up to {furthest[wide].max():.4g} rad; a URDF states radians, "
        "an MJCF degrees unless its compiler says radian: are these in the other unit?"
    ]


def _alone(path_task: PathTask) -> list[str]:
    """Where what is free is the motion of one joint, nothing is to be gained by it."""
    rows = twist_task(path_task, path_task.projector)
    rows.set_target(path_task.waypoints[0])
    state = rows.state(mink.Configuration(path_task.model, path_task.start))
    free = null_space(state.basis.T @ state.jacobian)
    if free.shape[1] != 1 or np.abs(free).max() < 1.0 - _ALONE:
        return []
    name = JointRanges.of(path_task.model).names[int(np.argmax(np.abs(free)))]
    return [
        f"free: the roll is {name} alone, since the frame's z is its axis: the methods differ in "
        "that joint only, and no other joint gains by it."
    ]


# ---------------------------------------------------------------- where it is, where it starts


def _reached(path_task: PathTask, request: Request, say: Progress) -> _Outcome:
    """The start of the path where it is, or where the robot reaches it."""
    say("looking for a start")
    here = _tried(path_task, np.zeros(3))
    if here.completed or request.place is not None:
        return here
    best = here
    say("looking for a place for the workpiece")
    for number_, shift in enumerate(placements(path_task)):
        if number_ == _PLACEMENTS:
            break
        say(f"looking for a start, placement {number_ + 1}")
        there = _tried(moved(path_task, shift), shift)
        if there.completed:
            return dataclasses.replace(there, why=here.why)
    return best


def _tried(path_task: PathTask, shift: Array) -> _Outcome:
    try:
        start = first_that_leads_on(path_task, _STARTS)
    except NoStart as error:
        return _Outcome(shift, None, error.why)
    why = ""
    if not start.completed:
        why = f"a lap keeps to {start.reached} of {start.waypoints} waypoints"
        if not central_configurations(path_task, start.reached):
            why += f": {what_forbids(path_task, start.reached)}"
        elif start.stopped_by:
            why += f", held by {start.stopped_by}"
    return _Outcome(shift, start, why)


def _placement_notes(request: Request, outcome: _Outcome) -> list[str]:
    if outcome.completed and not outcome.shift.any():
        return [] if request.place else ["where the file has it, in the axes of the robot's world."]
    if outcome.completed:
        to = ", ".join(f"{value:.3g}" for value in outcome.shift)
        return [
            f"MOVED to ({to}) m, since with the file's origin in that of the robot's world "
            f"{outcome.why}. Measure where it really is, and put that here."
        ]
    asked = "where --place puts it" if request.place else "where the file has it, nor elsewhere"
    return [
        f"NOT REACHED {asked}: {outcome.why}. Change position or rpy_deg, or free more of the "
        "orientation in [projector]."
    ]


def _start_notes(outcome: _Outcome) -> list[str]:
    start = outcome.start
    if start is None:
        return ["none is inside the limits."]
    margin = f"{100.0 * start.margin:.0f} %" if np.isfinite(start.margin) else "all"
    notes = [
        f"the most central one found whose lap comes furthest: {margin} of the half range left in "
        f"the joint that is nearest to a limit, z = {start.z:.3g}."
    ]
    if not start.completed:
        notes.append(
            f'{outcome.why}. A plan may get further: start = "best" above all tables, and method '
            "qp_planned."
        )
    return notes


def _rounded(q: Array, ranges: JointRanges) -> Array:
    """To four decimals, as the file has it, and still inside the limits."""
    scale = 180.0 / np.pi if ranges.hinge.all() else 1.0
    shown = np.round(q * scale, 4)
    low, high = ranges.lower * scale, ranges.upper * scale
    shown = np.where(shown < low, np.ceil(low * 1e4) * 1e-4, shown)
    shown = np.where(shown > high, np.floor(high * 1e4) * 1e-4, shown)
    rounded: Array = shown / scale
    return rounded
