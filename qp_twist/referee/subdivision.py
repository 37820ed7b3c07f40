"""Subdivide a motion along a path until its tolerances are proven, or violated."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Constraint
from qp_twist.kinematics import FramePair, SerialChain, Stretch
from qp_twist.paths import PathTask, Waypoints
from qp_twist.referee.displacement import LeverArms
from qp_twist.referee.intervals import Intervals, fewer_rows
from qp_twist.referee.joint_motion import JointMotion
from qp_twist.referee.measures import (
    Measure,
    Passage,
    Poses,
    axis_error,
    band_excess,
    constraint_excess,
    position_error,
)

WORK = 400_000
"""Largest number of further points that a proof may evaluate."""
PROVEN = 1e-6
"""Share of a tolerance by which a bound may exceed it: otherwise a motion exactly at its limit
would need endless subdivision."""
_SHARPER, _LOOSE = 1.02, 1.1
"""Ratio of the proven bound to the largest value found, where a tolerance is exceeded anyway and
where there is none."""
_EXTRA = 20_000
"""Largest number of points for values that have no tolerance or exceed it anyway."""
_FLOOR = 1e-5
"""Resolution of values without a tolerance, m and rad."""
_CHUNK = 40_000
"""Number of stretches that are evaluated together."""


class Points(NamedTuple):
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

    def take(self, which: Indices | Mask | slice) -> Points:
        """Some of them."""
        return Points(*(part[which] for part in self))  # type: ignore[arg-type]

    def with_others(self, others: Points) -> Points:
        """These, then others."""
        return Points(*(np.concatenate(parts) for parts in zip(self, others, strict=True)))

    @property
    def poses(self) -> Poses:
        """Joints, frames and targets."""
        return Poses(self.q, FramePair(self.R, self.p, self.R_d, self.p_d))


class Track:
    """A motion along a path: evaluates its points, and bounds the measures between them.

    Attributes:
        kept: Measures of hard bands and constraints, or of ``only`` one constraint.
        units: Unit of each column of values, (M,).
        of_path: Which columns refer to the path, (M,).
        limits: The tolerance of each column; NaN where there is none, (M,).
    """

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
        self.motion, self.when = motion, when
        self.intervals = Intervals(path.rotations, path.positions, fewer_rows(path.projectors))
        self.chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        self.arms = LeverArms.of(self.chain, motion)
        bands = [band_excess(b) for b in path_task.bands if b.weight is None and only is None]
        constraints = path_task.stated_constraints if only is None else [only]
        self.kept = [*bands, *map(constraint_excess, constraints)]
        #: For each projector its own measures, then those of every interval.
        self._measures = [
            [*([position_error(t), axis_error(t)] if task_errors else []), *self.kept]
            for t in self.intervals.projectors
        ]
        of_task = ("m", "rad") if task_errors else ()
        self.units = (*of_task, *(m.unit for m in self.kept for _ in range(m.width)))
        columns = len(of_task) + sum(band.width for band in bands)
        self.of_path = np.arange(len(self.units)) < columns
        by_unit = dict(zip(("m", "rad"), tolerances or (np.nan, np.nan), strict=True))
        self.limits = np.array([by_unit[unit] for unit in self.units])
        #: How much of an interval errors within the tolerances can add to progress, (N − 1,).
        self.within = self.intervals.within(tolerances or (0.0, 0.0))

    def by_measure(self, values: Array) -> Array:
        """Largest value of each of ``kept``, (K, B), from all values of these, (K, k)."""
        ends = np.cumsum([measure.width for measure in self.kept])
        parts = np.split(values, ends[:-1], axis=1) if self.kept else []
        return np.array([part.max(axis=1) for part in parts]).reshape(len(parts), len(values)).T

    def points(self, interval: Indices, row: Indices, time: Array) -> Points:
        """The motion at given times, measured against the intervals of the path."""
        q = self.motion.at(time).q
        R, p = self.chain.poses(q)
        begin, end = self.when[interval], self.when[interval + 1]
        even = (time - begin) / np.where(end > begin, end - begin, 1.0)
        raw, share = self.intervals.progress(R, p, interval, even)
        targets = self.intervals.at(interval, share)
        values = np.empty((len(time), len(self.units)))
        points = Points(interval, row, time, raw, share, q, R, p, *targets, values)
        for which, measures in self._groups(interval):
            here = points.take(which).poses
            values[which] = columns_of([measure.at(here) for measure in measures], len(which))
        return points

    def stretches(self, left: Points, right: Points) -> tuple[Passage, Array, Array]:
        """Bounds of the motion between points, of raw progress off its chord, and of |dλ/ds|."""
        took = right.time - left.time
        speeds = self.motion.largest_within(left.row, left.time, right.time)
        turn, turn_change, bend = self.arms.displacement(*speeds, took)
        moved = speeds[0] * took[:, None], speeds[1] * took[:, None] ** 2
        target_turn = self.intervals.turns[left.interval] * np.abs(right.share - left.share)
        curve = self.intervals.curve(left.interval, turn**2 + turn_change, bend)
        moved_most = np.linalg.norm(right.p - left.p, axis=1) + bend / 2.0, turn
        of_progress = left.interval, (left.raw, right.raw), curve, moved_most
        slip = self.intervals.uneven(*of_progress)
        stretch = Stretch(
            turn, turn_change, bend, target_turn, slip * self.intervals.lengths[left.interval],
            slip * self.intervals.turns[left.interval],
        )  # fmt: skip
        return Passage(stretch, *moved), curve, self.intervals.steepest(*of_progress)

    def most(self, left: Points, right: Points) -> Array:
        """Bounds of the measures between points and others, (K, M)."""
        stretch, *moved = self.stretches(left, right)[0]
        bounds = np.empty((len(left.time), len(self.units)))
        for which, measures in self._groups(left.interval):
            ends = left.take(which).poses, right.take(which).poses
            of_frames = Stretch(*(part[which] for part in stretch))
            here = Passage(of_frames, *(part[which] for part in moved))
            bounds[which] = columns_of([m.most(*ends, here) for m in measures], len(which))
        return bounds

    def _groups(self, interval: Indices) -> list[tuple[Indices, list[Measure]]]:
        which = self.intervals.which[interval]
        groups = [np.flatnonzero(which == number) for number in range(len(self._measures))]
        pairs = zip(groups, self._measures, strict=True)
        return [(here, measures) for here, measures in pairs if len(here)]


def columns_of(parts: list[Array], rows: int) -> Array:
    """Concatenate columns to (K, M); (K, 0) for an empty list."""
    return np.concatenate(parts, axis=1) if parts else np.zeros((rows, 0))


class Proof:
    """Subdivides a motion until its tolerances are proven or violated between the waypoints.

    Attributes:
        found: Largest value found in each interval, (N − 1, M).
        bound: Proven bound of the values, (N − 1, M).
        time: Time at which the largest value, relative to its tolerance, was found, s, (N − 1,).
    """

    def __init__(self, track: Track, work: int = WORK, exempt: Mask | None = None) -> None:
        self.track, self.work, self.extra = track, work, min(work, _EXTRA)
        pieces, columns = len(track.when) - 1, len(track.units)
        self.exempt = np.zeros((pieces, columns), dtype=bool) if exempt is None else exempt
        self.found, self.bound = np.zeros((2, pieces, columns))
        self.time = track.when[:-1].copy()
        self._largest = np.zeros(pieces)

    def start(self, samples: int) -> tuple[Points, Points]:
        """Evaluate points of every interval and prove the bounds; return the ends of stretches."""
        interval, row, begin, end = _knots(self.track.motion.times, self.track.when)
        kept = []
        step = max(1, _CHUNK // (samples + 1))
        for first in range(0, max(len(interval), 1), step):
            chunk = slice(first, first + step)
            kept.append(self._laid(interval[chunk], row[chunk], begin[chunk], end[chunk], samples))
            self._prove(*kept[-1])
        lefts, rights = zip(*kept, strict=True)
        return tuple(  # type: ignore[return-value]
            Points(*(np.concatenate(parts) for parts in zip(*side, strict=True)))
            for side in (lefts, rights)
        )

    def _laid(
        self, interval: Indices, row: Indices, begin: Array, end: Array, samples: int
    ) -> tuple[Points, Points]:
        parts = samples + 2
        times = begin[:, None] + (end - begin)[:, None] * np.arange(parts) / (parts - 1)
        times[:, -1] = end
        points = self.track.points(np.repeat(interval, parts), np.repeat(row, parts), times.ravel())
        grid = np.arange(len(interval) * parts).reshape(-1, parts)
        when = self.track.when
        inner = (times > when[interval][:, None]) & (times < when[interval + 1][:, None])
        self._note(points.take(inner.ravel()))
        return points.take(grid[:, :-1].ravel()), points.take(grid[:, 1:].ravel())

    def _prove(self, left: Points, right: Points) -> None:
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

    def _halved(self, left: Points, right: Points) -> tuple[Points, Points]:
        """Halve each stretch, and record the values at the middle."""
        self.work -= len(left.time)
        middle = self.track.points(left.interval, left.row, 0.5 * (left.time + right.time))
        self._note(middle)
        return left.with_others(middle), middle.with_others(right)

    def _note(self, points: Points) -> None:
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

    def rates(self, left: Points, right: Points, fastest: Array | None) -> tuple[Array, Mask]:
        """Fastest progress found in each interval, 1/s, and whether it is proven, (N − 1,).

        The change of λ that errors within the tolerances can explain is subtracted.
        """
        track = self.track
        rate, within = np.zeros((2, len(track.when) - 1))
        within[:] = track.within
        firsts = np.flatnonzero(np.diff(left.interval, prepend=-1))
        for first, last in itertools.pairwise([*firsts.tolist(), len(left.interval)]):
            piece = left.interval[first]
            time = np.append(left.time[first:last], right.time[last - 1])
            share = np.append(left.share[first:last], right.share[last - 1])
            rate[piece] = _fastest(time, share, within[piece])
        if fastest is None:
            return rate, np.zeros(len(rate), dtype=bool)
        kept = within >= 1.0  # the interval is no longer than the tolerated errors
        kept[np.bincount(left.interval, minlength=len(rate)) == 0] = True
        while True:
            here = ~kept[left.interval] & (rate <= fastest)[left.interval]
            left, right = left.take(here), right.take(here)
            if not len(left.time):
                return rate, kept
            # First without subtracting errors: this is enough for most motions.
            _, curve, steepest = track.stretches(left, right)
            took = np.maximum(right.time - left.time, np.finfo(float).tiny)
            slow = steepest <= (1.0 + PROVEN) * fastest[left.interval] * took
            open_, proven = np.zeros(len(slow), dtype=bool), np.unique(left.interval)
            for piece in np.unique(left.interval[~slow]):
                at = np.flatnonzero(left.interval == piece)
                at = at[np.argsort(left.time[at], kind="stable")]
                if track.intervals.by_rate[piece]:
                    ends = left.take(at), right.take(at)
                    rise, blame = _rise(track.intervals, *ends, curve[at], fastest[piece])
                    if rise <= (1.0 + PROVEN) * within[piece]:
                        continue
                    time = np.append(ends[0].time, ends[1].time[-1])
                    share = np.append(ends[0].share, ends[1].share[-1])
                    rate[piece] = _fastest(time, share, within[piece])
                    open_[at] = blame >= 0.5 * blame.max()
                else:
                    open_[at] = ~slow[at]
                proven = proven[proven != piece]
            kept[proven] = True
            open_ &= ~kept[left.interval] & (rate <= fastest)[left.interval]
            if not open_.any() or int(open_.sum()) > self.work:
                return rate, kept
            halves = self._halved(left.take(open_), right.take(open_))
            left, right = left.take(~open_), right.take(~open_)
            left, right = left.with_others(halves[0]), right.with_others(halves[1])


def _rise(
    intervals: Intervals, left: Points, right: Points, curve: Array, fastest: float
) -> tuple[float, Array]:
    """Bound of the rise of ±λ − fastest·t from any time of an interval to a later one.

    And of the part of that of λ that is due to the uncertainty of each of the K stretches in the
    order of time, (K,); ``curve`` is how far raw progress may be from its chord.
    """
    low = np.minimum(left.raw, right.raw) - curve
    high = np.maximum(left.raw, right.raw) + curve
    least, most = intervals.share(left.interval, low), intervals.share(left.interval, high)
    # Where λ is raw progress, neither clipped nor converted to an arc's share:
    even = intervals.straight[left.interval] & (low >= 0.0) & (high <= 1.0)
    near = np.where(even, curve, np.inf)
    begin, end = fastest * (left.time - left.time[0]), fastest * (right.time - left.time[0])
    rises, blames = [], []
    for first, last, lower, upper in (
        (left.share, right.share, least, most),
        (-left.share, -right.share, -most, -least),
    ):
        f, g = first - begin, last - end
        low = np.maximum(lower - end, np.minimum(f, g) - near)
        high = np.minimum(upper - begin, np.maximum(f, g) + near)
        up = np.maximum(g - f, 0.0)
        alone = np.minimum(upper - lower, up + 2.0 * near)
        later = high[1:] - np.minimum.accumulate(low)[:-1]
        rises.append(float(np.concatenate([alone, later]).max(initial=0.0)))
        blames.append(alone - up)
    return max(rises), blames[0]


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


def _raise(largest: Array, rows: Indices, values: Array) -> None:
    """Raise rows of ``largest`` (N, M), by their indices (K,), to the values (K, M)."""
    if not len(rows):
        return
    order = np.argsort(rows, kind="stable")
    first = np.flatnonzero(np.diff(rows[order], prepend=-1))
    here = rows[order[first]]
    largest[here] = np.maximum(largest[here], np.maximum.reduceat(values[order], first))


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
