"""Newton's corrections onto a path and descents of z along it, to be read: the kernel's oracle.

The same rules in NumPy, for one configuration at a time: steps of least norm, damped where they
would move a joint far; where they do not converge but come near, Levenberg's and Marquardt's method
for the least error.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows, newton

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

WILD = 10.0
"""Largest joint displacement of a step, rad or m, before it is damped more."""


def corrected(rows: PathRows, q: Array, at: Indices) -> tuple[Array, Mask]:
    """Configurations corrected onto the waypoints ``at``, (K, nv); which of them arrive, (K,)."""
    found = [_corrected(rows, here, k) for here, k in zip(q, at, strict=True)]
    return np.array([there for there, _ in found]), np.array([arrived for _, arrived in found])


def descended(
    rows: PathRows,
    q: Array,
    at: Indices,
    ranges: JointRanges,
    *,
    rounds: int,
    longest: float,
    settled: float,
) -> Array:
    """Gauss and Newton's steps of z along what the rows leave free; NaN where it fails."""
    low = np.full(q.shape, np.nan)
    for k, (begin, waypoint) in enumerate(zip(q, at, strict=True)):
        here, arrived = _corrected(rows, begin, waypoint)
        share = 1.0
        for _ in range(rounds if arrived else 0):
            A, _ = _rows_at(rows, here, waypoint)
            free = _null_space(A)
            if not free.shape[1]:
                break
            weighted, away = ranges.weight[:, None] * free, ranges.weight * (ranges.middle - here)
            gram = weighted.T @ weighted + 1e-12 * np.eye(free.shape[1])
            step = share * (free @ np.linalg.solve(gram, weighted.T @ away))
            there, on = _corrected(rows, _towards(here, step, longest), waypoint)
            gained = ranges.centring(here) - ranges.centring(there) if on else -1.0
            expected = step @ (ranges.weight * away)
            if gained > 0.0:
                here = there
            elif gained < 0.0:
                share *= 0.4
            if expected <= settled or share <= 0.01:
                break
        if arrived:
            low[k] = here
    return low


def _corrected(rows: PathRows, q: Array, at: int) -> tuple[Array, bool]:
    iterations, on_task, longest, rounding, near, _, _ = newton()
    nearest, least = q, np.inf
    for _ in range(iterations):
        A, b = _rows_at(rows, q, at)
        if (size := np.linalg.norm(b)) <= on_task:
            return q, True
        if size < least:
            nearest, least = q, size
        for damping in rounding * 100.0 ** np.arange(6):
            step = _damped(A, b, damping)
            if np.abs(step).max() <= WILD:
                break
        q = _towards(q, step, longest)
    return (q, False) if least > near else _least_errors(rows, nearest, at)


def _least_errors(rows: PathRows, q: Array, at: int) -> tuple[Array, bool]:
    """The least error near q, and whether it is within the tolerances of a check."""
    iterations, on_task, longest, _, _, linear, angular = newton()
    damping = 1e-8
    for _ in range(2 * iterations):
        A, b = _rows_at(rows, q, at)
        before = np.linalg.norm(b)
        there = _towards(q, _damped(A, b, damping), longest)
        gained = before - np.linalg.norm(_rows_at(rows, there, at)[1])
        if gained > 0.0:
            q, damping = there, max(0.1 * damping, 1e-8)
            if gained <= 0.01 * before:
                break
        elif damping > 1.0:
            break
        else:
            damping *= 10.0
    b = _rows_at(rows, q, at)[1]
    projector = rows._projectors[rows._which[at]]
    parts = np.split(b, [projector.linear.rank, projector.rank])
    allowed = (linear, angular, on_task)
    kept = [np.linalg.norm(part) <= most for part, most in zip(parts, allowed, strict=True)]
    return q, all(kept)


def _rows_at(rows: PathRows, q: Array, at: int) -> tuple[Array, Array]:
    """The rows A (r, nv) and their errors b (r,)."""
    [(_, A, b)] = rows._groups(q[None], np.array([at]))
    return A[0], b[0]


def _damped(A: Array, b: Array, damping: float) -> Array:
    """Aᵀ(AAᵀ + λ1)⁻¹b, λ a share of the trace, by singular values."""
    U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    step: Array = Vt.T @ (sigma / (sigma**2 + damping * (sigma @ sigma)) * (U.T @ b))
    return step


def _null_space(A: Array) -> Array:
    """Orthonormal columns, (nv, nv − r), also where the rows depend on each other."""
    return np.linalg.qr(A.T, mode="complete").Q[:, len(A) :]


def _towards(q: Array, step: Array, longest: float) -> Array:
    """q + step, shortened to ``longest`` in every joint."""
    return q + step * (longest / np.abs(step).max(initial=longest))
