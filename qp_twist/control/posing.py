"""From tasks, limits and secondary objectives at one configuration to a step's program."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import mink
import numpy as np
import numpy.typing as npt
import qpsolvers

from qp_twist.checks import Array, finite_array, largest, number
from qp_twist.constraints import GatheredLimits, Named, gather_limits, stopping_share
from qp_twist.control.composition import damps_by_error
from qp_twist.control.mink_costs import (
    check_cost,
    is_elastic,
    mink_cost,
    mink_costs,
    name_of,
    refuse_elastic,
)
from qp_twist.errors import InvalidInput
from qp_twist.kernel.constants import FASTEST, NEARLY_UNSEEN, STEEPEST
from qp_twist.kinematics import BandRows, TaskState, TwistTask, total_displacement
from qp_twist.kinematics.twist_task import AT_REST
from qp_twist.qp import Directions, LostDirection, QuadraticProgram, lost_directions

if TYPE_CHECKING:
    from qp_twist.control.controller import Controller

LevelItem = mink.tasks.BaseTask | mink.Limit


class Displacement(NamedTuple):
    """The joint displacement reference h of one step."""

    share: float
    """Share of the secondary objectives' displacement, from 0 to 1."""
    added: Array | None
    """What is added to it, rad or m, (nv,); ``None`` for nothing."""
    acts: bool
    """Whether h is not zero by these two."""

    @classmethod
    def of(cls, share: bool | float, added: npt.ArrayLike | None, nv: int) -> Displacement:
        """Check the arguments of :meth:`Controller.step <qp_twist.Controller.step>`."""
        if not isinstance(share, (bool, np.bool_)):
            share = number("use_secondary", share, at_least=0.0, at_most=1.0)
        if added is None:
            return EVERYTHING if share == 1.0 else cls(share, None, share > 0.0)
        return cls(float(share), finite_array("displacement", added, (nv,)), True)


EVERYTHING = Displacement(1.0, None, True)
"""h as the secondary objectives state it."""


class TaskRows(NamedTuple):
    """What one task asks for: A q̇ = b."""

    A: Array
    b: Array
    ahead: Array | float = 0.0
    """The part of b that follows a moving target, m/s and rad/s, (m,)."""


class PosedLevel(NamedTuple):
    """A priority level: A q̇ = b and G q̇ ≤ g."""

    tasks: list[TaskRows]
    """The rows of each of its tasks; of the first level as braked."""
    A: Array
    b: Array
    """Both of all its tasks, braked."""
    directions: Directions
    """The same rows in singular directions, in the null space of the levels above."""
    G: Array
    g: Array


@dataclass(eq=False)
class Posed:
    """A step before it is solved."""

    problem: QuadraticProgram
    """The program with all levels as equality constraints. Its inequality rows are those of the
    limits, then those of soft bands and elastic rows, then the levels' own; unknowns beyond nv are
    the slacks of soft bands and elastic rows."""
    levels: list[PosedLevel]
    limits: GatheredLimits
    sources: list[Named]
    """What the inequality rows come from, in their order."""
    tasks: Sequence[mink.tasks.BaseTask]
    configuration: mink.Configuration
    threshold: float
    """ε, singular value below which directions fade."""
    asked: Sequence[Array] | None = None
    """The combinations of each task's rows that the first level consists of, in columns; ``None``
    for all rows as they are."""
    braked: float = 1.0
    """Share of the first level's speed from which its motion can stop in time."""
    braking: tuple[int, str] | None = None
    """The joint, and the side of its acceleration limit, that decide this at the first level that
    is braked."""

    elastic: int = 0
    """Number of elastic rows, whose slacks are the last unknowns."""

    def hard(self, levels: int) -> QuadraticProgram:
        """The program without equality rows, and with the inequality rows of so many levels."""
        p = self.problem
        k = len(p.g) - sum(len(level.g) for level in self.levels[levels:])
        return QuadraticProgram(p.H, p.c, p.A[:0], p.b[:0], p.G[:k], p.g[:k], p.lower, p.upper)

    def without_elastic(self) -> Posed:
        """The step as if elastic rows had not been given."""
        p, n = self.problem, self.problem.n - self.elastic
        kept = ~p.G[:, n:].any(axis=1)
        problem = QuadraticProgram(
            p.H[:n, :n], p.c[:n], p.A[:, :n], p.b, p.G[kept, :n], p.g[kept], p.lower[:n],
            p.upper[:n],
        )  # fmt: skip
        sources = [source for source in self.sources if not is_elastic(source)]
        return replace(self, problem=problem, sources=sources, elastic=0)

    def sigma_min(self) -> float:
        """Smallest singular value of the first level's rows, as stated; infinity without rows."""
        rows = [row.A for row in self.levels[0].tasks if len(row.A)]
        if not rows:
            return np.inf
        A = np.vstack(rows)
        return 0.0 if len(A) > A.shape[1] else float(np.linalg.svd(A, compute_uv=False)[-1])

    def lost(self, velocity: Array, scale: float) -> tuple[LostDirection, ...]:
        """Weak directions of the first level in which a velocity (nv,) lacks what is asked."""
        first = self.levels[0]
        found = lost_directions(first.A, scale * first.b, velocity, self.threshold)
        tasks = self.tasks[: len(first.tasks)]
        bases = [
            task.state(self.configuration).basis
            if isinstance(task, TwistTask)
            else np.eye(len(row.b))
            for task, row in zip(tasks, first.tasks, strict=True)
        ]
        if self.asked is not None:
            bases = [basis @ turn for basis, turn in zip(bases, self.asked, strict=True)]
        return in_words(found, tasks, bases)


class NamedProblem(qpsolvers.Problem):
    r"""min ½ xᵀP x + qᵀx  subject to  A x = b,  G x ≤ h,  lb ≤ x ≤ ub,  as qpsolvers has it.

    Attributes:
        unknowns: Names of x: the joints, whose velocities they are, then slacks of soft bands and
            of elastic rows.
        equalities: Names of the rows of A.
        inequalities: Names of the rows of G.
    """

    def __init__(self, posed: Posed) -> None:
        """Take the arrays of a step, and name them."""
        p, slacks = posed.problem, posed.problem.n - len(posed.limits.lower)
        super().__init__(p.H, p.c, p.G, p.g, p.A, p.b, p.lower, p.upper)
        rows = [rows for level in posed.levels for rows in level.tasks]
        self.unknowns = (*posed.limits.names, *(f"slack {i + 1}" for i in range(slacks)))
        self.equalities = tuple(
            f"{name_of(task)} row {i + 1}"
            for task, (A, *_) in zip(posed.tasks, rows, strict=True)
            for i in range(len(A))
        )
        self.inequalities = tuple(
            f"{name} ({kind})" for source in posed.sources for name, kind in source.names
        )


def pose(
    controller: Controller, configuration: mink.Configuration, dt: float, h: Displacement
) -> Posed:
    """Pose the program of :class:`~qp_twist.Controller` at a configuration, for one step."""
    limits = gather_limits(controller.limits, configuration, dt)
    posed, soft_bands = _with_levels(controller, configuration, dt, limits)
    A, b = stacked([(level.A, level.b) for level in posed.levels], 0)
    desired = _desired(controller, configuration, dt, h)
    H, c = _secondary_cost(controller, configuration, desired, A)
    if controller.soft_tasks:
        hessian, linear, elastic = mink_costs(controller.soft_tasks, configuration, dt)
        H, c, posed.elastic = H + hessian, c + linear, len(elastic)
        soft_bands += elastic
    problem = QuadraticProgram(H, c, A, b, limits.rows, limits.bounds, limits.lower, limits.upper)
    check_speed("the secondary asks", desired)
    check_magnitudes(problem)
    posed.problem = with_inequalities(problem, soft_bands, posed.levels)
    posed.sources[:0] = [*limits.sources, *soft_bands]
    return posed


def _desired(
    controller: Controller, configuration: mink.Configuration, dt: float, h: Displacement
) -> Array:
    """ḣ = h/dt, (nv,)."""
    desired = np.zeros(controller.model.nv)
    if h.share > 0.0 and controller.secondary:
        desired = h.share * total_displacement(controller.secondary, configuration) / dt
    return desired if h.added is None else desired + h.added / dt


def _secondary_cost(
    controller: Controller, configuration: mink.Configuration, desired: Array, A: Array
) -> tuple[Array, Array]:
    r"""H and c of the secondary in joint space or in twist space, with the task rows A."""
    weight, metric = controller.joint_weight, controller.metric
    if controller.secondary_space == "joint":
        weights = weight * metric
        return np.diag(weights), -weights * desired
    blocks = [
        free_rows(task.state(configuration), controller.free_twist_costs)
        for task in controller.twist_tasks
    ]
    free = np.vstack([A[:0], *blocks])
    cost = free.T @ free + weight * unseen(np.vstack([A, free]), metric)
    # AᵀA is constant where A x = b, so that it does not change the solution, but H is then
    # close to JᵀJ instead of close to singular.
    return cost + A.T @ A, -cost @ desired


# ------------------------------------------------------------------------------------ the levels


def _with_levels(
    controller: Controller, configuration: mink.Configuration, dt: float, limits: GatheredLimits
) -> tuple[Posed, list[BandRows]]:
    """The levels of a step that has no program yet, and the soft bands of their tasks."""
    nv, threshold = controller.model.nv, controller.singularity
    smooth = controller.smooth and threshold > 0.0
    damp = smooth and damps_by_error(controller.limits, controller.on_infeasible)
    acceleration = controller.hardest if smooth and controller.braking else None
    nothing = QuadraticProgram(*[np.zeros(0)] * 8)
    posed = Posed(nothing, [], limits, [], controller.tasks, configuration, threshold)
    soft_bands: list[BandRows] = []
    above, null = np.zeros(nv), None
    for items in controller.levels:
        rows, G, g = _evaluate(items, configuration, dt, posed.sources, soft_bands)
        A, b = stacked([(row.A, row.b) for row in rows], nv)
        check_speed("the tasks ask", b)
        level = Directions.of(A, b, dt, threshold, damp=damp, smooth=smooth, null=null, above=above)
        if acceleration is not None and len(b):
            ahead = np.concatenate([row.ahead + np.zeros(len(row.b)) for row in rows])
            motion = level.motion(b - ahead - A @ above)
            slower = stopping_share(dt * motion, acceleration, dt)
            if slower < 1.0:
                b = slower * (b - ahead) + ahead
                level = level.of_rate(b - A @ above)
                joint = int(np.argmax(np.abs(motion) / acceleration))
                posed.braking = posed.braking or (joint, "lower" if motion[joint] > 0 else "upper")
                if not posed.levels:
                    parts = np.split(b, np.cumsum([len(row.b) for row in rows])[:-1])
                    rows = [TaskRows(row.A, part) for row, part in zip(rows, parts, strict=True)]
                    posed.braked = slower
        posed.levels.append(PosedLevel(rows, A, b, level, G, g))
        if len(posed.levels) < len(controller.levels):
            above, null = above + level.motion(), level.nulls
    return posed, soft_bands


def _evaluate(
    items: Sequence[LevelItem],
    configuration: mink.Configuration,
    dt: float,
    sources: list[Named],
    soft_bands: list[BandRows],
) -> tuple[list[TaskRows], Array, Array]:
    """Rows of a level's tasks, and its inequality rows.

    What the latter come from is added to ``sources``, the soft bands to ``soft_bands``.
    """
    rows, inequalities = list[TaskRows](), list[tuple[Array, Array]]()
    for item in items:
        if isinstance(item, TwistTask):
            A, b = item.velocity_rows(configuration, dt)
            ahead: Array | float = 0.0
            if item.feedforward is not AT_REST:
                state = item.state(configuration)
                ahead = state.basis.T @ state.feedforward
            rows.append(TaskRows(A, b, ahead))
            for band in item.band_rows(configuration, dt) if item.bands else ():
                if band.weight is not None:
                    soft_bands.append(band)
                else:
                    inequalities.append((band.rows, band.bounds))
                    sources.append(band)
        elif isinstance(item, mink.Limit):
            matrix, bounds, source = gather_limits([item], configuration, dt).as_rows()
            inequalities.append((matrix, bounds))
            sources.append(source)
        else:
            rows.append(_mink_rows(item, configuration, dt))
    return rows, *stacked(inequalities, configuration.model.nv)


def _mink_rows(task: mink.tasks.BaseTask, configuration: mink.Configuration, dt: float) -> TaskRows:
    """A mink task as rows: weighted as in its cost, which decides between rows of one level."""
    refuse_elastic(task)
    stated = mink_cost(task, configuration)
    if isinstance(stated, mink.Objective):
        raise InvalidInput(
            f"Controller(levels=…): {name_of(task)} states a cost but no rows, so it cannot "
            "stand in a level; give it in tasks= instead."
        )
    check_cost(task, stated)
    matrix, error, *_ = stated
    seen = np.abs(matrix).max(axis=1, initial=0.0) > 0.0  # a cost of zero asks for nothing
    return TaskRows(matrix[seen], error[seen] / dt)


@cache
def _no_rows(n: int) -> tuple[Array, Array]:
    return np.zeros((0, n)), np.zeros(0)


def stacked(blocks: Sequence[tuple[Any, ...]], n: int) -> tuple[Array, Array]:
    """Rows (m, n) and right-hand sides (m,), the first two of each block, below each other."""
    if not blocks:
        return _no_rows(n)
    if len(blocks) == 1:
        return blocks[0][0], blocks[0][1]
    return np.concatenate([v[0] for v in blocks]), np.concatenate([v[1] for v in blocks])


# ----------------------------------------------------------------------------------- the program


def with_inequalities(
    problem: QuadraticProgram, bands: Sequence[BandRows], levels: Sequence[PosedLevel]
) -> QuadraticProgram:
    r"""The program with the levels' own inequality rows, and a slack ε ≥ 0 for each soft band.

    .. math:: \mathbf G\dot{\mathbf q} - \varepsilon \le \mathbf g, \quad
              \text{cost } \tfrac12 w\,\varepsilon^2 + \rho\,\varepsilon

    ρ is the price of the rows of elastic tasks, 0 of tolerance bands.
    """
    blocks = [(band.rows, band.bounds) for band in bands]
    blocks += [(level.G, level.g) for level in levels if len(level.g)]
    if blocks:
        G, g = stacked([(problem.G, problem.g), *blocks], problem.n)
        problem = replace(problem, G=G, g=g)
    if not bands:
        return problem
    wide = problem.widened(len(bands))
    n, at = problem.n, len(wide.g) - sum(len(g) for _, g in blocks)
    wide.lower[n:] = 0.0
    for z, band in enumerate(bands, start=n):
        wide.H[z, z], unit, wide.c[z] = band.slack(problem.steepest)
        end = at + len(band.bounds)
        wide.G[at:end, z] = -unit
        at = end
    return wide


def free_rows(state: TaskState, costs: tuple[float, float]) -> Array:
    """The rows of (1 − T) J of a task, weighted by a linear and an angular cost, (6 − r, nv)."""
    free = state.projector.complement
    rows: Array = free.basis.T @ state.jacobian
    return np.repeat(costs, (free.linear.rank, free.angular.rank))[:, None] * rows


def unseen(rows: Array, metric: Array) -> Array:
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


def check_speed(what: str, values: Array) -> None:
    """Refuse speeds that no robot has, and that costs and limits are lost beside."""
    fastest = largest(values)
    if not fastest <= FASTEST:
        raise InvalidInput(
            f"step: {what} for a speed of {fastest:.3g} (m/s or rad/s); check targets, gains "
            f"and dt. Speeds up to {FASTEST:g} are taken."
        )


def check_magnitudes(problem: QuadraticProgram) -> None:
    """Refuse what no solver can work with, and no robot: the loops of some would not end."""
    if problem.pull <= STEEPEST * problem.steepest < math.inf:  # false for NaN
        return
    if not (np.isfinite(problem.H).all() and np.isfinite(problem.c).all()):
        raise InvalidInput(
            "step: the costs overflow; check the cost, weight and metric of tasks and controller."
        )
    raise InvalidInput(
        f"step: the linear cost reaches {problem.pull:.3g}, more than {STEEPEST:g} times the "
        "quadratic one; check the targets, costs and gains of the mink tasks."
    )


# ----------------------------------------------------------------------------- lost directions


def in_words(
    lost: Sequence[LostDirection], tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> tuple[LostDirection, ...]:
    """Lost directions of tasks with the bases U of their rows, each with its place in words."""
    return tuple([replace(d, where=_where(d, tasks, bases)) for d in lost])


def _where(
    lost: LostDirection, tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> str:
    """The task that a direction takes most from, and the part of its twist."""
    parts = np.split(lost.direction, np.cumsum([basis.shape[1] for basis in bases])[:-1])
    most = int(np.argmax([np.linalg.norm(part) for part in parts]))
    task, twist = tasks[most], bases[most] @ parts[most]
    if not isinstance(task, TwistTask):
        return f"{type(task).__name__} row {int(np.argmax(np.abs(twist)))}"
    # The sign of a singular vector is arbitrary: make the largest entry positive.
    twist *= np.sign(twist[np.argmax(np.abs(twist))])
    texts = [
        f"{block} ({', '.join(f'{value:.2f}' for value in entries.round(2) + 0.0)})"
        for block, entries in (("linear", twist[:3]), ("angular", twist[3:]))
        if np.abs(entries).max() > 0.005
    ]
    return f"{task.name} {', '.join(texts)}"
