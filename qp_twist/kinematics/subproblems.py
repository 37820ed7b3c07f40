"""Subproblems of Paden and Kahan, for many poses and branches at once.

Arrays of vectors are (3, K) or (3, K, B), of angles (K, B): K poses, B branches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array

NEARLY = 5e-3
"""Axes that miss each other by less than this are taken to meet, m, and to be parallel, rad."""
OBLIQUE = 0.1
"""Smallest sine of the angle between axes of which the meeting point is used."""
_EDGE = 1e-7
"""A cosine beyond ±1 by less is rounding at the edge of the reach."""


class Axes(NamedTuple):
    """Six screws for K values of the parameters."""

    directions: Array
    """(6, 3, K)."""
    anchors: Array
    """Points on them, m, (6, 3, K)."""


def distant(z: Array, a: Array, x: Array, m: Array, distance: Array) -> tuple[Array, Array]:
    """Both angles at which x, turned about the axis z through a, is so far from m."""
    x, m = x - a, m - a
    return projected(z, x, m, 0.5 * (dot(x, x) + dot(m, m) - distance**2))


def projected(z: Array, x: Array, d: Array, value: Array) -> tuple[Array, Array]:
    """Both angles q with d · R(z, q) x = value; NaN if there are none."""
    along = dot(d, z) * dot(x, z)
    cosine, sine = dot(d, x) - along, dot(d, cross(z, x))
    size = np.hypot(cosine, sine)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (value - along) / np.maximum(size, 1e-300)
    # Where the size is rounding, x is on the axis, or d along it: any angle does, or none.
    share = np.where(size < 1e-12, np.where(np.abs(value - along) < 1e-9, 1.0, np.nan), share)
    share = np.where(np.abs(share) > 1.0 + _EDGE, np.nan, np.clip(share, -1.0, 1.0))
    middle, half = np.arctan2(sine, cosine), np.arccos(share)
    return middle - half, middle + half


def about(z: Array, x: Array, y: Array) -> Array:
    """Angle about z from x to y, as seen along z."""
    return np.arctan2(dot(z, cross(x, y)), dot(x, y) - dot(x, z) * dot(y, z))


def rotated(z: Array, angle: Array, x: Array) -> Array:
    """R(z, angle) x, (3, K, B)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return x * cosine + cross(z, x) * sine + z * (dot(z, x) * (1.0 - cosine))


def each(found: tuple[Array, Array]) -> Array:
    """Two solutions (K, B) for each branch as (K, 2B), those of a branch next to each other."""
    return np.stack(found, axis=-1).reshape(len(found[0]), 2 * found[0].shape[1])


def cross(a: Array, b: Array) -> Array:
    """The cross product, also of complex vectors."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def dot(a: Array, b: Array) -> Array:
    """a · b, of complex vectors without a conjugate."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def norm(a: Array) -> Array:
    """The length of real vectors."""
    return np.sqrt(dot(a, a))


def turned(rotations: Array, vectors: Array) -> Array:
    """R v for each R (K, 3, 3), of vectors (3, K) or of one (3, 1), as (3, K) in memory, too."""
    return np.asarray(np.einsum("kij,jk->ik", rotations, vectors))


def sine_between(axes: Axes, a: int, b: int) -> Array:
    """Sine of the angle between two axes, (K,)."""
    return norm(cross(axes.directions[a], axes.directions[b]))


def meeting_point(axes: Axes, which: tuple[int, ...]) -> Array:
    """The point nearest to some axes, in the sense of least squares, m, (3, K)."""
    z = axes.directions[list(which)].transpose(2, 0, 1)  # (K, axes, 3)
    across = np.eye(3) - z[..., None] * z[..., None, :]
    anchors = axes.anchors[list(which)].transpose(2, 0, 1)[..., None]
    normal = across.sum(axis=1)
    diagonal = np.einsum("kii->ki", normal)
    diagonal += 1e-14  # parallel axes, which the caller looks for
    return np.linalg.solve(normal, (across @ anchors).sum(axis=1))[..., 0].T


def miss(axes: Axes, k: int, point: Array) -> Array:
    """Distance of a point (3, K) from an axis, m, (K,)."""
    return norm(cross(point - axes.anchors[k], axes.directions[k]))
