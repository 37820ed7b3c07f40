"""Motions from waypoint to waypoint as they are run: straight ones, corrected onto the path."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.path_rows import ITERATIONS, REACHED, PathRows

_KEPT = 500
"""Number of sets of points whose rows are kept: those of each interval between waypoints."""


class _Halving(NamedTuple):
    """How motions are halved."""

    rounds: int = 12
    """Halvings, as many as those of :func:`~qp_twist.refine_trajectory`."""
    bulge: float = 0.5
    """Largest correction of a middle, as a share of the motion: halves are no longer than it."""
    iterations: int = ITERATIONS
    """Newton steps of a correction."""


_OF_A_SEARCH = _Halving(3, 0.25, 10)
"""Of a search, which asks many edges: halves are at most three quarters of the whole, so that
halving ends; what needs more Newton steps is corrected too far."""


class _Way(NamedTuple):
    """Points of straight motions (K), corrected onto the path."""

    rows: PathRows
    at: Indices
    """Index of each point in the rows, (K,)."""
    q: Array
    held: Mask
    """Whether a point is within the joint limits, and not far from the straight one, (K,)."""
    strays: Mask
    """Whether it is further from the straight one than the tolerance of a check, (K,). Where the
    arm reaches the path only at waypoints it does not: no motion is better there."""


class OnThePath:
    """Motions between the waypoints of a path that stay on it, and the constraints on their way.

    A straight motion of the joints leaves the path by up to the square of its length. Where that is
    more than a check lets pass it is run with a row in its middle, corrected onto the path by
    least-norm steps, and so on with both halves. What the straight motion keeps, the one on the
    path may not: a tool that is lifted by some millimetres passes a clamp.
    """

    def __init__(self, path_task: PathTask) -> None:
        self._ranges = JointRanges.of(path_task.model)
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

    def kept(self, begin: Array, end: Array, at: Indices, violations: dict[str, float]) -> Mask:
        """Which motions (K, nv) from waypoints (K,) to the next stay on the path, (K,).

        And keep all margins there but for ``violations``, in rad and in m; to the resolution of a
        search.
        """

        def broken(way: _Way, which: Indices) -> Array:
            inside = way.rows.hard.inside(way.q[which], way.at[which], violations)
            return np.where(inside, 0.0, np.inf)[:, None]

        worst, _, _ = self._halved(begin, end, at, _OF_A_SEARCH, broken)
        return np.asarray(np.isfinite(worst).all(axis=1))

    def violations(self, q: Array) -> tuple[Array, Array]:
        """Largest violations by a path q (N, nv) between its waypoints, rad or m, (N − 1, k + 1).

        Looked at in the middles of halves until these are straight within the tolerance of a check.
        Where they never are, as between two branches of the inverse kinematics, the last column is
        ∞, else 0. Also the share of each interval where a violation is largest, (N − 1,).
        """

        def beyond(way: _Way, which: Indices) -> Array:
            return np.maximum(-way.rows.hard.margins(way.q[which], way.at[which]), 0.0)

        at = np.arange(len(q) - 1)
        worst, where, left = self._halved(q[:-1], q[1:], at, _Halving(), beyond)
        worst[left, -1] = np.inf
        return worst, where

    def _halved(
        self,
        begin: Array,
        end: Array,
        at: Indices,
        halving: _Halving,
        beyond: Callable[[_Way, Indices], Array],
    ) -> tuple[Array, Array, Indices]:
        """Halve motions (K, nv) from waypoints (K,) to the next, on the path, until straight.

        Returns:
            Largest violations ``beyond`` of those middles that stray from the straight motion, and
            a last column, ∞ where one is not held and 0 elsewhere, (K, k + 1); the shares at which
            they are largest, (K,); and the motions that are not straight after all halvings.
        """
        piece, share, size = np.arange(len(at)), np.full(len(at), 0.5), 0.5
        where, worst = share.copy(), np.zeros((len(at), 0))
        for _ in range(halving.rounds):
            middle = np.full(len(piece), 0.5)
            way = self._way(begin, end, middle, at[piece] + share, halving)
            here = np.flatnonzero(way.strays | ~way.held)
            found = np.column_stack([beyond(way, here), np.where(way.held[here], 0.0, np.inf)])
            worst = worst if worst.size else np.zeros((len(at), found.shape[1]))
            larger = found.max(axis=1) > worst[piece[here]].max(axis=1, initial=0.0)
            which = here[larger][np.argsort(found[larger].max(axis=1), kind="stable")]
            where[piece[which]] = share[which]  # the last one, the largest, stays
            np.maximum.at(worst, piece[here], found)
            here = here[np.isfinite(worst[piece[here]]).all(axis=1)]
            if not len(here):
                return worst, where, here
            halves, size = way.q[here], 0.5 * size
            begin, end = np.vstack([begin[here], halves]), np.vstack([halves, end[here]])
            piece, share = np.tile(piece[here], 2), np.tile(share[here], 2)
            share += np.repeat([-size, size], len(here))
        # Beside a singularity joints bend further and further, while the frame is on the path.
        places, of = np.unique(at[piece] + share, return_inverse=True)
        on_task = self._rows(places.tobytes()).on_task(0.5 * (begin + end), of)
        return worst, where, np.unique(piece[~on_task])

    def _way(
        self, begin: Array, end: Array, share: Array, s: Array, halving: _Halving | None = None
    ) -> _Way:
        """Points at shares (K,) of motions (K, nv), corrected onto the path at s (K,)."""
        halving = halving or _Halving()
        places, at = np.unique(s, return_inverse=True)
        rows, motion = self._rows(places.tobytes()), end - begin
        straight = begin + share[:, None] * motion
        q, arrived = rows.correct(straight, at, iterations=halving.iterations)
        strays = np.abs(q - straight).max(axis=1, initial=0.0) > REACHED.position
        # What does not stray is run straight, in the ranges. What strays is run as corrected there.
        out = np.flatnonzero(strays & (self._ranges.room(q).min(axis=1, initial=np.inf) < -WITHIN))
        lower, upper = self._ranges.lower, self._ranges.upper
        box = (np.broadcast_to(end, q[out].shape) for end in (lower, upper))
        q[out], arrived[out] = rows.correct_within(q[out], at[out], *box)
        apart = np.abs(q - straight).max(axis=1, initial=0.0)
        near = apart <= halving.bulge * np.abs(motion).max(axis=1, initial=0.0)
        near[out] &= arrived[out]
        return _Way(rows, at, q, near | ~strays, strays & arrived)
