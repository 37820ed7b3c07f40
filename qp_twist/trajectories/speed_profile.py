"""The fastest timing of joint rows connected by cubics in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.referee import JointMotion

_ROUNDS = 100
_ROUNDING = 1e-10
"""Share by which rounding may exceed a limit."""


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Timing of a path.

    Attributes:
        motion: The joints in time.
        pace: σ at each row: 1 at the feed, 0 at rest, (N,).
        speed_use: Share of the velocity limits that each piece uses, (N − 1, nv).
        acceleration_use: Share of the acceleration limits, (N − 1, nv).
    """

    motion: JointMotion
    pace: Array
    speed_use: Array
    acceleration_use: Array


def speed_profile(
    q: Array,
    feed: Array,
    max_velocity: Array,
    max_acceleration: Array,
    rests: Mask,
    most: Array | None = None,
) -> SpeedProfile:
    r"""Velocities and times at the rows of a joint path, as fast as feed and limits permit.

    Let s be the time that the feed would take. At row k the joints move at
    :math:`\dot{\mathbf q}_k = \sigma_k\,\mathbf p_k`: the direction :math:`\mathbf p = d\mathbf
    q/ds` is that of the parabola through three rows, the pace :math:`0 \le \sigma \le 1` is
    unknown. A piece of length h in s takes :math:`T = 2h/(a + b)` from pace a to pace b, and with
    :math:`\mathbf D = \Delta\mathbf q/h` the accelerations at its ends are, joint by joint,

    .. math::

        \frac{a + b}{2h}\,\bigl[(3D - 4p_k)\,a + (3D - 2p_{k+1})\,b\bigr], \qquad
        \frac{a + b}{2h}\,\bigl[(2p_k - 3D)\,a + (4p_{k+1} - 3D)\,b\bigr];

    the velocities are between the three numbers :math:`p_k a`, :math:`\tfrac32 D(a + b) - p_k a -
    p_{k+1} b` and :math:`p_{k+1} b`. All of them within their limits make the piece feasible.

    Each row first has the largest pace at which the pieces beside it are feasible if they keep it.
    Then, as in reachability analysis (Pham and Pham 2018), a pass backwards lowers the begin of
    each piece that could not brake to its end's pace, a pass forwards the end of each that could
    not reach it. Only the faster end of a piece is lowered, and never below the slower, so the
    passes come to rest, and away from the rests no pace becomes zero.

    Args:
        q: Joint positions, rad or m, (N, nv), no two successive rows alike where ``feed`` is 0.
        feed: Least time of each piece, s, (N − 1,), above 0.
        max_velocity: rad/s or m/s, (nv,); ∞ without a limit.
        max_acceleration: rad/s² or m/s², (nv,); ∞ likewise.
        rests: Rows at which the joints stand still, (N,).
        most: Largest pace at each row, above 0 and at most 1, (N,). If ``None`` it is 1, and pieces
            that the velocity limits do not permit at the feed take longer from the outset.
    """
    moved = np.diff(q, axis=0)
    h = feed
    if most is None:
        h = np.maximum(feed, (np.abs(moved) / max_velocity).max(axis=1, initial=0.0))
        most = np.ones(len(q))
    D = moved / h[:, None]
    p, p_begin, p_end = _directions(D, h, rests)
    pieces = _Pieces.of(D, p_begin, p_end, h, max_velocity, max_acceleration)
    steady, pace = pieces.steady_paces(), np.where(rests, 0.0, most)
    pace[:-1] = np.minimum(pace[:-1], steady)
    pace[1:] = np.minimum(pace[1:], steady)
    for _ in range(_ROUNDS):
        before = pace.copy()
        for k in reversed(range(len(h))):
            if pace[k] > pace[k + 1]:
                pace[k] = pieces.largest(k, float(pace[k]), float(pace[k + 1]), at_begin=True)
        for k in range(len(h)):
            if pace[k + 1] > pace[k]:
                pace[k + 1] = pieces.largest(k, float(pace[k + 1]), float(pace[k]), at_begin=False)
        if (pace == before).all():
            break
    together = pace[:-1] + pace[1:]
    T = 2.0 * h / np.where(together > 0.0, together, 1.0)
    # From rest to rest in one piece: |q̇| ≤ 1.5 D, and |q̈| = 6 D/T at its ends.
    both = together == 0.0
    slowest = np.maximum(
        1.5 * np.abs(moved) / max_velocity, np.sqrt(6.0 * np.abs(moved) / max_acceleration)
    )
    steady = h / np.minimum(most[:-1], most[1:])
    T[both] = np.maximum(steady, slowest.max(axis=1, initial=0.0))[both]
    times, velocities = np.concatenate([[0.0], np.cumsum(T)]), pace[:, None] * p
    motion = JointMotion(times, q, velocities)
    fastest, hardest = motion.largest_speeds(), motion.largest_accelerations()
    use = float(max(
        (fastest / max_velocity).max(initial=0.0),
        np.sqrt((hardest / max_acceleration).max(initial=0.0)),
    ))  # fmt: skip
    if use > 1.0:  # violations due to rounding, or to passes that were cut short
        motion = JointMotion(use * times, q, velocities / use)
        fastest, hardest = fastest / use, hardest / use**2
    return SpeedProfile(motion, pace, fastest / max_velocity, hardest / max_acceleration)


def straight_profile(q: Array, floor: Array, max_velocity: Array) -> SpeedProfile:
    """Constant joint speeds from row to row: at the feed, or as fast as the velocity limits permit.

    ``floor`` (N − 1,) has the least time of each piece, s, above 0.
    """
    moved = np.abs(np.diff(q, axis=0))
    T = np.maximum(floor, (moved / max_velocity).max(axis=1, initial=0.0))
    motion = JointMotion(np.concatenate([[0.0], np.cumsum(T)]), q)
    use = moved / T[:, None] / max_velocity
    return SpeedProfile(motion, np.ones(len(q)), use, np.zeros_like(use))


def _directions(D: Array, h: Array, rests: Mask) -> tuple[Array, Array, Array]:
    """dq/ds at the rows (N, nv), and at the begin and the end of each piece (N − 1, nv).

    The derivative of the parabola through a row and its neighbours; at a rest, where the path may
    turn, the one-sided derivative.
    """
    p = np.empty((len(D) + 1, D.shape[1]))
    before, after = h[:-1, None], h[1:, None]
    p[1:-1] = (after * D[:-1] + before * D[1:]) / (before + after)
    p[0], p[-1] = D[0], D[-1]
    begin, end = p[:-1].copy(), p[1:].copy()
    for k in np.flatnonzero(rests[:-1]):
        begin[k] = D[k] if rests[k + 1] else 2.0 * D[k] - p[k + 1]
    for k in np.flatnonzero(rests[1:]):
        end[k] = D[k] if rests[k] else 2.0 * D[k] - p[k]
    return p, begin, end


class _Pieces(NamedTuple):
    """|α a² + (α + β) a b + β b²| ≤ c and |γ a + δ b| ≤ v, of each piece the rows with limits."""

    alpha: Array
    beta: Array
    c: Array
    gamma: Array
    delta: Array
    v: Array

    @classmethod
    def of(
        cls, D: Array, p0: Array, p1: Array, h: Array, max_velocity: Array, max_acceleration: Array
    ) -> _Pieces:
        a, v = np.isfinite(max_acceleration), np.isfinite(max_velocity)
        return cls(
            np.hstack([3.0 * D - 4.0 * p0, 2.0 * p0 - 3.0 * D])[:, np.tile(a, 2)],
            np.hstack([3.0 * D - 2.0 * p1, 4.0 * p1 - 3.0 * D])[:, np.tile(a, 2)],
            2.0 * h[:, None] * np.tile(max_acceleration[a], 2),
            np.hstack([1.5 * D - p0, p0, 0.0 * D])[:, np.tile(v, 3)],
            np.hstack([1.5 * D - p1, 0.0 * D, p1])[:, np.tile(v, 3)],
            np.tile(max_velocity[v], 3),
        )

    def steady_paces(self) -> Array:
        """Largest constant pace, up to 1, on each piece, (N − 1,)."""
        steepest = np.max(
            np.abs([self.gamma + self.delta, self.gamma, self.delta]), axis=0, initial=0.0
        )
        with np.errstate(divide="ignore"):
            squares = self.c / np.abs(2.0 * (self.alpha + self.beta))
            paces = self.v / steepest
        slowest = np.sqrt(squares.min(axis=1, initial=1.0)), paces.min(axis=1, initial=1.0)
        return np.asarray(np.minimum(*slowest))

    def largest(self, k: int, x: float, y: float, *, at_begin: bool) -> float:
        """Largest pace from y to x at which piece k may begin, or end, if its other end has y ≤ x.

        y itself is feasible, so the largest is x or a point where a limit becomes tight.
        """
        alpha, beta, c, gamma, delta = (part[k] for part in self[:5])
        if not at_begin:
            alpha, beta, gamma, delta = beta, alpha, delta, gamma
        middle, constant = (alpha + beta) * y, beta * y * y

        def feasible(paces: Array) -> Mask:
            squares = paces[:, None] * (alpha * paces[:, None] + middle) + constant
            lines = gamma * paces[:, None] + delta * y
            hard = np.abs(squares) <= c * (1.0 + _ROUNDING)
            fast = np.abs(lines) <= self.v * (1.0 + _ROUNDING)
            return np.asarray(np.concatenate([hard, fast], axis=1).all(axis=1))

        if feasible(np.array([x]))[0]:
            return x
        with np.errstate(divide="ignore", invalid="ignore"):
            found = [np.array([y])]
            for sign in (1.0, -1.0):
                found.append((sign * self.v - delta * y) / gamma)
                root = np.sqrt(middle**2 - 4.0 * alpha * (constant - sign * c))
                # Both roots in the forms that lose no digits where α is small.
                half = -0.5 * (middle + np.where(middle < 0.0, -root, root))
                found += [half / alpha, (constant - sign * c) / half]
        paces = np.concatenate(found)
        paces = np.unique(paces[(paces >= y) & (paces < x)])[::-1]
        fits = feasible(paces)
        return float(paces[np.argmax(fits)]) if fits.any() else y
