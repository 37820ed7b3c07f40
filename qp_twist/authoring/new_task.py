"""A task file for a robot and a toolpath, which runs as it is written."""

from __future__ import annotations

import os
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import mink
import numpy as np
from scipy.linalg import null_space

from qp_twist.authoring.frame_choice import FrameChoice, choose_frame
from qp_twist.authoring.request import Request
from qp_twist.authoring.search import METHOD, PLANNED, Progress, Search, Searched, Trial
from qp_twist.authoring.task_text import Parts, feeds_in_words, task_text
from qp_twist.checks import Array, number
from qp_twist.errors import InvalidInput
from qp_twist.files import whole_file
from qp_twist.following import FoundStart
from qp_twist.kinematics import JointRanges, SerialChain, largest_reach
from qp_twist.paths import (
    ColumnChoice,
    PathTask,
    Toolpath,
    UnclearColumns,
    load_task,
    read_toolpath,
    shipped_folder,
    twist_task,
    unit_question,
)
from qp_twist.paths.task_file import FILE_KEY
from qp_twist.robots import Robot, load_robot
from qp_twist.trajectories import Check, run_task

_ALONE = 1e-6
"""A unit vector this near to an axis is the motion of one joint."""
_NO_SPEEDS = (
    "limits: the robot file states no joint speeds; put those of the data sheet into "
    "[limits.velocity], or none is held."
)
_WIDE = 8.0 * np.pi
"""A hinge that turns further than this from its zero has its limits in degrees, most likely."""
_FAR = 10.0
"""A path further from the robot than so many times its reach is asked about."""
_SMALL = 2e-3
"""A path that is smaller than this, m, is asked about."""


@dataclass(frozen=True, eq=False)
class NewTask:
    """A task file that was written.

    Attributes:
        path: The file.
        path_task: What it says.
        start: Where it starts; ``None`` if no start was found.
        notes: What was decided, a sentence each.
        check: What ``qp-twist run`` finds of the trajectory that it makes of the file by
            ``method``; ``None`` where no run came to the end of the path.
        method: By which the task was run.
    """

    path: Path
    path_task: PathTask
    start: FoundStart | None
    notes: tuple[str, ...]
    check: Check | None
    method: str

    @property
    def runs(self) -> bool:
        """Whether a run of the file passes its check."""
        return self.check is not None and self.check.passes


def new_task(
    request: Request, out: Path, *, force: bool = False, progress: Progress | None = None
) -> NewTask:
    """Write a task file for a robot and a toolpath.

    The frame, the projector and the workpiece's placement follow from the two files, unless they
    are given; the start is the most central one from which a run comes to the end of the path.
    Where the robot cannot reach the path as the file has it, and no placement is given, the
    workpiece is moved to where it can. The verdict is that of a run of the written file.

    Args:
        request: The files, and what is given.
        out: The file to write; its paths are relative to its folder.
        force: Whether a file that is there is overwritten.
        progress: Called with what is being done and the share of the search's time that is spent.

    Raises:
        InvalidInput: If a file is refused, the frame is not clear, or ``out`` is there.
    """
    _check_out(out, force)
    number("speed", request.speed, above=0.0)
    number("search_seconds", request.search_seconds, above=0.0)
    report = progress or (lambda what, share: None)
    report("reading the robot", 0.0)
    robot, scene = _robot(request.robot, out)
    frame = choose_frame(robot.model, request.frame, request.frame_type)
    report("reading the toolpath", 0.0)
    toolpath = _toolpath(request)
    _refuse_far(request, robot, frame, toolpath)
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
        rpy_deg=np.array(request.place_rpy_deg),
    )
    with whole_file(out) as unfinished:
        path_task = _loaded(parts, unfinished, out)
        search = Search(request.search_seconds, report, lambda q: _rounded(q, parts.ranges))
        searched = search.run(path_task, elsewhere=request.place is None)
        best = searched.best
        if best.placement is not None:
            parts = replace(parts, position=best.placement.position, rpy_deg=best.placement.rpy_deg)
        parts = replace(
            parts,
            placement_notes=_placement_notes(request, searched),
            start=None if best.start is None else best.start.q,
            start_notes=_start_notes(searched),
        )
        path_task = _loaded(parts, unfinished, out)
        check = _run_once_more(path_task, best, report) if best.passes else None
    path_task = replace(path_task, name=out.stem, source=out)
    notes = [
        f"frame: {frame.kind} {frame.name!r}" + (f", {frame.why}" if frame.why else ""),
        f"path: {_summary(toolpath, path_task)}",
        *_of_feed(request, toolpath),
        *(f"left out of {robot.path.name}: {sentence}" for sentence in robot.left_out),
        *(f"path: {note}" for note in toolpath.notes),
        *_small(toolpath),
        *_wide(parts.ranges),
        *_ways(toolpath),
        *_alone(path_task),
        *([] if robot.velocity_limits else [_NO_SPEEDS]),
        *(f"workpiece: {note}" for note in parts.placement_notes),
        *(f"start: {note}" for note in parts.start_notes),
        *([] if check is None else [f"run by {best.method}: {check.verdict}"]),
    ]
    return NewTask(out, path_task, best.start, tuple(notes), check, best.method)


def _run_once_more(path_task: PathTask, best: Trial, report: Progress) -> Check | None:
    """What the written file does, as it is read."""
    report("running the task as it is written", 1.0)
    with tempfile.TemporaryDirectory() as folder:
        return run_task(path_task, best.method, Path(folder) / "run.csv", give_up=True).check


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
            feed_unit=request.feed_unit,
        )
    except InvalidInput as error:
        raise InvalidInput(f"{error}{_hint(error)}") from error


def _hint(error: InvalidInput) -> str:
    """Which options say what a message about a toolpath asks for."""
    text = str(error)
    options = {
        "add length_unit": "--unit mm, --unit m or --unit inch",
        'say length_unit = "mm"': "--unit mm",
        'say length_unit = "inch"': "--unit inch",
        "add angle_unit": "--angle-unit deg or --angle-unit rad",
        "add feed_unit": "--feed-unit mm/min or another",
        "orientation =": "--orientation normal, axis, rpy or none",
    }
    said = [option for words, option in options.items() if words in text]
    if isinstance(error, UnclearColumns):
        found = error.suggestion
        said = [found.option if found else '--columns "position=1,2,3;normal=4,5,6"']
    return f" For qp-twist new: {' or '.join(said)}" if said else ""


def _refuse_far(request: Request, robot: Robot, frame: FrameChoice, toolpath: Toolpath) -> None:
    """Ask about a unit with which the path is many times the robot's reach away from it.

    Whether the path is too large as a whole is asked where the task is loaded.
    """
    if request.place is not None or request.length_unit is not None:
        return
    chain = SerialChain.of(robot.model, frame.name, frame.kind)
    reach = largest_reach(chain, JointRanges.of(robot.model))
    if not chain.screws or not np.isfinite(reach):
        return
    positions = np.concatenate([curve.positions for curve in toolpath.curves])
    apart = float(np.linalg.norm(positions - chain.screws[0].anchor, axis=1).min())
    largest = float(np.abs(positions).max())
    question = unit_question(
        toolpath.unit, largest, 2.0 * reach, unit_in_file=toolpath.unit_in_file
    )
    if apart > _FAR * reach and question.startswith("is the file"):
        raise InvalidInput(
            f"{request.toolpath.name}: its coordinates reach {largest:.3g} m, and the robot "
            f"{reach:.3g} m at most: {question}. If it is in {toolpath.unit}, say "
            f"--unit {toolpath.unit}, or --place where it stands."
        )


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
        raise InvalidInput(f"{said}{_hint(error)}") from error
    return replace(task, name=out.stem)


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


def _of_feed(request: Request, toolpath: Toolpath) -> list[str]:
    """The feeds of the file, and where they do not say anything."""
    if toolpath.feeds is None:
        return []
    return [
        f"feed: {feeds_in_words(toolpath)}, as the file states it; where it does not, "
        f"{request.speed:g} m/s."
    ]


def _small(toolpath: Toolpath) -> list[str]:
    """A path in metres that was read as millimetres."""
    extent = toolpath.extent
    if toolpath.unit == "m" or extent > _SMALL:
        return []
    return [f"path: it is only {1e3 * extent:.3g} mm across: is the file in m?"]


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


def _placement_notes(request: Request, searched: Searched) -> list[str]:
    best, here = searched.best, searched.here
    if here.passes:
        return [] if request.place else ["where the file has it, in the axes of the robot's world."]
    if best.passes:
        return [
            f"MOVED to {best.placement}, since with the file's frame in the origin of the robot's "
            f"world {here.why}. Measure where it really is, and put that here."
        ]
    asked = "where --place puts it" if request.place else "where the file has it"
    said = f"NOT REACHED {asked}: {here.why}. "
    if searched.places is not None:
        promising = len(searched.places.found)
        said += f"Elsewhere: of {searched.places}, "
        said += (
            f"{promising} are reached at the waypoints that were looked at; of these "
            f"{searched.run} were run, none to the end. "
            if promising
            else "none is reached at all the waypoints that were looked at. "
        )
    if searched.ended:
        more = "" if searched.by_user else "; --search-time gives it more"
        said += f"The search was ended {searched.ended}{more}. "
    if not here.impossible and not request.place:
        said += "It was not moved, since no waypoint was found that cannot be reached. "
    return [f"{said}Change position or rpy_deg, or free more of the orientation in [projector]."]


def _start_notes(searched: Searched) -> list[str]:
    best = searched.best
    start = best.start
    if start is None:
        return ["none is inside the limits." if best.impossible else "none was tried."]
    margin = f"{100.0 * start.margin:.0f} %" if np.isfinite(start.margin) else "all"
    which = "that of a plan of the whole path" if best.method != METHOD else (
        "the most central one found whose run comes furthest"
    )  # fmt: skip
    notes = [
        f"{which}: {margin} of the half range left in the joint that is nearest to a limit, "
        f"z = {start.z:.3g}."
    ]
    if best.method != METHOD:
        notes.append(
            f"{METHOD} does not come to the end from any start that was tried; {best.method} does:"
            f" run it with --method {best.method}."
        )
    if not best.passes:
        notes.append(
            f'{best.why}. A plan may get further: start = "best" above all tables, and method '
            f"{PLANNED}."
        )
    return notes


def _rounded(q: Array, ranges: JointRanges) -> Array:
    """To four decimals, as the file has it, and still inside the limits."""
    scale = 180.0 / np.pi if ranges.hinge.all() else 1.0
    shown = np.round(q * scale, 4)
    low, high = ranges.lower * scale, ranges.upper * scale
    shown = np.where(shown < low, np.ceil(low * 1e4) * 1e-4, shown)
    shown = np.where(shown > high, np.floor(high * 1e4) * 1e-4, shown)
    # As a task file is read, so that a trial and a run of the file begin with the same numbers.
    rounded: Array = np.radians(shown) if ranges.hinge.all() else shown
    return rounded
