"""The quadratic program of mink tasks and limits, solved by the kernel."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array, are_floats
from qp_twist.constraints import Box, LimitRows, MinkRange, Named, RowsOf, kind_of
from qp_twist.constraints.any_limit import UNLIMITED
from qp_twist.control.lazy_step import LazyStep, StepLabels
from qp_twist.control.mink_costs import WeightedRows
from qp_twist.control.posing import STEEPEST
from qp_twist.control.step import Status
from qp_twist.control.step_tables import TOLERANCES
from qp_twist.kernel.compiling import bound
from qp_twist.kernel.gather_bounds_and_rows import (
    append_rows,
    narrow_box,
    narrow_to_range,
)
from qp_twist.kernel.program_step import (
    program_step,
    scaled_step,
)
from qp_twist.kernel.step_record import PROGRAM, Sizes
from qp_twist.kernel.verified_program import DONE, INFEASIBLE, SCALED

_MOST = 64
"""Number of program shapes for which arrays are kept."""
_FIRST = {"acceleration": 0.0, "position": 2000.0}
"""First number of each kind of bound, 1000 for other kinds: of equal bounds the lowest counts."""
_mine = threading.local()


class CompiledProgram:
    """Arrays in which programs of n unknowns are assembled, one after the other, and solved.

    Each thread has one object for each n and reuses it. So no code of a task or limit may run
    between :meth:`begin` and the last access to the result: it might compute a step itself.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        # Costs: W, e and their sums.
        self._weighted, self._errors = np.zeros((4 * n, n)), np.zeros(4 * n)
        self._H, self._c, self._lift = np.zeros((n, n)), np.zeros(n), 0.0
        # Constraints: A and b.
        self._A, self._b = np.zeros((n, n)), np.zeros(n)
        self._m = 0
        # Limits: bounds, rows, and the rows of one limit before they are checked.
        self._open = np.array([[-np.inf], [np.inf], [np.inf], [np.inf]]).repeat(n, axis=1)
        self._box, self._kinds = self._open.copy(), dict[float, str]()
        self._rows, self._ends = np.zeros((n, n)), np.zeros(n)
        self._which = np.zeros(n, dtype=np.intp)
        self._limit_rows, self._limit_ends = np.zeros((n, n)), np.zeros(n)
        self._sources = list[tuple[mink.Limit, int, int]]()
        self._k, self._is_valid = 0, True
        # Arrays by m and their capacity of inequality rows.
        self._kept: dict[tuple[int, int], _Arrays] = {}
        self._program_step: Callable[..., int] | None = None
        self._size, self._result = Sizes(n, 0, 0, 1, 0, 0, 0, 0), np.zeros(0)

    @classmethod
    def of(cls, n: int) -> CompiledProgram:
        """The object of this thread for n unknowns."""
        kept: dict[int, CompiledProgram] = _mine.__dict__.setdefault("kept", {})
        found = kept.get(n)
        if found is None:
            if len(kept) >= _MOST:
                kept.clear()
            found = kept[n] = cls(n)
        return found

    def begin(self) -> None:
        """Clear the previous program."""
        self._m = self._k = 0
        self._is_valid = True
        self._box[:] = self._open
        self._kinds, self._sources = {}, []

    def add_costs(self, costs: list[WeightedRows | mink.Objective], damping: float | Array) -> None:
        r"""Add up the costs of the tasks, as mink does, and the damping of all joints."""
        at, lift = 0, damping
        for cost in costs:
            if type(cost) is WeightedRows:
                W, e, mu = cost
                end = at + len(e)
                if end > len(self._errors):
                    self._weighted = _longer(self._weighted, end)
                    self._errors = _longer(self._errors, end)
                self._weighted[at:end], self._errors[at:end] = W, e
                lift = lift + mu
                at = end
        W, e = self._weighted[:at], self._errors[:at]
        np.dot(W.T, W, out=self._H)
        np.dot(e, W, out=self._c)
        np.negative(self._c, out=self._c)
        for cost in costs:
            if type(cost) is mink.Objective:
                self._H += cost.H
                self._c += cost.c
        if isinstance(lift, np.ndarray):
            self._H.flat[:: self.n + 1] += lift
            lift = 0.0
        self._lift = float(lift)

    def cost(self, dt: float) -> tuple[Array, Array]:
        """Copies of H and c, for the velocity as the unknown."""
        H = self._H.copy()
        H.flat[:: self.n + 1] += self._lift
        return H, self._c / dt

    def add_equality(self, A: Array, b: Array) -> None:
        """Rows A q̇ = b, (m, n)."""
        first, self._m = self._m, self._m + len(b)
        if self._m > len(self._b):
            self._A, self._b = _longer(self._A, self._m), _longer(self._b, self._m)
        self._A[first : self._m], self._b[first : self._m] = A, b

    def add_box(self, box: Box) -> None:
        """Bounds, each (n,); invalid ones are left to the reference, which names them."""
        lower, upper = box.lower, box.upper
        self._is_valid &= are_floats(lower, self.n) and are_floats(upper, self.n)
        if self._is_valid:
            self._is_valid = narrow_box(lower, upper, self._number(box.kind), self._box)

    def add_range(self, limit: MinkRange, q: Array, dt: float) -> None:
        """mink's joint ranges at joint positions q (nq,)."""
        self._is_valid &= narrow_to_range(
            q, limit.lower, limit.upper, limit.gain, dt, limit.addresses, limit.dofs,
            self._number("position"), self._box,
        )  # fmt: skip

    def add_rows(self, limit_rows: LimitRows, dt: float) -> None:
        """Rows G Δq ≤ h of a limit, (k, n)."""
        limit, G, h = limit_rows
        count = len(h)
        if count > len(self._limit_ends):
            self._limit_rows = _longer(self._limit_rows, count)
            self._limit_ends = _longer(self._limit_ends, count)
        self._limit_rows[:count], self._limit_ends[:count] = G, h
        if self._reserve(count):
            self._record_source(
                limit,
                append_rows(
                    self._limit_rows, self._limit_ends, count, dt, self._number(kind_of(limit)),
                    UNLIMITED, self._box, self._rows, self._ends, self._which, self._k,
                ),
            )  # fmt: skip

    def _number(self, kind: str) -> float:
        """A new number for a bound of this kind."""
        number = _FIRST.get(kind, 1000.0) + len(self._kinds)
        self._kinds[number] = kind
        return number

    def _reserve(self, count: int) -> bool:
        """Grow the arrays for more inequality rows; return whether all input is valid so far."""
        if self._k + count > len(self._ends):
            self._rows = _longer(self._rows, self._k + count)
            self._ends = _longer(self._ends, self._k + count)
            self._which = _longer(self._which, self._k + count)
        return self._is_valid

    def _record_source(self, limit: mink.Limit, end: int) -> None:
        """Record the limit of the rows that were appended up to ``end``."""
        if end < 0:
            self._is_valid = False
        elif end > self._k:
            self._sources.append((limit, self._k, end))
            self._k = end

    def solve(self, dt: float, threshold: float, scales: bool = False) -> bool:
        """Solve and verify the program; return whether there is a solution that meets all rows.

        Args:
            dt: Length of the step, s.
            threshold: Singular value of A below which the reference solves the program; 0: never.
                Linearly dependent rows that are consistent count once.
            scales: Whether to solve A x = s b with the largest feasible s if A x = b is infeasible.
        """
        if not self._is_valid:
            return False
        k = self._k
        room = 0 if k == 0 else max(8, 1 << (k - 1).bit_length())
        arrays = self._kept.get((self._m, room))
        if arrays is None:
            if len(self._kept) >= _MOST:
                self._kept.clear()
            arrays = self._kept[self._m, room] = _Arrays(self.n, self._m, room)
        self._size, self._result = arrays.begin(k)
        arguments = (
            self._H, self._c, self._lift, STEEPEST, dt, self._A, self._b, self._box, self._rows,
            self._ends, UNLIMITED, arrays.floats, arrays.integers, arrays.level_ends, threshold,
            TOLERANCES,
        )  # fmt: skip
        if self._program_step is None:
            self._program_step = bound(program_step, *arguments)
        status: int = self._program_step(*arguments)
        if status == INFEASIBLE and scales:
            status = scaled_step(arrays.floats, arrays.integers, TOLERANCES)
        return status in (DONE, SCALED)

    @property
    def velocity(self) -> Array:
        """q̇ of the last program, (n,): a view that the next program overwrites."""
        velocity: Array = self._result[self.n : 2 * self.n]
        return velocity

    @property
    def scale(self) -> float:
        """s of A x = s b of the last program."""
        return float(self._result[PROGRAM.end(self._size, "lam")])

    def step(self, ranks: tuple[int, ...], names: tuple[str, ...]) -> LazyStep:
        """The step of the last program.

        Args:
            ranks: Number of equality rows of each constraint.
            names: Joint names by degree of freedom.
        """
        sources: list[Named] = [
            RowsOf.at(limit, self._which[first:end].copy()) for limit, first, end in self._sources
        ]
        labels = StepLabels(ranks, self._size.m, names, self._kinds)
        step = LazyStep.made(self.velocity, self._result, self._size, labels, sources)
        if self.scale < 1.0:
            step.set_outcome(Status.SCALED, self.scale, (), False)
        return step


class _Arrays:
    """Arrays of the kernel for m equality rows and up to ``room`` inequality rows."""

    def __init__(self, n: int, m: int, room: int) -> None:
        self._most = Sizes(n, m, 0, 1, 0, 0, 0, room)
        self.floats, self.integers = PROGRAM.allocate(self._most)
        self.level_ends = np.array([m])
        self._by_rows: dict[int, tuple[Sizes, Array]] = {}

    def begin(self, k: int) -> tuple[Sizes, Array]:
        """Sizes of a program with k inequality rows, and a view of its result."""
        found = self._by_rows.get(k)
        if found is None:
            size = self._most._replace(k=k)
            found = self._by_rows[k] = size, self.floats[: PROGRAM.end(size, "sensitivity")]
        PROGRAM.resize(self.integers, found[0])
        return found


def _longer(array: Any, length: int) -> Any:
    """A copy with at least ``length`` rows."""
    longer = np.zeros((max(length, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    longer[: len(array)] = array
    return longer
