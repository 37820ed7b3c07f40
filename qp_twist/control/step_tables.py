"""Limits, settings and tolerances as arrays for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import (
    DisplacementWindow,
    MotionLimit,
    PositionLimit,
    is_mink_box,
    kind_of,
    qpos_of,
)
from qp_twist.constraints.any_limit import UNLIMITED
from qp_twist.constraints.position_limit import NOTICEABLE
from qp_twist.control.composition import BOXES
from qp_twist.control.posing import FASTEST, NEARLY_UNSEEN, STEEPEST
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
from qp_twist.kernel.step_kernel import RAISE, Settings
from qp_twist.kernel.verified_program import SolverTolerances
from qp_twist.qp import levels, verification

_TYPES: dict[type, int] = dict(zip(BOXES, (POSITION, MOTION, WINDOW), strict=True))
_KINDS = {
    "acceleration": ACCELERATION_BOUND, "velocity": VELOCITY_BOUND, "position": POSITION_BOUND,
}  # fmt: skip
"""Kinds of bounds by name, with their numbers."""
TOLERANCES = SolverTolerances(
    equality=verification.EQUALITY_TOLERANCE,
    optimality=verification.OPTIMALITY_TOLERANCE,
    gain=verification.GAIN_TOLERANCE,
    gap=verification.GAP_TOLERANCE,
    rounding=verification.ROUNDING,
    bound=verification.BOUND_TOLERANCE,
    held=levels.HELD,
    dust=levels.ROUNDING,
)


def table_of(
    limits: Sequence[mink.Limit], nv: int
) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Tables of limits for ``kernel.bounds``, (L, nv, 7), and their kinds, (L,)."""
    table, numbers = np.zeros((len(limits), nv, 7)), numbers_of_kinds(limits)
    for row, limit in zip(table, limits, strict=True):
        if isinstance(limit, DisplacementWindow):
            row[:, 0], row[:, 1] = limit.reference, limit.half_width
        elif isinstance(limit, PositionLimit):
            row[:, 0], row[:, 1], row[:, 2:4] = limit.lower, limit.upper, limit.rounding.T
            if isinstance(limit, MotionLimit):
                row[:, 4], row[:, 5] = limit.max_velocity, limit.max_acceleration
        else:
            row[:, 0], row[:, 1], row[:, 2] = -np.inf, np.inf, numbers[kind_of(limit)]
        if is_mink_box(limit):
            write_box_of_mink(row, limit)
    types = [
        MINK_RANGE if type(limit) is mink.ConfigurationLimit and is_mink_box(limit)
        else _TYPES.get(type(limit), BOX_BOUNDS)
        for limit in limits
    ]  # fmt: skip
    return table, np.array(types, dtype=np.int64)


def with_slacks(
    table: Array, types: np.ndarray[tuple[int], np.dtype[np.int64]], slacks: int
) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Tables of limits extended by rows for the slacks ε ≥ 0."""
    if not slacks:
        return table, types
    free = np.repeat(table[:, :1], slacks, axis=1)
    free[..., 0], free[..., 1], free[..., 4:6], free[..., 6] = -np.inf, np.inf, np.inf, 0.0
    free[types == WINDOW, :, 0] = 0.0
    positive = np.zeros((1, table.shape[1] + slacks, 7))
    positive[..., 1], positive[..., : table.shape[1], 0] = np.inf, -np.inf
    return np.vstack([np.hstack([table, free]), positive]), np.append(types, BOX_BOUNDS)


def write_box_of_mink(row: Array, limit: Any) -> None:
    """Write the numbers of such a limit to its table (nv, 7), for ``kernel.bounds``."""
    if limit.projection_matrix is None:
        return
    dofs = limit.indices
    if isinstance(limit, mink.VelocityLimit):
        row[dofs, 0], row[dofs, 1] = -limit.limit, limit.limit
        return
    qpos = qpos_of(limit)
    row[dofs, 0], row[dofs, 1] = limit.lower[qpos], limit.upper[qpos]
    row[:, 2] = limit.gain


def state_of_mink(limit: Any) -> tuple[object, ...]:
    """The attributes of such a limit that may change between steps, in comparable form."""
    about = limit.indices.tobytes(), limit.projection_matrix is None
    if isinstance(limit, mink.VelocityLimit):
        return (limit.limit.tobytes(), *about)
    return (limit.lower.tobytes(), limit.upper.tobytes(), limit.gain, *about)


def numbers_of_kinds(limits: Sequence[mink.Limit]) -> dict[str, float]:
    """Numbers of the kinds of bounds, in the order of ``Intersection``.

    Other kinds are numbered around velocities, in the order of the limits.
    """
    found: dict[str, None] = {}
    for limit in limits:
        kind = "velocity"
        if type(limit) not in BOXES:
            kind = kind_of(limit)
        found.setdefault("" if type(limit) is PositionLimit else kind)
    names = [name for name in found if name not in ("", "acceleration", "position")]
    at = names.index("velocity") if "velocity" in names else len(names)
    step = 1.0 / (1 + len(names))
    others = {name: VELOCITY_BOUND + step * (i - at) for i, name in enumerate(names)}
    return others | _KINDS


def kernel_settings(
    singularity: float,
    weight: float,
    infeasible: int = RAISE,
    *,
    smooth: bool = False,
    trusts: bool = False,
    braking: bool = False,
) -> Settings:
    """Settings of a controller for ``step_kernel``."""
    return Settings(
        singularity, weight, NEARLY_UNSEEN, FASTEST, NOTICEABLE, UNLIMITED,
        STEEPEST, infeasible, smooth, trusts, braking,
    )  # fmt: skip
