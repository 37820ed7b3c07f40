"""No result is handed on unverified."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from qp_twist.checks import Array
from qp_twist.qp.problem import QuadraticProgram

EQUALITY_TOLERANCE = 1e-8
"""Largest equality residual, relative to 1 + max |b|; m/s and rad/s. Less is zero."""
BOUND_TOLERANCE = 1e-8
"""Largest excess over a bound or row, relative to 1 + max |x|."""
OPTIMALITY_TOLERANCE = 1e-6
"""Largest gradient that no multiplier explains, over max |H|, relative to 1 + max |x|; rad/s."""
GAIN_TOLERANCE = 1e-7
"""Largest cost that multipliers see beyond ``x``, relative to that of moving by 1 + max |x|."""
GAP_TOLERANCE = 5e-7
"""Largest duality gap, relative to the same."""
_TOUCHING, _ON = 1e-6, 1e-9
"""Distances at which a row or bound may touch ``x``, or does, relative to 1 + max |x|."""
ROUNDING = 1e-11
"""What the sums of the optimality condition lose, as a share of their largest term."""

Mask = npt.NDArray[np.bool_]


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


def row_tolerance(A: Array, b: Array) -> float:
    """Length of A x − b below which the rows are met: 1e-8 (longest row + max |b|), unit of b.

    In a step b is in m/s and rad/s, and the longest row times 1 rad/s is a speed, so that this is a
    hundred-millionth of a speed that is asked for, or that the robot has. A right-hand side below
    1e-8 times the longest row is zero: standing still meets it. The result does not depend on the
    unit of the rows.
    """
    longest = float(np.linalg.norm(A, axis=1).max(initial=0.0)) or 1.0
    return EQUALITY_TOLERANCE * (longest + float(np.abs(b).max(initial=0.0)))


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
    active = _Active.at(problem, x, _TOUCHING)
    multipliers = Multipliers(
        claimed.equality,
        np.where(active.rows, np.maximum(claimed.rows, 0.0), 0.0),
        np.where(active.upper, np.maximum(claimed.box, 0.0), 0.0)
        + np.where(active.lower, np.minimum(claimed.box, 0.0), 0.0),
    )
    with np.errstate(over="ignore", invalid="ignore"):  # a claim may be anything
        excess = _excess(problem, x, gradient, multipliers)
    for close in (_ON, _TOUCHING):
        if excess <= 1.0:
            break
        multipliers = _best(problem, gradient, _Active.at(problem, x, close))
        excess = _excess(problem, x, gradient, multipliers)
    if excess <= 1.0:
        return multipliers
    return f"a point that is not optimal ({excess:.1e} times the tolerance)"


class _Active(NamedTuple):
    """Which rows of G and which bounds a point touches."""

    rows: Mask
    lower: Mask
    upper: Mask

    @classmethod
    def at(cls, problem: QuadraticProgram, x: Array, close: float) -> _Active:
        close = close * (1.0 + float(np.abs(x).max(initial=0.0)))
        return cls(
            problem.G @ x >= problem.g - close * (1.0 + np.abs(problem.G).sum(axis=1)),
            x <= problem.lower + close,
            x >= problem.upper - close,
        )


def _excess(
    problem: QuadraticProgram, x: Array, gradient: Array, multipliers: Multipliers
) -> float:
    r"""The largest of what the multipliers leave of three conditions, in units of its tolerance.

    They are the gradient r; what they would still gain by moving onto the rows and bounds that they
    belong to, without which a point deep in a narrow wedge, near both of its walls but far from its
    tip, would pass for the tip; and the duality gap

    .. math::

        \tfrac12 r^T \mathbf H^{-1} r - y^T(\mathbf A x - \mathbf b)
        + \lambda^T(\mathbf g - \mathbf G x) + |\mu|^T \text{room},

    by which no point that satisfies the constraints exactly has a lower cost. A small r is much
    where H is ill-conditioned, and so is a small residual where rows nearly depend on each other.
    """
    equality, rows = problem.A.T @ multipliers.equality, problem.G.T @ multipliers.rows
    residual = gradient + equality + rows + multipliers.box
    left = float(np.abs(residual).max(initial=0.0))
    size = max(float(np.abs(problem.H).max(initial=0.0)), 1e-300)
    reach = 1.0 + float(np.abs(x).max(initial=0.0))
    terms = (problem.c, equality, rows, multipliers.box)
    largest = max(float(np.abs(term).max(initial=0.0)) for term in terms)
    on, box = multipliers.rows != 0.0, multipliers.box
    G, g, pull = problem.G[on], problem.g[on], multipliers.rows[on]
    room = np.where(box > 0.0, problem.upper - x, x - problem.lower)[box != 0.0]
    held = float(np.abs(box[box != 0.0]) @ room)
    gain = float(pull @ np.maximum(g - G @ x, 0.0)) + held
    cost = (size * reach + float(np.abs(problem.c).max(initial=0.0))) * reach
    lost = ROUNDING * float(pull @ (np.abs(g) + np.abs(G) @ np.abs(x)))
    try:
        gap = 0.5 * float(residual @ np.linalg.solve(problem.H, residual))
    except np.linalg.LinAlgError:  # of a singular H it says nothing
        gap = 0.0
    gap += float(pull @ (g - G @ x)) + held
    gap -= float(multipliers.equality @ (problem.A @ x - problem.b))
    ratios = (
        left / (OPTIMALITY_TOLERANCE * size * reach + ROUNDING * largest),
        gain / (GAIN_TOLERANCE * cost + lost),
        gap / (GAP_TOLERANCE * cost + lost),
    )
    return max(ratios) if np.isfinite(ratios).all() else np.inf


def _best(
    problem: QuadraticProgram,
    gradient: Array,
    active: _Active,
) -> Multipliers:
    """The multipliers that leave the least of the gradient."""
    identity = np.eye(problem.n)
    columns = np.vstack(
        [
            problem.A,
            -problem.A,
            problem.G[active.rows],
            identity[active.upper],
            -identity[active.lower],
        ]
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
    plus, minus, on, upper, lower = np.split(
        values, np.cumsum([m, m, int(active.rows.sum()), int(active.upper.sum())])
    )
    rows, box = np.zeros(len(problem.g)), np.zeros(problem.n)
    rows[active.rows] = on
    box[active.upper] += upper
    box[active.lower] -= lower
    return Multipliers(plus - minus, rows, box)
