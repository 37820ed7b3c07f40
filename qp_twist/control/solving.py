"""From a step's program to its verified velocity: as posed, scaled, relaxed, or level by level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.control.posed import Posed
from qp_twist.control.step import NOT_THE_LIMITS, Status, Step
from qp_twist.qp import (
    Directions,
    Found,
    InfeasibleStep,
    Level,
    QuadraticProgram,
    Refused,
    SolverInaccurate,
    Verified,
    costs_along,
    first_level,
    lexicographic,
    lost_directions,
    solve,
    solve_within,
)

WHOLE = 1.0 - 1e-8
"""Scale from which the first level counts as met at full speed: the tolerance of a verified row."""


def solved_step(
    posed: Posed, solver: str, on_infeasible: str, options: Mapping[str, Any] | None = None
) -> Step:
    """Solve the program of a step.

    Args:
        posed: The step's program.
        solver: A backend.
        on_infeasible: ``"scale"``, ``"relax"`` or ``"raise"``.
        options: Of the backend, in place of ours.

    Raises:
        InfeasibleStep: If the first level does not fit, or the robot is singular in a direction
            that it needs, and ``on_infeasible`` is ``"raise"``.
        SolverInaccurate: If the backend's result could not be verified.
    """
    levels, says = posed.levels, tuple[str, ...]()
    if levels.regular:
        result = solve(posed.problem, solver, options)
        if isinstance(result, Verified):
            multipliers = result.multipliers.box, result.multipliers.rows, 1.0
            return posed.step(result.x, Status.SOLVED, result.solver, multipliers)
        says = result.says
    first, hard = levels.directions[0], posed.hard(1)
    tried = levels.regular and len(levels.directions) == 1
    mode = "relax" if on_infeasible == "relax" else "scale"
    found = first_level(hard, first, mode, solver, options, whole=not tried)
    if isinstance(found, Refused):
        raise _not_solved(posed, solver, says + found.says)
    if on_infeasible == "raise":
        _raise_if_short(posed, found)
    if found is not None and len(levels.directions) == 1:
        status = Status.RELAXED if found.relaxed > 0.0 else Status.SCALED
        if found.scale >= WHOLE and found.relaxed == 0.0:
            status, found = Status.SOLVED, found._replace(scale=1.0)
        multipliers = found.box, found.rows, 0.0
        return posed.step(
            found.x, status, found.solver, multipliers, scale=found.scale, refused=says
        )
    return _in_order(posed, found, solver, says)


def _raise_if_short(posed: Posed, found: Found | None) -> None:
    levels = posed.levels
    if found is None or found.relaxed == 1.0:
        why = "; ".join(posed.limits.recovering)
        raise InfeasibleStep(
            "infeasible step: the limits exclude even a task at rest (scale 0)"
            f"{f': {why}' if why else ''}. Use on_infeasible='scale' for the closest step.",
            posed.problem,
        )
    A, b = levels.rows[0]
    lost = levels.where(
        lost_directions(A, found.scale * b, found.x[: A.shape[1]], levels.threshold)
    )
    if lost:
        raise InfeasibleStep(
            f"infeasible step: {NOT_THE_LIMITS}: {', '.join(map(str, lost))}. Use "
            "on_infeasible='scale' to keep the other directions.",
            posed.problem,
        )
    if found.relaxed > 0.0 or found.scale < WHOLE:
        binding = posed.binding(found.box, found.rows)
        names = ", ".join(str(limit) for limit in binding)
        why = f"binding: {names}" if names else NOT_THE_LIMITS
        raise InfeasibleStep(
            f"infeasible step: inside the limits the task can be met at {found.scale:.4g} of its "
            f"speed; {why}. Use on_infeasible='scale' to slow down.",
            posed.problem,
            binding,
        )


def _in_order(posed: Posed, found: Found | None, solver: str, says: tuple[str, ...]) -> Step:
    r"""The levels one after the other, then the cost on what they leave.

    Weak directions of every level have a slack of their own, :math:`\sigma_i v_i^T\dot{\mathbf q}
    - \sqrt{\lambda_i}\,z_i = \dots`, that costs as much as a joint's motion: the program of
    :mod:`qp_twist.qp.one_program`, in which a direction is met as far as it is not weak.
    """
    levels, problem = posed.levels, posed.hard(0)
    status, scale = Status.PRIORITIZED, 1.0
    first, pairs = levels.directions[0], zip(levels.directions, levels.rows, strict=True)
    # Rows as stated, with what they see of the motion of the levels above.
    stated = [(level.left.T @ A, level.left.T @ b) for level, (A, b) in pairs]
    rates = [b for _, b in stated]
    if found is None:
        status = Status.RELAXED
    elif found.relaxed > 0.0:
        status = Status.RELAXED
        reached = first.rows @ found.x[: first.rows.shape[1]]
        rates[0] = np.where(first.slack > 0.0, rates[0], reached)
    elif found.scale < WHOLE:
        status, scale = Status.SCALED, found.scale
        rates[0] = (first.weakness + scale * (1.0 - first.weakness)) * rates[0]
    rows, wide = _with_slacks(problem, levels.directions, [A for A, _ in stated])
    blocks = [
        Level(A, b, np.pad(G, ((0, 0), (0, wide.n - problem.n))), g)
        for A, b, (G, g) in zip(rows, rates, posed.inequalities, strict=True)
    ]
    hard = Level(np.zeros((0, wide.n)), np.zeros(0), wide.G, wide.g)
    start = np.zeros(wide.n)
    if found is not None:
        start[: problem.n] = found.x
    cascade = lexicographic([hard, *blocks], wide.lower, wide.upper, start, refine=True)
    if not hard.met(cascade.x):
        status = Status.RELAXED
    result = solve_within(wide, cascade, solver)
    if isinstance(result, Refused):
        raise _not_solved(posed, solver, says + result.says)
    if status is Status.PRIORITIZED and _lower_met(posed, result.x):
        status = Status.SOLVED
    multipliers = cascade.box_multipliers[: problem.n], np.array(cascade.row_multipliers), 0.0
    if status is Status.SCALED and found is not None:
        multipliers = found.box, np.append(found.rows, np.zeros(_own_rows(posed))), 0.0
    gaps = cascade.gaps(result.x)[1:]
    proven = all(level.proven(gap) for level, gap in zip(blocks, gaps, strict=True))
    return posed.step(
        result.x, status, result.solver, multipliers, scale=scale, refused=says + result.refused,
        gaps=gaps, proven=proven,
    )  # fmt: skip


def _not_solved(posed: Posed, solver: str, says: tuple[str, ...]) -> SolverInaccurate:
    """What is raised where the backend's results could not be verified."""
    return SolverInaccurate(
        f"{solver} did not solve a feasible step: {'; '.join(says)}.", posed.problem
    )


def _lower_met(posed: Posed, x: Array) -> bool:
    """Whether the levels below the first are met as they are stated."""
    below = zip(posed.levels.rows[1:], posed.levels.inequalities[1:], strict=True)
    return all(Level(A, b, G, g).met(x[: A.shape[1]]) for (A, b), (G, g) in below)


def _own_rows(posed: Posed) -> int:
    """Number of inequality rows of the levels below the first."""
    return sum(len(g) for _, g in posed.levels.inequalities[1:])


def _with_slacks(
    problem: QuadraticProgram, directions: list[Directions], stated: list[Array]
) -> tuple[list[Array], QuadraticProgram]:
    """The rows of all levels with a slack for each weak direction, and the program with these."""
    counts = [int((level.slack > 0.0).sum()) for level in directions]
    n, k = problem.n, sum(counts)
    rows, at, c = list[Array](), n, problem.c
    for level, A, count in zip(directions, stated, counts, strict=True):
        wide = np.zeros((len(level.rate), n + k))
        wide[:, : A.shape[1]] = A
        weak = np.flatnonzero(level.slack > 0.0)
        wide[weak, range(at, at + count)] = -np.sqrt(level.slack[weak])
        at += count
        rows.append(wide)
        c = level.free(c)
    cost = np.concatenate([costs_along(problem, v)[v.slack > 0.0] for v in directions])
    H = np.zeros((n + k, n + k))
    H[:n, :n] = problem.H
    H[range(n, n + k), range(n, n + k)] = cost
    free = np.full(k, np.inf)
    return rows, replace(
        problem, H=H, c=np.append(c, np.zeros(k)), A=np.zeros((0, n + k)),
        G=np.pad(problem.G, ((0, 0), (0, k))), lower=np.append(problem.lower, -free),
        upper=np.append(problem.upper, free),
    )  # fmt: skip
