"""The least-norm step in a weighted metric, and weights that avoid the joint limits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, float_array
from qp_twist.closed_form.resolutions import RANK_TOLERANCE, ProjectorLike, task_rows
from qp_twist.errors import InvalidInput

NEAREST = 1e-4
"""Distance from a limit, as a share of the range, at which a joint counts as at the limit."""


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

    with A = T J, b = TΔt and W diagonal and positive (Chan and Dubey, IEEE Trans. Robotics and
    Automation 11(2), 1995). With :func:`joint_limit_weights` a joint that approaches a limit is
    slowed down; it still crosses the limit if the task requires it. Rows that contradict each other
    are met in least squares. Without a projector (``None``) A and b are any rows J (m, n) and Δt
    (m,). Other arguments raise :class:`~qp_twist.InvalidInput`.

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
    return np.asarray(scale * (np.linalg.pinv(A * scale, rcond=RANK_TOLERANCE) @ b))


def joint_limit_gradient(q: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike) -> Array:
    r"""Gradient of Chan and Dubey's distance from the joint limits.

    .. math::

        H(\theta) = \sum_i \frac14 \frac{(\theta_{max,i} - \theta_{min,i})^2}
            {(\theta_{max,i} - \theta_i)(\theta_i - \theta_{min,i})}

    H is infinite at a limit and undefined outside. From a distance of 10⁻⁴ of the range on, the
    gradient is therefore its value there, 2.5 · 10⁷ over the range, times one plus the share of the
    range beyond: large, finite, and decreasing on the way back.

    Arguments are θ, θ_min and θ_max, rad or m, (n,) each, ±∞ where there is none; the result is
    ∂H/∂θ, 1/rad or 1/m, (n,), 0 for a joint without two finite limits or without range.
    """
    theta = finite_array("q", q, (None,))
    low, high = (float_array(n, v) for n, v in (("lower", lower), ("upper", upper)))
    if low.shape != theta.shape or high.shape != theta.shape or not (low <= high).all():
        raise InvalidInput(
            f"lower, upper: expected {len(theta)} numbers each, none of lower above upper; got "
            f"{low.tolist()} and {high.tolist()}."
        )
    limited = np.isfinite(low) & np.isfinite(high) & (low < high)
    low, high = np.where(limited, low, 0.0), np.where(limited, high, 1.0)
    width = high - low
    share = np.where(limited, (theta - low) / width, 0.5)
    inside = np.clip(share, NEAREST, 1.0 - NEAREST)
    gradient: Array = (2.0 * inside - 1.0) / (4.0 * (inside * (1.0 - inside)) ** 2 * width)
    gradient *= 1.0 + np.abs(share - inside)
    return gradient


def joint_limit_weights(
    q: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    previous_gradient: npt.ArrayLike | None = None,
) -> Array:
    r"""Weights for :func:`weighted_least_norm` that slow down joints approaching a limit.

    .. math::

        w_i = \begin{cases}
            1 + |g_i| & \text{if } |g_i| \ge |g_i|_{previous}\\
            1 & \text{otherwise}
        \end{cases}, \qquad
        \mathbf g = \partial H/\partial\theta

    A joint that moves away from a limit, or has none, has weight 1. Arguments and errors are those
    of :func:`joint_limit_gradient`; the result is the diagonal of W, (n,). ``previous_gradient`` is
    ∂H/∂θ at the last step, (n,); ``None`` at the first step, where every joint counts as
    approaching the nearer limit.
    """
    slope = np.abs(joint_limit_gradient(q, lower, upper))
    if previous_gradient is None:
        return 1.0 + slope
    before = np.abs(finite_array("previous_gradient", previous_gradient, slope.shape))
    return np.where(slope >= before, 1.0 + slope, 1.0)
