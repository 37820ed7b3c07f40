"""Random priority levels, and the textbook cascade of quadratic programs that solves them."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import qpsolvers
from scipy.optimize import lsq_linear

Array = npt.NDArray[np.float64]
Rows = tuple[Array, Array, Array, Array]
"""A x = b and G x ≤ g of one level."""

SOLVERS: dict[str, dict[str, float]] = {
    "piqp": {"eps_abs": 1e-12, "eps_rel": 0.0, "max_iter": 500},
    "clarabel": {"tol_feas": 1e-12, "tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13},
}


@dataclass
class Hierarchy:
    """Levels inside bounds."""

    levels: list[Rows]
    lower: Array
    upper: Array
    reference: Array


def random_hierarchy(seed: int, *, bounded: bool = True, inequalities: bool = True) -> Hierarchy:
    """2–4 levels on 3–30 unknowns: regular, rank-deficient, repeated or conflicting, at bounds.

    Every other hierarchy has inequality rows at some level; some unknowns are fixed or unbounded.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 31))
    levels: list[Rows] = []
    with_inequalities = inequalities and rng.random() < 0.5
    for _ in range(int(rng.integers(2, 5))):
        m = int(rng.integers(1, max(2, n // 2 + 1)))
        kind = rng.choice(["regular", "deficient", "repeated", "conflicting", "same"])
        A = rng.normal(size=(m, n))
        b = rng.normal(size=m) * 10.0 ** rng.uniform(-1.0, 1.0)
        if kind == "deficient" and m > 1:
            rank = int(rng.integers(1, m))
            A = rng.normal(size=(m, rank)) @ rng.normal(size=(rank, n))
        above = levels[-1] if levels else None
        if above is not None and len(above[0]):
            if kind == "repeated":  # some rows of the level above, scaled, other sides
                A[: max(1, m // 2)] = above[0][:1] * rng.normal()
            if kind == "conflicting":
                A, b = above[0].copy(), -above[1]
            if kind == "same":
                A, b = above[0].copy(), above[1].copy()
        G, g = np.zeros((0, n)), np.zeros(0)
        if with_inequalities and rng.random() < 0.6:
            k = int(rng.integers(1, n // 2 + 2))
            G = rng.normal(size=(k, n))
            g = rng.normal(size=k) + rng.choice([-1.0, 0.5, 2.0])
            if rng.random() < 0.3:
                A, b = np.zeros((0, n)), np.zeros(0)
        levels.append((A, b, G, g))
    lower, upper = -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    if rng.random() < 0.2:
        fixed = rng.random(n) < 0.2
        lower[fixed] = upper[fixed]
    if rng.random() < 0.2:
        lower[rng.random(n) < 0.3] = -np.inf
        upper[rng.random(n) < 0.3] = np.inf
    if not bounded:
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    return Hierarchy(levels, lower, upper, 0.3 * rng.normal(size=n))


def harder(seed: int, kind: str) -> Hierarchy:
    """The hierarchy of ``seed`` with rows of 1e-3 … 1e3, or with two rows at 1e-7 … 1e-2 rad."""
    rng = np.random.default_rng(seed)
    hierarchy = random_hierarchy(seed)
    for k, (A, b, G, g) in enumerate(hierarchy.levels):
        if kind == "stretched" and len(b):
            factor = 10.0 ** rng.uniform(-3.0, 3.0, len(b))
            hierarchy.levels[k] = (factor[:, None] * A, factor * b, G, g)
        if kind == "parallel" and len(b) > 1:
            near = A.copy()
            near[1] = A[0] + 10.0 ** rng.uniform(-7.0, -2.0) * rng.normal(size=A.shape[1])
            hierarchy.levels[k] = (near, b, G, g)
    return hierarchy


@dataclass
class Cascade:
    """What the oracle achieved, and how well its own conditions hold."""

    x: Array
    residuals: list[float] = field(default_factory=list)
    """Length of A x − b and of the part of G x above g, at each level when it was solved."""
    stationarity: float = 0.0
    """Largest gradient that no multiplier explains, at any level."""


def residual(level: Rows, x: Array) -> float:
    """Length of what is left of a level."""
    A, b, G, g = level
    return float(np.linalg.norm(np.concatenate([A @ x - b, np.maximum(G @ x - g, 0.0)])))


def cascade(hierarchy: Hierarchy, levels: Sequence[Rows]) -> Cascade:
    r"""Level after level, min ½‖A x − b‖² + ½‖w‖² with G x − w ≤ g, under what is held.

    Held are the rows A x of the levels above, as equalities on an orthonormal basis, and their
    rows G x ≤ max(g, G x*). Each program is solved by an interior-point method in (x, residual, w),
    so that no rows are squared, then again by least squares on the rows that it found active; the
    better of the two is kept, by the conditions of optimality.
    """
    n = len(hierarchy.lower)
    x = np.clip(np.zeros(n), hierarchy.lower, hierarchy.upper)
    V, C, d = np.zeros((0, n)), np.zeros((0, n)), np.zeros(0)
    result = Cascade(x)
    for A, b, G, g in levels:
        program = _Program(A, b, G, g, V, V @ x, C, d, hierarchy.lower, hierarchy.upper)
        best: tuple[float, Array] | None = None
        for solver in SOLVERS:
            if solver not in qpsolvers.available_solvers:
                continue
            start = _interior_point(solver, program)
            if start is None:
                continue
            for candidate in (_polished(start, program), start):
                if candidate is None:
                    continue
                wrong = _unexplained(candidate, program)
                if best is None or wrong < best[0]:
                    best = wrong, candidate
            if best is not None and best[0] < 1e-11:
                break
        assert best is not None, "no interior-point method solved a level"
        x = np.clip(best[1], hierarchy.lower, hierarchy.upper)
        result.stationarity = max(result.stationarity, best[0])
        result.residuals.append(residual((A, b, G, g), x))
        excess = G @ x - g
        V = _basis(np.vstack([V, A, G[excess > 1e-9]]))
        C, d = np.vstack([C, G]), np.concatenate([d, g + np.maximum(excess, 0.0)])
    result.x = x
    return result


class _Program(NamedTuple):
    """A level, what is held (V x = v, C x ≤ d) and the bounds."""

    A: Array
    b: Array
    G: Array
    g: Array
    V: Array
    v: Array
    C: Array
    d: Array
    lower: Array
    upper: Array


def _basis(rows: Array) -> Array:
    """Orthonormal basis of the row space."""
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > 0.0] / lengths[lengths > 0.0, None]
    _, sigma, right = np.linalg.svd(rows, full_matrices=False)
    return right[: int((sigma > 1e-9).sum())]


def _interior_point(solver: str, program: _Program) -> Array | None:
    A, b, G, g, V, v, C, d, lower, upper = program
    n, m, k = len(lower), len(b), len(g)
    H = np.diag(np.concatenate([np.zeros(n), np.ones(m + k)]))
    none = np.full(m + k, np.inf)
    equal = np.block([[A, -np.eye(m), np.zeros((m, k))], [V, np.zeros((len(V), m + k))]])
    below = np.block([[G, np.zeros((k, m)), -np.eye(k)], [C, np.zeros((len(C), m + k))]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = qpsolvers.solve_problem(
            qpsolvers.Problem(
                H, np.zeros(n + m + k),
                below if len(below) else None, np.concatenate([g, d]) if len(below) else None,
                equal if len(equal) else None, np.concatenate([b, v]) if len(equal) else None,
                np.concatenate([lower, -none]), np.concatenate([upper, none]),
            ), solver, **SOLVERS[solver],
        )  # fmt: skip
    if solution.x is None or not np.isfinite(solution.x).all():
        return None
    return np.array(solution.x[:n])


def _active(x: Array, program: _Program, close: float) -> tuple[Array, Array]:
    """Rows and right-hand sides of the bounds and rows that ``x`` touches."""
    *_, C, d, lower, upper = program
    identity = np.eye(len(x))
    up, down, on = x > upper - close, x < lower + close, C @ x > d - close
    return (
        np.vstack([identity[up], -identity[down], C[on]]),
        np.concatenate([upper[up], -lower[down], d[on]]),
    )


def _polished(x: Array, program: _Program) -> Array | None:
    """The least-squares solution on the rows that ``x`` touches, nearest to ``x``."""
    A, b, G, g, V, v, *_ = program
    rows, sides = _active(x, program, 1e-6)
    held, held_sides = np.vstack([V, rows]), np.concatenate([v, sides])
    moved = x + np.linalg.lstsq(held, held_sides - held @ x, rcond=1e-9)[0]
    _, sigma, right = np.linalg.svd(held) if len(held) else (0, np.zeros(0), np.eye(len(x)))
    N = right[int((sigma > 1e-9).sum()) :].T
    violated = G @ x > g - 1e-7
    unit, sides = np.vstack([A, G[violated]]), np.concatenate([b, g[violated]])
    if N.shape[1]:
        moved = moved + N @ np.linalg.lstsq(unit @ N, sides - unit @ moved, rcond=1e-10)[0]
    return moved if np.isfinite(moved).all() else None


def _unexplained(x: Array, program: _Program) -> float:
    """Largest of what breaks a constraint and of the gradient that no multiplier explains."""
    A, b, G, g, V, v, C, d, lower, upper = program
    broken = max(
        float(np.abs(V @ x - v).max(initial=0.0)),
        float((C @ x - d).max(initial=0.0)),
        float((lower - x).max(initial=0.0)),
        float((x - upper).max(initial=0.0)),
    )
    gradient = A.T @ (A @ x - b) + G.T @ np.maximum(G @ x - g, 0.0)
    rows, _ = _active(x, program, 1e-9)
    columns = np.vstack([V, rows])
    if len(columns):
        scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        low = np.concatenate([np.full(len(V), -np.inf), np.zeros(len(rows))])
        found = lsq_linear((columns / scale[:, None]).T, -gradient, (low, np.inf), method="bvls",
                           lsq_solver="exact", tol=1e-15, max_iter=500)  # fmt: skip
        gradient = gradient + (columns / scale[:, None]).T @ found.x
    size = 1.0 + float(np.linalg.norm(np.vstack([A, G]))) * (1.0 + float(np.abs(b).max(initial=0)))
    return max(broken, float(np.abs(gradient).max()) / size)
