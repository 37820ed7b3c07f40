"""The verification of a prepared step without compilation: lists where there are few numbers."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from qp_twist.checks import Array
from qp_twist.controller.plain_step import Numbers
from qp_twist.controller.step_tables import TOLERANCES

_EQUALITY, _OPTIMALITY, _GAIN, _GAP, _ROUNDING, _BOUND = TOLERANCES.tolist()


class Proof:
    """Whether multipliers prove x optimal, as ``verification`` has it.

    Of the program lower ≤ Wx ≤ upper, W the identity with m equality rows and others below it. With
    one multiplier for each end, above 0 at the upper one, all of them are treated alike: of an
    equality row both ends are the same.

    Attributes:
        hardest: The largest entry of H.
        on_bounds: Whether in the last program a bound had a multiplier.
    """

    def __init__(self) -> None:
        """``take_cost`` has to follow."""
        self.hardest, self.on_bounds = 0.0, False
        self._inverse: list[float] | None = None

    def take_cost(self, H: Array) -> None:
        """The cost of all programs from now on: H, (n, n), or its diagonal, (n,)."""
        self.hardest = float(np.abs(H).max())
        self._inverse = (1.0 / H).tolist() if H.ndim == 1 else None

    def holds(self, p: Numbers) -> bool:
        """Whether they do. Before, x is moved into the box, and what pulls at a row does not count.

        NaN anywhere makes the gap NaN, which is not small.
        """
        n, m, x = len(p.x), p.m, p.x.tolist()
        if len(p.rows) > m:
            lam = p.lam
            np.maximum(lam, 0.0, out=lam)
        low, high, pulls = p.lower_ends.tolist(), p.upper_ends.tolist(), p.multipliers.tolist()
        held = over = gap = 0.0
        inside = True
        self.on_bounds = False
        for i in range(n):
            value, least, most, pull = x[i], low[i], high[i], pulls[i]
            if not least <= value <= most:
                inside = False
                x[i] = value = least if value < least else most if value > most else value
            if pull > 0.0:
                self.on_bounds = True
                held += pull * (most - value)
            elif pull != 0.0:
                self.on_bounds = True
                held += pull * (least - value)
        if not inside:
            p.x[:] = x
        room = (p.upper_ends[n:] - p.rows.dot(p.x)).tolist()
        off = max(map(abs, room[:m]), default=0.0)
        for pull, left in zip(pulls[n : n + m], room, strict=False):
            gap += pull * left
        if len(room) > m:
            for pull, left in zip(pulls[n + m :], room[m:], strict=True):
                over = max(over, -left)
                held, gap = held + pull * max(left, 0.0), gap + pull * min(left, 0.0)
        r, excess = self._residual(p)
        gap += held + excess
        left, hardest = max(map(abs, r), default=0.0), self.hardest
        # All that is allowed grows with x, b and c: nearly always it is enough to take them for 0.
        if (
            off <= _EQUALITY
            and left <= _OPTIMALITY * hardest
            and held <= _GAIN * hardest
            and gap <= _GAP * hardest
            and over <= _BOUND
        ):
            return True
        return self._holds_for_its_size(p, off, left, held, gap, over)

    def _residual(self, p: Numbers) -> tuple[list[float], float]:
        """r = Hx + c + Wᵀλ and ½rᵀH⁻¹r."""
        explained = p.c + p.box + p.multipliers[len(p.x) :].dot(p.rows)
        if self._inverse is not None:
            r: list[float] = (p.cost * p.x + explained).tolist()
            return r, 0.5 * sum([v * v * w for v, w in zip(r, self._inverse, strict=True)])
        whole = p.cost.dot(p.x) + explained
        _, solved, info = lapack.dposv(p.cost, whole)
        return whole.tolist(), 0.5 * float(whole.dot(solved)) if info == 0 else math.inf

    def _holds_for_its_size(
        self, p: Numbers, off: float, left: float, held: float, gap: float, over: float
    ) -> bool:
        n, m, hardest = len(p.x), p.m, self.hardest
        on = p.lam > 0.0
        terms = np.abs(p.g[on]) + np.abs(p.G[on]).dot(np.abs(p.x))
        lost = _ROUNDING * float(p.lam[on].dot(terms))
        steepest, reach = _largest(p.c), 1.0 + _largest(p.x)
        pulls = p.box, p.multipliers[n : n + m].dot(p.A), p.lam.dot(p.G)
        size = max(steepest, *map(_largest, pulls))
        cost = (hardest * reach + steepest) * reach
        return bool(
            off <= _EQUALITY * (1.0 + _largest(p.b))
            and left <= _OPTIMALITY * hardest * reach + _ROUNDING * size
            and held <= _GAIN * cost + lost
            and gap <= _GAP * cost + lost
            and over <= _BOUND * reach
        )


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))
