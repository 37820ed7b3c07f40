"""The tolerance bands of a task as a mink limit."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import instance
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask


class BandLimit(mink.Limit):
    r"""Keep the hard bands of a :class:`~qp_twist.TwistTask`, ``task``, in :func:`mink.solve_ik`.

    The rows of :meth:`TwistTask.band_rows <qp_twist.TwistTask.band_rows>` on the displacement,
    :math:`\mathbf G\,\Delta\mathbf q \le \mathbf g\,dt`. Soft bands need a slack, which a mink
    limit cannot have; :class:`~qp_twist.Controller` reads both kinds from the task itself.
    """

    kind = "band"

    def __init__(self, task: TwistTask) -> None:
        """Take the bands of a task, of which at least one is hard; others are refused."""
        instance("BandLimit(task)", task, TwistTask)
        if all(band.weight is not None for band in task.bands):
            raise InvalidInput(
                f"BandLimit: {task.name} has no hard band; give it bands=[…] with weight=None."
            )
        self.task = task

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """G and g·dt, shapes (k, nv) and (k,)."""
        hard = [b for b in self.task.band_rows(configuration, dt) if b.weight is None]
        if not hard:
            return mink.Constraint()
        bounds = np.concatenate([band.bounds for band in hard])
        return mink.Constraint(G=np.vstack([band.rows for band in hard]), h=bounds * dt)
