"""Solve a program and trust nobody: verify, try the next backend, clip to the bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import qpsolvers

from qp_twist.checks import Array
from qp_twist.qp.backend import RawSolution, solve_raw
from qp_twist.qp.problem import QuadraticProgram
from qp_twist.qp.verification import complaint

FALLBACKS = ("daqp", "proxqp", "osqp")


@dataclass(frozen=True, eq=False)
class Verified:
    """A result that satisfies the problem.

    Attributes:
        x: The unknowns, inside the bounds to the last bit, (n,).
        solver: The backend that gave it.
        box_multipliers: Multipliers of the bounds, (n,).
        row_multipliers: Multipliers of G x ≤ g, (k,).
    """

    x: Array
    solver: str
    box_multipliers: Array
    row_multipliers: Array


@dataclass(frozen=True)
class Refused:
    """No backend gave a result that satisfies the problem.

    Attributes:
        says: For each backend tried, what it returned.
        claimed: Whether any of them called its result solved.
    """

    says: tuple[str, ...]
    claimed: bool


def solve(problem: QuadraticProgram, solver: str, *, fallbacks: bool = False) -> Verified | Refused:
    """Solve with ``solver`` and verify; with ``fallbacks`` ask the other backends after it."""
    others = [s for s in FALLBACKS if s != solver and s in qpsolvers.available_solvers]
    says, claimed = [], False
    for name in [solver, *(others if fallbacks else [])]:
        raw = solve_raw(problem, name)
        wrong = complaint(problem, raw.x) if raw.found else "no solution"
        if not wrong:
            return _verified(problem, raw, name)
        says.append(f"{name} returned {wrong}")
        claimed |= raw.found
    return Refused(tuple(says), claimed)


def _verified(problem: QuadraticProgram, raw: RawSolution, solver: str) -> Verified:
    assert raw.x is not None
    x = np.clip(raw.x, problem.lower, problem.upper)
    return Verified(x, solver, raw.box_multipliers, raw.row_multipliers)


def closest_rows(problem: QuadraticProgram, solver: str) -> Array | None:
    """The right-hand side A x that is closest to b inside the limits, (m,); ``None`` if none is."""
    # The small second term makes the point unique; its pull on A x is below the verification.
    hessian = problem.A.T @ problem.A + 1e-9 * np.eye(problem.n)
    least_squares = replace(
        problem,
        H=hessian,
        c=-problem.A.T @ problem.b,
        A=np.zeros((0, problem.n)),
        b=np.zeros(0),
    )
    result = solve(least_squares, solver, fallbacks=True)
    return problem.A @ result.x if isinstance(result, Verified) else None
