"""Saturation in the null space: the shortest step, with joints held at their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask, float_array
from qp_twist.closed_form.resolutions import RANK_TOLERANCE, ProjectorLike, task_rows
from qp_twist.errors import InvalidInput
from qp_twist.qp.verification import row_tolerance

INDEPENDENT = 1e-9
"""Orthonormal rows have full rank on a subset of joints if their singular values are above this."""
NEGLIGIBLE = 1e-13
"""Rates below this share of ‖c‖ are rounding."""
WHOLE = 1.0 - 1e-12
"""A larger scale is rounded to 1."""
CORNERS = 1000
"""Largest number of corners of the path; usual is about the number of joints."""


@dataclass(frozen=True, eq=False)
class Saturation:
    """Result of :func:`saturation_in_null_space`."""

    displacement: Array
    """Δθ, exactly inside the bounds, shape (n,)."""
    scale: float
    """s in [0, 1], the scale of the task."""
    saturated: Mask
    """Joints that are held at a bound, shape (n,)."""
    proven: bool
    """Whether s is known to be the largest feasible scale. It is at s = 1, in the basic form if
    releasing a joint would not help, in the optimal form unless the iterations ran out."""


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
    and Khatib, IEEE Trans. Robotics 31(3), 2015): start with all joints free; while a bound is
    exceeded at s = 1, hold the joint that allows the least s at its bound, until the free joints
    can no longer do the task. Joints are never released, so neither the largest s nor the shortest
    Δθ is guaranteed. Optimal form (after Flacco and De Luca, IEEE ICRA 2013): held joints whose
    multiplier has the wrong sign are released, so that Δθ is the shortest at the largest s. Both
    are computed by increasing s from 0.

    For dependent rows of A only the part of b in their range counts, as with the pseudo-inverse. A
    task whose residual due to bounds is at most 1e-8 (longest row of A + max |b|) counts as met.
    Without a projector (``None``) A and b are any rows J (m, n) and Δt (m,). The bounds (n,) are
    displacements around 0, ±∞ where there is none; other bounds raise
    :class:`~qp_twist.InvalidInput`.

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


def saturation_path(
    Q: Array, c: Array, lower: Array, upper: Array, *, release: bool
) -> tuple[Array, float, Mask, bool]:
    r"""Follow x(s) with Q x = s c inside the bounds, from x(0) = 0 to the largest s ≤ 1.

    Between two corners the joints that are held at a bound do not move, and the free ones move by
    the pseudo-inverse of their columns. At a corner a free joint reaches a bound and is held.
    Without ``release`` the path ends where the remaining free joints can no longer do the task.

    With ``release`` x(s) is the shortest step all along,

    .. math::

        x(s) = \arg\min \tfrac12\lVert x\rVert^2 \;\text{ s.t. }\; \mathbf Q x = s\,\mathbf c,\;
        lower \le x \le upper, \qquad x + \mathbf Q^T\lambda + \mu = 0

    with μ ≥ 0 at upper bounds, ≤ 0 at lower ones and 0 for free joints: a held joint is released
    where its μ reaches zero. If the free joints cannot do the task without the joint to be held,
    some ηᵀQ is zero on all of them; μ may be shifted along it until that of a held joint is zero,
    which is released in exchange. If there is none, ηᵀQ x is at its largest inside the bounds,
    which proves that no larger s fits.

    This is the active-set homotopy of Ferreau, Bock and Diehl (Int. J. Robust and Nonlinear Control
    18(8), 2008). Q (r, n) has orthonormal rows, and lower ≤ 0 ≤ upper. Returned are x (n,), s, the
    joints held at a bound, and whether s is proven to be the largest.
    """
    n = Q.shape[1]
    negligible = NEGLIGIBLE * float(np.linalg.norm(c))
    side = np.zeros(n, dtype=np.int_)  # +1 held at upper, −1 at lower, 0 free
    s = 0.0
    x = np.zeros(n)
    for _ in range(CORNERS):
        free = side == 0
        inverse = np.linalg.pinv(Q[:, free])
        # While the same joints are held: x = x_0 + s x_1 and μ = μ_0 + s μ_1.
        x_0 = np.where(side > 0, upper, np.where(side < 0, lower, 0.0))
        x_1 = np.zeros(n)
        x_0[free], x_1[free] = -inverse @ (Q[:, ~free] @ x_0[~free]), inverse @ c
        mu_0, mu_1 = ((inverse @ Q).T @ part[free] - part for part in (x_0, x_1))
        corner = np.full(n, np.inf)
        moving = free & (np.abs(x_1) > negligible)
        bound = np.where(x_1 > 0.0, upper, lower)
        corner[moving] = (bound - x_0)[moving] / x_1[moving]
        losing = release & (side * mu_1 < -negligible)
        corner[losing] = -mu_0[losing] / mu_1[losing]
        if corner.min(initial=np.inf) >= WHOLE:
            return x_0 + x_1, 1.0, ~free, True
        # Corners at the same s are processed one after the other, by index.
        corner = np.maximum(corner, s)
        joint = int(np.argmin(corner))
        s = float(corner[joint])
        x = x_0 + s * x_1
        if side[joint]:
            side[joint] = 0
            continue
        toward = 1 if x_1[joint] > 0.0 else -1
        free[joint] = False
        eta = _unseen_by(Q[:, free])
        if eta is not None:
            shift = -eta @ Q
            shift *= toward * np.sign(shift[joint])
            giving = side * shift < -INDEPENDENT
            if not (release and giving.any()):
                return x, s, ~free, not giving.any()
            room = np.full(n, np.inf)
            room[giving] = np.maximum(-(mu_0 + s * mu_1)[giving] / shift[giving], 0.0)
            side[int(np.argmin(room))] = 0
        side[joint] = toward
    return x, s, side != 0, False


def _unseen_by(columns: Array) -> Array | None:
    """A unit η with ηᵀ columns = 0, or ``None`` if the columns have full row rank."""
    u, sigma, _ = np.linalg.svd(columns)
    if len(sigma) == len(columns) and sigma.min(initial=1.0) > INDEPENDENT:
        return None
    return u[:, -1]
