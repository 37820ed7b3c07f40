"""The contenders: the floor, this package's steps, other libraries' steps, the closed forms."""

import importlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import mink
import mujoco
import numpy as np
from step_problems import DT, Problem
from step_program import Variant, turn_error
from timer import SplitStep, StepOf
from urdf import link_name, robot_urdf

from qp_twist.checks import Array, Indices
from qp_twist.closed_form import gradient_projection, minimum_norm, resolved_motion_rate, twa
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, solve_ik
from qp_twist.errors import UnknownSolver
from qp_twist.geometry import Projector, ProjectorKind, TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import PostureReference, TwistTask
from qp_twist.qp import check_solver, installed_solvers

EXPECTED = ("daqp", "proxqp", "osqp", "piqp", "quadprog", "clarabel", COMPILED)
"""Backends that are listed as missing if not installed."""


@dataclass(frozen=True)
class Contender:
    """A method and library that computes a step.

    Attributes:
        name: FAMILY:VARIANT, as for ``--only``.
        variant: The program that it solves.
        prepare: Untimed preparation: the robot and targets in the library's types. Returns a
            function that makes the step's objects (controller, tasks, limits), which are never
            shared.
        missing: Why it cannot take part at all; ``None`` if it can.
        applies: Whether it can take part in a problem.
    """

    name: str
    variant: Variant
    prepare: Callable[[Problem], Callable[[], StepOf]]
    missing: Callable[[], str | None] = lambda: None
    applies: Callable[[Problem], bool] = lambda problem: True

    @property
    def family(self) -> str:
        """The part of the name before the colon."""
        return self.name.partition(":")[0]


def one_level(problem: Problem) -> bool:
    """Whether a problem has no strict priorities."""
    return len(problem.levels) <= 1


def tool_axes(problem: Problem) -> bool:
    """Whether every frame has to keep exactly its position and its z axis.

    The soft tasks of other libraries, PlaCo's, and the closed forms are set up for these rows.
    """
    return (
        one_level(problem)
        and not len(problem.half_spaces)
        and all(
            frame.projector.linear.kind is ProjectorKind.FULL
            and frame.projector.angular.kind is ProjectorKind.PLANE
            for frame in problem.frames
        )
    )


def contenders() -> list[Contender]:
    """All contenders, installed or not."""
    return [*floor(), *own_steps(), *peer_steps(), *closed_form_contenders()]


# ---------------------------------------------------------------- the floor


def floor() -> list[Contender]:
    """MuJoCo's calls, and mink's wrappers of them: the floor of all times."""
    return [
        Contender("floor:mujoco", Variant.OTHER, _mujoco),
        Contender("floor:mink", Variant.OTHER, _mink),
    ]


def _mujoco(problem: Problem) -> Callable[[], StepOf]:
    model, q = problem.model, problem.q
    sites = [model.site(frame.site).id for frame in problem.frames]

    def make() -> StepOf:
        data = mujoco.MjData(model)
        linear, angular = np.empty((3, model.nv)), np.empty((3, model.nv))

        def step(k: int) -> None:
            data.qpos[:] = q[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for site in sites:
                mujoco.mj_jacSite(model, data, linear, angular, site)

        return step

    return make


def _mink(problem: Problem) -> Callable[[], StepOf]:
    def make() -> StepOf:
        configuration = mink.Configuration(problem.model)

        def step(k: int) -> None:
            configuration.update(problem.q[k])

        return step

    return make


# ---------------------------------------------------------------- this package's steps


def own_steps() -> list[Contender]:
    """Every installed backend, the usual ones that are missing, and the drop-in for mink's."""
    solvers = dict.fromkeys([*EXPECTED, *installed_solvers()])
    return [
        *(_controller(solver, "joint") for solver in solvers),
        *(_controller(solver, "twist") for solver in ("daqp", COMPILED)),
        Contender("solve_ik:daqp", Variant.COMMON, _drop_in, applies=one_level),
    ]


def _controller(solver: str, space: Literal["joint", "twist"]) -> Contender:
    suffix = "" if space == "joint" else ":twist"
    return Contender(
        f"step:{solver}{suffix}",
        Variant.COMMON if space == "joint" else Variant.OTHER,
        partial(own_step, solver, space),
        partial(_missing, solver),
    )


def _missing(solver: str) -> str | None:
    try:
        check_solver(solver)
    except UnknownSolver as error:
        return str(error)
    return None


class HalfSpaces(mink.Limit):
    """G q̇ ≤ g as a mink limit, on the displacement of the step.

    Attributes:
        ends: g of the next step, rad/s, (m,).
    """

    def __init__(self, rows: Array) -> None:
        self.rows = rows
        self.ends = np.zeros(len(rows))

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """G Δq ≤ g dt."""
        return mink.Constraint(self.rows, self.ends * dt)


def half_spaces(problem: Problem) -> list[HalfSpaces]:
    """The inequality rows, if there are any."""
    return [HalfSpaces(problem.half_spaces)] if len(problem.half_spaces) else []


def own_step(
    solver: str, space: Literal["joint", "twist"], problem: Problem
) -> Callable[[], SplitStep]:
    """``Controller.step`` with this package's own limits and secondary."""
    targets = problem.targets

    def make() -> SplitStep:
        tasks = [TwistTask(frame.site, "site", frame.projector) for frame in problem.frames]
        rows = half_spaces(problem)
        levels: Any = [[tasks[i] for i in level] for level in problem.levels] or None
        controller = Controller(
            problem.model,
            () if levels else tasks,
            levels=levels,
            secondary=[PostureReference(problem.model, problem.middle, gain=problem.gain)],
            secondary_space=space,
            limits=[MotionLimit(problem.model, velocity=problem.speeds, acceleration=None), *rows],
            solver=solver,
        )
        configuration = mink.Configuration(problem.model)

        def before(k: int) -> mink.Configuration:
            configuration.update(problem.q[k])
            for task, target in zip(tasks, targets[k], strict=True):
                task.set_target(target)
            for limit in rows:
                limit.ends = problem.ends[k]
            return configuration

        return SplitStep(before, lambda configuration: controller.step(configuration, DT).velocity)

    return make


# ---------------------------------------------------------------- other libraries' steps


def peer_steps() -> list[Contender]:
    """mink's, pink's and PlaCo's; costs and damping of soft tasks are those of their examples."""
    # In PlaCo the scale is a soft cost of fixed weight 1: a posture of cost 1 reduces the scale
    # even where the whole task is feasible. With 1e-2 the task is met to 2e-7, and PlaCo's
    # regularisation of 1e-8 is still small.
    costs = {"hard": 1.0, "soft": 1e-3, "scaled": 1e-2}
    return [
        Contender("mink:hard", Variant.COMMON, mink_step, applies=one_level),
        Contender("mink:soft", Variant.OTHER, partial(mink_step, soft=True), applies=tool_axes),
        Contender("pink:soft", Variant.OTHER, pink_step, PINK, tool_axes),
        *(
            Contender(
                f"placo:{priority}",
                Variant.COMMON if priority == "hard" else Variant.OTHER,
                partial(placo_step, priority, cost),
                PLACO,
                tool_axes,
            )
            for priority, cost in costs.items()
        ),
    ]


def _drop_in(problem: Problem) -> Callable[[], SplitStep]:
    return mink_step(problem, solve=solve_ik)


def mink_step(
    problem: Problem,
    *,
    soft: bool = False,
    solver: str = "daqp",
    solve: Callable[..., Any] = mink.solve_ik,
    **settings: Any,
) -> Callable[[], SplitStep]:
    """``mink.solve_ik``, or a function with its arguments.

    The frames are constraints with the posture as the only cost, or ``soft`` costs beside it. A
    limit gain below 1 would stop before the ends of the ranges.
    """
    model = problem.model
    names = [model.joint(dof).name for dof in range(model.nv)]

    def make() -> SplitStep:
        configuration = mink.Configuration(model)
        posture = mink.PostureTask(model, cost=1e-2 if soft else 1.0, gain=problem.gain)
        posture.set_target(problem.middle)
        tasks: list[Any] = [
            mink.FrameTask(frame.site, "site", 1.0, (1.0, 1.0, 0.0), lm_damping=1.0)
            if soft
            else TwistTask(frame.site, "site", frame.projector)
            for frame in problem.frames
        ]
        rows = half_spaces(problem)
        limits = [
            mink.ConfigurationLimit(model, gain=1.0),
            mink.VelocityLimit(model, dict(zip(names, problem.speeds, strict=True))),
            *rows,
        ]
        costs = [*tasks, posture] if soft else [posture]
        constraints = None if soft else tasks

        def before(k: int) -> None:
            configuration.update(problem.q[k])
            for task, target in zip(tasks, problem.targets[k], strict=True):
                task.set_target(target)
            for limit in rows:
                limit.ends = problem.ends[k]

        def call(_: None) -> Array:
            velocity: Array = solve(
                configuration, costs, DT, solver, limits=limits, constraints=constraints,
                **settings,
            )  # fmt: skip
            return velocity

        return SplitStep(before, call)

    return make


def _needs(*modules: str, package: str) -> Callable[[], str | None]:
    def missing() -> str | None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # pinocchio's import warns about its own parts
                for name in modules:
                    importlib.import_module(name)
        except ImportError as error:
            return f"{error}; install it: pip install {package}."
        return None

    return missing


PINK = _needs("pinocchio", "pink", package="pin-pink")
PLACO = _needs("placo", package="placo")


def pink_step(problem: Problem) -> Callable[[], StepOf]:
    """``pink.solve_ik``, the frames as costs; it reads the robot from URDF.

    Not as constraints: those have all six rows of a frame task, so the roll would not be free.
    """
    import pink
    import pinocchio

    model = pinocchio.buildModelFromXML(_urdf(problem))
    names = [problem.model.joint(dof).name for dof in range(problem.model.nv)]
    order = [names.index(name) for name in list(model.names)[1:]]  # a tree's joints by name
    back = np.argsort(order)
    q, middle = problem.q[:, order], problem.middle[order]
    goals = [
        [pinocchio.SE3(pose.rotation().as_matrix(), pose.translation()) for pose in targets]
        for targets in problem.targets
    ]

    def make() -> StepOf:
        robot = pink.Configuration(model, model.createData(), middle)
        tasks = [
            pink.FrameTask(
                link_name(number), position_cost=1.0, orientation_cost=(1.0, 1.0, 0.0),
                lm_damping=1.0,
            )
            for number in range(len(problem.frames))
        ]  # fmt: skip
        posture = pink.PostureTask(cost=1e-3, gain=problem.gain)
        posture.set_target(middle)
        limits = [
            pink.limits.ConfigurationLimit(model, config_limit_gain=1.0),
            pink.limits.VelocityLimit(model),
        ]

        def step(k: int) -> Array:
            robot.update(q[k])
            for task, goal in zip(tasks, goals[k], strict=True):
                task.set_target(goal)
            # Outside a range it warns instead of raising.
            velocity: Array = pink.solve_ik(
                robot, [*tasks, posture], DT, "daqp", limits=limits, safety_break=False
            )
            return velocity[back]

        return step

    return make


def placo_step(priority: str, cost: float, problem: Problem) -> Callable[[], StepOf]:
    """``placo.KinematicsSolver``, the frames at any priority; it reads the robot from URDF.

    It has its own QP solver. An infeasible hard task raises. A weight is a squared cost.
    """
    import placo

    robot = placo.RobotWrapper("", placo.Flags.ignore_collisions, _urdf(problem))
    names = [problem.model.joint(dof).name for dof in range(problem.model.nv)]
    goals = [
        [(pose.translation(), pose.rotation().as_matrix()[:, 2]) for pose in targets]
        for targets in problem.targets
    ]
    ends = problem.q + problem.gain * (problem.middle - problem.q)
    postures = [dict(zip(names, end, strict=True)) for end in ends.tolist()]

    def make() -> StepOf:
        solver = placo.KinematicsSolver(robot)
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        solver.dt = DT
        tasks = []
        z = np.array([0.0, 0.0, 1.0])
        for number in range(len(problem.frames)):
            link = link_name(number)
            place = solver.add_position_task(link, np.zeros(3))
            place.configure(f"position of {link}", priority, 1.0)
            axis = solver.add_axisalign_task(link, z, z)
            axis.configure(f"axis of {link}", priority, 1.0)
            tasks.append((place, axis))
        posture = solver.add_joints_task()
        posture.set_joints(postures[0])
        posture.configure("posture", "soft", cost**2)
        state = robot.state.q.copy()
        at = np.array([robot.get_joint_offset(name) for name in names])
        rates = np.array([robot.get_joint_v_offset(name) for name in names])

        def step(k: int) -> Array:
            state[at] = problem.q[k]
            robot.state.q = state
            robot.update_kinematics()
            for (place, axis), (position, direction) in zip(tasks, goals[k], strict=True):
                place.target_world = position
                axis.targetAxis_world = direction
            posture.set_joints(postures[k])
            velocity: Array = solver.solve(True)[rates] / DT
            return velocity

        return step

    return make


def _urdf(problem: Problem) -> str:
    return robot_urdf(problem.model, [frame.site for frame in problem.frames], problem.speeds)


# ---------------------------------------------------------------- the closed forms

Formula = Callable[[Array, TwistProjector, Array, Array], Array]
"""J (6, n), T in world axes, Δt (6,), h (n,) → Δθ (n,)."""

_FORMULAS: dict[str, tuple[Variant, Formula]] = {
    "minimum_norm": (Variant.SHORTEST, lambda J, T, dt, h: minimum_norm(J, T, dt)),
    "gradient_projection": (Variant.UNLIMITED, gradient_projection),
    "rmr": (Variant.OTHER, lambda J, T, dt, h: resolved_motion_rate(J, dt)),
    "twa": (Variant.OTHER, twa),
}


def closed_form_contenders() -> list[Contender]:
    """Each formula on arrays, once for every arm of the robot; kinematics not included.

    Resolved motion rate receives the whole twist to the target, the others its projection by T.
    """
    return [
        Contender(
            f"closed:{name}",
            variant,
            partial(_closed_form, formula, name == "rmr"),
            applies=tool_axes,
        )
        for name, (variant, formula) in _FORMULAS.items()
    ]


def _closed_form(formula: Formula, whole: bool, problem: Problem) -> Callable[[], StepOf]:
    cases = [_arrays(problem, k, whole) for k in range(len(problem.q) - 1)]
    nv = problem.model.nv

    def make() -> StepOf:
        velocity = np.zeros(nv)

        def step(k: int) -> Array:
            for dofs, J, T, error, h in cases[k]:
                velocity[dofs] = formula(J, T, error, h) / DT
            return velocity

        return step

    return make


def _arrays(
    problem: Problem, k: int, whole: bool
) -> list[tuple[Indices, Array, TwistProjector, Array, Array]]:
    """Joints, J, T, Δt and h of each arm; arms that share a joint have no closed form here."""
    found = []
    h = problem.gain * (problem.middle - problem.q[k])
    for frame, target, R, p, J in zip(
        problem.frames, problem.targets[k], *problem.jacobians(k), strict=True
    ):
        R_d = target.rotation().as_matrix()
        dofs = np.flatnonzero(np.abs(J).max(axis=0) > 0.0)
        T = frame.projector.resolved(body=R, target=R_d)
        turned = turn_error(Projector.full() if whole else frame.projector.angular, R, R_d)
        error = np.concatenate([target.translation() - p, turned])
        found.append((dofs, J[:, dofs], T, error, h[dofs]))
    return found
