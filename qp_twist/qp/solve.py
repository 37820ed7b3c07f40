"""Solve a program by a backend and verify the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.backend import RawSolution, solve_raw
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
    result = verified(problem, solve_raw(problem, solver, options), solver)
    if not isinstance(result, str):
        return result
    return Refused(f"{solver} returned {result}", not result.startswith("no solution"))


def verified(problem: QuadraticProgram, raw: RawSolution, solver: str) -> Verified | str:
    """The result if it satisfies the problem and is optimal, else what is wrong with it."""
    if not raw.found:
        return "no solution"
    point = feasible(problem, raw.x)
    if isinstance(point, str):
        return point
    proof = proof_of_optimality(problem, point, raw.multipliers)
    return proof if isinstance(proof, str) else Verified(point.x, solver, proof)


def solve_within(problem: QuadraticProgram, cascade: Cascade, solver: str) -> Verified | Refused:
    r"""Minimise the cost of ``problem`` on the points that a cascade of levels has left.

    They are x + N z with C z ≤ d. The program in z has no equality rows that could contradict each
    other by rounding, and z = 0 satisfies it.

    Args:
        problem: The program; of it only the cost counts.
        cascade: What the levels have left.
        solver: The backend.

    Returns:
        The result, with the multipliers of C z ≤ d.
    """
    if not cascade.optimal:
        return Refused("a priority level ran out of iterations", False)
    x, basis = cascade.x, cascade.basis
    n, p = basis.shape
    held = QuadraticProgram(
        problem.H, problem.c, np.zeros((0, n)), np.zeros(0),
        cascade.G, cascade.g, cascade.lower, cascade.upper,
    )  # fmt: skip
    if p == 0:
        return Verified(x, "levels", Multipliers.none(held))
    C, d, *_ = cascade.rows()
    H = basis.T @ problem.H @ basis
    none = np.full(p, np.inf)
    reduced = QuadraticProgram(
        0.5 * (H + H.T), basis.T @ (problem.H @ x + problem.c), np.zeros((0, p)), np.zeros(0),
        C, d, -none, none,
    )  # fmt: skip
    result = solve(reduced, solver)
    if isinstance(result, Refused):
        return result
    moved = feasible(held, np.clip(x + basis @ result.x, cascade.lower, cascade.upper))
    if isinstance(moved, str):
        return Refused(f"{result.solver} returned {moved}", True)
    return replace(result, x=moved.x)
