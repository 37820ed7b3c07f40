"""mink's ``solve_ik`` with a verified result, for apps that change one import."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import mink
import numpy as np

from qp_twist.checks import Array, finite_array, instance, number, one_of
from qp_twist.controller.infeasible import finished
from qp_twist.controller.posed import Posed
from qp_twist.controller.posing import (
    PosedLevels,
    TaskRows,
    check_magnitudes,
    lost_where,
    mink_costs,
)
from qp_twist.controller.step import NOT_THE_LIMITS, Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask
from qp_twist.limits import BoxLimit, check_model, gather_limits
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
_OF_MINK = (mink.Limit, mink.tasks.BaseTask)


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
    instance("configuration", configuration, mink.Configuration)
    dt = number("dt", dt, above=0.0)
    check_solver(solver)
    one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
    limits = [mink.ConfigurationLimit(configuration.model)] if limits is None else limits
    nv = configuration.model.nv
    _check_all("tasks", tasks, mink.tasks.BaseTask, nv)
    _check_all("limits", limits, mink.Limit, nv)
    _check_all("constraints", constraints or [], mink.Task, nv)
    if nv == 0:
        raise InvalidInput("solve_ik: the model has no joints to move.")
    finite_array("configuration.q", configuration.q, (configuration.model.nq,))
    configuration.check_limits(safety_break=safety_break)
    for task in (*tasks, *(constraints or [])):
        if isinstance(task, TwistTask):
            task.set_dt(dt)  # for its feed-forward
    H, c = mink_costs(tasks, configuration, dt)
    H += number("damping", damping, at_least=0.0) * np.eye(nv)
    check_magnitudes(H, c, np.zeros(nv))
    levels = _levels(constraints or [], configuration, dt, singularity)
    if on_infeasible == "raise" and levels.lost:
        names = ", ".join(str(lost) for lost in levels.lost)
        raise InfeasibleStep(f"infeasible step: {NOT_THE_LIMITS}: {names}.")
    gathered = gather_limits(limits, configuration, dt)
    problem = QuadraticProgram(
        H, c, *levels.equality, gathered.rows, gathered.bounds, gathered.lower, gathered.upper
    )
    posed = Posed.of(problem, levels, gathered, list(gathered.row_labels))
    result = solve(posed.problem, solver, options=kwargs)
    if kwargs and isinstance(result, Refused):
        again, before = solve(posed.problem, solver), result.says
        result = replace(again, refused=before) if isinstance(again, Verified) else again
    step = finished(posed, result, solver, on_infeasible)
    for limit in limits:
        if isinstance(limit, BoxLimit):
            limit.note(step.velocity)
    return step


def _levels(
    constraints: Sequence[mink.Task],
    configuration: mink.Configuration,
    dt: float,
    singularity: float,
) -> PosedLevels:
    """The constraints as one level, J q̇ = −k e/dt."""
    nv = configuration.model.nv
    rows, lost, regular = [], list[LostDirection](), list[TaskRows]()
    threshold = number("singularity", singularity, at_least=0.0, at_most=1.0)
    for task in constraints:
        name = type(task).__name__
        jacobian = finite_array(
            f"{name}: its Jacobian", task.compute_jacobian(configuration), (None, nv)
        )
        error = finite_array(
            f"{name}: its error", task.compute_error(configuration), (len(jacobian),)
        )
        rows.append(TaskRows(jacobian, -task.gain * error / dt))
        # What a task cannot do for itself is given up; the rest of it stays.
        own = regular_rows(rows[-1].A, rows[-1].b, threshold)
        lost += lost_where([task], rows[-1:], own.lost, configuration)
        regular.append(
            TaskRows(np.vstack([own.A, own.damped]), np.concatenate([own.b, own.damped_b]))
        )
    A = np.vstack([np.zeros((0, nv)), *(r.A for r in regular)])
    b = np.concatenate([np.zeros(0), *(r.b for r in regular)])
    whole = regular_rows(A, b, threshold)
    none = np.zeros((0, nv)), np.zeros(0)
    levels = [Level(whole.A, whole.b, *none)]
    if any(direction.sigma <= DEPENDENT for direction in whole.lost):
        # Constraints that contradict each other: none gives way, together they stand (s = 0).
        levels = [Level(A, b, *none)]
    else:
        lost += lost_where(constraints, regular, whole.lost, configuration)
        if len(whole.damped_b):
            levels.append(Level(whole.damped, whole.damped_b, *none))
    return PosedLevels(
        levels, [0] * len(levels), [], [rows], whole.sigma_min, tuple(lost), False, []
    )


def _check_all(name: str, items: Any, expected: type, nv: int) -> None:
    if not isinstance(items, (list, tuple)):
        raise InvalidInput(f"solve_ik: {name} is a list of mink {name}; got {items!r}.")
    for index, item in enumerate(items):
        if not isinstance(item, expected):
            belongs = "limits" if isinstance(item, mink.Limit) else "tasks"
            hint = f" It belongs into {belongs}=." if isinstance(item, _OF_MINK) else ""
            raise InvalidInput(
                f"solve_ik: {name}[{index}] is {type(item).__name__}, which is none of mink's "
                f"{name}.{hint}"
            )
        check_model(f"solve_ik: {name}[{index}]", item, nv)
