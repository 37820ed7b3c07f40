"""A sample of a study: the task with values drawn by its index."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal

import mink
import numpy as np

from qp_twist.checks import Array, did_you_mean
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, frame_pose
from qp_twist.paths import METHODS, PathTask, leaned, load_scene, placed, rerooted
from qp_twist.paths.task_schema import (
    PlacementTable,
    RobotTable,
    SolverTable,
    StudySection,
    ToolTable,
)
from qp_twist.planning import least_z_start, random_start
from qp_twist.qp import check_solver

Start = Literal["auto", "task", "least_z", "random", "best"]
FACTORS = ("robot", "placement", "tool", "gain", "solver", "start")
"""Factors that can be varied, in the order of application."""
_MOVED = {"placement", "tool", "robot"}
_REACHED = 0.2
"""A waypoint counts as reached at this share of the tolerances."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample.

    Attributes:
        index: Its index; with the seed it determines the sample.
        path_task: The task of this sample.
        solver: Backend of the QP methods.
        drawn: The drawn values by column name.
        methods: Methods that follow it.
        no_start: Methods without a start.
    """

    index: int
    path_task: PathTask
    solver: str
    drawn: dict[str, Any]
    methods: tuple[str, ...] = ()
    no_start: frozenset[str] = frozenset()

    def __str__(self) -> str:
        values = ", ".join(
            f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.drawn.items()
        )
        return f"sample {self.index}: {values or 'nothing drawn'}"


def section_of(path_task: PathTask) -> StudySection:
    """The task's study section, possibly empty."""
    return path_task.study or StudySection()


def check_factors(path_task: PathTask, vary: Collection[str]) -> tuple[str, ...]:
    """``vary`` in the order of :data:`FACTORS`.

    Raises:
        InvalidInput: If a factor is unknown or the task has no range for it.
    """
    section = section_of(path_task)
    if not vary:
        raise InvalidInput(f"study: vary is empty; name one of {', '.join(FACTORS)}.")
    for name in vary:
        if name not in FACTORS:
            raise InvalidInput(
                f"study: cannot vary {name!r}{did_you_mean(str(name), FACTORS)} What can be "
                f"varied: {', '.join(FACTORS)}."
            )
        if name != "start" and getattr(section, name) is None:
            raise InvalidInput(
                f"study: {path_task.name} does not say how to vary {name}: add a table "
                f"[study.{name}] to the task file."
            )
    if "placement" in vary and (table := section.placement) is not None:
        placed(path_task, mink.SO3.identity(), table.point, table.point, table.body)
    tool = section.tool if "tool" in vary else None
    if tool is not None and not any((*tool.lead_deg, *tool.tilt_deg)):
        raise InvalidInput("study.tool: lead_deg and tilt_deg are zero; give one of them a range.")
    for method in section.gain or () if "gain" in vary else ():
        if path_task.settings(method).secondary == "none":
            raise InvalidInput(f"study.gain.{method}: the method has no secondary, and so no gain.")
    for solver in section.solver.names if section.solver and "solver" in vary else ():
        check_solver(solver)
    for scene in section.robot.scenes if section.robot and "robot" in vary else ():
        _with_robot(path_task, scene)
    return tuple(name for name in FACTORS if name in vary)


def drawn_columns(path_task: PathTask, vary: Collection[str]) -> dict[str, type]:
    """Names and types of the values drawn by :func:`draw_sample`."""
    columns: dict[str, type] = {}
    if "placement" in vary:
        columns |= dict.fromkeys(("x", "y", "z", "yaw_deg", "tilt_deg", "azimuth_deg"), float)
    if "tool" in vary:
        columns |= dict.fromkeys(("tool_lead_deg", "tool_tilt_deg"), float)
    if "robot" in vary:
        columns["scene"] = str
    if "gain" in vary:
        gains = section_of(path_task).gain or {}
        columns |= {f"gain_{name}": float for name in sorted(gains)}
    return columns


def draw_sample(
    path_task: PathTask,
    vary: Collection[str],
    index: int,
    *,
    seed: int = 0,
    solver: str = "daqp",
    start: Start = "auto",
    methods: Collection[str] = (),
) -> Sample:
    """The sample with an index; it depends on seed and index only.

    Args:
        path_task: The task.
        vary: Names from :data:`FACTORS`.
        index: Index of the sample, from 0.
        seed: Seed of the study.
        solver: Backend, unless it is varied.
        start: ``"task"``: the task's; ``"least_z"`` and ``"random"``: on the first waypoint of the
            sample, inside the limits; ``"best"``: a plan's; ``"auto"``: random if the start is
            varied, the task's if the first waypoint does not move, else of least z.
        methods: Methods that will follow it; those that fix the whole twist need another start.
    """
    section = section_of(path_task)
    drawn: dict[str, Any] = {}
    if section.max_step_deg is not None:
        path_task = with_largest_step(path_task, section.max_step_deg)
    path_task = dataclasses.replace(path_task, iteration=_tolerances(path_task, section))
    for factor, one_draw in _DRAWS.items():
        if factor in vary:
            # One random stream per factor: its values do not depend on which others are varied.
            table = getattr(section, factor)
            path_task, values = one_draw(path_task, table, _stream(seed, index, factor))
            drawn |= values
    if start == "auto":
        start = _default_start(path_task, vary)
    no_start: frozenset[str] = frozenset()
    if start in ("least_z", "random"):
        path_task, no_start = _with_starts(path_task, methods, start, _stream(seed, index, "start"))
    elif start == "best":
        path_task = dataclasses.replace(path_task, best_start=True)
    return Sample(index, path_task, drawn.get("solver", solver), drawn, tuple(methods), no_start)


def _stream(seed: int, index: int, factor: str) -> np.random.Generator:
    # The same placements as in benchmarks/placements.py.
    number = [] if factor == "placement" else [FACTORS.index(factor)]
    return np.random.default_rng([seed, index, *number])


def _default_start(path_task: PathTask, vary: Collection[str]) -> Start:
    if "start" in vary:
        return "random"
    if path_task.best_start == "central":
        return "least_z"
    if path_task.best_start:
        return "best"
    return "least_z" if _MOVED & set(vary) else "task"


def with_largest_step(path_task: PathTask, max_step_deg: float) -> PathTask:
    """One waypoint per second, so that speeds equal steps."""
    return dataclasses.replace(
        path_task,
        durations=np.concatenate([[0.0], np.ones(len(path_task.waypoints) - 1)]),
        velocity_limits=np.full(path_task.model.nv, np.radians(max_step_deg)),
        acceleration_limits=np.full(path_task.model.nv, np.inf),
    )


def _tolerances(path_task: PathTask, section: StudySection) -> Any:
    """Waypoints count as reached well inside the tolerances of success, not the task's."""
    given = path_task.iteration
    angle = max(given.angle_tolerance_deg, _REACHED * section.axis_error_deg)
    position = max(given.position_tolerance, _REACHED * section.position_error)
    return given.model_copy(update={"position_tolerance": position, "angle_tolerance_deg": angle})


# ---------------------------------------------------------------- drawn values


Drawn = tuple[PathTask, dict[str, Any]]


def _placement(path_task: PathTask, table: PlacementTable, rng: np.random.Generator) -> Drawn:
    to = rng.uniform(table.lower, table.upper)
    low, high = np.radians(table.yaw_deg)
    # Draw numbers even if they are not used, so that other ranges do not shift them.
    yaw, azimuth = low + (high - low) * rng.uniform(), rng.uniform(-np.pi, np.pi)
    tilt = rng.uniform(*np.radians(table.tilt_deg))
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    rotation = mink.SO3.exp(tilt * axis) @ mink.SO3.from_z_radians(yaw)
    values = dict(zip(("x", "y", "z"), map(float, to), strict=True))
    for name, angle in (("yaw_deg", yaw), ("tilt_deg", tilt), ("azimuth_deg", azimuth)):
        values[name] = float(np.degrees(angle))
    return placed(path_task, rotation, table.point, to, table.body), values


def _tool(path_task: PathTask, table: ToolTable, rng: np.random.Generator) -> Drawn:
    lead, tilt = rng.uniform(*table.lead_deg), rng.uniform(*table.tilt_deg)
    values = {"tool_lead_deg": float(lead), "tool_tilt_deg": float(tilt)}
    return leaned(path_task, *np.radians([lead, tilt])), values


def _robot(path_task: PathTask, table: RobotTable, rng: np.random.Generator) -> Drawn:
    scene = str(rng.choice(table.scenes))
    return _with_robot(path_task, scene), {"scene": scene}


def _gain(
    path_task: PathTask, table: dict[str, tuple[float, float]], rng: np.random.Generator
) -> Drawn:
    settings, values = dict(path_task.methods), {}
    for method, interval in sorted(table.items()):
        gain = float(np.exp(rng.uniform(*np.log(interval))))
        settings[method] = path_task.settings(method).model_copy(update={"gain": gain})
        values[f"gain_{method}"] = gain
    return dataclasses.replace(path_task, methods=settings), values


def _solver(path_task: PathTask, table: SolverTable, rng: np.random.Generator) -> Drawn:
    return path_task, {"solver": str(rng.choice(table.names))}


_DRAWS: dict[str, Callable[[PathTask, Any, np.random.Generator], Drawn]] = {
    "robot": _robot, "placement": _placement, "tool": _tool, "gain": _gain, "solver": _solver,
}  # fmt: skip


def _with_robot(path_task: PathTask, scene: str) -> PathTask:
    if path_task.source is None:
        raise InvalidInput("study: robots are varied for tasks from a file, beside which they are.")
    robot = load_scene(path_task.source, scene)
    model, around = robot.model, None
    if path_task.relative_to is not None:
        model, around = rerooted(robot.model, path_task.relative_to).model, robot.model
    names, expected = JointRanges.of(model).names, JointRanges.of(path_task.model).names
    if names != expected:
        raise InvalidInput(
            f"study.robot.scenes: {scene} has the joints {', '.join(names)}; the task's robot has "
            f"{', '.join(expected)}. Limits, starts and methods are stated for these."
        )
    frame_pose(mink.Configuration(model), path_task.frame_name, path_task.frame_type)
    return dataclasses.replace(path_task, scene=robot.path, model=model, scene_model=around)


# ---------------------------------------------------------------- starts


def _with_starts(
    path_task: PathTask, methods: Collection[str], start: str, rng: np.random.Generator
) -> tuple[PathTask, frozenset[str]]:
    """The task with a start, and another one for methods that fix the roll; those without any."""

    def found(task: PathTask) -> Array | None:
        return least_z_start(task) if start == "least_z" else random_start(task, rng)

    free = found(path_task)
    if free is None:
        return path_task, frozenset(methods)
    starts: dict[str, Array] = {}
    no_start: set[str] = set()
    whole = dataclasses.replace(path_task, projector=path_task.operational, segments=(), bands=())
    for flipped, waypoints in (
        (False, path_task.waypoints), (True, path_task.flipped_waypoints)
    ):  # fmt: skip
        names = [m for m in methods if METHODS[m].whole_twist and METHODS[m].flipped is flipped]
        fixed = None
        if names and waypoints:
            fixed = found(dataclasses.replace(whole, waypoints=waypoints))
        if fixed is None:
            no_start.update(names)
        else:
            starts |= dict.fromkeys(names, fixed)
    return dataclasses.replace(path_task, start=free, starts=starts), frozenset(no_start)
