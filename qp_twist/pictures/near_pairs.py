"""Which pairs of geoms are near each other at a configuration."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.paths import PathTask

NEAR = 0.015
"""Margin below which a pair counts as near, m."""
TOO_NEAR = 1e-6
"""Violation from which a pair counts as too near, m."""

_FARTHEST = 10.0
"""Largest distance for which there is a point between, m."""


class NearPair(NamedTuple):
    """The pair with the least margin."""

    distance: float
    """Its distance, m; negative by the depth of penetration."""
    asked: float
    """The distance that the task asks for, m."""
    name: str
    """Its name, as in ``Clearance.names``."""
    middle: Array
    """Point between the two geoms where they are nearest, m, in the world, (3,)."""


class NearPairs:
    """The clearances of a task, evaluated for pictures."""

    def __init__(self, path_task: PathTask) -> None:
        self.path_task = path_task
        self._data = mujoco.MjData(path_task.model)

    def nearest(self, q: Array) -> NearPair | None:
        """The pair with the least margin at a configuration q (nq,); ``None`` without pairs."""
        best: NearPair | None = None
        for clearance in self.path_task.clearances:
            distance, pair = (found[0] for found in clearance.closest(q[None]))
            if best is None or distance - clearance.distance < best.distance - best.asked:
                middle = self._between(q, *clearance.pairs[pair])
                best = NearPair(float(distance), clearance.distance, clearance.names[pair], middle)
        return best

    def geoms(self, q: Array) -> dict[int, bool]:
        """Ids of the geoms of near pairs at any of q (N, nq), and whether one is too near."""
        found: dict[int, bool] = {}
        for clearance in self.path_task.clearances:
            least = clearance.bounded(q, NEAR).min(axis=0)
            for pair in np.flatnonzero(least < NEAR):
                for geom in clearance.pairs[pair].tolist():
                    found[geom] = found.get(geom, False) or bool(least[pair] < -TOO_NEAR)
        return found

    def poses(self, q: Array) -> tuple[Array, Array]:
        """Positions (G, 3), m, and rotations (G, 3, 3) of all geoms at a configuration q (nq,)."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self.path_task.model, self._data)
        return self._data.geom_xpos, self._data.geom_xmat.reshape(-1, 3, 3)

    def _between(self, q: Array, one: int, other: int) -> Array:
        """Point between two geoms where they are nearest, by MuJoCo, m, (3,)."""
        self.poses(q)
        ends = np.zeros(6)
        model = self.path_task.model
        mujoco.mj_geomDistance(model, self._data, one, other, _FARTHEST, ends)
        middle: Array = 0.5 * (ends[:3] + ends[3:])
        return middle
