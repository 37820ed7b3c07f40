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
J. Control Optim. 14, 1976), here in the singular directions of A N, so that no row is squared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qp_twist.checks import Array, Indices, Mask, largest
from qp_twist.kernel import COMPILED
from qp_twist.kernel.constants import DUST, HELD
from qp_twist.qp.backend import solve_raw
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import row_tolerance

INNER = COMPILED
"""Backend of a level's programs. Of 512 hierarchies, 212 of them ill-conditioned, it solves all;
DAQP fails in 6, quadprog in 3."""
PROXIMAL, SHARPER, SHARPEST = 1e-4, 0.25, 1e-7
"""Proximal weight ε, as a share of the level's longest row, its factor in each iteration, and the
smallest one: below it the programs fail by rounding."""
ROUNDS = 12
"""Most proximal iterations, usually one or two."""
RANK = 1e-10
"""Singular values below this share of a level's longest row count as zero."""
SATISFIED = 1e-9
"""Excess at which an inequality row counts as met, relative to 1 + |g| + its length."""
SETTLED = 1e-15
"""Share of its terms below which a gradient counts as zero."""
UNKNOWN = 1e100
"""A gap that exceeds every residual but does not overflow."""


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

    def broken(self, x: Array) -> Mask:
        """Which inequality rows are violated, (k,)."""
        sizes = 1.0 + np.abs(self.g) + np.linalg.norm(self.G, axis=1)
        return np.asarray(self.G @ x - self.g > SATISFIED * sizes)

    def rows(self, which: Mask) -> tuple[Array, Array]:
        """The equality rows, then some of the inequality rows, and their right-hand sides."""
        return np.vstack([self.A, self.G[which]]), np.append(self.b, self.g[which])

    def missed(self, x: Array) -> float:
        """√(‖A x − b‖² + ‖w‖²)."""
        w = np.maximum(self.G @ x - self.g, 0.0)
        return float(np.linalg.norm(np.append(self.A @ x - self.b, w)))

    @cached_property
    def size(self) -> float:
        """The length of the longest row of A, or of G if there is none."""
        return float(np.linalg.norm(self.A if len(self.b) else self.G, axis=1).max(initial=0.0))

    def rounding(self, x: Array) -> float:
        """The length of A x − b that counts as zero."""
        return DUST * (self.size * (1.0 + largest(x)) + largest(self.b))


class Cascade:
    """The points inside the bounds that are optimal for levels in order: x + N z with C z ≤ d.

    Attributes:
        x: One of the points, inside the bounds, (n,).
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
        self.x = np.clip(np.zeros(n) if start is None else start, lower, upper)
        self.lower, self.upper = lower, upper
        self.basis = np.eye(n)[:, upper > lower]
        self.G, self.g = np.zeros((0, n)), np.zeros(0)
        self._strict = np.zeros(0, dtype=np.intp)  # where the rows of G are among all levels' rows
        self.box_multipliers, self.row_multipliers = np.zeros(n), np.zeros(0)
        self.optimal = True
        self._achieved: list[tuple[Array, Array, Array, float]] = []
        for level in levels:
            self._minimise(level)

    @classmethod
    def keeping(cls, A: Array, problem: QuadraticProgram, x: Array) -> Cascade:
        """The points at which A, (m, j), sees of the first j unknowns what it sees at ``x``, (n,).

        They keep the bounds, and exceed no row of G by more than x does.
        """
        j, unit = A.shape[1], np.eye(problem.n)
        kept = cls([], problem.lower[:j], problem.upper[:j])
        kept._hold(A, np.zeros((0, kept.basis.shape[1])))
        kept.basis = np.hstack([unit[:, :j] @ kept.basis, unit[:, j:]])
        kept.x, kept.lower, kept.upper = x, problem.lower, problem.upper
        kept.G, kept.g = problem.G, np.maximum(problem.g, problem.G @ x)
        return kept

    def gaps(self, x: Array) -> tuple[float, ...]:
        """For each level, a bound of its residual's length at ``x`` less that at its optimum.

        In the unit of the rows. It follows from the gradient that the multipliers do not balance.
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
        d = np.concatenate([self.upper - self.x, self.x - self.lower, self.g - self.G @ self.x])
        sizes = np.append(np.ones(2 * len(self.x)), np.linalg.norm(self.G, axis=1))
        lengths = np.linalg.norm(C, axis=1)
        places = np.flatnonzero(np.isfinite(d) & (lengths > RANK * sizes))
        lengths = lengths[places]
        return C[places] / lengths[:, None], np.maximum(d[places], 0.0) / lengths, places, lengths

    def _minimise(self, level: Level) -> None:
        """Keep only the points that are optimal for another level."""
        n, first = len(self.x), len(self.row_multipliers)
        negligible = (HELD * level.missed(self.x) + level.rounding(self.x)) * level.size
        multipliers = self._go_to_optimum(level)
        C, d, places, lengths = self.rows()
        B, r = level.rows(level.G @ self.x - level.g > level.rounding(self.x))
        left = self.basis.T @ (B.T @ (r - B @ self.x)) - C.T @ multipliers
        gap = self._gap(left, float(multipliers @ d), float(np.linalg.norm(B @ self.x - r)))
        multipliers[multipliers <= negligible] = 0.0
        found = np.zeros(2 * n + len(self.g))
        found[places] = multipliers / lengths
        box, known = found[:n] - found[n : 2 * n], self.row_multipliers[self._strict]
        self.box_multipliers = np.where(self.box_multipliers, self.box_multipliers, box)
        self.row_multipliers[self._strict] = np.where(known, known, found[2 * n :])
        w = level.G @ self.x - level.g  # of a soft row the multiplier is w
        w[w <= negligible] = 0.0
        self.row_multipliers = np.append(self.row_multipliers, w)
        broken = level.broken(self.x)
        gap += self._hold(level.rows(broken)[0], C[multipliers > 0.0])
        self._achieved.append((B, r, self.x, gap))
        self.G, self.g = np.vstack([self.G, level.G[~broken]]), np.append(self.g, level.g[~broken])
        self._strict = np.append(self._strict, first + np.flatnonzero(~broken))

    def _go_to_optimum(self, level: Level) -> Array:
        """Move x to the optimum of a level; return the multipliers of C z ≤ d there, (c,)."""
        p, k = self.basis.shape[1], len(level.g)
        sigma, right = np.linalg.svd(level.A @ self.basis)[1:]
        seen = int((sigma > RANK * level.size).sum())
        T = right.T.copy()  # z = T u: of u the cost sees the first entries, each by itself
        T[:, :seen] /= sigma[:seen]
        found = np.zeros(2 * len(self.x) + len(self.g))
        for turn in range(ROUNDS if p and level.size else 0):
            weight = (max(PROXIMAL * SHARPER**turn, SHARPEST) * level.size) ** 2
            cost = np.concatenate([np.ones(seen), np.full(p - seen, weight), np.ones(k)])
            c = np.zeros(p + k)
            C, d, places, _ = self.rows()
            c[:seen] = (level.A @ self.basis @ T[:, :seen]).T @ (level.A @ self.x - level.b)
            rows = np.block(
                [[C @ T, np.zeros((len(d), k))], [level.G @ self.basis @ T, -np.eye(k)]]
            )
            bounds = np.append(d, level.g - level.G @ self.x)
            raw = solve_raw(QuadraticProgram.free(np.diag(cost), c, rows, bounds), INNER)
            if not raw.found or raw.x is None or not np.isfinite(raw.x).all():
                self.optimal &= turn > 0
                break
            moved = self.basis @ (T @ raw.x[:p])
            self.x = np.clip(self.x + moved, self.lower, self.upper)
            found[:] = 0.0
            found[places] = raw.multipliers.rows[: len(d)]
            left = weight * float(np.linalg.norm(raw.x[seen:p]))
            missed = level.missed(self.x)
            if left <= SETTLED * level.size * missed or missed <= level.rounding(self.x):
                break
        return found[self.rows()[2]]

    def _gap(self, left: Array, slack: float, length: float) -> float:
        """Bound of a residual's length less its optimal value.

        ``left`` is the gradient that the multipliers do not balance, ``slack`` what they lose to
        constraints that are not touched.
        """
        width = np.minimum(self.upper - self.lower, 2.0 * (1.0 + largest(self.x)))
        gained = float(np.linalg.norm(left) * np.linalg.norm(width)) + slack
        # ½‖·‖² decreases by at most ``gained``, and ‖·‖ at most to zero.
        return min(math.sqrt(2.0 * gained), gained / length if length > 0.0 else math.inf)

    def _hold(self, rows: Array, active: Array) -> float:
        """Reduce N to the null space of a level's rows, (m, n), and its active constraints C.

        Returns ``UNKNOWN`` if rounding decides what is left to the levels below, else 0.
        """
        lengths = np.linalg.norm(rows, axis=1)
        rows = rows[lengths > 0.0] / lengths[lengths > 0.0, None]
        _, sigma, right = np.linalg.svd(np.vstack([rows @ self.basis, active]))
        self.basis = self.basis @ right[int((sigma > RANK).sum()) :].T
        ambiguous = (sigma > 0.1 * RANK) & (sigma < 10.0 * RANK)
        return UNKNOWN if ambiguous.any() else 0.0
