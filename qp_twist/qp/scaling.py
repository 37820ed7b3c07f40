"""The largest part of a task that fits inside the limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, largest
from qp_twist.qp.levels import Cascade, Level
from qp_twist.qp.problem import QuadraticProgram

SCALE_BACKOFF = 1e-8
"""Share of a scaled task that is given up where the rows are then posed at the scale: on the
very edge rounding would decide whether they have a solution."""


class LargestScale(NamedTuple):
    """The optimum of the scaling program."""

    scale: float
    """s in [0, 1]."""
    x: Array
    """A point that reaches it, (n,)."""
    box_multipliers: Array
    """Gain of s per unit of room at each bound; positive at an upper, negative at a lower one."""
    row_multipliers: Array
    """The same for G x ≤ g, non-negative, (k,)."""


def largest_scale(problem: QuadraticProgram, offset: Array | None = None) -> LargestScale | None:
    r"""The linear program for the design's s.

    .. math::

        \max_{x,\,s} s \quad\text{s.t.}\quad \mathbf A x = \mathbf b_0 + s\,\mathbf b,\;
        \mathbf G x \le \mathbf g,\; lower \le x \le upper,\; 0 \le s \le 1

    It is a hierarchy in (x, s): the rows G, then A x = s b, then s = 1. The cascade needs no
    feasible start and has the multipliers of the last level. ``None`` where no such s has a
    solution.

    Args:
        problem: The program; of it all but the cost counts.
        offset: b₀, (m,); zero if ``None``.
    """
    n, k = problem.n, len(problem.g)
    none = np.zeros((0, n + 1))
    # The rows are as long as one, and the unknown is s in units of the largest right-hand side:
    # what counts as zero must not depend on the rows' unit.
    longest = float(np.linalg.norm(problem.A, axis=1).max(initial=0.0)) or 1.0
    b = problem.b / longest
    speed = largest(b) or 1.0
    wide = problem.widened(1)
    wide.A[:, :n] /= longest
    wide.A[:, n], wide.lower[n], wide.upper[n] = -b / speed, 0.0, speed
    held = 0.0 * b if offset is None else offset / longest
    task = Level(wide.A, held, none, none[:, 0])
    hard = Level(none, none[:, 0], wide.G, wide.g)
    aim = Level(np.eye(n + 1)[n:], np.array([speed]), none, none[:, 0])
    levels = [level for level in (hard, task) if len(level.b) + len(level.g)]
    found = Cascade([*levels, aim], wide.lower, wide.upper)
    if not found.optimal or not all(level.met(found.x) for level in levels):
        return None
    scale, gain = float(found.x[n]) / speed, 0.0
    if scale >= 1.0 - 1e-12:
        scale = 1.0
    else:  # the gradient of the distance ½(s − 1)² is (s − 1) times that of s
        gain = 1.0 / ((speed - found.x[n]) * speed)
    return LargestScale(
        scale,
        found.x[:n],
        gain * found.box_multipliers[:n],
        gain * np.array(found.row_multipliers[:k]),
    )
