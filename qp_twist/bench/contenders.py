"""The contenders: the floor, this package's steps, other libraries' steps, the closed forms."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import mink
import mujoco
import numpy as np

from qp_twist.bench.contender import Contender, SplitStep, StepOf, one_level, tool_axes
from qp_twist.bench.problem import DT, Problem
from qp_twist.bench.program import Variant, turn_error
from qp_twist.checks import Array, Indices
from qp_twist.closed_form import gradient_projection, minimum_norm, resolved_motion_rate, twa
from qp_twist.constraints import MotionLimit
from qp_twist.control import Controller, solve_ik
from qp_twist.errors import UnknownSolver
from qp_twist.geometry import Projector, TwistProjector
from qp_twist.kernel import COMPILED
from qp_twist.kinematics import PostureReference, TwistTask
from qp_twist.peers import MinkPeer, Peer, PeerFrame, PeerProblem, PinkPeer, PlacoPeer
from qp_twist.qp import check_solver, installed_solvers

EXPECTED = ("daqp", "proxqp", "osqp", "piqp", "quadprog", "clarabel", COMPILED)
"""Backends that are listed as missing if not installed."""
_ALL = TwistProjector(linear=Projector.full(), angular=Projector.full())


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
    mink_soft = partial(mink_step, partial(peer_problem, costs=1e-2, damping=1.0, aligned=False))
    pink_soft = partial(_peer_step, PinkPeer, partial(peer_problem, costs=1e-3, damping=1.0))
    # In PlaCo the scale is a soft cost of fixed weight 1: a posture of cost 1 reduces the scale
    # even where the whole task is feasible. With 1e-2 the task is met to 2e-7, and PlaCo's
    # regularisation of 1e-8 is still small.
    placo = {"hard": 1.0, "soft": 1e-3, "scaled": 1e-2}
    return [
        Contender("mink:hard", Variant.COMMON, partial(mink_step, hard_problem), applies=one_level),
        Contender("mink:soft", Variant.OTHER, mink_soft, applies=tool_axes),
        Contender("pink:soft", Variant.OTHER, pink_soft, PinkPeer.missing, tool_axes),
        *(
            Contender(
                f"placo:{priority}",
                Variant.COMMON if priority == "hard" else Variant.OTHER,
                partial(
                    _peer_step, PlacoPeer, partial(peer_problem, priority=priority, costs=cost)
                ),
                PlacoPeer.missing,
                tool_axes,
            )
            for priority, cost in placo.items()
        ),
    ]


def peer_problem(problem: Problem, **how: Any) -> PeerProblem:
    """A problem for other libraries: full joint ranges, speed limits, the posture.

    A limit gain below 1 would stop before the ends of the ranges.
    """
    frames = tuple(PeerFrame(f.site, "site", f.projector, _ALL) for f in problem.frames)
    return PeerProblem(
        problem.model, frames, problem.middle, speeds=problem.speeds, limit_gain=1.0, **how
    )


hard_problem: Callable[[Problem], PeerProblem] = partial(peer_problem, priority="hard", costs=1.0)
"""The frames as constraints, the posture as the only cost."""


def _drop_in(problem: Problem) -> Callable[[], SplitStep]:
    return mink_step(hard_problem, problem, solve_ik)


def mink_step(
    pose: Callable[[Problem], PeerProblem],
    problem: Problem,
    solve: Callable[..., Any] = mink.solve_ik,
) -> Callable[[], SplitStep]:
    """``mink.solve_ik``, or a function with its arguments."""
    peer = MinkPeer(pose(problem))
    goals = _goals(peer, problem)

    def make() -> SplitStep:
        step = peer.step()
        rows = half_spaces(problem)
        step.limits += rows
        step.solve = solve

        def before(k: int) -> None:
            step.update(problem.q[k])
            step.aim(goals[k])
            for limit in rows:
                limit.ends = problem.ends[k]

        return SplitStep(before, lambda _: step.velocity(DT))

    return make


def _peer_step(
    library: type[Peer], pose: Callable[[Problem], PeerProblem], problem: Problem
) -> Callable[[], StepOf]:
    """A step of a library with its own kinematics."""
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
