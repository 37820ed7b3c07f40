"""Paths as arrays: positions, and the tool axis if the path has one."""

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


def with_leads(points: Array, normals: Array, length: float, steps: int) -> tuple[Array, Array]:
    """A path with a straight approach and retreat along the normals of its ends.

    Args:
        points: The path, m, (N, 3).
        normals: Unit normals, away from the part, (N, 3).
        length: Length of each, m.
        steps: Equal steps along each.

    Returns:
        Points (N + 2·steps, 3), m, and normals to them.
    """
    ends = points[[0, -1]] + length * normals[[0, -1]]
    points = np.vstack(
        [
            polyline(np.array([ends[0], points[0]]), steps)[:-1],
            points,
            polyline(np.array([points[-1], ends[1]]), steps)[1:],
        ]
    )
    return points, np.pad(normals, ((steps, steps), (0, 0)), mode="edge")


def spherical_patch_edges(
    center: Array, radius: float, half_width: Array, steps: int
) -> tuple[Array, Array]:
    """The four edges of the cap of a sphere cut out by |x| ≤ half_width[0], |y| ≤ half_width[1].

    The edge goes (−,−) → (+,−) → (+,+) → (−,+) → start, uniform in the edge's coordinate.

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
