"""The secondary objectives of a compiled step, in its arrays."""

from __future__ import annotations

from collections.abc import Sequence

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.control.posing import EVERYTHING, Displacement
from qp_twist.kinematics import (
    JointCentering,
    JointRanges,
    PostureReference,
    SecondaryObjective,
    checked_displacement,
)


class SecondaryArrays:
    """Writes the two parts of h = displacement + stiffness (θ̄ − θ) where they have changed.

    Objectives of other classes are evaluated at each step.

    Attributes:
        others: These objectives.
        h: What was written last.
    """

    def __init__(
        self,
        secondary: Sequence[SecondaryObjective],
        ranges: JointRanges,
        stiffness: Array,
        displacement: Array,
    ) -> None:
        """Write h of ``secondary`` to two arrays of the kernel, each (nv,)."""
        self._ranges, self._stiffness, self._displacement = ranges, stiffness, displacement
        self._centering = [s for s in secondary if type(s) is JointCentering]
        plain = ranges.only_hinges_and_slides
        self._postures = [s for s in secondary if plain and type(s) is PostureReference]
        known = *self._centering, *self._postures
        self.others = [s for s in secondary if s not in known]
        self._known = known
        self._steady = np.zeros(len(ranges.names))
        self._write(EVERYTHING)

    def update(self, configuration: mink.Configuration, h: Displacement) -> None:
        """Write what has changed."""
        if h is not self.h or [s.revision for s in self._known] != self._revisions:
            self._write(h)
        if self.others:
            self._displacement[:] = self._steady
            for other in self.others if h.share > 0.0 else ():
                self._displacement += h.share * checked_displacement(other, configuration)

    def _write(self, h: Displacement) -> None:
        """Write the parts that do not depend on the configuration."""
        self.h, self._revisions = h, [s.revision for s in self._known]
        self._stiffness[:] = self._steady[:] = 0.0
        for centering in self._centering:
            self._stiffness += centering.gain * centering.stiffness
        for s in self._postures:
            self._stiffness += s.gain
            self._steady += s.gain * (self._ranges.positions(s.q_ref) - self._ranges.middle)
        self._stiffness *= h.share
        self._steady *= h.share
        if h.added is not None:
            self._steady += h.added
        self._displacement[:] = self._steady
