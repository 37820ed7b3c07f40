"""The optimum of a level to the last digits, and how far from it a point may be."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.qp.active_set import RANK_TOLERANCE

_CORRECTIONS = 5
"""Most corrections; where rows are not close to dependent the second one is rounding."""
_SETTLED = 1e-15
"""A correction that changes the rows by less than this share of their terms is rounding."""
_SQUARED = float(np.sqrt(np.finfo(float).tiny))
"""The square of a smaller number is not a number any more, so that nothing is gained by it."""
_SPLIT = 2.0**27 + 1.0
"""Splits a number into two halves of 26 bits (Veltkamp 1968)."""

Indices = npt.NDArray[np.intp]


class Held(NamedTuple):
    """Rows E x = e. Of e more digits are kept than a number has: e = E·anchor + rest."""

    rows: Array
    """E, of length about one, (h, n)."""
    anchors: Array
    """A point for each row, (h, n)."""
    rests: Array
    """(h,)."""
    uncertain: Array
    """How far e may be from what the level above achieves at its optimum, (h,)."""

    @classmethod
    def none(cls, n: int) -> Held:
        """No rows on n unknowns."""
        return cls(np.zeros((0, n)), np.zeros((0, n)), np.zeros(0), np.zeros(0))

    def plus(self, rows: Array, anchor: Array, rests: Array, uncertain: float) -> Held:
        """With more rows, held where they are at a point, plus a rest."""
        lengths = np.linalg.norm(rows, axis=1)
        seen = lengths > 0.0
        unit = np.exp2(np.floor(np.log2(lengths[seen])))  # division by it rounds nothing
        return Held(
            np.vstack([self.rows, rows[seen] / unit[:, None]]),
            np.vstack([self.anchors, np.broadcast_to(anchor, (len(unit), len(anchor)))]),
            np.concatenate([self.rests, rests[seen] / unit]),
            np.concatenate([self.uncertain, uncertain / unit]),
        )

    def missing(self, x: Array) -> Array:
        """e − E x, rounded once, (h,)."""
        return sums([(self.rows, self.anchors), (self.rows, -x)], self.rests)


class Refined(NamedTuple):
    """What :func:`refined` found."""

    x: Array
    """The point, (n,)."""
    residual: Array
    """ρ of the optimum, (m,)."""
    multipliers: Array
    """λ, (h,)."""
    rest: Array
    """What B x lacks of the optimum: about what rounding x takes from it, (m,)."""
    uncertain: float
    """How far B x + rest may be from the optimum, in the unit of B x."""
    weakest: float
    """Smallest singular value of B that counts, on what E x = e leaves; ∞ where none does."""


def refined(x: Array, B: Array, r: Array, held: Held, free: Indices, *, smallest: float) -> Refined:
    r"""Newton's method on the optimality conditions of min ½‖B x − r‖² under E x = e.

    .. math::

        \rho + \mathbf B x = r,\qquad \mathbf B^T\rho - \mathbf E^T\lambda = 0,\qquad
        \mathbf E x = e

    They are linear: each step mends what the arithmetic of the one before has lost. What is left of
    them is summed without rounding, everything else is in double precision. This is the iterative
    refinement of least squares (Björck, BIT 7, 1967): it finds the point, too, in directions that
    the rows hardly see, where a small gradient says little; the levels below may see them well.

    Args:
        x: A point near the optimum, (n,).
        B: Rows, (m, n).
        r: Right-hand side, (m,).
        held: E and e.
        free: The unknowns that move; others are at a bound.
        smallest: Singular values of B below this count as zero.
    """
    x = x.copy()
    E, B_free = held.rows[:, free], B[:, free]
    left, sigma, right = np.linalg.svd(E)
    rank = int((sigma > RANK_TOLERANCE).sum())
    inverse, N = right[:rank].T @ (left[:, :rank] / sigma[:rank]).T, right[rank:].T
    worst = float(sigma[0] / sigma[rank - 1]) if rank else 1.0
    left, sigma, right = np.linalg.svd(B_free @ N, full_matrices=False)
    kept = int((sigma > max(smallest, _SQUARED)).sum())
    U, S, V = left[:, :kept], sigma[:kept], right[:kept].T
    worst += float(S[0] / S[-1]) if kept else 0.0
    weakest = float(S[-1]) if kept else math.inf
    # What levels above may be off moves the optimum.
    inherited = float(np.linalg.norm(np.abs(B_free @ inverse) @ held.uncertain))
    rho = sums([(B, -x)], r)
    multipliers = inverse.T @ (B_free.T @ rho)
    size = _SETTLED * float(np.linalg.norm(np.abs(B) @ np.abs(x) + np.abs(r)))
    before = math.inf
    for _ in range(_CORRECTIONS):
        f = sums([(B, -x)], r, -rho)
        g = sums([(B_free.T, -rho), (E.T, multipliers)])
        across = inverse @ held.missing(x)
        f -= B_free @ across
        along = N @ (V @ (U.T @ f / S - V.T @ (N.T @ g) / S**2))
        rest = B_free @ (across + along)
        moved = float(np.linalg.norm(rest))
        if moved > size and not moved < 0.5 * before:
            break
        change = f - B_free @ along
        rho += change
        multipliers += inverse.T @ (B_free.T @ change - g)
        if moved <= size:
            # The next correction would be smaller by the share that the arithmetic loses.
            uncertain = inherited + moved * min(1.0, _SETTLED * worst)
            return Refined(x, rho, multipliers, rest, uncertain, weakest)
        x[free] += across + along
        before = moved
    return Refined(x, rho, multipliers, np.zeros(len(r)), inherited + moved, weakest)


def sums(products: list[tuple[Array, Array]], *terms: Array) -> Array:
    """A v for all matrices and vectors, and the terms, added up row by row and rounded once."""
    parts = [term[:, None] for term in terms]
    for a, b in products:
        high = a * b
        parts += [high, _lost(a, b, high)]
    return np.array([math.fsum(row) for row in np.hstack(parts).tolist()])


def _lost(a: Array, b: Array, product: Array) -> Array:
    """What rounding took from a product of two numbers, exactly (Dekker 1971)."""
    a_high, b_high = _SPLIT * a, _SPLIT * b
    a_high, b_high = a_high - (a_high - a), b_high - (b_high - b)
    a_low, b_low = a - a_high, b - b_high
    lost: Array = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return lost
