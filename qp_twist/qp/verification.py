"""No result is handed on unverified."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from qp_twist.checks import Array
from qp_twist.qp.problem import QuadraticProgram

EQUALITY_TOLERANCE = 1e-8
"""Largest equality residual, relative to 1 + max |b|; m/s and rad/s."""
BOUND_TOLERANCE = 1e-8
"""Largest excess over a bound or inequality row, relative to 1 + max |x|; rad/s or the row's."""
OPTIMALITY_TOLERANCE = 1e-6
"""Largest gradient that no multiplier explains, over max |H|, relative to 1 + max |x|; rad/s."""
_ROUNDING = 1e-11
"""What the sums of the optimality condition lose, as a share of their largest term."""


class Multipliers(NamedTuple):
    """Lagrange multipliers of a quadratic program."""

    equality: Array
    """Of A x = b, (m,)."""
    rows: Array
    """Of G x ≤ g, non-negative, (k,)."""
    box: Array
    """Of the bounds, positive at an upper one, negative at a lower one, (n,)."""

    @classmethod
    def none(cls, problem: QuadraticProgram) -> Multipliers:
        """All zero."""
        return cls(np.zeros(len(problem.b)), np.zeros(len(problem.g)), np.zeros(problem.n))


def infeasibility(problem: QuadraticProgram, x: Array | None) -> str:
    """Which constraint of ``problem`` the claimed result ``x`` breaks; empty if none.

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
    if not equality <= EQUALITY_TOLERANCE * (1.0 + float(np.abs(problem.b).max(initial=0.0))):
        return f"an equality residual of {equality:.2e}"
    row = float((problem.G @ x - problem.g).max(initial=0.0))
    if not row <= BOUND_TOLERANCE * size:
        return f"an inequality row exceeded by {row:.2e}"
    excess = max(
        float((problem.lower - x).max(initial=0.0)), float((x - problem.upper).max(initial=0.0))
    )
    if not excess <= BOUND_TOLERANCE * size:
        return f"a bound exceeded by {excess:.2e}"
    return ""


def proof_of_optimality(
    problem: QuadraticProgram, x: Array, claimed: Multipliers
) -> Multipliers | str:
    r"""Multipliers that prove a feasible ``x`` optimal, or what is wrong with it.

    .. math::

        \mathbf H x + \mathbf c + \mathbf A^T y + \mathbf G^T\lambda + \mu = 0, \quad
        \lambda \ge 0,\; \lambda^T(\mathbf G x - \mathbf g) = 0,\;
        \mu_i \text{ of the sign of the bound that } x_i \text{ touches}

    The backend's multipliers are tried first. Where they prove nothing, which says little about x,
    the best ones are found by non-negative least squares (Lawson and Hanson 1974).
    """
    gradient = problem.H @ x + problem.c
    close = 1e-6 * (1.0 + float(np.abs(x).max(initial=0.0)))
    touching = problem.G @ x >= problem.g - close * (1.0 + np.abs(problem.G).sum(axis=1))
    at_upper, at_lower = x >= problem.upper - close, x <= problem.lower + close
    box = np.where(at_upper, np.maximum(claimed.box, 0.0), 0.0)
    box += np.where(at_lower, np.minimum(claimed.box, 0.0), 0.0)
    rows = np.where(touching, np.maximum(claimed.rows, 0.0), 0.0)
    multipliers = Multipliers(claimed.equality, rows, box)
    if _unexplained(problem, x, gradient, multipliers) <= 1.0:
        return multipliers
    multipliers = _best(problem, gradient, touching, at_lower, at_upper)
    excess = _unexplained(problem, x, gradient, multipliers)
    if excess <= 1.0:
        return multipliers
    return f"a point that is not optimal (gradient {excess:.1e} times its tolerance)"


def _unexplained(
    problem: QuadraticProgram, x: Array, gradient: Array, multipliers: Multipliers
) -> float:
    """Length of the gradient that the multipliers leave, in units of its tolerance."""
    equality, rows = problem.A.T @ multipliers.equality, problem.G.T @ multipliers.rows
    left = np.abs(gradient + equality + rows + multipliers.box).max(initial=0.0)
    size = float(np.abs(problem.H).max(initial=0.0)) or 1.0
    allowed = OPTIMALITY_TOLERANCE * size * (1.0 + np.abs(x).max(initial=0.0))
    terms = (problem.c, equality, rows, multipliers.box)
    largest = max(float(np.abs(term).max(initial=0.0)) for term in terms)
    ratio = float(left) / float(allowed + _ROUNDING * largest)
    return ratio if np.isfinite(ratio) else np.inf


def _best(
    problem: QuadraticProgram,
    gradient: Array,
    touching: np.ndarray[tuple[int], np.dtype[np.bool_]],
    at_lower: np.ndarray[tuple[int], np.dtype[np.bool_]],
    at_upper: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> Multipliers:
    """The multipliers that leave the least of the gradient."""
    identity = np.eye(problem.n)
    columns = np.vstack(
        [problem.A, -problem.A, problem.G[touching], identity[at_upper], -identity[at_lower]]
    )
    if not len(columns):
        return Multipliers.none(problem)  # and scipy's nnls aborts the process without columns
    lengths = np.linalg.norm(columns, axis=1)
    lengths[lengths == 0.0] = 1.0
    try:
        values = nnls((columns / lengths[:, None]).T, -gradient)[0] / lengths
    except RuntimeError:  # too many iterations: nothing is proven
        return Multipliers.none(problem)
    m = len(problem.b)
    plus, minus, active, upper, lower = np.split(
        values, np.cumsum([m, m, int(touching.sum()), int(at_upper.sum())])
    )
    rows, box = np.zeros(len(problem.g)), np.zeros(problem.n)
    rows[touching] = active
    box[at_upper] += upper
    box[at_lower] -= lower
    return Multipliers(plus - minus, rows, box)
