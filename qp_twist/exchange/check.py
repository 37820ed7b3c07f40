"""Whether a joint trajectory, from wherever it comes, does a task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array, instance, number
from qp_twist.errors import InvalidInput
from qp_twist.exchange.joint_rows import JointRows
from qp_twist.exchange.matching import times_at_waypoints
from qp_twist.exchange.metadata import disagreements
from qp_twist.following import Trajectory
from qp_twist.following.resolver import twist_task
from qp_twist.kinematics import JointRanges
from qp_twist.path import PathTask
from qp_twist.timing import JointMotion, PathErrors, TimedTrajectory, path_errors

POSITION_TOLERANCE = 1e-4
"""Largest linear task error that passes, m."""
AXIS_TOLERANCE_DEG = 0.05
"""Largest angular task error that passes, degrees."""
OUTSIDE = 1e-6
"""A joint is outside its range from here on, rad or m: files round."""
EXCEEDED = 1e-6
"""Share by which a speed or an acceleration exceeds its limit when it counts."""
FASTER = 1e-3
"""Share by which the feed is exceeded when it counts."""
FASTER_MATCHED = 0.02
"""The same where the times at the waypoints had to be looked for."""
RUSHED = 1.5
"""Share of the feed from which on it counts between two waypoints: a cubic from rest to rest runs
so much faster in its middle than on its way as a whole."""
_CLOCK = 1e-9
"""Times in files are rounded to it, s; what speeds and accelerations owe to that does not count."""
_BAND = 1e-5
_REST = 1e-6
"""A joint rests below this speed, rad/s or m/s."""


@dataclass(frozen=True)
class Finding:
    """One line of a check.

    Attributes:
        name: What was looked at.
        value: The largest of it (the smallest margin).
        limit: What it may be; ``None`` where there is none.
        unit: Of both.
        where: Where that is, e.g. ``"joint_4, waypoint 17"``.
        passes: Whether the value keeps the limit.
    """

    name: str
    value: float
    limit: float | None
    unit: str
    where: str
    passes: bool

    def __str__(self) -> str:
        """A sentence for people."""
        unit = f" {self.unit}" if self.unit else ""
        limit = "" if self.limit is None else f", limit {self.limit:.4g}{unit}"
        return f"{self.name}: {self.value:.4g}{unit} at {self.where}{limit}"


@dataclass(frozen=True, eq=False)
class Check:
    """What :func:`~qp_twist.check_trajectory` found.

    Attributes:
        task: Name of the task.
        rows: Number of rows of the trajectory.
        waypoints: Number of waypoints of the task.
        matched: How rows and waypoints were brought together, in words.
        findings: What was looked at, line by line.
        notes: What could not be looked at, and why; what the file says otherwise.
    """

    task: str
    rows: int
    waypoints: int
    matched: str
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def passes(self) -> bool:
        """Whether every finding passes."""
        return all(finding.passes for finding in self.findings)

    @property
    def problems(self) -> tuple[str, ...]:
        """A sentence for each finding that does not pass."""
        return tuple(str(finding) for finding in self.findings if not finding.passes)

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.passes:
            return f"passes: {self.rows} rows do {self.task}"
        return "does not pass: " + "; ".join(self.problems)

    def table(self) -> str:
        """The findings as a plain table."""
        head = ("", "largest", "limit", "", "where", "")
        cells = [
            (
                finding.name,
                f"{finding.value:.4g}",
                "–" if finding.limit is None else f"{finding.limit:.4g}",
                finding.unit,
                finding.where,
                "" if finding.passes else "✗",
            )
            for finding in self.findings
        ]
        widths = [max(len(row[k]) for row in (head, *cells)) for k in range(len(head))]
        lines = [
            "  ".join(
                cell.rjust(width) if k in (1, 2) else cell.ljust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in (head, *cells)
        ]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "task": self.task,
            "rows": self.rows,
            "waypoints": self.waypoints,
            "matched": self.matched,
            "passes": self.passes,
            "findings": [vars(finding) for finding in self.findings],
            "problems": list(self.problems),
            "notes": list(self.notes),
        }

    def __repr__(self) -> str:
        return f"Check({self.task!r}, {self.verdict!r})"


def check_trajectory(
    trajectory: JointRows | Trajectory | TimedTrajectory,
    path_task: PathTask,
    *,
    position_tolerance: float = POSITION_TOLERANCE,
    axis_tolerance_deg: float = AXIS_TOLERANCE_DEG,
) -> Check:
    """Measure a trajectory against a task: errors at and between waypoints, limits, speeds.

    Everything is computed anew from the joint positions, and from times and velocities where there
    are any; of what the trajectory says of itself only that it says otherwise becomes a note.

    As many rows as waypoints belong together one by one. With another number of rows, or where rows
    miss waypoints that the motion between them meets, the trajectory has to pass all waypoints in
    their order, at times that are looked for.

    Args:
        trajectory: From :func:`~qp_twist.read_trajectory`, or one that was just made.
        path_task: The task that it is meant for.
        position_tolerance: Largest linear task error that passes, m.
        axis_tolerance_deg: Largest angular task error that passes, degrees.

    Raises:
        InvalidInput: If a joint of the task's robot is missing, or the robot has others than hinges
            and slides.
    """
    instance("check_trajectory(path_task)", path_task, PathTask)
    position = number("position_tolerance", position_tolerance, above=0.0)
    axis = np.radians(number("axis_tolerance_deg", axis_tolerance_deg, above=0.0))
    ranges = JointRanges.of(path_task.model)
    if not ranges.only_hinges_and_slides:
        raise InvalidInput(
            "check_trajectory: the robot has ball or free joints; only hinges and slides can be "
            "checked."
        )
    given = trajectory if isinstance(trajectory, JointRows) else JointRows.of(trajectory)
    rows = given.of_joints(ranges.names)
    motion, count = rows.motion(), len(path_task.waypoints)
    one_to_one = len(rows.q) == count
    times = motion.times
    slack = position, float(axis)
    errors = path_errors(path_task, motion, slack=slack) if one_to_one else None
    if errors is None or not _met(errors, position, float(axis)):
        found = times_at_waypoints(path_task, motion, position, float(axis))
        nearest = path_errors(path_task, motion, found, slack=slack)
        if errors is None or _met(nearest, position, float(axis)):
            errors, times, one_to_one = nearest, found, False
    place = _Places(times, one_to_one=one_to_one, timed=rows.times is not None)
    findings = _of_errors(errors, position, float(axis))
    findings += _of_bands(path_task, motion, times)
    findings += _of_positions(ranges, motion, place)
    notes = disagreements(rows.metadata, path_task)
    if rows.accelerated:
        notes.append(
            "the accelerations of the file are not looked at: checked are cubics between the rows; "
            "a controller that takes accelerations moves on other curves"
        )
    timed = rows.times is not None
    if timed:
        findings += _of_speeds(path_task, ranges, motion, place)
        findings += _of_feed(path_task, times, errors.rate, one_to_one=one_to_one)
        notes += _unchecked(path_task, ranges, motion)
    elif path_task.durations is not None:
        notes.append("the trajectory has no times: feed, velocities and accelerations unchecked")
    matched = "row by row" if one_to_one else "nearest points in the waypoints' order"
    return Check(path_task.name, len(rows.q), count, matched, tuple(findings), tuple(notes))


class _Places:
    """Names the waypoint nearest to a time."""

    def __init__(self, times: Array, *, one_to_one: bool, timed: bool) -> None:
        self.times, self.one_to_one, self.timed = times, one_to_one, timed

    def __call__(self, time: float) -> str:
        k = int(np.argmin(np.abs(self.times - time)))
        if self.one_to_one:
            return f"waypoint {k + 1}"
        # Without times the rows are counted.
        return f"{f'{time:.4g} s' if self.timed else f'row {round(time) + 1}'}, waypoint {k + 1}"


def _met(errors: PathErrors, position: float, axis: float) -> bool:
    return bool((errors.position <= position).all() and (errors.axis <= axis).all())


def _of_errors(errors: PathErrors, position: float, axis: float) -> list[Finding]:
    found = []
    for name, values, limit, scale, unit in (
        ("position error", (errors.position, errors.position_between), position, 1e3, "mm"),
        ("axis error", (errors.axis, errors.axis_between), axis, 180.0 / np.pi, "°"),
    ):
        for between, error in enumerate(values):
            if not len(error):
                continue
            k = int(np.argmax(error))
            where = f"waypoints {k + 1} to {k + 2}" if between else f"waypoint {k + 1}"
            found.append(
                Finding(
                    f"{name} between" if between else name,
                    float(scale * error[k]),
                    float(scale * limit),
                    unit,
                    where,
                    bool(error[k] <= limit),
                )
            )
    return found


def _of_bands(path_task: PathTask, motion: JointMotion, times: Array) -> list[Finding]:
    """How far the frame leaves its hard bands at the waypoints."""
    if not any(band.weight is None for band in path_task.bands):
        return []
    configuration = mink.Configuration(path_task.model)
    excess = np.zeros(len(times))
    for k, q in enumerate(motion.at(times).q):
        task = twist_task(path_task, path_task.in_force[k])
        task.set_target(path_task.waypoints[k])
        configuration.update(q)
        hard = [band.weight is None for band in task.bands]
        excess[k] = np.max(np.asarray(task.band_excess(configuration))[hard], initial=0.0)
    k = int(np.argmax(excess))
    passes = bool(excess[k] <= _BAND)
    return [Finding("outside a band", excess[k], _BAND, "rad, m", f"waypoint {k + 1}", passes)]


def _of_positions(ranges: JointRanges, motion: JointMotion, place: _Places) -> list[Finding]:
    """The smallest margin, at the rows and, exactly, between them."""
    if not ranges.limited.any():
        return []
    lowest, highest = motion.extremes()
    between = np.minimum(ranges.margins(lowest), ranges.margins(highest))
    # Rows first: of a least margin at a row the row is named, not the piece that ends there.
    margins = np.vstack([ranges.margins(motion.q), between])
    times = np.concatenate([motion.times, 0.5 * (motion.times[:-1] + motion.times[1:])])
    k, joint = np.unravel_index(int(np.argmin(margins)), margins.shape)
    outside = float(np.maximum(ranges.lower - lowest, highest - ranges.upper).max())
    where = f"{ranges.names[joint]}, {place(times[k])}"
    value = float(margins[k, joint])
    return [Finding("smallest joint margin", value, 0.0, "", where, outside <= OUTSIDE)]


def _of_speeds(
    path_task: PathTask, ranges: JointRanges, motion: JointMotion, place: _Places
) -> list[Finding]:
    """Largest shares of the velocity and acceleration limits; the speeds where there are none."""
    middles = 0.5 * (motion.times[:-1] + motion.times[1:])
    T = np.diff(motion.times)[:, None]
    # Of D = Δq/T, of which a cubic's speeds have 1.5 and its accelerations 6/T at most.
    rounding = np.abs(np.diff(motion.q, axis=0)) * _CLOCK / T**2
    speeds = np.maximum(motion.largest_speeds() - 1.5 * rounding, 0.0)
    found = []
    limits = path_task.velocity_limits
    if np.isfinite(limits).any():
        found.append(_share("velocity", speeds / limits, ranges.names, middles, place))
    else:
        k, joint = np.unravel_index(int(np.argmax(speeds)), speeds.shape)
        where = f"{ranges.names[joint]}, {place(middles[k])}"
        unit = f"{ranges.units[joint]}/s"
        found.append(Finding("joint speed", float(speeds[k, joint]), None, unit, where, True))
    limits = path_task.acceleration_limits
    if np.isfinite(limits).any():
        accelerations = np.maximum(motion.largest_accelerations() - 6.0 * rounding / T, 0.0)
        if motion.velocities is None:
            # Straight pieces: what it takes to change from one speed to the next between middles.
            speeds = np.diff(motion.q, axis=0) / T
            accelerations = np.abs(np.diff(speeds, axis=0)) / np.diff(middles)[:, None]
            middles = motion.times[1:-1]
        if len(accelerations):
            found.append(
                _share("acceleration", accelerations / limits, ranges.names, middles, place)
            )
    return found


def _unchecked(path_task: PathTask, ranges: JointRanges, motion: JointMotion) -> list[str]:
    """What passes although a robot may refuse it."""
    notes = []
    if not np.isfinite(path_task.velocity_limits).any():
        notes.append("the task states no velocity limits: joint speeds are shown, not checked")
    if motion.velocities is not None and np.isfinite(path_task.acceleration_limits).any():
        for end, row in (("begins", 0), ("ends", -1)):
            speed = np.abs(motion.velocities[row])
            joint = int(np.argmax(speed))
            if speed[joint] > _REST:
                notes.append(
                    f"the trajectory {end} at speed: {ranges.names[joint]} at {speed[joint]:.3g} "
                    f"{ranges.units[joint]}/s; the robot has to be brought to it and to rest"
                )
    return notes


def _share(kind: str, use: Array, names: Sequence[str], times: Array, place: _Places) -> Finding:
    k, joint = divmod(int(np.argmax(use)), use.shape[1])
    value = 100.0 * float(use[k, joint])
    where = f"{names[joint]}, {place(times[k])}"
    return Finding(f"{kind} limits", value, 100.0, "%", where, value <= 100.0 * (1.0 + EXCEEDED))


def _of_feed(path_task: PathTask, times: Array, rate: Array, *, one_to_one: bool) -> list[Finding]:
    """How fast the waypoints are passed, how fast between them, and how long it takes in all."""
    if path_task.durations is None:
        return []
    took = np.maximum(np.diff(times), _CLOCK)  # a motion that stands still may meet two at once
    use = path_task.durations[1:] / took
    k = int(np.argmax(use))
    rounding = FASTER if one_to_one else FASTER_MATCHED
    passes = bool(use[k] <= 1.0 + rounding)
    where = f"waypoints {k + 1} to {k + 2}"
    between = path_task.durations[1:] * rate
    j = int(np.argmax(between))
    rushed = bool(between[j] > RUSHED * (1.0 + rounding))
    total = float(times[-1] - times[0])
    at_feed = f"whole path, {float(path_task.durations.sum()):.4g} s at the feed"
    return [
        Finding("feed", 100.0 * float(use[k]), 100.0, "%", where, passes),
        Finding(
            "feed between",
            100.0 * float(between[j]),
            100.0 * RUSHED,
            "%",
            f"waypoints {j + 1} to {j + 2}",
            not rushed,
        ),
        Finding("time", total, None, "s", at_feed, True),
    ]
