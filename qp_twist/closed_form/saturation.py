"""Saturation in the null space: the shortest step, with joints held at their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, float_array
from qp_twist.closed_form.rows import RANK_TOLERANCE, ProjectorLike, task_rows
from qp_twist.closed_form.saturation_path import saturation_path
from qp_twist.errors import InvalidInput
from qp_twist.qp.verification import row_tolerance


@dataclass(frozen=True, eq=False)
class Saturation:
    """Result of :func:`saturation_in_null_space`.

    Attributes:
        displacement: Δθ, exactly inside the bounds, shape (n,).
        scale: s in [0, 1], the scale of the task.
        saturated: Joints that are held at a bound, shape (n,).
        proven: Whether s is known to be the largest feasible scale: always at s = 1; in the basic
            form also if releasing a joint would not help; in the optimal form unless the iterations
            ran out. In any case Δθ is feasible and does s times the task.
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
    r"""The task within hard bounds on the joints, scaled if infeasible.

    With A = T J, b = TΔt and W the diagonal matrix of ones for free and zeros for held joints,

    .. math::

        \Delta\theta = \Delta\theta_N + (\mathbf A\mathbf W)^\dagger
            (s\,\mathbf b - \mathbf A\,\Delta\theta_N),

    where Δθ_N has the held joints at their bounds and zeros elsewhere. Basic form (Flacco, De Luca
    and Khatib, "Control of redundant robots under hard joint constraints: saturation in the null
    space", IEEE Trans. Robotics 31(3), 2015): start with all joints free; while a bound is exceeded
    at s = 1, hold the joint that allows the least s at its bound. It ends when the free joints can
    no longer do the task. Joints are never released, so neither the largest s nor the shortest Δθ
    is guaranteed.

    Optimal form (after Flacco and De Luca, "Optimal redundancy resolution with task scaling under
    hard bounds in the robot joint space", IEEE ICRA 2013): held joints whose multiplier has the
    wrong sign are released, so that Δθ is the shortest at the largest s.

    Both are computed by increasing s from 0
    (:func:`~qp_twist.closed_form.saturation_path.saturation_path`). For the basic form this is
    equivalent: when the joint that allows the least s is held, Δθ at this s does not change, so
    each trial continues where the previous one ended. For the optimal form it proves the largest s.

    For dependent rows of A only the part of b in their range counts, as with the pseudo-inverse: no
    displacement meets the rest. A task whose residual due to bounds is at most 1e-8 (longest row of
    A + max |b|) counts as met, with scale 1.

    Args:
        jacobian: J, shape (6, n); (m, n) without a projector.
        projector: T of the task; ``None`` for all rows.
        twist: Δt, shape (6,); (m,) without a projector.
        lower: Smallest displacement of each joint, at most 0, −∞ without a bound, shape (n,).
        upper: Largest displacement of each joint, at least 0, +∞ without a bound, shape (n,).
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
    step, scale, held, proven = saturation_path(Q, c, low, high, release=optimal)
    if scale < 1.0:
        closest = np.clip(c @ Q, low, high)
        if np.linalg.norm(A @ (closest - c @ Q)) <= row_tolerance(A, b):
            # The task is met up to rounding, with a joint at its bound.
            return Saturation(closest, 1.0, closest != c @ Q, True)
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
