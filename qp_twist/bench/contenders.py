"""All who take part: the floor, this package's steps, other libraries' steps, the closed forms."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import mink
import mujoco
import numpy as np

from qp_twist.bench.contender import Contender, Parted, StepOf, one_level, tool_axes
from qp_twist.bench.problem import DT, Problem
from qp_twist.bench.program import Asked, turn_error
from qp_twist.checks import Array, Indices
from qp_twist.closed_form import gradient_projection, minimum_norm, resolved_motion_rate, twa
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, solve_ik
from qp_twist.errors import UnknownSolver
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import PostureReference, TwistTask
from qp_twist.peers import MinkPeer, Peer, PeerFrame, PinkPeer, PlacoPeer, Posed
from qp_twist.qp import check_solver, installed_solvers

EXPECTED = ("daqp", "proxqp", "osqp", "piqp", "quadprog", "clarabel", COMPILED)
"""Backends that are named where they are missing."""
_ALL = TwistProjector(linear=Projector.full(), angular=Projector.full())


def contenders() -> list[Contender]:
    """All that are known, installed or not."""
    return [*floor(), *own_steps(), *peer_steps(), *closed_forms()]


# ---------------------------------------------------------------- what everybody has to compute


def floor() -> list[Contender]:
    """MuJoCo's own calls, and mink's around them: the floor under all times."""
    return [
        Contender("floor:mujoco", Asked.OTHER, _mujoco),
        Contender("floor:mink", Asked.OTHER, _mink),
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
    """Every backend that is installed, the usual ones that are not, and the drop-in for mink's."""
    solvers = dict.fromkeys([*EXPECTED, *installed_solvers()])
    return [
        *(_controller(solver, "joint") for solver in solvers),
        *(_controller(solver, "twist") for solver in ("daqp", COMPILED)),
        Contender("solve_ik:daqp", Asked.COMMON, _drop_in, applies=one_level),
    ]


def _controller(solver: str, space: Literal["joint", "twist"]) -> Contender:
    suffix = "" if space == "joint" else ":twist"
    return Contender(
        f"step:{solver}{suffix}",
        Asked.COMMON if space == "joint" else Asked.OTHER,
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
    """G q̇ ≤ g as a limit of mink, which states it for the displacement of the step.

    Attributes:
        ends: g of the step that is next, rad/s, (m,).
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
) -> Callable[[], Parted]:
    """``Controller.step`` with this package's own limits and secondary."""
    targets = problem.targets

    def make() -> Parted:
        tasks = [TwistTask(frame.site, "site", frame.projector) for frame in problem.frames]
        rows = half_spaces(problem)
        levels: Any = [[tasks[i] for i in level] for level in problem.levels] or None
        controller = Controller(
            problem.model,
            () if levels else tasks,
            levels=levels,
            secondary=[PostureReference(problem.model, problem.middle, gain=problem.gain)],
            secondary_space=space,
            limits=[MotionLimit(problem.model, velocity=problem.speeds), *rows],
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

        return Parted(before, lambda configuration: controller.step(configuration, DT).velocity)

    return make


# ---------------------------------------------------------------- other libraries' steps


def peer_steps() -> list[Contender]:
    """mink's, pink's and PlaCo's; costs and damping of soft tasks are those of their examples."""
    mink_soft = partial(mink_step, partial(posed, costs=1e-2, damping=1.0, aligned=False))
    pink_soft = partial(_peer_step, PinkPeer, partial(posed, costs=1e-3, damping=1.0))
    # A scale is itself a soft cost, of weight 1, which PlaCo does not let anyone change: a posture
    # of cost 1 buys motion with it where the whole task fits. With 1e-2 the task is whole to 2e-7,
    # and PlaCo's own regularisation of 1e-8 is still small.
    placo = {"hard": 1.0, "soft": 1e-3, "scaled": 1e-2}
    return [
        Contender("mink:hard", Asked.COMMON, partial(mink_step, hard_posed), applies=one_level),
        Contender("mink:soft", Asked.OTHER, mink_soft, applies=tool_axes),
        Contender("pink:soft", Asked.OTHER, pink_soft, PinkPeer.missing, tool_axes),
        *(
            Contender(
                f"placo:{priority}",
                Asked.COMMON if priority == "hard" else Asked.OTHER,
                partial(_peer_step, PlacoPeer, partial(posed, priority=priority, costs=cost)),
                PlacoPeer.missing,
                tool_axes,
            )
            for priority, cost in placo.items()
        ),
    ]


def posed(problem: Problem, **how: Any) -> Posed:
    """A problem as other libraries are handed it: ranges to their ends, speeds, the posture.

    A gain below 1 of the limits would stop short of the ends of the ranges.
    """
    frames = tuple(PeerFrame(f.site, "site", f.projector, _ALL) for f in problem.frames)
    return Posed(
        problem.model, frames, problem.middle, speeds=problem.speeds, limit_gain=1.0, **how
    )


hard_posed: Callable[[Problem], Posed] = partial(posed, priority="hard", costs=1.0)
"""The frames as constraints, the posture as the only cost."""


def _drop_in(problem: Problem) -> Callable[[], Parted]:
    return mink_step(hard_posed, problem, solve_ik)


def mink_step(
    pose: Callable[[Problem], Posed],
    problem: Problem,
    solve: Callable[..., Any] = mink.solve_ik,
) -> Callable[[], Parted]:
    """``mink.solve_ik``, or what has its arguments."""
    peer = MinkPeer(pose(problem))
    goals = _goals(peer, problem)

    def make() -> Parted:
        step = peer.step()
        rows = half_spaces(problem)
        step.limits += rows
        step.solve = solve

        def before(k: int) -> None:
            step.update(problem.q[k])
            step.aim(goals[k])
            for limit in rows:
                limit.ends = problem.ends[k]

        return Parted(before, lambda _: step.velocity(DT))

    return make


def _peer_step(
    library: type[Peer], pose: Callable[[Problem], Posed], problem: Problem
) -> Callable[[], StepOf]:
    """A step of a library that has its own kinematics."""
    peer = library(pose(problem))
    states, goals = peer.state(problem.q), _goals(peer, problem)

    def make() -> StepOf:
        taken = peer.step()

        def step(k: int) -> Array:
            taken.update(states[k])
            taken.aim(goals[k])
            return taken.velocity(DT)

        return step

    return make


def _goals(peer: Peer, problem: Problem) -> list[list[Any]]:
    """Targets and posture of every step; the conversion is not timed."""
    return [
        peer.goals(q, targets, problem.gain)
        for q, targets in zip(problem.q[:-1], problem.targets, strict=True)
    ]


# ---------------------------------------------------------------- the closed forms

Formula = Callable[[Array, TwistProjector, Array, Array], Array]
"""J (6, n), T in world axes, Δt (6,), h (n,) → Δθ (n,)."""

_FORMULAS: dict[str, tuple[Asked, Formula]] = {
    "minimum_norm": (Asked.SHORTEST, lambda J, T, dt, h: minimum_norm(J, T, dt)),
    "gradient_projection": (Asked.UNLIMITED, gradient_projection),
    "rmr": (Asked.OTHER, lambda J, T, dt, h: resolved_motion_rate(J, dt)),
    "twa": (Asked.OTHER, twa),
}


def closed_forms() -> list[Contender]:
    """Each formula on arrays, once for every arm of the robot; the kinematics is given.

    Resolved motion rate is given the whole twist to the target, the others what T asks of it.
    """
    return [
        Contender(
            f"closed:{name}",
            asked,
            partial(_closed_form, formula, name == "rmr"),
            applies=tool_axes,
        )
        for name, (asked, formula) in _FORMULAS.items()
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
