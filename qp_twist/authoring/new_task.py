"""Write a task file for a robot and a toolpath that runs without changes."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import mink
import mujoco
import numpy as np
from scipy.linalg import null_space

from qp_twist.authoring.cell import cell_folder, new_folder, write_cell
from qp_twist.authoring.frame_choice import choose_frame
from qp_twist.authoring.request import Request
from qp_twist.authoring.search import METHOD, PLANNED, Progress, TaskSearch, TaskSearchResult, Trial
from qp_twist.authoring.search_clock import SearchClock
from qp_twist.authoring.task_text import Parts, feeds_in_words, task_text
from qp_twist.authoring.touching import watched
from qp_twist.authoring.units import refuse_other_units
from qp_twist.checks import Array, did_you_mean
from qp_twist.constraints import JointCouplings
from qp_twist.errors import InvalidInput
from qp_twist.files import printable, whole_file
from qp_twist.following import FoundStart
from qp_twist.geometry import ProjectorKind
from qp_twist.kernel import MACHINE_CODE
from qp_twist.kinematics import JointRanges, SerialChain, largest_reach
from qp_twist.paths import (
    PathTask,
    Toolpath,
    load_task,
    read_toolpath,
    rerooted,
    shipped_folder,
    twist_task,
)
from qp_twist.paths.task_file import FILE_KEY
from qp_twist.paths.toolpath_builder import times
from qp_twist.programs import AS_MODELLED
from qp_twist.robots import Robot, load_robot, stated_robot
from qp_twist.robots.srdf import disabled_pairs, srdf_beside
from qp_twist.trajectories import Check, run_task

_ALONE = 1e-6
"""Tolerance at which a unit vector counts as the motion of one joint."""
_NO_SPEEDS = (
    "limits: the robot file states no joint speeds; put those of the data sheet into "
    "[limits.velocity], or none is held."
)
_WIDE = 8.0 * np.pi
"""A hinge with a larger limit, rad, probably has its limits in degrees."""
_VARIED = 0.1
"""Margin of the placements of a study, in reaches of the robot."""
_SMALL = 2e-3
"""Size of a path, m, below which its unit is questioned."""


@dataclass(frozen=True, eq=False)
class NewTask:
    """A task file that was written.

    Attributes:
        path: The file.
        path_task: The task in it.
        start: Its start; ``None`` if none was found.
        notes: A sentence for each decision.
        check: The check of ``qp-twist run`` with ``method``; ``None`` if no run reached the end of
            the path.
        method: Method of that run.
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

    Frame, projector and placement of the workpiece follow from the two files unless the request
    contains them. The start is the most central one from which a run reaches the end of the path.
    If the robot cannot reach the path as in the file, and the request has no placement, the
    workpiece is moved. The verdict is that of a run of the written file.

    With a tool, a part or fixtures a scene is written into the folder ``NAME_cell`` beside the task
    file ``NAME.toml``; then a part or fixture is not moved.

    Args:
        request: The files and options.
        out: The file to write; its paths are relative to its folder.
        force: Whether to overwrite an existing file.
        progress: Called with the current phase and the share of the search time that is used.

    Raises:
        InvalidInput: If a file is refused, the frame is ambiguous, or ``out`` exists.
    """
    _check_out(out, force)
    controller = _controller(request.controller, out)
    report, clock = progress or (lambda what, share: None), SearchClock()
    report("reading the robot", 0.0)
    robot, scene = _robot(request, out)
    carrier, part = request.relative_to, ""
    seen = robot.model if carrier is None else _seen_from(robot.model, request, carrier)
    frame = choose_frame(seen, request.frame, request.frame_type)
    report("reading the toolpath", 0.0)
    toolpath = _toolpath(request)
    if request.roll is not None and not toolpath.has_roll:
        raise InvalidInput(
            f"{request.toolpath.name} states no roll of the tool; leave it out.", key="roll"
        )
    refuse_other_units(request, seen, frame, toolpath)
    with ExitStack() as stack:
        stack.enter_context(clock.running(lambda: report(MACHINE_CODE, 0.0)))
        model, watch, of_cell = robot.model, watched, tuple[str, ...]()
        packages = {name: _relative(at, out) for name, at in request.packages.items()}
        position, rpy_deg = np.array(request.place or (0.0,) * 3), np.array(request.place_rpy_deg)
        if request.has_cell:
            report("writing the scene", 0.0)
            folder = cell_folder(out)
            stack.enter_context(new_folder(folder, force=force))
            cell = write_cell(folder, robot, frame, request, rpy_deg, position)
            frame, part, of_cell, carrier = cell.frame, cell.part, cell.notes, cell.carrier
            model, scene, packages = cell.robot.model, f"{folder.name}/scene.xml", {}
            watch = partial(watched, tool=cell.tool, part=cell.part)
        if request.tool_at is not None:  # which is in the pose of the part
            position = rpy_deg = np.zeros(3)
        srdf = srdf_beside(request.robot, _model_name(robot))
        if srdf is not None:
            watch = partial(watch, disabled=disabled_pairs(srdf), srdf=srdf.name)
        parts = Parts(
            request=request,
            title=f"{_model_name(robot)} along {request.toolpath.name}",
            scene=scene,
            packages=packages,
            toolpath_file=_relative(request.toolpath, out),
            frame=frame,
            toolpath=toolpath,
            ranges=JointRanges.of(model),
            robot=robot,
            position=position,
            rpy_deg=rpy_deg,
            watched=watch(model),
            carrier=carrier,
            part=part if carrier is None else "",
            controller=controller,
        )
        stays = request.place or request.part_mesh or request.fixture_meshes or carrier
        with whole_file(out) as unfinished:
            path_task = _loaded(parts, unfinished, out)
            rounded = partial(_rounded, ranges=JointRanges.of(path_task.model))
            search = TaskSearch(request.search_seconds, clock, report, rounded)
            searched = search.run(path_task, elsewhere=not stays)
            best = searched.best
            parts = _placed_and_started(parts, searched)
            path_task = _loaded(parts, unfinished, out)
            check = _run_once_more(path_task, best, report) if best.passes else None
        path_task = replace(path_task, name=printable(out.stem), source=out)
        notes = [*_notes(parts, path_task, of_cell)]
        if check is not None:
            notes.append(f"run by {best.method}: {check.verdict}")
        return NewTask(out, path_task, best.start, tuple(notes), check, best.method)


def _notes(parts: Parts, path_task: PathTask, of_cell: Sequence[str]) -> Iterator[str]:
    """A sentence for each decision."""
    robot, frame, toolpath, ranges = parts.robot, parts.frame, parts.toolpath, parts.ranges
    yield f"frame: {frame.kind} {frame.name!r}" + (f", {frame.why}" if frame.why else "")
    yield f"path: {_summary(toolpath, path_task)}"
    if toolpath.feeds is not None:
        yield (
            f"feed: {feeds_in_words(toolpath)}, as the file states it; where it does not, "
            f"{parts.request.speed:g} m/s."
        )
    if parts.turns_in_place:
        yield (
            f"feed: the tool turns in place ({times(parts.turns_in_place)}), where a speed along "
            f"the path gives no time, or hardly any; it turns by at most {parts.angular_speed:g} "
            "degrees/s everywhere (--angular-speed)."
        )
    if toolpath.has_roll and parts.fixes_roll:
        yield "roll: fixed to that of the file (rank 6); --roll free leaves it free, drawn to it."
    elif toolpath.has_roll:
        yield "roll: free, and drawn to that of the file; --roll fixed holds it (rank 6)."
    yield from (f"left out of {robot.path.name}: {sentence}" for sentence in robot.left_out)
    yield from (f"path: {note}" for note in toolpath.notes)
    yield from (f"cell: {note}" for note in of_cell)
    yield from (f"clearance: {note}" for note in (parts.watched.notes if parts.watched else ()))
    if toolpath.unit != "m" and toolpath.extent <= _SMALL:
        yield f"path: it is only {1e3 * toolpath.extent:.3g} mm across: is the file in m?"
    furthest = np.maximum(np.abs(ranges.lower), np.abs(ranges.upper))
    wide = ranges.hinge & ranges.limited & (furthest > _WIDE)
    if wide.any():
        yield (
            f"limits: {', '.join(np.array(ranges.names)[wide])} may turn by up to "
            f"{furthest[wide].max():.4g} rad; a URDF states radians, an MJCF degrees unless its "
            "compiler says radian: are these in the other unit?"
        )
    curves = len(toolpath.curves)
    if parts.request.transfer == "joint" and curves > 1:
        yield (
            f"ways: {curves} curves; between them the joints move as fast as they may, clear of "
            "all that the scene has."
        )
    elif parts.keeps_rapids:
        yield (
            "ways: the tool comes and goes as in the file, rapid motions included, at the speed of "
            "[feed]; --rapids drop leaves them out."
        )
    elif curves > 1:
        yield (
            f"ways: {curves} curves; between them the tool goes away from the part, across, and "
            "back. Change [path.approach] and [path.retreat], or join the curves in the file."
        )
    yield from _alone(path_task)
    if not robot.velocity_limits:
        yield _NO_SPEEDS
    yield from (f"workpiece: {note}" for note in parts.placement_notes)
    yield from (f"start: {note}" for note in parts.start_notes)


def _seen_from(model: mujoco.MjModel, request: Request, carrier: str) -> mujoco.MjModel:
    """The robot file's scene as seen from the body that carries the part."""
    if request.tool_at is not None:
        raise InvalidInput(
            "with a tool that is fixed in the cell (--tool-at) the robot's --frame holds the part; "
            "leave --relative-to out.",
            key="relative_to",
        )
    return rerooted(model, carrier).model


def _placed_and_started(parts: Parts, searched: TaskSearchResult) -> Parts:
    """The parts with the placement and the start that were found, and what a study varies."""
    best, position, rpy_deg = searched.best, parts.position, parts.rpy_deg
    if best.placement is not None:
        position, rpy_deg = best.placement.position, best.placement.rpy_deg
    path = best.path_task.positions
    chain = SerialChain.of(
        best.path_task.model, best.path_task.frame_name, best.path_task.frame_type
    )
    reach = largest_reach(chain, JointRanges.of(best.path_task.model))
    return replace(
        parts,
        position=position,
        rpy_deg=rpy_deg,
        placement_notes=_placement_notes(parts.request, searched, parts.carrier),
        start=None if best.start is None else best.path_task.shown.configurations(best.start.q),
        start_notes=_start_notes(searched),
        middle=np.round(0.5 * (path.min(axis=0) + path.max(axis=0)), 4),
        margin=max(1e-3, round(_VARIED * reach, 3)) if np.isfinite(reach) else 0.1,
    )


def _run_once_more(path_task: PathTask, best: Trial, report: Progress) -> Check | None:
    """Read and run the written file."""
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


def _robot(request: Request, out: Path) -> tuple[Robot, str]:
    """The robot, and its reference in the task file."""
    file = request.robot
    if not file.exists() and file.name == str(file):
        scenes = {path.name: path for path in sorted(shipped_folder("scenes").glob("*.xml"))}
        shipped = scenes.get(file.name) or scenes.get(f"{file.name}.xml")
        if shipped is not None:
            return load_robot(shipped), shipped.name
        if not file.suffix:
            raise InvalidInput(
                f"ROBOT {file}: there is no such file, and no such shipped scene"
                f"{did_you_mean(file.name, scenes)} Shipped: {', '.join(scenes)}."
            )
    robot = load_robot(file, packages=request.packages, arguments=request.arguments)
    return robot, _relative(file, out)


def _model_name(robot: Robot) -> str:
    """The model's name, or else that of its file."""
    name = bytes(robot.model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    return name if name not in ("", "MuJoCo Model") else robot.path.stem


def _relative(file: Path, out: Path) -> str:
    """A path relative to the file ``out``."""
    try:
        return Path(os.path.relpath(file.resolve(), out.resolve().parent)).as_posix()
    except ValueError:  # on another drive
        return file.resolve().as_posix()


def _controller(stated: str | None, out: Path) -> str | None:
    """The controller as the task file names it.

    Raises:
        InvalidInput: If it is no known robot and no file with one.
    """
    if stated is None or stated == AS_MODELLED:
        return stated
    stated_robot(stated)
    return _relative(Path(stated), out) if stated.lower().endswith(".toml") else stated


def _toolpath(request: Request) -> Toolpath:
    try:
        return read_toolpath(request.toolpath, request)
    except InvalidInput as error:
        error.sentence += Request.hint(error.options, "qp-twist new")
        raise


def _loaded(parts: Parts, unfinished: Path, out: Path) -> PathTask:
    """The task of the parts, written to a temporary file."""
    try:
        unfinished.write_text(task_text(parts), encoding="utf-8")
    except UnicodeEncodeError as error:
        raise InvalidInput(
            f"{out}: a task file (TOML) cannot have the name "
            f"{printable(error.object[: error.end]).splitlines()[-1]}…, which is not UTF-8; rename "
            "that file."
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what was left out of the robot is in the file
            task = load_task(str(unfinished))
    except InvalidInput as error:
        # There is no task file to look at; a message about the toolpath has its own place.
        of_toolpath = error.key == FILE_KEY
        error.file, error.line = "" if of_toolpath else str(out), None
        error.key = "" if of_toolpath else error.key
        error.sentence += Request.hint(error.options, "qp-twist new")
        raise
    return replace(task, name=printable(out.stem))


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


def _alone(path_task: PathTask) -> list[str]:
    """Warn if the free motion of the frame is that of one joint: then nothing is gained by it.

    Joints that neither move the frame nor are coupled to one that does, such as those of a gripper,
    do not count.
    """
    rows = twist_task(path_task, path_task.projector)
    rows.set_target(path_task.waypoints[0])
    state = rows.state(mink.Configuration(path_task.model, path_task.start))
    slopes = JointCouplings(path_task.model).slopes(path_task.start[None])[0]
    moving = np.linalg.norm(np.vstack([state.jacobian, slopes]), axis=0) > _ALONE
    free = null_space(np.vstack([state.basis.T @ state.jacobian, slopes])[:, moving])
    if free.shape[1] != 1 or np.abs(free).max() < 1.0 - _ALONE:
        return []
    dof = int(np.flatnonzero(moving)[np.argmax(np.abs(free))])
    if np.linalg.norm(state.jacobian[:, dof]) <= _ALONE:
        return []
    name, angular = JointRanges.of(path_task.model).names[dof], path_task.projector.angular
    is_roll = angular.kind is ProjectorKind.PLANE and path_task.projector.linear.rank == 3
    what = f"the roll is {name} alone, since the frame's z is its axis"
    if not is_roll:
        what = f"the motion that the task leaves free is that of {name} alone"
    return [f"free: {what}: the methods differ in that joint only, and no other joint gains by it."]


# ---------------------------------------------------------------- where it is, where it starts


def _placement_notes(
    request: Request, searched: TaskSearchResult, carrier: str | None
) -> list[str]:
    best, here = searched.best, searched.here
    if here.passes and carrier is not None:
        return [f"on the body {carrier!r}, in its frame."]
    if here.passes:
        return [] if request.place else ["where the file has it, in the axes of the robot's world."]
    if best.passes:
        return [
            f"MOVED to {best.placement}, since with the file's frame in the origin of the robot's "
            f"world {here.why}. Measure where it really is, and put that here."
        ]
    place = "where --place puts it" if request.place else "where the file has it"
    text = f"NOT REACHED {place}: {here.why}. "
    if searched.places is not None:
        promising = len(searched.places.found)
        text += f"Elsewhere: of {searched.places.region}, "
        text += (
            f"{promising} are reached at the waypoints that were looked at; of these "
            f"{searched.run} were run, none to the end. "
            if promising
            else "none is reached at all the waypoints that were looked at. "
        )
    if searched.ended:
        more = "" if searched.by_user else "; --search-time gives it more"
        text += f"The search was ended {searched.ended}{more}. "
    if not here.impossible and not request.place:
        text += "It was not moved, since no waypoint was found that cannot be reached. "
    return [f"{text}Change position or rpy_deg, or free more of the orientation in [projector]."]


def _start_notes(searched: TaskSearchResult) -> list[str]:
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
    """Rounded to four decimals, as in the file, and still inside the limits."""
    scale = 180.0 / np.pi if ranges.hinge.all() else 1.0
    shown = np.round(q * scale, 4)
    low, high = ranges.lower * scale, ranges.upper * scale
    shown = np.where(shown < low, np.ceil(low * 1e4) * 1e-4, shown)
    shown = np.where(shown > high, np.floor(high * 1e4) * 1e-4, shown)
    # Convert as when reading a task file, so that a trial and a run of the file start equally.
    rounded: Array = np.radians(shown) if ranges.hinge.all() else shown
    return rounded
