"""Saturation in the null space: the shortest step, with joints held at their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, float_array
from qp_twist.closed_form.optimal_saturation import WHOLE, largest_scale_path
from qp_twist.closed_form.rows import RANK_TOLERANCE, ProjectorLike, task_rows
from qp_twist.errors import InvalidInput


@dataclass(frozen=True, eq=False)
class Saturation:
    """What :func:`saturation_in_null_space` returns.

    Attributes:
        displacement: Δθ, inside the bounds to the last bit, shape (n,).
        scale: s in [0, 1], the share of the task that it does.
        saturated: Joints that are held at a bound, shape (n,).
        proven: Whether s is known to be the largest there is: always at s = 1, and in the optimal
            form unless it ran out of iterations. Where it is not, Δθ does s of the task inside the
            bounds all the same.
    """

    displacement: Array
    scale: float
    saturated: npt.NDArray[np.bool_]
    proven: bool


def saturation_in_null_space(
    jacobian: npt.ArrayLike,
    projector: ProjectorLike | None,
    twist: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    optimal: bool = False,
) -> Saturation:
    r"""The task within hard bounds on the joints, scaled where it does not fit.

    With A = T J, b = TΔt and W the diagonal matrix of ones for free and zeros for held joints,

    .. math::

        \Delta\theta = \Delta\theta_N + (\mathbf A\mathbf W)^\dagger
            (s\,\mathbf b - \mathbf A\,\Delta\theta_N),

    where Δθ_N has the held joints at their bounds and zeros elsewhere. Basic form (Flacco, De Luca
    and Khatib, "Control of redundant robots under hard joint constraints: saturation in the null
    space", IEEE Trans. Robotics 31(3), 2015): start with all joints free and s = 1; while a bound
    is exceeded, note the largest s that fits, hold the joint that allows the least, and try again.
    When the free joints can no longer do the task the best s noted is taken. A joint once held
    stays held, so neither the largest s nor the shortest Δθ is guaranteed.

    Optimal form (after Flacco and De Luca, "Optimal redundancy resolution with task scaling under
    hard bounds in the robot joint space", IEEE ICRA 2013): held joints whose multiplier has the
    wrong sign are released, so that Δθ is the shortest at the largest s. Here s grows from 0
    (:func:`~qp_twist.closed_form.optimal_saturation.largest_scale_path`): the joint that allows the
    least s is again the next to be held, and where the free joints cannot do the task without it,
    a held one is released in exchange, or there is proof that no larger s fits.

    Where the rows of A are dependent b counts with its part in their range, as with the
    pseudo-inverse: the rest is met by no displacement, at any scale.

    Args:
        jacobian: J, shape (6, n); (m, n) without a projector.
        projector: T of the task; ``None`` takes every row as it is.
        twist: Δt, shape (6,); (m,) without a projector.
        lower: Least displacement of each joint, at most 0, −∞ where there is none, shape (n,).
        upper: Largest displacement of each joint, at least 0, +∞ where there is none, shape (n,).
        optimal: The optimal form instead of the basic one.

    Raises:
        InvalidInput: If a shape is wrong, an entry is not a number, or the bounds exclude 0.

    Example:
        >>> result = saturation_in_null_space([[2.0, 1.0]], None, [3.0], [-1, -1], [1, 1])
        >>> result.displacement, result.scale, result.saturated
        (array([1., 1.]), 1.0, array([ True, False]))
    """
    A, b = task_rows(jacobian, projector, twist)
    low, high = _bounds(lower, upper, A.shape[1])
    # Orthonormal rows of the same span: V_rᵀ Δθ = S_r⁻¹ U_rᵀ b = c.
    u, sigma, vt = np.linalg.svd(A, full_matrices=False)
    rank = int((sigma > RANK_TOLERANCE * sigma.max(initial=0.0)).sum())
    Q, c = vt[:rank], (u.T @ b)[:rank] / sigma[:rank]
    step, scale, held, proven = (largest_scale_path if optimal else _saturate)(Q, c, low, high)
    return Saturation(np.clip(step, low, high), scale, held, proven)


def _bounds(lower: npt.ArrayLike, upper: npt.ArrayLike, n: int) -> tuple[Array, Array]:
    low, high = float_array("lower", lower), float_array("upper", upper)
    for name, bound, right in (("lower", low, low <= 0.0), ("upper", high, high >= 0.0)):
        if bound.shape != (n,) or not right.all():
            raise InvalidInput(
                f"{name}: expected {n} bounds with 0 between lower and upper, got "
                f"{bound.tolist()}. A joint outside its limits may be given the bound 0 there."
            )
    return low, high


def _saturate(
    Q: Array, c: Array, lower: Array, upper: Array
) -> tuple[Array, float, npt.NDArray[np.bool_], bool]:
    """The basic form, on orthonormal rows Q Δθ = s c."""
    n = Q.shape[1]
    free = np.ones(n, dtype=np.bool_)
    best = (np.zeros(n), 0.0, ~free, False)
    offset = np.zeros(n)
    while np.linalg.matrix_rank(Q[:, free], tol=RANK_TOLERANCE) == len(Q):
        inverse = np.linalg.pinv(Q[:, free])
        # Δθ = offset + s slope
        slope = np.zeros(n)
        slope[free] = inverse @ c
        offset[free] = -inverse @ (Q[:, ~free] @ offset[~free])
        least, most = _fitting_scales(offset, slope, lower, upper)
        outside = (most < WHOLE) | (least > 2.0 - WHOLE)
        if not outside.any():
            return offset + slope, 1.0, ~free, True
        critical = int(np.argmin(np.where(outside, most, np.inf)))
        free[critical] = False
        if max(0.0, least.max()) <= most.min() and most.min() > best[1]:
            scale = float(most.min())
            best = (offset + scale * slope, scale, ~free, False)
        above = offset[critical] + slope[critical] > upper[critical]
        offset = np.where(free, 0.0, offset)
        offset[critical] = upper[critical] if above else lower[critical]
    return best


def _fitting_scales(offset: Array, slope: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """For each joint the least and the largest s with lower ≤ offset + s slope ≤ upper."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at_lower, at_upper = (lower - offset) / slope, (upper - offset) / slope
    inside = (lower <= offset) & (offset <= upper)
    # A joint that s does not move fits at every s or at none.
    still = slope == 0.0
    least = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(at_lower, at_upper))
    most = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(at_lower, at_upper))
    return least, most
