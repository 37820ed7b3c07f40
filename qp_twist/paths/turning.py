"""Directions and rotations along a path: angles, interpolation, and the least-turning roll."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.geometry import geodesic, rotation_matrix, rotation_vector


def angles_between(a: Array, b: Array) -> Array:
    r"""Angles between unit vectors (N, 3) and (N, 3), rad, (N,); exact for small and flat ones.

    .. math:: \theta = 2\,\mathrm{atan2}(\lVert\mathbf a - \mathbf b\rVert,
        \lVert\mathbf a + \mathbf b\rVert)
    """
    found: Array = 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return found


def turns_between(a: Array, b: Array) -> Array:
    """Angles of the rotations from (N, 3, 3) to (N, 3, 3), rad, (N,)."""
    return np.asarray(np.linalg.norm(rotation_vector(b @ a.transpose(0, 2, 1)), axis=1))


def vectors_at(a: Array, b: Array, shares: Array) -> Array:
    """Unit vectors (N, 3) on the great circle from unit vectors a to b, (3,) or (N, 3).

    Args:
        a: At the share 0.
        b: At the share 1, not opposite to a.
        shares: Of the angle, (N,).
    """
    turn = geodesic(a, b)
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    ahead = np.cross(turn, a) / np.where(angle > 0.0, angle, 1.0)  # a is perpendicular to the turn
    angles = shares[:, None] * angle
    return np.asarray(np.cos(angles) * a + np.sin(angles) * ahead)


def rotations_at(a: Array, b: Array, shares: Array) -> Array:
    """Rotations (N, 3, 3) from a to b, (3, 3) or (N, 3, 3), about one axis, at shares (N,)."""
    turn = rotation_vector(b @ np.swapaxes(a, -1, -2))
    return rotation_matrix(shares[:, None] * turn) @ a


def least_turns(a: Array, b: Array) -> Array:
    """The rotations (N, 3, 3) by the smallest angle that take unit vectors a to b, (N, 3) each."""
    return rotation_matrix(geodesic(a, b))


def transported(first: Array, axes: Array) -> Array:
    """Rotations with prescribed z axes that turn as little as possible (parallel transport).

    The roll of the first is that of ``first`` after the least turn of its z to the first axis; from
    each axis to the next the rotation has no component about the axis.

    Args:
        first: Rotation (3, 3).
        axes: Unit vectors (N, 3), neighbours not opposite.
    """
    turns = least_turns(np.vstack([first[:, 2], axes[:-1]]), axes)
    x, found = first[:, 0], np.empty_like(axes)
    for k, axis in enumerate(axes):
        x = turns[k] @ x
        # Rounding would add up over a long path: x is made perpendicular to z.
        x = x - axis * (axis @ x)
        x /= np.sqrt(x @ x)
        found[k] = x
    return np.stack([found, np.cross(axes, found), axes], axis=-1)
