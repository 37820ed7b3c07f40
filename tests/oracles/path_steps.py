"""Newton's corrections onto a path and descents of z along it, to be read: the kernel's oracle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import ON_TASK, PathRows

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

LONGEST = 0.3
"""Largest joint displacement of a step, rad or m."""


def corrected(rows: PathRows, q: Array, at: Indices, iterations: int = 40) -> tuple[Array, Mask]:
    """Steps of least norm onto the waypoints ``at``, (K, nv); which of them arrive, (K,)."""
    q, arrived = q.copy(), np.zeros(len(q), dtype=bool)
    left = np.arange(len(q))
    for _ in range(iterations):
        still = []
        for which, A, errors in rows._groups(q[left], at[left]):
            here = left[which]
            done = np.linalg.norm(errors, axis=1) <= ON_TASK
            arrived[here[done]] = True
            if A.shape[1]:
                step = (np.linalg.pinv(A[~done]) @ errors[~done][:, :, None])[:, :, 0]
                longest = np.abs(step).max(axis=1, initial=LONGEST)
                q[here[~done]] += step * (LONGEST / longest)[:, None]
            still.append(here[~done])
        left = np.concatenate(still)
        if not len(left):
            break
    return q, arrived


def descended(
    rows: PathRows,
    q: Array,
    at: Indices,
    ranges: JointRanges,
    *,
    rounds: int,
    longest: float,
    settled: float,
) -> Array:
    """Gauss and Newton's steps of z along what the rows leave free; NaN where it fails."""
    q, arrived = corrected(rows, q, at)
    share, moving = np.ones(len(q)), np.arange(len(q))
    for _ in range(rounds):
        here, there = q[moving], at[moving]
        basis = rows.motions(here, there)
        weighted = ranges.weight[:, None] * basis
        away = ranges.weight * (ranges.middle - here)
        gram = weighted.transpose(0, 2, 1) @ weighted + 1e-12 * np.eye(weighted.shape[2])
        u = np.linalg.solve(gram, weighted.transpose(0, 2, 1) @ away[:, :, None])
        step = share[moving, None] * (basis @ u)[:, :, 0]
        shorter = longest / np.abs(step).max(axis=1, initial=longest)
        moved, arrived_there = corrected(rows, step * shorter[:, None] + here, there)
        gained = np.where(arrived_there, ranges.centring(here) - ranges.centring(moved), -1.0)
        q[moving[gained > 0.0]] = moved[gained > 0.0]
        share[moving[gained < 0.0]] *= 0.4
        expected = (step * ranges.weight * away).sum(axis=1)
        moving = moving[(expected > settled) & (share[moving] > 0.01)]
        if not len(moving):
            break
    q[~arrived] = np.nan
    return q
