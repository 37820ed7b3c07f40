"""The verification of a prepared step without compilation: lists where there are few numbers."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from qp_twist.checks import Array
from qp_twist.controller.prepared_step import TOLERANCES

_EQUALITY, _OPTIMALITY, _GAIN, _GAP, _ROUNDING, _BOUND = TOLERANCES.tolist()


class Proof:
    """Whether multipliers prove x optimal, as ``verification`` has it.

    Of the program lower ≤ Wx ≤ upper, W the identity with m equality rows and others below it. With
    one multiplier for each end, above 0 at the upper one, all of them are treated alike: of an
    equality row both ends are the same.
    """

    def __init__(self, n: int, m: int) -> None:
        """For n unknowns and m equality rows; ``take_cost`` has to follow."""
        self._n, self._m = n, m

    def take_cost(self, H: Array) -> None:
        """The cost of all programs from now on: H, (n, n), or its diagonal, (n,)."""
        self._H = H
        self._hardest = float(np.abs(H).max())
        self._inverse = (1.0 / H).tolist() if H.ndim == 1 else None

    @property
    def hardest(self) -> float:
        """The largest entry of H."""
        return self._hardest

    def holds(
        self, c: Array, W: Array, lower: Array, upper: Array, x: Array, multipliers: Array
    ) -> bool:
        """Whether they do. Before, x is moved into the box, and what pulls at a row does not count.

        NaN anywhere makes the gap NaN, which is not small.
        """
        end = self._n + self._m
        if len(multipliers) > end:
            np.maximum(multipliers[end:], 0.0, out=multipliers[end:])
        low, high = lower.tolist(), upper.tolist()
        x[:] = [
            least if value < least else most if value > most else value
            for value, least, most in zip(x.tolist(), low, high, strict=False)
        ]
        reached, pulls = W.dot(x).tolist(), multipliers.tolist()
        off = held = over = gap = 0.0
        for i, pull in enumerate(pulls):
            if i < self._n:
                if pull > 0.0:
                    held += pull * (high[i] - reached[i])
                elif pull < 0.0:
                    held += pull * (low[i] - reached[i])
            elif i < end:
                apart = high[i] - reached[i]
                off, gap = max(off, apart, -apart), gap + pull * apart
            else:
                room = high[i] - reached[i]
                over = max(over, -room)
                if pull > 0.0:
                    held, gap = held + pull * max(room, 0.0), gap + pull * min(room, 0.0)
        along = multipliers.dot(W)
        r, left_over = self._residual(c, x, along)
        gap += held + left_over
        left, hardest = max(map(abs, r), default=0.0), self._hardest
        # All that is allowed grows with x, b and c: nearly always it is enough to take them for 0.
        if (
            off <= _EQUALITY
            and left <= _OPTIMALITY * hardest
            and held <= _GAIN * hardest
            and gap <= _GAP * hardest
            and over <= _BOUND
        ):
            return True
        return self._holds_for_its_size(c, W, upper, x, multipliers, (off, left, held, gap, over))

    def _residual(self, c: Array, x: Array, along: Array) -> tuple[list[float], float]:
        """r = Hx + c + Wᵀλ and ½rᵀH⁻¹r."""
        if self._inverse is not None:
            r: list[float] = (self._H * x + c + along).tolist()
            return r, 0.5 * sum([v * v * w for v, w in zip(r, self._inverse, strict=True)])
        whole = self._H.dot(x) + c + along
        _, solved, info = lapack.dposv(self._H, whole)
        return whole.tolist(), 0.5 * float(whole.dot(solved)) if info == 0 else math.inf

    def _holds_for_its_size(
        self,
        c: Array,
        W: Array,
        upper: Array,
        x: Array,
        multipliers: Array,
        found: tuple[float, float, float, float, float],
    ) -> bool:
        off, left, held, gap, over = found
        n, end, hardest = self._n, self._n + self._m, self._hardest
        b, rows, on = upper[n:end], multipliers[end:], multipliers[end:] > 0.0
        terms = np.abs(upper[end:][on]) + np.abs(W[end:][on]).dot(np.abs(x))
        lost = _ROUNDING * float(rows[on].dot(terms))
        steepest, reach = _largest(c), 1.0 + _largest(x)
        pulls = multipliers[:n], multipliers[n:end].dot(W[n:end]), rows.dot(W[end:])
        size = max(steepest, *map(_largest, pulls))
        cost = (hardest * reach + steepest) * reach
        return bool(
            off <= _EQUALITY * (1.0 + _largest(b))
            and left <= _OPTIMALITY * hardest * reach + _ROUNDING * size
            and held <= _GAIN * cost + lost
            and gap <= _GAP * cost + lost
            and over <= _BOUND * reach
        )


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))
