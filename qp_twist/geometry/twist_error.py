"""The task error Δt: the twist that would bring a frame to its target in one unit of gain."""

from __future__ import annotations

import math

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, rotation_matrix
from qp_twist.geometry.projector import Projector, ProjectorKind, perpendicular
from qp_twist.geometry.twist_projector import TwistProjector


def rotation_vector(rotation: Array) -> Array:
    """Logarithm of a rotation matrix (3, 3), in rad, of length at most π, shape (3,)."""
    wxyz = mink.SO3.from_matrix(np.ascontiguousarray(rotation)).wxyz
    if wxyz[0] < 0.0:
        wxyz = -wxyz
    sine = float(np.linalg.norm(wxyz[1:]))
    if sine < 1e-12:
        small: Array = 2.0 * wxyz[1:]
        return small
    vector: Array = wxyz[1:] * (2.0 * math.atan2(sine, wxyz[0]) / sine)
    return vector


def geodesic(start: Array, end: Array) -> Array:
    """Rotation vector (3,) of the shortest rotation taking unit vector ``start`` to ``end``, rad.

    For opposite vectors every half turn about a perpendicular axis is equally short; a fixed one is
    used, so the result is never NaN.
    """
    cosine = float(start @ end)
    # start × end, from a difference that is exact for nearly equal or opposite vectors: the plain
    # product's rounding would turn the axis out of the plane perpendicular to both.
    normal = cross(start, end - start if cosine > 0.0 else end + start)
    sine = math.hypot(*normal.tolist())
    if sine < 1e-12:
        return normal if cosine > 0.0 else math.pi * perpendicular(start)
    vector: Array = normal * (math.atan2(sine, cosine) / sine)
    return vector


def cross(a: Array, b: Array) -> Array:
    """a × b of two vectors; numpy's general function takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def twist_angle(rotation: Array, axis: Array) -> float:
    """Angle in (−π, π] of the part of ``rotation`` (3, 3) that turns about the unit ``axis``.

    The *twist* of the swing–twist decomposition; 0 where it is undefined (a swing by π).
    """
    w, *xyz = mink.SO3.from_matrix(np.ascontiguousarray(rotation)).wxyz
    along = float(np.dot(xyz, axis))
    if math.hypot(along, w) < 1e-12:
        return 0.0
    angle = 2.0 * math.atan2(along, w)
    # Both signs of the quaternion are the same rotation: fold into (−π, π].
    folded = math.remainder(angle, 2.0 * math.pi)
    return math.pi if folded == -math.pi else folded


def angular_error(
    rotation: Array, target: Array, projector: Projector, *, moves_with_body: bool
) -> Array:
    r"""Angular part of the task error, always inside the range of the projector, rad, shape (3,).

    With :math:`R_e = R_d R^T`: the rotation vector of R_e (full), its swing about e (plane), its
    twist angle about e times e (line), zero (none).

    The swing is a geodesic. If e moves with the body, it rotates e to R_e e, the desired direction
    of e. If e is fixed in space, it rotates R_eᵀ e to e, where R_eᵀ e is the present direction of
    the body axis that is e in the target. The two agree without roll; with roll each makes one full
    step exact.

    Args:
        rotation: R, from the controlled frame to the world, (3, 3).
        target: R_d, from the target frame to the world, (3, 3).
        projector: Angular projector in world axes.
        moves_with_body: Whether the projector's axis is fixed to the controlled frame.
    """
    if projector.kind is ProjectorKind.NONE:
        return np.zeros(3)
    error = target @ rotation.T
    if projector.kind is ProjectorKind.FULL:
        return rotation_vector(error)
    e = projector.axis
    assert e is not None
    if projector.kind is ProjectorKind.LINE:
        return twist_angle(error, e) * e
    return geodesic(e, error @ e) if moves_with_body else geodesic(error.T @ e, e)


def twist_error(
    rotation: npt.ArrayLike,
    position: npt.ArrayLike,
    target_rotation: npt.ArrayLike,
    target_position: npt.ArrayLike,
    projector: TwistProjector,
) -> Array:
    r"""Task error Δt = (linear, angular), in world axes, inside the range of T; m and rad, (6,).

    .. math::

        \Delta\mathbf t = \begin{bmatrix} \mathbf M_v (\mathbf p_d - \mathbf p) \\
        \Delta\boldsymbol\omega \end{bmatrix}

    with Δω from :func:`angular_error`. Source: the twist error of the paper's section 2 with the
    swing–twist decomposition of the rotation that is left.

    Args:
        rotation: R of the controlled frame to the world, (3, 3).
        position: Its origin in the world, m, (3,).
        target_rotation: R_d of the target frame to the world, (3, 3).
        target_position: Its origin in the world, m, (3,).
        projector: T, fixed to any frame.

    Raises:
        InvalidInput: If an array has the wrong shape, is not finite or not a rotation.
    """
    instance("projector", projector, TwistProjector)
    body = rotation_matrix("rotation", rotation)
    target = rotation_matrix("target_rotation", target_rotation)
    return resolved_twist_error(
        body,
        finite_array("position", position, (3,)),
        target,
        finite_array("target_position", target_position, (3,)),
        projector.resolved(body=body, target=target),
        moves_with_body=projector.frame == "body",
    )


def resolved_twist_error(
    rotation: Array,
    position: Array,
    target_rotation: Array,
    target_position: Array,
    world: TwistProjector,
    *,
    moves_with_body: bool,
) -> Array:
    """:func:`twist_error` for a projector that is already resolved in the world, (6,)."""
    linear = world.linear.basis @ (world.linear.basis.T @ (target_position - position))
    angular = angular_error(
        rotation, target_rotation, world.angular, moves_with_body=moves_with_body
    )
    return np.concatenate([linear, angular])


def clamp_twist(twist: Array, max_linear: float = math.inf, max_angular: float = math.inf) -> Array:
    """``twist`` (6,) with its linear and angular parts clamped to some lengths, m and rad.

    A full 90° swing in one step overshoots, since the Jacobian is only valid locally. Directions
    are kept.
    """
    return np.concatenate([_shortened(twist[:3], max_linear), _shortened(twist[3:], max_angular)])


def _shortened(vector: Array, longest: float) -> Array:
    length = math.hypot(*vector.tolist())
    return vector * (longest / length) if length > longest else vector
