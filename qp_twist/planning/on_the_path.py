"""Motions from waypoint to waypoint as they are run: straight ones, corrected onto the path."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.path_rows import REACHED, PathRows

_BULGE = 0.25
"""Largest correction of a middle, as a share of the motion: so each half is at most three quarters
as long as the whole, and halving ends."""
_ROUNDS = 12
"""Halvings, as many as those of :func:`~qp_twist.refine_trajectory`."""
_KEPT = 500
"""Number of sets of points whose rows are kept: those of each interval between waypoints."""


class _Way(NamedTuple):
    """Points of straight motions (K), corrected onto the path."""

    rows: PathRows
    at: Indices
    """Index of each point in the rows, (K,)."""
    q: Array
    held: Mask
    """Whether a point is reached, within the joint limits, and not far from the straight one."""
    strays: Mask
    """Whether it is further from the straight one than the tolerance of a check, (K,)."""


class OnThePath:
    """Motions between the waypoints of a path that stay on it, and the constraints on their way.

    A straight motion of the joints leaves the path by up to the square of its length. Where that is
    more than a check lets pass it is run with a row in its middle, corrected onto the path by
    least-norm steps, and so on with both halves. What the straight motion keeps, the one on the
    path may not: a tool that is lifted by some millimetres passes a clamp.
    """

    def __init__(self, path_task: PathTask) -> None:
        self._ranges = JointRanges.of(path_task.model)
        self._margins = len(PathRows(path_task).hard.names)
        self._rows = lru_cache(_KEPT)(lambda s: PathRows(path_task, np.frombuffer(s)))

    def margins(self, q: Array, at: Indices, share: Array) -> tuple[Array, Indices]:
        """Margins of a path q (N, nv) at shares (K,) of intervals, where it strays, rad or m.

        Returns:
            The margins, (S, k), and the indices of these points, (S,).
        """
        way = self._way(q[at], q[at + 1], share, at + share)
        which = np.flatnonzero(way.strays)
        return way.rows.hard.margins(way.q[which], way.at[which]), which

    def bounds(self, q: Array, at: Indices, share: Array) -> tuple[Array, Array, Indices, Indices]:
        """Linear rows that keep these margins above 0: rows · Δq ≤ rooms, Δq of the straight point.

        Returns:
            Rows (S, m, nv), rooms (S, m), the margin of each row, (m,), and the points, (S,).
        """
        way = self._way(q[at], q[at + 1], share, at + share)
        which = np.flatnonzero(way.strays)
        rows, rooms, of = way.rows.hard.rows(way.q[which], way.at[which])
        basis = way.rows.motions(way.q[which], way.at[which])  # a correction undoes all else
        return rows @ basis @ basis.swapaxes(1, 2), rooms, of, which

    def kept(
        self,
        begin: Array,
        end: Array,
        at: int,
        violations: dict[str, float],
        shares: Sequence[float],
    ) -> Mask:
        """Which motions (K, nv) from a waypoint to the next keep all margins at some shares, (K,).

        But for ``violations``, in rad and in m.
        """
        kept = np.ones(len(begin), dtype=bool)
        for share in shares:
            left = np.flatnonzero(kept)
            here = np.full(len(left), share)
            way = self._way(begin[left], end[left], here, at + here)
            kept[left] = way.held
            asked = way.held & way.strays
            kept[left[asked]] = way.rows.hard.inside(way.q[asked], way.at[asked], violations)
        return kept

    def violations(self, q: Array) -> tuple[Array, Array]:
        """Largest violations by a path q (N, nv) between its waypoints, rad or m, (N − 1, k).

        Looked at in the middles of halves until these are straight within the tolerance of a check;
        ∞ where halving leads astray. Also the share of each interval where it is largest, (N − 1,).
        """
        piece, share = np.arange(len(q) - 1), np.full(len(q) - 1, 0.5)
        begin, end, size = q[:-1], q[1:], 0.5
        worst, where = np.zeros((len(piece), self._margins)), share.copy()
        for _ in range(_ROUNDS):
            way = self._way(begin, end, np.full(len(piece), 0.5), piece + share)
            here = np.flatnonzero(way.strays | ~way.held)
            beyond = np.maximum(-way.rows.hard.margins(way.q[here], way.at[here]), 0.0)
            beyond[~way.held[here]] = np.inf
            for k, violation in zip(here.tolist(), beyond, strict=True):
                if violation.max() > worst[piece[k]].max():
                    where[piece[k]] = share[k]
                worst[piece[k]] = np.maximum(worst[piece[k]], violation)
            here = here[way.held[here]]
            if not len(here):
                return worst, where
            middle, size = way.q[here], 0.5 * size
            begin, end = np.vstack([begin[here], middle]), np.vstack([middle, end[here]])
            piece, share = np.tile(piece[here], 2), np.tile(share[here], 2)
            share += np.repeat([-size, size], len(here))
        worst[piece] = np.inf
        return worst, where

    def _way(self, begin: Array, end: Array, share: Array, s: Array) -> _Way:
        """Points at shares (K,) of motions (K, nv), corrected onto the path at s (K,)."""
        places, at = np.unique(s, return_inverse=True)
        rows, motion = self._rows(places.tobytes()), end - begin
        straight = begin + share[:, None] * motion
        q, arrived = rows.correct(straight, at)
        strays = np.abs(q - straight).max(axis=1, initial=0.0) > REACHED.position
        # What does not stray is run straight, in the ranges. What strays is run as corrected there.
        out = np.flatnonzero(strays & (self._ranges.room(q).min(axis=1, initial=np.inf) < -WITHIN))
        lower, upper = self._ranges.lower, self._ranges.upper
        box = (np.broadcast_to(end, q[out].shape) for end in (lower, upper))
        q[out], arrived[out] = rows.correct_within(q[out], at[out], *box)
        bulge = np.abs(q - straight).max(axis=1, initial=0.0)
        near = bulge <= _BULGE * np.abs(motion).max(axis=1, initial=0.0)
        return _Way(rows, at, q, arrived & (near | ~strays), strays)
