"""Programs that mink tasks and limits have stated, solved by the kernel."""

from __future__ import annotations

import threading
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints import Box, MinkRange, Named, RowsOf, StatedRows, kind_of
from qp_twist.constraints.stated_limit import UNLIMITED
from qp_twist.control.plain_step import Layout, PlainStep
from qp_twist.control.posing import STEEPEST, WeightedRows
from qp_twist.control.step import Status
from qp_twist.control.step_tables import TOLERANCES
from qp_twist.kernel.program_step import (
    keep_independent,
    program_step,
    slower_step,
)
from qp_twist.kernel.stated_limits import (
    append_ball_ranges,
    append_rows,
    narrow_box,
    narrow_to_range,
)
from qp_twist.kernel.step_record import PROGRAM, Sizes
from qp_twist.kernel.verified_program import DEPENDENT, DONE, SCALED, TOO_FAST
from qp_twist.qp.verification import EQUALITY_TOLERANCE

_MOST = 64
"""Shapes of programs for which arrays are kept."""
_FIRST = {"acceleration": 0.0, "position": 2000.0}
"""Numbers of kinds begin here, others at 1000: of equal bounds the one that comes first counts."""
_GONE = 1e-9
"""What is left of a row outside the others, as a length, that makes it depend on them."""
_mine = threading.local()


class CompiledProgram:
    """Room for programs of n unknowns: what is stated is laid down here, then solved.

    Each thread has its own for each n, and lays down one program after the other. So nobody else's
    code (a task, a limit) may run between :meth:`begin` and the last look at the result: it might
    ask for a step itself.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        # Of the costs: W, e and their sums.
        self._weighted, self._errors = np.zeros((4 * n, n)), np.zeros(4 * n)
        self._H, self._c, self._lift = np.zeros((n, n)), np.zeros(n), 0.0
        # Of the constraints: A and b.
        self._A, self._b = np.zeros((n, n)), np.zeros(n)
        self._m = 0
        # Of the limits: bounds, rows, and what one limit states before it is looked at.
        self._open = np.array([[-np.inf], [np.inf], [np.inf], [np.inf]]).repeat(n, axis=1)
        self._box, self._kinds = self._open.copy(), dict[float, str]()
        self._rows, self._ends = np.zeros((n, n)), np.zeros(n)
        self._which = np.zeros(n, dtype=np.intp)
        self._stated, self._stated_ends = np.zeros((n, n)), np.zeros(n)
        self._sources = list[tuple[mink.Limit | MinkRange, int, int]]()
        self._k, self._in_order = 0, True
        # Programs by m and the inequality rows that they have room for.
        self._kept: dict[tuple[int, int], _Arrays] = {}
        self._size, self._result = Sizes(n, 0, 0, 1, 0, n, 0, 0, 0), np.zeros(0)
        self._dependent: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, n: int) -> CompiledProgram:
        """The one of this thread."""
        kept: dict[int, CompiledProgram] = _mine.__dict__.setdefault("kept", {})
        found = kept.get(n)
        if found is None:
            if len(kept) >= _MOST:
                kept.clear()
            found = kept[n] = cls(n)
        return found

    def begin(self) -> None:
        """Forget the program before."""
        self._m = self._k = 0
        self._in_order = True
        self._box[:] = self._open
        self._kinds, self._sources = {}, []
        self._dependent = None

    def add_costs(self, costs: list[WeightedRows | mink.Objective], damping: float | Array) -> None:
        r"""Sum up what the tasks state, as mink does, with a damping of all joints."""
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
        """H and c on a velocity, copies."""
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
        """Bounds, each (n,); of others the reference says what is wrong."""
        lower, upper = box.lower, box.upper
        self._in_order &= _are_bounds(lower, self.n) and _are_bounds(upper, self.n)
        if self._in_order:
            self._in_order = narrow_box(lower, upper, self._number(box.kind), self._box)

    def add_range(self, limit: MinkRange, q: Array, dt: float) -> None:
        """A range of mink's, at joint positions q (nq,)."""
        self._in_order &= narrow_to_range(
            q, limit.lower, limit.upper, limit.gain, dt, limit.addresses, limit.dofs,
            self._number("position"), self._box,
        )  # fmt: skip
        count = len(limit.ball_dofs)
        if count and self._make_room(count):
            self._taken(
                limit,
                append_ball_ranges(
                    q, limit.ball_angles, limit.gain, dt, limit.ball_addresses, limit.ball_dofs,
                    limit.first_ball_row, self._rows, self._ends, self._which, self._k,
                ),
            )  # fmt: skip

    def add_rows(self, stated: StatedRows, dt: float) -> None:
        """Rows G Δq ≤ h that a limit states, (k, n)."""
        limit, G, h = stated
        count = len(h)
        if count > len(self._stated_ends):
            self._stated = _longer(self._stated, count)
            self._stated_ends = _longer(self._stated_ends, count)
        self._stated[:count], self._stated_ends[:count] = G, h
        if self._make_room(count):
            self._taken(
                limit,
                append_rows(
                    self._stated, self._stated_ends, count, dt, self._number(kind_of(limit)),
                    UNLIMITED, self._box, self._rows, self._ends, self._which, self._k,
                ),
            )  # fmt: skip

    def _number(self, kind: str) -> float:
        """Of a kind of limit, as the bounds have it."""
        number = _FIRST.get(kind, 1000.0) + len(self._kinds)
        self._kinds[number] = kind
        return number

    def _make_room(self, count: int) -> bool:
        """For more inequality rows; whether everything is in order so far."""
        if self._k + count > len(self._ends):
            self._rows = _longer(self._rows, self._k + count)
            self._ends = _longer(self._ends, self._k + count)
            self._which = _longer(self._which, self._k + count)
        return self._in_order

    def _taken(self, limit: mink.Limit | MinkRange, end: int) -> None:
        """Remember whose the rows are that now end at ``end``."""
        if end < 0:
            self._in_order = False
        elif end > self._k:
            self._sources.append((limit, self._k, end))
            self._k = end

    def solve(self, dt: float, threshold: float, scales: bool = False) -> bool:
        """Whether the program has a verified solution that meets every row; then it is kept here.

        Args:
            dt: Length of the step, s.
            threshold: Singular value of A below which the reference has to look at it. Rows that
                depend on others altogether, and ask for the same, count once.
            scales: Whether A x = s b at the largest s will do where A x = b does not fit.
        """
        if not self._in_order:
            return False
        status = self._solve(dt, threshold, self._m, scales)
        if status == DEPENDENT:
            m = self._m
            A, b = self._A[:m].copy(), self._b[:m].copy()
            kept = keep_independent(self._A, self._b, m, _GONE, np.empty((m, self.n)))
            if kept < m:
                status = self._solve(dt, threshold, kept, scales)
                off = float(np.abs(A @ self.velocity - self.scale * b).max())
                if not off <= EQUALITY_TOLERANCE * (1.0 + float(np.abs(b).max())):
                    status = DEPENDENT
                self._dependent = A, b
            self._A[:m], self._b[:m] = A, b
        return status in (DONE, SCALED)

    def _solve(self, dt: float, threshold: float, m: int, scales: bool) -> int:
        k = self._k
        room = 0 if k == 0 else max(8, 1 << (k - 1).bit_length())
        arrays = self._kept.get((m, room))
        if arrays is None:
            if len(self._kept) >= _MOST:
                self._kept.clear()
            arrays = self._kept[m, room] = _Arrays(self.n, m, room)
        self._size, self._result = arrays.begin(k)
        status: int = program_step(
            self._H, self._c, self._lift, STEEPEST, dt, self._A, self._b, self._box, self._rows,
            self._ends, UNLIMITED, arrays.floats, arrays.integers, arrays.level_ends, threshold,
            TOLERANCES, arrays.R, arrays.work, arrays.held,
        )  # fmt: skip
        if status == TOO_FAST and scales:
            status = slower_step(arrays.floats, arrays.integers, TOLERANCES)
        return status

    @property
    def velocity(self) -> Array:
        """q̇ of the program solved last, (n,), in arrays that the next one uses."""
        velocity: Array = self._result[self.n : 2 * self.n]
        return velocity

    @property
    def scale(self) -> float:
        """s of A x = s b, likewise."""
        return float(self._result[PROGRAM.end(self._size, "lam")])

    def step(self, ranks: tuple[int, ...], names: tuple[str, ...]) -> PlainStep:
        """The step of the program solved last.

        Args:
            ranks: Equality rows of each constraint.
            names: Of the joints, by degree of freedom.
        """
        sources: list[Named] = [
            _rows_of(limit, self._which[first:end].copy(), names)
            for limit, first, end in self._sources
        ]
        if self._dependent is not None:
            ranks_laid_down: tuple[int, ...] = (self._size.m,)
        else:
            ranks_laid_down = ranks
        layout = Layout(ranks_laid_down, self._size.m, names, self._kinds)
        step = PlainStep.made(self.velocity, self._result, self._size, layout, sources)
        if self.scale < 1.0:
            step.hindered(Status.SCALED, self.scale)
        if self._dependent is not None:
            A, b = self._dependent
            apart = np.split(A @ self.velocity - self.scale * b, np.cumsum(ranks)[:-1])
            sigma = np.linalg.svd(A, compute_uv=False)
            smallest = 0.0 if len(A) > self.n else float(sigma[-1])
            step.__dict__.update(residuals=tuple(apart), sigma_min=smallest)
        return step


class _Arrays:
    """What the kernel works in: m equality rows, room for so many inequality rows."""

    def __init__(self, n: int, m: int, room: int) -> None:
        self._most = Sizes(n, m, 0, 1, 0, n, 0, 0, room)
        self.floats, self.integers = PROGRAM.allocate(self._most)
        self.level_ends = np.array([m])
        self.R = np.zeros((n, n))
        self.work = np.zeros((4 + -(-room // (n + 1)), n + 1))
        self.held = np.zeros(m + room + 3 * n, dtype=np.int64)
        self._by_rows: dict[int, tuple[Sizes, Array]] = {}

    def begin(self, k: int) -> tuple[Sizes, Array]:
        """Sizes of a program with k inequality rows, and where it is left behind."""
        found = self._by_rows.get(k)
        if found is None:
            size = self._most._replace(k=k)
            found = self._by_rows[k] = size, self.floats[: PROGRAM.end(size, "gains")]
        PROGRAM.resize(self.integers, found[0])
        return found


class _BallRows:
    """Names of the ball joints' rows of a range."""

    def __init__(self, limit: MinkRange, which: Indices, names: tuple[str, ...]) -> None:
        dofs = limit.ball_dofs[which - limit.first_ball_row]
        self.names = [(names[dof], "position") for dof in dofs]


def _rows_of(limit: mink.Limit | MinkRange, which: Indices, names: tuple[str, ...]) -> Named:
    if isinstance(limit, MinkRange):
        return _BallRows(limit, which, names)
    return RowsOf(limit, which)


def _are_bounds(values: Any, n: int) -> bool:
    """Whether these are n floats; the kernel takes it for granted."""
    return type(values) is np.ndarray and values.dtype == np.float64 and values.shape == (n,)


def _longer(array: Any, length: int) -> Any:
    """The same with room for at least ``length`` entries."""
    longer = np.zeros((max(length, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    longer[: len(array)] = array
    return longer
