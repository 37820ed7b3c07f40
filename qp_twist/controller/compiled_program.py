"""Programs that mink tasks and limits have stated, solved by the kernel."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.plain_step import Layout, PlainStep
from qp_twist.controller.step_tables import TOLERANCES
from qp_twist.fast.program_step import program_step
from qp_twist.fast.step_record import HEADER, PROGRAM, Sizes
from qp_twist.fast.verified_program import REFUSED
from qp_twist.limits import Named
from qp_twist.limits.intersection import Intersection

_MOST = 64
"""Shapes of programs for which arrays are kept."""
_mine = threading.local()


class CompiledProgram:
    """Arrays for programs of one shape: n unknowns, m equality rows, k inequality rows."""

    def __init__(self, n: int, m: int, k: int) -> None:
        self._size = size = Sizes(n, m, 0, 1, 0, n, 0, 0, k)
        floats, integers = PROGRAM.lengths(size)
        self._floats = np.zeros(floats)
        self._integers = np.zeros(HEADER + integers, dtype=np.int64)
        self._integers[:HEADER] = size
        self._ends = np.array([m])
        self._result = self._floats[: PROGRAM.end(size, "gain_lam")]
        self._program = PROGRAM.arrays(self._floats, self._integers[HEADER:], size)

    @classmethod
    def of(cls, n: int, m: int, k: int) -> CompiledProgram:
        """The arrays of a shape, which every thread has for itself."""
        kept: dict[tuple[int, int, int], CompiledProgram] = _mine.__dict__.setdefault("kept", {})
        found = kept.get((n, m, k))
        if found is None:
            if len(kept) >= _MOST:
                kept.clear()
            found = kept[n, m, k] = cls(n, m, k)
        return found

    def solve(
        self,
        cost: tuple[Array, Array],
        equality: tuple[Array, Array],
        inequality: tuple[Array, Array],
        box: Intersection,
        threshold: float,
    ) -> bool:
        """Whether the program has a verified solution that meets every row; then it is kept here.

        Args:
            cost: H, positive definite, (n, n), and c, (n,).
            equality: A, (m, n), and b, (m,).
            inequality: G, (k, n), and g, (k,).
            box: Bounds.
            threshold: Singular value of A below which the reference has to look at it.
        """
        w = self._program
        w.dense[:], w.c[:] = cost
        w.lower[:], w.upper[:] = box.lower, box.upper
        if len(w.b):
            w.A[:], w.b[:] = equality
        if len(w.g):
            w.G[:], w.g[:] = inequality
        w.ints[0] = 0  # begun anew: the program may be another user's
        status: int = program_step(self._floats, self._integers, self._ends, threshold, TOLERANCES)
        return status != REFUSED

    def step(
        self,
        ranks: tuple[int, ...],
        names: tuple[str, ...],
        box: Intersection,
        rows: Sequence[Named],
    ) -> PlainStep:
        """The step of the program solved last.

        Args:
            ranks: Equality rows of each constraint.
            names: Of the joints, by degree of freedom.
            box: Bounds.
            rows: What the inequality rows come from.
        """
        layout = Layout(ranks, len(self._program.b), names, {})
        return PlainStep.made(self._program.x, self._result, self._size, layout, rows, box)
