"""Follow a path with a method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from qp_twist.checks import Array, did_you_mean, instance
from qp_twist.errors import InvalidInput
from qp_twist.following.planned import plan as plan_path
from qp_twist.following.planned import with_start
from qp_twist.following.stretches import follow_stretches
from qp_twist.following.trajectory import Trajectory
from qp_twist.kinematics import SecondaryObjective
from qp_twist.paths import (
    DEFAULT_METHOD,
    METHODS,
    LiftOffs,
    MethodSettings,
    PathTask,
    check_method,
    without_via_points,
)
from qp_twist.planning import Plan
from qp_twist.qp import check_solver


def follow(
    path_task: PathTask,
    method: str = DEFAULT_METHOD,
    *,
    solver: str | None = None,
    progress: Callable[[int], None] | None = None,
    stop: Callable[[Array, float, float], bool] | None = None,
    plan: Plan | None = None,
    planning: Callable[[str, float], None] | None = None,
    slow_down: bool = False,
    fine: bool = False,
    **options: Any,
) -> Trajectory:
    """Follow a path with one method.

    At each waypoint the method iterates until the task error is within the tolerances, up to its
    number of iterations. The secondary objective acts in the first iteration only: repeated, it
    would keep violating the task by curvature. The QPs keep the scene's position limits and, over
    the time of the waypoint, the task's velocity limits; if the whole task is infeasible within
    these, the step is scaled and the waypoint has an error. Where the projector changes
    (:class:`~qp_twist.paths.Segment`), the first iteration blends from one to the other, and the
    others correct the rows common to both.

    Where the task has joint moves, each stretch between them is followed by itself, from the start
    to which the joints move soonest of those from which the method keeps the stretch. The
    trajectory also has the rows of the joint moves, found and proven by ``JointMoveSearch``.

    Args:
        path_task: The task, from :func:`~qp_twist.load_task`.
        method: One of the method names; ``"qp_gradient"`` if none is given, the joint-space QP.
        solver: Backend of the QP methods; machine code if ``None``.
        progress: Called with the number of waypoints done.
        stop: Called after every waypoint with q (nq,), the position error (m) and the axis error
            (rad). The run ends if it returns true.
        plan: Plan that ``qp_planned`` follows, with the plan's start; if ``None`` it plans from the
            task's start, or from any where that is ``"best"``.
        planning: Called during planning with the current phase and its share done.
        slow_down: Whether to extend a waypoint's duration instead of missing it. The run ends
            before a waypoint that is out of reach for any duration; without ``slow_down`` it goes
            on, and :attr:`Trajectory.ending <qp_twist.Trajectory.ending>` says where it left the
            path. Acceleration limits are then left to :func:`~qp_twist.time_trajectory`.
        fine: Whether to follow the path also at rows between its waypoints, where joints that go
            straight from one to the next would leave it by more than the tolerances.
        **options: Settings that replace those of the task file, which replace the method's own
            (:data:`~qp_twist.paths.methods.METHODS`): ``iterations``, ``secondary`` (a name, or a
            :class:`~qp_twist.SecondaryObjective`), ``weight``, ``gain``, ``objective``, and for the
            peers ``posture_cost`` and ``every_iteration``.

    Returns:
        The trajectory, its first row the start corrected onto the first waypoint.

    Raises:
        InvalidInput: If the method or an option is unknown, an option would change nothing, the
            start cannot be corrected, or there is no plan.
        UnknownSolver: If the backend is not installed.
    """
    instance("follow(path_task, …)", path_task, PathTask)
    path_task = without_via_points(path_task)
    if plan is not None:
        path_task = _of_plan(path_task, plan)
    for name, function in (("progress", progress), ("stop", stop), ("planning", planning)):
        if function is not None and not callable(function):
            raise InvalidInput(f"follow({name}=…): expected a function, got {function!r}.")
    for name, given in (("slow_down", slow_down), ("fine", fine)):
        instance(f"follow({name}=…)", given, bool)
    solver = check_solver(solver)
    if options:
        path_task = with_options(path_task, [check_method(method)], options, f"follow({method!r})")
    settings = path_task.settings(method)
    if method in path_task.starts:
        path_task = replace(path_task, start=path_task.starts[method], best_start=False)
    if settings.secondary == "plan" and not METHODS[method].peer:  # peers refuse it
        path_task, plan = _with_plan(path_task, settings.objective, plan, planning, slow_down)
    else:
        path_task, plan = with_start(path_task, planning, slow_down=slow_down), None
    motion = None if plan is None else plan.at_waypoints
    paced = path_task
    if plan is not None and plan.is_slower:
        paced = replace(path_task, durations=plan.pace)
    trajectory = follow_stretches(
        paced, method, settings, start=None if motion is None else motion[0], solver=solver,
        plan=motion, slow_down=slow_down, fine=fine, progress=progress, stop=stop,
    )  # fmt: skip
    return replace(trajectory, path_task=path_task, plan=plan)


def _with_plan(
    path_task: PathTask,
    objective: str,
    plan: Plan | None,
    planning: Callable[[str, float], None] | None,
    slow_down: bool,
) -> tuple[PathTask, Plan]:
    """The task at its plan's start if that is to be the best one, and the plan, made if need be."""
    freely = path_task.best_start is True
    if not freely:
        path_task = with_start(path_task, planning, slow_down=slow_down)
    if plan is None:
        start = None if freely else path_task.start
        plan = plan_path(path_task, objective, start, slow_down=slow_down, progress=planning)
        path_task = _lifted(path_task, plan)
    return path_task.started_at(plan.start) if freely else path_task, plan


def _of_plan(path_task: PathTask, plan: Plan) -> PathTask:
    """The task with the lift-offs of a plan, which has to be one of its path."""
    instance("follow(plan=…)", plan, Plan)
    path_task = _lifted(path_task, plan)
    planned, count = len(plan.at_waypoints), len(path_task.waypoints)
    if planned != count:
        raise InvalidInput(
            f"follow(plan=…): the plan has {planned} waypoints, the path {count}; plan this path."
        )
    return path_task


def _lifted(path_task: PathTask, plan: Plan) -> PathTask:
    """The task with the lift-offs of its plan."""
    if plan.cuts == path_task.cuts or not plan.cuts:
        return path_task
    return LiftOffs.of(path_task, plan.cuts).task


def with_options(
    path_task: PathTask, methods: Sequence[str], options: Mapping[str, Any], call: str
) -> PathTask:
    """The task with options in place of the settings of methods, of each those that it uses.

    Raises:
        InvalidInput: If an option is unknown, has an invalid value, or would change nothing in any
            of the methods; with ``call``, what was called.
    """
    changed, left = dict(path_task.methods), dict[str, str]()
    used: set[str] = set()
    for method in methods:
        merged = {**path_task.settings(method).model_dump(), **options}
        unused = METHODS[method].unused(_validated(merged, call))
        own = {name: value for name, value in options.items() if name not in unused}
        stated = path_task.methods.get(method, MethodSettings()).model_dump(exclude_unset=True)
        used |= set(own)
        secondary = own.get("secondary")
        if isinstance(secondary, SecondaryObjective):
            own["gain"] = secondary.gain
        changed[method] = _validated({**stated, **own}, call)
        left |= {name: why for name, why in unused.items() if name in options}
    for name in options:
        if name not in used:
            raise InvalidInput(
                f"{call}: option {name} would change nothing, since {left[name]}; leave it out."
            )
    secondary = options.get("secondary")
    if isinstance(secondary, SecondaryObjective) and secondary.model.nv != path_task.model.nv:
        raise InvalidInput(
            f"{call}: the {type(secondary).__name__} is of a model with {secondary.model.nv} "
            f"degrees of freedom, the robot of {path_task.name} has {path_task.model.nv}; make it "
            "of task.model."
        )
    return replace(path_task, methods=changed)


def _validated(settings: dict[str, Any], call: str) -> MethodSettings:
    try:
        return MethodSettings.model_validate(settings)
    except ValidationError as error:
        item = error.errors()[0]
        name, fields = ".".join(map(str, item["loc"])), MethodSettings.model_fields
        if item["type"] == "extra_forbidden":
            said = f"there is no option {name!r}{did_you_mean(name, fields)}"
        else:
            said = f"option {name}: {item['msg']}, got {item['input']!r}."
        raise InvalidInput(f"{call}: {said} Options: {', '.join(fields)}.") from None
