"""A curve through the rows of a joint path, with continuous second derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from qp_twist.checks import Array, Indices
from qp_twist.referee import JointMotion

_RATIO = 2.0
"""How many times as far as on the shorter side of a row its turn reaches on the longer one. A
spline of rows at unequal distances, as beside a corner, would swing far beyond them."""
_SLIVER = 0.05
"""Share of a piece that no cubic is shorter than: on a sliver differences are rounding."""


@dataclass(frozen=True, eq=False)
class JointCurve:
    r"""Cubics q(x) through rows, joined with continuous derivatives q′ and q″.

    :math:`\mathbf q'' = \sum_k \mathbf M_k\,\Lambda_k(x)` with a hat function for each row: it is 1
    at the row and 0 at its neighbours, or already at twice the distance of the nearer one. M
    follows from the rows,

    .. math::

        \sum_j \mathbf M_j \int \Lambda_j\,\Phi_k\,dx = \mathbf D_k - \mathbf D_{k-1},

    with :math:`\mathbf D = \Delta\mathbf q/\Delta x` and the hat :math:`\Phi_k` from neighbour to
    neighbour. Of rows at equal distances it is the cubic spline. Both ends are straight, q″ = 0.

    Attributes:
        x: Where the cubics meet, (K,), increasing.
        q: Positions there, rad or m, (K, nv); ``first``, ``second``: q′ and q″.
        rows: Which of them are the rows, (N,).
    """

    x: Array
    q: Array
    first: Array
    second: Array
    rows: Indices

    @classmethod
    def through(cls, x: Array, q: Array) -> JointCurve:
        """The curve through rows q (N, nv) at x (N,), N ≥ 2."""
        h = np.diff(x)
        D = np.diff(q, axis=0) / h[:, None]
        # How far the hat of each row reaches to both sides.
        left, right = np.append(h[:1], h), np.append(h, h[-1:])
        left, right = np.minimum(left, _RATIO * right), np.minimum(right, _RATIO * left)
        for reach in (left[1:], right[:-1]):
            reach[reach > (1.0 - _SLIVER) * h] = h[reach > (1.0 - _SLIVER) * h]
        meet = np.abs(h - left[1:] - right[:-1]) < _SLIVER * h
        meet &= np.maximum(left[1:], right[:-1]) < h
        left[1:][meet] = (h - right[:-1])[meet]
        M = np.zeros_like(q)
        if len(q) > 2:
            before, after = left[1:-1], right[1:-1]
            own = before / 2.0 - before**2 / (6.0 * h[:-1])
            own += after / 2.0 - after**2 / (6.0 * h[1:])
            of_next, of_last = left[2:-1] ** 2 / (6.0 * h[1:-1]), right[1:-2] ** 2 / (6.0 * h[1:-1])
            bands = np.stack([np.append(0.0, of_next), own, np.append(of_last, 0.0)])
            M[1:-1] = solve_banded((1, 1), bands, np.diff(D, axis=0))
        k = np.arange(len(h))
        ahead, back = left[1:], right[:-1]
        begin = (
            D
            - M[:-1] * (back / 2.0 - back**2 / (6.0 * h))[:, None]
            - M[1:] * (ahead**2 / (6.0 * h))[:, None]
        )
        # A piece has up to four cubics: hats end inside it where it is long.
        places = np.stack(
            [x[:-1], np.minimum(x[:-1] + back, x[1:]), np.maximum(x[1:] - ahead, x[:-1])]
        )
        ends, piece = np.sort(places, axis=0), np.broadcast_to(k, places.shape)
        apart = np.diff(ends, axis=0, prepend=-np.inf) > 1e-9 * h
        apart &= (x[1:] - ends > 1e-9 * h) | (ends == x[:-1])
        order = np.lexsort((ends[apart], piece[apart]))
        where, of = ends[apart][order], piece[apart][order]
        where, of = np.append(where, x[-1]), np.append(of, len(h) - 1)
        from_left = np.maximum(1.0 - (where - x[of]) / back[of], 0.0)
        from_right = np.maximum(1.0 - (x[of + 1] - where) / ahead[of], 0.0)
        second = M[of] * from_left[:, None] + M[of + 1] * from_right[:, None]
        rows = np.append(np.searchsorted(of, k), len(where) - 1)
        # From the begin of each piece on by integration.
        d = np.diff(where)[:, None]
        speed = np.vstack(
            [np.zeros_like(q[:1]), np.cumsum(0.5 * d * (second[:-1] + second[1:]), axis=0)]
        )
        first = begin[of] + speed - speed[rows[of]]
        step = first[:-1] * d + (second[:-1] / 3.0 + second[1:] / 6.0) * d**2
        way = np.vstack([np.zeros_like(q[:1]), np.cumsum(step, axis=0)])
        found = q[of] + way - way[rows[of]]
        found[rows] = q
        return cls(where, found, first, second, rows)

    def at(self, x: Array, piece: Indices) -> Array:
        """q, q′, q″ and q‴ at x (K,), each on the cubic of this index, (K, 4, nv)."""
        d, h = (x - self.x[piece])[:, None], np.diff(self.x)[piece, None]
        third = (self.second[piece + 1] - self.second[piece]) / h
        second = self.second[piece] + d * third
        first = self.first[piece] + d * (self.second[piece] + 0.5 * d * third)
        q = self.q[piece] + d * (
            self.first[piece] + d * (0.5 * self.second[piece] + d * third / 6.0)
        )
        return np.stack([q, first, second, third], axis=1)

    @property
    def motion(self) -> JointMotion:
        """The curve as if it were passed with x as the time."""
        return JointMotion(self.x, self.q, self.first, self.second)
