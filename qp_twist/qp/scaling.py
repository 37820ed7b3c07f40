"""The largest part of a task that fits inside the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from qp_twist.checks import Array
from qp_twist.qp.active_set import (
    RANK_TOLERANCE,
    constrained_least_squares,
    null_basis,
)
from qp_twist.qp.problem import QuadraticProgram

SCALE_BACKOFF = 1e-8
"""Share of a scaled task that is given up, so that the scaled rows are not on the very edge."""


@dataclass(frozen=True, eq=False)
class LargestScale:
    """The optimum of the scaling program.

    Attributes:
        scale: s in [0, 1].
        x: A point that reaches it, (n,).
        box_multipliers: How much s gains per unit of room at each bound; positive at an upper one,
            negative at a lower one, (n,).
        row_multipliers: The same for G x ≤ g, non-negative, (k,).
    """

    scale: float
    x: Array
    box_multipliers: Array
    row_multipliers: Array


def largest_scale(problem: QuadraticProgram) -> LargestScale | None:
    r"""The linear program for the design's s.

    .. math::

        \max_{x,\,s} s \quad\text{s.t.}\quad \mathbf A x = s\,\mathbf b,\;
        \mathbf G x \le \mathbf g,\; lower \le x \le upper,\; 0 \le s \le 1

    Where standing still is allowed, the active-set method of the priority levels finds it from
    there, as the s closest to 1; otherwise HiGHS (scipy). ``None`` where not even s = 0 has a
    solution.
    """
    return _from_standstill(problem) or _by_linear_program(problem)


def _from_standstill(problem: QuadraticProgram) -> LargestScale | None:
    """The optimum from x = 0, s = 0, if that is feasible."""
    n, speed = problem.n, float(np.abs(problem.b).max(initial=0.0))
    standing = (problem.lower <= 0.0).all() and (problem.upper >= 0.0).all()
    if not standing or (problem.g < 0.0).any() or not 0.0 < speed < np.inf:
        return None
    # A x = s b with unit rows, s in units of speed: one null space for both.
    rows = np.column_stack([problem.A, -problem.b / speed])
    length = np.linalg.norm(rows, axis=1)
    basis = null_basis(rows[length > 0.0] / length[length > 0.0, None], n + 1)
    matrix = np.vstack([np.eye(n + 1)[:n], -np.eye(n + 1)[:n], np.pad(problem.G, ((0, 0), (0, 1)))])
    room = np.concatenate([problem.upper, -problem.lower, problem.g])
    reduced = matrix @ basis
    size = np.linalg.norm(reduced, axis=1)
    keep = np.isfinite(room) & (size > RANK_TOLERANCE * np.linalg.norm(matrix, axis=1))
    found = constrained_least_squares(
        basis[n:],
        np.array([speed]),
        reduced[keep] / size[keep, None],
        room[keep] / size[keep],
        np.zeros(basis.shape[1]),
        smallest=RANK_TOLERANCE,
    )
    if not found.optimal:
        return None
    point = basis @ found.z
    scale = max(0.0, float(point[n]) / speed)
    multipliers = np.zeros(len(room))
    if scale < 1.0 - 1e-12:
        # The gradient of the distance ½(s − 1)² is (s − 1) times that of s.
        multipliers[keep] = found.multipliers / size[keep] / (speed - point[n]) / speed
    else:
        scale = 1.0
    return LargestScale(
        scale=scale,
        x=point[:n],
        box_multipliers=multipliers[:n] - multipliers[n : 2 * n],
        row_multipliers=multipliers[2 * n :],
    )


def _by_linear_program(problem: QuadraticProgram) -> LargestScale | None:
    """The optimum by HiGHS."""
    n = problem.n
    cost = np.zeros(n + 1)
    cost[-1] = -1.0
    result = linprog(
        cost,
        A_eq=np.column_stack([problem.A, -problem.b]) if len(problem.b) else None,
        b_eq=np.zeros(len(problem.b)) if len(problem.b) else None,
        A_ub=np.column_stack([problem.G, np.zeros(len(problem.g))]) if len(problem.g) else None,
        b_ub=problem.g if len(problem.g) else None,
        bounds=np.column_stack([np.append(problem.lower, 0.0), np.append(problem.upper, 1.0)]),
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if result.status != 0:
        return None
    rows = -result.ineqlin.marginals if len(problem.g) else np.zeros(0)
    return LargestScale(
        scale=min(1.0, max(0.0, float(result.x[-1]))),
        x=np.asarray(result.x[:-1]),
        # HiGHS' marginals are d(−s)/d(bound); room at a lower bound is gained by lowering it.
        box_multipliers=-np.asarray(result.upper.marginals[:-1])
        - np.asarray(result.lower.marginals[:-1]),
        row_multipliers=np.asarray(rows),
    )
