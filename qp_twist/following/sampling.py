"""Rows of a path between its waypoints, as near to each other as its tolerances ask."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.paths import PathTask
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import JointMotion, sampled_errors

ROOM = 0.5
"""Share of the tolerances for linear pieces, which leaves a reserve for smooth ones."""


def fine_rows(path_task: PathTask, s: Array, start: Array) -> Array:
    """Parameters s (K,) and others between them, at which joints that go straight keep the path.

    Where the joints' least-norm motion from ``start`` misses the path by e in the middle between
    two of them, ⌈√(e/ε)⌉ equal parts keep it below ε, half the tolerance of a check, since e grows
    with the square of the distance. There is no joint move between them.
    :func:`~qp_twist.refine_trajectory` repairs what is left of a motion that turns more.
    """
    rows, q = PathRows(path_task, s), [start]
    for k in range(1, len(s)):
        [there], [arrived] = rows.correct(q[-1][None], np.array([k]))
        if not arrived:
            break
        q.append(there)
    known = len(q)
    if known < 2:
        return s
    motion = JointMotion(np.arange(known, dtype=np.float64), np.array(q))
    errors, units = sampled_errors(path_task, motion, s[:known], samples=1)
    bulge = errors[:, 1] - np.maximum(errors[:, 0], errors[:, 2])
    shares = (bulge / (ROOM * path_task.tolerances.of(units))).max(axis=1)
    parts = np.ones(len(s) - 1, dtype=np.intp)
    parts[: known - 1] = np.ceil(np.sqrt(np.maximum(shares, 1.0)))
    piece = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(piece)) - (np.cumsum(parts) - parts)[piece]) / parts[piece]
    found: Array = np.append(s[piece] + share * np.diff(s)[piece], s[-1])
    return found


def plan_at(path_task: PathTask, plan: Array, s: Array, fine: Array) -> Array:
    """A plan's rows (K, nv) at parameters ``s`` (K,), at others (N,): corrected onto the path."""
    between = np.array([np.interp(fine, s, joint) for joint in plan.T]).T
    return PathRows(path_task, fine).correct(between, np.arange(len(fine)))[0]
