"""Check a joint trajectory from any source against a task."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from qp_twist.checks import Mask, instance
from qp_twist.errors import InvalidInput
from qp_twist.geometry import resolved_twist_error
from qp_twist.kinematics import JointRanges
from qp_twist.notebook import html_table
from qp_twist.paths import PathTask
from qp_twist.referee import (
    DIP,
    Astray,
    Finding,
    JointMotion,
    MotionLimits,
    Passing,
    PathErrors,
    Tolerances,
    ToolSpeed,
    astray_parts,
    errors_of,
    examine,
    motion_limits,
    path_errors,
    poses_of,
    tool_speed,
    with_default_accelerations,
    with_default_jerks,
)
from qp_twist.trajectories.matching import times_at_waypoints
from qp_twist.trajectories.metadata import disagreements, with_lift_offs
from qp_twist.trajectories.program_findings import of_rests, of_rounding, of_stated_ramps
from qp_twist.trajectories.timed_path import TimedPath

if TYPE_CHECKING:
    from qp_twist.following import Trajectory

__all__ = ["Check", "Finding", "JointMotion", "PathErrors", "check_trajectory", "path_errors"]
_NAMED = 3
"""Largest number of joints without a limit that are named one by one."""
_DOES = {
    (False, True): "ends at",
    (False, False): "begins at",
    (True, True): "leaves the path for good after",
    (True, False): "comes onto the path only at",
}
"""What a motion does at the waypoint where a part begins (``after``) or ends."""
_REST = 1e-6
"""A joint counts as at rest below this speed, rad/s or m/s."""


@dataclass(frozen=True, eq=False)
class Check:
    """Result of :func:`~qp_twist.check_trajectory`.

    Attributes:
        task: Name of the task.
        rows: Number of rows of the trajectory.
        waypoints: Number of waypoints of the task.
        matched: How rows and waypoints were matched, in words.
        findings: The checked quantities, line by line.
        notes: Contradictions of the file's metadata, and other remarks.
        unchecked: What could not be checked, and why; part of the verdict.
        sources: Source of the limits that are not the task's: a data sheet, or a default.
        motion: The checked motion of the joints; without times one row per second.
        passing: Times at which it passes the waypoints.
        errors: Its errors at and between the waypoints.
        astray: Where it ends before its path does, or leaves it for good, or begins late.
        limits: Limits of speed, acceleration and jerk that it was checked against.
        program: Lines and points of a program, in words; empty of other files.
        speed: The tool's speed against the programmed one; ``None`` without a feed or times.
        tolerances: Largest task errors that pass.
        beside: On which sides of the path how many rows go beside it.
    """

    task: str
    rows: int
    waypoints: int
    matched: str
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    unchecked: tuple[str, ...]
    sources: tuple[str, ...]
    motion: JointMotion
    passing: Passing
    errors: PathErrors
    astray: tuple[Astray, ...]
    limits: MotionLimits
    program: str
    speed: ToolSpeed | None
    tolerances: Tolerances
    beside: Mapping[str, int]

    @property
    def passes(self) -> bool:
        """Whether every finding passes."""
        return all(finding.passes for finding in self.findings)

    @property
    def problems(self) -> tuple[str, ...]:
        """Where it leaves its path, and a sentence for each finding that does not pass."""
        return (
            *self.path_left,
            *(str(finding) for finding in self.findings if not finding.passes),
        )

    @property
    def path_left(self) -> tuple[str, ...]:
        """Where it ends or leaves its path before the last waypoint, or begins late, in words."""
        return tuple(
            f"{_DOES[part.moves, part.after]} waypoint {part.waypoint} of {self.waypoints}"
            if part.waypoint
            else f"meets none of {self.waypoints} waypoints"
            for part in self.astray
        )

    @property
    def verdict(self) -> str:
        """One line: whether it passes, what could not be checked, and the source of the limits."""
        if not self.passes:
            return "; ".join([f"does not pass: {'; '.join(self.problems)}", *self.sources])
        rows = f"{self.rows} rows of task {self.task}"
        but = [*self.unchecked, *self.sources]
        return "; ".join(["passes", *but]) + f" ({rows})" if but else f"passes: {rows}"

    def table(self) -> str:
        """The findings as a plain table."""
        rows = [("", "largest", "proven", "limit", "", "where", "")]
        for finding in self.findings:
            value, bound, limit = finding.shown
            measured = value, bound and f"≤ {bound}", limit or "–", finding.unit
            rows.append((finding.name, *measured, finding.where, "" if finding.passes else "✗"))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        align = "<>>><<<"
        lines = [
            "  ".join(f"{cell:{to}{w}}" for cell, to, w in zip(row, align, widths, strict=True))
            for row in rows
        ]
        return "".join(f"{line.rstrip()}\n" for line in lines)

    def to_dict(self) -> dict[str, Any]:
        """All results, ready for JSON, which has no infinity: ``None`` stands for it."""
        listed = ("problems", "notes", "unchecked", "sources")
        return {
            **{name: getattr(self, name) for name in ("task", "rows", "waypoints", "matched")},
            "passes": self.passes,
            "findings": [
                {key: _finite(value) for key, value in vars(finding).items()}
                for finding in self.findings
            ],
            **{name: list(getattr(self, name)) for name in listed},
            "tool_speed": None if self.speed is None else self.speed.to_dict(),
        }

    def _repr_html_(self) -> str:
        """The findings as a small table, for notebooks."""
        rows = []
        for finding in self.findings:
            name = f"{'✓' if finding.passes else '✗'} {finding.name}"
            limit = "–" if finding.limit is None else finding.limit
            rows.append((name, finding.value, limit, finding.unit, finding.where))
        return html_table(self.verdict, rows, ("", "largest", "limit", "", "where"))

    def __repr__(self) -> str:
        return f"Check({self.task!r}, {self.verdict!r})"


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_trajectory(
    trajectory: TimedPath | Trajectory,
    path_task: PathTask,
    *,
    position_tolerance: float | None = None,
    axis_tolerance_deg: float | None = None,
) -> Check:
    """Measure a trajectory against a task: errors at and between waypoints, limits, speeds.

    Everything is computed from the joint positions, and from times and velocities if there are any;
    the trajectory's metadata only say where the tool lifts off, if the task leaves that open, and
    produce notes where they contradict the task. Limits of speed, acceleration and jerk are the
    task's, else those of the robot's data sheet, else the defaults
    (:func:`~qp_twist.referee.with_default_accelerations`,
    :func:`~qp_twist.referee.with_default_jerks`), which the verdict names. As many
    rows as waypoints correspond one by one. With another number of rows, or if the motion between
    rows meets waypoints that the rows miss, the trajectory has to pass all waypoints in their
    order, at times that are searched.

    Args:
        trajectory: From :func:`~qp_twist.read_trajectory`, or a computed one.
        path_task: The task of the trajectory.
        position_tolerance: Largest linear task error that passes, m; ``None``: as the task states
            it in ``[study]``, else 0.1 mm.
        axis_tolerance_deg: Largest angular task error that passes, degrees; ``None``: likewise,
            else 0.05°.

    Raises:
        InvalidInput: If a joint of the task's robot is missing, or the robot has others than hinges
            and slides.
    """
    instance("check_trajectory(path_task)", path_task, PathTask)
    tolerances = path_task.tolerances.stated(position_tolerance, axis_tolerance_deg)
    ranges = JointRanges.of(path_task.model)
    if not ranges.only_hinges_and_slides:
        raise InvalidInput(
            "check_trajectory: the robot has ball or free joints; only hinges and slides can be "
            "checked."
        )
    rows = TimedPath.of(trajectory).of_joints(ranges.names)
    asked, path_task = path_task, with_lift_offs(path_task, rows.metadata)
    motion, count, timed = rows.motion, len(path_task.waypoints), rows.times is not None
    errors, passing = _matched(path_task, motion, tolerances, len(rows.q) == count, timed)
    met = tolerances.met(errors.position.at, errors.axis.at)
    astray = () if passing.by_row else astray_parts(path_task, motion, passing.times, met)
    limits = motion_limits(path_task)
    if not rows.own_ramps:
        limits = with_default_jerks(with_default_accelerations(limits, ranges))
    stops = motion.times[list(rows.stops)] if rows.own_ramps and timed else None
    speed = tool_speed(path_task, motion, passing, limits, stops)
    findings = examine(path_task, motion, tolerances, passing, errors, limits, astray)
    dips, of_speed = _of_speed(path_task, speed)
    rounding = of_rounding(rows, path_task, motion, passing, tolerances)
    of_ramps, more_sources = of_stated_ramps(rows, limits, ranges, passing)
    beside = _beside_the_path(path_task, passing, motion, met, tolerances)
    at_rests = of_rests(rows, limits, ranges)
    stated = _not_stated(beside, rows.beside)
    findings = (*findings, *dips, *rounding, *of_ramps, *at_rests, *stated)
    unasked = f"{_counted(beside)}: judged for limits and obstacles, not against the path"
    judged = [unasked] if beside else []
    foreign = bool(rows.program) and rows.beside is None
    notes = [
        *of_speed,
        *disagreements(rows.metadata, path_task, limits),
        *rows.notes,
        *_part_of_the_path(passing, motion, met),
        *([] if foreign else judged),
        *_about_rows(rows, path_task, findings),
    ]
    unchecked, sources = _coverage(path_task, limits, ranges, timed=timed)
    if path_task is not asked:
        after = ", ".join(map(str, path_task.cuts))
        unchecked.insert(0, f"lifts off after waypoints {after}, as it states itself: between each "
                            "of them and the next one the path is not asked about")  # fmt: skip
    sources += more_sources
    unchecked = [*rows.unjudged, *(judged if foreign else []), *unchecked]
    if timed:
        unchecked += [] if rows.own_ramps else _at_speed(ranges, motion)
        jumps, of_jerks, source = _of_jerks(path_task, limits, ranges, rows)
        findings, unchecked, sources = (*findings, *jumps), unchecked + of_jerks, sources + source
    return Check(
        path_task.name, len(rows.q), count,
        "row by row" if passing.by_row else "nearest points in the waypoints' order",
        findings, tuple(notes), tuple(unchecked), (*rows.sources, *sources), motion, passing,
        errors, astray, limits, rows.program, speed, tolerances, beside,
    )  # fmt: skip


def _about_rows(rows: TimedPath, path_task: PathTask, findings: Sequence[Finding]) -> Iterator[str]:
    """What a motion that does not pass may have left unsaid, and how its joints move."""
    unsaid = path_task.cuts == "fewest" and "cuts" not in rows.metadata
    if unsaid and not all(finding.passes for finding in findings):
        yield (
            "the task lets the tool lift off, but the trajectory does not say where it does: state "
            "the waypoints by cuts = [WAYPOINT, …] in [plan]"
        )
    if rows.motion.degree == 5:
        yield (
            "the trajectory has accelerations: its joints move on polynomials of degree five from "
            "row to row, as ROS' joint trajectory controller moves them"
        )


def _of_speed(path_task: PathTask, speed: ToolSpeed | None) -> tuple[list[Finding], list[str]]:
    """The dips of a constant speed, and sentences about them."""
    most = path_task.max_dip
    if not path_task.constant_speed or (speed is None and most is None):
        return [], []
    if speed is not None:
        return [speed.finding(most)], speed.sentences
    assert most is not None
    why = "no times, so that the speed of the tool is not known"
    return [Finding(DIP, np.inf, 100.0 * most, "%", why, passes=False)], []


def _of_jerks(
    path_task: PathTask, limits: MotionLimits, ranges: JointRanges, rows: TimedPath
) -> tuple[list[Finding], list[str], list[str]]:
    """A finding where jerks that the task limits are unknown; what is not checked, and sources."""
    stated, motion = np.isfinite(MotionLimits.of(path_task).jerk), rows.motion
    if rows.own_ramps:
        but = ["joint jerks not checked: the controller makes its own ramps"] * bool(stated.any())
        return [], but, []
    if motion.accelerations is None:
        if not (stated & np.any(motion.q != motion.q[0], axis=0)).any():
            return [], ["jerks not checked: no accelerations"], []
        do = (
            "a script states none; export straight moves (--motion linear), whose ramps are the "
            "controller's, or leave [limits.jerk] out" if rows.program else "write them, too"
        )  # fmt: skip
        where = f"rows, at which accelerations may jump, since none are stated: {do}"
        return [Finding("jerk limits", np.inf, 100.0, "%", where, passes=False)], [], []
    if not limits.jerks_of:
        return [], [], []
    others = ", ".join(np.array(ranges.names)[~stated])
    whose = f" of {others}, which the task does not state," if stated.any() else ""
    return [], [], [f"jerks{whose} checked against {limits.jerks_of}"]


def _matched(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, by_row: bool, timed: bool
) -> tuple[PathErrors, Passing]:
    """Errors at the rows, or else at the times at which the motion passes the waypoints nearest."""
    passing = Passing(motion.times, timed, by_row=True)
    if by_row:
        errors = errors_of(path_task, motion, tolerances, passing)
    if not by_row or not tolerances.met(errors.position.at, errors.axis.at).all():
        times = times_at_waypoints(path_task, motion, tolerances)
        searched = Passing(times, timed, by_row=False)
        nearest = errors_of(path_task, motion, tolerances, searched)
        if not by_row or tolerances.met(nearest.position.at, nearest.axis.at).all():
            return nearest, searched
    return errors, passing


def _part_of_the_path(passing: Passing, motion: JointMotion, met: Mask) -> list[str]:
    """A sentence if the trajectory begins late or ends early: several waypoints are at its end."""
    at, notes = passing.times, []
    for does, end, others, row in (
        ("begins", motion.times[0], "before", "first"), ("ends", motion.times[-1], "after", "last")
    ):  # fmt: skip
        there = np.flatnonzero((at == end) & ~met)
        kept = int(there[-1] + 2 if others == "before" else there[0]) if len(there) > 1 else 0
        if 1 <= kept <= len(at):
            notes.append(
                f"the trajectory {does} at waypoint {kept} of {len(at)}: those {others} it are "
                f"compared with its {row} row"
            )
    return notes


def _beside_the_path(
    path_task: PathTask, passing: Passing, motion: JointMotion, met: Mask, tolerances: Tolerances
) -> dict[str, int]:
    """The sides of the path, each with its rows beside it, unless they stay at its end."""
    found = {}
    for side, end, beside in (
        ("before the first waypoint", 0, motion.times < passing.times[0]),
        ("after the last waypoint", -1, motion.times > passing.times[-1]),
    ):
        if not (met[end] and beside.any()):
            continue
        R, p = poses_of(path_task, motion.q[beside])
        target = path_task.waypoints[end]
        R_d, p_d = target.rotation().as_matrix(), target.translation()
        errors = resolved_twist_error(R, p, R_d, p_d, path_task.in_force[end])[1]
        linear, angular = (np.linalg.norm(part, axis=1) for part in np.hsplit(errors, 2))
        if not tolerances.met(linear, angular).all():
            found[side] = len(R)
    return found


def _counted(beside: Mapping[str, int]) -> str:
    return " and ".join(f"{n} {'row' if n == 1 else 'rows'} {side}" for side, n in beside.items())


def _not_stated(beside: Mapping[str, int], stated: Sequence[str] | None) -> list[Finding]:
    """A finding if a program with a header goes beside the path where that does not say it."""
    more = {side: n for side, n in beside.items() if stated is not None and side not in stated}
    if not more:
        return []
    where = f"{_counted(more)}, which the header does not state: a point was changed"
    return [Finding("rows beside the path", sum(more.values()), 0.0, "", where, passes=False)]


def _coverage(
    path_task: PathTask, limits: MotionLimits, ranges: JointRanges, *, timed: bool
) -> tuple[list[str], list[str]]:
    """What could not be checked and why, and the sources of limits that are not the task's."""
    unchecked, sources = [], []
    if not timed:
        feed = "feed, " if path_task.durations is not None else ""
        unchecked.append(f"{feed}joint speeds and accelerations not checked: no times")
    else:
        of_limits = (
            ("joint speeds", limits.velocity, "no limits known"),
            ("joint accelerations", limits.acceleration, "the controller makes its own ramps"),
        )
        for what, most, why in of_limits:
            unknown = [n for n, limit in zip(ranges.names, most, strict=True) if limit == np.inf]
            of = ""
            if len(unknown) < len(most):
                more = f" and {len(unknown) - _NAMED} more" if len(unknown) > _NAMED else ""
                of = f" of {', '.join(unknown[:_NAMED])}{more}"
            if unknown:
                unchecked.append(f"{what}{of} not checked: {why}")
        if limits.speeds_of:
            sources.append(f"speeds checked against the {limits.speeds_of}'s data sheet")
        if limits.accelerations_of:
            sources.append(f"accelerations checked against {limits.accelerations_of}")
    if not ranges.limited.any():
        unchecked.append("joint ranges not checked: the model states none")
    return unchecked, sources


def _at_speed(ranges: JointRanges, motion: JointMotion) -> list[str]:
    """A sentence if the joints are not at rest in the first row or in the last."""
    found = []
    ends = motion.at(motion.times[[0, -1]]).velocities
    for does, velocities in zip(("begins", "ends"), ends, strict=True):
        joint = int(np.argmax(np.abs(velocities)))
        name, speed = ranges.names[joint], abs(velocities[joint])
        if speed > _REST:
            found.append(f"{name} {does} at {speed:.3g} {ranges.units[joint]}/s")
    return [f"rest at its ends not checked: {' and '.join(found)}"] if found else []
