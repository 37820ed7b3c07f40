"""What a joint path does not keep at its rows, by the tolerances of every verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.kinematics import FramePair, JointRanges, largest_excess
from qp_twist.paths import PathTask, Waypoints
from qp_twist.referee.path_errors import poses_of


@dataclass(frozen=True, eq=False)
class RowVerdict:
    """What the rows of a joint path do not keep; :func:`~qp_twist.referee.examine` has the motion.

    Rows whose task error does not pass, joints outside their ranges (N, nv), and rows outside a
    hard tolerance band or a constraint, (N,).
    """

    off: Mask
    outside: Mask
    band: Mask
    constraint: Mask

    @classmethod
    def of(
        cls,
        path_task: PathTask,
        path: Waypoints,
        q: Array,
        errors: tuple[Array, Array],
        band_excess: Array,
        constraint_excess: Array,
    ) -> RowVerdict:
        """From rows q (N, nq), their errors, m and rad, and violations, rad or m, (N,) each."""
        tolerances = path_task.tolerances
        if any(band.weight is not None for band in path_task.bands):  # soft ones count, too
            band_excess = _of_hard_bands(path_task, path, q)
        ranges = JointRanges.of(path_task.model)
        room = ranges.room(ranges.positions(q))
        return cls(
            ~tolerances.met(*errors),
            ~(room >= -tolerances.joint_range),
            ~(band_excess <= tolerances.band),
            ~(constraint_excess <= tolerances.band),
        )

    @property
    def fails(self) -> Mask:
        """Rows with anything that does not pass, (N,)."""
        return np.asarray(self.off | self.outside.any(axis=1) | self.band | self.constraint)


def _of_hard_bands(path_task: PathTask, path: Waypoints, q: Array) -> Array:
    """Largest violation of a hard band at rows q (N, nq), rad or m, (N,)."""
    pair = FramePair(*poses_of(path_task, q), path.rotations, path.positions)
    hard = (band for band in path_task.bands if band.weight is None)
    return np.where(path.on_path, largest_excess(hard, pair), 0.0)
