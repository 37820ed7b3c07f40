"""A step that keeps its clearances, where the step that was computed does not."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import Clearance, GatheredLimits, gather_limits
from qp_twist.control.sorted_limits import SortedLimits
from qp_twist.control.step import Step

_CORRECTIONS = 10
"""Largest number of times that a step is computed again to keep a clearance."""
_KEPT = 1e-7
"""By how much a step may lead below a clearance, m."""

_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Shares of a solution, the rest of which keeps clear, that are tried where it is not safe."""
_CORNERS = 256
"""Corners of the limits that are tried; all of them up to eight joints."""


def step_clear(
    solve: Callable[[], Step], limits: SortedLimits, configuration: mink.Configuration, dt: float
) -> Step:
    """What ``solve`` returns, or a step that keeps its clearances, too.

    Their rows are linear in the step, distances are not: where it leads too near, rows of the
    distances there are added, and the step is computed again.
    """
    clearances, motion = limits.clearances, limits.motion()
    for clearance in clearances:
        clearance.in_step.begin(configuration, *motion)
    try:
        return _corrected(solve, limits, configuration, dt)
    finally:
        for clearance in clearances:
            clearance.in_step.has_begun = False


def _corrected(
    solve: Callable[[], Step], limits: SortedLimits, configuration: mink.Configuration, dt: float
) -> Step:
    step, clearances = solve(), limits.clearances
    for correction in range(_CORRECTIONS + 1):
        lacking = [c for c in clearances if c.in_step.lacks(step.velocity, dt) > _KEPT]
        if not lacking:
            break
        corrected = False
        for clearance in lacking if correction < _CORRECTIONS else ():
            corrected |= clearance.in_step.correct(step.velocity, dt)
        if not corrected:
            others = [limit for limit in limits.limits if not isinstance(limit, Clearance)]
            gathered = gather_limits(others, configuration, dt)
            clear = _clear_velocity(clearances, gathered, step.velocity, dt)
            if clear is not None:
                for clearance in clearances:
                    clearance.in_step.hold(clear, dt)
        step = solve()
        if not corrected:
            break
    return step


def _clear_velocity(
    clearances: Sequence[Clearance], limits: GatheredLimits, velocity: Array, dt: float
) -> Array | None:
    """A velocity near another one that keeps all clearances.

    It is looked for between the other velocity and the hardest braking. Where an obstacle comes,
    braking does not help; then between it and a corner of the other limits. By its corrections
    alone, rows beside its own result, a step may end where no direction leads further, although
    another way round the obstacle is free. ``None`` if none is found.
    """

    def is_clear(velocity: Array) -> bool:
        return all(clearance.in_step.lacks(velocity, dt) <= _KEPT for clearance in clearances)

    def between(rest: Array) -> Array | None:
        for share in _SHARES:
            held: Array = rest + share * (velocity - rest)
            if is_clear(held):
                return held
        return None

    found = between(clearances[0].in_step.braked)
    if found is not None:
        return found
    nearest = sorted(_corners(limits), key=lambda corner: float(np.linalg.norm(corner - velocity)))
    clear = next(filter(is_clear, nearest), None)
    return None if clear is None else between(clear)


def _corners(limits: GatheredLimits) -> list[Array]:
    """Corners of the bounds that satisfy the rows; none where a joint has no bound."""
    lower, upper, n = limits.lower, limits.upper, len(limits.lower)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        return []
    if 2**n <= _CORNERS:
        sides = np.arange(2**n)[:, None] >> np.arange(n) & 1
    else:
        sides = np.random.default_rng(0).integers(0, 2, (_CORNERS, n))
    corners = np.where(sides, upper, lower)
    return list(corners[(corners @ limits.rows.T <= limits.bounds).all(axis=1)])
