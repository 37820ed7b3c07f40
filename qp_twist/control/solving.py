"""From a step's program to its verified velocity: as posed, scaled, relaxed, or level by level."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, binding_limits
from qp_twist.control.posing import Posed
from qp_twist.control.step import NOT_THE_LIMITS, Status, Step
from qp_twist.kernel import COMPILED
from qp_twist.kernel.constants import WHOLE
from qp_twist.qp import (
    Cascade,
    Found,
    InfeasibleStep,
    Level,
    QuadraticProgram,
    Refused,
    SolverInaccurate,
    Verified,
    costs_along,
    first_level,
    solve,
    solve_within,
    widened,
)


def solved_step(
    posed: Posed,
    solver: str,
    on_infeasible: str,
    options: Mapping[str, Any] | None = None,
    plain: Callable[[], Step] | None = None,
) -> Step:
    """Solve the program of a step by a backend, whose ``options`` take the place of ours.

    ``plain`` computes the step without elastic rows; by default this function does.

    Raises:
        InfeasibleStep: If the first level does not fit, or the robot is singular in a direction
            that it needs, and ``on_infeasible`` is ``"raise"``.
        SolverInaccurate: If the backend's result could not be verified.
    """
    first, alone = posed.levels[0].directions, len(posed.levels) == 1
    regular = all(level.directions.regular for level in posed.levels)
    # What the bounds forbid in a direction by itself need not be tried.
    if regular and first.allowed(posed.limits.lower, posed.limits.upper) == 1.0:
        result = solve(posed.problem, solver, options)
        if isinstance(result, Verified):
            box, rows = result.multipliers.box, result.multipliers.rows
            return step_of(posed, result.x, Status.SOLVED, result.solver, (box, rows, 1.0))
    if posed.elastic:
        plain = plain or partial(
            solved_step, posed.without_elastic(), solver, on_infeasible, options
        )
        return _with_elastic(posed, plain())
    mode = "relax" if on_infeasible == "relax" else "scale"
    whole = not (regular and alone)  # else it has just been tried
    found = first_level(posed.hard(1), first, mode, solver, options, whole=whole)
    if isinstance(found, Refused):
        raise _not_solved(posed, solver, found)
    if on_infeasible == "raise":
        _raise_if_short(posed, found)
    if found is None or not alone:
        return _in_order(posed, found, solver)
    status, scale = Status.SCALED, found.scale
    if found.relaxed > 0.0:
        status = Status.RELAXED
    elif scale >= WHOLE:
        status, scale = Status.SOLVED, 1.0
    return step_of(posed, found.x, status, found.solver, (found.box, found.rows, 0.0), scale)


def step_of(
    posed: Posed,
    x: Array,
    status: Status,
    solver: str,
    multipliers: tuple[Array, Array, float],
    scale: float = 1.0,
    gaps: tuple[float, ...] = (),
    proven: bool = True,
) -> Step:
    """The step of a solution x, with multipliers as arguments of :func:`_binding`."""
    velocity = x[: len(posed.limits.lower)].copy()  # of the joints alone
    lost = () if posed.levels[0].directions.regular else posed.lost(velocity, scale)
    if status is Status.SOLVED and lost:
        status = Status.DEGRADED
    elif posed.braked < 1.0 and status in (Status.SOLVED, Status.PRIORITIZED):
        status = Status.SCALED
    elif posed.braking is not None and status is Status.SOLVED:
        status = Status.PRIORITIZED
    later: dict[str, Callable[[], Any]] = {
        "binding": partial(_binding, posed, *multipliers),
        "residuals": partial(_residuals, posed, velocity.copy(), scale),
        "sigma_min": posed.sigma_min,
    }
    step = Step.with_later(lambda later, name: later[name](), later)
    step.__dict__.update(
        velocity=velocity, scale=scale * posed.braked, status=status, solver=solver,
        problem=posed.problem, lost=lost, recovering=posed.limits.recovering,
        gaps=gaps, proven=proven,
    )  # fmt: skip
    return step


def _residuals(posed: Posed, velocity: Array, scale: float) -> tuple[Array, ...]:
    """A q̇ − s b of each task; s = 1 below the first level, b of the first one as braked."""
    return tuple(
        rows.A @ velocity - (1.0 if index else scale) * rows.b
        for index, level in enumerate(posed.levels)
        for rows in level.tasks
    )


def _binding(posed: Posed, box: Array, rows: Array, floor: float = 0.0) -> tuple[BindingLimit, ...]:
    """The limits with a multiplier above ``floor``: of bounds (n,) and of rows (k,)."""
    limits = posed.limits
    kinds = limits.lower_kind, limits.upper_kind
    names, nv = limits.names, len(limits.lower)
    found = binding_limits(box[:nv], rows, floor, names, kinds, posed.sources)
    if posed.braking is not None and not found:
        dof, side = posed.braking
        return (BindingLimit(names[dof], "acceleration", side, 1.0),)
    return found


def _raise_if_short(posed: Posed, found: Found | None) -> None:
    """Raise if the first level is not met as it is stated."""
    if found is None or found.relaxed == 1.0:
        why = "; ".join(posed.limits.recovering)
        raise InfeasibleStep(
            "infeasible step: the limits exclude even a task at rest (scale 0)"
            f"{f': {why}' if why else ''}. Use on_infeasible='scale' for the closest step.",
            posed.problem,
        )
    lost = posed.lost(found.x[: len(posed.limits.lower)], found.scale)
    if lost:
        raise InfeasibleStep(
            f"infeasible step: {NOT_THE_LIMITS}: {', '.join(map(str, lost))}. Use "
            "on_infeasible='scale' to keep the other directions.",
            posed.problem,
        )
    if found.relaxed > 0.0 or found.scale < WHOLE:
        binding = _binding(posed, found.box, found.rows)
        names = ", ".join(str(limit) for limit in binding)
        why = f"binding: {names}" if names else NOT_THE_LIMITS
        raise InfeasibleStep(
            f"infeasible step: inside the limits the task can be met at {found.scale:.4g} of its "
            f"speed; {why}. Use on_infeasible='scale' to slow down.",
            posed.problem,
            binding,
        )


def _not_solved(posed: Posed, solver: str, refused: Refused) -> SolverInaccurate:
    """What is raised where the backend's result could not be verified."""
    return SolverInaccurate(
        f"{solver} did not solve a feasible step: {refused.says}.", posed.problem
    )


def _with_elastic(posed: Posed, plain: Step) -> Step:
    r"""The least price of elastic rows where the levels achieve what they do without these.

    .. math::

        \mathbf A_l\,\dot{\mathbf q} = \mathbf A_l\,\dot{\mathbf q}_0, \qquad
        \mathbf G\dot{\mathbf q} \le \max(\mathbf g, \mathbf G\dot{\mathbf q}_0)

    with :math:`\dot{\mathbf q}_0` the ``plain`` step, whose levels' rows :math:`\mathbf A_l` and
    status are kept. Prices are far above other costs, so that the package's own method solves it.
    """
    problem, nv = posed.problem, len(plain.velocity)
    start, units = np.zeros(problem.n), -problem.G[:, nv:]
    start[:nv] = plain.velocity
    over = (problem.G[:, :nv] @ plain.velocity - problem.g)[:, None]
    over = np.divide(over, units, out=np.zeros_like(units), where=units > 0.0)
    start[nv:] = over.max(axis=0, initial=0.0)  # the least slacks
    kept = Cascade.keeping(np.vstack([level.A for level in posed.levels]), problem, start)
    result = solve_within(problem, kept, COMPILED)
    if isinstance(result, Refused):
        raise _not_solved(posed, COMPILED, result)
    _, _, places, lengths = kept.rows()
    pushing = np.zeros(2 * problem.n + len(problem.g))
    pushing[places] = result.multipliers.rows / lengths
    upper, lower, rows = np.split(pushing, [problem.n, 2 * problem.n])
    velocity = result.x[:nv].copy()
    later: dict[str, Callable[[], Any]] = {
        "binding": lambda: plain.binding or _binding(posed, upper - lower, rows),
        "residuals": partial(_residuals, posed, velocity, plain.scale / posed.braked),
    }
    step = Step.with_later(
        lambda later, name: later[name]() if name in later else getattr(plain, name), later
    )
    step.__dict__.update(
        velocity=velocity, scale=plain.scale, status=plain.status, solver=result.solver,
        problem=problem, recovering=plain.recovering, gaps=plain.gaps, proven=plain.proven,
    )  # fmt: skip
    return step


def _in_order(posed: Posed, found: Found | None, solver: str) -> Step:
    r"""The levels one after the other, then the cost on what they leave.

    Weak directions of every level have a slack of their own, :math:`\sigma_i v_i^T\dot{\mathbf q}
    - \sqrt{\lambda_i}\,z_i = \dots`, that costs as much as a joint's motion: the program of
    :mod:`qp_twist.qp.one_program`, in which a direction is met as far as it is not weak.
    """
    levels, problem = posed.levels, posed.hard(0)
    status, scale = Status.PRIORITIZED, 1.0
    first = levels[0].directions
    # Rows as stated, with what they see of the motion of the levels above.
    stated = [level.directions.left.T @ level.A for level in levels]
    rates = [level.directions.left.T @ level.b for level in levels]
    if found is None:
        status = Status.RELAXED
    elif found.relaxed > 0.0:
        status = Status.RELAXED
        reached = first.rows @ found.x[: first.rows.shape[1]]
        rates[0] = np.where(first.slack > 0.0, rates[0], reached)
    elif found.scale < WHOLE:
        status, scale = Status.SCALED, found.scale
        rates[0] = (first.weakness + scale * (1.0 - first.weakness)) * rates[0]
    rows, wide = _with_slacks(posed, problem, stated)
    blocks = [
        Level(A, b, widened(level.G, wide.n), level.g)
        for A, b, level in zip(rows, rates, levels, strict=True)
    ]
    hard = Level(np.zeros((0, wide.n)), np.zeros(0), wide.G, wide.g)
    start = np.zeros(wide.n)
    if found is not None:
        start[: len(found.x)] = found.x
    cascade = Cascade([hard, *blocks], wide.lower, wide.upper, start)
    if not hard.met(cascade.x):
        status = Status.RELAXED
    result = solve_within(wide, cascade, solver)
    if isinstance(result, Refused):
        raise _not_solved(posed, solver, result)
    velocity = result.x[: len(posed.limits.lower)]
    below = (Level(level.A, level.b, level.G, level.g) for level in levels[1:])  # as stated
    if status is Status.PRIORITIZED and all(level.met(velocity) for level in below):
        status = Status.SOLVED
    multipliers = cascade.box_multipliers, np.array(cascade.row_multipliers), 0.0
    if status is Status.SCALED and found is not None:
        own = np.zeros(sum(len(level.g) for level in levels[1:]))
        multipliers = found.box, np.append(found.rows, own), 0.0
    gaps = cascade.gaps(result.x)[1:]
    proven = all(level.proven(gap) for level, gap in zip(blocks, gaps, strict=True))
    return step_of(posed, result.x, status, result.solver, multipliers, scale, gaps, proven)


def _with_slacks(
    posed: Posed, problem: QuadraticProgram, stated: list[Array]
) -> tuple[list[Array], QuadraticProgram]:
    """The rows of all levels with a slack for each weak direction, and the program with these."""
    directions = [level.directions.on(problem.n) for level in posed.levels]
    weak = [np.flatnonzero(level.weak) for level in directions]
    n, wide = problem.n, problem.widened(sum(map(len, weak)))
    rows, at, c = list[Array](), n, problem.c
    for level, A, places in zip(directions, stated, weak, strict=True):
        A_wide, slacks = widened(A, wide.n), range(at, at + len(places))
        A_wide[places, slacks] = -np.sqrt(level.slack[places])
        wide.H[slacks, slacks] = costs_along(problem, level)[places]
        at += len(places)
        rows.append(A_wide)
        c = level.free(c)
    wide.c[:n] = c
    return rows, wide
