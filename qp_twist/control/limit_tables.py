"""The limits of a step as tables for the kernels, and what keeps these up to date."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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
    kind_of,
    qpos_of,
)
from qp_twist.control.composition import BOXES
from qp_twist.kernel.bounds import (
    ACCELERATION_BOUND,
    BOX_BOUNDS,
    MINK_RANGE,
    MOTION,
    POSITION,
    POSITION_BOUND,
    VELOCITY_BOUND,
    WINDOW,
)

Types = np.ndarray[tuple[int], np.dtype[np.int64]]
_TYPES: dict[type, int] = dict(zip(BOXES, (POSITION, MOTION, WINDOW), strict=True))


def numbers_of_kinds(limits: Sequence[mink.Limit]) -> dict[str, float]:
    """Numbers of the kinds of bounds, in the order of ``Intersection``.

    Other kinds are numbered around velocities, in the order of the limits.
    """
    kinds = [
        "velocity" if type(limit) in BOXES else kind_of(limit)
        for limit in limits
        if type(limit) is not PositionLimit
    ]
    names = [name for name in dict.fromkeys(kinds) if name not in ("acceleration", "position")]
    at = names.index("velocity") if "velocity" in names else len(names)
    step = 1.0 / (1 + len(names))
    others = {name: VELOCITY_BOUND + step * (i - at) for i, name in enumerate(names)}
    return others | {
        "acceleration": ACCELERATION_BOUND,
        "velocity": VELOCITY_BOUND,
        "position": POSITION_BOUND,
    }


def table_of(limits: Sequence[mink.Limit], nv: int, slacks: int = 0) -> tuple[Array, Types]:
    """Tables of limits for ``kernel.bounds``, (L, nv, 7), and their kinds, (L,).

    With slacks ε ≥ 0, more unknowns that no limit is about, there is one more limit.
    """
    table = np.zeros((len(limits), nv + slacks, 7))
    table[:, nv:] = -np.inf, np.inf, 1.0, 0.0, np.inf, np.inf, 0.0
    types, numbers = np.full(len(limits), BOX_BOUNDS), numbers_of_kinds(limits)
    for i, limit in enumerate(limits):
        types[i] = _TYPES.get(type(limit), BOX_BOUNDS)
        if types[i] == BOX_BOUNDS:
            table[i, :nv, :3] = -np.inf, np.inf, numbers[kind_of(limit)]
        if type(limit) is mink.ConfigurationLimit and is_mink_box(limit):
            types[i] = MINK_RANGE
        if isinstance(limit, DisplacementWindow):
            table[i, nv:, 0] = 0.0
        _write(table[i, :nv], limit)
    if slacks:
        positive = np.full((1, nv + slacks, 7), [-np.inf, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0])
        positive[0, nv:, 0] = 0.0
        table, types = np.vstack([table, positive]), np.append(types, BOX_BOUNDS)
    return table, types


def _write(row: Array, limit: Any) -> None:
    """Write the numbers of a limit to its table (nv, 7)."""
    if isinstance(limit, DisplacementWindow):
        row[:, 0], row[:, 1] = limit.reference, limit.half_width
    elif isinstance(limit, PositionLimit):
        row[:, 0], row[:, 1], row[:, 2:4] = limit.lower, limit.upper, limit.rounding.T
        if isinstance(limit, MotionLimit):
            row[:, 4], row[:, 5] = limit.max_velocity, limit.max_acceleration
    elif is_mink_box(limit):
        row[:, 0], row[:, 1] = -np.inf, np.inf
        if limit.projection_matrix is None:
            return
        if isinstance(limit, mink.VelocityLimit):
            row[limit.indices, 0], row[limit.indices, 1] = -limit.limit, limit.limit
            return
        qpos = qpos_of(limit)
        row[limit.indices, 0], row[limit.indices, 1] = limit.lower[qpos], limit.upper[qpos]
        row[:, 2] = limit.gain


def _state(limit: Any) -> tuple[object, ...]:
    """What of a limit of mink's may change between steps, in comparable form."""
    about = limit.indices.tobytes(), limit.projection_matrix is None
    if isinstance(limit, mink.VelocityLimit):
        return (limit.limit.tobytes(), *about)
    return (limit.lower.tobytes(), limit.upper.tobytes(), limit.gain, *about)


class LimitTables:
    """Writes what has changed in limits between two steps to their tables.

    Attributes:
        evaluated: Limits of other classes, which Python evaluates at each step, and their tables.
        uncounted: Whether some are of mink's, or windows, whose changes nobody counts.
    """

    def __init__(self, limits: Sequence[mink.Limit], tables: Array) -> None:
        """Take the tables of ``kernel.bounds``, a view (L, nv, 7), in which the limits stand."""
        both = list(zip(tables, limits, strict=False))
        self._windows = [(t, v) for t, v in both if isinstance(v, DisplacementWindow)]
        self._own: list[list[Any]] = [
            [v, v.revision, t] for t, v in both if isinstance(v, PositionLimit)
        ]
        self._motions = [(v, t[:, 6]) for t, v in both if isinstance(v, MotionLimit)]
        self._minks = [[v, _state(v), t] for t, v in both if is_mink_box(v)]
        self.evaluated = [(t, v) for t, v in both if type(v) not in BOXES and not is_mink_box(v)]
        self.uncounted = bool(self._minks or self._windows)

    def update(self) -> bool:
        """Write changed ranges and windows; return whether ranges have changed."""
        changed = False
        for known in self._own:
            limit, revision, table = known
            if limit.revision != revision:
                known[1], changed = limit.revision, True
                _write(table, limit)
        for known in self._minks:
            limit, before, table = known
            state = _state(limit)
            if state != before:
                known[1], changed = state, True
                _write(table, limit)
        for table, window in self._windows:
            _write(table, window)
        return changed

    def write_velocities(self) -> None:
        """Write the joint velocity that acceleration limits count from."""
        for limit, before in self._motions:
            before[:] = limit.velocity

    def rows(self, configuration: mink.Configuration, dt: float) -> list[LimitRows | None]:
        """Bounds and rows of the limits that Python evaluates."""
        with np.errstate(over="ignore", invalid="ignore"):  # non-finite values are refused later
            return [LimitRows.of(limit, configuration, dt) for _, limit in self.evaluated]

    def write_bounds(self, found: Sequence[LimitRows | None]) -> None:
        """Write the bounds that :meth:`rows` has found."""
        for (table, limit), rows in zip(self.evaluated, found, strict=True):
            if not isinstance(limit, Clearance):  # which has rows only
                table[:, 0], table[:, 1] = (-np.inf, np.inf) if rows is None else rows.box[1:]
