"""The largest part of a task that fits inside the limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.qp.levels import Level, lexicographic
from qp_twist.qp.problem import QuadraticProgram

SCALE_BACKOFF = 1e-8
"""Share of a scaled task that is given up where the rows are then posed at the scale: on the
very edge rounding would decide whether they have a solution."""


@dataclass(frozen=True, eq=False)
class LargestScale:
    """The optimum of the scaling program.

    Attributes:
        scale: s in [0, 1].
        x: A point that reaches it, (n,).
        box_multipliers: How much s gains per unit of room at each bound; positive at an upper one,
            negative at a lower one, (n,).
        row_multipliers: The same for G x ≤ g, non-negative, (k,).
    """

    scale: float
    x: Array
    box_multipliers: Array
    row_multipliers: Array

    @classmethod
    def full(cls, x: Array, rows: int = 0) -> LargestScale:
        """s = 1 at a point, of a program with so many inequality rows."""
        return cls(1.0, x, np.zeros(len(x)), np.zeros(rows))


def largest_scale(
    problem: QuadraticProgram, *, offset: Array | None = None, low: float = 0.0, high: float = 1.0
) -> LargestScale | None:
    r"""The linear program for the design's s.

    .. math::

        \max_{x,\,s} s \quad\text{s.t.}\quad \mathbf A x = \mathbf b_0 + s\,\mathbf b,\;
        \mathbf G x \le \mathbf g,\; lower \le x \le upper,\; low \le s \le high

    It is a hierarchy in (x, s): the rows G, then A x = s b, then s = 1. The cascade needs no
    feasible start and has the multipliers of the last level. ``None`` where no such s has a
    solution.

    Args:
        problem: The program; of it all but the cost counts.
        offset: b₀, (m,); zero if ``None``.
        low: Smallest s.
        high: Largest s.
    """
    n, speed = problem.n, float(np.abs(problem.b).max(initial=0.0)) or 1.0
    offset = 0.0 * problem.b if offset is None else offset
    none = np.zeros((0, n + 1))
    rows = np.pad(problem.G, ((0, 0), (0, 1)))
    # The unknown is s in units of speed, so that all rows are of one size.
    task = Level(np.column_stack([problem.A, -problem.b / speed]), offset, none, none[:, 0])
    hard = Level(none, none[:, 0], rows, problem.g)
    aim = Level(np.eye(n + 1)[n:], np.array([high * speed]), none, none[:, 0])
    levels = [level for level in (hard, task) if len(level.b) + len(level.g)]
    found = lexicographic(
        levels, np.append(problem.lower, low * speed), np.append(problem.upper, high * speed)
    )
    if not all(level.met(found.x) for level in levels):
        return None
    found.minimise(aim)
    if not found.optimal:
        return None
    scale = float(found.x[n]) / speed
    if scale >= high - 1e-12:
        return replace(LargestScale.full(found.x[:n], len(problem.g)), scale=high)
    # The gradient of the distance ½(s − high)² is (s − high) times that of s.
    gain = 1.0 / ((high * speed - found.x[n]) * speed)
    return LargestScale(
        scale=scale,
        x=found.x[:n],
        box_multipliers=gain * found.box_multipliers[:n],
        row_multipliers=gain * np.array(found.row_multipliers[: len(problem.g)]),
    )
