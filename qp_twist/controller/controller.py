"""One step: tasks, limits and a backend make a joint velocity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeVar

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, number, one_of
from qp_twist.controller.step import NOT_THE_LIMITS, Status, Step
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import (
    FreeTwistCost,
    JointRanges,
    SecondaryObjective,
    TwistTask,
    frame_pose,
    total_displacement,
)
from qp_twist.limits import BindingLimit, GatheredLimits, PositionLimit, gather_limits
from qp_twist.qp import (
    InfeasibleStep,
    QuadraticProgram,
    Refused,
    SolverInaccurate,
    Verified,
    check_solver,
    closest_rows,
    largest_scale,
    solve,
)

Item = TypeVar("Item")

TIE_BREAK = 1e-9
"""Default ρ in joint space where other mink tasks decide and ρ only makes the result unique."""
UNSEEN_WEIGHT = 1e-2
"""Default ρ in twist space, where it weighs only the motion that the twist cost does not see."""
NEARLY_UNSEEN = 1e-4
"""Singular values of J below this share of the largest count, by degrees, as unseen."""
LARGEST_WEIGHT = 1e12
"""Largest ρ and entry of M: beyond it the other costs are lost in the arithmetic."""
FASTEST = 1e9
"""Largest speed that a task or a secondary may ask for, m/s or rad/s."""
SCALE_BACKOFF = 1e-8
"""Share of a scaled task that is given up, so that the scaled rows are not on the very edge."""


class Controller:
    r"""A quadratic program at every step (the design of the package, in one formula).

    .. math::

        \min_{\dot{\mathbf q}}\;& \tfrac12\lVert(\mathbf 1-\mathbf T)
            (\mathbf J\dot{\mathbf q}-\mathbf J\dot{\mathbf h})\rVert_{\mathbf w}^2
            \;[\text{secondary\_space = "twist"}]
            + \tfrac\rho2\lVert\dot{\mathbf q}-\dot{\mathbf h}\rVert_{\mathbf M}^2
            + \text{costs of other mink tasks} \\
        \text{s.t.}\;& \mathbf U^T\mathbf J\dot{\mathbf q}
            = s\,(k\,\mathbf U^T\Delta\mathbf t/dt + \mathbf U^T\mathbf t_{ff}),\quad
            lower \le \dot{\mathbf q} \le upper,\quad \mathbf G\dot{\mathbf q}\le\mathbf g

    with :math:`\dot{\mathbf h} = \mathbf h/dt`. While no limit is active, "joint" gives gradient
    projection (minimum norm without a secondary) and "twist" the paper's decomposition.

    In twist space the ρ term counts only in the null space of J, which the twist cost does not see:
    there it decides alone, elsewhere it would pull on the twist (a weight small enough not to be
    felt is too small for the solver's arithmetic). So :math:`\mathbf J^\dagger\mathbf T\Delta
    \mathbf t + (\mathbf 1-\mathbf J^\dagger\mathbf T\mathbf J)\mathbf h` comes out exactly.

    Example:
        >>> import mink, qp_twist as qt
        >>> path_task = qt.load_task("deburring")
        >>> task = qt.TwistTask("tool", "site", path_task.projector)
        >>> task.set_target(path_task.waypoints[0])
        >>> controller = qt.Controller(path_task.model, tasks=[task],
        ...                            secondary=[qt.JointCentering(path_task.model)])
        >>> step = controller.step(mink.Configuration(path_task.model, path_task.start), dt=0.1)
        >>> step.status.name, step.velocity.shape
        ('SOLVED', (6,))
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tasks: Sequence[mink.tasks.BaseTask],
        *,
        secondary: Sequence[SecondaryObjective] = (),
        secondary_space: Literal["joint", "twist"] = "joint",
        limits: Sequence[mink.Limit] | None = None,
        solver: str = "daqp",
        on_infeasible: Literal["scale", "relax", "raise"] = "scale",
        metric: npt.ArrayLike | None = None,
        joint_weight: float | None = None,
        free_linear_cost: float = 1.0,
        free_angular_cost: float = 1.0,
    ) -> None:
        """Compose a controller.

        Args:
            model: The robot.
            tasks: :class:`TwistTask` s become equality rows; any other mink task adds its cost.
            secondary: Objectives whose displacements add up to h.
            secondary_space: Whether the free motion follows h in joint space or in twist space.
            limits: Position limits of the model if ``None``; any mink limits; ``[]`` for none.
            solver: A qpsolvers backend by name. Its results are verified, whatever it says.
            on_infeasible: ``"scale"`` slows the task down, ``"relax"`` takes the closest velocity,
                ``"raise"`` raises :class:`~qp_twist.InfeasibleStep`.
            metric: Diagonal of M, positive, shape (nv,); ones if ``None``.
            joint_weight: ρ. By default 1 in joint space (1e-9 if other mink tasks decide, and no
                secondary), 0.01 in twist space.
            free_linear_cost: Square root of w for the linear rows of 1 − T, 1/m.
            free_angular_cost: Square root of w for the angular rows of 1 − T, 1/rad.

        Raises:
            InvalidInput: If an argument has the wrong type, shape or range.
            UnknownSolver: If the backend is not installed.
            mink.InvalidFrame: If the model lacks a task's frame.
        """
        instance("model", model, mujoco.MjModel)
        self.model = model
        self.tasks = tuple(t for t in _sequence("tasks", tasks) if isinstance(t, TwistTask))
        self.soft_tasks = tuple(t for t in tasks if not isinstance(t, TwistTask))
        self.secondary = tuple(_sequence("secondary", secondary))
        self.secondary_space = one_of("secondary_space", secondary_space, ("joint", "twist"))
        self.limits: list[mink.Limit] = (
            [PositionLimit(model)] if limits is None else list(_sequence("limits", limits))
        )
        self.solver = check_solver(solver)
        self.on_infeasible = one_of("on_infeasible", on_infeasible, ("scale", "relax", "raise"))
        self._check_types()
        self.metric = np.ones(model.nv)
        if metric is not None:
            self.metric = finite_array("metric", metric, (model.nv,))
            if not ((self.metric > 0.0) & (self.metric <= LARGEST_WEIGHT)).all():
                raise InvalidInput(
                    f"metric: every entry must be above 0 and at most {LARGEST_WEIGHT:g}."
                )
        self.free_costs = [
            FreeTwistCost(t, linear_cost=free_linear_cost, angular_cost=free_angular_cost)
            for t in self.tasks
            if self.secondary_space == "twist"
        ]
        if joint_weight is None:
            joint_weight = UNSEEN_WEIGHT
            if self.secondary_space == "joint":
                joint_weight = TIE_BREAK if self.soft_tasks and not self.secondary else 1.0
        self.joint_weight = number("joint_weight", joint_weight, above=0.0, at_most=LARGEST_WEIGHT)
        self._names = JointRanges.of(model).names

    def step(
        self, configuration: mink.Configuration, dt: float, *, use_secondary: bool = True
    ) -> Step:
        """Compute the joint velocity for one step of length ``dt``.

        Args:
            configuration: Where the robot is; it is not changed.
            dt: Length of the step, s.
            use_secondary: ``False`` sets h to zero, as in the later iterations of a waypoint, where
                a secondary would keep breaking the task by curvature.

        Raises:
            InvalidInput: If the configuration is not finite or of another model, or dt ≤ 0.
            mink.TargetNotSet: If a task has no target.
            InfeasibleStep: If the task does not fit inside the limits and ``on_infeasible`` is
                ``"raise"``, or the limits exclude every motion.
            SolverInaccurate: If every installed backend failed on a feasible step.
        """
        dt = number("dt", dt, above=0.0)
        self._check_configuration(configuration)
        with np.errstate(over="ignore", invalid="ignore"):  # the result is checked below
            problem, limits = self._pose(configuration, dt, bool(use_secondary))
        result = solve(problem, self.solver)
        if isinstance(result, Verified):
            return self._solved(problem, limits, result)
        return self._infeasible(problem, limits, result)

    def _pose(
        self, configuration: mink.Configuration, dt: float, use_secondary: bool
    ) -> tuple[QuadraticProgram, GatheredLimits]:
        nv = self.model.nv
        wish = np.zeros(nv)
        if use_secondary:
            wish = total_displacement(self.secondary, configuration) / dt
        blocks = [task.velocity_rows(configuration, dt) for task in self.tasks]
        A = np.vstack([np.zeros((0, nv)), *(rows for rows, _ in blocks)])
        b = np.concatenate([np.zeros(0), *(rate for _, rate in blocks)])
        if self.secondary_space == "joint":
            H = np.diag(self.joint_weight * self.metric)
            c = -H @ wish
        else:
            free = np.vstack(
                [
                    np.zeros((0, nv)),
                    *(f.cost[:, None] * f.compute_jacobian(configuration) for f in self.free_costs),
                ]
            )
            cost = free.T @ free + self.joint_weight * _unseen(np.vstack([A, free]), self.metric)
            # AᵀA is constant where A q̇ = b holds: it changes no solution, but with it H is near
            # JᵀJ instead of near singular.
            H = cost + A.T @ A
            c = -cost @ wish
        for task in self.soft_tasks:
            # mink's costs are on Δq = q̇ dt; divided by dt² their Hessian is on q̇.
            hessian, linear = _mink_objective(task, configuration)
            H += hessian
            c += linear / dt
        _check_magnitudes(H, c, b, wish)
        limits = gather_limits(self.limits, configuration, dt)
        return (
            QuadraticProgram(H, c, A, b, limits.rows, limits.bounds, limits.lower, limits.upper),
            limits,
        )

    def _infeasible(
        self, problem: QuadraticProgram, limits: GatheredLimits, refused: Refused
    ) -> Step:
        largest = largest_scale(problem)
        if largest is None:
            if self.on_infeasible == "raise":
                raise InfeasibleStep(
                    "infeasible step: the limits exclude even the standing task (scale 0).", problem
                )
            return self._relaxed(problem, limits)
        if largest.scale >= 1.0 - SCALE_BACKOFF:
            # The rows fit: it was the solver that failed. Ask the others.
            result = solve(problem, self.solver, fallbacks=True)
            if isinstance(result, Verified):
                return self._solved(problem, limits, result)
            raise SolverInaccurate(
                f"no backend solved a feasible step: {'; '.join(result.says)}.", problem
            )
        binding = self._binding(limits, largest.box_multipliers, largest.row_multipliers)
        if self.on_infeasible == "raise":
            names = ", ".join(str(limit) for limit in binding)
            why = f"binding: {names}" if names else NOT_THE_LIMITS
            raise InfeasibleStep(
                f"infeasible step: inside the limits the task can be met at {largest.scale:.4g} of "
                f"its speed; {why}. Use on_infeasible='scale' to slow down.",
                problem,
                binding,
            )
        if self.on_infeasible == "relax":
            return self._relaxed(problem, limits)
        scale = largest.scale * (1.0 - SCALE_BACKOFF)
        scaled = problem.with_rows(scale * problem.b)
        result = solve(scaled, self.solver, fallbacks=True)
        if isinstance(result, Refused):
            # On the very edge a backend may see no inside; the LP's own point is there.
            x = np.clip(
                scale / max(largest.scale, 1e-300) * largest.x, problem.lower, problem.upper
            )
            result = Verified(x, "highs", largest.box_multipliers, largest.row_multipliers)
        return self._step(scaled, result, scale, binding, Status.SCALED)

    def _relaxed(self, problem: QuadraticProgram, limits: GatheredLimits) -> Step:
        rows = closest_rows(problem, self.solver)
        if rows is None:
            raise InfeasibleStep(
                "infeasible step: the limits contradict each other; no velocity satisfies them.",
                problem,
            )
        result = solve(problem.with_rows(rows), self.solver, fallbacks=True)
        if isinstance(result, Refused):
            raise SolverInaccurate(f"relaxed step: {'; '.join(result.says)}.", problem)
        return self._solved(problem, limits, result, Status.RELAXED)

    def _solved(
        self,
        problem: QuadraticProgram,
        limits: GatheredLimits,
        result: Verified,
        status: Status = Status.SOLVED,
    ) -> Step:
        """A step at scale 1, its binding limits those of the quadratic program itself."""
        binding = self._binding(limits, result.box_multipliers, result.row_multipliers)
        return self._step(problem, result, 1.0, binding, status)

    def _step(
        self,
        problem: QuadraticProgram,
        result: Verified,
        scale: float,
        binding: tuple[BindingLimit, ...],
        status: Status,
    ) -> Step:
        residual = problem.A @ result.x - problem.b
        ends = np.cumsum([task.projector.rank for task in self.tasks])
        residuals = tuple(np.split(residual, ends[:-1])) if self.tasks else ()
        return Step(result.x, scale, residuals, binding, status, result.solver, problem)

    def _binding(self, limits: GatheredLimits, box: Array, rows: Array) -> tuple[BindingLimit, ...]:
        # Interior-point and first-order backends leave dust on inactive limits.
        dust = 1e-7 * max(1.0, float(np.abs(box).max(initial=0.0)), float(rows.max(initial=0.0)))
        found = []
        for dof in np.flatnonzero(np.abs(box) > dust):
            side = "upper" if box[dof] > 0.0 else "lower"
            kind = (limits.upper_kind if side == "upper" else limits.lower_kind)[dof]
            found.append(BindingLimit(self._names[dof], kind, side, float(abs(box[dof]))))
        for row in np.flatnonzero(rows > dust):
            label = limits.row_labels[row]
            found.append(BindingLimit(label, label.split(" row ")[0], "upper", float(rows[row])))
        return tuple(found)

    def _check_types(self) -> None:
        if self.model.nv == 0:
            raise InvalidInput("Controller: the model has no joints to move.")
        if not self.tasks and not self.soft_tasks:
            raise InvalidInput("Controller: tasks is empty; give at least one TwistTask.")
        for kind, expected, items in (
            ("tasks", mink.tasks.BaseTask, self.soft_tasks),
            ("secondary", SecondaryObjective, self.secondary),
            ("limits", mink.Limit, self.limits),
        ):
            for item in items:
                if not isinstance(item, expected):
                    raise InvalidInput(
                        f"Controller({kind}=…): expected objects of type {expected.__name__}, got "
                        f"{item!r}."
                    )
        for objective in self.secondary:
            if objective.model.nv != self.model.nv:
                raise InvalidInput(
                    f"Controller(secondary=…): {type(objective).__name__} is for a model of "
                    f"{objective.model.nv} degrees of freedom, this one has {self.model.nv}."
                )
        probe = mink.Configuration(self.model)
        for task in self.tasks:
            frame_pose(probe, task.frame_name, task.frame_type)

    def _check_configuration(self, configuration: mink.Configuration) -> None:
        instance("configuration", configuration, mink.Configuration)
        if (configuration.model.nq, configuration.model.nv) != (self.model.nq, self.model.nv):
            raise InvalidInput(
                f"step: the configuration has nq = {configuration.model.nq}, the controller's "
                f"model nq = {self.model.nq}; use a configuration of the same model."
            )
        finite_array("configuration.q", configuration.q, (self.model.nq,))

    def __repr__(self) -> str:
        return (
            f"Controller(tasks={list(self.tasks + self.soft_tasks)!r}, "
            f"secondary={list(self.secondary)!r}, secondary_space={self.secondary_space!r}, "
            f"solver={self.solver!r}, on_infeasible={self.on_infeasible!r})"
        )


def _unseen(rows: Array, metric: Array) -> Array:
    r"""Gram matrix (nv, nv) of the joint-space cost on the motion that ``rows`` (m, nv) do not see.

    :math:`\mathbf M^{1/2}\mathbf N\mathbf N^T\mathbf M^{1/2}` with N the null space of the rows
    in the coordinates :math:`\mathbf M^{1/2}\mathbf q`. Nearly singular directions fade in, so
    that the cost stays positive definite and continuous through a singularity.
    """
    root = np.sqrt(metric)
    _, sigma, right = np.linalg.svd(rows / root)
    seen = np.zeros(len(metric))
    largest = sigma[0] if len(sigma) and sigma[0] > 0.0 else 1.0
    seen[: len(sigma)] = np.minimum(1.0, (sigma / (NEARLY_UNSEEN * largest)) ** 2)
    directions = right * root
    gram: Array = directions.T @ ((1.0 - seen)[:, None] * directions)
    return gram


def _check_magnitudes(H: Array, c: Array, b: Array, wish: Array) -> None:
    """Refuse what no solver can work with, and no robot: the loops of some would not end."""
    for what, values in (("the tasks ask", b), ("the secondary asks", wish)):
        fastest = float(np.abs(values).max(initial=0.0))
        if not fastest <= FASTEST:
            raise InvalidInput(
                f"step: {what} for a speed of {fastest:.3g} (m/s or rad/s); check targets, gains "
                f"and dt. Speeds up to {FASTEST:g} are taken."
            )
    if not (np.isfinite(H).all() and np.isfinite(c).all()):
        raise InvalidInput(
            "step: the costs overflow; check the cost, weight and metric of tasks and controller."
        )


def _sequence(name: str, value: Sequence[Item]) -> Sequence[Item]:
    if isinstance(value, (list, tuple)):
        return value
    raise InvalidInput(f"Controller({name}=…): expected a list, got {value!r}.")


def _mink_objective(
    task: mink.tasks.BaseTask, configuration: mink.Configuration
) -> tuple[Array, Array]:
    """H and c of a mink task on Δq."""
    residual = task.compute_qp_residual(configuration)
    if residual is None:
        objective = task.compute_qp_objective(configuration)
        return objective.H, objective.c
    rows, error, damping = residual
    return rows.T @ rows + damping * np.eye(rows.shape[1]), -(error @ rows)
