r"""The task rows at the edge of the reach and near singularities.

All of it is a function of the matrix :math:`\mathbf A\mathbf A^T` and of the task's displacement
:math:`\mathbf e = \mathbf b\,dt`, and not of single singular vectors, which turn abruptly where two
singular values cross. With :math:`\mathbf A = \sum\sigma_i u_i v_i^T`, a function
:math:`f(\mathbf A\mathbf A^T)` is :math:`\sum f(\sigma_i^2) u_i u_i^T`.

**Damping.** Near the edge of the reach a singular value vanishes, and an error that the arm cannot
remove, or noise, would be divided by it again and again. From σ₁ on a direction is met as it is
stated; below, the square of its singular value is replaced by a bound that grows with the error:

.. math::

    \dot{\mathbf q} = \mathbf A^T\mathbf D^{-1}\mathbf b,\qquad
    \mathbf D = \max(\mathbf M + \ell r_l,\ t),\qquad
    \mathbf M = \max(\mathbf A\mathbf A^T,\ \varepsilon^2),\qquad
    t = \max(\sigma_1^2 \min(1, T/dt),\ t_e),\quad
    t_e = \ell\,\lVert w(\mathbf A\mathbf A^T)\,\mathbf e\rVert,\quad
    w(\mu) = \max(0,\, 1 - \mu/\sigma_1^2)^3

The share σ²/σ₁² of a small error is removed in a step of up to T = 5 ms, more in a longer one: a
target that stays is reached, and its noise, whose speed is the larger the shorter the step is, is
smoothed.
ℓ, 0.6 of the largest singular value, bounds how fast a small singular value changes with the
joints; w leaves out directions with σ ≥ σ₁, so that a far target damps none of them. It grows with
the cube: below σ₁ a far target would otherwise be damped all at once, within less than one step. A
damped direction moves by at most σ/ℓ in one step: not beyond the singularity. What damping leaves
of the error,

.. math:: r_l = \lVert(1 - \mathbf M\max(\mathbf M,\ t)^{-1})\,\mathbf e\rVert ,

turns with the arm and comes back as an error of the other directions: they are damped by ℓ r_l, or
they would overshoot it in every step. It is 0 while nothing is damped.

**Fading.** Below ε the direction is handed over to the secondary objective by a slack z that costs
½‖z‖² beside ½‖q̇ − ḣ‖²,

.. math::

    \mathbf A\dot{\mathbf q} - (\varepsilon^2 - \mathbf A\mathbf A^T)_+^{1/2}\,z
    = \max(\mathbf A\mathbf A^T, \varepsilon^2)\,\mathbf D^{-1}\mathbf b .

Without limits its solution is :math:`\dot{\mathbf h} + \mathbf A^T\max(\mathbf A\mathbf A^T,
\varepsilon^2)^{-1}(\ldots - \mathbf A\dot{\mathbf h})`: the share σ²/ε² follows the task, the rest
the secondary. The rows have singular values of at least ε whatever A is.

**Scaling** takes of each direction the share θφ + s (1 − φ), φ = 1 − σ²/max(σ², ε², t): what is
damped is asked for at any scale, as far as the joints have room for it (θ), so that it does not
hold the rest down.

**Relaxing** adds ℓ r to d, r the part of the displacement that the limits do not allow, and
minimises

.. math::

    \tfrac12\sum\tfrac{\sigma_i^2 d_i}{\max(\sigma_i^2, \varepsilon^2)}
    \bigl(v_i^T\dot{\mathbf q} - \tfrac{\sigma_i}{d_i}u_i^T\mathbf b\bigr)^2
    + \text{share of the cost in the null space}

inside the limits: a strictly convex program, hence one solution, continuous in its data.

What is proved of it and what is measured is on the docs' page *At the edge*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.singular import LostDirection
from qp_twist.qp.verification import row_tolerance

REGULAR = 0.05
"""σ₁: singular value, m/rad or 1, from which on a direction is met as stated; 50 ε if that is
less, and 2 ε at least."""
SMOOTHED = 0.005
"""T, s."""
NULL_SHARE = 0.3
"""Weight of the cost in the null space beside the damping of a relaxed task: what the limits keep
from one joint is made up for by others as far as that is worth their motion."""

BEND = 0.6
"""ℓ as a share of the largest singular value."""
ROUNDING = 1e-9
"""Damping below this share of ℓ² is none."""
SHORTENED = 2.0
"""Multiple of ε below which the secondary is shortened."""
RANK = 1e-12
"""Singular values below this share of the largest are no direction of the arm at all."""
HELD = 1e-10
"""Directions above this share of the largest singular value are closed to the levels below."""


@dataclass(frozen=True, eq=False)
class EdgeRows:
    """The rows A q̇ = b of a priority level, and their singular values in what is left to it.

    Attributes:
        A: Rows as stated, (m, n).
        b: Right-hand side, m/s and rad/s, (m,).
        dt: Length of the step, s.
        left: U, orthonormal, (m, m).
        sigma: σ, descending, (m,); 0 beyond the n-th.
        right: vᵢᵀ of A N Nᵀ, (m, n); zero beyond the n-th. N spans the null space of the levels
            above.
        basis: N, (n, p); ``None`` for the first level, which has all of the joints.
        nulls: Orthonormal basis of what this level and those above leave, (n, p').
        above: What the levels above do to the joints, outside N, (n,).
        threshold: ε, above 0.
        trust: Whether t counts; without it directions from ε on are met as stated, at any length.
        braked: What is asked instead of b where the joints could not stop in time, (m,); t and what
            is weak follow from b.
        fitting: θ, share of the damped motion of weak directions that the limits allow beside that
            of others.
    """

    A: Array
    b: Array
    dt: float
    left: Array
    sigma: Array
    right: Array
    basis: Array | None
    nulls: Array
    above: Array
    threshold: float
    trust: bool
    braked: Array | None = None
    fitting: float = 1.0

    @classmethod
    def of(
        cls,
        A: Array,
        b: Array,
        dt: float,
        threshold: float,
        *,
        basis: Array | None = None,
        above: Array | None = None,
        trust: bool = True,
    ) -> EdgeRows:
        """The rows of a level whose joints may move in the span of ``basis`` (n, p)."""
        m, n = A.shape
        span = np.eye(n) if basis is None else basis
        above = np.zeros(n) if above is None else above
        left, sigma, right = np.linalg.svd(A @ span)
        rank = int((sigma > HELD * max(sigma.max(initial=0.0), 1e-300)).sum())
        right = right @ span.T
        k = len(sigma)
        directions = np.zeros((m, n))
        directions[:k] = right[:k]
        sigma = np.concatenate([sigma, np.zeros(m - k)])
        return cls(
            A, b, dt, left, sigma, directions, basis, right[rank:].T.copy(), above,
            threshold, trust,
        )  # fmt: skip

    @cached_property
    def floor(self) -> Array:
        """max(σ², ε²), (m,)."""
        floor: Array = np.maximum(self.sigma**2, self.threshold**2)
        return floor

    @cached_property
    def size(self) -> float:
        """The largest singular value of A, of all that the joints could do."""
        return float(np.linalg.norm(self.A, 2)) if len(self.sigma) else 0.0

    @property
    def bend(self) -> float:
        """ℓ, bound of how fast a small singular value changes with the joints.

        Twice as large below other levels, which bend the motion that they leave as well.
        """
        whole = self.basis is None or self.basis.shape[1] == self.basis.shape[0]
        return BEND * self.size * (1.0 if whole else 2.0)

    @property
    def first(self) -> float:
        """σ₁."""
        return max(2.0 * self.threshold, min(REGULAR, 50.0 * self.threshold))

    @cached_property
    def weak(self) -> Array:
        """w(σ²), (m,): 1 at a singularity, 0 from σ₁ on."""
        weak: Array = np.maximum(0.0, 1.0 - (self.sigma / self.first) ** 2) ** 3
        return weak

    @cached_property
    def rate(self) -> Array:
        """Uᵀ(b − A q̇_above), m/s and rad/s, (m,)."""
        rate: Array = self.left.T @ (self.b - self.A @ self.above)
        return rate

    @property
    def target(self) -> Array:
        """b, braked where it has to be, m/s and rad/s, (m,)."""
        return self.b if self.braked is None else self.braked

    @cached_property
    def goal(self) -> Array:
        """The same as :attr:`rate` of the braked b."""
        goal: Array = self.left.T @ (self.target - self.A @ self.above)
        return goal

    @cached_property
    def sigma_min(self) -> float:
        """Smallest singular value of the rows; ∞ without rows."""
        return float(self.sigma[-1]) if len(self.sigma) else np.inf

    @cached_property
    def far(self) -> float:
        """t_e = ℓ ‖w e‖ at full speed, m²/rad² or 1."""
        if not self.trust:
            return 0.0
        return self.bend * self.dt * float(np.linalg.norm(self.weak * self.rate))

    @cached_property
    def damping(self) -> float:
        """t = max(σ₁² min(1, T/dt), t_e), m²/rad² or 1."""
        least = self.first**2 * min(1.0, SMOOTHED / self.dt)
        return max(least, self.far) if self.trust else 0.0

    @cached_property
    def regular(self) -> bool:
        """Whether the rows are met as they are stated, or at the share that braking leaves."""
        return self.sigma_min >= self.threshold and self.sigma_min**2 >= self.damping

    @cached_property
    def fades(self) -> bool:
        """Whether a direction is below ε."""
        return self.sigma_min < self.threshold

    def beneath(self, x: Array) -> EdgeRows:
        """The same rows where the levels above move the joints at x (n,)."""
        if self.basis is None:
            return self
        return replace(self, above=x - self.basis @ (self.basis.T @ x))

    def slack(self) -> Array:
        """(ε² − AAᵀ)₊^½ without columns of zeros, (m, k)."""
        missing = np.sqrt(np.maximum(0.0, self.threshold**2 - self.sigma**2))
        faded = missing > 0.0
        slack: Array = self.left[:, faded] * missing[faded]
        return slack

    def longest_slack(self) -> float:
        """Largest z of a step without limits and secondary, rad/s or m/s."""
        faded = self.sigma < self.threshold
        asked = self.met[faded] * self.goal[faded]
        return float(np.linalg.norm(asked)) / self.threshold if faded.any() else 0.0

    def rows(self) -> Array:
        """A, of regular rows as stated, else on what the levels above leave, (m, n)."""
        if self.regular or self.basis is None:
            return self.A
        rows: Array = self.left @ (self.sigma[:, None] * self.right)
        return rows

    @cached_property
    def bent(self) -> float:
        """ℓ r_l, r_l = ‖(1 − max(σ², ε²)/max(σ², ε², t)) e‖, m²/rad² or 1."""
        if self.regular:
            return 0.0
        left = 1.0 - self.floor / np.maximum(self.floor, self.damping)
        return self.bend * self.dt * float(np.linalg.norm(left * self.rate))

    @cached_property
    def damped(self) -> Array:
        """d = max(max(σ², ε²) + ℓ r_l, t), (m,)."""
        if self.regular:
            return self.floor
        damped: Array = np.maximum(self.floor + self.bent, self.damping)
        return damped

    @cached_property
    def met(self) -> Array:
        """Share of the goal that the damped rows ask for, max(σ², ε²)/d, (m,)."""
        met: Array = self.floor / self.damped
        return met

    @cached_property
    def weakness(self) -> Array:
        """φ = 1 − σ²/max(σ², ε², t), (m,): 0 of a regular direction, 1 at a singularity."""
        if self.regular:
            return np.zeros(len(self.sigma))
        weakness: Array = 1.0 - self.sigma**2 / np.maximum(self.floor, self.damping)
        return weakness

    def asked(self, scale: float = 1.0) -> Array:
        """max(AAᵀ, ε²) D⁻¹ (θφ + s(1 − φ)) b at a scale, m/s and rad/s, (m,)."""
        if self.regular:
            return scale * self.target
        share = self.fitting * self.weakness + scale * (1.0 - self.weakness)
        asked: Array = self.left @ (share * self.met * self.goal)
        return asked

    def motion(self, scale: float = 1.0) -> Array:
        """Aᵀ D⁻¹ (θφ + s(1 − φ)) b: what the task alone makes of the joints, rad/s or m/s, (n,)."""
        share = self.fitting * self.weakness + scale * (1.0 - self.weakness)
        motion: Array = (self._gain * share * self.met * self.goal) @ self.right
        return motion

    def fitted(self, lower: Array, upper: Array) -> EdgeRows:
        """The rows with θ: the share of weak directions for which their motion is inside bounds.

        Args:
            lower: Lower bounds of that motion, rad/s or m/s, (n,).
            upper: Upper bounds, (n,).
        """
        if self.degraded == 0.0:
            return self
        x = (self.weakness * self._gain * self.met * self.goal) @ self.right
        room = np.maximum(0.0, np.where(x > 0.0, upper, -lower))
        moving = np.abs(x) > 0.0
        share = float((room[moving] / np.abs(x[moving])).min(initial=1.0))
        return replace(self, fitting=share)

    @cached_property
    def _gain(self) -> Array:
        """σ/max(σ², ε²), (m,)."""
        gain: Array = self.sigma / self.floor
        return gain

    def lost(self) -> tuple[LostDirection, ...]:
        """Directions of which less is delivered than the task asks."""
        share = (1.0 - self.weakness) * (1.0 - self.weakness * (1.0 - self.fitting))
        missing = (1.0 - share) * np.abs(self.rate)
        noticeable = row_tolerance(self.A, self.b)
        return tuple(
            LostDirection(
                float(self.sigma[i]), self.left[:, i].copy(), float(share[i]), float(missing[i])
            )
            for i in np.flatnonzero(missing > noticeable)
            if share[i] < 1.0
        )

    @cached_property
    def degraded(self) -> float:
        """φ of the weakest direction: 0 of a regular task, 1 at a singularity."""
        return float(self.weakness.max(initial=0.0))

    def excess(self, short: float) -> float:
        """t_e + ℓ r of a relaxed level; not less than rounding, so that its optimum is unique."""
        return max(self.far + self.bend * short, ROUNDING * self.size**2)

    def relaxed(self, H: Array, c: Array, short: float) -> tuple[Array, Array]:
        """H and c of the damped least squares of this level and a share of the cost, (n, n), (n,).

        Args:
            H: Quadratic cost of the joints and of further unknowns behind them, (n', n').
            c: Linear cost, (n',).
            short: r, the length of the task's displacement that the limits do not allow, m and rad.
        """
        n, size = self.A.shape[1], float(np.abs(H).max()) or 1.0
        d = self.damped + self.bend * short
        weight = NULL_SHARE * self.excess(short) / size
        share = self.sigma**2 / self.floor  # of the task
        N = np.eye(len(c))
        N[:n, :n] -= self.right.T @ (share[:, None] * self.right)
        met = np.zeros(len(c))
        met[:n] = (self.sigma / d * self.goal) @ self.right + self.above
        quadratic = weight * (N @ H @ N)
        linear = weight * (N @ (c + H @ met))
        quadratic[:n, :n] += self.right.T @ ((share * d)[:, None] * self.right)
        linear[:n] -= (share * self.sigma * self.goal) @ self.right
        return 0.5 * (quadratic + quadratic.T), linear


def longest_secondary(rows: EdgeRows) -> float:
    r"""Length of h that stays clear of the nearest singularity, rad or m.

    .. math::

        \frac{\max(\sigma, \varepsilon)}{\sigma_{max}\,(1 - \sigma^2/(2\,\varepsilon)^2)_+}

    with σ the smallest singular value. A secondary objective that left the region where directions
    fade in one step would be called back in the next.
    """
    felt = rows.sigma[rows.sigma > RANK * rows.size]
    if not len(felt):
        return np.inf
    weakest, size = float(felt[-1]), rows.size
    near = 1.0 - (weakest / (SHORTENED * rows.threshold)) ** 2
    return max(weakest, rows.threshold) / (size * near) if near > 0.0 else np.inf
