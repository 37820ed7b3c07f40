"""Strict priorities: a level never changes what the levels above it achieved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.active_set import RANK_TOLERANCE, constrained_least_squares, null_basis
from qp_twist.qp.verification import row_tolerance

SATISFIED = 1e-9
"""Excess at which an inequality row counts as met, relative to 1 + |g| + its length."""
_HELD = 1e-8
"""Rows with a multiplier above this share of the level's first gradient are held below it."""
_ROUNDING = 1e-13
"""What a residual loses to rounding, as a share of its terms."""


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

    def violation(self, x: Array) -> Array:
        """What is left of the level at ``x``: A x − b, and the part of G x above g, (m + k,)."""
        return np.concatenate([self.A @ x - self.b, np.maximum(self.G @ x - self.g, 0.0)])

    def padded(self, n: int) -> Level:
        """The same rows on more unknowns, (…, n), of which the added ones do not count."""
        more = n - self.A.shape[1]
        if more == 0:
            return self
        return Level(
            np.pad(self.A, ((0, 0), (0, more))), self.b, np.pad(self.G, ((0, 0), (0, more))), self.g
        )

    def met(self, x: Array) -> bool:
        """Whether the level is met at ``x``: its equality rows to their :func:`row_tolerance`."""
        left = float(np.linalg.norm(self.A @ x - self.b))
        excess = (self.G @ x - self.g) / (1.0 + np.abs(self.g) + np.linalg.norm(self.G, axis=1))
        met = left <= row_tolerance(self.A, self.b)
        return bool(met and excess.max(initial=0.0) <= SATISFIED)


class RowOrigin(NamedTuple):
    """Where a row of C comes from."""

    number: int
    """Of the unknown, or of the row of G."""
    side: float
    """1 for an upper bound, −1 for a lower one, 0 for a row of G."""
    length: float
    """By which the row was divided."""


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
        row_origins: Index of each row of G among all inequality rows given, in order of levels.
        box_multipliers: Of the bounds, at the first level where they are not zero; positive at an
            upper one, (n,).
        row_multipliers: The same for all inequality rows given, in order of levels.
        optimal: Whether every level's optimality conditions held.
    """

    x: Array
    basis: Array
    lower: Array
    upper: Array
    G: Array
    g: Array
    box_multipliers: Array
    row_origins: list[int] = field(default_factory=list)
    row_multipliers: list[float] = field(default_factory=list)
    optimal: bool = True

    @classmethod
    def from_point(cls, x: Array, lower: Array, upper: Array) -> Cascade:
        """Start from a point; it is moved inside the bounds. Fixed unknowns do not move."""
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
        )

    def rows(self) -> tuple[Array, Array, list[RowOrigin]]:
        """C, d and where each row comes from.

        z = 0 satisfies them all. Rows which no z moves are left out, the others have length one.
        """
        blocks = [
            (self.basis, self.upper - self.x, 1.0),
            (-self.basis, self.x - self.lower, -1.0),
            (self.G @ self.basis, self.g - self.G @ self.x, 0.0),
        ]
        rows, bounds = [np.zeros((0, self.basis.shape[1]))], [np.zeros(0)]
        origins: list[RowOrigin] = []
        for matrix, room, kind in blocks:
            length = np.linalg.norm(matrix, axis=1)
            scale = np.ones(len(matrix)) if kind else np.linalg.norm(self.G, axis=1)
            keep = np.flatnonzero(np.isfinite(room) & (length > RANK_TOLERANCE * scale))
            rows.append(matrix[keep] / length[keep, None])
            bounds.append(np.maximum(room[keep], 0.0) / length[keep])
            origins += [RowOrigin(int(i), kind, float(length[i])) for i in keep]
        return np.vstack(rows), np.concatenate(bounds), origins

    def minimise(self, level: Level) -> None:
        r"""Keep only the points that are optimal for another level.

        .. math::

            \min_{z, w} \tfrac12\lVert\mathbf A(\mathbf x + \mathbf N z) - \mathbf b\rVert^2
            + \tfrac12\lVert w\rVert^2 \quad\text{s.t.}\quad
            \mathbf G(\mathbf x + \mathbf N z) - w \le \mathbf g,\; \mathbf C z \le \mathbf d

        At the optimum A x, and the violated rows of G, are unique: they become equality rows, and N
        the part of it that does not see them. The rows of G that are met become strict. Bounds
        with a positive multiplier are active in every optimal point: they are frozen, which keeps
        the levels below from degenerating.
        """
        if not len(level.b) + len(level.g):
            return
        C, d, origins = self.rows()
        p, k = self.basis.shape[1], len(level.g)
        # Rows of G are measured by their own lengths, so that long ones do not drown those of A.
        heavy = np.linalg.norm(level.G, axis=1)
        size = float(np.linalg.norm(level.A, axis=1).max(initial=0.0))
        size = size or float(heavy.max(initial=0.0))
        heavy[heavy == 0.0] = 1.0
        terms = size * (1.0 + np.abs(self.x).max(initial=0.0)) + np.abs(level.b).max(initial=0.0)
        violation = float(np.linalg.norm(level.violation(self.x)))
        dust = size * (_HELD * violation + _ROUNDING * float(terms))
        if size > 0.0 and p > 0:
            B = np.block(
                [
                    [level.A @ self.basis, np.zeros((len(level.b), k))],
                    [np.zeros((k, p)), np.diag(heavy)],
                ]
            )
            room = (level.g - level.G @ self.x) / heavy
            soft = np.hstack([level.G @ self.basis / heavy[:, None], -np.eye(k)])
            found = constrained_least_squares(
                B,
                np.concatenate([level.b - level.A @ self.x, np.zeros(k)]),
                np.vstack([np.hstack([C, np.zeros((len(d), k))]), soft]),
                np.concatenate([d, room]),
                np.concatenate([np.zeros(p), np.maximum(-room, 0.0)]),
                smallest=RANK_TOLERANCE * size,
            )
            self.optimal &= found.optimal
            self._move(found.z[:p])
            multipliers = found.multipliers
        else:
            multipliers = np.zeros(len(d) + k)
        violated = level.G @ self.x - level.g > SATISFIED * (1.0 + np.abs(level.g) + heavy)
        multipliers[multipliers <= dust] = 0.0
        held = np.flatnonzero(multipliers[: len(d)])
        for i in held:
            self._note(origins[i], float(multipliers[i]))
        self._freeze(level, violated, C[held])
        first = len(self.row_multipliers)
        self.row_multipliers += list(multipliers[len(d) :] / heavy)
        self.row_origins += [first + int(i) for i in np.flatnonzero(~violated)]
        self.G = np.vstack([self.G, level.G[~violated]])
        self.g = np.concatenate([self.g, level.g[~violated]])

    def _move(self, z: Array) -> None:
        self.x = np.clip(self.x + self.basis @ z, self.lower, self.upper)

    def _note(self, origin: RowOrigin, multiplier: float) -> None:
        """Keep the multiplier of a row that stands in a level's way, unless a higher level has."""
        value = multiplier / origin.length
        if origin.side:
            if self.box_multipliers[origin.number] == 0.0:
                self.box_multipliers[origin.number] = origin.side * value
        elif self.row_multipliers[self.row_origins[origin.number]] == 0.0:
            self.row_multipliers[self.row_origins[origin.number]] = value

    def _freeze(
        self, level: Level, violated: np.ndarray[tuple[int], np.dtype[np.bool_]], held: Array
    ) -> None:
        """Hold what ``level`` achieved, and the rows (k, p) that stood in its way."""
        unique = np.vstack([level.A, level.G[violated]])
        size = np.linalg.norm(unique, axis=1)
        fixed = unique[size > 0.0] @ self.basis / size[size > 0.0, None]
        self.basis = self.basis @ null_basis(np.vstack([fixed, held]), self.basis.shape[1])


def lexicographic(
    levels: Sequence[Level], lower: Array, upper: Array, start: Array | None = None
) -> Cascade:
    """The points inside the bounds that are optimal for the levels, one strictly after the other.

    Args:
        levels: From the most to the least important.
        lower: Bounds, −∞ where there is none, (n,).
        upper: Bounds, (n,).
        start: Where to start from, (n,); zero if ``None``.
    """
    cascade = Cascade.from_point(np.zeros(len(lower)) if start is None else start, lower, upper)
    for level in levels:
        cascade.minimise(level)
    return cascade
