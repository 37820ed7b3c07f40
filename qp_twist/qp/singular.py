"""Task rows near a singularity: what the arm can no longer do, and what it still does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf

from qp_twist.checks import Array
from qp_twist.qp.active_set import null_basis
from qp_twist.qp.verification import row_tolerance

_GONE = 1e-3
"""Below this share of the threshold a direction is left to the secondary objectives."""


@dataclass(frozen=True, eq=False)
class LostDirection:
    r"""A direction of the task in which the arm is singular.

    Attributes:
        sigma: Singular value of the task rows in this direction.
        direction: Unit vector in the task rows, in the order of ``Step.residuals``, (m,).
        share: Share of the speed asked for that is kept, σ²/threshold².
        missing: Speed that is not delivered, m/s or rad/s; of a scaled step: of the scaled speed.
            Where limits leave the slowed direction less than its share, it is more.
        where: The direction in words: a task, and its part of the twist in world axes.
    """

    sigma: float
    direction: Array
    share: float
    missing: float
    where: str = "a direction of the rows"

    def __str__(self) -> str:
        return f"{self.where} at σ = {self.sigma:.2g}"


@dataclass(eq=False)
class RegularRows:
    """Task rows that a bounded velocity can meet.

    Attributes:
        A: Rows of the regular directions, (m', n).
        b: Their right-hand side, (m',).
        damped: Rows of the singular directions, slowed down, (k, n).
        damped_b: Their right-hand side, (k,).
        lost: Directions in which less is asked of the arm than the task wants.
        given: The rows as given, in the null space of those above them.
    """

    A: Array
    b: Array
    damped: Array
    damped_b: Array
    lost: tuple[LostDirection, ...]
    given: Array

    @cached_property
    def sigma_min(self) -> float:
        """Smallest singular value of the rows as given; ∞ without rows."""
        m, n = self.given.shape
        if m > n:
            return 0.0
        return float(np.linalg.svd(self.given, compute_uv=False)[-1]) if m else np.inf


def regular_rows(
    A: Array, b: Array, threshold: float, *, above: tuple[Array, Array] | None = None
) -> RegularRows:
    r"""Slow the task down in its singular directions only.

    With A = Σ σᵢ uᵢ vᵢᵀ the rows σᵢ vᵢᵀ x = uᵢᵀ b of the directions with σᵢ ≥ ε stay as they are.
    Below it,

    .. math:: v_i^T x = \frac{\sigma_i}{\varepsilon^2} u_i^T \mathbf b ,

    which is the damped inverse σ/(σ² + λ²) with λ² = ε² − σ² (Nakamura and Hanafusa 1986, with the
    damping in the singular directions only: Maciejewski and Klein 1988). It is continuous at ε, at
    most 1/ε times the speed asked for, and fades to zero at the singularity itself. There the
    direction is free, so that a secondary objective can lead the arm out.

    Args:
        A: Task rows, (m, n).
        b: Right-hand side, (m,).
        threshold: ε; 0 leaves the rows alone.
        above: Rows and right-hand side of the levels above, which these rows must not touch: the
            singular directions are then those of A in their null space (algorithmic
            singularities).
    """
    m, n = len(b), A.shape[1]
    none = np.zeros((0, n)), np.zeros(0)
    if m == 0:
        return RegularRows(A, b, *none, (), A)
    if above is None and m <= n and _clearly_regular(A, threshold):  # nearly always
        return RegularRows(A, b, *none, (), A)
    basis, rate = np.eye(n), b
    if above is not None:
        lengths = np.linalg.norm(above[0], axis=1)
        lengths[lengths == 0.0] = 1.0
        held = above[0] / lengths[:, None]
        basis = null_basis(held, n)
        rate = b - A @ (np.linalg.pinv(held) @ (above[1] / lengths))
    given = A @ basis
    left, sigma, right = np.linalg.svd(given)
    sigma = np.concatenate([sigma, np.zeros(m - len(sigma))])
    singular = np.flatnonzero(sigma < threshold)
    if not len(singular):
        return RegularRows(A, b, *none, (), given)
    first = int(singular[0])
    rate = left.T @ rate
    regular = left[:, :first].T
    kept, sides = [none[0]], [none[1]]
    lost = []
    noticeable = row_tolerance(A, b)
    for i in singular:
        share = (sigma[i] / threshold) ** 2
        missing = float((1.0 - share) * abs(rate[i]))
        if missing > noticeable:
            lost.append(LostDirection(float(sigma[i]), left[:, i].copy(), float(share), missing))
        if sigma[i] > _GONE * threshold:
            kept.append(right[i : i + 1] @ basis.T)
            sides.append(np.array([sigma[i] / threshold**2 * rate[i]]))
    return RegularRows(
        regular @ A,
        regular @ b,
        np.vstack(kept),
        np.concatenate(sides),
        tuple(lost),
        given,
    )


def _clearly_regular(A: Array, threshold: float) -> bool:
    """Whether all singular values are above a threshold, beyond doubt: A Aᵀ − t² 1 has a root.

    Rounding takes less than 1e-13 of the trace from A Aᵀ; a tenth of the cost of the values.
    """
    gram = A @ A.T
    gram.reshape(-1)[:: len(A) + 1] -= threshold**2 + 1e-13 * gram.trace()
    singular: int = dpotrf(gram, overwrite_a=True)[1]
    return not singular
