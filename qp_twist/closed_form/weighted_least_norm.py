"""The least-norm step in a weighted metric."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.closed_form.rows import RANK_TOLERANCE, ProjectorLike, task_rows
from qp_twist.errors import InvalidInput


def weighted_least_norm(
    jacobian: npt.ArrayLike,
    projector: ProjectorLike | None,
    twist: npt.ArrayLike,
    weight: npt.ArrayLike,
) -> Array:
    r"""The joint displacement of least weighted norm for the task.

    .. math::

        \min \tfrac12 \Delta\theta^T \mathbf W \Delta\theta
        \;\text{ s.t. }\; \mathbf A\Delta\theta = \mathbf b:
        \qquad
        \Delta\theta = \mathbf W^{-1/2} (\mathbf A \mathbf W^{-1/2})^\dagger\, \mathbf b
        = \mathbf W^{-1}\mathbf A^T(\mathbf A\mathbf W^{-1}\mathbf A^T)^{-1}\mathbf b

    with A = T J, b = TΔt and W diagonal. Chan and Dubey, "A weighted least-norm solution based
    scheme for avoiding joint limits for redundant joint manipulators", IEEE Trans. Robotics and
    Automation 11(2), 1995. With :func:`joint_limit_weights` a joint that approaches a limit is
    slowed down; it still crosses the limit if the task requires it.

    The inverse is Moore–Penrose: rows that contradict each other are met in least squares.

    Args:
        jacobian: J, shape (6, n); (m, n) without a projector.
        projector: T of the task; ``None`` for all rows.
        twist: Δt, shape (6,); (m,) without a projector.
        weight: Diagonal of W, positive, shape (n,).

    Returns:
        Δθ, shape (n,).

    Raises:
        InvalidInput: If a shape is wrong, an entry is not finite, or a weight is not positive.

    Example:
        >>> weighted_least_norm([[1.0, 1.0]], None, [1.0], weight=[1.0, 3.0])
        array([0.75, 0.25])
    """
    A, b = task_rows(jacobian, projector, twist)
    w = finite_array("weight", weight, (A.shape[1],))
    if not (w > 0.0).all():
        raise InvalidInput(f"weight: every entry must be above 0, got {w.tolist()}.")
    # Only the ratios count: relative to the lightest joint no entry can overflow.
    scale = np.sqrt(w.min(initial=np.inf) / w)
    step: Array = scale * (np.linalg.pinv(A * scale, rcond=RANK_TOLERANCE) @ b)
    return step
