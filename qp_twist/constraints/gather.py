"""Collect all limits of a step: box bounds with their origin, and general rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints.box import Box, BoxLimit, Intersection, intersect
from qp_twist.constraints.evaluated_limit import (
    UNLIMITED,
    EvaluatedLimit,
    LimitRows,
    Named,
    RowName,
)
from qp_twist.constraints.mink_box import mink_box
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.joint_ranges import joint_names


@dataclass(eq=False)
class GatheredLimits:
    """lower ≤ q̇ ≤ upper and G q̇ ≤ g, with the kind of limit behind each bound.

    Attributes:
        box: The bounds on single joints.
        rows: G, shape (m, nv).
        bounds: g, shape (m,).
        rooms: Part of g that is what is left of a clearance, over dt; else 0, (m,).
        sources: The limits that the rows come from; they provide the rows' names.
        model: The robot.
        recovering: A sentence for each joint that is outside its limits.
    """

    box: Intersection
    rows: Array
    bounds: Array
    rooms: Array
    sources: Sequence[Named]
    model: mujoco.MjModel
    recovering: tuple[str, ...] = ()

    @property
    def lower(self) -> Array:
        """Lower velocity bounds, rad/s or m/s, (nv,)."""
        return self.box.lower

    @property
    def upper(self) -> Array:
        """Upper velocity bounds, (nv,)."""
        return self.box.upper

    @property
    def names(self) -> tuple[str, ...]:
        """Joint name of each degree of freedom; looked up only when a message needs it."""
        return joint_names(self.model)

    def as_rows(self) -> tuple[Array, Array, Named]:
        """All limits, bounds included, as rows G q̇ ≤ g; and an object with the rows' names."""
        identity = np.eye(len(self.lower))
        above, below = np.flatnonzero(self.upper < np.inf), np.flatnonzero(self.lower > -np.inf)
        return (
            np.vstack([identity[above], -identity[below], self.rows]),
            np.concatenate([self.upper[above], -self.lower[below], self.bounds]),
            _AsRows(self, above, below),
        )


class _AsRows(NamedTuple):
    """Names of :meth:`GatheredLimits.as_rows`: upper bounds, lower bounds, then the other rows."""

    limits: GatheredLimits
    above: Indices
    below: Indices

    @property
    def names(self) -> list[RowName]:
        """Name and kind of each row."""
        box, joints = self.limits.box, self.limits.names
        return [
            *((joints[i], box.upper_kind[i]) for i in self.above),
            *((joints[i], box.lower_kind[i]) for i in self.below),
            *(name for source in self.limits.sources for name in source.names),
        ]


def gather_limits(
    limits: Sequence[mink.Limit],
    configuration: mink.Configuration,
    dt: float,
    known: Mapping[int, LimitRows] = MappingProxyType({}),
) -> GatheredLimits:
    """Evaluate limits at a configuration.

    Any mink limit is accepted: a row with a single entry becomes a bound, other rows (collision
    avoidance) stay rows. :func:`~qp_twist.constraints.intersect` decides which bound is relaxed
    where two contradict each other.

    Args:
        limits: The limits to evaluate.
        configuration: The robot's configuration.
        dt: Length of the step, s.
        known: Rows that are already evaluated, by index into ``limits``.

    Raises:
        InvalidInput: If a limit returns NaN, or two limits contradict each other and neither
            yields.
    """
    boxes: list[Box] = []
    found: list[EvaluatedLimit] = []
    recovering: list[str] = []
    for place, limit in enumerate(limits):
        if isinstance(limit, BoxLimit):
            boxes += limit.boxes(configuration, dt)
            recovering += limit.recovering(configuration, dt)
            continue
        bounds = mink_box(limit, configuration, dt)
        if bounds is not None:
            boxes.append(bounds)
            continue
        rows = EvaluatedLimit.of(limit, configuration, dt, known.get(place))
        if rows is not None:
            boxes.append(rows.box)
            found.append(rows)
            recovering += rows.recovering
    model = configuration.model
    box = intersect(boxes, model)
    _drop_distant_bounds(box, model)
    return GatheredLimits(
        box,
        np.vstack([rows.rows for rows in found]) if found else np.zeros((0, model.nv)),
        np.concatenate([rows.bounds for rows in found]) if found else np.zeros(0),
        np.concatenate([rows.rooms for rows in found]) if found else np.zeros(0),
        found,
        model,
        tuple(recovering),
    )


def _drop_distant_bounds(box: Intersection, model: mujoco.MjModel) -> None:
    """Replace bounds beyond ±UNLIMITED by ±∞; raise if they exclude every slower velocity."""
    lower, upper = box.lower, box.upper
    impossible = (lower > UNLIMITED) | (upper < -UNLIMITED)
    if np.count_nonzero(impossible):
        joint = joint_names(model)[int(np.argmax(impossible))]
        raise InvalidInput(
            f"limits: joint {joint!r} would have to move faster than {UNLIMITED:g}; check the "
            "ranges and limits given, and dt."
        )
    lower[lower < -UNLIMITED] = -np.inf
    upper[upper > UNLIMITED] = np.inf
