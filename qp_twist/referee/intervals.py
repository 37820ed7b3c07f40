"""The path's intervals between consecutive waypoints, and the progress of a pose along them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.geometry import (
    ProjectorKind,
    TwistProjector,
    distinct_projectors,
    resolved_twist_error,
    rotation_matrix,
    rotation_vector,
    with_fewer_rows,
)

_SHORT = 1e-12
"""Square of a length below which it counts as zero, m² or rad²."""
_PROBE = 1e-6
"""Displacement of the differences for the derivative of the progress, m and rad."""


class _Way(NamedTuple):
    """The waypoints' poses, and the displacements from each to the next.

    Attributes:
        R: Rotations, (N, 3, 3).
        p: Positions, m, (N, 3).
        step: Displacements of the position, m, (N − 1, 3).
        turn: Rotation vectors in world axes, rad, (N − 1, 3).
    """

    R: Array
    p: Array
    step: Array
    turn: Array


class _Lines(NamedTuple):
    """Lines x₀ + λw on which progress λ = (x − x₀)·w/‖w‖² is measured.

    x is the origin in straight intervals, m, and in arcs the vectors that turn with the frame;
    columns that an interval does not need are 0.

    Attributes:
        begin: x₀, (N − 1, 9).
        along: w, (N − 1, 9).
    """

    begin: Array
    along: Array


class Intervals:
    r"""Straight lines between positions, shortest rotations between orientations.

    The progress λ of a pose is that of the nearest point of the interval, measured in the task's
    linear rows if the waypoints' positions differ in them, else in its angular rows. With rows that
    do not turn with the body it is a linear function of the origin,

    .. math:: \lambda = \frac{(\mathbf p - \mathbf p_0)\cdot\mathbf w}{\|\mathbf w\|^2},

    clipped to [0, 1], with w the displacement between the waypoints in the rows of the first. If
    only the orientations differ, w is the chord of the arc of the tool's axis, or of the whole
    orientation. If neither differs in the rows, λ is the share of the time.

    Attributes:
        projectors: Each projector once, and ``which`` of them is each interval's, (N − 1,).
        lengths: Distance of the positions, m, (N − 1,), and ``turns``, that of orientations, rad.
        straight: Where λ is a linear function of the origin, (N − 1,).
    """

    def __init__(self, R_d: Array, p_d: Array, rows: Sequence[TwistProjector]) -> None:
        self.projectors, self.which = distinct_projectors(rows)
        turn = rotation_vector(R_d[1:] @ R_d[:-1].transpose(0, 2, 1))
        self._way = _Way(R_d, p_d, p_d[1:] - p_d[:-1], turn)
        self.lengths = np.linalg.norm(self._way.step, axis=1)
        self.turns = np.linalg.norm(turn, axis=1)
        count = len(turn)
        self.straight, self._arc = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        self._lines = _Lines(np.zeros((count, 9)), np.zeros((count, 9)))
        # Whether the linear rows measure progress, and the length of the interval in the rows that
        # do, m or rad.
        self._moves, self._extent = np.zeros(count, dtype=bool), np.zeros(count)
        for number, projector in enumerate(self.projectors):
            here = np.flatnonzero(self.which == number)
            first, last = (R_d[here], p_d[here]), (R_d[here + 1], p_d[here + 1])
            turned = resolved_twist_error(*first, *last, projector)[1][:, 3:]
            # The rows at the first waypoint, in any frame.
            basis = projector.linear.basis
            if projector.frame != "world":
                basis = R_d[here] @ basis
            seen = np.swapaxes(basis, -1, -2) @ self._way.step[here][:, :, None]
            w = (basis @ seen)[:, :, 0]
            moves = (w**2).sum(axis=1) > _SHORT
            self._moves[here] = moves
            self._extent[here] = np.linalg.norm(np.where(moves[:, None], w, turned), axis=1)
            if projector.linear.kind is ProjectorKind.FULL or projector.frame != "body":
                on = here[moves]
                self.straight[on] = True
                self._lines.begin[on, :3], self._lines.along[on, :3] = p_d[on], w[moves]
            if projector.angular.kind in (ProjectorKind.FULL, ProjectorKind.PLANE):
                on = here[~moves & ((turned**2).sum(axis=1) > _SHORT)]
                self._arc[on] = True
                x = self._turning(projector, R_d[on])
                self._lines.begin[on] = x
                self._lines.along[on] = self._turning(projector, R_d[on + 1]) - x

    @property
    def by_rate(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where :meth:`curve` bounds progress off its chord, (N − 1,)."""
        return self.straight | self._arc

    def at(self, interval: Indices, share: Array) -> tuple[Array, Array]:
        """Rotations (K, 3, 3) and positions (K, 3) at shares of intervals, (K,)."""
        way, share = self._way, share[:, None]
        turned = rotation_matrix(share * way.turn[interval])
        return turned @ way.R[interval], way.p[interval] + share * way.step[interval]

    def progress(self, R: Array, p: Array, interval: Indices, even: Array) -> tuple[Array, Array]:
        """Progress of poses along intervals: raw (share of the chord, not clipped), and λ, (K,).

        Where the rows do not see an interval, progress is ``even``, the share of its time.
        """
        raw = even.copy()
        straight, arc = self.straight[interval], self._arc[interval]
        begin, along = self._lines
        if straight.any():
            on = interval[straight]
            raw[straight] = _along(p[straight] - begin[on, :3], along[on, :3])
        for number, projector in enumerate(self.projectors):
            here = np.flatnonzero(self.which[interval] == number)
            bent = here[arc[here]]
            if len(bent):
                x = self._turning(projector, R[bent]) - begin[interval[bent]]
                raw[bent] = _along(x, along[interval[bent]])
            rest = here[~straight[here] & ~arc[here]]
            if len(rest):
                raw[rest] = self._by_errors(projector, R[rest], p[rest], interval[rest], even[rest])
        return raw, self.share(interval, raw)

    def gradient(self, R: Array, p: Array, interval: Indices, even: Array) -> Array:
        """Derivative of λ on the frame's twist (linear, angular), world axes, (K, 6).

        By central differences; 0 where λ is clipped, or does not depend on the pose.
        """
        found = np.empty((len(p), 6))
        for column, unit in enumerate(_PROBE * np.eye(6)):
            turned = rotation_matrix(unit[3:])
            ahead = self.progress(turned @ R, p + unit[:3], interval, even)[1]
            back = self.progress(turned.T @ R, p - unit[:3], interval, even)[1]
            found[:, column] = (ahead - back) / (2.0 * _PROBE)
        return found

    def velocity(self, interval: Indices) -> Array:
        """Twist (linear, angular) of the target with λ, world axes, m and rad, (K, 6)."""
        return np.hstack([self._way.step[interval], self._way.turn[interval]])

    def share(self, interval: Indices, raw: Array) -> Array:
        """λ in [0, 1] from raw progress; converts a chord's share to its arc's; monotonic, (K,)."""
        cut = np.clip(raw, 0.0, 1.0)
        arc, turn = self._arc[interval], self.turns[interval]
        angle = np.where(arc, turn, 1.0)
        sine = np.clip(2.0 * np.sin(0.5 * angle) * (cut - 0.5), -1.0, 1.0)
        bent = np.clip(0.5 + np.arcsin(sine) / angle, 0.0, 1.0)
        return np.where(arc, bent, cut)

    def curve(self, interval: Indices, curl: Array, bend: Array) -> Array:
        """Bound of the distance of raw progress from its chord, (K,).

        Args:
            interval: Index of each motion's interval.
            curl: Bound of the second derivative of vectors that turn with the frame, (K,).
            bend: Bound of the second derivative of its origin, m.
        """
        straight, arc = self.straight[interval], self._arc[interval]
        length = np.where(straight | arc, np.linalg.norm(self._lines.along[interval], axis=1), 1.0)
        return np.where(straight, bend, np.where(arc, curl, 0.0)) / length / 8.0

    def steepest(
        self, interval: Indices, ends: tuple[Array, Array], curve: Array, moved: tuple[Array, Array]
    ) -> Array:
        """Largest |dλ/ds| between two poses, s going from 0 to 1, (K,).

        Args:
            interval: Index of each pair's interval.
            ends: Raw progress at both poses.
            curve: Bound of its distance from its chord between them.
            moved: Largest displacement of the origin and the orientation, m and rad.
        """
        slope = np.abs(ends[1] - ends[0]) + 4.0 * curve  # ‖x″‖/2 more than the chord's
        arc = self._arc[interval]
        slope = np.where(arc, slope * self._of_arc(interval, ends, curve)[0], slope)
        length = self._extent[interval]
        rest = np.divide(
            np.where(self._moves[interval], *moved),
            length,
            out=np.zeros(len(interval)),
            where=length > 0.0,
        )
        return np.where(arc | self.straight[interval], slope, rest)

    def uneven(
        self, interval: Indices, ends: tuple[Array, Array], curve: Array, moved: tuple[Array, Array]
    ) -> Array:
        """Bound of the distance of λ between two poses from the chord of its values at them, (K,).

        The arguments are those of :meth:`steepest`.
        """
        # λ is clipped at each pose: its chord differs from that of raw progress if the clipping
        # begins or ends between the poses.
        cut = [np.clip(end, 0.0, 1.0) for end in ends]
        beyond = [end - inside for end, inside in zip(ends, cut, strict=True)]
        clipped = np.where(
            np.sign(beyond[0]) == np.sign(beyond[1]), 0.0, np.maximum(*np.abs(beyond))
        )
        off = curve + clipped
        slope, bend = self._of_arc(interval, ends, curve)
        of_arc = slope * off + bend * (cut[1] - cut[0]) ** 2 / 8.0
        # A value that changes by at most d differs from its chord by at most d/2.
        rest = 0.5 * self.steepest(interval, ends, curve, moved)
        arc, straight = self._arc[interval], self.straight[interval]
        return np.minimum(np.where(arc, of_arc, np.where(straight, off, rest)), 1.0)

    def _of_arc(
        self, interval: Indices, ends: tuple[Array, Array], curve: Array
    ) -> tuple[Array, Array]:
        """Largest derivatives of an arc's share by that of its chord, first and second, (K,)."""
        off = np.minimum(np.maximum(*(np.abs(end - 0.5) for end in ends)) + curve, 0.5)
        angle = np.where(self._arc[interval], self.turns[interval], 1.0)
        chord = 2.0 * np.sin(0.5 * angle)
        cosine = np.sqrt(np.maximum(1.0 - (chord * off) ** 2, 1e-12))
        return chord / (angle * cosine), chord**3 * off / (angle * cosine**3)

    def within(self, tolerances: tuple[float, float]) -> Array:
        """The share of each interval that task errors within the tolerances can add, (N − 1,)."""
        error = np.where(self._moves, *tolerances)
        return np.asarray(2.0 * error / np.maximum(self._extent, _SHORT))

    @staticmethod
    def _turning(projector: TwistProjector, R: Array) -> Array:
        """Vectors that turn with the frame, as the angular rows see them, (K, 9)."""
        if projector.angular.kind is ProjectorKind.FULL:
            return np.asarray(R.reshape(-1, 9) / np.sqrt(2.0))
        found = np.zeros((len(R), 9))
        axis = projector.angular.axis
        assert axis is not None
        found[:, :3] = (R.transpose(0, 2, 1) if projector.frame == "world" else R) @ axis
        return found

    def _by_errors(
        self, projector: TwistProjector, R: Array, p: Array, interval: Indices, even: Array
    ) -> Array:
        """Progress from the task errors to both waypoints, for rows that turn with the body."""
        ends = [
            resolved_twist_error(R, p, self._way.R[k], self._way.p[k], projector)[1]
            for k in (interval, interval + 1)
        ]
        raw = even.copy()
        decided = np.zeros(len(p), dtype=bool)
        for part in (slice(0, 3), slice(3, 6)):
            seen = ends[1][:, part] - ends[0][:, part]
            here = ~decided & ((seen**2).sum(axis=1) > _SHORT)
            raw[here] = -_along(ends[0][here, part], seen[here])
            decided |= here
        return raw


def _along(x: Array, w: Array) -> Array:
    """x·w/‖w‖² row by row."""
    return np.asarray(np.einsum("ki,ki->k", x, w) / np.einsum("ki,ki->k", w, w))


def fewer_rows(projectors: Sequence[TwistProjector]) -> list[TwistProjector]:
    """The projector with fewer rows of each two successive waypoints, (N − 1,)."""
    return [with_fewer_rows(*pair) for pair in itertools.pairwise(projectors)]
