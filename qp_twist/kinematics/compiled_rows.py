"""Serial chains and projectors as arrays for the kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.geometry import ProjectorKind, TwistProjector, perpendicular
from qp_twist.kernel import twist_rows
from qp_twist.kernel.arm_kernel import Arm
from qp_twist.kernel.path_kernel import Rows
from qp_twist.kinematics.serial_chain import SerialChain

_FRAMES = {"world": twist_rows.WORLD, "body": twist_rows.BODY, "target": twist_rows.TARGET}


def rows_of(
    projectors: Sequence[TwistProjector],
    which: Indices,
    rotations: Array,
    positions: Array,
    *,
    max_linear_step: float = np.inf,
    max_angular_step: float = np.inf,
) -> Rows:
    """The task rows of a path of N waypoints, at rotations (N, 3, 3) and positions (N, 3), m.

    ``which`` (N,) is the index of each waypoint's projector, −1 for none of them. Errors are
    clamped to the largest steps, m and rad.
    """
    count, steps = len(positions), (max_linear_step, max_angular_step)
    return Rows(
        np.array([kinds_of(p) for p in projectors], dtype=np.int64).reshape(-1, 3),
        np.array([shape_of(p, 1.0, *steps) for p in projectors]).reshape(-1, 27),
        np.asarray(which, dtype=np.int64),
        np.hstack([rotations.reshape(count, 9), positions, np.zeros((count, 6))]),
    )


def arm_of(chain: SerialChain) -> Arm:
    """A chain with a frame for each joint, its z along the axis."""
    frames, rotation, origin = [], np.eye(3), np.zeros(3)
    for screw in chain.screws:
        x = perpendicular(screw.axis)
        turned = np.stack([x, np.cross(screw.axis, x), screw.axis], axis=1)
        frames.append(_between(rotation, origin, turned, screw.anchor))
        rotation, origin = turned, screw.anchor
    return Arm(
        np.array(frames).reshape(-1, 12),
        _between(rotation, origin, chain.rotation, chain.position),
        np.array([screw.reference for screw in chain.screws], dtype=np.float64),
        np.array(chain.qpos, dtype=np.int64),
        np.array([screw.dof for screw in chain.screws], dtype=np.int64),
        np.array([screw.slides for screw in chain.screws], dtype=np.int64),
    )


def _between(rotation: Array, origin: Array, turned: Array, anchor: Array) -> Array:
    """Pose of the second frame in the first one: rotation (9) and origin (3)."""
    return np.concatenate([(rotation.T @ turned).ravel(), rotation.T @ (anchor - origin)])


def kinds_of(projector: TwistProjector) -> tuple[int, int, int]:
    """Kinds of the linear and the angular block, and the frame of their axes."""
    frame = _FRAMES[projector.frame]
    return projector.linear.kind.value, projector.angular.kind.value, frame


def shape_of(projector: TwistProjector, *settings: float) -> Array:
    """Bases and axes of the two blocks; then gain and the largest steps, m and rad, (27,)."""
    numbers = []
    for block in (projector.linear, projector.angular):
        basis = np.zeros((3, 3))
        basis[:, : block.rank] = block.basis
        # A projector without an axis does not rotate.
        has_axis = block.kind in (ProjectorKind.PLANE, ProjectorKind.LINE)
        numbers += [basis.ravel(), block.axis if has_axis else np.zeros(3)]
    return np.concatenate([*numbers, settings])
