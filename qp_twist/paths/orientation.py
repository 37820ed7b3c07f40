"""Waypoints from positions and orientations, with the rule that completes a tool axis."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array, unit_vector
from qp_twist.errors import InvalidInput
from qp_twist.geometry import rotation_matrix


def roll_by_plane(axes: Array, plane_normal: Array, *, flip: bool = False) -> Array:
    r"""Rotations whose z are tool axes (N, 3) and whose y lie in a plane.

    .. math::

        \mathbf y = \pm\frac{\hat{\mathbf n} \times \mathbf z}
                            {\lVert\hat{\mathbf n} \times \mathbf z\rVert}, \qquad
        \mathbf x = \mathbf y \times \mathbf z

    With n = y of the base it is the paper's rule for resolved motion rate, "y coplanar to the
    xz-plane of the robot base". The rule leaves the sign open: ``flip`` takes −y.

    Raises:
        InvalidInput: If an axis is parallel to n, where the rule says nothing.
    """
    normal = unit_vector("plane_normal", plane_normal)
    y = np.cross(normal, axes)
    length = np.linalg.norm(y, axis=1)
    if (length < 1e-9).any():
        raise InvalidInput(
            f"roll rule: at waypoint {int(np.argmin(length)) + 1} the tool axis is parallel to "
            f"plane_normal = {plane_normal.tolist()}, where the rule leaves the roll open; choose "
            "another plane_normal."
        )
    y = y / length[:, None] * (-1.0 if flip else 1.0)
    return np.stack([np.cross(y, axes), y, axes], axis=-1)


def lean_turns(what: str, positions: Array, axes: Array, lead: float, tilt: float) -> Array:
    r"""Tilts of a tool at the waypoints of a path, constant relative to the path.

    The tilt at each waypoint has the rotation vector :math:`\text{lead}\;\hat{\mathbf z} \times
    \hat{\mathbf t} + \text{tilt}\;\hat{\mathbf t}`, with z the tool's axis and t the direction of
    the path perpendicular to it (:func:`tangents`).

    Args:
        what: Name of the path in messages.
        positions: Of the waypoints, m, (N, 3).
        axes: z, unit vectors, (N, 3).
        lead: Tilt towards the direction of the path, rad.
        tilt: Tilt to the left of it, as seen from the tip of z, rad.

    Returns:
        Rotations in the world, (N, 3, 3), to be multiplied from the left.

    Raises:
        InvalidInput: If the path goes along the tool's axis everywhere.
    """
    t = tangents(what, positions, axes)
    return rotation_matrix(lead * np.cross(axes, t) + tilt * t)


def tangents(what: str, positions: Array, axes: Array) -> Array:
    """Directions of a path perpendicular to the tool's axes, unit vectors, (N, 3).

    Where the path is parallel to the axis, that of the nearest waypoint where it is not.

    Raises:
        InvalidInput: If the path goes along the tool's axis everywhere.
    """
    found = np.gradient(positions, axis=0) if len(positions) > 1 else np.zeros((1, 3))
    found -= (found * axes).sum(axis=1, keepdims=True) * axes
    lengths = np.linalg.norm(found, axis=1)
    along = np.flatnonzero(lengths > 1e-6 * lengths.max(initial=1e-9))
    if not len(along):
        raise InvalidInput(
            f"{what}: the path goes along the tool's axis everywhere, so that lead and tilt have "
            "no meaning."
        )
    nearest = along[np.searchsorted((along[1:] + along[:-1]) / 2.0, np.arange(len(axes)))]
    t: Array = found[nearest] - (found[nearest] * axes).sum(axis=1, keepdims=True) * axes
    return np.asarray(t / np.linalg.norm(t, axis=1, keepdims=True))


def poses(positions: Array, rotations: Array) -> tuple[mink.SE3, ...]:
    """Poses from positions (N, 3), m, and rotation matrices (N, 3, 3)."""
    return tuple(
        mink.SE3.from_rotation_and_translation(
            mink.SO3.from_matrix(np.ascontiguousarray(rotation)), position
        )
        for position, rotation in zip(positions, rotations, strict=True)
    )
