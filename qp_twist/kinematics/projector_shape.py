"""Projectors as arrays for ``kernel.twist_rows``."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import ProjectorKind, TwistProjector
from qp_twist.kernel import twist_rows

_FRAMES = {"world": twist_rows.WORLD, "body": twist_rows.BODY, "target": twist_rows.TARGET}


def kinds_of(projector: TwistProjector) -> tuple[int, int, int]:
    """Kinds of the linear and the angular block, and the frame of their axes."""
    frame = _FRAMES[projector.frame]
    return projector.linear.kind.value, projector.angular.kind.value, frame


def shape_of(projector: TwistProjector, *settings: float) -> Array:
    """Bases and axes of the two blocks; then gain and the largest steps, m and rad, (27,)."""
    numbers = []
    for block in (projector.linear, projector.angular):
        basis = np.zeros((3, 3))
        basis[:, : block.rank] = block.basis
        # A projector without an axis does not rotate.
        has_axis = block.kind in (ProjectorKind.PLANE, ProjectorKind.LINE)
        numbers += [basis.ravel(), block.axis if has_axis else np.zeros(3)]
    return np.concatenate([*numbers, settings])
