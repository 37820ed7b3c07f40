"""Vectors of R³ and rotations: each function takes one, or arrays of them."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from qp_twist.checks import Array

_TINY = 1e-12
"""Sines below this are rounding: of opposite vectors, or of an undefined angle."""


def rotate(rotations: Array, vectors: Array) -> Array:
    """R v of rotations (…, 3, 3) and vectors (…, 3)."""
    return (rotations @ vectors[..., None])[..., 0]


def cross(a: Array, b: Array) -> Array:
    """a × b of vectors (…, 3), in a fifth of the time of numpy's, which takes any axes."""
    (ax, ay, az), (bx, by, bz) = _entries(a), _entries(b)
    return _vectors(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def perpendicular(e: Array) -> Array:
    """A fixed unit vector perpendicular to the unit vector ``e``, (…, 3).

    It is built from the coordinate axis that is furthest from ``e``, so it is never degenerate.
    """
    normal = cross(e, np.eye(3)[np.argmin(np.abs(e), axis=-1)])
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def geodesic(start: Array, end: Array) -> Array:
    """Rotation vector of the shortest rotation from unit ``start`` to unit ``end``, rad, (…, 3).

    For opposite vectors every half turn about a perpendicular axis is equally short; a fixed one is
    used, so the result is never NaN.
    """
    (ax, ay, az), (bx, by, bz) = _entries(start), _entries(end)
    cosine = ax * bx + ay * by + az * bz
    # start × end, from a difference that is exact for nearly equal or opposite vectors: the plain
    # product's rounding would turn the axis out of the plane perpendicular to both.
    side = 1.0 - 2.0 * (cosine > 0.0)
    x, y, z = bx + side * ax, by + side * ay, bz + side * az
    x, y, z = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    sine = np.sqrt(x * x + y * y + z * z)
    scale = np.arctan2(sine, cosine) / (sine + (sine == 0.0))
    vectors = _vectors(scale * x, scale * y, scale * z)
    opposite = (sine < _TINY) & (cosine <= 0.0)
    if np.count_nonzero(opposite):
        vectors[opposite] = np.pi * perpendicular(np.broadcast_to(start, vectors.shape)[opposite])
    return vectors


def rotation_vector(rotation: Array) -> Array:
    """Logarithm of rotation matrices, of length at most π, rad; (3,) of (3, 3), or of many."""
    w, x, y, z = _quaternion(rotation)
    sine = np.sqrt(x * x + y * y + z * z)
    scale = 2.0 * np.arctan2(sine, w) / (sine + (sine == 0.0))
    return _vectors(scale * x, scale * y, scale * z)


def rotation_matrix(vectors: Array) -> Array:
    """Exponential of rotation vectors, rad; (3, 3) of (3,), or of many."""
    x, y, z = _entries(vectors)
    half = 0.5 * np.sqrt(x * x + y * y + z * z)
    scale = 0.5 * np.sin(half) / (half + (half == 0.0))
    w, x, y, z = np.cos(half), scale * x, scale * y, scale * z
    entries = np.array([
        w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z,
    ])  # fmt: skip
    matrices: Array = np.moveaxis(entries, 0, -1).reshape(*vectors.shape, 3)
    return matrices


def twist_angle(rotation: Array, axis: Array) -> Array:
    """Angle in (−π, π] of the part of a rotation (3, 3) that turns about the unit ``axis`` (3,).

    The *twist* of the swing–twist decomposition; 0 where it is undefined (a swing by π).
    """
    (w, x, y, z), (ax, ay, az) = _quaternion(rotation), _entries(axis)
    along = ax * x + ay * y + az * z
    angle = 2.0 * np.arctan2(along, w)  # from −π to π, since w ≥ 0
    angle += 2.0 * np.pi * (angle == -np.pi)
    twist: Array = angle * (np.hypot(along, w) >= _TINY)
    return twist


def _quaternion(rotation: Array) -> Any:
    """w ≥ 0, x, y, z of a rotation matrix, as floats, or as arrays of many."""
    if rotation.ndim > 2:
        # 4 times the products of its entries; the row of the largest is the least inexact.
        R = np.moveaxis(rotation, (-2, -1), (0, 1))
        xw, yw, zw = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        xy, xz, yz = R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] + R[1, 2]
        x, y, z = (1.0 + 2.0 * R[k, k] - (R[0, 0] + R[1, 1] + R[2, 2]) for k in range(3))
        w = 1.0 + R[0, 0] + R[1, 1] + R[2, 2]
        rows = np.stack([w, xw, yw, zw, xw, x, xy, xz, yw, xy, y, yz, zw, xz, yz, z], axis=-1)
        rows = rows.reshape(*w.shape, 4, 4)
        largest = np.diagonal(rows, axis1=-2, axis2=-1).argmax(axis=-1)[..., None, None]
        row = np.take_along_axis(rows, largest, axis=-2)[..., 0, :]
        row /= np.linalg.norm(row, axis=-1, keepdims=True)
        return np.moveaxis(np.where(row[..., :1] < 0.0, -row, row), -1, 0)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())  # in a hundredth of scipy's time for one
    return (-quaternion if quaternion[0] < 0.0 else quaternion).tolist()


def _entries(vectors: Array) -> Any:
    """x, y, z of one vector as floats, with which Python computes fastest, or arrays of many."""
    return vectors.tolist() if vectors.ndim == 1 else np.moveaxis(vectors, -1, 0)


def _vectors(x: Any, y: Any, z: Any) -> Array:
    """The inverse of :func:`_entries`."""
    return np.array([x, y, z]) if isinstance(x, float) else np.stack([x, y, z], axis=-1)
