"""Newton's corrections onto a path and descents of z along it, to be read: the kernel's oracle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

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
