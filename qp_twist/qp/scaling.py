"""The largest part of a task that fits inside the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from qp_twist.checks import Array
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

    Solved by HiGHS (scipy). ``None`` where not even s = 0 has a solution.
    """
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
