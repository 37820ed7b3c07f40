"""From tasks, objectives and limits at one configuration to the arrays of a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, are_rows, finite_array, float_array, largest, within
from qp_twist.constraints import Named, gather_limits, stopping_share
from qp_twist.errors import InvalidInput, InvalidTarget
from qp_twist.kinematics import BandRows, TwistTask
from qp_twist.qp import Directions, LostDirection, QuadraticProgram

NEARLY_UNSEEN = 1e-4
"""Singular values of J below this share of the largest count, by degrees, as unseen."""
FASTEST = 1e9
"""Largest speed that a task or a secondary may ask for, m/s or rad/s."""
STEEPEST = 1e12
"""Largest linear cost, relative to the largest quadratic one."""

LARGEST_ROW = 1e12
"""Largest entry of a task's rows: beyond it the others are lost in the arithmetic."""

LevelItem = mink.tasks.BaseTask | mink.Limit


class TaskRows(NamedTuple):
    """What one task asks for, before anything is taken from it: A q̇ = b."""

    A: Array
    b: Array


@dataclass(eq=False)
class PosedLevels:
    """The priority levels of a step.

    Attributes:
        rows: A and b of each level, from the most important on; b is braked.
        directions: The same in singular directions, each in the null space of the levels above.
        inequalities: G and g of each level.
        sources: What the inequality rows come from, in order of levels.
        tasks: Rows as the tasks state them, for each level; those of the first one as braked.
        soft_bands: Rows of the soft bands of all tasks.
        threshold: ε, singular value from which directions fade.
        braked: Share of the first level's speed from which its motion can stop in time.
        braking: The joint whose acceleration limit decides that, and the limit's side; or decides
            it of a lower level.
        where: What says lost directions of the first level in words.
    """

    rows: list[tuple[Array, Array]]
    directions: list[Directions]
    inequalities: list[tuple[Array, Array]]
    sources: list[Named]
    tasks: list[list[TaskRows]]
    soft_bands: list[BandRows]
    threshold: float
    braked: float
    braking: tuple[int, str] | None
    where: Callable[[Sequence[LostDirection]], tuple[LostDirection, ...]]

    @property
    def equality(self) -> tuple[Array, Array]:
        """A and b of all levels, stacked."""
        return stacked(self.rows, 0)

    @property
    def regular(self) -> bool:
        """Whether all levels are met exactly where limits allow it."""
        return all(level.regular for level in self.directions)

    def sigma_min(self) -> float:
        """Smallest singular value of the first level's rows; infinity without rows."""
        sigma = self.directions[0].sigma
        return float(sigma[-1]) if len(sigma) else np.inf


def stacked(blocks: Sequence[tuple[Array, Array]], n: int) -> tuple[Array, Array]:
    """Rows (m, n) and right-hand sides (m,), one block below the other."""
    if len(blocks) == 1:
        return blocks[0]
    if not blocks:
        return np.zeros((0, n)), np.zeros(0)
    return np.vstack([A for A, _ in blocks]), np.concatenate([b for _, b in blocks])


def pose_levels(
    levels: Sequence[Sequence[LevelItem]],
    configuration: mink.Configuration,
    dt: float,
    threshold: float,
    *,
    damp: bool,
    smooth: bool,
    acceleration: Array | None,
) -> PosedLevels:
    """Evaluate the levels at a configuration.

    Args:
        levels: Tasks and limits, level by level.
        configuration: Where the robot is.
        dt: Length of the step, s.
        threshold: ε, singular value below which a direction fades.
        damp: Whether weak directions are damped by the length of the error.
        smooth: Whether the step has to change little with its data.
        acceleration: Limits to brake by, rad/s² or m/s², (nv,); ``None``: the speed is not bounded
            by what can be stopped from.
    """
    nv = configuration.model.nv
    posed = PosedLevels([], [], [], [], [], [], threshold, 1.0, None, tuple)
    above, null = np.zeros(nv), None
    for index, items in enumerate(levels):
        rows, G, g = _evaluate(items, configuration, dt, posed.sources, posed.soft_bands)
        A, b = stacked(rows, nv)
        check_speed("the tasks ask", b)
        level = Directions.of(A, b, dt, threshold, damp=damp, smooth=smooth, null=null, above=above)
        if acceleration is not None and len(b):
            ahead = _feedforward(items, rows, configuration)
            motion = level.of_rate(b - ahead - A @ above).motion()
            slower = stopping_share(dt * motion, acceleration, dt)
            if slower < 1.0:
                b = slower * (b - ahead) + ahead
                level = level.of_rate(b - A @ above)
                if posed.braking is None:
                    joint = int(np.argmax(np.abs(motion) / acceleration))
                    posed.braking = joint, "lower" if motion[joint] > 0.0 else "upper"
                if index == 0:
                    posed.braked, ends = slower, np.cumsum([len(row.b) for row in rows])[:-1]
                    parts = np.split(b, ends)
                    rows = [r._replace(b=part) for r, part in zip(rows, parts, strict=True)]
        if index == 0:
            posed.where = partial(lost_where, items, rows, configuration)
        above, null = above + level.motion(), level.nulls
        posed.rows.append((A, b))
        posed.directions.append(level)
        posed.tasks.append(rows)
        posed.inequalities.append((G, g))
    return posed


def _feedforward(
    items: Sequence[LevelItem], rows: Sequence[TaskRows], configuration: mink.Configuration
) -> Array:
    """The part of a level's right-hand side that follows moving targets, m/s and rad/s, (m,)."""
    parts = []
    stating = [item for item in items if not isinstance(item, mink.Limit)]
    for item, row in zip(stating, rows, strict=True):
        part = np.zeros(len(row.b))
        if isinstance(item, TwistTask) and item.feedforward.any():
            state = item.state(configuration)
            part = state.basis.T @ state.feedforward
        parts.append(part)
    return np.concatenate(parts) if parts else np.zeros(0)


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
    nv = configuration.model.nv
    rows: list[TaskRows] = []
    inequalities: list[tuple[Array, Array]] = []
    for item in items:
        if isinstance(item, mink.Limit):
            gathered = gather_limits([item], configuration, dt)
            matrix, bounds, source = gathered.as_rows()
            inequalities.append((matrix, bounds))
            sources.append(source)
        elif isinstance(item, TwistTask):
            rows.append(TaskRows(*item.velocity_rows(configuration, dt)))
            for band in item.band_rows(configuration, dt) if item.bands else ():
                if band.weight is not None:
                    soft_bands.append(band)
                else:
                    inequalities.append((band.rows, band.bounds))
                    sources.append(band)
        else:
            rows.append(_mink_rows(item, configuration, dt))
    return rows, *stacked(inequalities, nv)


def lost_where(
    items: Sequence[LevelItem],
    rows: Sequence[TaskRows],
    configuration: mink.Configuration,
    lost: Sequence[LostDirection],
) -> tuple[LostDirection, ...]:
    """Lost directions of a level of tasks with their rows, each with its place in words."""
    if not lost:
        return ()
    tasks = [item for item in items if not isinstance(item, mink.Limit)]
    bases = [
        task.state(configuration).basis if isinstance(task, TwistTask) else np.eye(len(r.b))
        for task, r in zip(tasks, rows, strict=True)
    ]
    return in_words(lost, tasks, bases)


def in_words(
    lost: Sequence[LostDirection], tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> tuple[LostDirection, ...]:
    """Lost directions of tasks with the bases U of their rows, each with its place in words."""
    return tuple([replace(d, where=_where(d, tasks, bases)) for d in lost])


def _where(
    lost: LostDirection, tasks: Sequence[mink.tasks.BaseTask], bases: Sequence[Array]
) -> str:
    """A lost direction in words: the task that it takes most from, and which part of its twist."""
    ends = np.cumsum([basis.shape[1] for basis in bases])
    parts = np.split(lost.direction, ends[:-1])
    most = int(np.argmax([np.linalg.norm(part) for part in parts]))
    task = tasks[most]
    if not isinstance(task, TwistTask):
        return f"{type(task).__name__} row {int(np.argmax(np.abs(parts[most])))}"
    twist = bases[most] @ parts[most]
    # The sign of a singular vector is anybody's choice: make the largest entry positive.
    twist *= np.sign(twist[np.argmax(np.abs(twist))])
    texts = [
        f"{block} ({', '.join(f'{value:.2f}' for value in entries.round(2) + 0.0)})"
        for block, entries in (("linear", twist[:3]), ("angular", twist[3:]))
        if np.abs(entries).max() > 0.005
    ]
    return f"{task.name} {', '.join(texts)}"


def _mink_rows(task: mink.tasks.BaseTask, configuration: mink.Configuration, dt: float) -> TaskRows:
    """A mink task as rows: weighted as in its cost, which decides between rows of one level."""
    stated = mink_cost(task, configuration)
    if isinstance(stated, mink.Objective):
        raise InvalidInput(
            f"Controller(levels=…): {name_of(task)} states a cost but no rows, so it cannot "
            "stand in a level; give it in tasks= instead."
        )
    check_cost(task, stated)
    matrix, error, _ = stated
    seen = np.abs(matrix).max(axis=1, initial=0.0) > 0.0  # a cost of zero asks for nothing
    return TaskRows(matrix[seen], error[seen] / dt)


class WeightedRows(NamedTuple):
    """A cost ½‖W Δq − e‖² + ½ μ‖Δq‖² of a mink task."""

    rows: Array
    """W, (k, nv)."""
    error: Array
    """e, (k,)."""
    damping: Any
    """μ, a number or (nv,)."""


def name_of(task: Any) -> str:
    """How messages call a task: with its frame, where it has one."""
    frame, kind = getattr(task, "frame_name", None), getattr(task, "frame_type", None)
    name = type(task).__name__
    return name if frame is None or kind is None else f"{name}({frame!r}, {kind!r})"


def check_target(task: Any) -> None:
    """Refuse a mink task whose target is not finite.

    Raises:
        InvalidTarget: If it is not.
    """
    target = getattr(task, "transform_target_to_world", None)
    if isinstance(target, mink.SE3):
        finite_array(f"{name_of(task)}: its target", target.wxyz_xyz, (7,), error=InvalidTarget)


def mink_cost(
    task: mink.tasks.BaseTask, configuration: mink.Configuration
) -> WeightedRows | mink.Objective:
    """What a task states for a cost, once asked and of the right shape; it may be anybody's class.

    As mink has it: lists of numbers and single rows are taken, and a pair for an objective.

    Raises:
        InvalidInput: If it is anything else.
    """
    nv, residual = configuration.model.nv, task.compute_qp_residual(configuration)
    if residual is None:
        return _objective(name_of(task), task.compute_qp_objective(configuration), nv)
    W, e, damping = residual
    if are_rows(W, e, nv):
        return WeightedRows(W, e, damping)
    name = name_of(task)
    return WeightedRows(
        *as_rows(W, e, nv, f"{name}: its rows, cost × Jacobian", f"{name}: its error"), damping
    )


def as_rows(rows: Any, ends: Any, nv: int, name: str, name_of_ends: str) -> tuple[Array, Array]:
    """Anybody's rows (k, nv) and right-hand sides (k,); one row may be given without its brackets.

    Raises:
        InvalidInput: If they are none, or not finite.
    """
    matrix, sides = float_array(name, rows), float_array(name_of_ends, ends)
    matrix = finite_array(name, matrix[None] if matrix.ndim == 1 else matrix, (None, nv))
    sides = finite_array(name_of_ends, sides[None] if sides.ndim == 0 else sides, (len(matrix),))
    return matrix, sides


def _objective(name: str, objective: Any, nv: int) -> mink.Objective:
    """H, made symmetric, and c; the cost depends on no more than that part of H."""
    H, c = objective
    if not (type(H) is type(c) is np.ndarray and H.shape == (nv, nv) and c.shape == (nv,)):
        H = finite_array(f"{name}: H of its cost", H, (nv, nv))
        c = finite_array(f"{name}: c of its cost", c, (nv,))
    return mink.Objective(0.5 * (H + H.T), c)


def check_cost(task: mink.tasks.BaseTask, stated: WeightedRows | mink.Objective) -> None:
    """Refuse what is not finite, or too large to compute with, by the name of the task.

    Raises:
        InvalidInput: If it is.
    """
    check_target(task)
    name = name_of(task)
    if isinstance(stated, mink.Objective):
        finite_array(f"{name}: H of its cost", stated.H, stated.H.shape)
        finite_array(f"{name}: c of its cost", stated.c, stated.c.shape)
        return
    finite_array(f"{name}: its rows", stated.rows, stated.rows.shape)
    within(f"{name}: its rows, cost × Jacobian", stated.rows, LARGEST_ROW)
    finite_array(f"{name}: its error", stated.error, stated.error.shape)
    finite_array(f"{name}: its damping", stated.damping, np.shape(stated.damping))


def mink_costs(
    tasks: Sequence[mink.tasks.BaseTask], configuration: mink.Configuration, dt: float
) -> tuple[Array, Array]:
    r"""H and c of mink tasks on q̇: theirs are on Δq = q̇ dt, here divided by dt².

    Of tasks that state weighted rows W, errors e and a damping μ

    .. math::

        \mathbf H = \textstyle\sum\mathbf W^T\mathbf W + \mu\,\mathbf 1, \qquad
              \mathbf c = -\textstyle\sum\mathbf W^T\mathbf e

    Raises:
        InvalidInput: If what a task states is not finite or of the wrong shape.
    """
    nv = configuration.model.nv
    H, c = np.zeros((nv, nv)), np.zeros(nv)
    stated = [mink_cost(task, configuration) for task in tasks]
    for cost in stated:
        if isinstance(cost, mink.Objective):
            H += cost.H
            c += cost.c
        else:
            W, e, damping = cost
            H += W.T @ W
            H.reshape(-1)[:: nv + 1] += damping
            c -= e @ W
    # Squares of the largest rows that are taken; written so that NaN is too large.
    if not largest(H) + largest(c) <= LARGEST_ROW**2:
        for task, cost in zip(tasks, stated, strict=True):
            check_cost(task, cost)
    return H, c / dt


def with_soft_bands(problem: QuadraticProgram, bands: Sequence[BandRows]) -> QuadraticProgram:
    r"""The program with one slack ε ≥ 0 for each soft band.

    .. math:: \mathbf G\dot{\mathbf q} - \varepsilon \le \mathbf g, \quad
              \text{cost } \tfrac12 w\,\varepsilon^2

    The unknown is ε in units that give it a cost of the size of the others, whatever w: costs of
    one size are what the optimality of a result can be told by.
    """
    if not bands:
        return problem
    n, k = problem.n, len(bands)
    cost = float(np.abs(problem.H).max())
    wide = [np.hstack([problem.G, np.zeros((len(problem.g), k))])]
    sides = [problem.g]
    for i, band in enumerate(bands):
        slack = np.zeros((len(band.bounds), k))
        slack[:, i] = -math.sqrt(cost / float(band.weight or 1.0))
        rows = np.pad(band.rows, ((0, 0), (0, n - band.rows.shape[1])))
        wide.append(np.hstack([rows, slack]))
        sides.append(band.bounds)
    H = np.zeros((n + k, n + k))
    H[:n, :n] = problem.H
    H[range(n, n + k), range(n, n + k)] = cost
    return QuadraticProgram(
        H,
        np.concatenate([problem.c, np.zeros(k)]),
        np.hstack([problem.A, np.zeros((len(problem.b), k))]),
        problem.b,
        np.vstack(wide),
        np.concatenate(sides),
        np.concatenate([problem.lower, np.zeros(k)]),
        np.concatenate([problem.upper, np.full(k, np.inf)]),
    )


def check_speed(what: str, values: Array) -> None:
    """Refuse speeds that no robot has, and that costs and limits are lost beside."""
    fastest = largest(values)
    if not fastest <= FASTEST:
        raise InvalidInput(
            f"step: {what} for a speed of {fastest:.3g} (m/s or rad/s); check targets, gains "
            f"and dt. Speeds up to {FASTEST:g} are taken."
        )


def check_magnitudes(problem: QuadraticProgram, desired: Array) -> None:
    """Refuse what no solver can work with, and no robot: the loops of some would not end."""
    check_speed("the secondary asks", desired)
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
