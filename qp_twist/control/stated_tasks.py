"""The tasks of a controller, for good: by level, and those that add a cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import mink
import mujoco

from qp_twist.constraints import Constraint, check_constraint, check_model
from qp_twist.control.posing import LevelItem
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import TwistTask, frame_pose


class StatedTasks(NamedTuple):
    """The tasks of a controller; see :class:`~qp_twist.Controller`."""

    levels: tuple[tuple[LevelItem, ...], ...]
    tasks: tuple[mink.tasks.BaseTask, ...]
    """Those of all levels."""
    twist_tasks: tuple[TwistTask, ...]
    soft_tasks: tuple[mink.tasks.BaseTask, ...]
    """Those that add a cost."""

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        tasks: Sequence[mink.tasks.BaseTask],
        levels: Sequence[Sequence[LevelItem]] | None,
    ) -> StatedTasks:
        """Check the arguments of a controller."""
        stated = _levels(sequence("tasks", tasks), levels)
        of_levels = tuple(v for level in stated for v in level if not isinstance(v, mink.Limit))
        soft = tuple(task for task in tasks if not isinstance(task, TwistTask))
        _check_tasks(model, stated, soft)
        twists = tuple(task for task in of_levels if isinstance(task, TwistTask))
        return cls(stated, of_levels, twists, soft)


def _check_tasks(
    model: mujoco.MjModel, levels: Sequence[Sequence[LevelItem]], soft_tasks: Sequence[Any]
) -> None:
    if model.nv == 0:
        raise InvalidInput("Controller: the model has no joints to move.")
    items = [item for level in levels for item in level]
    if not soft_tasks and all(isinstance(item, mink.Limit) for item in items):
        raise InvalidInput("Controller: tasks is empty; give at least one TwistTask.")
    for item in items:
        if not isinstance(item, (mink.tasks.BaseTask, mink.Limit)):
            raise InvalidInput(f"Controller(levels=…): expected tasks and limits, got {item!r}.")
    all_of(model, "tasks", mink.tasks.BaseTask, soft_tasks)
    check_constraints(model, items)
    probe = mink.Configuration(model)
    for item in items:
        if isinstance(item, TwistTask):
            frame_pose(probe, item.frame_name, item.frame_type)


def _levels(
    tasks: Sequence[mink.tasks.BaseTask], levels: Sequence[Sequence[LevelItem]] | None
) -> tuple[tuple[LevelItem, ...], ...]:
    twist_tasks = tuple(task for task in tasks if isinstance(task, TwistTask))
    if levels is None:
        return (twist_tasks,)
    if twist_tasks:
        raise InvalidInput(
            "Controller: with levels= every TwistTask belongs to a level; tasks= then holds only "
            "mink tasks that add a cost."
        )
    given = tuple(tuple(sequence("levels", level)) for level in sequence("levels", levels))
    if not given or not all(given):
        raise InvalidInput("Controller(levels=…): expected lists of tasks, none of them empty.")
    return given


def all_of(model: mujoco.MjModel, name: str, expected: type, items: Any) -> Sequence[Any]:
    """The items, each of the type expected and of the model."""
    for item in sequence(name, items):
        if not isinstance(item, expected):
            raise InvalidInput(
                f"Controller({name}=…): expected objects of type {expected.__name__}, got {item!r}."
            )
        check_model(f"Controller({name}=…)", item, model.nv)
    return cast(Sequence[Any], items)


def check_constraints(model: mujoco.MjModel, limits: Sequence[object]) -> None:
    """Refuse constraints of another model, and those that no step can keep."""
    for limit in limits:
        if isinstance(limit, Constraint):
            check_constraint(f"Controller(limits=…): {type(limit).__name__}", limit, model)


def sequence(name: str, value: Any) -> Sequence[Any]:
    """A list or tuple as it is."""
    if isinstance(value, (list, tuple)):
        return value
    raise InvalidInput(f"Controller({name}=…): expected a list, got {value!r}.")
