"""The quadratic program of one step, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from qp_twist.checks import Array


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

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.c)

    def with_rows(self, b: Array) -> QuadraticProgram:
        """The same program with another right-hand side of the equality rows."""
        return replace(self, b=b)

    def save(self, path: str | Path) -> None:
        """Write the arrays to a ``.npz`` file, so that a step can be sent to somebody."""
        with Path(path).open("wb") as file:
            np.savez(file, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> QuadraticProgram:
        """Read a program written by :meth:`save`."""
        with np.load(path, allow_pickle=False) as arrays:
            return cls(**{f.name: arrays[f.name] for f in fields(cls)})
