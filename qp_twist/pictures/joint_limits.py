"""A joint's limits in a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.pictures.style import LIMIT

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_limits(panel: Axes, ranges: JointRanges, dof: int, curves: Sequence[Array]) -> None:
    """A joint's limits in red, the outside shaded, and its name and unit."""
    if ranges.limited[dof]:
        unit = np.degrees(1.0) if ranges.hinge[dof] else 1.0
        lower, upper = unit * ranges.lower[dof], unit * ranges.upper[dof]
        low, high = _view(lower, upper, curves)
        panel.set_ylim(low, high)
        for edge, limit in ((low, lower), (high, upper)):
            panel.axhline(limit, color=LIMIT, linewidth=1.2)
            panel.axhspan(edge, limit, color=LIMIT, alpha=0.07, linewidth=0)
    panel.set_title(ranges.names[dof])
    panel.set_ylabel("degrees" if ranges.hinge[dof] else "m")


def _view(lower: float, upper: float, curves: Sequence[Array]) -> tuple[float, float]:
    """Axis limits: the joint limits with a margin, larger if a curve leaves them, but bounded."""
    width = upper - lower
    seen = np.concatenate(curves)
    low = max(min(lower - 0.08 * width, seen.min() - 0.05 * width), lower - 0.5 * width)
    high = min(max(upper + 0.08 * width, seen.max() + 0.05 * width), upper + 0.5 * width)
    return float(low), float(high)
