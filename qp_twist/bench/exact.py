r"""The step's program, solved without rounding.

.. math:: \min_{\dot q}\ \tfrac12\lVert\dot q-\dot q_0\rVert^2 \quad\text{s.t.}\quad
    A\dot q=b,\quad G\dot q\le g,\quad l\le\dot q\le u

The numbers of a program are binary fractions, so that its solution is rational: for a given active
set, it is a linear system, solved here in integers of any length. A solver provides the initial
active set, which is corrected until the optimality conditions hold, compared as fractions without a
tolerance. So the result is exact even if the initial guess is wrong. If the corrections do not
terminate, the slower dual method of Goldfarb and Idnani (1983) is used, in fractions as well.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import qpsolvers

from qp_twist.bench.program import StepProgram
from qp_twist.checks import Array

_GUESS = 1e-7
"""Multipliers of the guess above this count as active; the exact conditions decide."""
_MENDINGS = 20
"""Number of corrections before the dual method is used."""


Row = list[Fraction]


class Dependent(ArithmeticError):
    """The rows of a system are linearly dependent."""


class NoExactSolution(ArithmeticError):
    """The program has no solution, or its equality rows are dependent."""


@dataclass(frozen=True, eq=False)
class ExactSolution:
    """The solution of a program.

    Attributes:
        velocity: q̇ rounded once, at the end, rad/s, (n,).
        active: Number of bounds and inequality rows with a multiplier above zero.
    """

    velocity: Array
    active: int


_Key = tuple[str, int, int]
"""("bound", joint, −1 lower or 1 upper) or ("row", i, 1)."""


def exact_solution(program: StepProgram) -> ExactSolution:
    """Solve a program exactly.

    Raises:
        NoExactSolution: If there is no solution, or the equality rows are dependent.
    """
    exact = _Exact(program)
    active = _guess(program) & set(exact.ends)
    try:
        for _ in range(_MENDINGS):
            velocity, multipliers = exact.held(active)
            wrong = {key for key, multiplier in multipliers.items() if multiplier < 0}
            beyond = {key for key in exact.ends if exact.beyond(key, velocity) > 0}
            if not wrong and not beyond:
                return _found(velocity, multipliers)
            active = (active - wrong) | beyond
    except Dependent:
        pass
    return _found(*exact.dual_method())


def _found(velocity: Row, multipliers: dict[_Key, Fraction]) -> ExactSolution:
    return ExactSolution(
        np.array([float(value) for value in velocity]), sum(m > 0 for m in multipliers.values())
    )


class _Exact:
    """A program as fractions; its inequalities as normal · q̇ ≤ end."""

    def __init__(self, program: StepProgram) -> None:
        self.desired = fractions(program.desired)
        self.A, self.b = [fractions(row) for row in program.A], fractions(program.b)
        self.G = [fractions(row) for row in program.G]
        self.ends: dict[_Key, Fraction] = {
            ("bound", joint, side): side * Fraction(float(limit[joint]))
            for side, limit in ((-1, program.lower), (1, program.upper))
            for joint in range(len(self.desired))
            if np.isfinite(limit[joint])
        }
        self.ends |= {("row", i, 1): end for i, end in enumerate(fractions(program.g))}

    def normal(self, key: _Key) -> Row:
        """The row of an inequality."""
        kind, index, side = key
        if kind == "row":
            return self.G[index]
        row = [Fraction()] * len(self.desired)
        row[index] = Fraction(side)
        return row

    def beyond(self, key: _Key, velocity: Row) -> Fraction:
        """Violation of an inequality by a velocity; negative inside."""
        kind, index, side = key
        value = dot(self.G[index], velocity) if kind == "row" else side * velocity[index]
        return value - self.ends[key]

    def held(self, active: set[_Key]) -> tuple[Row, dict[_Key, Fraction]]:
        """The optimal velocity with the active inequalities as equalities, and their multipliers.

        Active bounds are substituted instead of added as rows: the system stays as small as the
        task.
        """
        fixed = {i: side * self.ends[kind, i, side] for kind, i, side in active if kind == "bound"}
        chosen = [key for key in active if key[0] == "row"]
        rows = [*self.A, *(self.G[i] for _, i, _ in chosen)]
        ends = [*self.b, *(self.ends[key] for key in chosen)]
        begin = [fixed.get(i, desired) for i, desired in enumerate(self.desired)]
        free = [[v for i, v in enumerate(row) if i not in fixed] for row in rows]
        gram = [[dot(p, q) for q in free] for p in free]
        gaps = [end - dot(row, begin) for row, end in zip(rows, ends, strict=True)]
        y = solve_square(gram, gaps)
        moved = [dot(y, [row[i] for row in rows]) for i in range(len(self.desired))]
        velocity = [fixed[i] if i in fixed else begin[i] + moved[i] for i in range(len(begin))]
        multipliers: dict[_Key, Fraction] = {}
        for key in active:
            kind, i, side = key
            if kind == "bound":
                # Stationarity: q̇ − q̇₀ minus the rows' term is the multiplier of the bound.
                multipliers[key] = -side * (velocity[i] - self.desired[i] - moved[i])
        for key, multiplier in zip(chosen, y[len(self.b) :], strict=True):
            multipliers[key] = -multiplier
        return velocity, multipliers

    def dual_method(self) -> tuple[Row, dict[_Key, Fraction]]:
        """Goldfarb and Idnani's method: add violated inequalities one by one; the cost rises."""
        try:
            velocity, _ = self.held(set())
        except Dependent as error:
            raise NoExactSolution(f"exact_solution: {error}") from None
        multipliers: dict[_Key, Fraction] = {}
        while True:
            worst = max(self.ends, key=lambda key: self.beyond(key, velocity), default=None)
            if worst is None or self.beyond(worst, velocity) <= 0:
                return velocity, multipliers
            velocity = self._added(worst, velocity, multipliers)

    def _added(self, key: _Key, velocity: Row, multipliers: dict[_Key, Fraction]) -> Row:
        """The velocity with one more inequality active; others may be dropped for it."""
        normal, multiplier = self.normal(key), Fraction()
        while True:
            kept = list(multipliers)
            rows = [*self.A, *(self.normal(k) for k in kept)]
            gram = [[dot(p, q) for q in rows] for p in rows]
            share = solve_square(gram, [dot(row, normal) for row in rows])
            along = [
                v - dot(share, [row[i] for row in rows]) for i, v in enumerate(normal)
            ]  # the part of the normal orthogonal to the others
            room = dict(zip(kept, share[len(self.A) :], strict=True))
            drop = min(
                (k for k in kept if room[k] > 0),
                key=lambda k: multipliers[k] / room[k],
                default=None,
            )
            slope = dot(along, normal)
            full = self.beyond(key, velocity) / slope if slope else None
            step = multipliers[drop] / room[drop] if drop is not None else full
            if step is None:
                raise NoExactSolution("exact_solution: the constraints contradict each other.")
            if full is not None and full <= step:
                step, drop = full, None
            velocity = [v - step * d for v, d in zip(velocity, along, strict=True)]
            for k in kept:
                multipliers[k] -= step * room[k]
            multiplier += step
            if drop is None:
                multipliers[key] = multiplier
                return velocity
            del multipliers[drop]


def _guess(program: StepProgram) -> set[_Key]:
    """The active set of a floating-point solver."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about converted dense matrices
        solution = qpsolvers.solve_problem(program.posed(), solver="clarabel")
    if not solution.found:
        return set()
    active: set[_Key] = set()
    if solution.z_box is not None:
        for joint in np.flatnonzero(np.abs(solution.z_box) > _GUESS):
            active.add(("bound", int(joint), 1 if solution.z_box[joint] > 0 else -1))
    if solution.z is not None:
        active |= {("row", int(i), 1) for i in np.flatnonzero(solution.z > _GUESS)}
    return active


def fractions(values: Array) -> Row:
    """Convert floats to fractions, exactly."""
    return [Fraction(float(value)) for value in values]


def dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    """Σ aᵢ bᵢ."""
    return sum((p * q for p, q in zip(a, b, strict=True) if p and q), Fraction())


def solve_square(matrix: Sequence[Sequence[Fraction]], right: Sequence[Fraction]) -> Row:
    """The solution of a square system, by elimination with any nonzero pivot.

    Raises:
        Dependent: If the system is singular.
    """
    work = [[*row, end] for row, end in zip(matrix, right, strict=True)]
    size = len(work)
    for k in range(size):
        pivot = next((i for i in range(k, size) if work[i][k]), None)
        if pivot is None:
            raise Dependent("the rows depend on each other.")
        work[k], work[pivot] = work[pivot], work[k]
        for i in range(k + 1, size):
            if work[i][k]:
                share = work[i][k] / work[k][k]
                work[i][k:] = [p - share * q for p, q in zip(work[i][k:], work[k][k:], strict=True)]
    x = [Fraction()] * size
    for k in reversed(range(size)):
        x[k] = (work[k][size] - dot(work[k][k + 1 : size], x[k + 1 :])) / work[k][k]
    return x
