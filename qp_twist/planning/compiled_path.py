"""Task rows of a path for the kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.geometry import TwistProjector
from qp_twist.kernel import path_kernel
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.compiled_rows import arm_of, rows_of

Newton = tuple[int, float, float, float, float, float, float]
"""The settings of :func:`~qp_twist.kernel.path_kernel.correct`."""
Descent = tuple[int, float, float]
"""Largest number of rounds, largest step, smallest gain."""


class CompiledPath:
    """Newton corrections and descents of z along a path, configuration by configuration."""

    def __init__(
        self,
        chain: SerialChain,
        projectors: Sequence[TwistProjector],
        which: Indices,
        rotations: Array,
        positions: Array,
        couplings: path_kernel.Couplings,
    ) -> None:
        """Fill the arrays; ``which`` (N,) is the index of each waypoint's projector."""
        self._rows = (
            arm_of(chain), rows_of(projectors, which, rotations, positions), couplings
        )  # fmt: skip

    def correct(self, q: Array, at: Indices, newton: Newton) -> np.ndarray:
        """Correct q (K, nv) onto the waypoints, in place; return which converged, (K,)."""
        arrived: np.ndarray = path_kernel.correct(*self._rows, q, at, newton)
        return arrived

    def descend(
        self, q: Array, at: Indices, ranges: JointRanges, newton: Newton, descent: Descent
    ) -> None:
        """Move q (K, nv) to the local minimum of z, in place; NaN where it does not converge."""
        path_kernel.centred_nearby(
            *self._rows, q, at, ranges.weight, ranges.middle, newton, descent
        )
