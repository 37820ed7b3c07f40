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
        self._ranged = [(t, limit) for t, limit in both if isinstance(limit, PositionLimit)]
        self._revisions = [limit.revision for _, limit in self._ranged]
        self._windows = [(t, limit) for t, limit in both if isinstance(limit, DisplacementWindow)]
        self._motions = [(t[:, 6], limit) for t, limit in both if isinstance(limit, MotionLimit)]
        self._of_mink = [(t, limit) for t, limit in both if is_mink_box(limit)]
        self._states = [state_of_mink(limit) for _, limit in self._of_mink]
        self.evaluated = [
            (t, limit) for t, limit in both if type(limit) not in BOXES and not is_mink_box(limit)
        ]

    def update(self) -> bool:
        """Write changed ranges, windows and last velocities; return whether ranges have changed."""
        changed = False
        for number, (table, limit) in enumerate(self._ranged):
            if limit.revision != self._revisions[number]:
                self._revisions[number] = limit.revision
                table[:] = table_of([limit], len(table))[0][0]
                changed = True
        for number, (table, box) in enumerate(self._of_mink):
            state = state_of_mink(box)
            if state != self._states[number]:
                self._states[number] = state
                table[:] = table_of([box], len(table))[0][0]
        for table, window in self._windows:
            table[:, 0], table[:, 1] = window.reference, window.half_width
        for before, motion in self._motions:
            before[:] = motion.velocity
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
