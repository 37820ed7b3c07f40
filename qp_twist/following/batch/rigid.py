"""Poses and rigid motions as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput


@np.errstate(over="ignore", invalid="ignore")  # an overflow is not a rotation
def rigid_motions(name: str, motions: Sequence[mink.SE3] | npt.ArrayLike) -> Array:
    """Rotations (9), row by row, and translations (3), (K, 12).

    Args:
        name: Their name in messages.
        motions: :class:`mink.SE3`, or matrices (K, 4, 4).

    Raises:
        InvalidInput: If one of them is not a rigid motion.
    """
    if isinstance(motions, (list, tuple)) and all(isinstance(m, mink.SE3) for m in motions):
        matrices = np.array([m.as_matrix() for m in motions]).reshape(-1, 4, 4)
    else:
        matrices = finite_array(name, cast(Any, motions), (None, 4, 4))
    turns = matrices[:, :3, :3]
    rows = turns[:, 0], turns[:, 1], turns[:, 2]
    # Entry by entry: matrix products of many small matrices take five times as long.
    off = np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
    for i in range(3):
        for j in range(i + 1):
            product = np.einsum("ki,ki->k", rows[i], rows[j])
            np.maximum(off, np.abs(product - float(i == j)), out=off)
    x, y, z = (rows[0][:, axis] for axis in range(3))
    u, v, w = (rows[1][:, axis] for axis in range(3))
    third = np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
    wrong = ~(off <= 1e-6) | ~(np.einsum("ki,ki->k", third, rows[2]) > 0.0)
    if wrong.any():
        raise InvalidInput(
            f"{name}: number {int(np.argmax(wrong))} is no rigid motion: a rotation and a "
            "translation above a row 0, 0, 0, 1."
        )
    return np.hstack([turns.reshape(-1, 9), matrices[:, :3, 3]])


def pose_of(motion: Array) -> mink.SE3:
    """The pose of rotation (9) and translation (3)."""
    rotation = mink.SO3.from_matrix(motion[:9].reshape(3, 3))
    return mink.SE3.from_rotation_and_translation(rotation, motion[9:12])
