"""Solve a program by a backend and verify the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.backend import solve_raw
from qp_twist.qp.levels import Cascade
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import Multipliers, feasible, proof_of_optimality


class Verified(NamedTuple):
    """A result that satisfies the problem and is optimal."""

    x: Array
    """The unknowns, inside the bounds to the last bit, (n,)."""
    solver: str
    multipliers: Multipliers
    """Those that prove it optimal."""


class Refused(NamedTuple):
    """The backend gave no result that satisfies the problem."""

    says: str
    """What was tried, and what it returned."""
    claimed: bool
    """Whether the backend called its result solved."""


def solve(
    problem: QuadraticProgram, solver: str, options: Mapping[str, Any] | None = None
) -> Verified | Refused:
    """Solve with a backend, whose ``options`` take the place of ours, and verify."""
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
    other by rounding, and z = 0 satisfies it. The multipliers are those of C z ≤ d.
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
    return result._replace(x=moved.x)
