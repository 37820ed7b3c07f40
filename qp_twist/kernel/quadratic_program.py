"""Solve a quadratic program by the compiled method, from arrays to arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.kernel.dual_active_set import SOLVED, dual_active_set

Array = npt.NDArray[np.float64]
_solved: Any = dual_active_set


class ProgramSolution(NamedTuple):
    """A solution with its multipliers, named as in qpsolvers."""

    found: bool
    x: Array
    y: Array
    z: Array
    z_box: Array


def solve_program(
    H: Array, c: Array, A: Array, b: Array, G: Array, g: Array, lower: Array, upper: Array
) -> ProgramSolution:
    """Minimise ½xᵀHx + cᵀx subject to Ax = b, Gx ≤ g, lower ≤ x ≤ upper, from a cold start."""
    n, m, k = len(c), len(b), len(g)
    x, u, active = np.zeros(n), np.zeros(n + 1), np.zeros(n, dtype=np.int64)
    given = (np.ascontiguousarray(array) for array in (H, c, A, b, G, g, lower, upper))
    work = np.zeros((n, n)), np.zeros((n, n)), np.zeros(m + k + 2 * n, dtype=np.int64)
    status, count = _solved(*given, active, 0, x, u, *work, np.zeros((3, n + 1)), np.zeros(k))
    y, z, z_box = np.zeros(m), np.zeros(k), np.zeros(n)
    for number, multiplier in zip(active[:count], u[:count], strict=True):
        if number < m:
            y[number] = -multiplier
        elif number < m + k:
            z[number - m] = multiplier
        elif number < m + k + n:
            z_box[number - m - k] -= multiplier
        else:
            z_box[number - m - k - n] += multiplier
    return ProgramSolution(status == SOLVED, x, y, z, z_box)
