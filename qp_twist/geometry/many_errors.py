"""The task errors of many poses of a frame."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.geometry.projector import Projector, ProjectorKind, perpendicular
from qp_twist.geometry.twist_projector import TwistProjector


def many_twist_errors(
    rotations: Array,
    positions: Array,
    target_rotations: Array,
    target_positions: Array,
    projector: TwistProjector,
) -> tuple[Array, Array]:
    """Bases U (K, 6, r) and errors Δt (K, 6) of K poses, both in world axes.

    Row by row what :func:`~qp_twist.geometry.twist_error` says; for searches, which look at
    thousands of configurations.

    Args:
        rotations: Of the frame to the world, (K, 3, 3).
        positions: Its origins, m, (K, 3).
        target_rotations: R_d, (K, 3, 3), or (3, 3) for all of them.
        target_positions: p_d, m, (K, 3) or (3,).
        projector: T, in whichever frame it is fixed to.
    """
    count = len(rotations)
    turn: Array = rotations
    if projector.frame != "body":
        fixed = np.eye(3) if projector.frame == "world" else target_rotations
        turn = np.broadcast_to(fixed, (count, 3, 3))
    split = projector.linear.rank
    bases = np.zeros((count, 6, projector.rank))
    bases[:, :3, :split] = _turned(projector.linear, turn)
    bases[:, 3:, split:] = _turned(projector.angular, turn)
    errors = np.zeros((count, 6))
    linear = bases[:, :3, :split]
    apart = (target_positions - positions)[:, :, None]
    errors[:, :3] = (linear @ (linear.transpose(0, 2, 1) @ apart))[:, :, 0]
    left = target_rotations @ rotations.transpose(0, 2, 1)
    errors[:, 3:] = _angular(left, projector, turn)
    return bases, errors


def _turned(block: Projector, turn: Array) -> Array:
    if block.axis is None:
        return block.basis
    turned: Array = turn @ block.basis
    return turned


def _angular(left: Array, projector: TwistProjector, turn: Array) -> Array:
    """Angular errors (K, 3) for the rotations that are left (K, 3, 3)."""
    block = projector.angular
    if block.kind is ProjectorKind.NONE:
        return np.zeros((len(left), 3))
    if block.kind is ProjectorKind.FULL:
        vectors: Array = Rotation.from_matrix(left).as_rotvec()
        return vectors
    assert block.axis is not None
    axes = turn @ block.axis
    if block.kind is ProjectorKind.LINE:
        quaternion = Rotation.from_matrix(left).as_quat()
        along = np.einsum("ki,ki->k", quaternion[:, :3], axes)
        angle = 2.0 * np.arctan2(along, quaternion[:, 3])
        angle -= 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
        about: Array = angle[:, None] * axes
        return about
    if projector.frame == "body":
        return _geodesics(axes, np.einsum("kij,kj->ki", left, axes))
    return _geodesics(np.einsum("kji,kj->ki", left, axes), axes)


def _geodesics(start: Array, end: Array) -> Array:
    """Rotation vectors (K, 3) of the shortest rotations from ``start`` (K, 3) to ``end``."""
    normal = np.cross(start, end)
    sine = np.linalg.norm(normal, axis=1)
    cosine = np.einsum("ki,ki->k", start, end)
    vectors: Array = normal * (np.arctan2(sine, cosine) / np.where(sine > 0.0, sine, 1.0))[:, None]
    for k in np.flatnonzero((sine < 1e-12) & (cosine < 0.0)):
        vectors[k] = np.pi * perpendicular(start[k])
    return vectors
