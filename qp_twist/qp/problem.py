"""The quadratic program of one step, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from qp_twist.checks import Array, largest


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    r"""min ½ xᵀH x + cᵀx  subject to  A x = b,  G x ≤ g,  lower ≤ x ≤ upper.

    Attributes:
        H: Positive definite Hessian, (n, n).
        c: Linear cost, (n,).
        A: Equality rows, (m, n); none: shape (0, n).
        b: Right-hand side, (m,).
        G: Inequality rows, (k, n); none: shape (0, n).
        g: Right-hand side, (k,).
        lower: Lower bounds, −∞ where there is none, (n,).
        upper: Upper bounds, +∞ where there is none, (n,).
    """

    H: Array
    c: Array
    A: Array
    b: Array
    G: Array
    g: Array
    lower: Array
    upper: Array

    @classmethod
    def free(cls, H: Array, c: Array, G: Array, g: Array) -> QuadraticProgram:
        """A program without equality rows and bounds."""
        none, end = np.zeros((0, len(c))), np.full(len(c), np.inf)
        return cls(H, c, none, none[:, 0], G, g, -end, end)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.c)

    @cached_property
    def steepest(self) -> float:
        """max |H|, the size of the quadratic cost."""
        return largest(self.H)

    @cached_property
    def pull(self) -> float:
        """max |c|, the size of the linear one."""
        return largest(self.c)

    def with_rows(self, H: Array, c: Array, A: Array, b: Array) -> QuadraticProgram:
        """The program with other costs and equality rows."""
        return QuadraticProgram(H, c, A, b, self.G, self.g, self.lower, self.upper)

    def widened(self, k: int) -> QuadraticProgram:
        """The program with k more unknowns, which have neither costs nor bounds nor entries."""
        n, free = self.n + k, np.full(k, np.inf)
        return QuadraticProgram(
            widened(widened(self.H, n).T, n), np.append(self.c, np.zeros(k)),
            widened(self.A, n), self.b, widened(self.G, n), self.g,
            np.append(self.lower, -free), np.append(self.upper, free),
        )  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the arrays to a ``.npz`` file, so that a step can be sent to somebody."""
        np.savez(Path(path), **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> QuadraticProgram:
        """Read a program written by :meth:`save`."""
        with np.load(Path(path), allow_pickle=False) as file:
            return cls(**{f.name: file[f.name] for f in fields(cls)})


def widened(rows: Array, n: int) -> Array:
    """A copy of rows (m, k) with zero columns, (m, n)."""
    wide = np.zeros((len(rows), n))
    wide[:, : rows.shape[1]] = rows
    return wide
