r"""The program of a step that every contender with hard rows has to solve.

Its rows are computed from MuJoCo's Jacobian and the poses alone, as an independent reference: none
of the package's tasks, limits or controllers is used. Its solution is found by a method that no
contender uses: the equations are eliminated with an orthonormal basis N of their null space, and
what remains is the point nearest to the origin in a polyhedron, which non-negative least squares
finds in finitely many steps (LDP; Lawson and Hanson, *Solving Least Squares Problems*, 1974,
chapter 23). The multipliers are non-negative by construction; the point is then computed again from
the active inequalities, so that it is exact up to rounding.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from qp_twist.checks import Array
from qp_twist.geometry import Projector, ProjectorKind


class Variant(enum.Enum):
    """The variant of the program that a contender solves, for its error."""

    COMMON = "the program of the problem"
    UNLIMITED = "the same without limits"
    SHORTEST = "the same without limits, the desired velocity zero"
    OTHER = "another one, or none"


@dataclass(frozen=True, eq=False)
class StepProgram:
    r"""One step as arrays.

    .. math:: \min_{\dot q}\ \tfrac12\lVert\dot q-\dot q_0\rVert^2 \quad\text{s.t.}\quad
        A\dot q=b,\quad G\dot q\le g,\quad l\le\dot q\le u

    Attributes:
        desired: q̇₀, rad/s, (n,).
        A: UᵀJ, (r, n).
        b: UᵀΔt/dt, m/s and rad/s, (r,).
        G: Inequality rows, (m, n).
        g: Their right-hand sides, (m,).
        lower: l, rad/s, (n,).
        upper: u, (n,).
    """

    desired: Array
    A: Array
    b: Array
    G: Array
    g: Array
    lower: Array
    upper: Array

    def of(self, variant: Variant) -> StepProgram:
        """The program without its limits; for ``SHORTEST`` also without the desired velocity."""
        if variant is Variant.COMMON:
            return self
        free = np.full(len(self.desired), np.inf)
        desired = np.zeros_like(self.desired) if variant is Variant.SHORTEST else self.desired
        return replace(self, desired=desired, lower=-free, upper=free, G=self.G[:0], g=self.g[:0])

    def residual(self, velocity: Array) -> float:
        """‖A q̇ − b‖, m/s and rad/s."""
        return float(np.linalg.norm(self.A @ velocity - self.b))

    def excess(self, velocity: Array) -> float:
        """Largest violation of a bound or a row by q̇; 0 inside, rad/s."""
        beyond = [self.lower - velocity, velocity - self.upper, self.G @ velocity - self.g]
        return max(0.0, float(np.concatenate(beyond).max(initial=0.0)))


def basis(block: Projector, rotation: Array) -> Array:
    """Orthonormal columns (3, rank) of a block whose axis is fixed to a frame at ``rotation``."""
    if block.axis is None:
        return np.eye(3)[:, : block.rank]
    _, _, vectors = np.linalg.svd((rotation @ block.axis)[None])
    return vectors[1:].T if block.kind is ProjectorKind.PLANE else vectors[:1].T


def turn_error(block: Projector, here: Array, there: Array) -> Array:
    """Rotation error of a block, as a rotation vector in world axes, (3,).

    Full: the whole of R_e = R_d Rᵀ. A plane: the geodesic that takes the axis e to R_e e. A line:
    the turn about e that is in R_e.
    """
    between = there @ here.T
    if block.axis is None:
        return _rotation_vector(between) if block.rank else np.zeros(3)
    e = here @ block.axis
    if block.kind is ProjectorKind.PLANE:
        # Subtract first: exact for nearly equal vectors, unlike the product.
        across = np.cross(e, between @ e - e)
        sine = float(np.linalg.norm(across))
        return across * (math.atan2(sine, float(e @ between @ e)) / sine) if sine else across
    twice_sine = _twice_sine(between)
    # tan of half the turn about e, from the quaternion (1 + trace, twice_sine) / norm.
    turn: Array = 2.0 * math.atan2(float(e @ twice_sine), 1.0 + float(np.trace(between))) * e
    return turn


def _twice_sine(rotation: Array) -> Array:
    """The axis of a rotation times twice the sine of its angle, (3,)."""
    return np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )


def _rotation_vector(rotation: Array) -> Array:
    """Axis times angle of a rotation by less than π, (3,)."""
    twice_sine = _twice_sine(rotation)
    size = float(np.linalg.norm(twice_sine))
    angle = math.atan2(0.5 * size, 0.5 * (float(np.trace(rotation)) - 1.0))
    return twice_sine * (angle / size) if size else twice_sine


# ---------------------------------------------------------------- its solution

_INDEPENDENT = 1e-9
"""Smallest singular value of the equations, as a share of the largest one."""
_EMPTY = 1e-10
"""Residual of the non-negative least squares below which the inequalities exclude each other."""
_VERIFIED = 1e-11
"""Largest violation of the program, rad/s, relative to 1 + the largest number of the solution."""
_SAME = 1e-7
"""Largest difference, on the same scale, of the point computed again from that of the method."""


class NoReference(ArithmeticError):
    """The program has no solution, dependent equations, or none that could be verified."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The solution of a program.

    Attributes:
        velocity: q̇, rad/s, (n,).
        active: Number of bounds and inequality rows with a multiplier above zero.
    """

    velocity: Array
    active: int


def reference(program: StepProgram) -> Reference:
    """Solve a program, and verify that the solution satisfies it.

    Raises:
        NoReference: If there is no solution, or the equations are dependent.
    """
    n, r = len(program.desired), len(program.b)
    left, sigma, right = np.linalg.svd(program.A)
    if r and (r > n or sigma[-1] <= _INDEPENDENT * sigma[0]):
        raise NoReference("reference: the equations depend on each other.")
    particular = right[:r].T @ ((left.T @ program.b) / sigma)
    N = right[r:].T
    nearest = particular + N @ (N.T @ (program.desired - particular))
    C = np.vstack([program.G, np.eye(n), -np.eye(n)])
    d = np.concatenate([program.g, program.upper, -program.lower])
    C, d = C[np.isfinite(d)], d[np.isfinite(d)]
    # min ‖w‖ subject to rows w ≥ ends, for q̇ = nearest + N w.
    rows, ends = -C @ N, C @ nearest - d
    velocity, active, moved = nearest, np.zeros(0, dtype=int), 0.0
    if (ends > 0.0).any():
        goal = np.append(np.zeros(n - r), 1.0)
        dual, residual = nnls(np.vstack([rows.T, ends]), goal, maxiter=100 * len(ends))
        if residual <= _EMPTY:
            raise NoReference("reference: the constraints contradict each other.")
        active = np.flatnonzero(dual > 0.0)
        w = np.linalg.pinv(rows[active]) @ ends[active]
        velocity = nearest + N @ w
        moved = float(np.linalg.norm(w - rows.T @ dual / (1.0 - ends @ dual)))
    size = 1.0 + np.abs(velocity).max(initial=0.0)
    wrong = max(program.residual(velocity), program.excess(velocity))
    if wrong > _VERIFIED * size or moved > _SAME * size:
        raise NoReference(f"reference: the solution is off by {max(wrong, moved):.0e} rad/s.")
    return Reference(velocity, len(active))
