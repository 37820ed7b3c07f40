"""The free motion and the tolerances of a trajectory, spent on the speed of its tool."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from qp_twist.checks import Array, Mask
from qp_twist.following import Trajectory
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import AT_SPEED, MotionLimits
from qp_twist.trajectories.refine_trajectory import with_rows_between
from qp_twist.trajectories.rounded_path import differences, rounding, smooth_at

_ROUNDS, _HALVINGS = 100, 6
_LONGEST = 0.1
"""Largest displacement of a joint in a round, rad or m: the rows hold only nearby."""
_QUIET = 1e-3
"""Weight of what is far below the limits, so that the free motion is smooth there, too."""
_SETTLED = 1e-4
"""Share of the cost by which a round has to reduce it."""
_DAMPING = 1e-9
_SLOW = 1.0 - AT_SPEED
"""What a piece loses where the tool counts as slow, as a share of its time: what it loses beyond
costs less and less, so that few are slow, and not all a little (``timing_seam``, UR10e: 29 % of the
path at speed, 11 % without)."""
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
    def lost(self) -> Array:
        """Time that the limits cost each, as a share of its own and of :data:`_SLOW`, (3N − 6,).

        A piece that asks for the share u of a speed takes u times as long, one that asks for the
        share u of an acceleration √u times, of a jerk ∛u times.
        """
        factors: Array = (self.of ** (1.0 / self.order)).max(axis=1)
        return np.maximum(factors - 1.0, 0.0) / _SLOW

    @property
    def cost(self) -> float:
        """Time in which the tool is slow, s, smoothed, and a little of all shares' squares."""
        slow = _SLOW * np.log1p(self.lost) + _QUIET * (self.of**2).sum(axis=1)
        return float(self.spans @ slow)

    @property
    def weights(self) -> Array:
        """Of the squares of the shares: their sum has the gradient of the cost, smoothed."""
        u = np.minimum(self.of, 1e6)
        smoothed = u**6 / (1.0 + u ** (8.0 - 1.0 / self.order)) / (1.0 + self.lost[:, None])
        weights: Array = self.spans[:, None] * (_QUIET + smoothed)
        return weights


def steady_trajectory(trajectory: Trajectory, limits: MotionLimits) -> Trajectory:
    r"""The trajectory with rows every 20 ms, whose tool is slow on less of the path.

    The path is rounded within the tolerances of a check
    (``rounding``), and then the free motion moves. On rows
    :math:`\mathbf q_k` that take :math:`h_k` at the feed, the joints would have speeds
    :math:`\Delta\mathbf q_k/h_k` and the accelerations of their changes. Where these exceed their
    limits the tool has to be slower. Minimised, along the null space of the task's rows, is

    .. math::

        \sum_k h_k\,\varepsilon\log(1 + \tau_k/\varepsilon), \qquad
        \tau_k = \bigl(\max_j \max(u_{kj},\, \sqrt{u'_{kj}},\, \sqrt[3]{u''_{kj}}) - 1\bigr)_+,

    with the shares u, u′ and u″ of the limits of speed, acceleration and jerk, and ε = 2 %, from
    which on the tool counts as slow, by least squares whose weights are renewed in each round. At
    corners of the path only speeds count, since the tool slows down there whatever the joints do.
    Joint ranges, hard bands and constraints are kept at the rows. The ends of joint moves stay, as
    does the first row, unless the task leaves its start open.

    Args:
        trajectory: Result of :func:`~qp_twist.follow`.
        limits: Of the joints' speeds, accelerations and jerks.
    """
    trajectory = _dense(trajectory)
    task, feed = trajectory.path_task, trajectory.feed
    if feed is None or len(trajectory.q) < 4:
        return trajectory
    at, ranges, moves = np.arange(len(feed) + 1), JointRanges.of(task.model), trajectory.path.moves
    held = np.append(moves, False) | np.append(False, moves)
    held[0] |= not task.best_start
    rows = PathRows(task, trajectory.s, rounding(trajectory, held))
    change = _change(differences(feed, moves), limits)
    pieces, smooth = np.where(moves, 0.0, feed), smooth_at(trajectory)
    at_rows, inner = 0.5 * smooth * (pieces[1:] + pieces[:-1]), smooth[1:] * smooth[:-1]
    spans = np.concatenate([pieces, at_rows, inner * pieces[1:-1]])
    order = np.repeat([[1.0], [2.0], [3.0]], [len(pieces), len(at_rows), len(inner)], axis=0)

    def uses(q: Array) -> _Uses:
        return _Uses(np.abs(change @ q.ravel()).reshape(-1, q.shape[1]), spans, order)

    q, inside = rows.correct_inside(trajectory.q, at)
    q[held | ~inside] = trajectory.q[held | ~inside]
    now = uses(q)
    outside = np.minimum(0.0, ranges.room(q).min(axis=1))
    for _ in range(_ROUNDS if rows.freedom.any() else 0):
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


def _change(changes: Sequence[sparse.csr_matrix], limits: MotionLimits) -> sparse.csr_matrix:
    """From q (N nv,) to speeds, accelerations and jerks at the feed in shares of their limits."""
    rates = itertools.accumulate(changes, lambda of, change: change @ of)
    most = limits.velocity, limits.acceleration, limits.jerk
    found = (sparse.kron(of, np.diag(1.0 / limit)) for of, limit in zip(rates, most, strict=True))
    return sparse.vstack(list(found), format="csr")


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
