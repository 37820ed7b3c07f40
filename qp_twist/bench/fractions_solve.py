"""Linear algebra of fractions."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from qp_twist.checks import Array

Row = list[Fraction]


class Dependent(ArithmeticError):
    """The rows of a system depend on each other."""


def fractions(values: Array) -> Row:
    """Binary fractions as what they are."""
    return [Fraction(float(value)) for value in values]


def dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    """Σ aᵢ bᵢ."""
    return sum((p * q for p, q in zip(a, b, strict=True) if p and q), Fraction())


def solve(matrix: Sequence[Sequence[Fraction]], right: Sequence[Fraction]) -> Row:
    """The solution of a square system, by elimination with any pivot that is not zero.

    Raises:
        Dependent: If it has none, or many.
    """
    work = [[*row, end] for row, end in zip(matrix, right, strict=True)]
    size = len(work)
    for k in range(size):
        pivot = next((i for i in range(k, size) if work[i][k]), None)
        if pivot is None:
            raise Dependent("the rows depend on each other.")
        work[k], work[pivot] = work[pivot], work[k]
        for i in range(k + 1, size):
            if work[i][k]:
                share = work[i][k] / work[k][k]
                work[i][k:] = [p - share * q for p, q in zip(work[i][k:], work[k][k:], strict=True)]
    x = [Fraction()] * size
    for k in reversed(range(size)):
        x[k] = (work[k][size] - dot(work[k][k + 1 : size], x[k + 1 :])) / work[k][k]
    return x


def floats(values: Row) -> Array:
    """Each rounded once."""
    return np.array([float(value) for value in values])
