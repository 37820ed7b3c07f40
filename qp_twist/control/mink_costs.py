"""What mink tasks of any class state: costs and rows, checked by the name of the task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, are_rows, finite_array, float_array, largest, within
from qp_twist.errors import InvalidInput, InvalidTarget

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


def refuse_elastic(task: Any) -> None:
    """Refuse an elastic task of a newer mink: its rows are neither a cost nor equations.

    Raises:
        InvalidInput: If the task has a true attribute ``elastic``.
    """
    if getattr(task, "elastic", False):
        raise InvalidInput(
            f"{name_of(task)} is elastic: its rows may be missed at a price (mink after 1.3), "
            "which qp_twist would ignore. Give the same task with elastic=False, for a cost or an "
            "equation, or a lower level of a qt.Controller to a task that may give way."
        )


def mink_cost(
    task: mink.tasks.BaseTask, configuration: mink.Configuration
) -> WeightedRows | mink.Objective:
    """What a task states for a cost, once asked and of the right shape; any class may state it.

    As mink has it: lists of numbers and single rows are taken, and a pair for an objective.

    Raises:
        InvalidInput: If it is anything else.
    """
    refuse_elastic(task)
    nv, residual = configuration.model.nv, task.compute_qp_residual(configuration)
    if residual is None:
        return _objective(name_of(task), task.compute_qp_objective(configuration), nv)
    W, e, damping = residual
    return WeightedRows(*as_rows(task, W, e, nv), damping)


def as_rows(task: Any, rows: Any, sides: Any, nv: int) -> tuple[Array, Array]:
    """Rows (k, nv) and sides (k,) of a task; one row may be given without its brackets.

    Raises:
        InvalidInput: If they are none, or not finite.
    """
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
    """H and c of mink tasks on q̇: theirs are on Δq = q̇ dt, here divided by dt².

    Raises:
        InvalidInput: If what a task states is not finite or of the wrong shape.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused by name
        stated = [mink_cost(task, configuration) for task in tasks]
        return costs_of(tasks, stated, configuration.model.nv, dt)


def costs_of(
    tasks: Sequence[mink.tasks.BaseTask],
    stated: Sequence[WeightedRows | mink.Objective],
    nv: int,
    dt: float,
) -> tuple[Array, Array]:
    r""":func:`mink_costs` of what tasks have stated.

    .. math::

        \mathbf H = \textstyle\sum(\mathbf W^T\mathbf W + \mu\mathbf 1), \qquad
              \mathbf c = -\textstyle\sum\mathbf W^T\mathbf e
    """
    H, c = np.zeros((nv, nv)), np.zeros(nv)
    for cost in stated:
        if isinstance(cost, WeightedRows):
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
