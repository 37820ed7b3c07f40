"""Collect all limits of a step: box bounds with their origin, and general rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints.any_limit import LimitRows, Named, RowName, box_of_mink
from qp_twist.constraints.box import Box, BoxLimit, Intersection
from qp_twist.errors import InvalidInput
from qp_twist.kernel.constants import UNLIMITED


class GatheredLimits(Intersection):
    """lower ≤ q̇ ≤ upper and G q̇ ≤ g, with the kind of limit behind each bound.

    Attributes:
        rows: G, shape (m, nv).
        bounds: g, shape (m,).
        sources: The limits that the rows come from; they provide the rows' names.
        recovering: A sentence for each joint that is outside its limits.
    """

    def __init__(
        self,
        boxes: Sequence[Box],
        sources: Sequence[LimitRows],
        recovering: Sequence[str],
        model: mujoco.MjModel,
    ) -> None:
        """Intersect the boxes and stack the rows; no velocity beyond ±UNLIMITED is allowed."""
        super().__init__(boxes, model)
        impossible = (self.lower > UNLIMITED) | (self.upper < -UNLIMITED)
        if np.count_nonzero(impossible):
            raise InvalidInput(
                f"limits: joint {self.names[int(np.argmax(impossible))]!r} would have to move "
                f"faster than {UNLIMITED:g}; check the ranges and limits given, and dt."
            )
        self.lower[self.lower < -UNLIMITED] = -np.inf
        self.upper[self.upper > UNLIMITED] = np.inf
        self.rows, self.bounds = np.zeros((0, model.nv)), np.zeros(0)
        if sources:
            self.rows = np.vstack([source.rows for source in sources])
            self.bounds = np.concatenate([source.bounds for source in sources])
        self.sources, self.recovering = sources, tuple(recovering)

    def as_rows(self) -> tuple[Array, Array, Named]:
        """All limits, bounds included, as rows G q̇ ≤ g; and an object with the rows' names."""
        identity = np.eye(len(self.lower))
        above, below = np.flatnonzero(self.upper < np.inf), np.flatnonzero(self.lower > -np.inf)
        names = [(self.names[i], self.upper_kind[i]) for i in above]
        names += [(self.names[i], self.lower_kind[i]) for i in below]
        names += [name for source in self.sources for name in source.names]
        return (
            np.vstack([identity[above], -identity[below], self.rows]),
            np.concatenate([self.upper[above], -self.lower[below], self.bounds]),
            _Names(names),
        )


class _Names(NamedTuple):
    names: list[RowName]


def gather_limits(
    limits: Sequence[mink.Limit],
    configuration: mink.Configuration,
    dt: float,
    stated: Sequence[tuple[Array, Array]] | None = None,
) -> GatheredLimits:
    """Evaluate any limits at a configuration, or sort the rows G Δq ≤ h that they have stated.

    A row with a single entry becomes a bound, other rows (collision avoidance) stay rows. NaN, and
    limits that contradict each other of which neither yields, are refused.
    """
    boxes: list[Box] = []
    found: list[LimitRows] = []
    recovering: list[str] = []
    for k, limit in enumerate(limits):
        if isinstance(limit, BoxLimit):
            boxes += limit.boxes(configuration, dt)
            recovering += limit.recovering(configuration, dt)
            continue
        box = box_of_mink(limit, configuration, dt)
        known = None if stated is None else stated[k]
        evaluated = None if box else LimitRows.of(limit, configuration, dt, known)
        if evaluated is not None:
            box = evaluated.box
            found.append(evaluated)
            recovering += evaluated.recovering
        if box is not None:
            boxes.append(box)
    return GatheredLimits(boxes, found, recovering, configuration.model)
