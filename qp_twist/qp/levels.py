r"""Strict priorities: a level never increases the residuals of the levels above it.

A level is the program

.. math::

    \min_{z, w} \tfrac12\lVert\mathbf A(\mathbf x + \mathbf N z) - \mathbf b\rVert^2
    + \tfrac12\lVert w\rVert^2 \quad\text{s.t.}\quad
    \mathbf G(\mathbf x + \mathbf N z) - w \le \mathbf g,\; \mathbf C z \le \mathbf d

with C z ≤ d the bounds and the inequality rows of the levels above. At its optimum A x, the
violated rows of G and the active constraints are unique: they are held, with N reduced to their
null space, and the rows of G that are met become strict for the levels below. As in the compiled
statement, ``kernel.levels``, the optimum is found by the proximal point method (Rockafellar, SIAM
J. Control Optim. 14, 1976), here in the singular directions of A N, so that no row is squared, and
corrected on the constraints that are active there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask, largest
from qp_twist.kernel import COMPILED
from qp_twist.qp.backend import solve_raw
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import row_tolerance

INNER = COMPILED
"""Backend of a level's programs. Of 512 hierarchies, 212 of them ill-conditioned, it solves all;
DAQP fails in 6, quadprog in 3, and quadprog leaves 6 beyond their gaps."""
PROXIMAL, SHARPER, SHARPEST = 1e-4, 0.25, 1e-7
"""Proximal weight ε, as a share of the level's longest row, its factor in each iteration, and the
smallest one: below it the programs fail by rounding."""
ROUNDS, CORRECTIONS = 12, 2
"""Most proximal iterations, usually one or two, and corrections in each."""
RANK = 1e-10
"""Singular values below this share of a level's longest row count as zero."""
SATISFIED = 1e-9
"""Excess at which an inequality row counts as met, relative to 1 + |g| + its length."""
HELD = 1e-8
"""Constraints with a multiplier above this share of a level's first gradient become equality rows
for the levels below."""
ACTIVE = 1e-9
"""Share of the largest multiplier from which a constraint of the proximal program is active."""
ROUNDING, SETTLED = 1e-13, 1e-15
"""Shares of their terms below which a residual and a gradient count as zero."""
EXACT = np.longdouble
"""Numbers in which residuals and gradients are summed: nearly dependent rows divide their rounding
by the square of a small singular value (Björck, BIT 7, 1967). Where they are doubles, on Windows
and Apple's processors, 19 of 212 ill-conditioned hierarchies are not proven instead of 2."""
UNKNOWN = 1e100
"""An uncertainty that exceeds every residual but does not overflow."""

Exact = npt.NDArray[np.longdouble]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Level:
    """The rows of one priority level: A x = b and G x ≤ g, both in least squares.

    Attributes:
        A: Equality rows, (m, n).
        b: Right-hand side, (m,).
        G: Inequality rows, (k, n).
        g: Right-hand side, (k,).
    """

    A: Array
    b: Array
    G: Array
    g: Array

    def proven(self, gap: float) -> bool:
        """Whether a gap counts as zero: at most ten times the :func:`row_tolerance`."""
        return gap <= 10.0 * row_tolerance(*self.rows(np.full(len(self.g), True)))

    def met(self, x: Array) -> bool:
        """Whether the level is met at ``x``: its equality rows to their :func:`row_tolerance`."""
        met = float(np.linalg.norm(self.A @ x - self.b)) <= row_tolerance(self.A, self.b)
        return met and not self.broken(x).any()

    def broken(self, x: Array | Exact) -> Mask:
        """Which inequality rows are violated, (k,)."""
        sizes = 1.0 + np.abs(self.g) + np.linalg.norm(self.G, axis=1)
        broken: Mask = self.G @ x - self.g > SATISFIED * sizes
        return broken

    def rows(self, which: Mask) -> tuple[Array, Array]:
        """The equality rows, then some of the inequality rows, and their right-hand sides."""
        return np.vstack([self.A, self.G[which]]), np.append(self.b, self.g[which])

    def missed(self, x: Exact) -> float:
        """√(‖A x − b‖² + ‖w‖²)."""
        w = np.maximum(self.G @ x - self.g, 0.0)
        return float(np.sqrt(((self.A @ x - self.b) ** 2).sum() + (w**2).sum()))

    @cached_property
    def size(self) -> float:
        """The length of the longest row of A, or of G if there is none."""
        return float(np.linalg.norm(self.A if len(self.b) else self.G, axis=1).max(initial=0.0))

    def rounding(self, x: Exact) -> float:
        """The length of A x − b that counts as zero."""
        return ROUNDING * (self.size * (1.0 + float(np.abs(x).max())) + largest(self.b))


class Conditions(NamedTuple):
    """What tells whether a point x is optimal for a level, with some constraints active."""

    C: Array
    """Constraints C z ≤ d, (c, p)."""
    d: Array
    places: Indices
    """Where they are among upper bounds, lower bounds and rows of G, (c,)."""
    lengths: Array
    """What they were divided by, (c,)."""
    on: Mask
    """Which are active, (c,)."""
    B: Array
    """A, and the violated rows of G."""
    r: Array
    """Their right-hand sides."""
    slope: Array
    """Nᵀ Bᵀ (r − B x), (p,)."""
    multipliers: Array
    """The non-negative multipliers that balance it best, (c,)."""
    seen: Array
    """V S⁻¹ of B N = U S Vᵀ on the null space of the active constraints, (p, rank)."""

    @property
    def left(self) -> Array:
        """What the multipliers leave of the slope, (p,)."""
        left: Array = self.slope - self.C.T @ self.multipliers
        return left


class Cascade:
    """The points inside the bounds that are optimal for levels in order: x + N z with C z ≤ d.

    Attributes:
        basis: N, orthonormal, (n, p).
        G: Inequality rows that hold strictly, (k, n).
        g: Their right-hand side, (k,).
        box_multipliers: Multipliers of the bounds, of the first level where they are not zero;
            positive at an upper bound, (n,).
        row_multipliers: The same for all levels' inequality rows, in order of levels.
        optimal: Whether an optimum was found for every level.
    """

    def __init__(
        self, levels: Sequence[Level], lower: Array, upper: Array, start: Array | None = None
    ) -> None:
        """Go from a point to the optimum of one level after the other.

        Args:
            levels: From the most to the least important.
            lower: Bounds, −∞ where there is none, (n,).
            upper: Bounds, (n,).
            start: A point, moved into the bounds, (n,); zero if ``None``.
        """
        n = len(lower)
        start = np.zeros(n) if start is None else start
        self._x: Exact = np.clip(start, lower, upper).astype(EXACT)
        self.lower, self.upper = lower, upper
        self.basis = np.eye(n)[:, upper > lower]
        self.G, self.g = np.zeros((0, n)), np.zeros(0)
        self._strict = np.zeros(0, dtype=np.intp)  # where the rows of G are among all levels' rows
        self.box_multipliers, self.row_multipliers = np.zeros(n), np.zeros(0)
        self.optimal = True
        self._held, self._uncertain = np.zeros((0, n)), np.zeros(0)
        self._achieved: list[tuple[Array, Array, Array, float]] = []
        for level in levels:
            self._minimise(level)

    @property
    def x(self) -> Array:
        """One of the points, inside the bounds, (n,)."""
        return self._x.astype(float)

    def gaps(self, x: Array) -> tuple[float, ...]:
        """For each level, a bound of its residual's length at ``x`` less that at its optimum.

        In the unit of the rows. It follows from the gradient that the multipliers do not balance
        and, to first order, from how far the levels above may be from their optimum.
        """
        return tuple(
            min(float(np.linalg.norm(B @ x - r)), gap + float(np.linalg.norm(B @ (x - optimum))))
            for B, r, optimum, gap in self._achieved
        )

    def rows(self) -> tuple[Array, Array, Indices, Array]:
        """C, d, where the rows are among upper bounds, lower bounds and G, and their divisors.

        z = 0 satisfies all rows. Rows that do not depend on z are omitted; the others have length
        one.
        """
        C = np.vstack([self.basis, -self.basis, self.G @ self.basis])
        d = np.concatenate([self.upper - self._x, self._x - self.lower, self.g - self.G @ self._x])
        sizes = np.append(np.ones(2 * len(self._x)), np.linalg.norm(self.G, axis=1))
        lengths = np.linalg.norm(C, axis=1)
        places = np.flatnonzero(np.isfinite(d) & (lengths > RANK * sizes))
        lengths = lengths[places]
        room = np.maximum(d[places], 0.0).astype(float) / lengths
        return C[places] / lengths[:, None], room, places, lengths

    def _minimise(self, level: Level) -> None:
        """Keep only the points that are optimal for another level."""
        n, first = len(self._x), len(self.row_multipliers)
        negligible = HELD * level.missed(self._x) + level.rounding(self._x)
        at = self._optimum(level)
        gap, uncertain = self._gap(level, at)
        self._achieved.append((at.B, at.r, self.x, gap))
        multipliers = np.where(at.multipliers > negligible * level.size, at.multipliers, 0.0)
        found = np.zeros(2 * n + len(self.g))
        found[at.places] = multipliers / at.lengths
        box, known = found[:n] - found[n : 2 * n], self.row_multipliers[self._strict]
        self.box_multipliers = np.where(self.box_multipliers, self.box_multipliers, box)
        self.row_multipliers[self._strict] = np.where(known, known, found[2 * n :])
        w = (level.G @ self._x - level.g).astype(float)  # of a soft row the multiplier is w
        w[w <= negligible * level.size] = 0.0
        self.row_multipliers = np.append(self.row_multipliers, w)
        broken = level.broken(self._x)
        self._hold(level.rows(broken)[0], at.C[multipliers > 0.0], uncertain)
        self.G, self.g = np.vstack([self.G, level.G[~broken]]), np.append(self.g, level.g[~broken])
        self._strict = np.append(self._strict, first + np.flatnonzero(~broken))

    def _optimum(self, level: Level) -> Conditions:
        """Move x to the optimum of a level."""
        p, k = self.basis.shape[1], len(level.g)
        sigma, right = np.linalg.svd(level.A @ self.basis)[1:]
        seen = int((sigma > RANK * level.size).sum())
        T = right.T.copy()  # z = T u: of u the cost sees the first entries, each by itself
        T[:, :seen] /= sigma[:seen]
        at = self._conditions(level, np.zeros(0, dtype=np.intp))
        for turn in range(ROUNDS if p and level.size else 0):
            weight = (max(PROXIMAL * SHARPER**turn, SHARPEST) * level.size) ** 2
            cost = np.concatenate([np.ones(seen), np.full(p - seen, weight), np.ones(k)])
            c = np.zeros(p + k)
            C, d, places, _ = self.rows()
            c[:seen] = (level.A @ self.basis @ T[:, :seen]).T @ (level.A @ self._x - level.b)
            rows = np.block(
                [[C @ T, np.zeros((len(d), k))], [level.G @ self.basis @ T, -np.eye(k)]]
            )
            bounds = np.append(d, level.g - level.G @ self._x).astype(float)
            found = solve_raw(QuadraticProgram.free(np.diag(cost), c, rows, bounds), INNER)
            if not found.found or found.x is None or not np.isfinite(found.x).all():
                self.optimal &= turn > 0
                break
            multipliers = found.multipliers.rows
            self._x = self._moved(T @ found.x[:p])
            active = places[multipliers[: len(d)] > ACTIVE * largest(multipliers)]
            at = self._corrected(level, active)
            left, missed = float(np.linalg.norm(at.left)), level.missed(self._x)
            if left <= SETTLED * level.size * missed or missed <= level.rounding(self._x):
                break
        return at

    def _corrected(self, level: Level, active: Indices) -> Conditions:
        """Move x to the least-squares solution on the active constraints, or towards it."""
        at = self._conditions(level, active)
        for _ in range(CORRECTIONS):
            onto = np.linalg.lstsq(at.C[at.on], at.d[at.on], rcond=RANK)[0]
            slope = at.slope - self.basis.T @ (at.B.T @ (at.B @ (self.basis @ onto)))
            z = onto + at.seen @ (at.seen.T @ slope)
            ahead = ~at.on & (at.C @ z > at.d + ROUNDING)
            share = (at.d[ahead] / (at.C[ahead] @ z)).min(initial=1.0)
            x = self._moved(share * z)
            if level.missed(x) > level.missed(self._x) + level.rounding(x):
                break
            self._x = x
            at = self._conditions(level, active)
        return at

    def _moved(self, z: Array) -> Exact:
        moved: Exact = np.clip(self._x + self.basis @ z, self.lower, self.upper)
        return moved

    def _conditions(self, level: Level, active: Indices) -> Conditions:
        """The conditions of optimality at x."""
        C, d, places, lengths = self.rows()
        on = np.isin(places, active)
        B, r = level.rows(level.G @ self._x - level.g > level.rounding(self._x))
        slope = (self.basis.T @ (B.T @ (r - B @ self._x))).astype(float)
        multipliers = np.zeros(len(d))
        multipliers[on] = np.maximum(np.linalg.lstsq(C[on].T, slope, rcond=None)[0], 0.0)
        free = null_basis(C[on])
        sigma, right = np.linalg.svd(B @ self.basis @ free, full_matrices=False)[1:]
        kept = sigma > RANK * level.size
        seen = free @ (right[kept].T / sigma[kept])
        return Conditions(C, d, places, lengths, on, B, r, slope, multipliers, seen)

    def _gap(self, level: Level, at: Conditions) -> tuple[float, float]:
        """Bounds of ‖B x − r‖ less its optimal value, and of the distance of B x from there."""
        length = float(np.linalg.norm(at.B @ self._x - at.r))
        width = np.minimum(self.upper - self.lower, 2.0 * (1.0 + largest(self.x)))
        gained = float(np.linalg.norm(at.left) * np.linalg.norm(width) + at.multipliers @ at.d)
        # ½‖·‖² decreases by at most ``gained``, and ‖·‖ at most to zero.
        gap = min(math.sqrt(2.0 * gained), gained / length if length > 0.0 else math.inf)
        moving = self.upper > self.lower
        inherited = at.B[:, moving] @ np.linalg.pinv(self._held[:, moving], rcond=RANK)
        off = float(np.linalg.norm(np.abs(inherited) @ self._uncertain))
        off += float(np.linalg.norm(at.seen.T @ at.left))
        weakest = float(np.linalg.norm(at.seen, axis=0).max(initial=0.0))
        off += float(np.finfo(EXACT).eps) * level.size * length * weakest
        return gap + off, off

    def _hold(self, rows: Array, active: Array, uncertain: float) -> None:
        """Reduce N to the null space of a level's rows, (m, n), and its active constraints C."""
        lengths = np.linalg.norm(rows, axis=1)
        rows, lengths = rows[lengths > 0.0], lengths[lengths > 0.0]
        rows = rows / lengths[:, None]
        self._held = np.vstack([self._held, rows, active @ self.basis.T])
        off = np.append(uncertain / lengths, np.zeros(len(active)))
        left = np.vstack([rows @ self.basis, active])
        sigma = np.linalg.svd(left, compute_uv=False)
        if ((sigma > 0.1 * RANK) & (sigma < 10.0 * RANK)).any():
            off += UNKNOWN  # rounding decides what is left to the levels below
        self._uncertain = np.append(self._uncertain, off)
        self.basis = self.basis @ null_basis(left)


def null_basis(rows: Array) -> Array:
    """Orthonormal basis of the null space of rows of length about one, (n, p)."""
    _, sigma, right = np.linalg.svd(rows)
    basis: Array = right[int((sigma > RANK).sum()) :].T
    return basis
