"""mink's ``solve_ik`` with a verified result, for apps that change one import."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import mink
import numpy as np

from qp_twist.checks import Array, finite_array, number, one_of
from qp_twist.controller.infeasible import finished
from qp_twist.controller.posed import Posed
from qp_twist.controller.posing import (
    PosedLevels,
    TaskRows,
    check_magnitudes,
    lost_where,
    mink_costs,
    stacked,
)
from qp_twist.controller.step import NOT_THE_LIMITS, Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask, check_configuration
from qp_twist.kinematics.joint_ranges import joint_names
from qp_twist.limits import BoxLimit, GatheredLimits, check_model, default_limit, gather_limits
from qp_twist.qp import (
    InfeasibleStep,
    Level,
    LostDirection,
    QuadraticProgram,
    Refused,
    Verified,
    check_solver,
    regular_rows,
    solve,
)

DEPENDENT = 1e-9
"""Default of ``singularity``: rows that depend on each other to this much count once."""


def solve_ik(
    configuration: mink.Configuration,
    tasks: Sequence[mink.tasks.BaseTask],
    dt: float,
    solver: str,
    damping: float = 1e-12,
    safety_break: bool = False,
    limits: Sequence[mink.Limit] | None = None,
    constraints: Sequence[mink.Task] | None = None,
    *,
    on_infeasible: Literal["scale", "relax", "raise"] = "scale",
    singularity: float = DEPENDENT,
    **kwargs: Any,
) -> Array:
    r"""The joint velocity that :func:`mink.solve_ik` states, verified; its signature and meaning.

    .. math::

        \min_{\dot{\mathbf q}}\; \text{costs of the tasks} + \tfrac12\,damping\,
        \lVert\dot{\mathbf q}\rVert^2 \quad\text{s.t.}\quad
        \mathbf J_c\dot{\mathbf q} = -s\,k\,\mathbf e_c/dt,\quad
        \mathbf G\dot{\mathbf q} \le \mathbf h/dt

    While the constraints fit into the limits s is 1 and the velocity is mink's. Where they do not,
    mink raises; here the constraints are met at the largest s that fits (``"scale"``; 0 where they
    contradict each other), or in least squares (``"relax"``). Whatever the backend says, the result
    is checked; if it is not a solution the other backends are asked. :func:`ik_step` gives the
    velocity with all that is known of it: scale, status, binding limits.

    Args:
        configuration: Where the robot is; it is not changed.
        tasks: mink tasks, each a cost.
        dt: Length of the step, s.
        solver: A qpsolvers backend by name.
        damping: Levenberg–Marquardt damping of all degrees of freedom.
        safety_break: Whether a joint outside its range is an error; otherwise mink logs it.
        limits: mink limits and ours; ``mink.ConfigurationLimit`` if ``None``, ``[]`` for none.
        constraints: mink tasks whose rows are equalities.
        on_infeasible: What is done where the constraints do not fit.
        singularity: Singular value of the constraints' rows below which a direction is slowed down,
            as in :class:`~qp_twist.Controller`.
        kwargs: Options of the backend, which take the place of ours in the first attempt.

    Returns:
        q̇, rad/s and m/s, shape (nv,).

    Raises:
        mink.NotWithinConfigurationLimits: If ``safety_break`` is set and a joint is outside.
        InvalidInput: If an argument has the wrong type or range, or a task is not finite.
        InfeasibleStep: If the constraints do not fit and ``on_infeasible`` is ``"raise"``; as
            :class:`SolverInaccurate` a subclass of :class:`mink.NoSolutionFound`.
        SolverInaccurate: If every installed backend failed.

    Example:
        >>> import mink, qp_twist as qt
        >>> model = qt.load_task("deburring").model
        >>> configuration = mink.Configuration(model)
        >>> hand = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=1.0)
        >>> hand.set_target_from_configuration(configuration)
        >>> bool(abs(qt.solve_ik(configuration, [hand], 0.01, "daqp")).max() < 1e-9)
        True
    """
    return ik_step(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints,
        on_infeasible=on_infeasible, singularity=singularity, **kwargs,
    ).velocity  # fmt: skip


def ik_step(
    configuration: mink.Configuration,
    tasks: Sequence[mink.tasks.BaseTask],
    dt: float,
    solver: str,
    damping: float = 1e-12,
    safety_break: bool = False,
    limits: Sequence[mink.Limit] | None = None,
    constraints: Sequence[mink.Task] | None = None,
    *,
    on_infeasible: Literal["scale", "relax", "raise"] = "scale",
    singularity: float = DEPENDENT,
    **kwargs: Any,
) -> Step:
    """:func:`solve_ik` with its whole :class:`~qp_twist.Step`; residuals are of the constraints."""
    check_configuration(configuration)
    dt = number("dt", dt, above=0.0)
    check_solver(solver)
    one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
    threshold = number("singularity", singularity, at_least=0.0, at_most=1.0)
    model = configuration.model
    costs = _listed("tasks", tasks, model.nv)
    stated = [default_limit(model)] if limits is None else _listed("limits", limits, model.nv)
    exact = _listed("constraints", constraints or (), model.nv)
    if model.nv == 0:
        raise InvalidInput("solve_ik: the model has no joints to move.")
    finite_array("configuration.q", configuration.q, (model.nq,))
    configuration.check_limits(safety_break=safety_break)
    for task in (*costs, *exact):
        if isinstance(task, TwistTask):
            task.set_dt(dt)  # for its feed-forward
    H, c = mink_costs(costs, configuration, dt)
    H.flat[:: model.nv + 1] += _damping(damping, model.nv)
    check_magnitudes(H, c, c[:0])
    rows = [_constraint_rows(task, configuration, dt) for task in exact]
    gathered = gather_limits(stated, configuration, dt)
    step = None
    if not kwargs and not gathered.recovering:
        step = _by_kernel((H, c), rows, gathered, threshold)
    if step is None:
        levels = _levels(exact, rows, configuration, threshold)
        step = _by_reference((H, c), levels, gathered, solver, on_infeasible, kwargs)
    for limit in stated:
        if isinstance(limit, BoxLimit):
            limit.note(step.velocity)
    return step


def _by_kernel(
    cost: tuple[Array, Array], rows: list[TaskRows], limits: GatheredLimits, threshold: float
) -> Step | None:
    """The step where it is a plain one: all rows met at full speed inside all limits."""
    from qp_twist.controller.compiled_program import CompiledProgram  # numba takes half a second

    n = len(cost[1])
    A, b = stacked([(r.A, r.b) for r in rows], n)
    program = CompiledProgram.of(n, len(b), len(limits.bounds))
    if not program.solve(cost, (A, b), (limits.rows, limits.bounds), limits.box, threshold):
        return None
    ranks = tuple(len(r.b) for r in rows)
    return program.step(ranks, joint_names(limits.model), limits.box, limits.sources)


def _by_reference(
    cost: tuple[Array, Array],
    levels: PosedLevels,
    limits: GatheredLimits,
    solver: str,
    on_infeasible: str,
    options: dict[str, Any],
) -> Step:
    """The step by a backend of qpsolvers, whatever becomes of it."""
    if on_infeasible == "raise" and levels.lost:
        names = ", ".join(str(lost) for lost in levels.lost)
        raise InfeasibleStep(f"infeasible step: {NOT_THE_LIMITS}: {names}.")
    problem = QuadraticProgram(
        *cost, *levels.equality, limits.rows, limits.bounds, limits.lower, limits.upper
    )
    posed = Posed.of(problem, levels, limits, list(limits.sources))
    result = solve(posed.problem, solver, options=options)
    if options and isinstance(result, Refused):
        again, before = solve(posed.problem, solver), result.says
        result = replace(again, refused=before) if isinstance(again, Verified) else again
    return finished(posed, result, solver, on_infeasible)


def _damping(damping: Any, nv: int) -> float | Array:
    """mink's damping: a number, or one for each degree of freedom."""
    if np.ndim(damping) == 0:
        return number("damping", damping, at_least=0.0)
    found = finite_array("damping", damping, (nv,))
    if (found < 0.0).any():
        raise InvalidInput(f"damping: expected numbers of at least 0, got {found.min():g}.")
    return found


def _constraint_rows(task: mink.Task, configuration: mink.Configuration, dt: float) -> TaskRows:
    """J q̇ = −k e/dt of a constraint."""
    name, nv = type(task).__name__, configuration.model.nv
    jacobian = finite_array(
        f"{name}: its Jacobian", task.compute_jacobian(configuration), (None, nv)
    )
    error = finite_array(f"{name}: its error", task.compute_error(configuration), (len(jacobian),))
    return TaskRows(jacobian, -task.gain * error / dt)


def _levels(
    constraints: Sequence[mink.Task],
    rows: list[TaskRows],
    configuration: mink.Configuration,
    threshold: float,
) -> PosedLevels:
    """The constraints, with their rows, as one level."""
    nv = configuration.model.nv
    lost, regular = list[LostDirection](), list[tuple[Array, Array]]()
    for task, stated in zip(constraints, rows, strict=True):
        # What a task cannot do for itself is given up; the rest of it stays.
        own = regular_rows(stated.A, stated.b, threshold)
        lost += lost_where([task], [stated], own.lost, configuration)
        regular.append((np.vstack([own.A, own.damped]), np.concatenate([own.b, own.damped_b])))
    A, b = stacked(regular, nv)
    whole = regular_rows(A, b, threshold)
    none = np.zeros((0, nv)), np.zeros(0)
    levels = [Level(whole.A, whole.b, *none)]
    if any(direction.sigma <= DEPENDENT for direction in whole.lost):
        # Constraints that contradict each other: none gives way, together they stand (s = 0).
        levels = [Level(A, b, *none)]
    else:
        blocks = [TaskRows(*block) for block in regular]
        lost += lost_where(constraints, blocks, whole.lost, configuration)
        if len(whole.damped_b):
            levels.append(Level(whole.damped, whole.damped_b, *none))
    return PosedLevels(
        levels, [0] * len(levels), [], [rows], whole.sigma_min, tuple(lost), False, []
    )


_ASKED = {
    "tasks": ("compute_qp_residual",),
    "limits": ("compute_qp_inequalities",),
    "constraints": ("compute_error", "compute_jacobian"),
}
"""What mink calls of an item of each list."""


def _listed(name: str, items: Any, nv: int) -> Sequence[Any]:
    """The items, each of which has what mink would call; any iterable will do."""
    if not isinstance(items, (list, tuple)):
        if isinstance(items, (str, bytes)) or not isinstance(items, Iterable):
            raise InvalidInput(f"solve_ik: {name} is a list of mink {name}; got {items!r}.")
        items = list(items)
    found: Sequence[Any] = items
    for index, item in enumerate(items):
        if not all(hasattr(item, asked) for asked in _ASKED[name]):
            others = [other for other, calls in _ASKED.items() if hasattr(item, calls[0])]
            hint = f" It belongs into {others[0]}=." if others else ""
            raise InvalidInput(
                f"solve_ik: {name}[{index}] is {type(item).__name__}, which is none of mink's "
                f"{name}.{hint}"
            )
        check_model(f"solve_ik: {name}[{index}]", item, nv)
    return found
