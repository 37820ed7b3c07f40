r"""The rows of a priority level in their singular directions, and which of them are weak.

With A = Σ σᵢ uᵢ vᵢᵀ a level asks for :math:`\sigma_i v_i^T\dot{\mathbf q} = \beta_i`, with
:math:`\beta_i = u_i^T\mathbf b`. Near a singularity or the edge of the reach a σᵢ vanishes, and an
error that the arm cannot remove would be divided by it again and again. Such a direction is met by
the damped inverse

.. math::

    v_i^T\dot{\mathbf q} = \frac{\sigma_i}{d_i}\beta_i, \qquad d_i = \sigma_i^2 + \lambda_i
    = \max(\sigma_i^2,\ \varepsilon^2,\ t), \\
    t = \max\bigl(\sigma_1^2\min(1, T/dt),\ \ell\,dt\,\lVert w_i\beta_i\rVert\bigr), \qquad
    w_i = \max(0,\ 1 - \sigma_i^2/\sigma_1^2)^3

(Nakamura and Hanafusa 1986; Maciejewski and Klein 1988 with damping in the singular directions
only), and all others exactly. With the error that t grows with, a weak direction moves by at most
σ/ℓ in one step, so that the arm does not leap over the singularity; ℓ bounds how fast a small
singular value changes with the joints. In the program a weak direction is a cost,
½ (σᵢvᵢᵀq̇ − βᵢ)²/λᵢ beside ½‖q̇‖², whose minimum the damped inverse is. At a singularity it
vanishes, and the secondary has the direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.kernel.constants import (
    BEND,
    DEPENDENT,
    EQUALITY_TOLERANCE,
    MOST_REGULAR,
    REGULAR,
    SMOOTHED,
)
from qp_twist.qp.problem import widened
from qp_twist.qp.verification import row_tolerance


@dataclass(frozen=True, eq=False)
class LostDirection:
    """A direction of the task in which less is delivered than it asks."""

    sigma: float
    """Singular value of the task rows in this direction."""
    direction: Array
    """Unit vector in the task rows, in the order of ``Step.residuals``, (m,)."""
    share: float
    """Share of the speed asked for that is delivered."""
    missing: float
    """Speed that is not delivered, m/s or rad/s; of a scaled step: of the scaled speed."""
    where: str = "a direction of the rows"
    """In words: a task, and its part of the twist in world axes."""

    def __str__(self) -> str:
        return f"{self.where} at σ = {self.sigma:.2g}"


@dataclass(frozen=True, eq=False)
class Directions:
    """A level's rows, rotated to their singular directions."""

    left: Array
    """U, (m, m)."""
    sigma: Array
    """σ, (m,), 0 beyond the n-th."""
    rows: Array
    """σᵢ vᵢᵀ on what the levels above leave, (m, n)."""
    rate: Array
    """β, m/s and rad/s, (m,)."""
    damped: Array
    """d, (m,)."""
    floor: Array
    """max(σ², ε²), of rounding no smaller than 1e-10 of ``size``, (m,)."""
    size: float
    """The largest singular value of the rows as stated."""
    threshold: float
    """ε."""
    nulls: Array
    """Orthonormal basis of what this level and those above leave, (n, p)."""
    smooth: bool
    """Whether the step has to change little with its data: see ``qp.one_program``."""

    @classmethod
    def of(
        cls,
        A: Array,
        b: Array,
        dt: float,
        threshold: float,
        *,
        damp: bool = True,
        smooth: bool = True,
        null: Array | None = None,
        above: Array | None = None,
    ) -> Directions:
        """Rotate the rows A q̇ = b, (m, n).

        ``damp``: whether t counts; if not, directions from ε on are met exactly. The levels above
        leave what the orthonormal ``null`` (n, p) spans, and move the joints by ``above`` (n,).
        """
        m, n = A.shape
        if above is not None:
            b = b - A @ above
        left, sigma, right = np.linalg.svd(A if null is None else A @ null)
        size = float(sigma.max(initial=0.0))
        if null is not None:
            right = right @ null.T
            size = float(np.linalg.norm(A, 2)) if m else 0.0
        if len(sigma) < m:
            sigma = np.concatenate([sigma, np.zeros(m - len(sigma))])
        rank = int(np.count_nonzero(sigma > DEPENDENT * max(size, 1e-300)))
        sigma[rank:] = 0.0
        rows = np.zeros((m, n))
        rows[:rank] = sigma[:rank, None] * right[:rank]
        rate = left.T @ b
        first = regular_from(threshold)
        damped = floor = np.maximum(sigma * sigma, max(threshold, DEPENDENT * size) ** 2)
        if sigma.min(initial=np.inf) < (first if damp else threshold):
            t = 0.0
            if damp and first > 0.0:
                weak = np.maximum(0.0, 1.0 - (sigma / first) ** 2) ** 3
                far = BEND * size * dt * float(np.linalg.norm(weak * rate))
                t = max(first**2 * min(1.0, SMOOTHED / dt), far)
            damped = np.maximum(floor, t)
        return cls(
            left, sigma, rows, rate, damped, floor, size, threshold, right[rank:].T.copy(), smooth
        )  # fmt: skip

    @classmethod
    def as_stated(cls, A: Array, b: Array) -> Directions:
        """The rows as they are, all of them exact: where they contradict each other none is met."""
        n, lengths = A.shape[1], np.linalg.norm(A, axis=1)
        free = np.full(len(b), np.inf)  # rows that depend on each other leave no null space to say
        return cls(
            np.eye(len(b)), lengths, A, b, lengths**2, free, 0.0, 0.0, np.zeros((n, 0)), False
        )

    @property
    def contradicts(self) -> bool:
        """Whether rows that depend on each other ask for different velocities."""
        off = np.abs(self.rate[self.sigma == 0.0]).max(initial=0.0)
        return bool(off > row_tolerance(self.rows, self.rate))

    def on(self, n: int) -> Directions:
        """The same directions on n unknowns, of which the joints are the first."""
        return self if self.rows.shape[1] == n else replace(self, rows=widened(self.rows, n))

    def of_rate(self, b: Array) -> Directions:
        """The same directions with another right-hand side on what the levels above leave, (m,)."""
        return replace(self, rate=self.left.T @ b)

    @cached_property
    def slack(self) -> Array:
        """λ = d − σ², (m,): 0 of a direction that is met exactly."""
        return np.maximum(self.damped - self.sigma**2, 0.0)

    @cached_property
    def weakness(self) -> Array:
        """φ = λ/d, (m,): 0 of a regular direction, 1 at a singularity."""
        return self.slack / np.where(self.damped > 0.0, self.damped, 1.0)

    @property
    def weak(self) -> Mask:
        """Directions met by the damped inverse, (m,); not those that only rounding keeps from 0."""
        weak: Mask = self.slack > 0.0
        return weak if self.threshold > DEPENDENT * self.size else weak & (self.sigma > 0.0)

    @property
    def regular(self) -> bool:
        """Whether every direction is met exactly."""
        return not self.slack.any()

    def allowed(self, lower: Array, upper: Array) -> float:
        """The largest s ≤ 1 at which bounds of the joints, (n,), allow each exact direction."""
        hard = (self.slack == 0.0) & (self.rate != 0.0)
        if not hard.any():
            return 1.0
        asked = np.abs(self.rate[hard])
        rows = self.rows[hard] * np.sign(self.rate[hard])[:, None]
        ends = np.where(rows > 0.0, upper, np.where(rows < 0.0, lower, 0.0))
        # What the verification lets pass is no speed that the bounds deny.
        rounding = EQUALITY_TOLERANCE * (self.sigma.max() + asked.max())
        share = ((rows * ends).sum(axis=1) + rounding) / asked
        return min(max(float(share.min()), 0.0), 1.0)

    def motion(self, b: Array | None = None) -> Array:
        """Σ vᵢ σᵢ βᵢ/dᵢ, what the level alone makes of the joints, rad/s or m/s, (n,).

        ``b``, (m,), takes the place of the right-hand side on what the levels above leave.
        """
        rate = self.rate if b is None else self.left.T @ b
        return (rate / np.where(self.damped > 0.0, self.damped, 1.0)) @ self.rows

    def free(self, c: Array) -> Array:
        """N c, what the directions leave of a linear cost (n,): N = 1 − Σ σᵢ²vᵢvᵢᵀ/max(σᵢ², ε²)."""
        free: Array = (
            c - ((self.rows @ c) / np.where(self.floor > 0.0, self.floor, 1.0)) @ self.rows
        )
        return free


def regular_from(threshold: float) -> float:
    """σ₁ of a controller's ε."""
    return max(2.0 * threshold, min(REGULAR, MOST_REGULAR * threshold))


def lost_directions(
    A: Array, b: Array, velocity: Array, threshold: float
) -> tuple[LostDirection, ...]:
    """Weak directions of the rows A q̇ = b in which a velocity (n,) delivers less than b asks."""
    if not len(b):
        return ()
    left, sigma, _ = np.linalg.svd(A)
    sigma = np.concatenate([sigma, np.zeros(len(b) - len(sigma))])
    rate, reached = left.T @ b, left.T @ (A @ velocity)
    missing = np.abs(rate - reached)
    weak = sigma < max(regular_from(threshold), DEPENDENT * sigma[0])
    found = np.flatnonzero(weak & (missing > row_tolerance(A, b)))
    return tuple(
        LostDirection(
            float(sigma[i]), left[:, i].copy(),
            float(np.clip(reached[i] / rate[i], 0.0, 1.0)) if rate[i] else 0.0, float(missing[i]),
        )
        for i in found
    )  # fmt: skip
