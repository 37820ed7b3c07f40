"""Solve a program by a backend and verify the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.backend import solve_raw
from qp_twist.qp.levels import Cascade
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import Multipliers, feasible, proof_of_optimality


@dataclass(frozen=True, eq=False)
class Verified:
    """A result that satisfies the problem and is optimal.

    Attributes:
        x: The unknowns, inside the bounds to the last bit, (n,).
        solver: The backend that gave it.
        multipliers: The multipliers that prove it optimal.
    """

    x: Array
    solver: str
    multipliers: Multipliers


@dataclass(frozen=True)
class Refused:
    """The backend gave no result that satisfies the problem.

    Attributes:
        says: What was tried, and what it returned.
        claimed: Whether the backend called its result solved.
    """

    says: str
    claimed: bool


def solve(
    problem: QuadraticProgram, solver: str, options: Mapping[str, Any] | None = None
) -> Verified | Refused:
    """Solve with a backend and verify.

    Args:
        problem: The program.
        solver: The backend.
        options: Of the backend, in place of ours.
    """
    if np.count_nonzero(problem.lower > problem.upper):
        return Refused("the bounds leave no room", False)
    raw = solve_raw(problem, solver, options)
    if not raw.found:
        return Refused(f"{solver} returned no solution", False)
    point = feasible(problem, raw.x)
    if isinstance(point, str):
        return Refused(f"{solver} returned {point}", True)
    proof = proof_of_optimality(problem, point, raw.multipliers)
    if isinstance(proof, str):
        return Refused(f"{solver} returned {proof}", True)
    return Verified(point.x, solver, proof)


def solve_within(problem: QuadraticProgram, cascade: Cascade, solver: str) -> Verified | Refused:
    r"""Minimise the cost of ``problem`` on the points that a cascade of levels has left.

    They are x + N z with C z ≤ d. The program in z has no equality rows that could contradict each
    other by rounding, and z = 0 satisfies it.

    Args:
        problem: The program; of it the cost counts, and the bounds, which are the cascade's.
        cascade: What the levels have left.
        solver: The backend.

    Returns:
        The result, with the multipliers of C z ≤ d.
    """
    if not cascade.optimal:
        return Refused("a priority level ran out of iterations", False)
    x, basis = cascade.x, cascade.basis
    within = replace(problem, A=problem.A[:0], b=problem.b[:0], G=cascade.G, g=cascade.g)
    if basis.shape[1] == 0:
        return Verified(x, "levels", Multipliers.none(within))
    C, d, *_ = cascade.rows()
    H, c = basis.T @ problem.H @ basis, basis.T @ (problem.H @ x + problem.c)
    result = solve(QuadraticProgram.free(0.5 * (H + H.T), c, C, d), solver)
    if isinstance(result, Refused):
        return result
    moved = feasible(within, np.clip(x + basis @ result.x, problem.lower, problem.upper))
    if isinstance(moved, str):
        return Refused(f"{result.solver} returned {moved}", True)
    return replace(result, x=moved.x)
