"""The way from each waypoint to the next, and how far along it a pose is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array, Indices
from qp_twist.geometry import (
    ProjectorKind,
    TwistProjector,
    distinct_projectors,
    many_twist_errors,
)

_SHORT = 1e-12
"""Square of a length below which a way has none, m² or rad²."""


class Way:
    r"""Straight lines between positions, shortest rotations between orientations.

    The share λ of a pose is that of the point of the way which is nearest in the task's linear
    rows, where the positions differ in them, else in its angular ones. With rows that do not turn
    with the body it is a linear function of the origin,

    .. math:: \lambda = \frac{(\mathbf p - \mathbf p_0)\cdot\mathbf w}{\|\mathbf w\|^2},

    w being the way in the rows at its first waypoint, cut to [0, 1]. Where only orientations
    differ, the same is done with the chord of the arc that the tool's axis, or the whole
    orientation, passes. Where neither differs in the rows, λ is the share of the time.

    Attributes:
        projectors: Each projector once.
        which: Index of the one in force on each way, (N − 1,).
        lengths: Distance of the positions, m, (N − 1,).
        turns: Angle between the orientations, rad, (N − 1,).
        straight: Where λ is a linear function of the origin, (N − 1,).
    """

    def __init__(self, R_d: Array, p_d: Array, rows: Sequence[TwistProjector]) -> None:
        self.projectors, self.which = distinct_projectors(rows)
        self._R, self._p = R_d, p_d
        self._step = p_d[1:] - p_d[:-1]
        turn = R_d[1:] @ R_d[:-1].transpose(0, 2, 1)
        self._turn = Rotation.from_matrix(turn).as_rotvec() if len(turn) else np.zeros((0, 3))
        self.lengths = np.linalg.norm(self._step, axis=1)
        self.turns = np.linalg.norm(self._turn, axis=1)
        count = len(self.lengths)
        self._linear, self._angular = np.zeros((count, 3)), np.zeros((count, 3))
        self.straight, self._arc = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        self._origin, self._chord = np.zeros((count, 9)), np.zeros((count, 9))
        self._moves = np.zeros(count, dtype=bool)
        for number, projector in enumerate(self.projectors):
            here = np.flatnonzero(self.which == number)
            first, last = (R_d[here], p_d[here]), (R_d[here + 1], p_d[here + 1])
            way = many_twist_errors(*first, *last, projector)[1]
            # The rows at the first waypoint, whatever they turn with.
            basis = projector.linear.basis
            if projector.frame != "world":
                basis = R_d[here] @ basis
            seen = np.swapaxes(basis, -1, -2) @ self._step[here][:, :, None]
            self._linear[here] = (basis @ seen)[:, :, 0]
            self._angular[here] = way[:, 3:]
            moves = (self._linear[here] ** 2).sum(axis=1) > _SHORT
            self._moves[here] = moves
            whole = projector.linear.kind is ProjectorKind.FULL
            self.straight[here] = moves & (whole or projector.frame != "body")
            if projector.angular.kind in (ProjectorKind.FULL, ProjectorKind.PLANE):
                x = self._turning(projector, R_d[here])
                self._origin[here] = x
                self._chord[here] = self._turning(projector, R_d[here + 1]) - x
                turned = (way[:, 3:] ** 2).sum(axis=1) > _SHORT
                self._arc[here] = ~moves & turned

    @property
    def by_rate(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where progress is near its chord in a short stretch, so that λ is bounded, (N − 1,)."""
        return self.straight | self._arc

    def at(self, way: Indices, share: Array) -> tuple[Array, Array]:
        """Rotations (K, 3, 3) and positions (K, 3) at shares of the ways, (K,)."""
        turned = Rotation.from_rotvec(share[:, None] * self._turn[way]).as_matrix()
        return turned @ self._R[way], self._p[way] + share[:, None] * self._step[way]

    def progress(self, R: Array, p: Array, way: Indices, even: Array) -> tuple[Array, Array]:
        """How far poses are along ways: before it is cut and bent, and λ, (K,) each.

        Where the rows see nothing of a way, it is passed evenly: at shares ``even`` of its time.
        """
        raw = even.copy()
        straight, arc = self.straight[way], self._arc[way]
        if straight.any():
            on = way[straight]
            raw[straight] = _along(p[straight] - self._p[on], self._linear[on])
        for number, projector in enumerate(self.projectors):
            here = np.flatnonzero(self.which[way] == number)
            bent = here[arc[here]]
            if len(bent):
                x = self._turning(projector, R[bent]) - self._origin[way[bent]]
                raw[bent] = _along(x, self._chord[way[bent]])
            rest = here[~straight[here] & ~arc[here]]
            if len(rest):
                raw[rest] = self._by_errors(projector, R[rest], p[rest], way[rest], even[rest])
        return raw, self.share(way, raw)

    def share(self, way: Indices, raw: Array) -> Array:
        """λ in [0, 1]: a share of a chord is another one of its arc; never decreasing, (K,)."""
        cut = np.clip(raw, 0.0, 1.0)
        arc, turn = self._arc[way], self.turns[way]
        angle = np.where(arc, turn, 1.0)
        sine = np.clip(2.0 * np.sin(0.5 * angle) * (cut - 0.5), -1.0, 1.0)
        bent = np.clip(0.5 + np.arcsin(sine) / angle, 0.0, 1.0)
        share: Array = np.where(arc, bent, cut)
        return share

    def curve(self, way: Indices, curl: Array, bend: Array) -> Array:
        """How far progress, before it is cut and bent, may be from its chord, (K,).

        Args:
            way: Where.
            curl: Bound of the second derivative of vectors that turn with the frame, (K,).
            bend: The same of its origin, m.
        """
        straight, arc = self.straight[way], self._arc[way]
        of_line = np.where(straight, np.linalg.norm(self._linear[way], axis=1), 1.0)
        of_arc = np.where(arc, np.linalg.norm(self._chord[way], axis=1), 1.0)
        away: Array = np.where(straight, bend / of_line, np.where(arc, curl / of_arc, 0.0)) / 8.0
        return away

    def steepest(
        self, way: Indices, ends: tuple[Array, Array], curve: Array, moved: tuple[Array, Array]
    ) -> Array:
        """Largest |dλ/ds| between two poses, s going from 0 to 1, (K,).

        Args:
            way: Where.
            ends: Progress at both, before it is cut and bent.
            curve: How far it may be from its chord between them.
            moved: How far origin and orientation move at most, m and rad.
        """
        slope = np.abs(ends[1] - ends[0]) + 4.0 * curve  # ‖x″‖/2 more than the chord's
        off = np.minimum(np.maximum(*(np.abs(end - 0.5) for end in ends)) + curve, 0.5)
        arc = self._arc[way]
        angle = np.where(arc, self.turns[way], 1.0)
        sine = np.sin(0.5 * angle)
        cosine = np.sqrt(np.maximum(1.0 - (2.0 * sine * off) ** 2, 1e-12))
        slope = np.where(arc, slope * 2.0 * sine / (angle * cosine), slope)
        length = self._length(way)
        rest = np.divide(
            np.where(self._moves[way], *moved), length, out=np.zeros(len(way)), where=length > 0.0
        )
        steepest: Array = np.where(arc | self.straight[way], slope, rest)
        return steepest

    def within(self, tolerances: tuple[float, float]) -> Array:
        """The share of each way that errors at both ends of a stretch can be, (N − 1,)."""
        error = np.where(self._moves, *tolerances)
        length = np.maximum(self._length(np.arange(len(error))), _SHORT)
        within: Array = 2.0 * error / length
        return within

    def _length(self, way: Indices) -> Array:
        """The way's length in the rows that progress is measured in, m or rad, (K,)."""
        linear, angular = (
            np.linalg.norm(part[way], axis=1) for part in (self._linear, self._angular)
        )
        length: Array = np.where(self._moves[way], linear, angular)
        return length

    @staticmethod
    def _turning(projector: TwistProjector, R: Array) -> Array:
        """What turns with the frame and its rows see, a vector of length 1 or √3, (K, 9)."""
        if projector.angular.kind is ProjectorKind.FULL:
            whole: Array = R.reshape(-1, 9) / np.sqrt(2.0)
            return whole
        found = np.zeros((len(R), 9))
        axis = projector.angular.axis
        assert axis is not None
        found[:, :3] = (R.transpose(0, 2, 1) if projector.frame == "world" else R) @ axis
        return found

    def _by_errors(
        self, projector: TwistProjector, R: Array, p: Array, way: Indices, even: Array
    ) -> Array:
        """Progress by the task errors to both waypoints, in rows that turn with the body."""
        ends = [
            many_twist_errors(R, p, self._R[k], self._p[k], projector)[1] for k in (way, way + 1)
        ]
        raw = even.copy()
        decided = np.zeros(len(p), dtype=bool)
        for part in (slice(0, 3), slice(3, 6)):
            seen = ends[1][:, part] - ends[0][:, part]
            here = ~decided & ((seen**2).sum(axis=1) > _SHORT)
            raw[here] = -_along(ends[0][here, part], seen[here])
            decided |= here
        return raw


def _along(x: Array, way: Array) -> Array:
    """x·w/‖w‖² row by row."""
    along: Array = np.einsum("ki,ki->k", x, way) / np.einsum("ki,ki->k", way, way)
    return along
