"""What is asked of every motion: errors, bands, ranges, speeds, feed, each as a named finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.path_errors import PROVEN, PathErrors, path_errors

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
CLOCK = 1e-9
"""Times in files are rounded to it, s; what speeds and accelerations owe to that does not count."""
BAND = 1e-5
"""A band is left at a waypoint from here on, rad or m."""


@dataclass(frozen=True)
class Finding:
    """One line of a check.

    Attributes:
        name: What was looked at.
        value: The largest of it that was found (the smallest margin).
        limit: What it may be; ``None`` where there is none.
        unit: Of both.
        where: Where that is, e.g. ``"joint_4, waypoint 17"``.
        passes: Whether the value keeps the limit, and between waypoints is proven to.
        bound: What the value is proven not to exceed between the points that were looked at;
            ``None`` where the value itself is exact.
    """

    name: str
    value: float
    limit: float | None
    unit: str
    where: str
    passes: bool
    bound: float | None = None

    @property
    def proven(self) -> bool:
        """Whether it is known if it passes."""
        return self.passes or self.limit is None or self.value > self.limit

    def __str__(self) -> str:
        """A sentence for people."""
        unit = f" {self.unit}" if self.unit else ""
        limit = "" if self.limit is None else f", limit {self.limit:.4g}{unit}"
        found = f"{self.name}: {self.value:.4g}{unit} at {self.where}{limit}"
        if self.proven:
            return found
        more = "more" if self.bound is None else f"up to {self.bound:.4g}{unit}"
        return (
            f"{found}, but not proven: between the points looked at it may be {more}; put rows "
            "closer together there"
        )


@dataclass(frozen=True)
class Tolerances:
    """Largest task errors that pass.

    Between waypoints a hard band may be left by as much, each in its unit: the path itself is known
    no better there.

    Attributes:
        position: m.
        axis: rad.
    """

    position: float = POSITION_TOLERANCE
    axis: float = float(np.radians(AXIS_TOLERANCE_DEG))


@dataclass(frozen=True, eq=False)
class Passing:
    """When a motion is at each waypoint.

    Attributes:
        times: s, (N,), never decreasing.
        timed: Whether the motion's times are a clock's; otherwise they count its rows.
        by_row: Whether each waypoint has its row.
    """

    times: Array
    timed: bool
    by_row: bool

    def place(self, time: float) -> str:
        """The waypoint nearest to a time, in words."""
        k = int(np.argmin(np.abs(self.times - time)))
        if self.by_row:
            return f"waypoint {k + 1}"
        # Without times the rows are counted.
        return f"{f'{time:.4g} s' if self.timed else f'row {round(time) + 1}'}, waypoint {k + 1}"


def examine(
    path_task: PathTask,
    motion: JointMotion,
    tolerances: Tolerances | None = None,
    passing: Passing | None = None,
    errors: PathErrors | None = None,
) -> tuple[Finding, ...]:
    """Ask a motion about every constraint of its task, at and between the waypoints.

    Task errors and hard tolerance bands between the waypoints are proven by subdivision
    (:func:`~qp_twist.referee.path_errors`), as is the feed; ranges, speeds and accelerations
    of the joints have their extremes in closed form.

    Args:
        path_task: The task.
        motion: Joints by degree of freedom, and the way between its rows.
        tolerances: Largest task errors that pass; 0.1 mm and 0.05° if ``None``.
        passing: When the motion is at each waypoint; if ``None``, it has a row for each, and its
            times are a clock's if the task has one.
        errors: From :func:`~qp_twist.trajectories.path_errors` for these tolerances, times and
            ``fastest_progress``, where they are known.

    Raises:
        InvalidInput: If the robot has joints that are neither hinges nor slides, or the task a band
            that cannot be proven.
    """
    ranges = JointRanges.of(path_task.model)
    if not ranges.only_hinges_and_slides:
        raise InvalidInput(
            f"{path_task.name}: the robot has ball or free joints; only motions of hinges and "
            "slides can be checked."
        )
    tolerances = tolerances or Tolerances()
    passing = passing or Passing(motion.times, path_task.durations is not None, by_row=True)
    if errors is None:
        errors = errors_of(path_task, motion, tolerances, passing)
    findings = [
        *_of_errors(errors, tolerances),
        *_of_bands(path_task, errors, tolerances),
        *_of_constraints(path_task, motion, errors, tolerances, passing),
        *_of_positions(ranges, motion, passing),
    ]
    if passing.timed:
        findings += _of_speeds(path_task, ranges, motion, passing)
        findings += _of_feed(path_task, errors, passing)
    return tuple(findings)


def errors_of(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> PathErrors:
    """The task errors of a motion as :func:`examine` needs them."""
    return path_errors(
        path_task,
        motion,
        passing.times,
        tolerances=(tolerances.position, tolerances.axis),
        fastest=_fastest(path_task, passing),
    )


def _fastest(path_task: PathTask, passing: Passing) -> Array | None:
    """Largest progress between a waypoint and the next, 1/s, (N − 1,)."""
    if path_task.durations is None or not passing.timed:
        return None
    most: Array = _rushed(passing) / path_task.durations[1 : len(passing.times)]
    return most


def _rushed(passing: Passing) -> float:
    return RUSHED * (1.0 + (FASTER if passing.by_row else FASTER_MATCHED))


def _of_errors(errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    found = []
    degrees = 180.0 / np.pi
    for name, at, between, bound, limit, scale, unit in (
        ("position error", errors.position, errors.position_between, errors.position_bound,
         tolerances.position, 1e3, "mm"),
        ("axis error", errors.axis, errors.axis_between, errors.axis_bound,
         tolerances.axis, degrees, "°"),
    ):  # fmt: skip
        k = int(np.argmax(at))
        where = f"waypoint {k + 1}"
        passes = bool(at[k] <= limit)
        found.append(Finding(name, scale * float(at[k]), scale * limit, unit, where, passes))
        if len(between):
            found.append(_between(f"{name} between", between, bound, limit, scale, unit))
    return found


def _between(
    name: str, values: Array, bound: Array, limit: float, scale: float, unit: str, which: str = ""
) -> Finding:
    """The largest value between waypoints, or the largest bound where that fails alone."""
    kept = bound <= (1.0 + PROVEN) * limit
    exceeded = values > limit
    k = int(np.argmax(values if kept.all() or exceeded.any() else bound))
    return Finding(
        name,
        scale * float(values[k]),
        scale * limit,
        unit,
        f"waypoints {k + 1} to {k + 2}{which}",
        bool(kept.all() and not exceeded.any()),
        scale * float(bound.max()),
    )


def _of_bands(path_task: PathTask, errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    """How far the frame leaves its hard bands at the waypoints, and between them."""
    hard = [band for band in path_task.bands if band.weight is None]
    if not hard:
        return []
    worst = errors.bands[:, : len(hard)].max(axis=1)
    k = int(np.argmax(worst))
    passes = bool(worst[k] <= BAND)
    found = [
        Finding("outside a band", float(worst[k]), BAND, "rad, m", f"waypoint {k + 1}", passes)
    ]
    between = [
        _between("outside a band between", values, bound, limit, 1.0, unit, f", {band.kind} band")
        for band, values, bound, unit, limit in (
            (band, errors.bands_between[:, b], errors.bands_bound[:, b], unit,
             tolerances.position if unit == "m" else tolerances.axis)
            for b, (band, unit) in enumerate(zip(hard, errors.band_units, strict=False))
        )
        if len(values)
    ]  # fmt: skip
    if between:
        # Bands of lengths and of angles side by side: what fails first, then what comes nearest.
        found.append(max(between, key=lambda f: (not f.passes, f.value / (f.limit or 1.0))))
    return found


def _of_constraints(
    path_task: PathTask,
    motion: JointMotion,
    errors: PathErrors,
    tolerances: Tolerances,
    passing: Passing,
) -> list[Finding]:
    """How far the motion leaves each of the task's constraints at the waypoints, and between."""
    found: list[Finding] = []
    first = len(errors.band_units) - len(path_task.constraints)  # after the hard bands
    for column, constraint in enumerate(path_task.constraints, start=first):
        excess, unit = errors.bands[:, column], errors.band_units[column]
        k = int(np.argmax(excess))
        margins = constraint.margins(motion.at(passing.times[k : k + 1]).q)[0]
        where = f"{constraint.names[int(np.argmin(margins))]}, waypoint {k + 1}"
        name = f"outside {constraint.kind}"
        passes = bool(excess[k] <= BAND)
        found.append(Finding(name, float(excess[k]), BAND, unit, where, passes))
        if len(errors.bands_between):
            limit = tolerances.position if unit == "m" else tolerances.axis
            between = errors.bands_between[:, column], errors.bands_bound[:, column]
            found.append(_between(f"{name} between", *between, limit, 1.0, unit))
    return found


def _of_positions(ranges: JointRanges, motion: JointMotion, passing: Passing) -> list[Finding]:
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
    where = f"{ranges.names[joint]}, {passing.place(times[k])}"
    value = float(margins[k, joint])
    return [Finding("smallest joint margin", value, 0.0, "", where, outside <= OUTSIDE)]


def speed_limits(path_task: PathTask) -> tuple[Array, str]:
    """Largest joint speeds that a motion is checked against, (nv,), and whose they are.

    Those of the task (its file's, or its URDF's); for the other joints those of the robot, if it is
    a known one, whose name is then returned. ∞ where nobody states one.
    """
    limits = path_task.velocity_limits
    if np.isfinite(limits).all() or path_task.known_speeds is None:
        return limits, ""
    robot, speeds = path_task.known_speeds
    filled = np.where(np.isfinite(limits), limits, speeds)
    return filled, robot.name if (filled != limits).any() else ""


def _of_speeds(
    path_task: PathTask, ranges: JointRanges, motion: JointMotion, passing: Passing
) -> list[Finding]:
    """Largest shares of the velocity and acceleration limits; the speeds where there are none."""
    middles = 0.5 * (motion.times[:-1] + motion.times[1:])
    clocks = _within_rounding(motion)
    speeds = np.min([clock.largest_speeds() for clock in clocks], axis=0)
    found = []
    limits, _ = speed_limits(path_task)
    if np.isfinite(limits).any():
        found.append(_share("velocity", speeds / limits, ranges.names, middles, passing))
    else:
        k, joint = np.unravel_index(int(np.argmax(speeds)), speeds.shape)
        where = f"{ranges.names[joint]}, {passing.place(middles[k])}"
        unit = f"{ranges.units[joint]}/s"
        found.append(Finding("joint speed", float(speeds[k, joint]), None, unit, where, True))
    limits = path_task.acceleration_limits
    if np.isfinite(limits).any():
        if motion.velocities is None:
            # Straight pieces: what it takes to change from one speed to the next between middles.
            speeds = np.diff(motion.q, axis=0) / np.diff(motion.times)[:, None]
            accelerations = np.abs(np.diff(speeds, axis=0)) / np.diff(middles)[:, None]
            middles = motion.times[1:-1]
        else:
            # At either end on the clock that suits it: what one gains by rounding the other loses.
            ends = np.abs([clock.end_accelerations() for clock in clocks])
            accelerations = ends.min(axis=0).max(axis=0)
        if len(accelerations):
            found.append(
                _share("acceleration", accelerations / limits, ranges.names, middles, passing)
            )
    return found


def _within_rounding(motion: JointMotion) -> list[JointMotion]:
    """The motion on its own clock, and on two from which that differs by its rounding."""
    T = np.diff(motion.times)
    clocks = [motion]
    for pieces in (T + CLOCK, np.maximum(T - CLOCK, 0.5 * T)):
        times = np.concatenate([[0.0], np.cumsum(pieces)])
        clocks.append(JointMotion(times, motion.q, motion.velocities))
    return clocks


def _share(kind: str, use: Array, names: Sequence[str], times: Array, passing: Passing) -> Finding:
    k, joint = divmod(int(np.argmax(use)), use.shape[1])
    value = 100.0 * float(use[k, joint])
    where = f"{names[joint]}, {passing.place(times[k])}"
    return Finding(f"{kind} limits", value, 100.0, "%", where, value <= 100.0 * (1.0 + EXCEEDED))


def _of_feed(path_task: PathTask, errors: PathErrors, passing: Passing) -> list[Finding]:
    """How fast the waypoints are passed, how fast between them, and how long it takes in all."""
    times = passing.times
    if path_task.durations is None or len(times) < 2:
        return []
    durations = path_task.durations[1 : len(times)]
    took = np.maximum(np.diff(times), CLOCK)  # a motion that stands still may meet two at once
    use = durations / took
    k = int(np.argmax(use))
    passes = bool(use[k] <= _rushed(passing) / RUSHED)
    between = durations * errors.rate
    exceeded = between > _rushed(passing)
    slow = exceeded.any() or errors.rate_kept.all()
    j = int(np.argmax(between if slow else ~errors.rate_kept))
    total = float(times[-1] - times[0])
    at_feed = f"whole path, {float(path_task.durations.sum()):.4g} s at the feed"
    return [
        Finding("feed", 100.0 * float(use[k]), 100.0, "%", f"waypoints {k + 1} to {k + 2}", passes),
        Finding(
            "feed between",
            100.0 * float(between[j]),
            100.0 * RUSHED,
            "%",
            f"waypoints {j + 1} to {j + 2}",
            bool(errors.rate_kept.all() and not exceeded.any()),
        ),
        Finding("time", total, None, "s", at_feed, True),
    ]
