r"""The solution of a step's program by a method that no contender uses.

.. math:: \min_{\dot q}\ \tfrac12\lVert\dot q-\dot q_0\rVert^2 \quad\text{s.t.}\quad
    A\dot q=b,\quad G\dot q\le g,\quad l\le\dot q\le u

The equations are eliminated with an orthonormal basis N of their null space. What remains is the
point nearest to the origin in a polyhedron, which non-negative least squares finds in finitely many
steps (LDP; Lawson and Hanson, *Solving Least Squares Problems*, 1974, chapter 23). The multipliers
are non-negative by construction; the point is then computed again from the active inequalities, so
that it is exact up to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from qp_twist.bench.program import StepProgram
from qp_twist.checks import Array

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
