"""A clearance in one step of a controller: its rows, and what a solution still lacks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints.shapes import MovingShapes
from qp_twist.kernel.clearance_rows import Braking, correct, lack_of, write_rows
from qp_twist.kernel.compiling import bound
from qp_twist.kinematics import JointRanges

HORIZON = 0.2
"""Margin below which a pair has a row in a step, m."""
_EXACT = 1e-10
"""Room of the rows that hold a velocity, rad or m."""


class PairRows(NamedTuple):
    """Rows G q̇ ≤ g of a step; views that the next step overwrites, but for the pairs."""

    rows: Array
    """G, (k, nv)."""
    bounds: Array
    """g, (k,)."""
    rooms: Array
    """The part of it that is what is left of the margin, over dt; else 0, (k,)."""
    pairs: Indices
    """The pair of each row, (k,)."""


class ClearanceStep:
    """One clearance from step to step: its rows, and what a velocity lacks.

    Attributes:
        distance: The distance to keep, m.
        recovery: Speed at which a pair that is too near is moved apart, m/s.
        least: The least margin left if the joints brake and no obstacle moves, m.
    """

    distance: float
    recovery: float

    def __init__(self, shapes: MovingShapes, ranges: JointRanges) -> None:
        """Allocate the rows for ``shapes``; distance and speed are set for each step."""
        nv, pairs = len(ranges.lower), len(shapes.cell.pairs)
        # Pairs and joints have rows; then come corrections, and those that hold a velocity.
        rows = 2 * pairs + 200 + 4 * nv
        self._shapes, self._state = shapes, Braking.empty(ranges.nq, nv, pairs, rows)
        self._state.hardest[:] = self._state.fastest[:] = np.inf
        self._state.lower[:], self._state.upper[:] = ranges.lower, ranges.upper
        self._is_limited = False
        self._fastest: Array | None = None
        self._count, self.least = 0, np.inf
        self._known = known = shapes.cell, self._state
        self._write_rows = bound(write_rows, *known, 1.0, 1.0, 1.0, 1.0, False)
        self._lack_of = bound(lack_of, *known, self._state.before, 1.0)
        self._correct = bound(correct, *known, self._state.before, 1.0, 0)

    def begin(self, velocity: Array | None, hardest: Array | None, fastest: Array | None) -> None:
        """Begin a step: from a velocity (nv,), with acceleration and velocity limits (nv,), if any.

        Obstacles have been taken from MuJoCo's data.
        """
        self._count = -1
        if hardest is not None:
            self._state.before[:], self._state.hardest[:] = velocity, hardest
        elif self._is_limited:
            self._state.before[:], self._state.hardest[:] = 0.0, np.inf
        self._is_limited = hardest is not None
        if fastest is not self._fastest:
            self._state.fastest[:] = np.inf if fastest is None else fastest
            self._fastest = fastest

    def rows(self, q: Array, dt: float) -> PairRows:
        """The rows at a configuration q (nq,), and corrections that have been added."""
        s = self._state
        if self._count < 0:
            s.q[:] = q
            self._count, self.least = self._write_rows(
                *self._known, dt, self.distance, HORIZON, self.recovery, self._shapes.has_moved
            )
        k = self._count
        return PairRows(s.G[:k], s.g[:k], s.room[:k], s.pair[:k].copy())

    @property
    def pairs(self) -> Indices:
        """The pair of each row, (k,)."""
        return self._state.pair[: self._count].copy()

    def lacks(self, velocity: Array, dt: float) -> float:
        """By how much a velocity (nv,) leads below what it may leave of the margins, m."""
        lack: float = self._lack_of(*self._known, np.ascontiguousarray(velocity, float), dt)
        return lack

    def correct(self, velocity: Array, dt: float) -> bool:
        """Add rows of where a velocity leads that lacks something; whether there are any.

        :meth:`lacks` has found that it does.
        """
        before, velocity = self._count, np.ascontiguousarray(velocity, float)
        self._count = self._correct(*self._known, velocity, dt, before)
        return self._count > before

    @property
    def braked(self) -> Array:
        """The hardest braking from the last velocity, rad/s or m/s, (nv,)."""
        return self._state.braked.copy()

    def hold(self, velocity: Array, dt: float) -> None:
        """Replace all rows by those that hold a velocity (nv,).

        It need not satisfy the others, which are linear, and with both there might be no step.
        """
        s, nv = self._state, len(velocity)
        self._count = count = 2 * nv
        s.G[:count] = np.vstack([np.eye(nv), -np.eye(nv)])
        s.g[:count] = np.concatenate([velocity, -velocity]) + _EXACT / dt
        s.room[:count], s.pair[:count] = 0.0, np.argmin(self._shapes.cell.pairs["worst"])
