"""Strict priorities in 60-digit decimal arithmetic: an oracle that no BLAS kernel takes part in."""

import decimal
from decimal import Decimal
from typing import Any

import numpy as np
import numpy.typing as npt

from oracles.hierarchies import Hierarchy

Array = npt.NDArray[np.float64]
Exact = npt.NDArray[np.object_]
Singular = list[tuple[Decimal, Exact, Exact]]

DIGITS = 60
RANK = Decimal("1e-10")
"""Singular values below this share of a level's longest row are left to the levels below."""
ZERO = Decimal("1e-22")
"""What is left of the arithmetic's rounding, of numbers up to 1e10."""
MET = Decimal("1e-9")
"""An inequality row that is exceeded by less is met."""
DEPENDENT = Decimal("1e-18")
"""A row of which less than this share is left is a combination of others."""


class NoOracle(ArithmeticError):
    """The active constraints were not found."""


def exact(values: Any) -> Exact:
    """Binary fractions as decimals, without rounding."""
    array = np.asarray(values, dtype=np.float64)
    return np.array([Decimal(float(v)) for v in array.ravel()], dtype=object).reshape(array.shape)


def length(vector: Exact) -> Decimal:
    return Decimal(sum((v * v for v in vector), Decimal(0))).sqrt()


def exact_cascade(h: Hierarchy) -> list[float]:
    """Level after level, min ‖A x − b‖² + ‖max(G x − g, 0)‖² inside the bounds: the lengths."""
    with decimal.localcontext(prec=DIGITS):
        cascade = _Cascade(h)
        return [float(cascade.level(*map(exact, level))) for level in h.levels]


class _Cascade:
    """A point, the orthonormal rows that are held there, and rows · x ≤ ends."""

    def __init__(self, h: Hierarchy) -> None:
        self.n = len(h.lower)
        self.x = exact(np.clip(np.zeros(self.n), h.lower, h.upper))
        self.held: list[Exact] = []
        self.rows: list[Exact] = []
        self.ends: list[Decimal] = []
        for unit, low, high in zip(exact(np.eye(self.n)), h.lower, h.upper, strict=True):
            if low == high:
                self.held.append(unit)
                continue
            for side, end in ((1, high), (-1, low)):
                if np.isfinite(end):
                    self.rows.append(side * unit)
                    self.ends.append(side * Decimal(float(end)))

    def level(self, A: Exact, b: Exact, G: Exact, g: Exact) -> Decimal:
        """Go to the optimum of a level and hold it; the length of its residual.

        By a primal active-set method in (x, w) with G x − w ≤ g and ½‖w‖² in the cost.
        """
        n, k = self.n, len(g)
        wide = _Cascade.__new__(_Cascade)
        wide.n = n + k
        none = exact(np.zeros(k))
        wide.x = np.concatenate([self.x, [max(v, Decimal(0)) for v in G @ self.x - g]])
        wide.held = [np.concatenate([row, none]) for row in self.held]
        wide.rows = [np.concatenate([row, none]) for row in self.rows]
        wide.ends = list(self.ends)
        for row, unit, end in zip(G, exact(np.eye(k)), g, strict=True):
            wide.rows.append(np.concatenate([row, -unit]))
            wide.ends.append(end)
        B = np.concatenate(
            [
                np.concatenate([A, exact(np.zeros((len(b), k)))], axis=1),
                np.concatenate([exact(np.zeros((k, n))), exact(np.eye(k))], axis=1),
            ]
        )
        r = np.concatenate([b, none])
        strict = wide.minimise(B, r) if len(B) else []
        self.x = wide.x[:n]
        for row in strict:
            if row < len(self.rows):
                self.hold(self.rows[row])
        # Less is what rows that repeat those of a level above, up to rounding, pull at others.
        violated = np.array([excess > MET for excess in wide.x[n:]], dtype=bool)
        units = [row / length(row) for row in [*A, *G[violated]] if length(row) > 0]
        for sigma, direction, _ in self.singular(units, self.held):
            if self.kept(sigma, Decimal(1)):
                self.hold(direction)
        for row, end in zip(G[~violated], g[~violated], strict=True):
            self.rows.append(row)
            self.ends.append(max(end, row @ self.x))
        return length(B @ wide.x - r)

    def minimise(self, B: Exact, r: Exact) -> list[int]:
        """Go to the minimum of ‖B x − r‖; the constraints with a positive multiplier."""
        size = max(length(row) for row in B)
        working, degenerate = list[int](), 0
        for _ in range(1000):
            left = r - B @ self.x
            step = self.step(B, left, working, size)
            share, blocking = Decimal(1), -1
            for k, (row, end) in enumerate(zip(self.rows, self.ends, strict=True)):
                speed = row @ step
                if k not in working and speed > ZERO and end - row @ self.x < share * speed:
                    share, blocking = max(end - row @ self.x, Decimal(0)) / speed, k
            self.x = self.x + share * step
            degenerate = degenerate + 1 if share == 0 else 0
            if blocking >= 0:
                working.append(blocking)
                continue
            wrong = self.wrong(B, r, working, size)
            if not wrong:
                left = r - B @ self.x
                # What directions below the threshold could still gain holds nothing.
                dust = ZERO + RANK * size * length(left)
                found = zip(self.multipliers(B.T @ left, working), working, strict=True)
                return [k for m, k in found if m > dust]
            working.remove(min(wrong)[1] if degenerate < 20 else min(k for _, k in wrong))
        raise NoOracle("the active constraints were not found")

    def wrong(
        self, B: Exact, r: Exact, working: list[int], size: Decimal
    ) -> list[tuple[Decimal, int]]:
        """Negative multipliers of constraints without which there is a better point.

        Without some only directions are added that are below the threshold of the rank.
        """
        left = r - B @ self.x
        wrong = []
        for m, k in zip(self.multipliers(B.T @ left, working), working, strict=True):
            if m < -ZERO:
                others = [other for other in working if other != k]
                if self.rows[k] @ self.step(B, left, others, size) < -ZERO:
                    wrong.append((m, k))
        return wrong

    def step(self, B: Exact, rate: Exact, working: list[int], size: Decimal) -> Exact:
        """The shortest way to the minimum on the held and the working rows."""
        basis = self.with_rows(working)
        step = exact(np.zeros(self.n))
        for sigma, direction, left in self.singular(list(B), basis):
            if self.kept(sigma, size):
                step = step + direction * (left @ rate) / sigma
        return step

    def with_rows(self, working: list[int]) -> list[Exact]:
        basis = list(self.held)
        for k in working:
            left = self.without(self.rows[k], basis)
            basis.append(left / length(left))
        return basis

    def kept(self, sigma: Decimal, size: Decimal) -> bool:
        return bool(sigma > RANK * size)

    def hold(self, row: Exact) -> None:
        left = self.without(row, self.held)
        if length(left) > DEPENDENT * length(row):
            self.held.append(left / length(left))

    @staticmethod
    def without(row: Exact, basis: list[Exact]) -> Exact:
        for _ in range(2):
            for unit in basis:
                row = row - (unit @ row) * unit
        return row

    def singular(self, matrix: list[Exact], basis: list[Exact]) -> Singular:
        """σ, v and u of a matrix on what a basis leaves, by one-sided Jacobi rotations."""
        rows = [self.without(row, basis) for row in matrix]
        left = list(exact(np.eye(len(rows))))
        size = max([*(length(row) for row in matrix), ZERO])
        squares = [row @ row for row in rows]
        turned = True
        while turned:
            turned = False
            for i in range(len(rows)):
                for j in range(i + 1, len(rows)):
                    p, q, both = squares[i], squares[j], rows[i] @ rows[j]
                    if min(p, q) < (ZERO * size) ** 2 or both**2 <= Decimal("1e-80") * p * q:
                        continue
                    turned = True
                    zeta = (q - p) / (2 * both)
                    t = (1 if zeta >= 0 else -1) / (abs(zeta) + (1 + zeta * zeta).sqrt())
                    c = 1 / (1 + t * t).sqrt()
                    s = c * t
                    rows[i], rows[j] = c * rows[i] - s * rows[j], s * rows[i] + c * rows[j]
                    left[i], left[j] = c * left[i] - s * left[j], s * left[i] + c * left[j]
                    squares[i], squares[j] = rows[i] @ rows[i], rows[j] @ rows[j]
        sigmas = [square.sqrt() for square in squares]
        return [
            (sigma, row / sigma, u)
            for sigma, row, u in zip(sigmas, rows, left, strict=True)
            if sigma > ZERO * size
        ]

    def multipliers(self, gradient: Exact, working: list[int]) -> list[Decimal]:
        """Of the working rows, in gradient = Σ λ row + what is held; by Gram–Schmidt."""
        Q: list[Exact] = []
        R = [[Decimal(0)] * len(working) for _ in working]
        for j, k in enumerate(working):
            row = self.without(self.rows[k], self.held)
            left = self.without(row, Q)
            for i, unit in enumerate(Q):
                R[i][j] = unit @ row
            R[j][j] = length(left)
            Q.append(left / R[j][j])
        result = [Decimal(0)] * len(Q)
        for j in range(len(Q) - 1, -1, -1):
            known = sum((R[j][i] * result[i] for i in range(j + 1, len(Q))), Decimal(0))
            result[j] = (Q[j] @ gradient - known) / R[j][j]
        return result
