"""The program behind ``qt.solve_ik``: what is called solved is the optimum, by other solvers."""

from __future__ import annotations

from typing import Any

import mink
import numpy as np
import pytest
import qpsolvers

from qp_twist.constraints import Box, LimitRows
from qp_twist.control.compiled_program import CompiledProgram
from qp_twist.control.mink_costs import WeightedRows

DT = 0.01
UNNAMED: Any = None


class Drawn:
    """A random program: costs of some ranks, rows that may depend on each other, bounds, cuts."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        n = self.n = int(rng.integers(1, 15))
        self.costs = [
            WeightedRows(rng.normal(size=(k, n)), 0.05 * rng.normal(size=k), 0.0)
            for k in rng.integers(1, 8, size=rng.integers(1, 4))
        ]
        self.damping = float(10.0 ** rng.choice([-9.0, -6.0, -3.0]))
        self.A = rng.normal(size=(int(rng.integers(0, min(n, 6))), n))
        if len(self.A) > 1 and rng.random() < 0.3:
            self.A[-1] = self.A[:-1].T @ rng.normal(size=len(self.A) - 1)
        inside = rng.normal(size=n)
        self.b = self.A @ inside
        width = np.abs(rng.normal(size=n)) * 10.0 ** rng.uniform(-2.0, 2.0)
        self.lower, self.upper = np.minimum(-width, inside), np.maximum(width, inside)
        self.upper[rng.random(n) < 0.2] = np.inf
        self.G = rng.normal(size=(int(rng.integers(0, 20)), n)) * (rng.random(n) < 0.7)
        self.h = (self.G @ inside + np.abs(rng.normal(size=len(self.G)))) * DT

    def laid_down(self) -> CompiledProgram:
        program = CompiledProgram.of(self.n)
        program.begin()
        program.add_costs(self.costs, self.damping)
        program.add_equality(self.A, self.b)
        program.add_box(Box("velocity", self.lower, self.upper))
        program.add_rows(LimitRows(mink.CollisionAvoidanceLimit, self.G, self.h), DT)  # type: ignore[arg-type]
        return program

    def stated(self) -> qpsolvers.Problem:
        """On velocities, from the same numbers."""
        W = np.vstack([cost.rows for cost in self.costs])
        e = np.concatenate([cost.error for cost in self.costs])
        return qpsolvers.Problem(
            W.T @ W + self.damping * np.eye(self.n), -W.T @ e / DT, self.G, self.h / DT,
            self.A, self.b, self.lower, self.upper,
        )  # fmt: skip


def optimum(problem: qpsolvers.Problem) -> np.ndarray:
    # Of rows that depend on each other an interior-point method needs a basis.
    left, sigma, right = np.linalg.svd(problem.A, full_matrices=False)
    keep = sigma > 1e-9 * max(1.0, sigma.max(initial=0.0))
    A, b = right[keep], (left.T @ problem.b)[keep] / sigma[keep]
    posed = qpsolvers.Problem(
        problem.P, problem.q, problem.G, problem.h, A if len(b) else None, b if len(b) else None,
        problem.lb, problem.ub,
    )  # fmt: skip
    for tolerance in (1e-11, 1e-9):
        tight = {"tol_feas": tolerance, "tol_gap_abs": tolerance, "tol_gap_rel": tolerance}
        found = qpsolvers.solve_problem(posed, solver="clarabel", **tight)
        if found.found and found.x is not None:
            return found.x
    raise AssertionError("the oracle found no optimum")


@pytest.mark.filterwarnings("ignore::qpsolvers.warnings.SparseConversionWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_solved_program_is_at_its_optimum_and_nearly_all_are_solved() -> None:
    solved = 0
    for seed in range(150):
        drawn = Drawn(seed)
        program = drawn.laid_down()
        if not program.solve(DT, 0.0):
            continue
        solved += 1
        x, stated = program.velocity.copy(), drawn.stated()
        size = 1.0 + np.abs(x).max()
        assert (x >= drawn.lower).all()
        assert (x <= drawn.upper).all()
        assert (stated.G @ x <= stated.h + 1e-8 * size).all()
        assert (
            np.abs(stated.A @ x - stated.b) <= 1e-8 * (1.0 + np.abs(stated.b).max(initial=0.0))
        ).all()
        best = optimum(stated)
        values = [0.5 * v @ stated.P @ v + stated.q @ v for v in (x, best)]
        hardest = np.abs(stated.P).max() * size**2 + np.abs(stated.q).max() * size
        assert values[0] <= values[1] + 1e-6 * hardest
    assert solved >= 147


def test_programs_of_all_sizes_one_after_the_other_do_not_mix() -> None:
    """The same program again, after others of other sizes, to the last bit."""
    first = [Drawn(seed) for seed in range(40)]
    velocities = []
    for drawn in (*first, *reversed(first)):
        program = drawn.laid_down()
        program.solve(DT, 0.0)
        velocities.append(program.velocity.copy())
    for there, back in zip(velocities[:40], velocities[:39:-1], strict=True):
        np.testing.assert_array_equal(there, back)
