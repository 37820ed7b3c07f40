"""The task error Δt: the twist that would bring a frame to its target in one unit of gain."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, rotation_matrix
from qp_twist.geometry.projector import Projector, ProjectorKind
from qp_twist.geometry.rotations import geodesic, rotate, rotation_vector, twist_angle
from qp_twist.geometry.twist_projector import TwistProjector


def angular_error(
    rotation: Array, target: Array, projector: Projector, *, moves_with_body: bool
) -> Array:
    r"""Angular part of the task error, always inside the range of the projector, rad, shape (3,).

    With :math:`R_e = R_d R^T`: the rotation vector of R_e (full), its swing about e (plane), its
    twist angle about e times e (line), zero (none).

    The swing is a geodesic. If e moves with the body, it rotates e to R_e e, the desired direction
    of e. If e is fixed in space, it rotates R_eᵀ e to e, where R_eᵀ e is the present direction of
    the body axis that is e in the target. The two agree without roll; with roll each makes one full
    step exact. Rotations are one (3, 3) each, or many; the projector is in world axes.
    """
    error = target @ rotation.swapaxes(-1, -2)
    if projector.kind is ProjectorKind.NONE:
        return np.zeros(error.shape[:-1])
    if projector.kind is ProjectorKind.FULL:
        return rotation_vector(error)
    e = projector.axis
    assert e is not None
    if projector.kind is ProjectorKind.LINE:
        return twist_angle(error, e)[..., None] * e
    if moves_with_body:
        return geodesic(e, rotate(error, e))
    return geodesic(rotate(error.swapaxes(-1, -2), e), e)


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

    with Δω from :func:`angular_error` (the paper's section 2, with the swing–twist decomposition of
    the rotation that is left). R (3, 3) and p (3,), m, are those of the controlled frame in the
    world, R_d and p_d those of the target; the projector may be fixed to any frame. Other arrays
    raise :class:`~qp_twist.InvalidInput`.
    """
    instance("projector", projector, TwistProjector)
    return resolved_twist_error(
        rotation_matrix("rotation", rotation),
        finite_array("position", position, (3,)),
        rotation_matrix("target_rotation", target_rotation),
        finite_array("target_position", target_position, (3,)),
        projector,
    )[1]


def resolved_twist_error(
    rotation: Array,
    position: Array,
    target_rotation: Array,
    target_position: Array,
    projector: TwistProjector,
) -> tuple[TwistProjector, Array]:
    """T in world axes and Δt of :func:`twist_error`, of one pose or of many, without its checks.

    For K poses all shapes are preceded by K, those of the basis of T, too, if it depends on them.
    """
    world = projector.in_world(rotation, target_rotation)
    U = world.linear.basis
    linear = rotate(U, rotate(U.swapaxes(-1, -2), target_position - position))
    angular = angular_error(
        rotation, target_rotation, world.angular, moves_with_body=projector.frame == "body"
    )
    return world, np.concatenate([linear, angular], axis=-1)


def clamp_twist(twist: Array, max_linear: float = math.inf, max_angular: float = math.inf) -> Array:
    """``twist`` (6,) with its linear and angular parts clamped to some lengths, m and rad.

    A full 90° swing in one step overshoots, since the Jacobian is only valid locally. Directions
    are kept.
    """
    clamped = twist.copy()
    for part, longest in ((slice(3), max_linear), (slice(3, 6), max_angular)):
        length = math.hypot(*twist[part].tolist())
        if length > longest:
            clamped[part] *= longest / length
    return clamped
