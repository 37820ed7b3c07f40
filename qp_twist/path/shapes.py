"""Paths as arrays: positions, and the tool axis where the path states one."""

from __future__ import annotations

import itertools
import math

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput


def polyline(points: Array, steps: int) -> Array:
    """Points along straight segments, ``steps`` equal steps each, both ends included, (N, 3), m."""
    parts = [
        a + (b - a) * (np.arange(steps)[:, None] / steps) for a, b in itertools.pairwise(points)
    ]
    return np.vstack([*parts, points[-1:]])


def spherical_patch_edges(
    center: Array, radius: float, half_width: Array, steps: int
) -> tuple[Array, Array]:
    """The four edges of the cap of a sphere cut out by |x| ≤ half_width[0], |y| ≤ half_width[1].

    The lap runs (−,−) → (+,−) → (+,+) → (−,+) → start, uniform in the edge's coordinate.

    Args:
        center: Centre of the sphere in the world, m, (3,).
        radius: Its radius, m.
        half_width: Half-widths of the patch along x and y, m, (2,).
        steps: Steps along each edge.

    Returns:
        Points (4·steps + 1, 3), m, and outward unit normals (4·steps + 1, 3).

    Raises:
        InvalidInput: If the patch's corners are not on the sphere.
    """
    corner = math.hypot(*half_width)
    if corner >= radius:
        raise InvalidInput(
            f"spherical_patch: the corners are {corner:g} m from the axis, outside the sphere of "
            f"radius {radius:g} m; make half_width smaller."
        )
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], dtype=np.float64)
    corners = np.column_stack([signs * half_width, np.zeros(5)])
    offsets = polyline(corners, steps)
    offsets[:, 2] = np.sqrt(radius**2 - np.sum(offsets[:, :2] ** 2, axis=1))
    return center + offsets, offsets / radius
