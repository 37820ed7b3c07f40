"""Examine a motion: errors, bands, ranges, speeds and feed, each as a named finding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.constraints import Clearance, Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, Tolerances, in_joint_moves, joint_move_ends
from qp_twist.referee.astray import Astray
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.joint_rates import CLOCK, largest_accelerations, largest_speeds
from qp_twist.referee.motion_limits import MotionLimits, motion_limits
from qp_twist.referee.path_errors import PROVEN, Left, PathErrors, constraint_left, path_errors

EXCEEDED = 1e-6
"""Share by which a speed or an acceleration has to exceed its limit to count."""
FASTER = 1e-3
"""Share by which the feed has to be exceeded to count."""
FASTER_MATCHED = 0.02
"""The same if the times at the waypoints were searched."""
RUSHED = 1.5
"""Factor of the feed that counts as exceeded between two waypoints: the ratio of the largest to the
mean speed of a cubic from rest to rest."""
BEFORE, AFTER = " before the path", " after the path"
"""Ends of the names of findings about the motion before the first and after the last waypoint."""
OFF = " off the path"
"""The same of findings about parts that do not follow the path."""
_ERRORS = (("position", 1e3, "mm"), ("axis", 180.0 / np.pi, "°"))
"""Task errors, and the unit in which a finding states them."""
_IGNORED = "pairs that are ignored elsewhere"
_LOOKED_AT = 21
"""Places between two waypoints at which it is looked for what is violated most."""


@dataclass(frozen=True)
class Finding:
    """One line of a check.

    Attributes:
        name: The checked quantity.
        value: Its largest value found (for margins the smallest).
        limit: Its limit; ``None`` without one.
        unit: Unit of both.
        where: Place of the value, e.g. ``"joint_4, waypoint 17"``.
        passes: Whether the value is within the limit, proven also between waypoints.
        bound: Proven bound of the value between the evaluated points; ``None`` if the value itself
            is exact.
        least: Whether the limit is the least value that passes.
    """

    name: str
    value: float
    limit: float | None
    unit: str
    where: str
    passes: bool
    bound: float | None = None
    least: bool = False

    @property
    def proven(self) -> bool:
        """Whether it is decided if it passes."""
        if self.passes or self.limit is None:
            return True
        return self.value < self.limit if self.least else self.value > self.limit

    def __str__(self) -> str:
        """The finding as a sentence."""
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


@dataclass(frozen=True, eq=False)
class Passing:
    """Times at which a motion passes the waypoints.

    Attributes:
        times: s, (N,), nondecreasing.
        timed: Whether the motion's times are seconds; otherwise they are row numbers.
        by_row: Whether rows and waypoints correspond one by one.
    """

    times: Array
    timed: bool
    by_row: bool

    def place(self, time: float) -> str:
        """The waypoint nearest to a time, or the side of the path on which it lies, in words."""
        waypoint = f"waypoint {int(np.argmin(np.abs(self.times - time))) + 1}"
        if self.by_row:
            return waypoint
        if time < self.times[0]:
            waypoint = "before the first waypoint"
        elif time > self.times[-1]:
            waypoint = "after the last waypoint"
        return f"{self.moment(time)}, {waypoint}"

    def moment(self, time: float) -> str:
        """A time in words; without times, the row."""
        return f"{time:.4g} s" if self.timed else f"row {round(time) + 1}"


def examine(
    path_task: PathTask,
    motion: JointMotion,
    tolerances: Tolerances | None = None,
    passing: Passing | None = None,
    errors: PathErrors | None = None,
    limits: MotionLimits | None = None,
    astray: Sequence[Astray] = (),
) -> tuple[Finding, ...]:
    """Check a motion against every constraint of its task, at and between the waypoints.

    Task errors and hard tolerance bands between the waypoints are proven by subdivision
    (:func:`~qp_twist.referee.path_errors`), as is the feed; ranges, speeds and accelerations
    of the joints have their extremes in closed form.

    Args:
        path_task: The task.
        motion: Joints by degree of freedom, with the interpolation between its rows.
        tolerances: What passes; those of the task if ``None``.
        passing: Times at the waypoints; if ``None``, rows and waypoints correspond, and times are
            seconds if the task has a feed.
        errors: Result of :func:`~qp_twist.trajectories.path_errors` for these tolerances, times and
            ``fastest_progress``, if already known.
        limits: Of the joints' speeds and accelerations; ``None``: those of
            :func:`~qp_twist.referee.motion_limits`.
        astray: The parts that do not follow the path, from
            :func:`~qp_twist.referee.astray_parts`.

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
    tolerances = tolerances or path_task.tolerances
    passing = passing or Passing(motion.times, path_task.durations is not None, by_row=True)
    if errors is None:
        errors = errors_of(path_task, motion, tolerances, passing)
    findings = [
        *_of_parts(astray, tolerances, passing),
        *_of_errors(errors, tolerances),
        *_of_bands(path_task, errors, tolerances),
        *_of_constraints(path_task, motion, errors, tolerances, passing),
        *_of_joint_moves(path_task, motion, tolerances, passing),
        *_off_the_path(path_task, motion, tolerances, passing),
        *_of_positions(ranges, motion, tolerances, passing),
    ]
    if passing.timed:
        limits = limits or motion_limits(path_task)
        findings += _of_speeds(limits, ranges, motion, passing)
        findings += _of_braking(limits, ranges, motion, tolerances)
        met = tolerances.met(errors.position, errors.axis)
        findings += _of_feed(path_task, errors, passing, met)
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
    durations = _at_feed(path_task, len(passing.times))
    with np.errstate(divide="ignore"):
        most: Array = _rushed(passing) / durations
    return most


def _at_feed(path_task: PathTask, count: int) -> Array:
    """Times between waypoints at the feed, s, (count − 1,); 0 of joint moves."""
    assert path_task.durations is not None
    moves = in_joint_moves(path_task, count)
    durations: Array = np.where(moves, 0.0, path_task.durations[1:count])
    return durations


def _rushed(passing: Passing) -> float:
    return RUSHED * (1.0 + (FASTER if passing.by_row else FASTER_MATCHED))


def _of_errors(errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    found = []
    for kind, scale, unit in _ERRORS:
        limit, at = getattr(tolerances, kind), getattr(errors, kind)
        k = int(np.argmax(at))
        passes, value = bool(at[k] <= limit), scale * float(at[k])
        name = f"{kind} error"
        found.append(Finding(name, value, scale * limit, unit, f"waypoint {k + 1}", passes))
        between, bound = getattr(errors, f"{kind}_between"), getattr(errors, f"{kind}_bound")
        if len(between):
            found.append(_between(f"{name} between", between, bound, limit, scale, unit))
    return found


def _of_parts(astray: Sequence[Astray], tolerances: Tolerances, passing: Passing) -> list[Finding]:
    """The largest errors where the motion is off the path."""
    parts, found = [part for part in astray if part.moves], []
    for kind, scale, unit in _ERRORS if parts else ():
        part = max(parts, key=lambda one: float(getattr(one, kind).max()))
        limit, values = getattr(tolerances, kind), getattr(part, kind)
        k = int(np.argmax(values))
        where = f"{passing.moment(float(part.times[k]))}, {part.place}"
        value = float(values[k])
        passes, name = value <= limit, f"{kind} error{OFF}"
        found.append(Finding(name, scale * value, scale * limit, unit, where, passes))
    return found


def _between(
    name: str,
    values: Array,
    bound: Array,
    limit: float,
    scale: float,
    unit: str,
    what: str | Callable[[int], str] = "",
) -> Finding:
    """The largest value between waypoints, or the largest bound if only that fails.

    ``what`` is violated, or nearest to it; a function names it for the motion after waypoint k.
    """
    kept = bound <= (1.0 + PROVEN) * limit
    exceeded = values > limit
    k = int(np.argmax(values if kept.all() or exceeded.any() else bound))
    named = what if isinstance(what, str) else what(k)
    return Finding(
        name,
        scale * float(values[k]),
        scale * limit,
        unit,
        ", ".join(filter(None, (named, f"waypoints {k + 1} to {k + 2}"))),
        bool(kept.all() and not exceeded.any()),
        scale * float(bound.max()),
    )


def _of_bands(path_task: PathTask, errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    """Violation of the hard bands at the waypoints, and between them."""
    hard = [band for band in path_task.bands if band.weight is None]
    if not hard:
        return []
    worst = errors.bands[:, : len(hard)].max(axis=1)
    k = int(np.argmax(worst))
    limit = tolerances.band
    passes = bool(worst[k] <= limit)
    found = [
        Finding("outside a band", float(worst[k]), limit, "rad, m", f"waypoint {k + 1}", passes)
    ]
    between = []
    for column, (band, unit) in enumerate(zip(hard, errors.band_units, strict=False)):
        values, bound = errors.bands_between[:, column], errors.bands_bound[:, column]
        limit = tolerances.between(unit)
        if len(values):
            name = "outside a band between"
            between.append(_between(name, values, bound, limit, 1.0, unit, f"{band.kind} band"))
    if between:
        # Compare bands of lengths and of angles: failures first, then the largest ratio to the
        # tolerance.
        found.append(max(between, key=lambda f: (not f.passes, f.value / (f.limit or 1.0))))
    return found


def _of_constraints(
    path_task: PathTask,
    motion: JointMotion,
    errors: PathErrors,
    tolerances: Tolerances,
    passing: Passing,
) -> list[Finding]:
    """Violation of each of the task's constraints at the waypoints, and between them."""
    found: list[Finding] = []
    first = len(errors.band_units) - len(path_task.stated_constraints)  # after the hard bands
    for column, constraint in enumerate(path_task.stated_constraints, start=first):
        excess, unit = errors.bands[:, column], errors.band_units[column]
        k = int(np.argmax(excess))
        margins = constraint.margins(motion.at(passing.times[k : k + 1]).q)[0]
        where = f"{constraint.names[int(np.argmin(margins))]}, waypoint {k + 1}"
        name = f"outside {constraint.kind}"
        passes = bool(excess[k] <= tolerances.band)
        found.append(Finding(name, float(excess[k]), tolerances.band, unit, where, passes))
        if len(errors.bands_between):
            limit = tolerances.between(unit)
            between = errors.bands_between[:, column], errors.bands_bound[:, column]

            def nearest(k: int, constraint: Constraint = constraint) -> str:
                times = np.linspace(passing.times[k], passing.times[k + 1], _LOOKED_AT)
                margins = constraint.margins(motion.at(times).q).min(axis=0)
                return constraint.names[int(np.argmin(margins))]

            found.append(_between(f"{name} between", *between, limit, 1.0, unit, nearest))
    return found


def _of_joint_moves(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> list[Finding]:
    """Pairs that the clearances ignore, on joint moves that begin and end clear of them."""
    found: list[Finding] = []
    limits = tolerances.position, tolerances.axis
    for first, last in joint_move_ends(path_task):
        if last >= len(passing.times):
            break
        begin, end = passing.times[[first, last]].tolist()
        where = f"waypoints {first + 1} to {last + 1}, {_IGNORED}"
        for clearance in _ignored(path_task, motion, begin, end):
            left = constraint_left(path_task, clearance, motion, begin, end, limits)
            found.append(_way("outside clearance on joint moves", left, "m", tolerances, where))
    # One line for all of them.
    return [max(found, key=lambda f: (not f.passes, f.value))] if found else []


def _off_the_path(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> list[Finding]:
    """Violation of the constraints before the first waypoint and after the last.

    No path holds there. As on joint moves, the clearances judge pairs that they ignore elsewhere,
    too, where these are clear at both ends.
    """
    found: list[Finding] = []
    limits = tolerances.position, tolerances.axis
    ends = *motion.times[[0, -1]].tolist(), *passing.times[[0, -1]].tolist()
    for side, begin, end in ((BEFORE, ends[0], ends[2]), (AFTER, ends[3], ends[1])):
        if not end > begin:
            continue
        parts = [(constraint, "") for constraint in path_task.stated_constraints]
        parts += [(ignored, _IGNORED) for ignored in _ignored(path_task, motion, begin, end)]
        for constraint, remark in parts:
            left = constraint_left(path_task, constraint, motion, begin, end, limits)
            where = ", ".join(filter(None, (left.name, passing.place(left.time), remark)))
            name, unit = f"outside {constraint.kind}{side}", constraint.units[0]
            finding = _way(name, left, unit, tolerances, where)
            if not remark or not finding.passes:
                found.append(finding)
    return found


def _way(name: str, left: Left, unit: str, tolerances: Tolerances, where: str) -> Finding:
    """Violation of a constraint on a way that is no path."""
    limit = tolerances.between(unit)
    passes = left.bound <= (1.0 + PROVEN) * limit
    return Finding(name, left.found, limit, unit, where, passes, left.bound)


def _ignored(path_task: PathTask, motion: JointMotion, begin: float, end: float) -> list[Clearance]:
    """The pairs that each clearance ignores, as far as they are clear at both times."""
    if not end > begin:
        return []
    ends = motion.at([begin, end]).q
    ignored = [c.of_ignored(ends) for c in path_task.constraints if isinstance(c, Clearance)]
    return [clearance for clearance in ignored if len(clearance.pairs)]


def joint_margins(ranges: JointRanges, motion: JointMotion) -> tuple[Array, Array]:
    """Margins of the joints at the rows and, the least exactly, between them.

    Returns:
        Times of the rows, then the middles between them, s, (2N − 1,), and the margins there,
        (2N − 1, nv): ``1 − |θ − θ̄| / half-range``, ∞ without a range.
    """
    lowest, highest = motion.extremes()
    between = np.minimum(ranges.margins(lowest), ranges.margins(highest))
    # Rows first: a least margin at a row is reported there, not for the piece that ends there.
    margins = np.vstack([ranges.margins(motion.q), between])
    return np.concatenate([motion.times, _middles(motion)]), margins


def _middles(motion: JointMotion) -> Array:
    middles: Array = 0.5 * (motion.times[:-1] + motion.times[1:])
    return middles


def _of_positions(
    ranges: JointRanges, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> list[Finding]:
    """The smallest margin, at the rows and, exactly, between them."""
    if not ranges.limited.any():
        return []
    times, margins = joint_margins(ranges, motion)
    lowest, highest = motion.extremes()
    k, joint = np.unravel_index(int(np.argmin(margins)), margins.shape)
    outside = float(np.maximum(ranges.lower - lowest, highest - ranges.upper).max())
    where = f"{ranges.names[joint]}, {passing.place(times[k])}"
    value, passes = float(margins[k, joint]), outside <= tolerances.joint_range
    return [Finding("smallest joint margin", value, 0.0, "", where, passes, least=True)]


def _of_braking(
    limits: MotionLimits, ranges: JointRanges, motion: JointMotion, tolerances: Tolerances
) -> list[Finding]:
    """Joints at speed in the first or last row that no acceleration keeps inside their ranges.

    From speed v a joint comes to rest, at its largest acceleration a, after v²/(2a); before the
    first row it needs as much to come to v.
    """
    found = []
    velocities = motion.at(motion.times[[0, -1]]).velocities
    for name, row, v in (
        ("range before the first row", 0, -velocities[0]),
        ("range after the last row", -1, velocities[1]),
    ):
        rest = motion.q[row] + v * np.abs(v) / (2.0 * limits.acceleration)
        outside = np.maximum(ranges.lower - rest, rest - ranges.upper)
        joint = int(np.argmax(outside))
        if outside[joint] > tolerances.joint_range and v[joint] != 0.0:
            where = f"{ranges.names[joint]}, at rest"
            value, unit = float(outside[joint]), ranges.units[joint]
            found.append(Finding(name, value, 0.0, unit, where, passes=False))
    return found


def velocity_use(motion: JointMotion, limits: Array) -> tuple[Array, Array]:
    """Largest speeds of the joints between rows, as shares of their limits (nv,).

    Returns:
        Middles between the rows, s, (N − 1,), and the shares, (N − 1, nv); 0 without a limit.
    """
    return _middles(motion), largest_speeds(motion) / limits


def acceleration_use(motion: JointMotion, limits: Array) -> tuple[Array, Array]:
    """Largest accelerations of the joints, as shares of their limits (nv,).

    Returns:
        Times, s, (K,), and the shares, (K, nv); 0 without a limit. With velocities K = N − 1
        pieces, without the K = N − 2 changes of speed at the rows.
    """
    times, accelerations = largest_accelerations(motion)
    return times, accelerations / limits


def _of_speeds(
    limits: MotionLimits, ranges: JointRanges, motion: JointMotion, passing: Passing
) -> list[Finding]:
    """Largest shares of the velocity and acceleration limits; the speeds if there are none."""
    found = []
    if np.isfinite(limits.velocity).any():
        middles, use = velocity_use(motion, limits.velocity)
        found.append(_share("velocity", use, ranges.names, middles, passing))
    else:
        speeds = largest_speeds(motion)
        k, joint = np.unravel_index(int(np.argmax(speeds)), speeds.shape)
        where = f"{ranges.names[joint]}, {passing.place(_middles(motion)[k])}"
        unit = f"{ranges.units[joint]}/s"
        found.append(Finding("joint speed", float(speeds[k, joint]), None, unit, where, True))
    if np.isfinite(limits.acceleration).any():
        times, use = acceleration_use(motion, limits.acceleration)
        if len(use):
            found.append(_share("acceleration", use, ranges.names, times, passing))
    return found


def _share(kind: str, use: Array, names: Sequence[str], times: Array, passing: Passing) -> Finding:
    k, joint = divmod(int(np.argmax(use)), use.shape[1])
    value = 100.0 * float(use[k, joint])
    where = f"{names[joint]}, {passing.place(times[k])}"
    return Finding(f"{kind} limits", value, 100.0, "%", where, value <= 100.0 * (1.0 + EXCEEDED))


def _of_feed(path_task: PathTask, errors: PathErrors, passing: Passing, met: Mask) -> list[Finding]:
    """Feed at the waypoints, between them, and over the whole path.

    Two waypoints of which one is missed have no time from one to the other. Without two successive
    ones that are met there is no feed at the waypoints; the errors there do not pass then.
    """
    times = passing.times
    if path_task.durations is None or len(times) < 2:
        return []
    durations = _at_feed(path_task, len(times))
    took = np.maximum(np.diff(times), CLOCK)  # a motion at rest may meet two waypoints at once
    both = met[:-1] & met[1:]
    use = np.where(both, durations / took, 0.0)
    k = int(np.argmax(use))
    at_waypoints: list[Finding] = []
    if both.any():
        passes = bool(use[k] <= _rushed(passing) / RUSHED)
        where = f"waypoints {k + 1} to {k + 2}"
        at_waypoints = [Finding("feed", 100.0 * float(use[k]), 100.0, "%", where, passes)]
    # The mean is part of it: what is shorter than the tolerated errors is not slower for that.
    between = np.maximum(durations * errors.rate, np.minimum(use, RUSHED))
    exceeded = between > _rushed(passing)
    slow = exceeded.any() or errors.rate_kept.all()
    j = int(np.argmax(between if slow else ~errors.rate_kept))
    total = float(times[-1] - times[0])
    whole = "whole path" if met.all() else "not the whole path"
    at_feed = f"{whole}, {float(durations.sum()):.4g} s at the feed"
    moves = in_joint_moves(path_task, len(times))
    in_the_air: list[Finding] = []
    if moves.any():
        count = int(moves[0]) + int((moves[1:] & ~moves[:-1]).sum())
        many = f"{count} joint moves" if count > 1 else "1 joint move"
        air = float(np.diff(times)[moves].sum())
        in_the_air = [Finding("time of joint moves", air, None, "s", many, True)]
    return [
        *at_waypoints,
        Finding(
            "feed between",
            100.0 * float(between[j]),
            100.0 * RUSHED,
            "%",
            f"waypoints {j + 1} to {j + 2}",
            bool(errors.rate_kept.all() and not exceeded.any()),
        ),
        Finding("time", total, None, "s", at_feed, True),
        *in_the_air,
    ]
