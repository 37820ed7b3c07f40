"""The free motion of a trajectory, spent on the speed of its tool."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from qp_twist.checks import Array, Mask
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import CORNER, MotionLimits, turns_of
from qp_twist.trajectories.refine_trajectory import with_rows_between

_ROUNDS, _HALVINGS = 40, 6
_LONGEST = 0.1
"""Largest displacement of a joint in a round, rad or m: the rows hold only nearby."""
_QUIET = 1e-3
"""Weight of what is far below the limits, so that the free motion is smooth there, too."""
_SETTLED = 1e-3
"""Share of the cost by which a round has to reduce it."""
_DAMPING = 1e-9
_APART = 0.02
"""Largest time between rows, s. Between rows 0.2 s apart the tool is up to 13 % slower than at them
(dome_seams), 50 ms apart 4 %, 20 ms apart less than what counts as slow."""


class _Uses(NamedTuple):
    """Shares of the limits that the programmed speed asks for, and the time that each counts for.

    Speeds of the N − 1 pieces, accelerations at the N − 2 rows between them, and jerks of the N − 3
    inner pieces, (3N − 6, nv); ``order`` (3N − 6, 1) is 1, 2 or 3.
    """

    of: Array
    spans: Array
    order: Array

    @property
    def cost(self) -> float:
        """Time that the limits cost, s, and a little of the squares of all shares.

        A piece that asks for the share u of a speed takes u times as long, one that asks for the
        share u of an acceleration √u times, of a jerk ∛u times.
        """
        factors = (self.of ** (1.0 / self.order)).max(axis=1)
        lost = np.maximum(factors - 1.0, 0.0) + _QUIET * (self.of**2).sum(axis=1)
        return float(self.spans @ lost)

    @property
    def weights(self) -> Array:
        """Of the squares of the shares: their sum has the gradient of the lost time, smoothed."""
        u = np.minimum(self.of, 1e6)
        smoothed = u**6 / (1.0 + u ** (8.0 - 1.0 / self.order))
        weights: Array = self.spans[:, None] * (_QUIET + smoothed)
        return weights


def steady_trajectory(trajectory: Trajectory, limits: MotionLimits) -> Trajectory:
    r"""The trajectory with rows every 20 ms, and a free motion that slows its tool down less.

    On rows :math:`\mathbf q_k` that take :math:`h_k` at the feed, the joints would have speeds
    :math:`\Delta\mathbf q_k/h_k` and the accelerations of their changes. Where these exceed their
    limits the tool has to be slower. Minimised, along the null space of the task's rows, is the
    time that this costs,

    .. math::

        \sum_k h_k\,\bigl(\max_j \max(u_{kj},\, \sqrt{u'_{kj}},\, \sqrt[3]{u''_{kj}}) - 1\bigr)_+,

    with the shares u, u′ and u″ of the limits of speed, acceleration and jerk, by least squares
    whose weights are renewed in each round. At corners of the path only speeds count, since the
    tool slows down there whatever the joints do. Joint ranges, hard bands and constraints are kept
    at the rows. The ends of joint moves stay, as does the first row, unless the task leaves its
    start open.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`.
        limits: Of the joints' speeds, accelerations and jerks.
    """
    trajectory = _dense(trajectory)
    task, feed = trajectory.path_task, trajectory.feed
    if feed is None or len(trajectory.q) < 4:
        return trajectory
    rows, at = PathRows(task, trajectory.s), np.arange(len(trajectory.q))
    if not rows.freedom.any():
        return trajectory
    moves, ranges = trajectory.path.moves, JointRanges.of(task.model)
    held = np.append(moves, False) | np.append(False, moves)
    held[0] |= not task.best_start
    change = _change(feed, moves, limits)
    pieces = np.where(moves, 0.0, feed)
    smooth = turns_of(trajectory.path.positions) < CORNER
    at_rows, inner = 0.5 * smooth * (pieces[1:] + pieces[:-1]), smooth[1:] * smooth[:-1]
    spans = np.concatenate([pieces, at_rows, inner * pieces[1:-1]])
    order = np.repeat([[1.0], [2.0], [3.0]], [len(pieces), len(at_rows), len(inner)], axis=0)

    def uses(q: Array) -> _Uses:
        return _Uses(np.abs(change @ q.ravel()).reshape(-1, q.shape[1]), spans, order)

    q, now = trajectory.q, uses(trajectory.q)
    outside = np.minimum(0.0, ranges.room(q).min(axis=1))
    for _ in range(_ROUNDS):
        step = _step(change, q, rows.motions(q, at), now.weights, held)
        step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), _DAMPING))
        before = now.cost
        for _ in range(_HALVINGS):
            trial, inside = rows.correct_inside(q + step, at)
            trial[held] = q[held]
            kept = (inside & (ranges.room(trial).min(axis=1) >= outside)) | held
            if kept.all() and (found := uses(trial)).cost < before:
                q, now = trial, found
                break
            step = 0.5 * step
        if now.cost > (1.0 - _SETTLED) * before:
            break
    return replace(trajectory, q=q, durations=np.append(0.0, feed))


def _dense(trajectory: Trajectory) -> Trajectory:
    """With rows between others, on the path, until none is farther from the next in time."""
    while (feed := trajectory.feed) is not None:
        wide = np.flatnonzero((feed > _APART) & ~trajectory.path.moves)
        trajectory, divided = with_rows_between(trajectory, wide, np.full(len(wide), 0.5))
        if len(divided) < len(wide) or not len(wide):
            break
    return trajectory


def _change(feed: Array, moves: Mask, limits: MotionLimits) -> sparse.csr_matrix:
    """From q (N nv,) to speeds, accelerations and jerks at the feed in shares of their limits."""
    h = np.where(moves | (feed <= 0.0), np.inf, feed)
    most, rates, found = (limits.velocity, limits.acceleration, limits.jerk), None, []
    for spans, limit in zip((h, 0.5 * (h[1:] + h[:-1]), h[1:-1]), most, strict=True):
        shape = (len(spans), len(spans) + 1)
        change = sparse.diags([-1.0 / spans, 1.0 / spans], [0, 1], shape=shape)
        rates = change if rates is None else change @ rates
        found.append(sparse.kron(rates, sparse.diags(1.0 / limit)))
    return sparse.vstack(found, format="csr")


def _step(change: sparse.csr_matrix, q: Array, basis: Array, weights: Array, held: Mask) -> Array:
    """The displacement (N, nv) in the null spaces (N, nv, d) of least weighted squares."""
    count, nv, d = basis.shape
    basis = np.where(held[:, None, None], 0.0, basis)
    pointers = np.arange(count + 1)
    into = sparse.bsr_matrix(
        (basis, pointers[:-1], pointers), shape=(count * nv, count * d)
    ).tocsr()
    A = change @ into
    w = weights.ravel()
    normal = (A.T @ A.multiply(w[:, None])).tocsc()
    right = -A.T @ (w * (change @ q.ravel()))
    damping = _DAMPING * (normal.diagonal().max() + 1.0)
    x = spsolve(normal + damping * sparse.identity(count * d, format="csc"), right)
    step: Array = (into @ x).reshape(count, nv)
    return step
