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
from qp_twist.kinematics import JointRanges

HORIZON = 0.2
"""Margin below which a pair has a row in a step, m."""
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
    """Arrays of :mod:`qp_twist.kernel.clearance_rows` for one clearance, from step to step.

    Attributes:
        arrays: Those of the cell and of the rows, as ``rows_apart`` takes them.
        count: Number of rows of the present step; −1 if they are not known yet.
        distance: The distance to keep, m.
        recovery: Speed at which a pair that is too near is moved apart, m/s.
    """

    distance: float
    recovery: float

    def __init__(self, shapes: MovingShapes, ranges: JointRanges) -> None:
        """Allocate them for the pairs of ``shapes``; distance and speed are set for each step."""
        nq, nv = ranges.nq, len(ranges.lower)
        self._shapes, self._cell = shapes, shapes.arrays
        pairs = shapes.count
        # Pairs and joints have rows; then come corrections, and those that hold a velocity.
        size = ApartSizes(nq, nv, pairs, 2 * pairs + 200 + 4 * nv)
        self._floats, self._integers = APART.allocate(size)
        self._views: Apart = APART.arrays(self._floats, self._integers, self._integers)
        self._views.hardest[:] = self._views.fastest[:] = np.inf
        self._least, self._pair = self._views.least, self._views.pair
        self._is_limited = False
        self._fastest: Array | None = None
        self._views.lower[:], self._views.upper[:] = ranges.lower, ranges.upper
        self.arrays = *self._cell, self._floats, self._integers
        self.count = 0

    def begin(self, velocity: Array | None, hardest: Array | None, fastest: Array | None) -> None:
        """Begin a step: from a velocity (nv,), with acceleration and velocity limits (nv,), if any.

        Obstacles have been taken from MuJoCo's data.
        """
        self.count = -1
        if hardest is not None:
            self._views.before[:], self._views.hardest[:] = velocity, hardest
        elif self._is_limited:
            self._views.before[:], self._views.hardest[:] = 0.0, np.inf
        self._is_limited = hardest is not None
        if fastest is not self._fastest:
            self._views.fastest[:] = np.inf if fastest is None else fastest
            self._fastest = fastest

    @property
    def settings(self) -> tuple[float, float, float, bool]:
        """What ``rows_apart`` takes after dt."""
        return self.distance, HORIZON, self.recovery, self._shapes.has_moved

    def rows(self, q: Array, dt: float) -> PairRows:
        """The rows at a configuration q (nq,), and corrections that have been added."""
        views = self._views
        if self.count < 0:
            views.q[:] = q
            self.count = rows_apart(*self.arrays, dt, *self.settings)
        k = self.count
        return PairRows(views.G[:k], views.h[:k] / dt, views.room[:k] / dt, views.pair[:k].copy())

    @property
    def named(self) -> tuple[float, Indices]:
        """The least margin left if the joints brake, m, and the pair of each row, (k,)."""
        return self._least.item(), self._pair[: self.count].copy()

    def lacks(self, velocity: Array, dt: float) -> float:
        """By how much a velocity (nv,) leads below what it may leave of the margins, m."""
        _, then, integers = self._cell
        lack: float = lack_apart(
            then, integers, self._floats, self._integers, velocity, dt, self.distance
        )
        return lack

    def correct(self, velocity: Array, dt: float) -> bool:
        """Add rows of where a velocity leads that lacks something; whether there are any.

        :meth:`lacks` has found that it does.
        """
        _, then, integers = self._cell
        before = self.count
        self.count = correct_apart(
            then, integers, self._floats, self._integers, velocity, dt, self.distance, before
        )
        return self.count > before

    @property
    def braked(self) -> Array:
        """The hardest braking from the last velocity, rad/s or m/s, (nv,)."""
        return self._views.braked.copy()

    def hold(self, velocity: Array, dt: float) -> None:
        """Replace all rows by those that hold a velocity (nv,).

        It need not satisfy the others, which are linear, and with both there might be no step.
        """
        views, nv = self._views, len(velocity)
        worst = int(np.argmin(views.worst))
        self.count = count = 2 * nv
        views.G[:count] = np.vstack([np.eye(nv), -np.eye(nv)])
        views.h[:count] = np.concatenate([velocity, -velocity]) * dt + _EXACT
        views.room[:count], views.pair[:count] = 0.0, worst

    def load(self) -> None:
        """Load, or compile, what steps take that are corrected or computed by the reference.

        It overwrites the present rows.
        """
        at_rest = np.zeros_like(self._views.before)
        self.count = -1
        self.rows(self._views.q, 1.0)
        self.lacks(at_rest, 1.0)
        self.correct(at_rest, 1.0)
