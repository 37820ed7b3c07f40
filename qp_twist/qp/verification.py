"""No result is handed on unverified."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv

from qp_twist.checks import Array, Mask, largest
from qp_twist.kernel.constants import (
    BOUND_TOLERANCE,
    EQUALITY_TOLERANCE,
    GAIN_TOLERANCE,
    GAP_TOLERANCE,
    OPTIMALITY_TOLERANCE,
    ROUNDING,
)
from qp_twist.qp.problem import QuadraticProgram

_TOUCHING, _ON = 1e-6, 1e-9
"""Distances at which a row or bound may touch ``x``, or does, relative to 1 + max |x|."""


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


class Point(NamedTuple):
    """A result inside the bounds, and how far it is from the constraints of its program."""

    x: Array
    """The unknowns, (n,)."""
    size: float
    """1 + max |x|, which tolerances are relative to."""
    equality: Array
    """A x − b, (m,)."""
    room: Array
    """g − G x, (k,)."""
    above: Array
    """x − lower, (n,)."""
    below: Array
    """upper − x, (n,)."""

    @classmethod
    def at(cls, problem: QuadraticProgram, x: Array) -> Point:
        """x (n,), moved into the bounds."""
        x = np.minimum(np.maximum(x, problem.lower), problem.upper)
        equality, room = problem.A @ x - problem.b, problem.g - problem.G @ x
        return cls(x, 1.0 + largest(x), equality, room, x - problem.lower, problem.upper - x)


def row_tolerance(A: Array, b: Array) -> float:
    """Length of A x − b below which the rows are met: 1e-8 (longest row + max |b|), unit of b.

    In a step b is in m/s and rad/s, and the longest row times 1 rad/s is a speed, so that this is a
    hundred-millionth of a speed that is asked for, or that the robot has. A right-hand side below
    1e-8 times the longest row is zero: standing still meets it. The result does not depend on the
    unit of the rows.
    """
    longest = float(np.linalg.norm(A, axis=1).max(initial=0.0)) or 1.0
    return EQUALITY_TOLERANCE * (longest + largest(b))


def feasible(problem: QuadraticProgram, x: Array | None) -> Point | str:
    """The claimed result ``x`` inside the bounds, or which constraint of ``problem`` it breaks.

    Checked are shape, finiteness and bounds; equality and inequality rows where an excess over a
    bound, within the tolerance, has been cut off.
    """
    if x is None:
        return "no result"
    if x.shape != (problem.n,):
        return f"a result of shape {x.shape} for {problem.n} unknowns"
    if not math.isfinite(sum(x.tolist())):
        return "a result that is not finite"
    point = Point.at(problem, x)
    excess, equality = largest(x - point.x), largest(point.equality)
    if excess > BOUND_TOLERANCE * point.size:
        return f"a bound exceeded by {excess:.2e}"
    if not equality <= EQUALITY_TOLERANCE and not (
        equality <= EQUALITY_TOLERANCE * (1.0 + largest(problem.b))
    ):
        return f"an equality residual of {equality:.2e}"
    if len(point.room) and not -point.room.min() <= BOUND_TOLERANCE * point.size:
        return f"an inequality row exceeded by {-point.room.min():.2e}"
    return point


def proof_of_optimality(
    problem: QuadraticProgram, point: Point, claimed: Multipliers
) -> Multipliers | str:
    r"""Multipliers that prove a feasible point x optimal, or what is wrong with it.

    .. math::

        \mathbf H x + \mathbf c + \mathbf A^T y + \mathbf G^T\lambda + \mu = 0, \quad
        \lambda \ge 0,\; \lambda^T(\mathbf G x - \mathbf g) = 0,\;
        \mu_i \text{ of the sign of the bound that } x_i \text{ touches}

    The backend's multipliers are tried first. Where they prove nothing, which says little about x,
    the best ones are found by non-negative least squares (Lawson and Hanson 1974).
    """
    gradient = problem.H @ point.x + problem.c
    # A multiplier of the wrong sign, or of what x does not touch, counts as none.
    y, rows, box = claimed
    if len(rows):
        rows = np.where(_touched_rows(problem, point, _TOUCHING) & (rows > 0.0), rows, 0.0)
    room = np.where(box > 0.0, point.below, point.above)
    with np.errstate(over="ignore", invalid="ignore"):  # a claim may be anything
        multipliers = Multipliers(y, rows, box * (room <= _TOUCHING * point.size))
        excess = _excess(problem, point, gradient, multipliers)
    for close in (_ON, _TOUCHING):
        if excess <= 1.0:
            return multipliers
        multipliers = _best(problem, point, gradient, close)
        excess = _excess(problem, point, gradient, multipliers)
    if excess > 1.0:
        gradient, multipliers = _with_more_digits(problem, point, multipliers)
        excess = min(excess, _excess(problem, point, gradient, multipliers))
    if excess <= 1.0:
        return Multipliers(*(values.astype(np.float64) for values in multipliers))
    return f"a point that is not optimal ({excess:.1e} times the tolerance)"


def _touched_rows(problem: QuadraticProgram, point: Point, close: float) -> Mask:
    """Which rows of G a point touches, (k,)."""
    touched: Mask = point.room <= close * point.size * (1.0 + np.abs(problem.G).sum(axis=1))
    return touched


def _excess(
    problem: QuadraticProgram, point: Point, gradient: Array, multipliers: Multipliers
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
    y, lam, box = multipliers
    pull, push = problem.A.T @ y, problem.G.T @ lam if len(lam) else 0.0 * box
    residual = gradient + pull + push + box
    steepest, reach = max(problem.steepest, 1e-300), point.size
    cost = (steepest * reach + problem.pull) * reach
    gain = lost = 0.0
    on = box.nonzero()[0]
    if len(on):
        gain = float(np.abs(box[on]) @ np.where(box > 0.0, point.below, point.above)[on])
    # Of a singular H the gap says nothing.
    inverse, singular = dgesv(problem.H, residual.astype(np.float64))[2:]
    gap = gain - float(y @ point.equality)
    if not singular:
        gap += 0.5 * float(residual @ inverse)
    on = lam.nonzero()[0]
    if len(on):
        weights, room = lam[on], point.room[on]
        gain += float(weights @ np.maximum(room, 0.0))
        gap += float(weights @ room)
        terms_of_rows = np.abs(problem.g[on]) + np.abs(problem.G[on]) @ np.abs(point.x)
        lost = ROUNDING * float(weights @ terms_of_rows)
    slope, allowed = largest(residual), OPTIMALITY_TOLERANCE * steepest * reach
    if slope > allowed:
        allowed += ROUNDING * max(map(largest, (problem.c, pull, push, box)))
    ratios = (
        slope / allowed,
        gain / (GAIN_TOLERANCE * cost + lost),
        gap / (GAP_TOLERANCE * cost + lost),
    )
    return max(ratios) if all(map(math.isfinite, ratios)) else math.inf


def _with_more_digits(
    problem: QuadraticProgram, point: Point, multipliers: Multipliers
) -> tuple[Any, Multipliers]:
    """The gradient, and multipliers that leave less of it, in the longest numbers of the machine.

    At the tip of a narrow wedge multipliers are so much larger than the gradient that their sum
    loses it.
    """
    longest: Any = [values.astype(np.longdouble) for values in multipliers]
    y, rows, box = longest
    on, held = rows.nonzero()[0], box.nonzero()[0]
    columns = np.vstack([problem.A, problem.G[on], np.eye(problem.n)[held]])
    gradient = problem.H @ point.x.astype(np.longdouble) + problem.c
    for _ in range(2):
        values = np.concatenate([y, rows[on], box[held]])
        left = (gradient + columns.T @ values).astype(np.float64)
        values -= np.linalg.lstsq(columns.T, left, rcond=None)[0]
        y, rows[on], box[held] = np.split(values, [len(y), len(y) + len(on)])
    # A multiplier that has changed its sign counts as none.
    return gradient, Multipliers(
        y, np.maximum(rows, 0.0), np.where(box * multipliers.box > 0.0, box, 0.0)
    )


def _best(problem: QuadraticProgram, point: Point, gradient: Array, close: float) -> Multipliers:
    """The multipliers, of what a point touches, that leave the least of the gradient."""
    identity, on = np.eye(problem.n), _touched_rows(problem, point, close)
    upper, lower = point.below <= close * point.size, point.above <= close * point.size
    columns = np.vstack([problem.A, -problem.A, problem.G[on], identity[upper], -identity[lower]])
    if not len(columns):
        return Multipliers.none(problem)  # and scipy's nnls aborts the process without columns
    from scipy.optimize import nnls  # imported on demand: 0.2 s

    lengths = np.linalg.norm(columns, axis=1)
    lengths[lengths == 0.0] = 1.0
    try:
        values = nnls((columns / lengths[:, None]).T, -gradient)[0] / lengths
    except RuntimeError:  # too many iterations: nothing is proven
        return Multipliers.none(problem)
    m = len(problem.b)
    plus, minus, pushing, above, below = np.split(
        values, np.cumsum([m, m, int(on.sum()), int(upper.sum())])
    )
    rows, box = np.zeros(len(problem.g)), np.zeros(problem.n)
    rows[on] = pushing
    box[upper] += above
    box[lower] -= below
    return Multipliers(plus - minus, rows, box)
