"""Strict priorities: a level never increases the residuals of the levels above it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.qp.active_set import (
    RANK_TOLERANCE,
    clear_cut,
    constrained_least_squares,
    null_basis,
)
from qp_twist.qp.refinement import Held, Refined, refined, sums
from qp_twist.qp.verification import row_tolerance

SATISFIED = 1e-9
"""Excess at which an inequality row counts as met, relative to 1 + |g| + its length."""
HELD = 1e-8
"""Rows with a multiplier above this share of the level's initial gradient become equality rows for
the levels below."""
ROUNDING = 1e-13
"""Rounding error of a residual, as a share of its terms."""
_LAST_DIGITS = 1e-15
"""Share of its terms below which a multiplier's sign is unknown."""
_UNKNOWN = 1e100
"""An uncertainty that exceeds every residual but does not overflow."""


Mask = npt.NDArray[np.bool_]


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
        A, b = np.vstack([self.A, self.G]), np.concatenate([self.b, self.g])
        return gap <= 10.0 * row_tolerance(A, b)

    def met(self, x: Array) -> bool:
        """Whether the level is met at ``x``: its equality rows to their :func:`row_tolerance`."""
        left = float(np.linalg.norm(self.A @ x - self.b))
        excess = (self.G @ x - self.g) / (1.0 + np.abs(self.g) + np.linalg.norm(self.G, axis=1))
        met = left <= row_tolerance(self.A, self.b)
        return bool(met and excess.max(initial=0.0) <= SATISFIED)


class Achieved(NamedTuple):
    """Optimum of a level: B x = B·anchor + rest, with B its equality and violated rows."""

    B: Array
    r: Array
    anchor: Array
    rest: Array
    uncertain: float
    """Bound of the distance of B·anchor + rest from the optimum, in the rows' unit."""
    gain: float
    """Possible further decrease of ‖B x − r‖ in directions with small singular values."""

    def gap(self, x: Array) -> float:
        """Bound of ‖B x − r‖ less its optimal value."""
        away = sums([(self.B, self.anchor), (self.B, -x)], self.rest)
        residual = float(np.linalg.norm(sums([(self.B, x)], -self.r)))
        return min(residual, float(np.linalg.norm(away)) + self.uncertain + self.gain)


class RowOrigin(NamedTuple):
    """The bound or row of G behind a row of C."""

    number: int
    """Index of the unknown, or of the row of G."""
    side: float
    """1 for an upper bound, −1 for a lower one, 0 for a row of G."""
    length: float
    """Divisor of the row."""


@dataclass(eq=False)
class Cascade:
    r"""The points that are optimal for all levels so far: x + N z with rows C z ≤ d.

    Attributes:
        x: One of them, (n,).
        basis: N, orthonormal, (n, p).
        lower: Bounds, (n,).
        upper: Bounds, (n,).
        G: Inequality rows that hold strictly, (k, n).
        g: Their right-hand side, (k,).
        row_origins: Index of each row of G among all levels' inequality rows, in order of levels.
        box_multipliers: Multipliers of the bounds, of the first level where they are not zero;
            positive at an upper bound, (n,).
        row_multipliers: The same for all levels' inequality rows, in order of levels.
        optimal: Whether every level's optimality conditions hold.
        pinned: Unknowns that are fixed, or frozen at a bound, (n,).
        held: The frozen rows of G and the rows of the levels so far, as equality constraints.
        refine: Whether to refine each level to the last digits and to store ``achieved``.
        achieved: The optimum of each level.
        clear: Whether the numerical rank of all rows so far is unambiguous; if not, the freedom
            left to the levels below is uncertain.
    """

    x: Array
    basis: Array
    lower: Array
    upper: Array
    G: Array
    g: Array
    box_multipliers: Array
    pinned: Mask
    held: Held
    row_origins: list[int] = field(default_factory=list)
    row_multipliers: list[float] = field(default_factory=list)
    refine: bool = False
    achieved: list[Achieved] = field(default_factory=list)
    optimal: bool = True
    clear: bool = True

    @classmethod
    def from_point(cls, x: Array, lower: Array, upper: Array, *, refine: bool = False) -> Cascade:
        """Start from a point, clipped to the bounds. Unknowns with lower = upper stay fixed."""
        n = len(x)
        moving = np.flatnonzero(upper > lower)
        return cls(
            np.clip(x, lower, upper),
            np.eye(n)[:, moving],
            lower,
            upper,
            np.zeros((0, n)),
            np.zeros(0),
            np.zeros(n),
            upper <= lower,
            Held.none(n),
            refine=refine,
        )

    def gaps(self, x: Array) -> tuple[float, ...]:
        """For each level, a bound of its residual's length at ``x`` less that at its optimum.

        In the unit of the rows. It follows from the residual of the optimality conditions, summed
        without rounding, and its first-order effect on the levels below. Needs ``refine``.
        """
        return tuple(level.gap(x) for level in self.achieved)

    def rows(self) -> tuple[Array, Array, list[RowOrigin]]:
        """C, d and the origin of each row.

        z = 0 satisfies all rows. Rows that do not depend on z are omitted; the others have length
        one.
        """
        blocks = [
            (self.basis, self.upper - self.x, 1.0),
            (-self.basis, self.x - self.lower, -1.0),
            (self.G @ self.basis, self.g - self.G @ self.x, 0.0),
        ]
        rows, bounds = [np.zeros((0, self.basis.shape[1]))], [np.zeros(0)]
        origins: list[RowOrigin] = []
        for matrix, slack, kind in blocks:
            length = np.linalg.norm(matrix, axis=1)
            scale = np.ones(len(matrix)) if kind else np.linalg.norm(self.G, axis=1)
            keep = np.flatnonzero(np.isfinite(slack) & (length > RANK_TOLERANCE * scale))
            rows.append(matrix[keep] / length[keep, None])
            bounds.append(np.maximum(slack[keep], 0.0) / length[keep])
            origins += [RowOrigin(int(i), kind, float(length[i])) for i in keep]
        return np.vstack(rows), np.concatenate(bounds), origins

    def minimise(self, level: Level) -> None:
        r"""Keep only the points that are optimal for another level.

        .. math::

            \min_{z, w} \tfrac12\lVert\mathbf A(\mathbf x + \mathbf N z) - \mathbf b\rVert^2
            + \tfrac12\lVert w\rVert^2 \quad\text{s.t.}\quad
            \mathbf G(\mathbf x + \mathbf N z) - w \le \mathbf g,\; \mathbf C z \le \mathbf d

        At the optimum, A x and the violated rows of G are unique: they become equality rows, and N
        is reduced to their null space. The rows of G that are met become strict constraints. Bounds
        with a positive multiplier are active in every optimal point; they are frozen, which avoids
        degeneracy in the levels below.
        """
        if not len(level.b) + len(level.g):
            self.achieved += [self._empty()] * self.refine
            return
        C, d, origins = self.rows()
        p, k = self.basis.shape[1], len(level.g)
        # Rows of G are normalised, so that long ones do not dominate those of A.
        heavy = np.linalg.norm(level.G, axis=1)
        size = float(np.linalg.norm(level.A, axis=1).max(initial=0.0))
        size = size or float(heavy.max(initial=0.0))
        heavy[heavy == 0.0] = 1.0
        terms = size * (1.0 + np.abs(self.x).max(initial=0.0)) + np.abs(level.b).max(initial=0.0)
        excess = np.maximum(level.G @ self.x - level.g, 0.0)
        violation = math.hypot(*(level.A @ self.x - level.b).tolist(), *excess.tolist())
        negligible = size * (HELD * violation + ROUNDING * float(terms))
        if size > 0.0 and p > 0:
            B = np.block(
                [
                    [level.A @ self.basis, np.zeros((len(level.b), k))],
                    [np.zeros((k, p)), np.diag(heavy)],
                ]
            )
            slack = (level.g - level.G @ self.x) / heavy
            soft = np.hstack([level.G @ self.basis / heavy[:, None], -np.eye(k)])
            found = constrained_least_squares(
                B,
                np.concatenate([level.b - level.A @ self.x, np.zeros(k)]),
                np.vstack([np.hstack([C, np.zeros((len(d), k))]), soft]),
                np.concatenate([d, slack]),
                np.concatenate([np.zeros(p), np.maximum(-slack, 0.0)]),
                smallest=RANK_TOLERANCE * size,
            )
            self.optimal &= found.optimal
            self._move(found.z[:p])
            multipliers = found.multipliers
            working = [origins[i] for i in found.working if i < len(d)]
        else:
            multipliers, working = np.zeros(len(d) + k), []
        if self.refine:
            exceeded = level.G @ self.x - level.g > ROUNDING * terms
            B = np.vstack([level.A, level.G[exceeded]])
            r = np.concatenate([level.b, level.g[exceeded]])
            self.achieved.append(self._refine(B, r, working, size))
        violated = level.G @ self.x - level.g > SATISFIED * (1.0 + np.abs(level.g) + heavy)
        multipliers[multipliers <= negligible] = 0.0
        held = np.flatnonzero(multipliers[: len(d)])
        for i in held:
            self._note(origins[i], float(multipliers[i]))
        if self.refine:
            self._hold(self.achieved[-1], [origins[i] for i in held])
        self._freeze(level, violated, C[held])
        first = len(self.row_multipliers)
        self.row_multipliers += list(multipliers[len(d) :] / heavy)
        self.row_origins += [first + int(i) for i in np.flatnonzero(~violated)]
        self.G = np.vstack([self.G, level.G[~violated]])
        self.g = np.concatenate([self.g, level.g[~violated]])

    def _move(self, z: Array) -> None:
        self.x = np.clip(self.x + self.basis @ z, self.lower, self.upper)

    def _empty(self) -> Achieved:
        n = len(self.x)
        return Achieved(np.zeros((0, n)), np.zeros(0), self.x, np.zeros(0), 0.0, 0.0)

    def _refine(self, B: Array, r: Array, working: list[RowOrigin], size: float) -> Achieved:
        """Move to the optimum of min ‖B x − r‖ on the constraints of the working set."""
        if not len(r):
            return self._empty()
        pinned, active = self.pinned.copy(), []
        for origin in working:
            i = origin.number
            if origin.side:
                pinned[i] = True
                self.x[i] = self.upper[i] if origin.side > 0.0 else self.lower[i]
            else:
                active.append(i)
        G, g = self.G[active], self.g[active]
        held = self.held.plus(G, self.x, sums([(G, -self.x)], g), 0.0)
        free = np.flatnonzero(~pinned)
        found = refined(self.x, B, r, held, free, smallest=RANK_TOLERANCE * size)
        step = found.x - self.x
        share = self._share(step, pinned, active)
        lost = (1.0 - share) * float(np.linalg.norm(B @ step))
        moved = self.x + share * step if lost else found.x
        self.x = np.clip(moved, self.lower, self.upper)
        gain, wrong = self._gain(B, working, held, found, pinned)
        uncertain = found.uncertain + lost + wrong / found.weakest
        if gain > row_tolerance(B, r):
            uncertain, gain = uncertain + gain, 0.0
        rest = np.zeros(len(r)) if lost else found.rest
        return Achieved(B, r, self.x.copy(), rest, uncertain if self.clear else _UNKNOWN, gain)

    def _share(self, step: Array, pinned: Mask, active: list[int]) -> float:
        """Share of a step that the inactive constraints allow."""
        open_rows = np.setdiff1d(np.arange(len(self.g)), active)
        G, g = self.G[open_rows], self.g[open_rows]
        moving = ~pinned
        speed = np.concatenate([step[moving], -step[moving], G @ step])
        slack = np.concatenate(
            [(self.upper - self.x)[moving], (self.x - self.lower)[moving], g - G @ self.x]
        )
        # Violations of the size of rounding errors do not count.
        sizes = np.concatenate([np.ones(2 * int(moving.sum())), np.linalg.norm(G, axis=1)])
        ahead = speed > np.maximum(slack, 0.0) + ROUNDING * sizes
        return float((np.maximum(slack, 0.0)[ahead] / speed[ahead]).min(initial=1.0))

    def _gain(
        self, B: Array, working: list[RowOrigin], held: Held, found: Refined, pinned: Mask
    ) -> tuple[float, float]:
        """Bound of a further decrease of ‖B x − r‖, and the sum of wrong-signed multipliers.

        The decrease follows from the part of the gradient that the multipliers do not balance.
        """
        rho, multipliers = found.residual, found.multipliers
        slope = sums([(B.T, rho), (held.rows.T, -multipliers)])
        slope[np.abs(slope) <= _LAST_DIGITS * (np.abs(B.T) @ np.abs(rho))] = 0.0
        unexplained = np.where(pinned, 0.0, np.abs(slope))
        for origin in working:
            if origin.side:
                unexplained[origin.number] = max(-origin.side * slope[origin.number], 0.0)
        # The active rows come last; the held ones before them may have multipliers of either sign.
        active = sum(origin.side == 0.0 for origin in working)
        wrong = float(np.maximum(-multipliers[len(multipliers) - active :], 0.0).sum())
        width = np.minimum(self.upper - self.lower, 2.0 * (1.0 + np.abs(self.x).max()))
        gained = float(unexplained @ width) + wrong * float(width.max())
        # ½‖·‖² decreases by at most ``gained``, and ‖·‖ at most to zero.
        length, shorter = float(np.linalg.norm(rho)), math.sqrt(2.0 * gained)
        gain = min(shorter, gained / length) if length > 0.0 else shorter
        return gain, wrong + float(unexplained[pinned].sum())

    def _hold(self, achieved: Achieved, stopped: list[RowOrigin]) -> None:
        """Hold what a level achieved, and the bounds and rows that were active at its optimum."""
        for origin in stopped:
            if origin.side:
                self.pinned[origin.number] = True
                continue
            G, g = self.G[[origin.number]], self.g[[origin.number]]
            self.held = self.held.plus(G, self.x, sums([(G, -self.x)], g), 0.0)
        self.held = self.held.plus(achieved.B, achieved.anchor, achieved.rest, achieved.uncertain)

    def _note(self, origin: RowOrigin, multiplier: float) -> None:
        """Store an active row's multiplier, unless a higher level has stored one."""
        value = multiplier / origin.length
        if origin.side:
            if self.box_multipliers[origin.number] == 0.0:
                self.box_multipliers[origin.number] = origin.side * value
        elif self.row_multipliers[self.row_origins[origin.number]] == 0.0:
            self.row_multipliers[self.row_origins[origin.number]] = value

    def _freeze(self, level: Level, violated: Mask, held: Array) -> None:
        """Reduce N to the null space of the level's achieved rows and its active rows (k, p)."""
        unique = np.vstack([level.A, level.G[violated]])
        size = np.linalg.norm(unique, axis=1)
        fixed = unique[size > 0.0] @ self.basis / size[size > 0.0, None]
        rows = np.vstack([fixed, held])
        self.clear &= clear_cut(rows)
        self.basis = self.basis @ null_basis(rows, self.basis.shape[1])


def lexicographic(
    levels: Sequence[Level],
    lower: Array,
    upper: Array,
    start: Array | None = None,
    *,
    refine: bool = False,
) -> Cascade:
    """The points inside the bounds that are optimal for the levels in strict priority.

    Args:
        levels: From the most to the least important.
        lower: Bounds, −∞ where there is none, (n,).
        upper: Bounds, (n,).
        start: Starting point, (n,); zero if ``None``.
        refine: Whether to refine each level to the last digits and to bound its error.
    """
    begin = np.zeros(len(lower)) if start is None else start
    cascade = Cascade.from_point(begin, lower, upper, refine=refine)
    for level in levels:
        cascade.minimise(level)
    return cascade
