"""What a controller is composed of: checked when it is assigned, between steps too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Revised, checked, finite_array, number, one_of, read_only
from qp_twist.constraints import Constraint, check_constraint, check_model
from qp_twist.control.mink_costs import refuse_elastic
from qp_twist.control.posing import LevelItem
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import SecondaryObjective, TwistTask, frame_pose
from qp_twist.qp import check_solver

TIE_BREAK = 1e-9
"""Default ρ in joint space if other mink tasks have costs; ρ then only makes the result unique."""
UNSEEN_WEIGHT = 1e-2
"""Default ρ in twist space, where it applies only to motion that the twist cost does not see."""
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12
"""Range of ρ and the entries of M: beyond it, they or other costs are lost to rounding."""
SINGULARITY = 1e-3
"""Singular value of the task rows, m/rad or 1, below which a direction is slowed down."""
SMOOTH_SINGULARITY = 5e-3
"""The same of smooth steps: an arm that is stretched stays near enough to a bent one to return."""
LARGEST_FREE_COST = 1e6
"""Largest root of w: beyond it other costs are lost to rounding."""
SMALLEST_SINGULARITY = 1e-9
"""A smaller ``singularity`` counts as 0."""


def _metric(settings: Any, name: str, value: npt.ArrayLike) -> Array:
    """The diagonal of M, read-only: only an assignment can change it, which steps detect."""
    metric = finite_array(name, value, (settings.model.nv,))
    if not ((metric >= SMALLEST_WEIGHT) & (metric <= LARGEST_WEIGHT)).all():
        raise InvalidInput(
            f"metric: every entry must be above 0, from {SMALLEST_WEIGHT:g} to {LARGEST_WEIGHT:g}."
        )
    return read_only(metric)


def _joint_weight(_: Any, name: str, value: Any) -> float:
    return number(name, value, at_least=SMALLEST_WEIGHT, at_most=LARGEST_WEIGHT)


def _flag(_: Any, name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidInput(f"{name}: expected True or False, got {value!r}.")
    return bool(value)


def _free_twist_costs(_: Any, name: str, value: tuple[float, float]) -> tuple[float, float]:
    """Roots of w for the linear and the angular rows of 1 − T."""
    linear, angular = finite_array(name, value, (2,)).tolist()
    if not 0.0 <= min(linear, angular) <= max(linear, angular) <= LARGEST_FREE_COST:
        raise InvalidInput(f"{name}: expected two numbers from 0 to {LARGEST_FREE_COST:g}.")
    return linear, angular


def _secondaries(settings: Any, name: str, value: Any) -> tuple[SecondaryObjective, ...]:
    return tuple(all_of(settings.model, name, SecondaryObjective, value))


def checked_limits(settings: Any, name: str, value: Any) -> list[mink.Limit]:
    """A list of limits of the model, without those that no step can keep."""
    limits = list(all_of(settings.model, name, mink.Limit, value))
    _check_constraints(settings.model, limits)
    return limits


class StepSettings(Revised):
    """The attributes of a :class:`~qp_twist.Controller`, which documents them."""

    secondary: Sequence[SecondaryObjective] = checked(_secondaries)
    limits: list[mink.Limit] = checked(checked_limits)
    secondary_space: str = checked(lambda _, name, value: one_of(name, value, ("joint", "twist")))
    metric: Array = checked(_metric)
    joint_weight: float = checked(_joint_weight)
    free_twist_costs: tuple[float, float] = checked(_free_twist_costs)
    solver: str = checked(lambda _, name, value: check_solver(value))
    on_infeasible: str = checked(
        lambda _, name, value: one_of(name, value, ("scale", "relax", "raise"))
    )
    smooth: bool = checked(_flag)
    braking: bool = checked(_flag)

    def __init__(self, model: mujoco.MjModel) -> None:
        """The defaults of a controller without a secondary in twist space."""
        self.model = model
        self.metric, self.joint_weight = np.ones(model.nv), 1.0
        self.free_twist_costs = 1.0, 1.0
        self.smooth = self.braking = True
        self._singularity: float | None = None

    @property
    def singularity(self) -> float:
        """ε."""
        if self._singularity is None:
            return SMOOTH_SINGULARITY if self.smooth else SINGULARITY
        return self._singularity

    @singularity.setter
    def singularity(self, value: float) -> None:
        given = number("singularity", value, at_least=0.0, at_most=1.0)
        # What is too small to distinguish from rounding is 0.
        self._singularity = given if given >= SMALLEST_SINGULARITY else 0.0


class TasksByKind(NamedTuple):
    """The tasks of a controller, which stay the same, by what they add to a step.

    Attributes:
        levels: The strict priorities, most important first: tasks and limits.
        of_levels: The tasks among them.
        twist: The TwistTasks among these.
        soft: The tasks that add a cost.
    """

    levels: tuple[tuple[LevelItem, ...], ...]
    of_levels: tuple[mink.tasks.BaseTask, ...]
    twist: tuple[TwistTask, ...]
    soft: tuple[mink.tasks.BaseTask, ...]


def checked_tasks(
    model: mujoco.MjModel,
    tasks: Sequence[mink.tasks.BaseTask],
    levels: Sequence[Sequence[LevelItem]] | None,
) -> TasksByKind:
    """The tasks of a controller from its arguments."""
    twist_tasks = tuple(task for task in _sequence("tasks", tasks) if isinstance(task, TwistTask))
    stated: tuple[tuple[LevelItem, ...], ...] = (twist_tasks,)
    if levels is not None:
        if twist_tasks:
            raise InvalidInput(
                "Controller: with levels= every TwistTask belongs to a level; tasks= then holds "
                "only mink tasks that add a cost."
            )
        stated = tuple(tuple(_sequence("levels", v)) for v in _sequence("levels", levels))
        if not stated or not all(stated):
            raise InvalidInput("Controller(levels=…): expected lists of tasks, none of them empty.")
    if model.nv == 0:
        raise InvalidInput("Controller: the model has no joints to move.")
    items = [item for level in stated for item in level]
    if len(tasks) == len(twist_tasks) and all(isinstance(item, mink.Limit) for item in items):
        raise InvalidInput("Controller: tasks is empty; give at least one TwistTask.")
    for item in items:
        if not isinstance(item, (mink.tasks.BaseTask, mink.Limit)):
            raise InvalidInput(f"Controller(levels=…): expected tasks and limits, got {item!r}.")
        if isinstance(item, mink.tasks.BaseTask):
            refuse_elastic(item)
    all_of(model, "tasks", mink.tasks.BaseTask, tasks)
    _check_constraints(model, items)
    probe = mink.Configuration(model)
    for item in items:
        if isinstance(item, TwistTask):
            frame_pose(probe, item.frame_name, item.frame_type)
    of_levels = tuple(item for item in items if not isinstance(item, mink.Limit))
    return TasksByKind(
        stated,
        of_levels,
        tuple(task for task in of_levels if isinstance(task, TwistTask)),
        tuple(task for task in tasks if not isinstance(task, TwistTask)),
    )


def all_of(model: mujoco.MjModel, name: str, expected: type, items: Any) -> Sequence[Any]:
    """The items, each of the type expected and of the model."""
    for item in _sequence(name, items):
        if not isinstance(item, expected):
            raise InvalidInput(
                f"Controller({name}=…): expected objects of type {expected.__name__}, got {item!r}."
            )
        check_model(f"Controller({name}=…)", item, model.nv)
    return cast(Sequence[Any], items)


def _check_constraints(model: mujoco.MjModel, limits: Sequence[object]) -> None:
    """Refuse constraints of another model, and those that no step can keep."""
    for limit in limits:
        if isinstance(limit, Constraint):
            check_constraint(f"Controller(limits=…): {type(limit).__name__}", limit, model)


def _sequence(name: str, value: Any) -> Sequence[Any]:
    """A list or tuple as it is."""
    if isinstance(value, (list, tuple)):
        return value
    raise InvalidInput(f"Controller({name}=…): expected a list, got {value!r}.")
