"""Directions and rotations along a path: angles, interpolation, and the least-turning roll."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.geometry import perpendicular


def angles_between(a: Array, b: Array) -> Array:
    r"""Angles between unit vectors (N, 3) and (N, 3), rad, (N,); exact for small and flat ones.

    .. math:: \theta = 2\,\mathrm{atan2}(\lVert\mathbf a - \mathbf b\rVert,
        \lVert\mathbf a + \mathbf b\rVert)
    """
    found: Array = 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return found


def turns_between(a: Array, b: Array) -> Array:
    """Angles of the rotations from (N, 3, 3) to (N, 3, 3), rad, (N,)."""
    if not len(a):
        return np.zeros(0)
    found: Array = Rotation.from_matrix(b @ a.transpose(0, 2, 1)).magnitude()
    return found


def vectors_at(a: Array, b: Array, shares: Array) -> Array:
    r"""Unit vectors on the great circle from a to b.

    .. math:: \frac{\sin((1-\lambda)\theta)\,\mathbf a + \sin(\lambda\theta)\,\mathbf b}
        {\sin\theta}

    Args:
        a: Unit vector, (3,) or (N, 3).
        b: Unit vector, not opposite to a, (3,) or (N, 3).
        shares: λ, 0 at a and 1 at b, (N,).

    Returns:
        Unit vectors (N, 3).
    """
    theta = np.atleast_1d(angles_between(a, b))[:, None]
    shares = shares[:, None]
    # For small angles the sines would cancel; the chord is the arc there to 1e-16.
    small = theta < 1e-6
    safe = np.where(small, 1.0, theta)
    of_a = np.where(small, 1.0 - shares, np.sin((1.0 - shares) * safe) / np.sin(safe))
    of_b = np.where(small, shares, np.sin(shares * safe) / np.sin(safe))
    found = of_a * a + of_b * b
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def rotations_at(a: Array, b: Array, shares: Array) -> Array:
    """Rotations interpolated from a to b about one fixed axis.

    Args:
        a: Rotation, (3, 3) or (N, 3, 3).
        b: Rotation, (3, 3) or (N, 3, 3).
        shares: 0 at a and 1 at b, (N,).

    Returns:
        Rotations (N, 3, 3).
    """
    turn = Rotation.from_matrix(b @ np.swapaxes(a, -1, -2)).as_rotvec()
    found: Array = Rotation.from_rotvec(shares[:, None] * turn).as_matrix() @ a
    return found


def least_turns(a: Array, b: Array) -> Array:
    r"""The rotations (N, 3, 3) by the smallest angle that take unit vectors a to b, (N, 3) each.

    .. math:: \mathbf R = \mathbf 1 + [\mathbf v]_\times
        + \frac{[\mathbf v]_\times^2}{1 + \mathbf a \cdot \mathbf b}, \qquad
        \mathbf v = \mathbf a \times \mathbf b

    For opposite vectors, where any axis perpendicular to a does it, a fixed one is taken.
    """
    v = np.cross(a, b)
    cosine = (a * b).sum(axis=1)
    cross = np.zeros((len(a), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = v
    cross[:, [1, 2, 0], [2, 0, 1]] = -v
    share = 1.0 / (1.0 + np.maximum(cosine, -1.0 + 1e-12))
    found: Array = np.eye(3) + cross + share[:, None, None] * (cross @ cross)
    for k in np.flatnonzero(cosine < -1.0 + 1e-12):
        u = perpendicular(a[k])
        found[k] = 2.0 * np.outer(u, u) - np.eye(3)
    return found


def transported(first: Array, axes: Array) -> Array:
    """Rotations with prescribed z axes that turn as little as possible (parallel transport).

    The roll of the first is that of ``first`` after the least turn of its z to the first axis; from
    each axis to the next the rotation has no component about the axis.

    Args:
        first: Rotation (3, 3).
        axes: Unit vectors (N, 3), neighbours not opposite.

    Returns:
        Rotations (N, 3, 3).
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
