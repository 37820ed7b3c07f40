"""The tolerances of every verdict: what a motion may miss and still passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask, number


@dataclass(frozen=True)
class Tolerances:
    """What passes, in runs, checks, comparisons, studies, reports and on the live page.

    A task states the errors in ``[study]``; these are the defaults. Between waypoints the errors'
    tolerances also apply to violations of hard bands and constraints, each in its unit: the path
    itself is not known more precisely there.

    Attributes:
        position: Largest linear task error, m.
        axis: Largest angular task error, rad.
        band: Largest violation of a tolerance band or a constraint at a waypoint, rad or m.
        joint_range: Largest violation of a joint's range, rad or m: half a unit of the fourth
            decimal of a degree, to which files are rounded.
    """

    position: float = 1e-4
    axis: float = float(np.radians(0.05))
    band: float = 1e-5
    joint_range: float = float(np.radians(0.5e-4))

    def stated(
        self, position_tolerance: float | None, axis_tolerance_deg: float | None
    ) -> Tolerances:
        """These, with those of a call in place of them where it states any, m and degrees.

        Raises:
            InvalidInput: If one is not above 0.
        """
        position, axis = self.position, self.axis
        if position_tolerance is not None:
            position = number("position_tolerance", position_tolerance, above=0.0)
        if axis_tolerance_deg is not None:
            axis = float(np.radians(number("axis_tolerance_deg", axis_tolerance_deg, above=0.0)))
        return replace(self, position=position, axis=axis)

    def between(self, unit: str) -> float:
        """The tolerance between waypoints of a unit, ``"m"`` or ``"rad"``."""
        return self.position if unit == "m" else self.axis

    def of(self, units: Sequence[str]) -> Array:
        """The tolerances between waypoints of some units."""
        return np.array([self.between(unit) for unit in units])

    def keeps_clear(self, distance: float, asked: float) -> bool:
        """Whether a pair that is ``distance`` apart is as far as ``asked``, m."""
        return distance >= asked - self.position

    def met(self, position: npt.ArrayLike, axis: npt.ArrayLike) -> Mask:
        """Whether task errors, m and rad, (N,) each, are within them; NaN is not, (N,)."""
        return np.less_equal(position, self.position) & np.less_equal(axis, self.axis)
