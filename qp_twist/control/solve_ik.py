"""mink's ``solve_ik`` with a verified result, for apps that change one import."""

from __future__ import annotations

import inspect
import logging
import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from typing import Any, Literal, NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, did_you_mean, finite_array, number, one_of
from qp_twist.constraints import (
    BoxLimit,
    Constraint,
    check_constraint,
    check_model,
    default_limit,
    gather_limits,
    stated_rows,
)
from qp_twist.control.mink_bounds import add_bounds
from qp_twist.control.mink_costs import (
    WeightedRows,
    as_rows,
    check_target,
    costs_of,
    elastic_constraint,
    elastic_rows,
    mink_cost,
    name_of,
    refuse_elastic,
)
from qp_twist.control.mink_tasks import OwnTasks
from qp_twist.control.posing import (
    Posed,
    PosedLevel,
    TaskRows,
    check_magnitudes,
    check_speed,
    stacked,
    with_inequalities,
)
from qp_twist.control.solving import solved_step, step_of
from qp_twist.control.step import Status, Step
from qp_twist.errors import InvalidInput
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import BandRows, TwistTask, check_configuration
from qp_twist.qp import Directions, Found, QuadraticProgram, check_solver

DEFAULT_SINGULARITY = 1e-9
"""Default of ``singularity``: rows whose smallest singular value is below it are dependent."""

_NONE = np.zeros(0)
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
        tasks: mink tasks, each a cost; of elastic ones (mink after 1.3) a price of what they miss.
            Tasks, limits and constraints may be any iterables of objects that have the methods
            which mink calls.
        dt: Length of the step, s.
        solver: Name of a qpsolvers backend.
        damping: Levenberg–Marquardt damping, a number or one for each degree of freedom, (nv,).
        safety_break: Whether a joint outside its range is an error; otherwise mink logs it.
        limits: Limits of mink and this package; ``None`` for ``mink.ConfigurationLimit``, ``[]``
            for none.
        constraints: mink tasks whose rows are equality constraints; ``mink.Elastic`` has a price.
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
    asked = _Asked.of(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints, on_infeasible,
        singularity, kwargs,
    )  # fmt: skip
    found = asked.by_kernel()
    velocity = asked.by_reference(configuration).velocity if found is None else found.x
    asked.note(velocity)
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
    asked = _Asked.of(
        configuration, tasks, dt, solver, damping, safety_break, limits, constraints, on_infeasible,
        singularity, kwargs,
    )  # fmt: skip
    step = asked.step(configuration)
    asked.note(step.velocity)
    return step


class _Asked(NamedTuple):
    """The arguments, checked; tasks, limits and constraints each evaluated once, as mink does."""

    tasks: Sequence[mink.tasks.BaseTask]
    costs: list[WeightedRows | mink.Objective | None]
    """Of each task; ``None`` of those in ``sums``."""
    sums: tuple[Array, Array, float]
    """H, of which the lower half is written, c and damping of mink's own tasks."""
    limits: Sequence[mink.Limit] | None
    """``None`` for mink's default."""
    bounds: list[tuple[Array, Array] | None]
    """Rows G Δq ≤ h of each limit; ``None`` of those in ``box``."""
    box: Array
    """Bounds of the velocity, (2, nv), of mink's limits on single joints."""
    elastic: list[BandRows]
    """Rows of tasks that are elastic, and of ``mink.Elastic`` constraints, with their prices."""
    constraints: Sequence[mink.Task]
    """Those that are not elastic."""
    rows: list[TaskRows]
    """Their rows."""
    damping: float | Array
    dt: float
    nv: int
    solver: str
    on_infeasible: str
    singularity: float
    options: dict[str, Any]

    @classmethod
    def of(
        cls,
        configuration: mink.Configuration,
        tasks: Any,
        dt: Any,
        solver: str,
        damping: Any,
        safety_break: bool,
        limits: Any,
        constraints: Any,
        on_infeasible: str,
        singularity: float,
        options: dict[str, Any],
    ) -> _Asked:
        """Check the arguments and evaluate them; an item that cannot be evaluated is named."""
        check_solver(solver)
        one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
        singularity = number("singularity", singularity, at_least=0.0, at_most=1.0)
        check_configuration(configuration)
        dt = number("dt", dt.item() if isinstance(dt, np.ndarray) and dt.size == 1 else dt, above=0)
        model, q = configuration.model, configuration.data.qpos
        nv = model.nv
        if nv == 0:
            raise InvalidInput("solve_ik: the model has no joints to move.")
        if not math.isfinite(q @ q):  # or too large: then all are looked at
            finite_array("configuration.q", configuration.q, (model.nq,))
        if safety_break or _check_has_effect(configuration):
            configuration.check_limits(safety_break=safety_break)
        damping = _damping(damping, nv)
        costed = _listed("tasks", tasks)
        limiting = None if limits is None else _listed("limits", limits)
        if constraints is None or not isinstance(constraints, Iterable):
            constraints = constraints or ()  # as in mink
        given = _listed("constraints", constraints)
        priced = [item for item in given if hasattr(item, "compute_penalized_rows")]
        equalities = [item for item in given if item not in priced] if priced else given
        try:
            inner = [getattr(item, "task", item) for item in priced] if priced else priced
            for task in (*costed, *equalities, *inner):
                if TwistTask in type(task).__mro__:  # a third of the time of isinstance
                    task.set_dt(dt)  # for its feed-forward
            H, c = np.zeros((nv, nv)), np.zeros(nv)
            own = OwnTasks(configuration)
            mu, known = own.add_costs(costed, H, c)
            costs = [
                None if summed else mink_cost(task, configuration)
                for task, summed in zip(costed, known, strict=True)
            ]
            box = _unbounded(nv).copy()
            bounds = [
                None
                if add_bounds(limit, configuration, dt, box)
                else stated_rows(limit, configuration, dt)
                for limit in ((default_limit(model),) if limiting is None else limiting)
            ]
            rows = [_constraint_rows(task, configuration, dt, own) for task in equalities]
            elastic: list[BandRows] = []
            if priced or costs.count(None) < len(costs):  # those summed are not elastic
                prices = [elastic_constraint(item, configuration) for item in priced]
                elastic = elastic_rows([*costed, *priced], [*costs, *prices], dt)
        except Exception:
            _check_items("tasks", costed, model)
            _check_items("limits", limiting or (), model)
            _check_items("constraints", given, model)
            raise
        return cls(
            costed, costs, (H, c, mu), limiting, bounds, box, elastic, equalities, rows, damping,
            dt, nv, solver, on_infeasible, singularity, options,
        )  # fmt: skip

    def note(self, velocity: Array) -> None:
        """Store the new joint velocity in the limits that need the previous one."""
        for limit in self.limits or ():
            if isinstance(limit, BoxLimit):
                limit.note(velocity)

    def by_kernel(self) -> Found | None:
        """The solution, at the largest scale where the constraints do not fit.

        ``None`` where the backend has to solve the program: with options of its own, where a
        direction is to be slowed down or the task relaxed, where constraints beside elastic rows
        do not fit, and where the kernel could not verify its result or found something that is no
        number.
        """
        if self.options:
            return None
        nv, floats = self.nv, np.ascontiguousarray
        residuals: list[tuple[Array, Array]] = []
        H, c, own = self.sums
        damping = self.damping + own
        for cost in self.costs:
            if isinstance(cost, WeightedRows):
                if cost.penalty is None:
                    residuals.append(cost[:2])
                    damping = damping + cost.damping
            elif cost is not None:
                H, c = H + cost.H, c + cost.c
        level, each = damping, _NONE
        if type(damping) is not float:
            level, each = 0.0, np.zeros(nv)
            each += damping
        W, e = stacked(residuals, nv)
        A, b = stacked(self.rows, nv)
        G, h = stacked([rows for rows in self.bounds if rows is not None], nv)
        bounds = self.box
        if self.elastic:
            H, c = np.tril(H) + np.tril(H, -1).T + W.T @ W, c - e @ W
            H.reshape(-1)[:: nv + 1] += damping
            p = QuadraticProgram(H, c / self.dt, A, b, G, h / self.dt, *bounds)
            p = with_inequalities(p, self.elastic, [])
            H, c, A, G, h = p.H, p.c * self.dt, p.A, p.G, p.g * self.dt
            bounds, level, each = np.array([p.lower, p.upper]), 0.0, _NONE
            W, e = H[:0], c[:0]
        slowed = self.singularity if self.singularity > DEFAULT_SINGULARITY else 0.0
        solved, velocity, scale, box, multipliers = _machine_code()(
            floats(W), floats(e), level, each, H, c, floats(A), floats(b), floats(G), floats(h),
            bounds, self.dt, slowed, self.on_infeasible == "scale" and not self.elastic,
        )  # fmt: skip
        if not solved:
            return None
        if self.elastic:
            velocity, box = velocity[:nv], box[:nv]
        return Found(velocity, scale, 0.0, box, multipliers, COMPILED)

    def posed(self, configuration: mink.Configuration) -> Posed:
        """The program, with names, and the constraints in their singular directions.

        Raises:
            InvalidInput: If a number is none, or too large to compute with; with the item's name.
        """
        dt, rows, own, epsilon = self.dt, self.rows, self.limits, self.singularity
        for task, (A, b, _) in zip(self.constraints, rows, strict=True):
            check_target(task)
            finite_array(f"{name_of(task)}: its Jacobian", A, A.shape)
            finite_array(f"{name_of(task)}: its error", b, b.shape)
            check_speed(f"{name_of(task)} asks", b)
        costs = [
            mink_cost(task, configuration) if cost is None else cost
            for task, cost in zip(self.tasks, self.costs, strict=True)
        ]
        H, c = costs_of(self.tasks, costs, self.nv, dt)
        H.reshape(-1)[:: self.nv + 1] += self.damping
        if own is None:
            own = [mink.ConfigurationLimit(configuration.model)]
        stated = [
            stated_rows(limit, configuration, dt) if known is None else known
            for limit, known in zip(own, self.bounds, strict=True)
        ]
        limits = gather_limits(own, configuration, dt, stated)
        whole = [Directions.of(A, b, dt, epsilon, damp=False, smooth=False) for A, b, _ in rows]
        # What a constraint contradicts in itself it does not ask for.
        turns = [v.left[:, v.sigma > 0.0] for v in whole]
        asked = [
            (turn.T @ A, v.rate[v.sigma > 0.0])
            for turn, v, (A, *_) in zip(turns, whole, rows, strict=True)
        ]
        A, b = stacked(asked, self.nv)
        directions = Directions.of(A, b, dt, epsilon, damp=False, smooth=False)
        if directions.contradicts:  # none of the constraints gives way: all are scaled together
            directions = Directions.as_stated(A, b)
        level = PosedLevel(rows, A, b, directions, A[:0], b[:0])
        box = limits.lower, limits.upper
        problem = QuadraticProgram(H, c, A, b, limits.rows, limits.bounds, *box)
        check_magnitudes(problem)
        return Posed(
            with_inequalities(problem, self.elastic, [level]), [level], limits,
            [*limits.sources, *self.elastic], self.constraints, configuration, epsilon, turns,
            elastic=len(self.elastic),
        )  # fmt: skip

    def step(self, configuration: mink.Configuration) -> Step:
        """The step by the kernel, or else by a backend."""
        found = self.by_kernel()
        if found is None:
            return self.by_reference(configuration)
        whole = found.scale == 1.0
        return step_of(
            self.posed(configuration), found.x, Status.SOLVED if whole else Status.SCALED,
            COMPILED, (found.box, found.rows, 1.0 if whole else 0.0), found.scale,
        )  # fmt: skip

    def by_reference(self, configuration: mink.Configuration) -> Step:
        """The step by a backend of qpsolvers."""
        posed, plain = self.posed(configuration), self._replace(elastic=[])
        try:
            return solved_step(
                posed, self.solver, self.on_infeasible, self.options,
                partial(plain.step, configuration),
            )  # fmt: skip
        except InvalidInput as error:  # the backend does not know an option
            parameters = inspect.signature(ik_step).parameters
            meant = "".join(f" {name!r}{did_you_mean(name, parameters)}" for name in self.options)
            raise InvalidInput(f"{error} As arguments of solve_ik:{meant}") from error


@cache
def _machine_code() -> Callable[..., Any]:
    """``kernel.row_program.solve_rows``."""
    from qp_twist.kernel.compiling import bound  # with numba, which takes half a second
    from qp_twist.kernel.row_program import solve_rows

    one, row = np.zeros(1), np.zeros((1, 1))
    return bound(solve_rows, row, one, 0.0, one, row, one, row, one, row, one, row, 1.0, 0.0, True)


@cache
def _unbounded(nv: int) -> Array:
    """Bounds of a velocity without limits."""
    return np.repeat([[-np.inf], [np.inf]], nv, axis=1)


def _check_has_effect(configuration: mink.Configuration) -> bool:
    """Whether mink's check of the joints does more than write log lines that are discarded."""
    check = getattr(configuration.check_limits, "__func__", None)
    return check is not _CHECK_LIMITS or _MINK_LOG.isEnabledFor(logging.DEBUG)


def _damping(damping: Any, nv: int) -> float | Array:
    """Check mink's damping: a number, or one for each degree of freedom."""
    if type(damping) is float or np.size(damping) == 1:
        given = damping if type(damping) is float else np.asarray(damping).item()
        return number("damping", given, at_least=0.0)
    values = finite_array("damping", damping, (nv,))
    if (values < 0.0).any():
        raise InvalidInput(f"damping: expected numbers of at least 0, got {values.min():g}.")
    return values


def _constraint_rows(
    task: Any, configuration: mink.Configuration, dt: float, own: OwnTasks
) -> TaskRows:
    """Rows J q̇ = −k e/dt of a constraint."""
    known = own.rows(task)
    if known is not None:
        return TaskRows(known[0], -task.gain * known[1] / dt)
    refuse_elastic(task)
    kind = type(task)
    if TwistTask in kind.__mro__ and all(
        getattr(kind, name) is getattr(TwistTask, name) and name not in task.__dict__
        for name in ("compute_error", "compute_jacobian", "velocity_rows")
    ):
        return TaskRows(*task.velocity_rows(configuration, dt))  # evaluates both at once
    jacobian, error = task.compute_jacobian(configuration), task.compute_error(configuration)
    jacobian, error = as_rows(task, jacobian, error, configuration.model.nv)
    return TaskRows(jacobian, -task.gain * error / dt)


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
        label = f"solve_ik: {name}[{index}]"
        priced = name == "constraints" and hasattr(item, "compute_penalized_rows")
        calls = () if priced else _METHODS_CALLED[name]
        if isinstance(item, type) or not all(hasattr(item, method) for method in calls):
            what = f"the class {item.__name__}" if isinstance(item, type) else type(item).__name__
            raise InvalidInput(f"{label} is {what}, which is none of mink's {name}.")
        check_model(label, item, model.nv)
        if isinstance(item, Constraint):
            check_constraint(f"{label}, {type(item).__name__}", item, model)
