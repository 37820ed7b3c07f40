"""The parameter of a way from rest to rest in which its speed is not 0 at the rests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array

_RISE, _HALVINGS = 0.6, 52
"""Way on which dx/dξ rises to 1, as a share of the parameter, and bisections of its inverse."""


class RestRamps(NamedTuple):
    """A parameter ξ(x) of a way from rest to rest.

    At constant jerk from a rest the way grows with t³. So x ∝ ξ³ there: with ζ from 0 to 1 on the
    first d of the way, x = (d/0.6) (2ζ³ − 2ζ⁴ + 0.6ζ⁵) and ξ = (d/0.6) ζ; at d it is dx/dξ = 1, and
    the second and third derivative are 0. Likewise before the end.
    """

    begin: float
    end: float
    up: float
    """d at the begin, above 0."""
    down: float
    """The same at the end."""

    def cells(self, x: Array) -> tuple[Array, Array, Array]:
        """ξ at the ends of cells, given x (C + 1,), and what is needed of their inner places.

        Returns:
            ξ, (C + 1,); x at the begin, the middle and the end of each cell, (C, 3); dx/dξ,
            d²x/dξ² and d³x/dξ³ there, (C, 3, 3).
        """
        w_up, w_down = self.up / _RISE, self.down / _RISE
        total = self.end - self.begin - self.up - self.down + w_up + w_down
        behind, ahead = x - self.begin, self.end - x
        rising = w_up * _inverse(np.minimum(behind, self.up) / w_up)
        xi = np.where(
            ahead < self.down,
            total - w_down * _inverse(np.minimum(ahead, self.down) / w_down),
            rising + np.maximum(behind - self.up, 0.0),
        )
        places = np.stack([xi[:-1], 0.5 * (xi[:-1] + xi[1:]), xi[1:]], axis=1)
        at = self.begin + self.up + places - w_up
        X = np.zeros((len(places), 3, 3))
        X[:, :, 0] = 1.0
        for w, sign, rest, way in (
            (w_up, 1.0, self.begin, places), (w_down, -1.0, self.end, total - places),
        ):  # fmt: skip
            near = way[:, 1] < w
            z = way[near] / w
            at[near] = rest + sign * w * z**3 * (2.0 - 2.0 * z + _RISE * z**2)
            X[near, :, 0] = z**2 * (6.0 - 8.0 * z + 3.0 * z**2)
            X[near, :, 1] = sign * 12.0 * z * (1.0 - z) ** 2 / w
            X[near, :, 2] = 12.0 * (1.0 - z) * (1.0 - 3.0 * z) / w**2
        at[:, 0], at[:, 2] = x[:-1], x[1:]
        return xi, at, X


def _inverse(share: Array) -> Array:
    """ζ in [0, 1] with 2ζ³ − 2ζ⁴ + 0.6ζ⁵ = share, by bisection."""
    low, high = np.zeros_like(share), np.ones_like(share)
    for _ in range(_HALVINGS):
        z = 0.5 * (low + high)
        below = z**3 * (2.0 - 2.0 * z + _RISE * z**2) < share
        low, high = np.where(below, z, low), np.where(below, high, z)
    return high
