"""Moves of a tool on circles and lines by formulas of the tests' own."""

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

Array = np.ndarray


def centre_of(a: Array, b: Array, c: Array) -> Array:
    """The centre of the circle through three points, by the products of its chords."""
    u, v = b - a, c - a
    n = np.cross(u, v)
    return a + ((v @ v) * np.cross(n, u) - (u @ u) * np.cross(n, v)) / (2.0 * (n @ n))


def sweep_of(a: Array, b: Array, c: Array) -> float:
    """The angle from a through b to c: twice the inscribed angles at c and at a, rad."""

    def angle(p: Array, q: Array, r: Array) -> float:
        u, v = p - q, r - q
        return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))

    return 2.0 * (angle(a, c, b) + angle(b, a, c))


def moved(
    begin: Array, end: Array, shares: Array, via: Array | None = None, rule: str = "space"
) -> tuple[Array, Array]:
    """Positions (K, 3) and rotations (K, 3, 3) between two poses (4, 4), through a position (3,).

    In space the turn is a slerp of the poses, on the path of what the frame of tangent, radius and
    normal sees of them; with the tangent it is what that sees of the first.
    """
    a, c = begin[:3, 3], end[:3, 3]
    R = Rotation.from_matrix([begin[:3, :3], end[:3, :3]])
    if via is None:
        return a + shares[:, None] * (c - a), Slerp([0.0, 1.0], R)(shares).as_matrix()
    centre, sweep = centre_of(a, via, c), sweep_of(a, via, c)
    x = (a - centre) / np.linalg.norm(a - centre)
    n = np.cross(via - a, c - via)
    n /= np.linalg.norm(n)
    y = np.cross(n, x)
    cos, sin = np.cos(sweep * shares)[:, None], np.sin(sweep * shares)[:, None]
    radial, tangent = cos * x + sin * y, cos * y - sin * x
    points = centre + np.linalg.norm(a - centre) * radial
    if rule == "space":
        return points, Slerp([0.0, 1.0], R)(shares).as_matrix()
    frames = np.stack([tangent, radial, np.broadcast_to(n, radial.shape)], axis=2)
    first = np.column_stack([y, x, n])
    last = np.column_stack([np.cos(sweep) * y - np.sin(sweep) * x,
                            np.cos(sweep) * x + np.sin(sweep) * y, n])  # fmt: skip
    seen = [first.T @ begin[:3, :3], last.T @ end[:3, :3]]
    if rule == "tangent":
        seen[1] = seen[0]
    # The frame is left-handed, as are both views, so that the turn between them is proper.
    turn = Rotation.from_matrix(seen[0].T @ seen[1]).as_rotvec()
    return points, frames @ seen[0] @ Rotation.from_rotvec(shares[:, None] * turn).as_matrix()


def length_of(begin: Array, end: Array, via: Array | None) -> float:
    """Of the way between two poses, m."""
    a, c = begin[:3, 3], end[:3, 3]
    if via is None:
        return float(np.linalg.norm(c - a))
    return sweep_of(a, via, c) * float(np.linalg.norm(a - centre_of(a, via, c)))
