"""The limits of a compiled step, in its arrays."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import (
    Clearance,
    DisplacementWindow,
    LimitRows,
    MotionLimit,
    PositionLimit,
    is_mink_box,
)
from qp_twist.control.composition import BOXES
from qp_twist.control.step_tables import state_of_mink, table_of


class LimitTables:
    """Writes what has changed in limits between two steps to their tables.

    Attributes:
        evaluated: Limits of other classes, which Python evaluates at each step, and their tables.
    """

    def __init__(self, limits: Sequence[mink.Limit], tables: Array) -> None:
        """Take the tables of ``kernel.bounds``, a view (L, nv, 7), in which the limits stand."""
        both = list(zip(tables, limits, strict=False))
        self._ranged = [
            [limit, limit.revision, t] for t, limit in both if isinstance(limit, PositionLimit)
        ]
        self._windows = [(t, limit) for t, limit in both if isinstance(limit, DisplacementWindow)]
        self._motions = [(t[:, 6], limit) for t, limit in both if isinstance(limit, MotionLimit)]
        self._of_mink = [
            [limit, state_of_mink(limit), t] for t, limit in both if is_mink_box(limit)
        ]
        self.evaluated = [
            (t, limit) for t, limit in both if type(limit) not in BOXES and not is_mink_box(limit)
        ]

    def update(self) -> bool:
        """Write changed ranges, windows and last velocities; return whether ranges have changed."""
        changed = False
        for known in self._ranged:
            limit, revision, table = known
            if limit.revision != revision:
                known[1], changed = limit.revision, True
                table[:] = table_of([limit], len(table))[0][0]
        for known in self._of_mink:
            limit, before, table = known
            state = state_of_mink(limit)
            if state != before:
                known[1], table[:] = state, table_of([limit], len(table))[0][0]
        for table, window in self._windows:
            table[:, 0], table[:, 1] = window.reference, window.half_width
        for velocity, motion in self._motions:
            velocity[:] = motion.velocity
        return changed

    def rows(self, configuration: mink.Configuration, dt: float) -> list[LimitRows | None]:
        """Bounds and rows of the limits that Python evaluates."""
        with np.errstate(over="ignore", invalid="ignore"):  # non-finite values are refused later
            return [LimitRows.of(limit, configuration, dt) for _, limit in self.evaluated]

    def write_bounds(self, found: Sequence[LimitRows | None]) -> None:
        """Write the bounds that :meth:`rows` has found."""
        for (table, limit), rows in zip(self.evaluated, found, strict=True):
            if not isinstance(limit, Clearance):  # which has rows only
                table[:, 0], table[:, 1] = (-np.inf, np.inf) if rows is None else rows.box[1:]
