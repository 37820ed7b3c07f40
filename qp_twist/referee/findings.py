"""Examine a motion: errors, bands, ranges, speeds and feed, each as a named finding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.constraints import Clearance, Constraint
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask, Tolerances, in_joint_moves, joint_move_ends
from qp_twist.referee.astray import Astray
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.joint_rates import CLOCK, largest_accelerations, largest_jerks, largest_speeds
from qp_twist.referee.motion_limits import MotionLimits, motion_limits
from qp_twist.referee.path_errors import Deviation, Left, PathErrors, constraint_left, path_errors
from qp_twist.referee.subdivision import PROVEN

EXCEEDED = 1e-6
"""Share by which a speed or an acceleration has to exceed its limit to count."""
FASTER = 1e-3
"""Share by which the feed has to be exceeded to count."""
FASTER_MATCHED = 0.02
"""The same between two waypoints if their times were searched. That of each is known as well as
that of one move: over K in a row it is twice a K-th of it at most, once for each end, and at least
twice FASTER, of the motion and of printed speeds."""
RUSHED = 1.5
"""Factor of the feed that counts as exceeded between two waypoints: the ratio of the largest to the
mean speed of a cubic from rest to rest."""
BEFORE, AFTER = " before the path", " after the path"
"""Ends of the names of findings about the motion before the first and after the last waypoint."""
OFF = " off the path"
"""The same of findings about parts that do not follow the path."""
_SHOWN = {"position": (1e3, "mm"), "axis": (180.0 / np.pi, "°")}
"""Factor and unit in which findings state a task error."""
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

    @property
    def shown(self) -> tuple[str, str, str]:
        """Value, bound and limit in words, empty where there is none.

        They have four digits, or where it does not pass as many as it takes that none that is
        another number looks like the limit.
        """
        limit = self.limit
        numbers = [self.value, *([] if self.bound is None else [self.bound])]
        others = [] if self.passes or limit is None else [x for x in numbers if x != limit]
        digits = next(
            (n for n in range(4, 17) if all(f"{x:.{n}g}" != f"{limit:.{n}g}" for x in others)), 17
        )
        value, bound, most = (
            "" if x is None else f"{x:.{digits}g}" for x in (self.value, self.bound, limit)
        )
        return value, bound, most

    def __str__(self) -> str:
        """The finding as a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        value, proven, most = self.shown
        limit = "" if self.limit is None else f", limit {most}{unit}"
        found = f"{self.name}: {value}{unit} at {self.where}{limit}"
        if self.proven:
            return found
        more = "more" if self.bound is None else f"up to {proven}{unit}"
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
        errors: Those of ``errors_of``, if already known.
        limits: Of the joints' speeds, accelerations, jerks; ``None``: those of
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
    job = path_task, motion, tolerances, passing
    findings = [
        *_of_parts(astray, tolerances, passing), *_of_errors(errors, tolerances),
        *_of_bands(path_task, errors, tolerances), *_of_constraints(*job, errors),
        *_of_joint_moves(*job), *_off_the_path(*job),
        *_of_positions(ranges, motion, tolerances, passing),
    ]  # fmt: skip
    if passing.timed:
        limits = limits or motion_limits(path_task)
        findings += _of_speeds(limits, ranges, motion, passing)
        findings += _of_braking(limits, ranges, motion, tolerances)
        findings += _of_feed(path_task, errors, passing, tolerances)
    return tuple(findings)


def errors_of(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> PathErrors:
    """The task errors of a motion as :func:`examine` needs them."""
    fastest = None
    if path_task.durations is not None and passing.timed:
        with np.errstate(divide="ignore"):
            fastest = RUSHED * _allowed(passing) / _at_feed(path_task, len(passing.times))
    proven = tolerances.position, tolerances.axis
    return path_errors(path_task, motion, passing.times, tolerances=proven, fastest=fastest)


def _at_feed(path_task: PathTask, count: int) -> Array:
    """Times between waypoints at the feed, s, (count − 1,); 0 of joint moves."""
    assert path_task.durations is not None
    moves = in_joint_moves(path_task, count)
    return np.where(moves, 0.0, path_task.durations[1:count])


def _allowed(passing: Passing, count: int = 1) -> float:
    """The share of the feed that does not count as exceeded, over so many waypoints in a row."""
    matched = min(FASTER_MATCHED, max(2.0 * FASTER_MATCHED / count, 2.0 * FASTER))
    return 1.0 + (FASTER if passing.by_row else matched)


# ---------------------------------------------------------------- errors, bands, constraints


def _at_waypoints(
    name: str, of: Deviation, limit: float, scale: float, unit: str, what: str = ""
) -> Finding:
    """The largest value at a waypoint; ``what`` is violated there."""
    k = int(np.argmax(of.at))
    where = f"{what}waypoint {k + 1}"
    value = float(of.at[k])
    return Finding(name, scale * value, scale * limit, unit, where, value <= limit)


def _between(
    name: str,
    of: Deviation,
    limit: float,
    scale: float,
    unit: str,
    what: str | Callable[[int], str] = "",
) -> Finding:
    """The largest value between waypoints, or the largest bound if only that fails.

    ``what`` is violated, or nearest to it; a function names it for the motion after waypoint k.
    """
    kept, exceeded = of.kept(limit), of.between > limit
    k = int(np.argmax(of.between if kept.all() or exceeded.any() else of.bound))
    return Finding(
        f"{name} between", scale * float(of.between[k]), scale * limit, unit,
        f"{what if isinstance(what, str) else what(k)}waypoints {k + 1} to {k + 2}",
        bool(kept.all() and not exceeded.any()), scale * float(of.bound.max()),
    )  # fmt: skip


def _of_errors(errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    found = []
    for kind, (scale, unit) in _SHOWN.items():
        name, of, limit = f"{kind} error", getattr(errors, kind), getattr(tolerances, kind)
        found.append(_at_waypoints(name, of, limit, scale, unit))
        if len(of.between):
            found.append(_between(name, of, limit, scale, unit))
    return found


def _of_parts(astray: Sequence[Astray], tolerances: Tolerances, passing: Passing) -> list[Finding]:
    """The largest errors where the motion is off the path."""
    parts, found = [part for part in astray if part.moves], []
    for kind, (scale, unit) in _SHOWN.items() if parts else ():
        part = max(parts, key=lambda one: float(getattr(one, kind).max()))
        limit, values = getattr(tolerances, kind), getattr(part, kind)
        k = int(np.argmax(values))
        where, value = f"{passing.moment(float(part.times[k]))}, {part.place}", float(values[k])
        name = f"{kind} error{OFF}"
        found.append(Finding(name, scale * value, scale * limit, unit, where, value <= limit))
    return found


def _of_bands(path_task: PathTask, errors: PathErrors, tolerances: Tolerances) -> list[Finding]:
    """Violation of the hard bands at the waypoints, and between them."""
    hard = [band for band in path_task.bands if band.weight is None]
    of_bands = list(zip(hard, errors.bands, strict=False))
    name, found, between = "outside a band", list[Finding](), list[Finding]()
    for band, of in of_bands:
        found.append(_at_waypoints(name, of, tolerances.band, 1.0, "rad, m"))
        if len(of.between):
            limit, what = tolerances.between(of.unit), f"{band.kind} band, "
            between.append(_between(name, of, limit, 1.0, of.unit, what))
    # Bands of lengths and of angles: failures first, then the largest ratio to the tolerance.
    return [
        max(each, key=lambda f: (not f.passes, f.value / (f.limit or 1.0)))
        for each in (found, between)
        if each
    ]


def _of_constraints(
    path_task: PathTask,
    motion: JointMotion,
    tolerances: Tolerances,
    passing: Passing,
    errors: PathErrors,
) -> list[Finding]:
    """Violation of each of the task's constraints at the waypoints, and between them."""
    found: list[Finding] = []
    constraints = path_task.stated_constraints
    for constraint, of in zip(constraints, errors.bands[-len(constraints) :], strict=False):

        def nearest(times: Array, constraint: Constraint = constraint) -> str:
            margins = constraint.margins(motion.at(times).q).min(axis=0)
            return f"{constraint.names[int(np.argmin(margins))]}, "

        def after(k: int, nearest: Callable[[Array], str] = nearest) -> str:
            return nearest(np.linspace(passing.times[k], passing.times[k + 1], _LOOKED_AT))

        name, k = f"outside {constraint.kind}", int(np.argmax(of.at))
        what = nearest(passing.times[k : k + 1])
        found.append(_at_waypoints(name, of, tolerances.band, 1.0, of.unit, what))
        if len(of.between):
            limit = tolerances.between(of.unit)
            found.append(_between(name, of, limit, 1.0, of.unit, after))
    return found


def _of_joint_moves(
    path_task: PathTask, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> list[Finding]:
    """Pairs that the clearances ignore, on joint moves that begin and end clear of them."""
    found: list[Finding] = []
    for first, last in joint_move_ends(path_task):
        if last >= len(passing.times):
            break
        begin, end = passing.times[[first, last]].tolist()
        where = f"waypoints {first + 1} to {last + 1}, {_IGNORED}"
        for clearance in _ignored(path_task, motion, begin, end):
            left = constraint_left(path_task, clearance, motion, begin, end, tolerances)
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
    ends = *motion.times[[0, -1]].tolist(), *passing.times[[0, -1]].tolist()
    for side, begin, end in ((BEFORE, ends[0], ends[2]), (AFTER, ends[3], ends[1])):
        if not end > begin:
            continue
        parts = [(constraint, "") for constraint in path_task.stated_constraints]
        parts += [(ignored, _IGNORED) for ignored in _ignored(path_task, motion, begin, end)]
        for constraint, remark in parts:
            left = constraint_left(path_task, constraint, motion, begin, end, tolerances)
            where = ", ".join(filter(None, (left.name, passing.place(left.time), remark)))
            name, unit = f"outside {constraint.kind}{side}", constraint.units[0]
            of = _way(name, left, unit, tolerances, where)
            if not remark or not of.passes:
                found.append(of)
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


# ---------------------------------------------------------------- joints


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
    return np.concatenate([motion.times, motion.middles]), margins


def _of_positions(
    ranges: JointRanges, motion: JointMotion, tolerances: Tolerances, passing: Passing
) -> list[Finding]:
    """The smallest margin, at the rows and, exactly, between them."""
    if not ranges.limited.any():
        return []
    times, margins = joint_margins(ranges, motion)
    lowest, highest = motion.extremes()
    outside = float(np.maximum(ranges.lower - lowest, highest - ranges.upper).max())
    least = _largest("smallest joint margin", -margins, ranges.names, times, passing)
    passes = outside <= tolerances.joint_range
    return [replace(least, value=-least.value, limit=0.0, passes=passes, least=True)]


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
        outside = -ranges.room(motion.q[row] + v * np.abs(v) / (2.0 * limits.acceleration))
        joint = int(np.argmax(outside))
        if outside[joint] > tolerances.joint_range and v[joint] != 0.0:
            where, unit = f"{ranges.names[joint]}, at rest", ranges.units[joint]
            found.append(Finding(name, float(outside[joint]), 0.0, unit, where, passes=False))
    return found


def velocity_use(motion: JointMotion, limits: Array) -> tuple[Array, Array]:
    """Largest speeds of the joints between rows, as shares of their limits (nv,).

    Returns:
        Middles between the rows, s, (N − 1,), and the shares, (N − 1, nv); 0 without a limit.
    """
    return motion.middles, largest_speeds(motion) / limits


def acceleration_use(motion: JointMotion, limits: Array) -> tuple[Array, Array]:
    """Largest accelerations of the joints, as shares of their limits (nv,).

    Returns:
        Times, s, (K,), and the shares, (K, nv); 0 without a limit. With velocities K = N − 1
        pieces, without the K = N − 2 changes of speed at the rows.
    """
    times, accelerations = largest_accelerations(motion)
    return times, accelerations / limits


def jerk_use(motion: JointMotion, limits: Array) -> tuple[Array, Array]:
    """Largest jerks of the joints, as shares of their limits (nv,).

    Returns:
        Middles between the rows, s, and the shares, (N − 1, nv); nothing, K = 0, if accelerations
        jump at the rows, as they do where none are stated.
    """
    if motion.accelerations is None:
        return motion.middles[:0], np.zeros((0, motion.q.shape[1]))
    return motion.middles, largest_jerks(motion) / limits


def _of_speeds(
    limits: MotionLimits, ranges: JointRanges, motion: JointMotion, passing: Passing
) -> list[Finding]:
    """Largest shares of the limits of velocity, acceleration and jerk; speeds if there are none."""
    found = []
    for kind, most, use_of in (
        ("velocity", limits.velocity, velocity_use),
        ("acceleration", limits.acceleration, acceleration_use),
        ("jerk", limits.jerk, jerk_use),
    ):
        if np.isfinite(most).any():
            times, use = use_of(motion, most)
            if len(use):
                share = _largest(f"{kind} limits", 100.0 * use, ranges.names, times, passing)
                passes = share.value <= 100.0 * (1.0 + EXCEEDED)
                found.append(replace(share, limit=100.0, unit="%", passes=passes))
        elif kind == "velocity":
            times, speeds = motion.middles, largest_speeds(motion)
            speed = _largest("joint speed", speeds, ranges.names, times, passing)
            unit = ranges.units[int(np.argmax(speeds)) % speeds.shape[1]]
            found.append(replace(speed, unit=f"{unit}/s"))
    return found


def _largest(
    name: str, values: Array, joints: Sequence[str], times: Array, passing: Passing
) -> Finding:
    """The largest of values (K, nv) at times (K,), s, without a limit."""
    k, joint = divmod(int(np.argmax(values)), values.shape[1])
    where = f"{joints[joint]}, {passing.place(times[k])}"
    return Finding(name, float(values[k, joint]), None, "", where, passes=True)


# ---------------------------------------------------------------- feed


def _fastest_part(durations: Array, took: Array, counts: Mask, passing: Passing) -> Finding:
    """The part of the path that is faster than the feed by the most of what is allowed there.

    It is between two waypoints or, where their times were searched, between 2, 4, 8, … more.
    """

    def over(count: int, of: Array | Mask) -> Array:
        total = np.append(0.0, np.cumsum(of))
        found: Array = total[count:] - total[:-count]
        return found

    parts = list[tuple[float, float, float, str]]()
    for count in [1] if passing.by_row else (2 ** np.arange(len(took).bit_length())).tolist():
        most = _allowed(passing, count)
        use = np.where(over(count, counts) == count, over(count, durations) / over(count, took), 0)
        k = int(np.argmax(use))
        where = f"waypoints {k + 1} to {k + 1 + count}"
        parts.append((float(use[k]) / most, float(use[k]), most, where))
    share, value, most, where = max(parts, key=lambda part: part[0])
    limit = 100.0 if passing.by_row else 100.0 * most
    return Finding("feed", 100.0 * value, limit, "%", where, share <= 1.0)


def _of_feed(
    path_task: PathTask, errors: PathErrors, passing: Passing, tolerances: Tolerances
) -> list[Finding]:
    """Feed at the waypoints, between them, and over the whole path.

    Two waypoints of which one is missed have no time from one to the other. Without two successive
    ones that are met there is no feed at the waypoints; the errors there do not pass then.
    """
    times, met = passing.times, tolerances.met(errors.position.at, errors.axis.at)
    if path_task.durations is None or len(times) < 2:
        return []
    durations = _at_feed(path_task, len(times))
    took = np.maximum(np.diff(times), CLOCK)  # a motion at rest may meet two waypoints at once
    both = met[:-1] & met[1:]
    use = np.where(both, durations / took, 0.0)
    found: list[Finding] = []
    if both.any():
        found.append(_fastest_part(durations, took, both & (durations > 0.0), passing))
    # The mean is part of it: what is shorter than the tolerated errors is not slower for that.
    between = np.maximum(durations * errors.rate, np.minimum(use, RUSHED))
    exceeded = between > RUSHED * _allowed(passing)
    slow = exceeded.any() or errors.rate_kept.all()
    j = int(np.argmax(between if slow else ~errors.rate_kept))
    passes, where = (
        bool(errors.rate_kept.all() and not exceeded.any()),
        f"waypoints {j + 1} to {j + 2}",
    )
    value, most = 100.0 * float(between[j]), 100.0 * RUSHED
    found.append(Finding("feed between", value, most, "%", where, passes))
    whole = "whole path" if met.all() else "not the whole path"
    where = f"{whole}, {float(durations.sum()):.4g} s at the feed"
    found.append(Finding("time", float(times[-1] - times[0]), None, "s", where, passes=True))
    moves = in_joint_moves(path_task, len(times))
    if moves.any():
        count = int(moves[0]) + int((moves[1:] & ~moves[:-1]).sum())
        many = f"{count} joint moves" if count > 1 else "1 joint move"
        air = float(np.diff(times)[moves].sum())
        found.append(Finding("time of joint moves", air, None, "s", many, passes=True))
    return found
