"""Errors of a joint motion along a path: at the waypoints, and proven bounds between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Constraint
from qp_twist.geometry import TwistProjector, resolved_twist_error
from qp_twist.kinematics import FramePair, SerialChain, Stretch
from qp_twist.kinematics.frame import frame_id
from qp_twist.paths import PathTask, Waypoints
from qp_twist.referee.displacement import LeverArms
from qp_twist.referee.intervals import Intervals, fewer_rows
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.measures import (
    AxisError,
    BandExcess,
    ConstraintExcess,
    Measure,
    Passage,
    Poses,
    PositionError,
)

SAMPLES = 8
"""Points at which every motion is evaluated between consecutive rows or waypoints."""
WORK = 400_000
"""Largest number of further points that a proof may evaluate."""
PROVEN = 1e-6
"""Share of a tolerance by which a bound may exceed it: otherwise a motion exactly at its limit
would need endless subdivision."""
_SHARPER = 1.02
"""Where a tolerance is exceeded anyway: ratio of the proven bound to the largest value found."""
_LOOSE = 1.1
"""The same where there is no tolerance."""
_EXTRA = 20_000
"""Largest number of points for values that have no tolerance or exceed it anyway."""
_FLOOR = 1e-5
"""Resolution of values without a tolerance, m and rad."""
_CHUNK = 40_000
"""Number of stretches that are evaluated together."""


@dataclass(frozen=True, eq=False)
class PathErrors:
    """Errors of a motion in the rows of the task, and its violation of bands and constraints.

    For each interval between two waypoints: the largest value found at single points
    (``_between``), and a proven bound for all points (``_bound``).

    Attributes:
        position: Task error at the waypoints, m, (N,).
        axis: Task error at the waypoints, rad, (N,).
        bands: Violation of each of the task's hard bands, then of each of its constraints, at the
            waypoints, m or rad, (N, B).
        position_between: Largest position error found in each interval, m, (N − 1,).
        axis_between: Largest axis error found, rad, (N − 1,).
        bands_between: Largest violations found, m or rad, (N − 1, B).
        position_bound: Proven bound of the position error in each interval, m, (N − 1,).
        axis_bound: Proven bound of the axis error, rad, (N − 1,).
        bands_bound: Proven bounds of the violations, m or rad, (N − 1, B).
        rate: Fastest progress found in each interval, less the progress that errors within the
            tolerances can explain, in shares of the interval per second, 1/s, (N − 1,).
        rate_kept: Whether the rate is proven not to exceed ``fastest``, (N − 1,).
        band_units: ``"m"`` or ``"rad"`` of each band and constraint.
    """

    position: Array
    axis: Array
    bands: Array
    position_between: Array
    axis_between: Array
    bands_between: Array
    position_bound: Array
    axis_bound: Array
    bands_bound: Array
    rate: Array
    rate_kept: Mask
    band_units: tuple[str, ...]

    def kept(self, position: float, axis: float) -> Mask:
        """Intervals in which the tolerances, m and rad, are proven to be kept, (N − 1,).

        Violations of bands and constraints are compared with the tolerance of their unit, since the
        path itself is not known better.
        """
        kept = (self.position_bound <= (1.0 + PROVEN) * position) & (
            self.axis_bound <= (1.0 + PROVEN) * axis
        )
        for bound, unit in zip(self.bands_bound.T, self.band_units, strict=True):
            kept &= bound <= (1.0 + PROVEN) * (position if unit == "m" else axis)
        return kept


def path_errors(
    path_task: PathTask,
    motion: JointMotion,
    times: Array | None = None,
    *,
    s: Array | None = None,
    tolerances: tuple[float, float] | None = None,
    fastest: Array | None = None,
    samples: int = SAMPLES,
    work: int = WORK,
) -> PathErrors:
    r"""Measure a motion against the waypoints and against the path between them.

    Between two waypoints the path is the straight line of their positions and the shortest rotation
    of their orientations, both in the same proportion λ ∈ [0, 1]. The error is the distance from
    this path, not from the nominal pose at that time: a pose is compared with the path at the λ of
    least linear task error (angular if the positions do not differ). Only if the rows do not see
    the interval, λ is proportional to time.

    The bounds hold between the evaluated points. From one point to the next the error is a vector
    that stays within max‖x″‖/8 of its chord, and x″ is bounded by the joints' displacements and the
    lengths of the links (:class:`~qp_twist.referee.LeverArms`). If that bound exceeds the
    tolerance, the stretch is halved, until the bound is within the tolerance, a point is found
    outside, or the work is used up.

    The rows are those of the projector in force at both waypoints; where it changes, those of the
    projector with fewer rows. On a joint move no path holds: errors and violations of bands, which
    refer to a path, count as 0 there and at its via points. Constraints hold there as well.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom of the task's robot, hinges and slides.
        times: Time of the motion at each waypoint, s, (N,), non-decreasing; if ``None`` the times
            of its rows, one per waypoint.
        s: Parameters of the path (``PathTask.at``) that stand for the waypoints, (N,); if
            ``None`` its first N waypoints.
        tolerances: Errors to be proven between the waypoints, m and rad; errors along the path
            within them do not count as progress. Without it the largest values are bounded to a
            tenth.
        fastest: Rate of progress to be proven, in shares of the interval per second, (N − 1,).
        samples: Points that are always evaluated between consecutive rows or waypoints.
        work: Largest number of further points.
    """
    when = motion.times if times is None else times
    path = path_task.at(np.arange(len(when), dtype=np.float64) if s is None else s)
    track = _Track(path_task, motion, when, path, tolerances)
    q = motion.at(when).q
    R, p = poses_of(path_task, q)
    targets = path.rotations, path.positions
    errors = task_errors(R, p, *targets, path.projectors)
    position, axis = (np.linalg.norm(part, axis=1) for part in np.hsplit(errors, 2))
    bands = track.by_band(track.kept_at(Poses(q, FramePair(R, p, *targets))))
    off = ~path.on_path
    position[off] = axis[off] = 0.0
    bands[off, : track.hard_bands] = 0.0
    moves = path.moves
    proof = _Proof(track, work, moves[:, None] & track.of_path)
    left, right = proof.start(samples)
    if fastest is not None:
        fastest = np.where(moves, np.inf, fastest)
    rate, kept = proof.rates(left, right, fastest)
    rate[moves], kept[moves] = 0.0, fastest is not None
    between, bound = proof.found, proof.bound
    return PathErrors(
        position,
        axis,
        bands,
        between[:, 0],
        between[:, 1],
        track.by_band(between[:, 2:]),
        bound[:, 0],
        bound[:, 1],
        track.by_band(bound[:, 2:]),
        rate,
        kept,
        tuple(measure.unit for measure in track.kept),
    )


def straight_errors(path_task: PathTask, q: Array, s: Array | None = None) -> PathErrors:
    """Errors of a motion that interpolates the joints linearly between the waypoints.

    Args:
        path_task: The path.
        q: Joint positions at its first waypoints, rad or m, (N, nv).
        s: Parameters of the path in place of its first waypoints, (N,).

    Raises:
        InvalidInput: If there are fewer than two rows, one is not finite, or a joint that moves the
            frame is neither hinge nor slide.
    """
    return path_errors(path_task, JointMotion(np.arange(len(q), dtype=np.float64), q), s=s)


def sampled_errors(
    path_task: PathTask,
    motion: JointMotion,
    s: Array,
    pieces: Indices | None = None,
    samples: int = SAMPLES,
) -> tuple[Array, tuple[str, ...]]:
    """The errors of :func:`path_errors` at points of a motion, without a proof for the others.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom, with a row at each of the parameters.
        s: Parameters of the path, (N,).
        pieces: Index of the row before each interval that is evaluated, (K,); ``None``: all.
        samples: Points between two rows.

    Returns:
        Position error, axis error, and the violation of each hard band and each constraint, m or
        rad, (K, samples + 2, 2 + B), the first and the last at the rows; and the unit of each.
    """
    path = path_task.at(s)
    track = _Track(path_task, motion, motion.times, path, None)
    which = np.arange(len(s) - 1) if pieces is None else pieces
    shares, parts = np.linspace(0.0, 1.0, samples + 2), samples + 2
    begin, end = motion.times[which, None], motion.times[which + 1, None]
    piece = np.repeat(which, parts)
    values = track.points(piece, piece, ((1.0 - shares) * begin + shares * end).ravel()).values
    values = np.where(path.moves[piece, None] & track.of_path, 0.0, values)
    errors = np.hstack([values[:, :2], track.by_band(values[:, 2:])])
    units = ("m", "rad", *(measure.unit for measure in track.kept))
    return errors.reshape(len(which), parts, len(units)), units


class Outside(NamedTuple):
    """Violation of hard bands and constraints between consecutive waypoints."""

    found: Array
    """Largest violation found of each band's values and each margin, rad or m, (N − 1, k)."""
    bound: Array
    """Proven bound of the violation, (N − 1, k)."""
    share: Array
    """Share of each interval at which the largest was found, from 0 to 1, (N − 1,)."""


def constraints_left(path_task: PathTask, q: Array, tolerances: tuple[float, float]) -> Outside:
    """Proven violation of hard bands and constraints by linear interpolation of the joints.

    Measure and subdivision are those of :func:`path_errors`, without the task errors.

    Args:
        path_task: The path.
        q: Joint positions at its waypoints, rad or m, (N, nv).
        tolerances: Violations to be proven, m and rad.
    """
    motion = JointMotion(np.arange(len(q), dtype=np.float64), q)
    path = path_task.at(motion.times)  # one row for each waypoint
    track = _Track(path_task, motion, motion.times, path, tolerances, task_errors=False)
    proof = _Proof(track, WORK)
    proof.start(0)
    share = proof.time - motion.times[:-1]
    return Outside(proof.found, proof.bound, share)


class Left(NamedTuple):
    """Violation of one constraint by a part of a motion."""

    found: float
    """Largest violation found, rad or m; 0 inside."""
    bound: float
    """Proven bound of the violation."""
    time: float
    """Time at which the largest was found, s."""
    name: str
    """Name of the margin that is violated most, or nearest to it then."""


def constraint_left(
    path_task: PathTask,
    constraint: Constraint,
    motion: JointMotion,
    begin: float,
    end: float,
    tolerances: tuple[float, float],
) -> Left:
    """Proven violation of a constraint by a part of a motion on which no path holds.

    Uses the subdivision of :func:`path_errors`.

    Args:
        path_task: The task of the motion.
        constraint: One with margins.
        motion: Joints by degree of freedom, hinges and slides.
        begin: When the part begins, s.
        end: When it ends, s, after ``begin``.
        tolerances: Violations to be proven, m and rad.
    """
    when, path = np.array([begin, end]), path_task.at(np.zeros(2))
    proof = _Proof(
        _Track(path_task, motion, when, path, tolerances, task_errors=False, only=constraint), WORK
    )
    proof.start(0)
    time = float(proof.time[0])
    name = constraint.names[int(np.argmin(constraint.margins(motion.at([time]).q)[0]))]
    return Left(float(proof.found.max()), float(proof.bound.max()), time, name)


class _Points(NamedTuple):
    """K points of the motion, each in an interval between two waypoints."""

    interval: Indices
    """Index of the waypoint before each point."""
    row: Indices
    """Index of the motion's row before each point."""
    time: Array
    """s."""
    raw: Array
    """Progress along the interval, not clipped to [0, 1]."""
    share: Array
    """λ, in [0, 1]."""
    q: Array
    """Joints, rad or m, (K, nv)."""
    R: Array
    p: Array
    R_d: Array
    """Target at λ, (K, 3, 3)."""
    p_d: Array
    values: Array
    """Value of each measure, (K, M)."""

    def take(self, which: Indices | Mask | slice) -> _Points:
        return _Points(*(part[which] for part in self))  # type: ignore[arg-type]

    @property
    def poses(self) -> Poses:
        return Poses(self.q, FramePair(self.R, self.p, self.R_d, self.p_d))


def _joined(one: _Points, other: _Points) -> _Points:
    return _Points(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))


class _Track:
    """A motion along a path: evaluates its points, and bounds the measures between them."""

    def __init__(
        self,
        path_task: PathTask,
        motion: JointMotion,
        when: Array,
        path: Waypoints,
        tolerances: tuple[float, float] | None,
        *,
        task_errors: bool = True,
        only: Constraint | None = None,
    ) -> None:
        self.motion, self.when, self.tolerances = motion, when, tolerances
        self.intervals = Intervals(path.rotations, path.positions, fewer_rows(path.projectors))
        self.chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        self.arms = LeverArms.of(self.chain, motion)
        bands = [band for band in path_task.bands if band.weight is None and only is None]
        #: Measures of hard bands and constraints.
        self.kept: list[Measure] = [
            *map(BandExcess, bands),
            *map(ConstraintExcess, path_task.stated_constraints if only is None else [only]),
        ]
        #: For each projector its own measures, then those of every interval.
        self._measures: list[list[Measure]] = [
            [*([PositionError(t), AxisError(t)] if task_errors else []), *self.kept]
            for t in self.intervals.projectors
        ]
        #: Unit of each column of values, (M,).
        self.units = (
            *(("m", "rad") if task_errors else ()),
            *(measure.unit for measure in self.kept for _ in range(measure.width)),
        )
        by_unit = dict(zip(("m", "rad"), tolerances or (np.nan, np.nan), strict=True))
        #: Number of hard bands, which are the first of ``kept``.
        self.hard_bands = len(bands)
        widths = sum(measure.width for measure in self.kept[: self.hard_bands])
        #: Which columns refer to the path, (M,).
        self.of_path = np.arange(len(self.units)) < (2 if task_errors else 0) + widths
        #: The tolerance of each column; NaN where there is none, (M,).
        self.limits = np.array([by_unit[unit] for unit in self.units])

    def by_band(self, values: Array) -> Array:
        """Largest value of each band and each constraint, (K, B), from all values (K, k)."""
        ends = np.cumsum([measure.width for measure in self.kept])
        parts = np.split(values, ends[:-1], axis=1) if self.kept else []
        return np.array([part.max(axis=1) for part in parts]).reshape(len(parts), len(values)).T

    def kept_at(self, poses: Poses) -> Array:
        """Violations of bands and constraints at poses, (K, k)."""
        return _columns([measure.at(poses) for measure in self.kept], len(poses.q))

    def points(self, interval: Indices, row: Indices, time: Array) -> _Points:
        """The motion at given times, measured against the intervals of the path."""
        q = self.motion.at(time).q
        R, p = self.chain.poses(q)
        begin, end = self.when[interval], self.when[interval + 1]
        even = (time - begin) / np.where(end > begin, end - begin, 1.0)
        raw, share = self.intervals.progress(R, p, interval, even)
        pair = FramePair(R, p, *self.intervals.at(interval, share))
        values = np.empty((len(time), len(self.units)))
        for which, measures in self._groups(interval):
            here = Poses(q[which], FramePair(*(part[which] for part in pair[:4])))
            values[which] = _columns([measure.at(here) for measure in measures], len(which))
        return _Points(interval, row, time, raw, share, q, *pair[:4], values)

    def stretches(self, left: _Points, right: _Points) -> tuple[Passage, Array]:
        """Bounds of the motion between points, and of progress off its chord, (K,)."""
        took = right.time - left.time
        speeds = self.motion.largest_within(left.row, left.time, right.time)
        turn, turn_change, bend = self.arms.displacement(*speeds, took)
        moved = speeds[0] * took[:, None], speeds[1] * took[:, None] ** 2
        target_turn = self.intervals.turns[left.interval] * np.abs(right.share - left.share)
        curve = self.intervals.curve(left.interval, turn**2 + turn_change, bend)
        moved_most = np.linalg.norm(right.p - left.p, axis=1) + bend / 2.0, turn
        slip = self.intervals.uneven(left.interval, (left.raw, right.raw), curve, moved_most)
        stretch = Stretch(
            turn,
            turn_change,
            bend,
            target_turn,
            slip * self.intervals.lengths[left.interval],
            slip * self.intervals.turns[left.interval],
        )
        return Passage(stretch, *moved), curve

    def most(self, left: _Points, right: _Points) -> Array:
        """Bounds of the measures between points and others, (K, M)."""
        stretch, *moved = self.stretches(left, right)[0]
        bounds = np.empty((len(left.time), len(self.units)))
        for which, measures in self._groups(left.interval):
            ends = left.take(which).poses, right.take(which).poses
            of_frames = Stretch(*(part[which] for part in stretch))
            here = Passage(of_frames, *(part[which] for part in moved))
            bounds[which] = _columns([m.most(*ends, here) for m in measures], len(which))
        return bounds

    def _groups(self, interval: Indices) -> list[tuple[Indices, list[Measure]]]:
        which = self.intervals.which[interval]
        groups = [np.flatnonzero(which == number) for number in range(len(self._measures))]
        return [
            (here, measures)
            for here, measures in zip(groups, self._measures, strict=True)
            if len(here)
        ]


def _raise(largest: Array, rows: Indices, values: Array) -> None:
    """Raise rows of ``largest`` (N, M), by their indices (K,), to the values (K, M)."""
    if not len(rows):
        return
    order = np.argsort(rows, kind="stable")
    first = np.flatnonzero(np.diff(rows[order], prepend=-1))
    here = rows[order[first]]
    largest[here] = np.maximum(largest[here], np.maximum.reduceat(values[order], first))


class _Proof:
    """Subdivides a motion until its tolerances are proven or violated between the waypoints."""

    def __init__(self, track: _Track, work: int, exempt: Mask | None = None) -> None:
        self.track, self.work, self.extra = track, work, min(work, _EXTRA)
        pieces, columns = len(track.when) - 1, len(track.units)
        self.exempt = np.zeros((pieces, columns), dtype=bool) if exempt is None else exempt
        self.found = np.zeros((pieces, columns))
        self.bound = np.zeros((pieces, columns))
        #: Time at which the largest value, relative to its tolerance, was found, s, (N − 1,).
        self.time = track.when[:-1].copy()
        self._largest = np.zeros(pieces)

    def start(self, samples: int) -> tuple[_Points, _Points]:
        """Evaluate points of every interval and prove the bounds; return the ends of stretches."""
        interval, row, begin, end = _knots(self.track.motion.times, self.track.when)
        kept = []
        step = max(1, _CHUNK // (samples + 1))
        for first in range(0, max(len(interval), 1), step):
            chunk = slice(first, first + step)
            stretches = self._laid(interval[chunk], row[chunk], begin[chunk], end[chunk], samples)
            kept.append(stretches)
            self._prove(*stretches)
        lefts, rights = zip(*kept, strict=True)
        return tuple(  # type: ignore[return-value]
            _Points(*(np.concatenate(parts) for parts in zip(*side, strict=True)))
            for side in (lefts, rights)
        )

    def _laid(
        self, interval: Indices, row: Indices, begin: Array, end: Array, samples: int
    ) -> tuple[_Points, _Points]:
        shares = np.arange(samples + 2) / (samples + 1)
        times = begin[:, None] + (end - begin)[:, None] * shares
        times[:, -1] = end
        parts = samples + 2
        points = self.track.points(np.repeat(interval, parts), np.repeat(row, parts), times.ravel())
        grid = np.arange(len(interval) * parts).reshape(-1, parts)
        inner = (times > self.track.when[interval][:, None]) & (
            times < self.track.when[interval + 1][:, None]
        )
        self._note(points.take(inner.ravel()))
        return points.take(grid[:, :-1].ravel()), points.take(grid[:, 1:].ravel())

    def _prove(self, left: _Points, right: _Points) -> None:
        limits = self.track.limits
        while len(left.time):
            bounds = np.where(self.exempt[left.interval], 0.0, self.track.most(left, right))
            largest = self.found.max(axis=0, initial=0.0)
            # Where a tolerance is exceeded anyway, only values above the largest found matter.
            settled = np.isnan(limits) | (self.found[left.interval] > limits)
            sharp = np.where(
                np.isnan(limits), np.maximum(_LOOSE * largest, _FLOOR), _SHARPER * largest
            )
            above = bounds > np.where(settled, sharp, (1.0 + PROVEN) * limits)
            middle = 0.5 * (left.time + right.time)
            splits = (left.time < middle) & (middle < right.time)
            needed = (above & ~settled).any(axis=1) & splits
            wanted = above.any(axis=1) & splits & ~needed
            if int(wanted.sum()) > self.extra:
                wanted[:] = False
            if int(needed.sum()) > self.work:
                needed[:] = False
            self.extra -= int(wanted.sum())
            open_ = needed | wanted
            _raise(self.bound, left.interval[~open_], bounds[~open_])
            left, right = self._halved(left.take(open_), right.take(open_))

    def _halved(self, left: _Points, right: _Points) -> tuple[_Points, _Points]:
        """Halve each stretch, and record the values at the middle."""
        middle = self._middle(left, right)
        return _joined(left, middle), _joined(middle, right)

    def _middle(self, left: _Points, right: _Points) -> _Points:
        self.work -= len(left.time)
        middle = self.track.points(left.interval, left.row, 0.5 * (left.time + right.time))
        self._note(middle)
        return middle

    def _note(self, points: _Points) -> None:
        """Record the values at points."""
        values = np.where(self.exempt[points.interval], 0.0, points.values)
        _raise(self.found, points.interval, values)
        limits = self.track.limits
        shares = (values / np.where(np.isnan(limits), 1.0, limits)).max(axis=1, initial=0.0)
        rising = np.argsort(shares, kind="stable")
        more = rising[shares[rising] > self._largest[points.interval[rising]]]
        # Of several points of an interval, the last (largest) assignment remains.
        self._largest[points.interval[more]] = shares[more]
        self.time[points.interval[more]] = points.time[more]

    def rates(self, left: _Points, right: _Points, fastest: Array | None) -> tuple[Array, Mask]:
        """Fastest progress found in each interval, 1/s, and whether it is proven, (N − 1,).

        The change of λ that errors within the tolerances can explain is subtracted.
        """
        track = self.track
        pieces = len(track.when) - 1
        within = track.intervals.within(track.tolerances or (0.0, 0.0))
        rate = np.zeros(pieces)
        firsts = np.flatnonzero(np.diff(left.interval, prepend=-1))
        for first, last in itertools.pairwise([*firsts.tolist(), len(left.interval)]):
            piece = left.interval[first]
            time = np.append(left.time[first:last], right.time[last - 1])
            share = np.append(left.share[first:last], right.share[last - 1])
            rate[piece] = _fastest(time, share, within[piece])
        kept = np.zeros(pieces, dtype=bool)
        if fastest is None:
            return rate, kept
        kept |= within >= 1.0  # the interval is no longer than the tolerated errors
        kept[np.bincount(left.interval, minlength=pieces) == 0] = True
        while True:
            here = ~kept[left.interval] & (rate <= fastest)[left.interval]
            left, right = left.take(here), right.take(here)
            if not len(left.time):
                return rate, kept
            # First without subtracting errors: this is enough for most motions.
            (stretch, *_), curve = track.stretches(left, right)
            took = np.maximum(right.time - left.time, np.finfo(float).tiny)
            moved_most = (
                np.linalg.norm(right.p - left.p, axis=1) + stretch.bend / 2.0,
                stretch.turn,
            )
            steepest = track.intervals.steepest(
                left.interval, (left.raw, right.raw), curve, moved_most
            )
            slow = steepest <= (1.0 + PROVEN) * fastest[left.interval] * took
            fast = np.zeros(pieces, dtype=bool)
            fast[left.interval[~slow]] = True
            open_ = np.zeros(len(slow), dtype=bool)
            for piece in np.flatnonzero(fast):
                at = np.flatnonzero(left.interval == piece)
                at = at[np.argsort(left.time[at], kind="stable")]
                if not track.intervals.by_rate[piece]:
                    open_[at] = ~slow[at]
                    continue
                span = _Span.of(track.intervals, left.take(at), right.take(at), curve[at])
                (up, blame), (down, _) = (s.rise(fastest[piece]) for s in (span, span.turned()))
                if max(up, down) <= (1.0 + PROVEN) * within[piece]:
                    fast[piece] = False
                    continue
                rate[piece] = _fastest(span.times, span.progress, within[piece])
                open_[at] = blame >= 0.5 * blame.max()
            shown = np.zeros(pieces, dtype=bool)
            shown[left.interval] = True
            kept |= shown & ~fast
            open_ &= ~kept[left.interval] & (rate <= fastest)[left.interval]
            if not open_.any() or int(open_.sum()) > self.work:
                return rate, kept
            halves = self._halved(left.take(open_), right.take(open_))
            left, right = (
                _joined(side.take(~open_), half)
                for side, half in zip((left, right), halves, strict=True)
            )


class _Span(NamedTuple):
    """Progress along one interval in K stretches, in the order of time."""

    begin: Array
    """Time after the first, s."""
    end: Array
    shares: Array
    """λ at both ends, (K, 2)."""
    least: Array
    """Lower bound of λ."""
    most: Array
    """Upper bound of λ."""
    even: Mask
    """Whether λ is raw progress, neither clipped nor converted to an arc's share."""
    curve: Array
    """Bound of the distance of raw progress from its chord."""

    @classmethod
    def of(cls, intervals: Intervals, left: _Points, right: _Points, curve: Array) -> _Span:
        low = np.minimum(left.raw, right.raw) - curve
        high = np.maximum(left.raw, right.raw) + curve
        return cls(
            left.time - left.time[0],
            right.time - left.time[0],
            np.column_stack([left.share, right.share]),
            intervals.share(left.interval, low),
            intervals.share(left.interval, high),
            intervals.straight[left.interval] & (low >= 0.0) & (high <= 1.0),
            curve,
        )

    def turned(self) -> _Span:
        """The same with −λ."""
        return self._replace(shares=-self.shares, least=-self.most, most=-self.least)

    def rise(self, fastest: float) -> tuple[float, Array]:
        """Bound of the rise of f = λ − fastest·t from any time to a later one.

        And the part of it that is due to the uncertainty of each stretch, (K,).
        """
        first = self.shares[:, 0] - fastest * self.begin
        last = self.shares[:, 1] - fastest * self.end
        near = np.where(self.even, self.curve, np.inf)
        low = np.maximum(self.least - fastest * self.end, np.minimum(first, last) - near)
        high = np.minimum(self.most - fastest * self.begin, np.maximum(first, last) + near)
        up = np.maximum(last - first, 0.0)
        alone = np.minimum(self.most - self.least, up + 2.0 * near)
        later = high[1:] - np.minimum.accumulate(low)[:-1]
        return float(np.concatenate([alone, later]).max(initial=0.0)), alone - up

    @property
    def times(self) -> Array:
        """All ends, s, (K + 1,)."""
        return np.append(self.begin, self.end[-1])

    @property
    def progress(self) -> Array:
        """λ at all ends, (K + 1,)."""
        return np.append(self.shares[:, 0], self.shares[-1, 1])


def _fastest(time: Array, share: Array, within: float) -> float:
    r"""Fastest progress from any of some times to a later one, less what errors explain, 1/s.

    .. math:: \max_{i<j} \frac{|\lambda_j - \lambda_i| - \text{within}}{t_j - t_i}

    By Dinkelbach's iteration: for a rate r the pair with the largest rise of λ − r t has a higher
    rate, until r is the largest.
    """
    rate = 0.0
    for progress in (share, -share):
        while True:
            f = progress - rate * time
            later = int(np.argmax(f - np.minimum.accumulate(f)))
            earlier = int(np.argmin(f[: later + 1]))
            gained = progress[later] - progress[earlier] - within
            took = time[later] - time[earlier]
            if took <= 0.0 or gained <= rate * took * (1.0 + 1e-12):
                break
            rate = float(gained / took)
    return rate


def _knots(rows: Array, when: Array) -> tuple[Indices, Indices, Array, Array]:
    """Pieces of the motion: index of the interval, of the row before, start and end times.

    It is cut at all waypoints and rows, so that each piece is one polynomial.
    """
    inner = rows[(rows > when[0]) & (rows < when[-1])]
    knots = np.union1d(when, inner)
    begin, end = knots[:-1], knots[1:]
    interval = np.clip(np.searchsorted(when, begin, side="right") - 1, 0, len(when) - 2)
    row = np.clip(np.searchsorted(rows, begin, side="right") - 1, 0, len(rows) - 2)
    return interval, row, begin, end


def poses_of(path_task: PathTask, q: Array) -> tuple[Array, Array]:
    """Rotations (K, 3, 3) and positions (K, 3) of the task's frame for joints q (K, nv)."""
    model = path_task.model
    data = mujoco.MjData(model)
    index = frame_id(model, path_task.frame_name, path_task.frame_type)
    rotation = getattr(data, mink.FRAME_TO_XMAT_ATTR[path_task.frame_type])[index]
    origin = getattr(data, mink.FRAME_TO_POS_ATTR[path_task.frame_type])[index]
    R, p = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        R[k], p[k] = rotation.reshape(3, 3), origin
    return R, p


def task_errors(
    R: Array,
    p: Array,
    R_d: Array,
    p_d: Array,
    rows: Sequence[TwistProjector],
) -> Array:
    """Δt (K, 6) from K poses to K targets, each in the rows of its own projector."""
    errors = np.zeros((len(p), 6))
    ids = np.array([id(projector) for projector in rows])
    for projector in {id(t): t for t in rows}.values():
        here = ids == id(projector)
        errors[here] = resolved_twist_error(R[here], p[here], R_d[here], p_d[here], projector)[1]
    return errors


def _columns(parts: list[Array], rows: int) -> Array:
    """Concatenate columns to (K, M); (K, 0) for an empty list."""
    return np.concatenate(parts, axis=1) if parts else np.zeros((rows, 0))
