"""What to do when the levels cannot all be met: scale, relax or raise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.control.posed import Posed
from qp_twist.control.step import NOT_THE_LIMITS, Status, Step
from qp_twist.qp import (
    SCALE_BACKOFF,
    InfeasibleStep,
    LargestScale,
    Refused,
    SolverInaccurate,
    Verified,
    largest_scale,
    lexicographic,
    solve,
    solve_within,
)


def finished(posed: Posed, result: Verified | Refused, solver: str, on_infeasible: str) -> Step:
    """The step for a backend's result; if it was refused, find out why and scale, relax or raise.

    Args:
        posed: The step's program.
        result: The backend's result.
        solver: The backend's name.
        on_infeasible: ``"scale"``, ``"relax"`` or ``"raise"``.

    Raises:
        InfeasibleStep: If the first level is infeasible and ``on_infeasible`` is ``"raise"``.
        SolverInaccurate: If the step is feasible and no backend solved it.
    """
    if isinstance(result, Verified):
        return solved_as_posed(posed, result)
    first, problem = posed.padded[0], posed.problem
    # The residual decides if the first level is feasible, because it has a unit: for a task that is
    # met up to rounding, the largest scale is arbitrary.
    closest = lexicographic([posed.hard, first], problem.lower, problem.upper)
    feasible = posed.hard.met(closest.x) and first.met(closest.x)
    if feasible:
        largest: LargestScale | None = LargestScale.full(closest.x)
    else:  # for the hard rows and the first level only
        G, g = np.vstack([posed.hard.G, first.G]), np.concatenate([posed.hard.g, first.g])
        largest = largest_scale(replace(problem, A=first.A, b=first.b, G=G, g=g))
    if largest is None or largest.scale < 1.0 - SCALE_BACKOFF:
        if on_infeasible == "raise":
            raise infeasible_step(posed, largest)
        if largest is None or on_infeasible == "relax":
            start = np.zeros(problem.n) if largest is None else largest.x
            return _cascade(posed, solver, 1.0, start, Status.RELAXED)
        return _scaled(posed, solver, largest)
    # The first level is feasible. Either a lower level is not, or the solver failed.
    if not any(len(level.b) + len(level.g) for level in posed.padded[1:]):
        result = solve(problem, solver, persist=True)
        if isinstance(result, Verified):
            return solved_as_posed(posed, result)
        if result.claimed:
            raise inaccurate(posed, result)
    return _cascade(posed, solver, 1.0, largest.x, Status.PRIORITIZED, refused=result.says)


def solved_as_posed(posed: Posed, result: Verified) -> Step:
    """The step of a program that was solved as posed."""
    status = Status.SOLVED
    if posed.levels.lost:
        status = Status.DEGRADED
    elif posed.levels.lower_lost:
        status = Status.PRIORITIZED
    return posed.step(
        result.x,
        status,
        result.solver,
        (result.multipliers.box, result.multipliers.rows, 1.0),
        refused=result.refused,
    )


def _scaled(posed: Posed, solver: str, largest: LargestScale) -> Step:
    scale = largest.scale * (1.0 - SCALE_BACKOFF)
    multipliers = largest.box_multipliers, largest.row_multipliers, 0.0
    if len(posed.padded) == 1:
        problem = posed.problem.with_rows(scale * posed.problem.b)
        result = solve(problem, solver)
        if isinstance(result, Verified):
            return posed.step(
                result.x, Status.SCALED, result.solver, multipliers, scale=scale, problem=problem
            )
    # The feasible set may be too thin for a backend; the point of the largest scale is inside.
    return _cascade(posed, solver, scale, largest.x, Status.SCALED, multipliers=multipliers)


def _cascade(
    posed: Posed,
    solver: str,
    scale: float,
    start: Array,
    status: Status,
    *,
    multipliers: tuple[Array, Array, float] | None = None,
    refused: tuple[str, ...] = (),
) -> Step:
    """Minimise the levels in order from ``start``, then the cost in the remaining freedom."""
    problem = posed.problem
    levels = [
        replace(level, b=scale * level.b) if stated == 0 else level
        for stated, level in zip(posed.levels.stated, posed.padded, strict=True)
    ]
    cascade = lexicographic([posed.hard, *levels], problem.lower, problem.upper, start, refine=True)
    if not posed.hard.met(cascade.x):
        status = Status.RELAXED
    if status is Status.PRIORITIZED:
        if posed.levels.lost:
            status = Status.DEGRADED
        elif all(level.met(cascade.x) for level in levels) and not posed.levels.lower_lost:
            status = Status.SOLVED
    result = solve_within(problem, cascade, solver)
    if isinstance(result, Refused):
        raise inaccurate(posed, result)
    if multipliers is None:
        multipliers = cascade.box_multipliers, np.array(cascade.row_multipliers), 0.0
    gaps = cascade.gaps(result.x)[1:]
    return posed.step(
        result.x,
        status,
        result.solver,
        multipliers,
        scale=scale,
        problem=problem.with_rows(np.concatenate([level.b for level in levels])),
        refused=refused + result.refused,
        gaps=posed.levels.as_stated(gaps),
        proven=all(level.proven(gap) for level, gap in zip(levels, gaps, strict=True)),
    )


def infeasible_step(posed: Posed, largest: LargestScale | None) -> InfeasibleStep:
    """What ``on_infeasible="raise"`` raises at a largest scale below 1, or without any."""
    if largest is None:
        why = "; ".join(posed.limits.recovering)
        return InfeasibleStep(
            "infeasible step: the limits exclude even a task at rest (scale 0)"
            f"{f': {why}' if why else ''}. Use on_infeasible='scale' for the closest step.",
            posed.problem,
        )
    binding = posed.binding(largest.box_multipliers, largest.row_multipliers)
    names = ", ".join(str(limit) for limit in binding)
    why = f"binding: {names}" if names else NOT_THE_LIMITS
    return InfeasibleStep(
        f"infeasible step: inside the limits the task can be met at {largest.scale:.4g} of its "
        f"speed; {why}. Use on_infeasible='scale' to slow down.",
        posed.problem,
        binding,
    )


def inaccurate(posed: Posed, result: Refused) -> SolverInaccurate:
    """What is raised where every backend failed on a feasible step."""
    return SolverInaccurate(
        f"no backend solved a feasible step: {'; '.join(result.says)}.", posed.problem
    )
