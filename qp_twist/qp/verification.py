"""No result is handed on unverified."""

from __future__ import annotations

import math
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


class Residuals(NamedTuple):
    """How far a point is from the constraints of a program, row by row."""

    equality: Array
    """A x − b, (m,)."""
    room: Array
    """g − G x, (k,)."""
    above: Array
    """x − lower, (n,)."""
    below: Array
    """upper − x, (n,)."""

    @classmethod
    def at(cls, problem: QuadraticProgram, x: Array) -> Residuals:
        """Of a point x (n,)."""
        return cls(
            problem.A @ x - problem.b,
            problem.g - problem.G @ x,
            x - problem.lower,
            problem.upper - x,
        )


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
    size = 1.0 + _largest(x)
    if not size < np.inf:  # NaN neither
        return "a result that is not finite"
    left = Residuals.at(problem, x)
    equality = _largest(left.equality)
    if not equality <= EQUALITY_TOLERANCE * (1.0 + _largest(problem.b)):
        return f"an equality residual of {equality:.2e}"
    if len(left.room) and not -left.room.min() <= BOUND_TOLERANCE * size:
        return f"an inequality row exceeded by {-left.room.min():.2e}"
    excess = -min(float(left.above.min()), float(left.below.min())) if problem.n else 0.0
    if not excess <= BOUND_TOLERANCE * size:
        return f"a bound exceeded by {excess:.2e}"
    return ""


def _largest(values: Array) -> float:
    """max |values|; 0 of none, NaN if there is one."""
    return float(np.abs(values).max()) if values.size else 0.0


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
    left = Residuals.at(problem, x)
    active = _Active.at(problem, x, left, _TOUCHING)
    # A multiplier of the wrong sign, or of what x does not touch, counts as none.
    multipliers = Multipliers(
        claimed.equality,
        np.where(active.rows & (claimed.rows > 0.0), claimed.rows, 0.0),
        np.where(np.where(claimed.box > 0.0, active.upper, active.lower), claimed.box, 0.0),
    )
    with np.errstate(over="ignore", invalid="ignore"):  # a claim may be anything
        excess = _excess(problem, x, gradient, left, multipliers)
    for close in (_ON, _TOUCHING):
        if excess <= 1.0:
            break
        multipliers = _best(problem, gradient, _Active.at(problem, x, left, close))
        excess = _excess(problem, x, gradient, left, multipliers)
    if excess <= 1.0:
        return multipliers
    return f"a point that is not optimal ({excess:.1e} times the tolerance)"


class _Active(NamedTuple):
    """Which rows of G and which bounds a point touches."""

    rows: Mask
    lower: Mask
    upper: Mask

    @classmethod
    def at(cls, problem: QuadraticProgram, x: Array, left: Residuals, close: float) -> _Active:
        close = close * (1.0 + _largest(x))
        rows = left.room <= close
        if len(left.room):
            rows = left.room <= close * (1.0 + np.abs(problem.G).sum(axis=1))
        return cls(rows, left.above <= close, left.below <= close)


def _excess(
    problem: QuadraticProgram,
    x: Array,
    gradient: Array,
    left: Residuals,
    multipliers: Multipliers,
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
    y, box = multipliers.equality, multipliers.box
    terms = np.array([problem.c, problem.A.T @ y, problem.G.T @ multipliers.rows, box])
    residual = gradient + terms[1:].sum(axis=0)
    size, reach = max(_largest(problem.H), 1e-300), 1.0 + _largest(x)
    cost = (size * reach + _largest(problem.c)) * reach
    room = np.where(box > 0.0, left.below, np.where(box < 0.0, left.above, 0.0))
    gain = float(np.abs(box) @ room)
    try:
        gap = 0.5 * float(residual @ np.linalg.solve(problem.H, residual))
    except np.linalg.LinAlgError:  # of a singular H it says nothing
        gap = 0.0
    gap += gain - float(y @ left.equality)
    lost = 0.0
    if multipliers.rows.any():
        on = np.flatnonzero(multipliers.rows)
        pull, room = multipliers.rows[on], left.room[on]
        gain += float(pull @ np.maximum(room, 0.0))
        gap += float(pull @ room)
        terms_of_rows = np.abs(problem.g[on]) + np.abs(problem.G[on]) @ np.abs(x)
        lost = ROUNDING * float(pull @ terms_of_rows)
    ratios = (
        _largest(residual) / (OPTIMALITY_TOLERANCE * size * reach + ROUNDING * _largest(terms)),
        gain / (GAIN_TOLERANCE * cost + lost),
        gap / (GAP_TOLERANCE * cost + lost),
    )
    return max(ratios) if all(map(math.isfinite, ratios)) else math.inf


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
