"""Waypoints from positions and orientations, with the rule that completes a tool axis."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array, unit_vector
from qp_twist.errors import InvalidInput


def roll_by_plane(axes: Array, plane_normal: Array, *, flip: bool = False) -> Array:
    r"""Rotations whose z is the tool axis and whose y lies in a plane.

    .. math::

        \mathbf y = \pm\frac{\hat{\mathbf n} \times \mathbf z}
                            {\lVert\hat{\mathbf n} \times \mathbf z\rVert}, \qquad
        \mathbf x = \mathbf y \times \mathbf z

    With n = y of the base it is the paper's rule for resolved motion rate, "y coplanar to the
    xz-plane of the robot base". The rule leaves the sign open: ``flip`` takes the other one.

    Args:
        axes: Tool axes z, unit vectors in the world, (N, 3).
        plane_normal: n, world, (3,).
        flip: Take −y.

    Returns:
        Rotations to the world, (N, 3, 3).

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


def poses(positions: Array, rotations: Array) -> tuple[mink.SE3, ...]:
    """Poses from positions (N, 3), m, and rotation matrices (N, 3, 3)."""
    return tuple(
        mink.SE3.from_rotation_and_translation(
            mink.SO3.from_matrix(np.ascontiguousarray(rotation)), position
        )
        for position, rotation in zip(positions, rotations, strict=True)
    )
