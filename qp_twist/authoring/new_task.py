"""Write a task file for a robot and a toolpath that runs without changes."""

from __future__ import annotations

import os
import tempfile
import warnings
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from qp_twist.authoring.cell import cell_folder, new_folder, write_cell
from qp_twist.authoring.frame_choice import choose_frame
from qp_twist.authoring.notes import notes_of, placement_note, start_notes
from qp_twist.authoring.request import Request
from qp_twist.authoring.search import Progress, TaskSearch, TaskSearchResult
from qp_twist.authoring.task_text import Parts, task_text
from qp_twist.authoring.touching import watched
from qp_twist.authoring.units import refuse_other_units
from qp_twist.checks import Array, did_you_mean
from qp_twist.errors import InvalidInput
from qp_twist.files import printable, whole_file
from qp_twist.following import FoundStart
from qp_twist.kinematics import JointRanges, SerialChain, largest_reach
from qp_twist.paths import PathTask, load_task, read_toolpath, rerooted, shipped_folder
from qp_twist.paths.task_file import FILE_KEY
from qp_twist.programs import AS_MODELLED
from qp_twist.robots import Robot, load_robot, stated_robot
from qp_twist.robots.srdf import disabled_pairs, srdf_beside
from qp_twist.trajectories import Check, run_task

_VARIED = 0.1
"""Margin of the placements of a study, in reaches of the robot."""


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
    report = progress or (lambda what, share: None)
    with ExitStack() as stack:
        parts, of_cell = _parts(request, out, force, report, stack)
        stays = request.place or request.part_mesh or request.fixture_meshes or parts.carrier
        with whole_file(out) as unfinished:
            path_task = _loaded(parts, unfinished, out)
            rounded = partial(_rounded, ranges=JointRanges.of(path_task.model))
            search = TaskSearch(request.search_seconds, report, rounded)
            searched = search.run(path_task, elsewhere=not stays)
            best, check = searched.best, None
            parts = _placed_and_started(parts, searched)
            path_task = _loaded(parts, unfinished, out)
            if best.passes:
                report("running the task as it is written", 1.0)
                with tempfile.TemporaryDirectory() as folder:
                    file = Path(folder) / "run.csv"
                    check = run_task(path_task, best.method, file, give_up=True).check
        path_task = replace(path_task, source=out)
        notes = [*notes_of(parts, path_task, of_cell)]
        if check is not None:
            notes.append(f"run by {best.method}: {check.verdict}")
        return NewTask(out, path_task, best.start, tuple(notes), check, best.method)


def _parts(
    request: Request, out: Path, force: bool, report: Progress, stack: ExitStack
) -> tuple[Parts, tuple[str, ...]]:
    """Read the robot and the toolpath, and write the scene of a cell, which ``stack`` removes."""
    controller = _controller(request.controller, out)
    report("reading the robot", 0.0)
    robot, scene = _robot(request, out)
    carrier, part = request.relative_to, ""
    seen = robot.model if carrier is None else _seen_from(robot.model, request, carrier)
    frame = choose_frame(seen, request.frame, request.frame_type)
    report("reading the toolpath", 0.0)
    try:
        toolpath = read_toolpath(request.toolpath, request)
    except InvalidInput as error:
        error.sentence += Request.hint(error.options, "qp-twist new")
        raise
    if request.roll is not None and not toolpath.has_roll:
        raise InvalidInput(
            f"{request.toolpath.name} states no roll of the tool; leave it out.", key="roll"
        )
    refuse_other_units(request, seen, frame, toolpath)
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
    name = _model_name(robot)
    srdf = srdf_beside(request.robot, name)
    if srdf is not None:
        watch = partial(watch, disabled=disabled_pairs(srdf), srdf=srdf.name)
    parts = Parts(
        request=request, title=f"{name} along {request.toolpath.name}", scene=scene,
        packages=packages, toolpath_file=_relative(request.toolpath, out), frame=frame,
        toolpath=toolpath, ranges=JointRanges.of(model), robot=robot, position=position,
        rpy_deg=rpy_deg, watched=watch(model), carrier=carrier,
        part=part if carrier is None else "", controller=controller,
    )  # fmt: skip
    return parts, of_cell


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
    note = placement_note(parts.request, searched, parts.carrier)
    reach = largest_reach(chain, JointRanges.of(best.path_task.model))
    return replace(
        parts, position=position, rpy_deg=rpy_deg, placement_notes=[note] if note else [],
        start=None if best.start is None else best.path_task.shown.configurations(best.start.q),
        start_notes=start_notes(searched),
        middle=np.round(0.5 * (path.min(axis=0) + path.max(axis=0)), 4),
        margin=max(1e-3, round(_VARIED * reach, 3)) if np.isfinite(reach) else 0.1,
    )  # fmt: skip


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


def _loaded(parts: Parts, unfinished: Path, out: Path) -> PathTask:
    """The task of the parts, written to a temporary file."""
    # A name of a file that is not UTF-8, and so none in a TOML file, is not found below.
    unfinished.write_text(task_text(parts), encoding="utf-8", errors="replace")
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


def _rounded(q: Array, ranges: JointRanges) -> Array:
    """Rounded to four decimals, as in the file, and still inside the limits."""
    scale = 180.0 / np.pi if ranges.hinge.all() else 1.0
    shown = np.round(q * scale, 4)
    low, high = ranges.lower * scale, ranges.upper * scale
    shown = np.where(shown < low, np.ceil(low * 1e4) * 1e-4, shown)
    shown = np.where(shown > high, np.floor(high * 1e4) * 1e-4, shown)
    # Convert as when reading a task file, so that a trial and a run of the file start equally.
    return np.radians(shown) if ranges.hinge.all() else shown
