"""What mink tasks of any class state: costs and rows, checked by the name of the task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, are_rows, finite_array, float_array, largest, within
from qp_twist.errors import InvalidInput, InvalidTarget
from qp_twist.kernel.constants import ELASTIC_CURVED, FASTEST
from qp_twist.kinematics import BandRows

LARGEST_ROW = 1e12
"""Largest entry of a task's rows: beyond it the others are lost in the arithmetic."""


class WeightedRows(NamedTuple):
    """A cost ½‖W Δq − e‖² + ½ μ‖Δq‖² of a mink task."""

    rows: Array
    """W, (k, nv)."""
    error: Array
    """e, (k,)."""
    damping: Any
    """μ, a number or (nv,)."""
    penalty: Array | None = None
    """ρ of an elastic task, (k,), whose cost is Σ ρᵢ |(W Δq − e)ᵢ| instead; ``None`` of others."""


def name_of(task: Any) -> str:
    """How messages call a task: with its frame, where it has one."""
    frame, kind = getattr(task, "frame_name", None), getattr(task, "frame_type", None)
    name = type(task).__name__
    if hasattr(task, "compute_penalized_rows"):  # around a task
        return f"{name}({name_of(task.task)})" if hasattr(task, "task") else name
    return name if frame is None or kind is None else f"{name}({frame!r}, {kind!r})"


def check_target(task: Any) -> None:
    """Refuse a mink task whose target is not finite."""
    target = getattr(task, "transform_target_to_world", None)
    if isinstance(target, mink.SE3):
        finite_array(f"{name_of(task)}: its target", target.wxyz_xyz, (7,), error=InvalidTarget)


def _elastic(task: Any) -> bool:
    """Whether a task says that it is elastic."""
    given = getattr(task, "elastic", False)
    if given is not False and np.size(given) != 1:
        raise InvalidInput(
            f"expected True or False, got {given!r}.", key=f"{name_of(task)}: elastic"
        )
    return bool(given)


def refuse_elastic(task: Any) -> None:
    """Refuse an elastic task where rows are met, not priced: as a constraint, or in a level."""
    if _elastic(task):
        raise InvalidInput(
            f"{name_of(task)} is elastic: its rows may be missed at a price, so that it is neither "
            "a constraint nor a task of a level. Give it in tasks=, of a qt.Controller as a mink "
            "task, or set elastic=False."
        )


def is_elastic(source: object) -> bool:
    """Whether these are a row of an elastic task."""
    return isinstance(source, BandRows) and source.price > 0.0


def elastic_constraint(item: Any, configuration: mink.Configuration) -> WeightedRows:
    """What an item with mink's ``compute_penalized_rows``, ``mink.Elastic``, states for a cost.

    Rows of price 0 are free.
    """
    stated = item.compute_penalized_rows(configuration)
    if not isinstance(stated, (tuple, list)) or len(stated) != 3:
        raise InvalidInput(
            "expected the rows J, their errors times the gain and their prices, (J, e, ρ); got "
            f"{type(stated).__name__ if stated is not None else None}"
            f"{f' of {len(stated)}' if isinstance(stated, (tuple, list)) else ''}.",
            key=f"{name_of(item)}: compute_penalized_rows",
        )
    J, e, given = stated
    rows, error = as_rows(item, J, e, configuration.model.nv)
    penalty = _penalty(item, given, len(error), free=True)
    priced = penalty > 0.0
    return WeightedRows(rows[priced], -error[priced], 0.0, penalty[priced])


def _penalty(task: Any, given: Any, k: int, *, free: bool = False) -> Array:
    """ρ of the k rows of an elastic task or constraint: one number for all or one for each.

    0, where rows may be ``free``.
    """
    name, least = f"{name_of(task)}: its penalty", "at least 0" if free else "above 0"
    if given is None:
        raise InvalidInput(f"expected a number {least}, or one for each row; got None.", key=name)
    if np.size(given) == 1:
        given = np.full(k, np.asarray(given).item())
    penalty = finite_array(name, given, (k,))
    if not (penalty >= 0.0 if free else penalty > 0.0).all():
        raise InvalidInput(f"expected numbers {least}, got {penalty.min():g}.", key=name)
    return within(name, penalty, LARGEST_ROW)


def elastic_rows(
    tasks: Sequence[Any], stated: Sequence[WeightedRows | mink.Objective | None], dt: float
) -> list[BandRows]:
    r"""The rows of elastic tasks, each with a slack ε ≥ 0, divided by dt² as all costs on q̇.

    .. math::

        -\varepsilon_i \le \mathbf w_i^T\dot{\mathbf q} - e_i/dt \le \varepsilon_i, \qquad
        \text{cost } \tfrac{\rho_i}{dt}\,(\varepsilon_i + \tfrac{1}{2}\,\eta\,\varepsilon_i^2/r)

    η makes the program strictly convex in ε; r is a speed of the size of those that may be missed.
    """
    found: list[BandRows] = []
    for task, cost in zip(tasks, stated, strict=True):
        if isinstance(cost, WeightedRows) and cost.penalty is not None:
            check_cost(task, cost)
            name = name_of(task)
            rates = within(f"{name}: its error/dt", cost.error / dt, FASTEST)
            lengths = np.linalg.norm(cost.rows, axis=1)
            reach = max(largest(rates), largest(lengths))
            for i in np.flatnonzero(lengths).tolist():  # a cost of zero asks for nothing
                row, rate, price = cost.rows[i], rates[i], float(cost.penalty[i]) / dt
                rows, bounds = np.array([row, -row]), np.array([rate, -rate])
                weight = ELASTIC_CURVED * price / reach
                found.append(BandRows(rows, bounds, f"{name} row {i + 1}", weight, price))
    return found


def mink_cost(
    task: mink.tasks.BaseTask, configuration: mink.Configuration
) -> WeightedRows | mink.Objective:
    """What a task states for a cost, once asked and of the right shape; any class may state it.

    As mink has it: lists of numbers and single rows are taken, and a pair for an objective. A task
    with a true attribute ``elastic`` has the attribute ``penalty``, too (mink after 1.3). Anything
    else is refused.
    """
    elastic = _elastic(task)
    nv, residual = configuration.model.nv, task.compute_qp_residual(configuration)
    if residual is None:
        if elastic:
            raise InvalidInput(f"{name_of(task)} is elastic, but states no rows to be missed.")
        return _objective(name_of(task), task.compute_qp_objective(configuration), nv)
    W, e, damping = residual
    rows, error = as_rows(task, W, e, nv)
    if not elastic:
        return WeightedRows(rows, error, damping)
    if np.any(np.asarray(damping) > 0.0):
        raise InvalidInput(f"{name_of(task)} is elastic: set its lm_damping to 0.")
    penalty = _penalty(task, getattr(task, "penalty", None), len(error))
    return WeightedRows(rows, error, 0.0, penalty)


def as_rows(task: Any, rows: Any, sides: Any, nv: int) -> tuple[Array, Array]:
    """Rows (k, nv) and sides (k,) of a task; one row may be given without its brackets."""
    if are_rows(rows, sides, nv):
        return rows, sides
    name = f"{name_of(task)}: its rows", f"{name_of(task)}: its error"
    matrix = finite_array(name[0], np.atleast_2d(float_array(name[0], rows)), (None, nv))
    given = np.atleast_1d(float_array(name[1], sides))
    return matrix, finite_array(name[1], given, (len(matrix),))


def _objective(name: str, objective: Any, nv: int) -> mink.Objective:
    """H, made symmetric, and c; the cost depends on no more than that part of H."""
    H, c = objective
    if not (type(H) is type(c) is np.ndarray and H.shape == (nv, nv) and c.shape == (nv,)):
        H = finite_array(f"{name}: H of its cost", H, (nv, nv))
        c = finite_array(f"{name}: c of its cost", c, (nv,))
    return mink.Objective(0.5 * (H + H.T), c)


def check_cost(task: mink.tasks.BaseTask, stated: WeightedRows | mink.Objective) -> None:
    """Refuse what is not finite, or too large to compute with, by the name of the task."""
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
) -> tuple[Array, Array, list[BandRows]]:
    """H and c of mink tasks on q̇: theirs are on Δq = q̇ dt, here divided by dt²; elastic rows."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused by name
        stated = [mink_cost(task, configuration) for task in tasks]
        H, c = costs_of(tasks, stated, configuration.model.nv, dt)
        return H, c, elastic_rows(tasks, stated, dt)


def costs_of(
    tasks: Sequence[mink.tasks.BaseTask],
    stated: Sequence[WeightedRows | mink.Objective],
    nv: int,
    dt: float,
) -> tuple[Array, Array]:
    r"""H and c of :func:`mink_costs`, of what tasks have stated; elastic ones have none.

    .. math::

        \mathbf H = \textstyle\sum(\mathbf W^T\mathbf W + \mu\mathbf 1), \qquad
              \mathbf c = -\textstyle\sum\mathbf W^T\mathbf e
    """
    H, c = np.zeros((nv, nv)), np.zeros(nv)
    for cost in stated:
        if isinstance(cost, WeightedRows):
            if cost.penalty is not None:
                continue
            H += cost.rows.T @ cost.rows
            H.reshape(-1)[:: nv + 1] += cost.damping
            c -= cost.error @ cost.rows
        else:
            H += cost.H
            c += cost.c
    # Squares of the largest rows that are taken; written so that NaN is too large.
    if not largest(H) + largest(c) <= LARGEST_ROW**2:
        for task, cost in zip(tasks, stated, strict=True):
            check_cost(task, cost)
    return H, c / dt
