"""How far a joint motion is from a path: at its waypoints, and proven between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.geometry import TwistProjector, many_twist_errors
from qp_twist.kinematics import FramePair, SerialChain, Stretch
from qp_twist.kinematics.frame import frame_id
from qp_twist.path import PathTask
from qp_twist.referee.displacement import LeverArms
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
from qp_twist.referee.way import Way

SAMPLES = 8
"""Points between a row or waypoint and the next at which every motion is looked at."""
WORK = 400_000
"""Further points at most that a proof may look at."""
PROVEN = 1e-6
"""Share of a tolerance by which a bound may exceed it: a motion at its limit is no endless work."""
_SHARPER = 1.02
"""Between waypoints where a tolerance is exceeded anyway, the largest value is found this well."""
_LOOSE = 1.1
"""The same where there is no tolerance."""
_EXTRA = 20_000
"""Points at most for values that are no question of tolerances."""
_FLOOR = 1e-5
"""Without a tolerance nothing below is resolved, m and rad."""
_CHUNK = 40_000
"""Stretches that are looked at together."""


@dataclass(frozen=True, eq=False)
class PathErrors:
    """Task errors of a motion, in the rows of the task only, and what it leaves that is hard.

    What is "between" a waypoint and the next has a largest value that was found at single points,
    and a bound that was proven for all of them.

    Attributes:
        position: At the waypoints, m, (N,).
        axis: At the waypoints, rad, (N,).
        bands: How far the motion is outside each of the task's hard bands, and after them each of
            its constraints, at the waypoints, m or rad, (N, B).
        position_between: Largest found between a waypoint and the next, m, (N − 1,).
        axis_between: Likewise, rad, (N − 1,).
        bands_between: Likewise, m or rad, (N − 1, B).
        position_bound: What it is proven not to exceed there, m, (N − 1,).
        axis_bound: Likewise, rad, (N − 1,).
        bands_bound: Likewise, m or rad, (N − 1, B).
        rate: Fastest progress found between a waypoint and the next, in shares of that way per
            second, beyond what errors within the tolerances can make of it, (N − 1,); 1/s.
        rate_kept: Whether the rate that was given is proven not to be exceeded, (N − 1,).
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
        """Between which waypoints tolerances, m and rad, are proven to be kept, (N − 1,).

        Bands and constraints are held to the tolerance of their unit there: the path itself is
        known no better.
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
    tolerances: tuple[float, float] | None = None,
    fastest: Array | None = None,
    samples: int = SAMPLES,
    work: int = WORK,
) -> PathErrors:
    r"""Measure a motion against the waypoints and against the way from each to the next.

    Between two waypoints the path is the straight line of their positions and the shortest rotation
    of their orientations, both in the same proportion λ ∈ [0, 1]. What counts is the distance from
    that way, not from where the feed would be: a pose is measured against the λ at which the linear
    task error is least (the angular one where the positions do not differ). Only where the rows see
    nothing of the way is it passed evenly in time.

    Nothing is concluded from points alone. From one point to the next the error is a vector that
    stays within max‖x″‖/8 of its chord, and x″ is bounded by the joints' displacements and the
    lengths of the links (:class:`~qp_twist.referee.LeverArms`). Where that does not decide, a point
    is put in the middle, until the bound is within the tolerance, a point is found outside, or the
    work is used up.

    The rows are those of the projector that is in force at both waypoints; where it changes, of the
    one with fewer rows.

    Args:
        path_task: The path.
        motion: Joints by degree of freedom of the task's robot, hinges and slides.
        times: When the motion is at each waypoint, s, (N,), never decreasing; its rows' times if
            ``None``, which then are as many as the waypoints.
        tolerances: What has to be proven between the waypoints, m and rad; errors along the path
            that are no larger are no progress. Without it the largest values are bounded to a
            tenth.
        fastest: Progress in shares of the way per second that has to be proven, (N − 1,).
        samples: Points that are looked at in any case from each waypoint, and each row between
            waypoints, to the next.
        work: Further points at most.
    """
    when = motion.times if times is None else times
    track = _Track(path_task, motion, when, tolerances)
    R, p = poses_of(path_task, motion.at(when).q)
    position, axis = _at(R, p, track.targets, path_task.in_force[: len(when)])
    bands = track.by_band(track.kept_at(Poses(motion.at(when).q, FramePair(R, p, *track.targets))))
    proof = _Proof(track, work)
    left, right = proof.start(samples)
    rate, kept = proof.rates(left, right, fastest)
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


def straight_errors(path_task: PathTask, q: Array) -> PathErrors:
    """What joints that move straight from waypoint to waypoint stray from the path, at most.

    The way between the waypoints that no file and no controller has changed yet.

    Args:
        path_task: The path.
        q: Joint positions at its first waypoints, rad or m, (N, nv).

    Raises:
        InvalidInput: If there are fewer than two rows, one is not finite, or a joint that moves the
            frame is neither hinge nor slide.
    """
    return path_errors(path_task, JointMotion(np.arange(len(q), dtype=np.float64), q))


class Outside(NamedTuple):
    """How far a motion leaves hard bands and constraints from each waypoint to the next."""

    found: Array
    """Largest that was found of each value of a band and each margin, rad or m, (N − 1, k)."""
    bound: Array
    """What it is proven not to exceed, (N − 1, k)."""
    share: Array
    """Where on each way the largest was found, from 0 to 1, (N − 1,)."""


def constraints_left(
    path_task: PathTask, q: Array, tolerances: tuple[float, float], exempt: Mask | None = None
) -> Outside:
    """How far joints that go straight between waypoints leave hard bands and constraints: proven.

    By the subdivision of :func:`path_errors`, but against a target that goes with the joints, at
    the same share of each way, and without the task's own errors.

    Args:
        path_task: The path.
        q: Joint positions at its waypoints, rad or m, (N, nv).
        tolerances: What has to be proven, m and rad.
        exempt: Values that are not asked on a way, (N − 1, k).
    """
    motion = JointMotion(np.arange(len(q), dtype=np.float64), q)
    track = _Track(path_task, motion, motion.times, tolerances, with_joints=True)
    proof = _Proof(track, WORK, exempt)
    proof.start(0)
    share = proof.time - motion.times[:-1]
    return Outside(proof.found, proof.bound, share)


class _Points(NamedTuple):
    """Points of the motion, each on the way from one waypoint to the next; K of them."""

    way: Indices
    """Index of the waypoint before each."""
    row: Indices
    """Index of the motion's row before each."""
    time: Array
    """s."""
    raw: Array
    """How far along the way, before it is cut to [0, 1]."""
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
    """Of each measure, (K, M)."""

    def take(self, which: Indices | Mask | slice) -> _Points:
        return _Points(*(part[which] for part in self))  # type: ignore[arg-type]

    @property
    def poses(self) -> Poses:
        return Poses(self.q, FramePair(self.R, self.p, self.R_d, self.p_d))


def _joined(one: _Points, other: _Points) -> _Points:
    return _Points(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))


class _Track:
    """A motion along a path: where its points are, and what may happen between two of them."""

    def __init__(
        self,
        path_task: PathTask,
        motion: JointMotion,
        when: Array,
        tolerances: tuple[float, float] | None,
        *,
        with_joints: bool = False,
    ) -> None:
        self.motion, self.when, self.tolerances = motion, when, tolerances
        self._with_joints = with_joints
        count = len(when)
        waypoints = path_task.waypoints[:count]
        R_d = np.array([w.rotation().as_matrix() for w in waypoints])
        p_d = np.array([w.translation() for w in waypoints])
        self.targets = R_d, p_d
        fewer = [
            after if after.rank <= before.rank else before
            for before, after in itertools.pairwise(path_task.in_force[:count])
        ]
        self.way = Way(R_d, p_d, fewer)
        self.chain = SerialChain.of(path_task.model, path_task.frame_name, path_task.frame_type)
        self.arms = LeverArms.of(self.chain, motion)
        #: Of hard bands and constraints.
        self.kept: list[Measure] = [
            *(BandExcess(band) for band in path_task.bands if band.weight is None),
            *map(ConstraintExcess, path_task.constraints),
        ]
        #: Of each projector its own measures, then those that hold on every way.
        self._measures: list[list[Measure]] = [
            [*([] if with_joints else [PositionError(t), AxisError(t)]), *self.kept]
            for t in self.way.projectors
        ]
        #: Of each column of values, (M,).
        self.units = (
            *(() if with_joints else ("m", "rad")),
            *(measure.unit for measure in self.kept for _ in range(measure.width)),
        )
        by_unit = dict(zip(("m", "rad"), tolerances or (np.nan, np.nan), strict=True))
        #: The tolerance of each column; NaN where there is none, (M,).
        self.limits = np.array([by_unit[unit] for unit in self.units])

    def by_band(self, values: Array) -> Array:
        """The largest of each band and each constraint, (K, B), of all their values, (K, k)."""
        ends = np.cumsum([measure.width for measure in self.kept])
        parts = np.split(values, ends[:-1], axis=1) if self.kept else []
        return np.array([part.max(axis=1) for part in parts]).reshape(len(parts), len(values)).T

    def kept_at(self, poses: Poses) -> Array:
        """What bands and constraints are left by at some poses, (K, k)."""
        return _columns([measure.at(poses) for measure in self.kept], len(poses.q))

    def points(self, way: Indices, row: Indices, time: Array) -> _Points:
        """The motion at times, measured against the way from a waypoint to the next."""
        q = self.motion.at(time).q
        R, p = self.chain.poses(q)
        begin, end = self.when[way], self.when[way + 1]
        even = (time - begin) / np.where(end > begin, end - begin, 1.0)
        raw, share = (even, even) if self._with_joints else self.way.progress(R, p, way, even)
        pair = FramePair(R, p, *self.way.at(way, share))
        values = np.empty((len(time), len(self.units)))
        for which, measures in self._groups(way):
            here = Poses(q[which], FramePair(*(part[which] for part in pair[:4])))
            values[which] = _columns([measure.at(here) for measure in measures], len(which))
        return _Points(way, row, time, raw, share, q, *pair[:4], values)

    def stretches(self, left: _Points, right: _Points) -> tuple[Passage, Array]:
        """What may happen from points to others, and how far λ may be from its chord, (K,)."""
        took = right.time - left.time
        speeds = self.motion.largest_within(left.row, left.time, right.time)
        turn, turn_change, bend = self.arms.displacement(*speeds, took)
        travel = speeds[0] * took[:, None]
        target_turn = self.way.turns[left.way] * np.abs(right.share - left.share)
        if self._with_joints:
            none = np.zeros(len(took))
            stretch = Stretch(turn, turn_change, bend, target_turn, none, none)
            return Passage(stretch, travel), none
        curve = self.way.curve(left.way, turn**2 + turn_change, bend)
        # λ is cut to [0, 1] pose by pose, the targets go evenly from the one end's to the other's:
        # that differs where the cut begins or ends between the two.
        beyond = [side.raw - side.share for side in (left, right)]
        cut = np.where(np.sign(beyond[0]) == np.sign(beyond[1]), 0.0, np.maximum(*np.abs(beyond)))
        slip = np.where(self.way.straight[left.way], np.minimum(curve + cut, 1.0), 0.0)
        stretch = Stretch(
            turn,
            turn_change,
            bend,
            target_turn,
            slip * self.way.lengths[left.way],
            slip * self.way.turns[left.way],
        )
        return Passage(stretch, travel), curve

    def most(self, left: _Points, right: _Points) -> Array:
        """Bounds of the measures between points and others, (K, M)."""
        stretch, travel = self.stretches(left, right)[0]
        bounds = np.empty((len(left.time), len(self.units)))
        for which, measures in self._groups(left.way):
            ends = left.take(which).poses, right.take(which).poses
            here = Passage(Stretch(*(part[which] for part in stretch)), travel[which])
            bounds[which] = _columns([m.most(*ends, here) for m in measures], len(which))
        return bounds

    def _groups(self, way: Indices) -> list[tuple[Indices, list[Measure]]]:
        which = self.way.which[way]
        groups = [np.flatnonzero(which == number) for number in range(len(self._measures))]
        return [
            (here, measures)
            for here, measures in zip(groups, self._measures, strict=True)
            if len(here)
        ]


class _Proof:
    """Subdivides a motion until what has to be shown between its waypoints is shown, or not."""

    def __init__(self, track: _Track, work: int, exempt: Mask | None = None) -> None:
        self.track, self.work, self.extra = track, work, min(work, _EXTRA)
        pieces, columns = len(track.when) - 1, len(track.units)
        self.exempt = np.zeros((pieces, columns), dtype=bool) if exempt is None else exempt
        self.found = np.zeros((pieces, columns))
        self.bound = np.zeros((pieces, columns))
        #: When the largest value of each piece, as a share of its tolerance, was found, s.
        self.time = track.when[:-1].copy()
        self._largest = np.zeros(pieces)

    def start(self, samples: int) -> tuple[_Points, _Points]:
        """Look at every piece at some points and prove what is between; the points' stretches."""
        way, row, begin, end = _knots(self.track.motion.times, self.track.when)
        kept = []
        step = max(1, _CHUNK // (samples + 1))
        for first in range(0, max(len(way), 1), step):
            chunk = slice(first, first + step)
            stretches = self._laid(way[chunk], row[chunk], begin[chunk], end[chunk], samples)
            kept.append(stretches)
            self._prove(*stretches)
        lefts, rights = zip(*kept, strict=True)
        # Only what progress needs is held on to: the poses of a long path are many.
        return tuple(  # type: ignore[return-value]
            _Points(*(np.concatenate(parts) for parts in zip(*side, strict=True)))
            for side in (lefts, rights)
        )

    def _laid(
        self, way: Indices, row: Indices, begin: Array, end: Array, samples: int
    ) -> tuple[_Points, _Points]:
        shares = np.arange(samples + 2) / (samples + 1)
        times = begin[:, None] + (end - begin)[:, None] * shares
        times[:, -1] = end
        parts = samples + 2
        points = self.track.points(np.repeat(way, parts), np.repeat(row, parts), times.ravel())
        grid = np.arange(len(way) * parts).reshape(-1, parts)
        inner = (times > self.track.when[way][:, None]) & (
            times < self.track.when[way + 1][:, None]
        )
        self._note(points.take(inner.ravel()))
        return points.take(grid[:, :-1].ravel()), points.take(grid[:, 1:].ravel())

    def _prove(self, left: _Points, right: _Points) -> None:
        limits = self.track.limits
        while len(left.time):
            bounds = np.where(self.exempt[left.way], 0.0, self.track.most(left, right))
            largest = self.found.max(axis=0, initial=0.0)
            # Where a tolerance is exceeded only more than all that was found is of interest.
            settled = np.isnan(limits) | (self.found[left.way] > limits)
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
            np.maximum.at(self.bound, left.way[~open_], bounds[~open_])
            left, right = self._halved(left.take(open_), right.take(open_))

    def _halved(self, left: _Points, right: _Points) -> tuple[_Points, _Points]:
        """Each stretch in two halves, what was found in the middle counted."""
        middle = self._middle(left, right)
        return _joined(left, middle), _joined(middle, right)

    def _middle(self, left: _Points, right: _Points) -> _Points:
        self.work -= len(left.time)
        middle = self.track.points(left.way, left.row, 0.5 * (left.time + right.time))
        self._note(middle)
        return middle

    def _note(self, points: _Points) -> None:
        """Count what was found at points inside their pieces."""
        values = np.where(self.exempt[points.way], 0.0, points.values)
        np.maximum.at(self.found, points.way, values)
        limits = self.track.limits
        shares = (values / np.where(np.isnan(limits), 1.0, limits)).max(axis=1, initial=0.0)
        rising = np.argsort(shares, kind="stable")
        more = rising[shares[rising] > self._largest[points.way[rising]]]
        # Of several points of a piece the last, which is the largest, stays.
        self._largest[points.way[more]] = shares[more]
        self.time[points.way[more]] = points.time[more]

    def rates(self, left: _Points, right: _Points, fastest: Array | None) -> tuple[Array, Mask]:
        """Fastest progress that was found in each piece, 1/s, and whether it is proven, (N − 1,).

        Of each change of λ that of errors within the tolerances is taken off.
        """
        track = self.track
        pieces = len(track.when) - 1
        within = track.way.within(track.tolerances or (0.0, 0.0))
        rate = np.zeros(pieces)
        took = right.time - left.time
        moved = np.maximum(np.abs(right.share - left.share) - within[left.way], 0.0)
        np.maximum.at(rate, left.way, np.divide(moved, took, out=np.zeros_like(took),
                                                where=took > 0.0))  # fmt: skip
        kept = np.zeros(pieces, dtype=bool)
        if fastest is None:
            return rate, kept
        kept |= within >= 1.0  # all of the way is no more than what errors are
        kept[np.bincount(left.way, minlength=pieces) == 0] = True
        while True:
            here = ~kept[left.way] & (rate <= fastest)[left.way]
            left, right = left.take(here), right.take(here)
            if not len(left.time):
                return rate, kept
            # A change of λ that no tolerance has to excuse first: most motions end here.
            (stretch, _), curve = track.stretches(left, right)
            took = np.maximum(right.time - left.time, np.finfo(float).tiny)
            moved_most = (
                np.linalg.norm(right.p - left.p, axis=1) + stretch.bend / 2.0,
                stretch.turn,
            )
            steepest = track.way.steepest(left.way, (left.raw, right.raw), curve, moved_most)
            slow = steepest <= (1.0 + PROVEN) * fastest[left.way] * took
            fast = np.zeros(pieces, dtype=bool)
            fast[left.way[~slow]] = True
            open_ = np.zeros(len(slow), dtype=bool)
            for piece in np.flatnonzero(fast):
                at = np.flatnonzero(left.way == piece)
                at = at[np.argsort(left.time[at], kind="stable")]
                if not track.way.by_rate[piece]:
                    open_[at] = ~slow[at]
                    continue
                span = _Span.of(track.way, left.take(at), right.take(at), curve[at])
                (up, blame), (down, _) = (s.rise(fastest[piece]) for s in (span, span.turned()))
                if max(up, down) <= (1.0 + PROVEN) * within[piece]:
                    fast[piece] = False
                    continue
                found = [s.found(fastest[piece], within[piece]) for s in (span, span.turned())]
                rate[piece] = max(rate[piece], *found)
                open_[at] = blame >= 0.5 * blame.max()
            shown = np.zeros(pieces, dtype=bool)
            shown[left.way] = True
            kept |= shown & ~fast
            open_ &= ~kept[left.way] & (rate <= fastest)[left.way]
            if not open_.any() or int(open_.sum()) > self.work:
                return rate, kept
            halves = self._halved(left.take(open_), right.take(open_))
            left, right = (
                _joined(side.take(~open_), half)
                for side, half in zip((left, right), halves, strict=True)
            )


class _Span(NamedTuple):
    """Progress along one way, stretch by stretch in the order of time; K of them."""

    begin: Array
    """s after the first."""
    end: Array
    shares: Array
    """λ at both ends, (K, 2)."""
    least: Array
    """What λ is at least."""
    most: Array
    even: Mask
    """Whether λ stays near its chord, cut and bent nowhere."""
    curve: Array
    """How near."""

    @classmethod
    def of(cls, way: Way, left: _Points, right: _Points, curve: Array) -> _Span:
        low = np.minimum(left.raw, right.raw) - curve
        high = np.maximum(left.raw, right.raw) + curve
        return cls(
            left.time - left.time[0],
            right.time - left.time[0],
            np.column_stack([left.share, right.share]),
            way.share(left.way, low),
            way.share(left.way, high),
            way.straight[left.way] & (low >= 0.0) & (high <= 1.0),
            curve,
        )

    def turned(self) -> _Span:
        """The same with λ falling where it rose."""
        return self._replace(shares=-self.shares, least=-self.most, most=-self.least)

    def rise(self, fastest: float) -> tuple[float, Array]:
        """What f = λ − fastest·t rises by at most, from any time to a later one.

        And how much of that each stretch's bounds may be to blame for, (K,).
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

    def found(self, fastest: float, within: float) -> float:
        """The rate, 1/s, of the ends by which f rises most; 0 where errors excuse that."""
        time = np.append(self.begin, self.end[-1])
        share = np.append(self.shares[:, 0], self.shares[-1, 1])
        f = share - fastest * time
        later = int(np.argmax(f - np.minimum.accumulate(f)))
        earlier = int(np.argmin(f[: later + 1]))
        if f[later] - f[earlier] <= within or time[later] <= time[earlier]:
            return 0.0
        return float((share[later] - share[earlier] - within) / (time[later] - time[earlier]))


def _knots(rows: Array, when: Array) -> tuple[Indices, Indices, Array, Array]:
    """The pieces of the motion between waypoints: on which way, after which row, from, to.

    Cut at all rows, however many lie between two waypoints, so that each is one polynomial.
    """
    inner = rows[(rows > when[0]) & (rows < when[-1])]
    knots = np.union1d(when, inner)
    begin, end = knots[:-1], knots[1:]
    way = np.clip(np.searchsorted(when, begin, side="right") - 1, 0, len(when) - 2)
    row = np.clip(np.searchsorted(rows, begin, side="right") - 1, 0, len(rows) - 2)
    return way, row, begin, end


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
    """Δt (K, 6) of K poses against K targets, each in the rows of its own projector."""
    errors = np.zeros((len(p), 6))
    ids = np.array([id(projector) for projector in rows])
    for projector in {id(t): t for t in rows}.values():
        here = ids == id(projector)
        errors[here] = many_twist_errors(R[here], p[here], R_d[here], p_d[here], projector)[1]
    return errors


def _at(
    R: Array, p: Array, targets: tuple[Array, Array], rows: Sequence[TwistProjector]
) -> tuple[Array, Array]:
    errors = task_errors(R, p, *targets, rows)
    return np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)


def _columns(parts: list[Array], rows: int) -> Array:
    """Columns side by side, (K, M), also of none."""
    return np.concatenate(parts, axis=1) if parts else np.zeros((rows, 0))
