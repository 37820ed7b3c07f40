"""No result is handed on unverified."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.problem import QuadraticProgram

EQUALITY_TOLERANCE = 1e-7
"""Largest equality residual, relative to 1 + max |b|; m/s and rad/s."""
BOUND_TOLERANCE = 1e-8
"""Largest excess over a bound or inequality row, relative to 1 + max |x|; rad/s or the row's."""


def complaint(problem: QuadraticProgram, x: Array | None) -> str:
    """What is wrong with ``x`` as an answer to ``problem``; empty if nothing is.

    Checked are shape, finiteness, equality rows, inequality rows and bounds.
    """
    if x is None:
        return "no result"
    if x.shape != (problem.n,):
        return f"a result of shape {x.shape} for {problem.n} unknowns"
    if not np.isfinite(x).all():
        return "a result that is not finite"
    size = 1.0 + float(np.abs(x).max(initial=0.0))
    equality = float(np.abs(problem.A @ x - problem.b).max(initial=0.0))
    if equality > EQUALITY_TOLERANCE * (1.0 + float(np.abs(problem.b).max(initial=0.0))):
        return f"an equality residual of {equality:.2e}"
    row = float((problem.G @ x - problem.g).max(initial=0.0))
    if row > BOUND_TOLERANCE * size:
        return f"an inequality row exceeded by {row:.2e}"
    excess = max(
        float((problem.lower - x).max(initial=0.0)), float((x - problem.upper).max(initial=0.0))
    )
    if excess > BOUND_TOLERANCE * size:
        return f"a bound exceeded by {excess:.2e}"
    return ""
