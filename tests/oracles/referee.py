"""An independent check of a quadratic program's result: feasible by arithmetic, optimal by duality.

Any multipliers give a lower bound of the optimum (weak duality), so that a bad reference can refuse
a good result but never pass a bad one. Nothing here comes from the package's own verification.
"""

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import qpsolvers
from scipy.optimize import lsq_linear

from qp_twist import QuadraticProgram

Array = npt.NDArray[np.float64]
Multipliers = tuple[Array, Array, Array]

EQUALITY = 1e-8
"""Largest |A x − b|, relative to 1 + max |b|; m/s and rad/s."""
INEQUALITY = 1e-8
"""Largest excess over G x ≤ g, relative to 1 + max |x|; bounds hold to the last bit."""
GAP = 1e-6
"""Largest gap between the objective and its lower bound, relative to the size of the objective."""
REFERENCES: dict[str, dict[str, Any]] = {
    "piqp": {"eps_abs": 1e-13, "eps_rel": 0.0},
    "clarabel": {"tol_feas": 1e-13, "tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13},
}


def broken_constraint(p: QuadraticProgram, x: Array) -> str:
    """What a result breaks, in words; empty if nothing."""
    if x.shape != p.c.shape or not np.isfinite(x).all():
        return "not a finite vector"
    if (x < p.lower).any() or (x > p.upper).any():
        return "outside the bounds"
    equality = np.abs(p.A @ x - p.b).max(initial=0.0) / (1.0 + np.abs(p.b).max(initial=0.0))
    if equality > EQUALITY:
        return f"equality rows missed by {equality:.1e}"
    excess = (p.G @ x - p.g).max(initial=0.0) / (1.0 + np.abs(x).max())
    if excess > INEQUALITY:
        return f"inequality rows exceeded by {excess:.1e}"
    return ""


def lower_bound(p: QuadraticProgram, multipliers: Multipliers) -> float:
    """The dual objective: no point that satisfies the constraints has a lower cost."""
    y, rows, box = multipliers
    rows = np.maximum(rows, 0.0)
    box = np.where(box > 0.0, np.where(p.upper < np.inf, box, 0.0), box)
    box = np.where(box < 0.0, np.where(p.lower > -np.inf, box, 0.0), box)
    r = p.c + p.A.T @ y + p.G.T @ rows + box
    at_box = np.where(box > 0.0, p.upper, np.where(box < 0.0, p.lower, 0.0))
    values = [-0.5 * r @ np.linalg.solve(p.H, r), *(-p.b * y), *(-p.g * rows), *(-box * at_box)]
    # What the sum may have lost by rounding is given away, or the bound would not be one.
    return float(np.sum(values) - 1e-15 * np.abs(values).sum())


def objective(p: QuadraticProgram, x: Array) -> float:
    return float(0.5 * x @ p.H @ x + p.c @ x)


def objective_size(p: QuadraticProgram, x: Array) -> float:
    length = 1.0 + float(np.linalg.norm(x))
    return float(np.linalg.norm(p.H, 2) * length**2 + np.linalg.norm(p.c) * length)


class LowerBound:
    """The best lower bound of a problem's optimum, sought no further than a result needs."""

    def __init__(self, problem: QuadraticProgram) -> None:
        self.problem = problem
        self.best = -np.inf
        self.sources: Iterator[Callable[[], Multipliers]] = iter(
            [lambda name=name: reference(problem, name) for name in REFERENCES]
        )

    def gap(self, x: Array) -> float:
        """Of a point, relative to the size of the objective."""
        p = self.problem
        size = objective_size(p, x)
        while (objective(p, x) - self.best) / size > GAP:
            source = next(self.sources, None)
            if source is None:
                self.best = max(self.best, lower_bound(p, at(p, x)))
                break
            self.best = max(self.best, lower_bound(p, source()))
        return (objective(p, x) - self.best) / size


def reference(p: QuadraticProgram, name: str) -> Multipliers:
    """The multipliers of an interior-point method, on rows of length one."""
    size = np.abs(p.H).max()
    lengths = [np.linalg.norm(rows, axis=1) for rows in (p.A, p.G)]
    a, g = (np.where(length > 0.0, length, 1.0) for length in lengths)
    none = (np.zeros(len(p.b)), np.zeros(len(p.g)), np.zeros(p.n))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            solution = qpsolvers.solve_problem(
                qpsolvers.Problem(
                    p.H / size,
                    p.c / size,
                    p.G / g[:, None] if len(g) else None,
                    p.g / g if len(g) else None,
                    p.A / a[:, None] if len(a) else None,
                    p.b / a if len(a) else None,
                    p.lower,
                    p.upper,
                ),
                name,
                **REFERENCES[name],
            )
        except Exception:
            return none
    if solution.x is None or not np.isfinite(solution.x).all():
        return none
    parts = []
    for value, empty in zip((solution.y, solution.z, solution.z_box), none, strict=True):
        usable = value is not None and len(value) == len(empty) and np.isfinite(value).all()
        parts.append(size * np.array(value) if usable else empty)
    return parts[0] / a, parts[1] / g, parts[2]


def at(p: QuadraticProgram, x: Array) -> Multipliers:
    """Multipliers that explain the gradient at a point, by bounded least squares."""
    close = 1e-5 * (1.0 + np.abs(x).max())
    lengths = np.linalg.norm(p.G, axis=1)
    touching = p.G @ x >= p.g - close * np.maximum(lengths, 1e-300)
    up, down = x >= p.upper - close, x <= p.lower + close
    identity = np.eye(p.n)
    columns = np.vstack([p.A, p.G[touching], identity[up], -identity[down]])
    m = len(p.b)
    y, rows, box = np.zeros(m), np.zeros(len(p.g)), np.zeros(p.n)
    if len(columns):
        scale = np.linalg.norm(columns, axis=1)
        scale[scale == 0.0] = 1.0
        low = np.concatenate([np.full(m, -np.inf), np.zeros(len(columns) - m)])
        found = lsq_linear(
            (columns / scale[:, None]).T, -(p.H @ x + p.c), (low, np.inf), method="bvls",
            tol=1e-15, lsq_solver="exact",
        ).x / scale  # fmt: skip
        k = int(touching.sum())
        y, rows[touching] = found[:m], found[m : m + k]
        box[up] += found[m + k : m + k + up.sum()]
        box[down] -= found[m + k + up.sum() :]
    return y, rows, box
