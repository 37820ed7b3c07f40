"""The path of saturation in the null space: the step while the scale grows from 0."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array

INDEPENDENT = 1e-9
"""Orthonormal rows have full rank on a subset of joints if their singular values are above this."""
NEGLIGIBLE = 1e-13
"""Rates below this share of ‖c‖ are rounding."""
WHOLE = 1.0 - 1e-12
"""A larger scale is rounded to 1."""
CORNERS = 1000
"""Largest number of corners of the path; usual is about the number of joints."""


def saturation_path(
    Q: Array, c: Array, lower: Array, upper: Array, *, release: bool
) -> tuple[Array, float, npt.NDArray[np.bool_], bool]:
    r"""Follow x(s) with Q x = s c inside the bounds, from x(0) = 0 to the largest s ≤ 1.

    Between two corners the joints that are held at a bound do not move, and the free ones move by
    the pseudo-inverse of their columns. At a corner a free joint reaches a bound and is held.
    Without ``release`` the path ends where the remaining free joints can no longer do the task.

    With ``release`` x(s) is the shortest step all along,

    .. math::

        x(s) = \arg\min \tfrac12\lVert x\rVert^2 \quad\text{s.t.}\quad
        \mathbf Q x = s\,\mathbf c,\quad lower \le x \le upper, \qquad
        x + \mathbf Q^T\lambda + \mu = 0

    with μ ≥ 0 at upper bounds, ≤ 0 at lower ones and 0 for free joints: a held joint is released
    where its μ reaches zero. If the free joints cannot do the task without the joint to be held,
    some ηᵀQ is zero on all of them; μ may be shifted along it until that of a held joint is zero,
    which is released in exchange. If there is none, ηᵀQ x is at its largest inside the bounds,
    which proves that no larger s fits.

    This is the active-set homotopy of parametric quadratic programs (Ferreau, Bock and Diehl, Int.
    J. Robust and Nonlinear Control 18(8), 2008). With several corners at one s it might cycle in
    theory; it stops after ``CORNERS`` corners.

    Args:
        Q: Orthonormal rows, (r, n).
        c: Right-hand side, (r,).
        lower: At most 0, (n,).
        upper: At least 0, (n,).
        release: Whether held joints are released.

    Returns:
        x (n,), s, the joints held at a bound, and whether s is proven to be the largest.
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
    direction: Array = u[:, -1]
    return direction
