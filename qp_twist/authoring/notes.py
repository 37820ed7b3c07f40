"""The sentences that ``qp-twist new`` prints: one for each decision."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mink
import numpy as np
from scipy.linalg import null_space

from qp_twist.authoring.request import Request
from qp_twist.authoring.search import METHOD, PLANNED, TaskSearchResult
from qp_twist.authoring.task_text import Parts, feeds_in_words
from qp_twist.constraints import JointCouplings
from qp_twist.geometry import ProjectorKind
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, twist_task
from qp_twist.paths.toolpath_builder import times

_ALONE = 1e-6
"""Tolerance at which a unit vector counts as the motion of one joint."""
_NO_SPEEDS = (
    "limits: the robot file states no joint speeds; put those of the data sheet into "
    "[limits.velocity], or none is held."
)
_WIDE = 8.0 * np.pi
"""A hinge with a larger limit, rad, probably has its limits in degrees."""
_SMALL = 2e-3
"""Size of a path, m, below which its unit is questioned."""
_DIRECTIONS = {
    "axis": "with the tool's axis",
    "normal": "with surface normals",
    "rotation": "with whole orientations",
    "none": "without directions",
}


def notes_of(parts: Parts, path_task: PathTask, of_cell: Sequence[str]) -> Iterator[str]:
    """A sentence for each decision in a task file; ``of_cell`` those of its scene."""
    robot, frame, toolpath, ranges = parts.robot, parts.frame, parts.toolpath, parts.ranges
    yield f"frame: {frame.kind} {frame.name!r}" + (f", {frame.why}" if frame.why else "")
    length = float(np.linalg.norm(np.diff(path_task.positions, axis=0), axis=1).sum())
    yield (
        f"path: {sum(map(len, toolpath.curves))} points {_DIRECTIONS[toolpath.meaning]}, "
        f"{1e3 * length:.4g} mm, {len(path_task.waypoints)} waypoints, rank "
        f"{path_task.projector.rank} of {path_task.operational.rank}"
    )
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
    yield from _of_ways(parts)
    yield from _alone(path_task)
    if not robot.velocity_limits:
        yield _NO_SPEEDS
    yield from (f"workpiece: {note}" for note in parts.placement_notes)
    yield from (f"start: {note}" for note in parts.start_notes)


def _of_ways(parts: Parts) -> Iterator[str]:
    curves = len(parts.toolpath.curves)
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


def _alone(path_task: PathTask) -> Iterator[str]:
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
        return
    dof = int(np.flatnonzero(moving)[np.argmax(np.abs(free))])
    if np.linalg.norm(state.jacobian[:, dof]) <= _ALONE:
        return
    name, projector = JointRanges.of(path_task.model).names[dof], path_task.projector
    what = f"the motion that the task leaves free is that of {name} alone"
    if projector.angular.kind is ProjectorKind.PLANE and projector.linear.rank == 3:
        what = f"the roll is {name} alone, since the frame's z is its axis"
    yield f"free: {what}: the methods differ in that joint only, and no other joint gains by it."


def placement_note(request: Request, searched: TaskSearchResult, carrier: str | None) -> str:
    """Where the workpiece stands, and why; empty where the user put it."""
    best, here = searched.best, searched.here
    if here.passes:
        if carrier is not None:
            return f"on the body {carrier!r}, in its frame."
        return "" if request.place else "where the file has it, in the axes of the robot's world."
    if best.passes:
        return (
            f"MOVED to {best.placement}, since with the file's frame in the origin of the robot's "
            f"world {here.why}. Measure where it really is, and put that here."
        )
    place = "where --place puts it" if request.place else "where the file has it"
    text = f"NOT REACHED {place}: {here.why}. "
    if searched.places is not None:
        promising = len(searched.places.found)
        text += f"Elsewhere: of {searched.places.region}, " + (
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
    return f"{text}Change position or rpy_deg, or free more of the orientation in [projector]."


def start_notes(searched: TaskSearchResult) -> list[str]:
    """Which start was found, and by which method a run of it passes."""
    best = searched.best
    if best.start is None:
        return ["none is inside the limits." if best.impossible else "none was tried."]
    margin = best.start.margin
    which = "the most central one found whose run comes furthest"
    if best.method != METHOD:
        which = "that of a plan of the whole path"
    notes = [
        f"{which}: {f'{100.0 * margin:.0f} %' if np.isfinite(margin) else 'all'} of the half range "
        f"left in the joint that is nearest to a limit, z = {best.start.z:.3g}."
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
