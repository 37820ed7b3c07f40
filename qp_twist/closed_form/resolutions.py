r"""The paper's resolutions of one step, as plain functions of arrays.

All take displacements: Δt (6,) is the twist to the target, in m and rad, and the result Δθ (n,) the
joint displacement of one step. J is 6 × n, rows (linear, angular) in world axes; T is a
:class:`~qp_twist.geometry.TwistProjector` in world axes or its 6 × 6 matrix.

The paper's J† = Jᵀ(JJᵀ)⁻¹ needs full row rank, which the 6 × 3 Jacobian of a planar arm lacks. Here
J† is the Moore–Penrose inverse of T_O J, the operational rows: the same matrix where the paper's
exists, and the least-squares answer where the arm has fewer joints than operational rows.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.closed_form.rows import ProjectorLike, projector_matrix


def resolved_motion_rate(
    jacobian: npt.ArrayLike, twist: npt.ArrayLike, operational: ProjectorLike | None = None
) -> Array:
    r"""The whole operational twist, no redundancy (paper, eq. *inverse*).

    .. math:: \Delta\theta = \mathbf J^{-1}\Delta\mathbf t

    Args:
        jacobian: J, shape (6, n).
        twist: Δt, shape (6,).
        operational: T_O; full if ``None``.

    Returns:
        Δθ, shape (n,). For n > n_o it is the minimum-norm solution, for n < n_o least squares.
    """
    j, dt = _step(jacobian, twist)
    t_o = projector_matrix("operational", operational)
    return np.linalg.pinv(t_o @ j) @ (t_o @ dt)


def minimum_norm(jacobian: npt.ArrayLike, projector: ProjectorLike, twist: npt.ArrayLike) -> Array:
    r"""The minimum-norm joint displacement of the task.

    .. math:: \Delta\theta = (\mathbf T\mathbf J)^\dagger \mathbf T\Delta\mathbf t

    The first term of the paper's eq. *general* on the task's rows.

    Args:
        jacobian: J, shape (6, n).
        projector: T of the task.
        twist: Δt, shape (6,).
    """
    j, dt = _step(jacobian, twist)
    t = projector_matrix("projector", projector)
    return np.linalg.pinv(t @ j) @ (t @ dt)


def gradient_projection(
    jacobian: npt.ArrayLike, projector: ProjectorLike, twist: npt.ArrayLike, h: npt.ArrayLike
) -> Array:
    r"""Minimum norm plus h projected on the null space of the task's rows (paper, eq. *general*).

    .. math::

        \Delta\theta = (\mathbf T\mathbf J)^\dagger \mathbf T\Delta\mathbf t
        + (\mathbf 1 - (\mathbf T\mathbf J)^\dagger \mathbf T\mathbf J)\,\mathbf h

    The projector is orthogonal, so a step along h = −∇z never raises z to first order (Liégeois,
    IEEE Trans. SMC 7(12), 1977).

    Args:
        jacobian: J, shape (6, n).
        projector: T of the task.
        twist: Δt, shape (6,).
        h: Desired joint displacement, shape (n,).
    """
    j, dt = _step(jacobian, twist)
    t = projector_matrix("projector", projector)
    desired = finite_array("h", h, (j.shape[1],))
    inverse = np.linalg.pinv(t @ j)
    return inverse @ (t @ dt) + desired - inverse @ (t @ j @ desired)


def twa(
    jacobian: npt.ArrayLike,
    projector: ProjectorLike,
    twist: npt.ArrayLike,
    h: npt.ArrayLike,
    *,
    operational: ProjectorLike | None = None,
    manipulator_redundancy: bool = False,
) -> Array:
    r"""The twist decomposition of Baron and Chablat (paper, eq. *liguo*).

    .. math::

        \Delta\theta = \mathbf J^\dagger \mathbf T\Delta\mathbf t
        + \mathbf J^\dagger(\mathbf 1 - \mathbf T)\mathbf J\,\mathbf h

    For n > n_o the equation leaves the manipulator's own redundancy unused. With
    ``manipulator_redundancy`` the null space of J is added, and the secondary term becomes

    .. math::

        \mathbf J^\dagger(\mathbf 1-\mathbf T)\mathbf J\mathbf h
        + (\mathbf 1 - \mathbf J^\dagger\mathbf J)\mathbf h
        = (\mathbf 1 - \mathbf J^\dagger\mathbf T\mathbf J)\mathbf h .

    J†(1 − T)J is an oblique projector: the step may raise z. It is singular wherever J is, also
    where TJ keeps its rank. For n < n_o a twist inside T is in general out of the arm's reach, and
    the first term is the least-squares answer over all operational rows.

    Args:
        jacobian: J, shape (6, n).
        projector: T of the task.
        twist: Δt, shape (6,).
        h: Desired joint displacement, shape (n,).
        operational: T_O; full if ``None``. J† is the inverse of T_O J, and 1 − T is T_O − T.
        manipulator_redundancy: Add (1 − J†J) h.
    """
    j, dt = _step(jacobian, twist)
    t = projector_matrix("projector", projector)
    t_o = projector_matrix("operational", operational)
    desired = finite_array("h", h, (j.shape[1],))
    inverse = np.linalg.pinv(t_o @ j)
    step = inverse @ (t @ dt) + inverse @ ((t_o - t) @ j @ desired)
    if manipulator_redundancy:
        step = step + desired - inverse @ (t_o @ j @ desired)
    return step


def _step(jacobian: npt.ArrayLike, twist: npt.ArrayLike) -> tuple[Array, Array]:
    return finite_array("jacobian", jacobian, (6, None)), finite_array("twist", twist, (6,))
