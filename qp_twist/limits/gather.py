"""Collect all limits of a step: box bounds with their origin, and general rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, finite_array, float_array, within
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.limits.band_limit import BandLimit
from qp_twist.limits.box_limit import Box, BoxLimit
from qp_twist.limits.intersection import Kinds, intersect

RowName = tuple[str, str]
"""Name and kind of an inequality row, as in :class:`~qp_twist.BindingLimit`."""
UNLIMITED = 1e12
"""A velocity bound beyond this is none, rad/s or m/s."""
_MINK_KINDS = {"ConfigurationLimit": "position", "VelocityLimit": "velocity"}


@dataclass(eq=False)
class GatheredLimits:
    """lower ≤ q̇ ≤ upper and G q̇ ≤ g, with the kind of limit each bound comes from.

    Attributes:
        lower: Lower velocity bounds, rad/s or m/s, shape (nv,).
        upper: Upper velocity bounds, shape (nv,).
        lower_kind: Kind of the limit that set each lower bound.
        upper_kind: Kind of the limit that set each upper bound.
        rows: G, shape (m, nv).
        bounds: g, shape (m,).
        row_labels: Name and kind of each row.
        model: The robot.
        recovering: Sentences about joints that are outside their limits.
    """

    lower: Array
    upper: Array
    lower_kind: Kinds
    upper_kind: Kinds
    rows: Array
    bounds: Array
    row_labels: list[RowName]
    model: mujoco.MjModel
    recovering: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Joint name of each degree of freedom; looked up only where a message needs it."""
        return JointRanges.of(self.model).names

    def as_rows(self) -> tuple[Array, Array, list[RowName]]:
        """All limits as rows G q̇ ≤ g, the bounds too, with a name and kind for each."""
        identity = np.eye(len(self.lower))
        above, below = np.flatnonzero(self.upper < np.inf), np.flatnonzero(self.lower > -np.inf)
        names = self.names
        return (
            np.vstack([identity[above], -identity[below], self.rows]),
            np.concatenate([self.upper[above], -self.lower[below], self.bounds]),
            [(names[i], self.upper_kind[i]) for i in above]
            + [(names[i], self.lower_kind[i]) for i in below]
            + self.row_labels,
        )


def gather_limits(
    limits: Sequence[mink.Limit], configuration: mink.Configuration, dt: float
) -> GatheredLimits:
    """Evaluate limits at a configuration.

    mink's limits are accepted as they are: a row with a single entry becomes a bound, other rows
    (collision avoidance) stay rows. :func:`~qp_twist.limits.intersect` tells which bound gives way
    where two contradict each other.

    Raises:
        InvalidInput: If a limit returns NaN, or two limits contradict each other and neither gives
            way.
    """
    nv = configuration.model.nv
    boxes: list[Box] = []
    rows, bounds, labels = [np.zeros((0, nv))], [np.zeros(0)], list[RowName]()
    recovering: list[str] = []
    for limit in limits:
        if isinstance(limit, BoxLimit):
            boxes += limit.boxes(configuration, dt)
            recovering += limit.recovering(configuration, dt)
            continue
        constraint = limit.compute_qp_inequalities(configuration, dt)
        if constraint.inactive:
            continue
        name = type(limit).__name__
        G, g = _stated(name, constraint, nv, dt)
        entries = np.count_nonzero(G, axis=1)
        boxes.append(_box(_MINK_KINDS.get(name, name), G[entries == 1], g[entries == 1]))
        general = (entries > 1) & (g < np.inf) | (entries == 0) & (g < 0.0)
        rows.append(G[general])
        bounds.append(g[general])
        labels += [_row_name(limit, int(index)) for index in np.flatnonzero(general)]
    lower, upper, lower_kind, upper_kind = intersect(boxes, configuration.model)
    lower[lower < -UNLIMITED] = -np.inf
    upper[upper > UNLIMITED] = np.inf
    impossible = (lower > UNLIMITED) | (upper < -UNLIMITED)
    if impossible.any():
        joint = JointRanges.of(configuration.model).names[int(np.argmax(impossible))]
        raise InvalidInput(
            f"limits: joint {joint!r} would have to move faster than {UNLIMITED:g}; check the "
            "ranges and limits given, and dt."
        )
    return GatheredLimits(
        lower,
        upper,
        lower_kind,
        upper_kind,
        np.vstack(rows),
        np.concatenate(bounds),
        labels,
        configuration.model,
        tuple(recovering),
    )


def _stated(name: str, constraint: mink.Constraint, nv: int, dt: float) -> tuple[Array, Array]:
    """G and h/dt of a limit of anybody's class, checked; bounds too far away are none."""
    stated: tuple[Any, Any] = constraint.G, constraint.h
    G = within(
        f"{name}: G", finite_array(f"{name}: G of G Δq ≤ h", stated[0], (None, nv)), UNLIMITED
    )
    h = float_array(f"{name}: h of G Δq ≤ h", stated[1])
    if h.shape != (len(G),) or np.isnan(h).any() or (h == -np.inf).any():
        raise InvalidInput(
            f"{name}: its rows G Δq ≤ h need h of shape {(len(G),)} without NaN or −∞; it has "
            f"shape {h.shape}, {h!r}."[:300]
        )
    g: Array = h / dt
    g[g > UNLIMITED] = np.inf
    return G, g


def _row_name(limit: mink.Limit, row: int) -> RowName:
    if isinstance(limit, mink.CollisionAvoidanceLimit):
        geoms = [limit.model.geom(g).name or f"geom {g}" for g in limit.geom_id_pairs[row]]
        return " – ".join(geoms), "collision"
    if isinstance(limit, BandLimit):
        return f"{limit.task.name} band row {row}", "band"
    name = type(limit).__name__
    return f"{name} row {row}", name


def _box(kind: str, rows: Array, bounds: Array) -> Box:
    """Rows (m, nv) of a single entry each, and their bounds (m,), as a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = bounds[:, None] / rows
    lower = np.where(rows < 0.0, bound, -np.inf).max(axis=0, initial=-np.inf)
    upper = np.where(rows > 0.0, bound, np.inf).min(axis=0, initial=np.inf)
    return Box(kind, lower, upper)
