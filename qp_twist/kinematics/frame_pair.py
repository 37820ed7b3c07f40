"""A frame and its target."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, read_only

_WORLD = read_only(np.eye(3))
_REST = read_only(np.zeros(6))


class FramePair(NamedTuple):
    """A frame and its target, in the world; or N of them, with N before every shape."""

    rotation: Array
    """R of the frame, shape (3, 3)."""
    position: Array
    """Origin of the frame, m, shape (3,)."""
    target_rotation: Array
    """R_d of the target, shape (3, 3)."""
    target_position: Array
    """Origin of the target, m, shape (3,)."""
    target_twist: Array = _REST
    """Twist of the target (linear, angular), world axes, m/s and rad/s, shape (6,)."""

    def axes(self, frame: str) -> Array:
        """Rotation to the world of the frame that a band's vectors are fixed to, (3, 3)."""
        if frame == "world":
            return _WORLD
        return self.rotation if frame == "body" else self.target_rotation

    @property
    def error(self) -> Array:
        """E = R R_dᵀ, (3, 3)."""
        return self.rotation @ self.target_rotation.swapaxes(-1, -2)
