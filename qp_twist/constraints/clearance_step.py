"""A clearance in one step of a controller: its rows, and what a solution still lacks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints.shapes import MovingShapes
from qp_twist.kernel.clearance_rows import (
    APART,
    Apart,
    ApartSizes,
    correct_apart,
    lack_apart,
    rows_apart,
)

HORIZON = 0.2
"""Margin below which a pair has a row in a step, m."""
_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Shares of a solution, the rest of which is braking, that are tried where it is not safe."""
_EXACT = 1e-10
"""Room of the rows that hold a velocity, rad or m."""


class PairRows(NamedTuple):
    """Rows G q̇ ≤ g of a step; G is a view that the next step overwrites."""

    rows: Array
    """G, (k, nv)."""
    bounds: Array
    """g, (k,)."""
    rooms: Array
    """The part of it that is what is left of the margin, over dt; else 0, (k,)."""
    pairs: Indices
    """The pair of each row, (k,)."""


class ClearanceStep:
    """Arrays of :mod:`qp_twist.kernel.clearance_rows` for one clearance, from step to step."""

    def __init__(self, shapes: MovingShapes, nq: int, nv: int, distance: float) -> None:
        """Allocate them for the pairs of ``shapes`` and a distance to keep, m."""
        self._shapes, self._distance, self._cell = shapes, distance, shapes.arrays
        pairs = shapes.count
        # Every pair has a row; then come corrections, and those that hold a velocity.
        size = ApartSizes(nq, nv, pairs, 2 * pairs + 200 + 2 * nv)
        self._floats, self._integers = APART.allocate(size)
        self._arrays: Apart = APART.arrays(self._floats, self._integers, self._integers)
        self._arrays.hardest[:] = np.inf
        self._count = 0

    def begin(self, velocity: Array | None, hardest: Array | None) -> None:
        """Begin a step: from a velocity (nv,) and with acceleration limits (nv,), if there are any.

        Obstacles have been taken from MuJoCo's data.
        """
        self._count = -1
        arrays = self._arrays
        if hardest is None:
            arrays.before[:], arrays.hardest[:] = 0.0, np.inf
        else:
            arrays.before[:], arrays.hardest[:] = velocity, hardest

    def rows(self, q: Array, dt: float, recovery: float) -> PairRows:
        """The rows at a configuration q (nq,), and corrections that have been added."""
        arrays = self._arrays
        if self._count < 0:
            arrays.q[:] = q
            self._count = rows_apart(
                *self._cell, self._floats, self._integers, dt, self._distance, HORIZON, recovery,
                self._shapes.has_moved,
            )  # fmt: skip
        k = self._count
        return PairRows(
            arrays.G[:k], arrays.h[:k] / dt, arrays.room[:k] / dt, arrays.pair[:k].copy()
        )

    def pair_of(self, row: int) -> int:
        """The pair of a row."""
        return int(self._arrays.pair[row])

    def lacks(self, velocity: Array, dt: float) -> float:
        """By how much a velocity (nv,) leads below what it may leave of the margins, m."""
        _, then, integers = self._cell
        lack: float = lack_apart(
            then, integers, self._floats, self._integers, velocity, dt, self._distance
        )
        return lack

    def correct(self, velocity: Array, dt: float) -> bool:
        """Add rows of where a velocity leads that lacks something; whether there are any.

        :meth:`lacks` has found that it does.
        """
        _, then, integers = self._cell
        before = self._count
        self._count = correct_apart(
            then, integers, self._floats, self._integers, velocity, dt, self._distance, before
        )
        return self._count > before

    def hold(self, velocity: Array, dt: float, kept: float) -> None:
        """Only rows that hold a velocity between this one and braking that lacks at most ``kept``.

        It need not satisfy the others, which are linear, and with both there might be no step. None
        are changed where braking lacks as much: an obstacle comes too fast.
        """
        arrays, nv = self._arrays, len(velocity)
        worst = int(np.argmin(arrays.worst))
        for share in _SHARES:
            held = arrays.braked + share * (velocity - arrays.braked)
            if self.lacks(held, dt) <= kept:
                break
        else:
            return
        self._count = count = 2 * nv
        arrays.G[:count] = np.vstack([np.eye(nv), -np.eye(nv)])
        arrays.h[:count] = np.concatenate([held, -held]) * dt + _EXACT
        arrays.room[:count], arrays.pair[:count] = 0.0, worst
