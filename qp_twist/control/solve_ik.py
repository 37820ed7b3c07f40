"""mink's ``solve_ik`` with a verified result, for apps that change one import."""

from __future__ import annotations

import inspect
import logging
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import (
    Array,
    are_rows,
    did_you_mean,
    finite_array,
    largest,
    number,
    one_of,
)
from qp_twist.constraints import (
    Box,
    BoxLimit,
    Constraint,
    LimitRows,
    MinkRange,
    bounds_of,
    check_constraint,
    check_model,
    default_range,
    gather_limits,
)
from qp_twist.control.mink_costs import (
    WeightedRows,
    as_rows,
    check_cost,
    check_target,
    mink_cost,
    name_of,
    refuse_elastic,
)
from qp_twist.control.posing import (
    FASTEST,
    Posed,
    PosedLevel,
    TaskRows,
    check_magnitudes,
    check_speed,
    stacked,
)
from qp_twist.control.solving import solved_step
from qp_twist.control.step import Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask, check_configuration
from qp_twist.kinematics.joint_ranges import joint_names
from qp_twist.qp import Directions, QuadraticProgram, check_solver

if TYPE_CHECKING:
    from qp_twist.control.compiled_program import CompiledProgram

DEFAULT_SINGULARITY = 1e-9
"""Default of ``singularity``: rows whose smallest singular value is below it are dependent."""

_MINK_LOG = logging.getLogger(mink.__name__)
_CHECK_LIMITS = mink.Configuration.check_limits


def solve_ik(
    configuration: mink.Configuration,
    tasks: Iterable[mink.tasks.BaseTask],
    dt: float,
    solver: str,
    damping: float | Array = 1e-12,
    safety_break: bool = False,
    limits: Iterable[mink.Limit] | None = None,
    constraints: Iterable[mink.Task] | None = None,
    *,
    on_infeasible: Literal["scale", "relax", "raise"] = "scale",
    singularity: float = DEFAULT_SINGULARITY,
    **kwargs: Any,
) -> Array:
    r"""The joint velocity of :func:`mink.solve_ik`, verified; same signature and meaning.

    .. math::

        \min_{\dot{\mathbf q}}\; \text{costs of the tasks} + \tfrac12\,damping\,
        \lVert\dot{\mathbf q}\rVert^2 \quad\text{s.t.}\quad
        \mathbf J_c\dot{\mathbf q} = -s\,k\,\mathbf e_c/dt,\quad
        \mathbf G\dot{\mathbf q} \le \mathbf h/dt

    If the constraints are feasible within the limits, s is 1 and the velocity is mink's. If not,
    mink raises; here the constraints are met at the largest feasible s (``"scale"``; 0 if they
    contradict each other) or in least squares (``"relax"``). The result of the backend is verified;
    what is none is an error. :func:`ik_step` also returns scale, status and binding limits.

    Args:
        configuration: Configuration of the robot; not modified.
        tasks: mink tasks, each a cost. Tasks, limits and constraints may be any iterables of
            objects that have the methods which mink calls.
        dt: Length of the step, s.
        solver: Name of a qpsolvers backend.
        damping: Levenberg–Marquardt damping, a number or one for each degree of freedom, (nv,).
        safety_break: Whether a joint outside its range is an error; otherwise mink logs it.
        limits: Limits of mink and this package; ``None`` for ``mink.ConfigurationLimit``, ``[]``
            for none.
        constraints: mink tasks whose rows are equality constraints.
        on_infeasible: What to do if the constraints are infeasible.
        singularity: Singular value of the constraints' rows below which a direction is slowed down,
            as in :class:`~qp_twist.Controller`.
        kwargs: Options of the backend; they replace this package's.

    Returns:
        q̇, rad/s and m/s, shape (nv,).

    Raises:
        mink.NotWithinConfigurationLimits: If ``safety_break`` is set and a joint is outside.
        UnknownSolver: If there is no such backend; also a ``qpsolvers.SolverNotFound``.
        InvalidInput: If an argument has the wrong type or range, or a task is not finite.
        InfeasibleStep: If the constraints are infeasible and ``on_infeasible`` is ``"raise"``; a
            subclass of :class:`mink.NoSolutionFound`, as :class:`SolverInaccurate` is.
        SolverInaccurate: If the backend's result could not be verified.

    Example:
        >>> import mink, qp_twist as qt
        >>> model = qt.load_task("deburring").model
        >>> configuration = mink.Configuration(model)
        >>> hand = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=1.0)
        >>> hand.set_target_from_configuration(configuration)
        >>> bool(abs(qt.solve_ik(configuration, [hand], 0.01, "daqp")).max() < 1e-9)
        True
    """
    problem, solved = _solved(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints,
        on_infeasible, singularity, kwargs,
    )  # fmt: skip
    velocity = solved.velocity.copy()
    problem.note(velocity)
    return velocity


def ik_step(
    configuration: mink.Configuration,
    tasks: Iterable[mink.tasks.BaseTask],
    dt: float,
    solver: str,
    damping: float | Array = 1e-12,
    safety_break: bool = False,
    limits: Iterable[mink.Limit] | None = None,
    constraints: Iterable[mink.Task] | None = None,
    *,
    on_infeasible: Literal["scale", "relax", "raise"] = "scale",
    singularity: float = DEFAULT_SINGULARITY,
    **kwargs: Any,
) -> Step:
    """:func:`solve_ik`, returning a :class:`~qp_twist.Step` with the constraints' residuals."""
    problem, solved = _solved(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints,
        on_infeasible, singularity, kwargs,
    )  # fmt: skip
    step = solved
    if not isinstance(step, Step):
        ranks = tuple(len(rows.b) for rows in problem.rows)
        step = step.step(ranks, joint_names(configuration.model))
        step.__dict__["recovering"] = problem.recovering(configuration)
    problem.note(step.velocity)
    return step


class _Problem(NamedTuple):
    """Tasks, limits and constraints, each evaluated once, as mink does."""

    tasks: Sequence[mink.tasks.BaseTask]
    costs: list[WeightedRows | mink.Objective]
    """Costs of the tasks."""
    limits: Sequence[mink.Limit] | None
    """``None`` for mink's default."""
    bounds: Sequence[MinkRange | LimitRows | tuple[Box, ...]]
    """Bounds and rows of the limits, each in the most compact form known for its class."""
    constraints: Sequence[mink.Task]
    rows: list[TaskRows]
    """Rows of the constraints."""
    damping: float | Array
    dt: float

    @property
    def own_limits(self) -> list[Any]:
        """The limits of classes of this package."""
        return [limit for limit in self.limits or () if _is_a(limit, BoxLimit)]

    def recovering(self, configuration: mink.Configuration) -> tuple[str, ...]:
        """Messages about joints and constraints that are outside their limits."""
        row_sets = [bounds for bounds in self.bounds if isinstance(bounds, LimitRows)]
        own = self.own_limits
        return (
            *(text for limit in own for text in limit.recovering(configuration, self.dt)),
            *(text for rows in row_sets for text in rows.recovering(configuration)),
        )

    def note(self, velocity: Array) -> None:
        """Store the new joint velocity in the limits that need the previous one."""
        for limit in self.own_limits:
            limit.note(velocity)


def _solved(
    configuration: mink.Configuration,
    tasks: Iterable[mink.tasks.BaseTask],
    dt: float,
    solver: str,
    damping: float | Array,
    safety_break: bool,
    limits: Iterable[mink.Limit] | None,
    constraints: Iterable[mink.Task] | None,
    on_infeasible: str,
    singularity: float,
    options: dict[str, Any],
) -> tuple[_Problem, CompiledProgram | Step]:
    """The evaluated problem, and the program solved by the kernel or the reference's step."""
    from qp_twist.control.compiled_program import CompiledProgram  # numba takes half a second

    check_configuration(configuration)
    dt = number("dt", dt.item() if isinstance(dt, np.ndarray) and dt.size == 1 else dt, above=0.0)
    check_solver(solver)
    one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
    threshold = number("singularity", singularity, at_least=0.0, at_most=1.0)
    model = configuration.model
    if model.nv == 0:
        raise InvalidInput("solve_ik: the model has no joints to move.")
    q = configuration.data.qpos
    if not math.isfinite(np.add.reduce(q)):
        finite_array("configuration.q", configuration.q, (model.nq,))
    if safety_break or _check_has_effect(configuration):
        configuration.check_limits(safety_break=safety_break)
    problem = _evaluated(configuration, tasks, dt, _damping(damping, model.nv), limits, constraints)

    program = CompiledProgram.of(model.nv)
    program.begin()
    program.add_costs(problem.costs, problem.damping)
    for bounds in problem.bounds:
        if isinstance(bounds, MinkRange):
            program.add_range(bounds, q, dt)
        elif isinstance(bounds, LimitRows):
            program.add_rows(bounds, dt)
        else:
            for box in bounds:
                program.add_box(box)
    for constraint, rows in zip(problem.constraints, problem.rows, strict=True):
        if not largest(rows.b) <= FASTEST:
            _check_rows(constraint, rows)
        program.add_equality(rows.A, rows.b)
    slowed = threshold if threshold > DEFAULT_SINGULARITY else 0.0
    if not options and program.solve(dt, slowed, on_infeasible == "scale"):
        return problem, program
    return problem, _by_reference(
        problem, program.cost(dt), configuration, solver, on_infeasible, threshold, options
    )


def _check_has_effect(configuration: mink.Configuration) -> bool:
    """Whether mink's check of the joints does more than write log lines that are discarded."""
    check = getattr(configuration.check_limits, "__func__", None)
    return check is not _CHECK_LIMITS or _MINK_LOG.isEnabledFor(logging.DEBUG)


def _evaluated(
    configuration: mink.Configuration,
    tasks: Iterable[mink.tasks.BaseTask],
    dt: float,
    damping: float | Array,
    limits: Iterable[mink.Limit] | None,
    constraints: Iterable[mink.Task] | None,
) -> _Problem:
    """Evaluate tasks, limits and constraints; an item that cannot be evaluated is named."""
    costed = _listed("tasks", tasks)
    limiting = None if limits is None else _listed("limits", limits)
    if not isinstance(constraints, Iterable):
        constraints = constraints or ()  # as in mink
    equalities = _listed("constraints", constraints)
    try:
        task: Any
        for task in (*costed, *equalities):
            if _is_a(task, TwistTask):
                task.set_dt(dt)  # for its feed-forward
        costs = [mink_cost(task, configuration) for task in costed]
        bounds: list[MinkRange | LimitRows | tuple[Box, ...]]
        if limiting is None:
            model = configuration.model
            bounds = [
                default_range(model)
                or LimitRows.of(mink.ConfigurationLimit(model), configuration, dt)
            ]
        else:
            bounds = [bounds_of(limit, configuration, dt) for limit in limiting]
        rows = [_constraint_rows(task, configuration, dt) for task in equalities]
    except Exception:
        _check_items("tasks", costed, configuration.model)
        _check_items("limits", limiting or (), configuration.model)
        _check_items("constraints", equalities, configuration.model)
        raise
    return _Problem(costed, costs, limiting, bounds, equalities, rows, damping, dt)


def _by_reference(
    evaluated: _Problem,
    cost: tuple[Array, Array],
    configuration: mink.Configuration,
    solver: str,
    on_infeasible: str,
    threshold: float,
    options: dict[str, Any],
) -> Step:
    """Compute the step by a backend of qpsolvers; values that are not finite are named."""
    for task, task_cost in zip(evaluated.tasks, evaluated.costs, strict=True):
        check_cost(task, task_cost)
    for constraint, rows in zip(evaluated.constraints, evaluated.rows, strict=True):
        _check_rows(constraint, rows)
    own = evaluated.limits
    if own is None:
        own = [mink.ConfigurationLimit(configuration.model)]
    limits = gather_limits(
        [
            bounds if isinstance(bounds, LimitRows) else limit
            for limit, bounds in zip(own, evaluated.bounds, strict=True)
        ],
        configuration,
        evaluated.dt,
    )
    whole = [
        Directions.of(rows.A, rows.b, evaluated.dt, threshold, damp=False, smooth=False)
        for rows in evaluated.rows
    ]
    # What a constraint contradicts in itself it does not ask for.
    turns = [v.left[:, v.sigma > 0.0] for v in whole]
    asked = [
        (turn.T @ r.A, v.rate[v.sigma > 0.0])
        for turn, v, r in zip(turns, whole, evaluated.rows, strict=True)
    ]
    A, b = stacked(asked, configuration.model.nv)
    directions = Directions.of(A, b, evaluated.dt, threshold, damp=False, smooth=False)
    if directions.contradicts:  # none of the constraints gives way: all are scaled together
        directions = Directions.as_stated(A, b)
    level = PosedLevel(evaluated.rows, A, b, directions, A[:0], b[:0])
    problem = QuadraticProgram(*cost, A, b, limits.rows, limits.bounds, limits.lower, limits.upper)
    check_magnitudes(problem)
    posed = Posed(
        problem, [level], limits, list(limits.sources), evaluated.constraints, configuration,
        threshold, turns,
    )  # fmt: skip
    try:
        return solved_step(posed, solver, on_infeasible, options)
    except InvalidInput as error:  # the backend does not know an option
        parameters = inspect.signature(ik_step).parameters
        meant = "".join(f" {name!r}{did_you_mean(name, parameters)}" for name in options)
        raise InvalidInput(f"{error} As arguments of solve_ik:{meant}") from error


def _damping(damping: Any, nv: int) -> float | Array:
    """Check mink's damping: a number, or one for each degree of freedom."""
    if type(damping) is float:  # nearly always
        return number("damping", damping, at_least=0.0)
    if np.size(damping) == 1:
        return number("damping", np.asarray(damping).item(), at_least=0.0)
    values = finite_array("damping", damping, (nv,))
    if (values < 0.0).any():
        raise InvalidInput(f"damping: expected numbers of at least 0, got {values.min():g}.")
    return values


def _constraint_rows(task: Any, configuration: mink.Configuration, dt: float) -> TaskRows:
    """Rows J q̇ = −k e/dt of a constraint."""
    refuse_elastic(task)
    if _has_joint_evaluation(task):
        return TaskRows(*task.velocity_rows(configuration, dt))
    jacobian, error = task.compute_jacobian(configuration), task.compute_error(configuration)
    nv = configuration.model.nv
    if not are_rows(jacobian, error, nv):
        what = f"{name_of(task)}: its"
        jacobian, error = as_rows(jacobian, error, nv, f"{what} Jacobian", f"{what} error")
    return TaskRows(jacobian, -task.gain * error / dt)


def _is_a(item: object, ours: type) -> bool:
    """``isinstance``, in a third of the time that it takes for mink's abstract classes."""
    return ours in type(item).__mro__


def _has_joint_evaluation(task: Any) -> bool:
    """Whether a task has the error and Jacobian of :class:`~qp_twist.TwistTask`.

    Then ``velocity_rows`` evaluates both at once.
    """
    kind = type(task)
    return _is_a(task, TwistTask) and all(
        getattr(kind, name) is getattr(TwistTask, name) and name not in task.__dict__
        for name in ("compute_error", "compute_jacobian", "velocity_rows")
    )


def _check_rows(task: mink.Task, rows: TaskRows) -> None:
    """Refuse rows of a constraint that are not finite or require an impossible speed; name it."""
    check_target(task)
    name = name_of(task)
    finite_array(f"{name}: its Jacobian", rows.A, rows.A.shape)
    finite_array(f"{name}: its error", rows.b, rows.b.shape)
    check_speed(f"{name} asks", rows.b)


_METHODS_CALLED = {
    "tasks": ("compute_qp_residual",),
    "limits": ("compute_qp_inequalities",),
    "constraints": ("compute_error", "compute_jacobian"),
}
"""Methods that mink calls on the items of each list."""


def _listed(name: str, items: Any) -> Sequence[Any]:
    """Items of an iterable."""
    if isinstance(items, (list, tuple)):
        return items
    if isinstance(items, (str, bytes)) or not isinstance(items, Iterable):
        raise InvalidInput(f"solve_ik: {name} is a list of mink {name}; got {items!r}.")
    return list(items)


def _check_items(name: str, items: Sequence[Any], model: mujoco.MjModel) -> None:
    """Refuse an item that lacks the methods mink calls, or belongs to another model."""
    for index, item in enumerate(items):
        if not all(hasattr(item, method) for method in _METHODS_CALLED[name]):
            others = [other for other, calls in _METHODS_CALLED.items() if hasattr(item, calls[0])]
            hint = f" It belongs into {others[0]}=." if others else ""
            raise InvalidInput(
                f"solve_ik: {name}[{index}] is {type(item).__name__}, which is none of mink's "
                f"{name}.{hint}"
            )
        label = f"solve_ik: {name}[{index}]"
        if isinstance(item, type):
            raise InvalidInput(
                f"{label} is the class {item.__name__}; make an object of it: {item.__name__}(…)."
            )
        check_model(label, item, model.nv)
        if isinstance(item, Constraint):
            check_constraint(f"{label}, {type(item).__name__}", item, model)
