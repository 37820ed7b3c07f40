"""mink's ``solve_ik`` with a verified result, for apps that change one import."""

from __future__ import annotations

import inspect
import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
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
    MinkRange,
    StatedRows,
    check_constraint,
    check_model,
    default_range,
    gather_limits,
    range_of,
    speeds_of,
)
from qp_twist.control.infeasible import finished
from qp_twist.control.posed import Posed
from qp_twist.control.posing import (
    FASTEST,
    PosedLevels,
    TaskRows,
    WeightedRows,
    as_rows,
    check_cost,
    check_magnitudes,
    check_speed,
    check_target,
    lost_where,
    mink_cost,
    name_of,
    stacked,
)
from qp_twist.control.step import NOT_THE_LIMITS, Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask, check_configuration
from qp_twist.kinematics.joint_ranges import joint_names
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

if TYPE_CHECKING:
    from qp_twist.control.compiled_program import CompiledProgram

DEPENDENT = 1e-9
"""Default of ``singularity``: rows that depend on each other to this much count once."""

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
        tasks: mink tasks, each a cost. As of limits and constraints, any iterable will do, and
            anything that has the methods which mink calls.
        dt: Length of the step, s.
        solver: A qpsolvers backend by name.
        damping: Levenberg–Marquardt damping of all degrees of freedom, or of each, (nv,).
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
        UnknownSolver: If there is no such backend; it is a ``qpsolvers.SolverNotFound``, too.
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
    request, solved = _solved(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints,
        on_infeasible, singularity, kwargs,
    )  # fmt: skip
    velocity = solved.velocity.copy()
    request.note(velocity)
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
    singularity: float = DEPENDENT,
    **kwargs: Any,
) -> Step:
    """:func:`solve_ik` with its whole :class:`~qp_twist.Step`; residuals are of the constraints."""
    request, solved = _solved(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints,
        on_infeasible, singularity, kwargs,
    )  # fmt: skip
    step = solved
    if not isinstance(step, Step):
        ranks = tuple(len(rows.b) for rows in request.rows)
        step = step.step(ranks, joint_names(configuration.model))
        step.__dict__["recovering"] = request.recovering(configuration)
    request.note(step.velocity)
    return step


class _Request(NamedTuple):
    """What tasks, limits and constraints have stated, each asked once, as mink does."""

    tasks: Sequence[mink.tasks.BaseTask]
    costs: list[WeightedRows | mink.Objective]
    """Of the tasks."""
    limits: Sequence[mink.Limit] | None
    """``None`` for mink's own default."""
    findings: Sequence[MinkRange | StatedRows | tuple[Box, ...]]
    """What the limits say, each in the shortest form that is known of its class."""
    constraints: Sequence[mink.Task]
    rows: list[TaskRows]
    """Of the constraints."""
    damping: float | Array
    dt: float

    @property
    def ours(self) -> list[Any]:
        """Those of the limits that are of this package."""
        return [limit for limit in self.limits or () if _is_a(limit, BoxLimit)]

    def recovering(self, configuration: mink.Configuration) -> tuple[str, ...]:
        """What our limits, and constraints of anybody's, say of what is outside."""
        stated = [f for f in self.findings if isinstance(f, StatedRows)]
        return (
            *(words for limit in self.ours for words in limit.recovering(configuration, self.dt)),
            *(words for rows in stated for words in rows.recovering(configuration)),
        )

    def note(self, velocity: Array) -> None:
        """Tell our limits which velocity is running from now on."""
        for limit in self.ours:
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
) -> tuple[_Request, CompiledProgram | Step]:
    """What was asked, and the program as the kernel has solved it or the reference's step."""
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
    if safety_break or _check_is_heard(configuration):
        configuration.check_limits(safety_break=safety_break)
    request = _asked(configuration, tasks, dt, _damping(damping, model.nv), limits, constraints)

    program = CompiledProgram.of(model.nv)
    program.begin()
    program.add_costs(request.costs, request.damping)
    for found in request.findings:
        if isinstance(found, MinkRange):
            program.add_range(found, q, dt)
        elif isinstance(found, StatedRows):
            program.add_rows(found, dt)
        else:
            for box in found:
                program.add_box(box)
    for constraint, rows in zip(request.constraints, request.rows, strict=True):
        if not largest(rows.b) <= FASTEST:
            _check_rows(constraint, rows)
        program.add_equality(rows.A, rows.b)
    if not options and program.solve(dt, threshold, on_infeasible == "scale"):
        return request, program
    return request, _by_reference(
        request, program.cost(dt), configuration, solver, on_infeasible, threshold, options
    )


def _check_is_heard(configuration: mink.Configuration) -> bool:
    """Whether mink's check of the joints does more than write lines of its log for nobody."""
    check = getattr(configuration.check_limits, "__func__", None)
    return check is not _CHECK_LIMITS or _MINK_LOG.isEnabledFor(logging.DEBUG)


def _asked(
    configuration: mink.Configuration,
    tasks: Iterable[mink.tasks.BaseTask],
    dt: float,
    damping: float | Array,
    limits: Iterable[mink.Limit] | None,
    constraints: Iterable[mink.Task] | None,
) -> _Request:
    """What everybody states; whoever cannot be asked is named."""
    given = _listed("tasks", tasks)
    stated = None if limits is None else _listed("limits", limits)
    if not isinstance(constraints, Iterable):
        constraints = constraints or ()  # as in mink
    exact = _listed("constraints", constraints)
    try:
        task: Any
        for task in (*given, *exact):
            if _is_a(task, TwistTask):
                task.set_dt(dt)  # for its feed-forward
        costs = [mink_cost(task, configuration) for task in given]
        findings: list[MinkRange | StatedRows | tuple[Box, ...]]
        if stated is None:
            findings = [default_range(configuration.model)]
        else:
            findings = [_finding(limit, configuration, dt) for limit in stated]
        rows = [_constraint_rows(task, configuration, dt) for task in exact]
    except Exception:
        for name, items in (("tasks", given), ("limits", stated or ()), ("constraints", exact)):
            _check_items(name, items, configuration.model)
        raise
    return _Request(given, costs, stated, findings, exact, rows, damping, dt)


def _finding(
    limit: Any, configuration: mink.Configuration, dt: float
) -> MinkRange | StatedRows | tuple[Box, ...]:
    """What a limit says: mink's own on single joints are known and need not state their rows."""
    if type(limit) is mink.ConfigurationLimit:
        found = range_of(limit, configuration.model)
        if found is not None:
            return found
    elif type(limit) is mink.VelocityLimit:
        speeds = speeds_of(limit, configuration.model.nv)
        if speeds is not None:
            return (speeds,)
    elif _is_a(limit, BoxLimit):
        boxes: tuple[Box, ...] = limit.boxes(configuration, dt)
        return boxes
    return StatedRows.of(limit, configuration, dt)


def _by_reference(
    request: _Request,
    cost: tuple[Array, Array],
    configuration: mink.Configuration,
    solver: str,
    on_infeasible: str,
    threshold: float,
    options: dict[str, Any],
) -> Step:
    """The step by a backend of qpsolvers, whatever becomes of it; what is no number is named."""
    for task, found in zip(request.tasks, request.costs, strict=True):
        check_cost(task, found)
    for constraint, rows in zip(request.constraints, request.rows, strict=True):
        _check_rows(constraint, rows)
    stated = request.limits
    limits = gather_limits(
        [mink.ConfigurationLimit(configuration.model)] if stated is None else stated,
        configuration,
        request.dt,
        {i: found for i, found in enumerate(request.findings) if isinstance(found, StatedRows)},
    )
    levels = _levels(request.constraints, request.rows, configuration, threshold)
    if on_infeasible == "raise" and levels.lost:
        names = ", ".join(str(lost) for lost in levels.lost)
        raise InfeasibleStep(f"infeasible step: {NOT_THE_LIMITS}: {names}.")
    problem = QuadraticProgram(
        *cost, *levels.equality, limits.rows, limits.bounds, limits.lower, limits.upper
    )
    check_magnitudes(problem, problem.c[:0])
    posed = Posed.of(problem, levels, limits)
    try:
        result = solve(posed.problem, solver, options=options)
    except InvalidInput as error:  # of an option that the backend does not know
        own = inspect.signature(ik_step).parameters
        meant = "".join(f" {name!r}{did_you_mean(name, own)}" for name in options)
        raise InvalidInput(f"{error} As arguments of solve_ik:{meant}") from error
    if options and isinstance(result, Refused):
        again, before = solve(posed.problem, solver), result.says
        result = replace(again, refused=before) if isinstance(again, Verified) else again
    return finished(posed, result, solver, on_infeasible)


def _damping(damping: Any, nv: int) -> float | Array:
    """mink's damping: a number, or one for each degree of freedom."""
    if type(damping) is float:  # nearly always
        return number("damping", damping, at_least=0.0)
    if np.size(damping) == 1:
        return number("damping", np.asarray(damping).item(), at_least=0.0)
    found = finite_array("damping", damping, (nv,))
    if (found < 0.0).any():
        raise InvalidInput(f"damping: expected numbers of at least 0, got {found.min():g}.")
    return found


def _constraint_rows(task: Any, configuration: mink.Configuration, dt: float) -> TaskRows:
    """J q̇ = −k e/dt of a constraint."""
    if _looks_once(task):
        return TaskRows(*task.velocity_rows(configuration, dt))
    jacobian, error = task.compute_jacobian(configuration), task.compute_error(configuration)
    nv = configuration.model.nv
    if not are_rows(jacobian, error, nv):
        what = f"{name_of(task)}: its"
        jacobian, error = as_rows(jacobian, error, nv, f"{what} Jacobian", f"{what} error")
    return TaskRows(jacobian, -task.gain * error / dt)


def _is_a(item: object, ours: type) -> bool:
    """``isinstance``, which takes mink's abstract classes three times as long."""
    return ours in type(item).__mro__


def _looks_once(task: Any) -> bool:
    """Whether error and Jacobian of a task are those of :class:`~qp_twist.TwistTask`.

    Then one look at the configuration gives both.
    """
    kind = type(task)
    return _is_a(task, TwistTask) and all(
        getattr(kind, name) is getattr(TwistTask, name) and name not in task.__dict__
        for name in ("compute_error", "compute_jacobian", "velocity_rows")
    )


def _check_rows(task: mink.Task, rows: TaskRows) -> None:
    """Refuse rows of a constraint that are not finite, or ask for a speed that is none, by name."""
    check_target(task)
    name = name_of(task)
    finite_array(f"{name}: its Jacobian", rows.A, rows.A.shape)
    finite_array(f"{name}: its error", rows.b, rows.b.shape)
    check_speed(f"{name} asks", rows.b)


def _levels(
    constraints: Sequence[mink.Task],
    rows: list[TaskRows],
    configuration: mink.Configuration,
    threshold: float,
) -> PosedLevels:
    """The constraints, with their rows, as one level."""
    nv = configuration.model.nv
    lost: list[LostDirection] = []
    regular: list[tuple[Array, Array]] = []
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
    return PosedLevels(levels, [0] * len(levels), [], [rows], whole, tuple(lost), False, [])


_ASKED = {
    "tasks": ("compute_qp_residual",),
    "limits": ("compute_qp_inequalities",),
    "constraints": ("compute_error", "compute_jacobian"),
}
"""What mink calls of an item of each list."""


def _listed(name: str, items: Any) -> Sequence[Any]:
    """The items of any iterable."""
    if isinstance(items, (list, tuple)):
        return items
    if isinstance(items, (str, bytes)) or not isinstance(items, Iterable):
        raise InvalidInput(f"solve_ik: {name} is a list of mink {name}; got {items!r}.")
    return list(items)


def _check_items(name: str, items: Sequence[Any], model: mujoco.MjModel) -> None:
    """Refuse an item that lacks what mink would call, or is for another model."""
    for index, item in enumerate(items):
        if not all(hasattr(item, asked) for asked in _ASKED[name]):
            others = [other for other, calls in _ASKED.items() if hasattr(item, calls[0])]
            hint = f" It belongs into {others[0]}=." if others else ""
            raise InvalidInput(
                f"solve_ik: {name}[{index}] is {type(item).__name__}, which is none of mink's "
                f"{name}.{hint}"
            )
        said = f"solve_ik: {name}[{index}]"
        if isinstance(item, type):
            raise InvalidInput(
                f"{said} is the class {item.__name__}; make an object of it: {item.__name__}(…)."
            )
        check_model(said, item, model.nv)
        if isinstance(item, Constraint):
            check_constraint(f"{said}, {type(item).__name__}", item, model)
