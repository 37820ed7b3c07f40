r"""The paper's resolutions of one step, as plain functions of arrays.

All take displacements: Δt (6,) is the twist to the target, in m and rad, the result Δθ (n,) the
joint displacement of one step, and h (n,) a desired one. J is 6 × n, rows (linear, angular) in
world axes; T, the projector of the task, is a :class:`~qp_twist.geometry.TwistProjector` in world
axes or its 6 × 6 matrix. What has another shape, is not finite or not in world axes raises
:class:`~qp_twist.InvalidInput`.

The paper's J† = Jᵀ(JJᵀ)⁻¹ needs full row rank, which the 6 × 3 Jacobian of a planar arm lacks. Here
J† is the Moore–Penrose inverse of T_O J, the operational rows: the same matrix where the paper's
exists, and the least-squares answer where the arm has fewer joints than operational rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector

ProjectorLike = TwistProjector | npt.ArrayLike

RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""


def projector_matrix(name: str, projector: ProjectorLike | None) -> Array:
    """T as a 6 × 6 matrix in world axes; the identity if ``None``."""
    if projector is None:
        return np.eye(6)
    if isinstance(projector, TwistProjector):
        if projector.frame != "world":
            raise InvalidInput(
                f"{name}: this projector is fixed to the {projector.frame} frame; pass "
                "projector.resolved(body=R, target=R_d), which is in world axes."
            )
        return projector.matrix
    return finite_array(name, projector, (6, 6))


def task_rows(
    jacobian: npt.ArrayLike, projector: ProjectorLike | None, twist: npt.ArrayLike
) -> tuple[Array, Array]:
    """A and b of the task A Δθ = b: T J and TΔt, or any rows J (m, n) and Δt (m,) without T.

    Raises:
        InvalidInput: If a shape is wrong, an entry is not finite, or T is not in world axes.
    """
    j = finite_array("jacobian", jacobian, (None if projector is None else 6, None))
    dt = finite_array("twist", twist, (j.shape[0],))
    if projector is None:
        return j, dt
    t = projector_matrix("projector", projector)
    return t @ j, t @ dt


def resolved_motion_rate(
    jacobian: npt.ArrayLike, twist: npt.ArrayLike, operational: ProjectorLike | None = None
) -> Array:
    r"""The whole operational twist, no redundancy (paper, eq. *inverse*).

    .. math:: \Delta\theta = \mathbf J^{-1}\Delta\mathbf t

    The minimum-norm solution for n > n_o, least squares for n < n_o; T_O is full if ``None``.
    """
    return minimum_norm(jacobian, projector_matrix("operational", operational), twist)


def minimum_norm(jacobian: npt.ArrayLike, projector: ProjectorLike, twist: npt.ArrayLike) -> Array:
    r"""The minimum-norm joint displacement of the task: the first term of eq. *general*.

    .. math:: \Delta\theta = (\mathbf T\mathbf J)^\dagger \mathbf T\Delta\mathbf t
    """
    A, b = task_rows(jacobian, projector, twist)
    return np.linalg.pinv(A) @ b


def gradient_projection(
    jacobian: npt.ArrayLike, projector: ProjectorLike, twist: npt.ArrayLike, h: npt.ArrayLike
) -> Array:
    r"""Minimum norm plus h (n,) projected on the null space of the rows (paper, eq. *general*).

    .. math::

        \Delta\theta = (\mathbf T\mathbf J)^\dagger \mathbf T\Delta\mathbf t
        + (\mathbf 1 - (\mathbf T\mathbf J)^\dagger \mathbf T\mathbf J)\,\mathbf h

    The projector is orthogonal, so a step along h = −∇z never raises z to first order (Liégeois,
    IEEE Trans. SMC 7(12), 1977).
    """
    A, b = task_rows(jacobian, projector, twist)
    desired = finite_array("h", h, (A.shape[1],))
    inverse = np.linalg.pinv(A)
    return inverse @ b + desired - inverse @ (A @ desired)


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

    With an operational T_O, which is full if ``None``, J† is the inverse of T_O J, and 1 − T is
    T_O − T.
    """
    j = finite_array("jacobian", jacobian, (6, None))
    dt = finite_array("twist", twist, (6,))
    t = projector_matrix("projector", projector)
    t_o = projector_matrix("operational", operational)
    desired = finite_array("h", h, (j.shape[1],))
    inverse = np.linalg.pinv(t_o @ j)
    step = inverse @ (t @ dt) + inverse @ ((t_o - t) @ j @ desired)
    if manipulator_redundancy:
        step = step + desired - inverse @ (t_o @ j @ desired)
    return step


BY_METHOD: dict[str, Callable[[Array, TwistProjector, Array, Array, TwistProjector], Array]] = {
    "rmr": lambda J, T, twist, h, whole: resolved_motion_rate(J, twist, whole),
    "rmr_flipped": lambda J, T, twist, h, whole: resolved_motion_rate(J, twist, whole),
    "minimum_norm": lambda J, T, twist, h, whole: minimum_norm(J, T, twist),
    "gradient_projection": lambda J, T, twist, h, whole: gradient_projection(J, T, twist, h),
    "twa": lambda J, T, twist, h, whole: twa(J, T, twist, h, operational=whole),
}
"""The resolution of a method, of J, T, Δt, h and T_O; a method has its name and its settings in
``paths/methods.py``."""
