"""Elastic tasks, of the mink after 1.3, by classes that have what it adds.

The oracle are the multipliers of the program posed by hand: min f(Δq) + Σ ρᵢ|wᵢΔq − eᵢ| is convex,
so that Δq is optimal if and only if some ν, |νᵢ| ≤ ρᵢ, νᵢ = ±ρᵢ where a row is missed, balances the
gradient of f with multipliers of the limits that are touched.
"""

from functools import partial
from typing import Any

import mink
import numpy as np
import pytest
import qpsolvers
from oracles.arms import seven_axes
from scipy.optimize import linprog, lsq_linear
from scipy.sparse import csc_matrix

import qp_twist as qt

DT = 0.01
ARM = seven_axes()
LIMITS = [
    mink.ConfigurationLimit(ARM),
    mink.VelocityLimit(ARM, {f"a{i + 1}": 2.0 for i in range(7)}),
]
SOFTER = [1e3, 1e3, 1e3, 1.0, 1.0, 1.0]


class Elastic(mink.FrameTask):
    """A task that is elastic itself: the price is on its weighted rows."""

    elastic = True

    def __init__(self, penalty: Any = 1e3, **costs: Any) -> None:
        super().__init__(
            "tool", "site", **({"position_cost": 2.0, "orientation_cost": 0.5} | costs)
        )
        self.penalty = penalty


class Around:
    """``mink.Elastic``, around a task: the price is on its plain rows, 0 for none."""

    def __init__(self, task: mink.Task, penalty: Any = 1e3) -> None:
        self.task, self.penalty = task, penalty

    def compute_penalized_rows(self, c: mink.Configuration) -> tuple[Any, Any, Any]:
        J, e = self.task.compute_jacobian(c), self.task.gain * self.task.compute_error(c)
        rho = np.broadcast_to(self.penalty, e.shape)
        return J, e, rho


class Case:
    """A seven-axis arm somewhere, its posture, and a target at a distance, m and rad."""

    def __init__(self, seed: int, far: float) -> None:
        rng = np.random.default_rng(seed)
        self.c = mink.Configuration(ARM, rng.uniform(-1.5, 1.5, 7))
        self.posture = mink.PostureTask(ARM, cost=0.1)
        self.posture.set_target(rng.uniform(-1.0, 1.0, 7))
        turn = mink.SO3.exp(rng.normal(size=3) * far)
        by = mink.SE3.from_rotation_and_translation(turn, rng.normal(size=3) * far)
        self.target = self.c.get_transform_frame_to_world("tool", "site") @ by

    def aimed(self, task: Any) -> Any:
        task.set_target(self.target)
        return task


def unexplained(case: Case, task: Any, velocity: Any, hard: Any = None) -> float:
    """What no multipliers explain of the gradient at Δq, as a share of 1 + its largest entry."""
    x = velocity * DT
    problem = mink.build_ik(case.c, [case.posture], DT, limits=LIMITS)
    if isinstance(task, Around):
        W, e, rho = task.compute_penalized_rows(case.c)
        e = -e
    else:
        W, e, _ = task.compute_qp_residual(case.c)
        rho = np.broadcast_to(task.penalty, len(e))
    missed = W @ x - e
    assert (problem.h - problem.G @ x).min() > -1e-9
    active = problem.G[problem.h - problem.G @ x < 1e-8]
    lower = np.where(missed > 1e-8, rho, -rho) * (1.0 - 1e-6) - 1e-9
    upper = np.where(missed < -1e-8, -rho, rho) * (1.0 - 1e-6) + 1e-9
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    equal = np.zeros((0, 7)) if hard is None else hard.compute_jacobian(case.c)
    free = np.full(len(equal), np.inf)
    gradient = problem.P @ x + problem.q
    lower = np.r_[lower, np.zeros(len(active)), -free]
    upper = np.r_[upper, np.full(len(active), np.inf), free]
    found = lsq_linear(np.vstack([W, active, equal]).T, -gradient, (lower, upper), tol=1e-14)
    return float(np.abs(found.fun).max() / (1.0 + np.abs(gradient).max()))


@pytest.mark.parametrize("penalty", [1e3, 1.0, 1e-3, SOFTER], ids=str)
@pytest.mark.parametrize("far", [0.003, 0.5])
def test_the_step_is_the_optimum_of_the_program_posed_by_hand(far: float, penalty: Any) -> None:
    for seed in range(6):
        case = Case(seed, far)
        for task in (case.aimed(Elastic(penalty)), Around(case.aimed(Elastic()), penalty)):
            given: dict[str, Any] = {"tasks": [case.posture, task]}
            if isinstance(task, Around):
                task.task.elastic = False
                given = {"tasks": [case.posture], "constraints": [task]}
            fast = qt.ik_step(case.c, dt=DT, solver="daqp", limits=LIMITS, **given)
            read = qt.ik_step(
                case.c, dt=DT, solver="daqp", limits=LIMITS, **given, primal_tol=1e-11
            )
            assert (fast.solver, read.solver) == ("compiled", "daqp")
            assert np.abs(fast.velocity - read.velocity).max() < 1e-6
            assert unexplained(case, task, fast.velocity) < 1e-7, seed
            assert {limit.kind for limit in fast.binding} <= {"velocity", "position"}
            if isinstance(task, Elastic):
                for solver in (None, "daqp"):
                    controller = qt.Controller(
                        ARM, [case.posture, task], limits=LIMITS, solver=solver
                    )
                    controller.joint_weight = 1e-12
                    step = controller.step(case.c, DT)
                    assert np.abs(step.velocity - fast.velocity).max() < 1e-5, solver


@pytest.mark.parametrize("solver", ["compiled", "daqp", "clarabel", "quadprog"])
def test_what_is_in_reach_is_met_as_a_constraint_and_what_is_not_at_the_least_price(
    solver: str,
) -> None:
    case = Case(1, 0.003)
    task = case.aimed(Elastic(1e4))
    step = qt.ik_step(case.c, [case.posture, task], DT, solver, limits=LIMITS)
    task.elastic = False
    hard = mink.solve_ik(case.c, [case.posture], DT, "daqp", limits=LIMITS, constraints=[task])
    assert np.abs(step.velocity - hard).max() < 1e-7
    assert step.status is qt.Status.SOLVED

    case = Case(2, 0.5)
    task = case.aimed(Elastic(1e4))
    velocity = qt.ik_step(case.c, [case.posture, task], DT, solver, limits=LIMITS).velocity
    W, e, _ = task.compute_qp_residual(case.c)
    problem = mink.build_ik(case.c, [], DT, limits=LIMITS)
    G = np.vstack([np.hstack([W, -np.eye(6)]), np.hstack([-W, -np.eye(6)])])
    G = np.vstack([np.hstack([problem.G, np.zeros((len(problem.h), 6))]), G])
    least = linprog(np.r_[np.zeros(7), np.ones(6)], G, np.r_[problem.h, e, -e], bounds=(None, None))
    assert least.fun > 0.1
    assert np.abs(W @ velocity * DT - e).sum() == pytest.approx(least.fun, rel=1e-6)


def test_a_row_is_held_from_the_price_on_that_the_constraint_is_worth() -> None:
    case = Case(3, 0.003)
    costs = {"position_cost": 1.0, "orientation_cost": 1.0}
    hard = case.aimed(mink.FrameTask("tool", "site", **costs))
    x = DT * mink.solve_ik(case.c, [case.posture], DT, "daqp", limits=[], constraints=[hard])
    problem = mink.build_ik(case.c, [case.posture], DT, limits=[])
    J, e = hard.compute_jacobian(case.c), hard.compute_error(case.c)
    worth = np.abs(np.linalg.lstsq(J.T, problem.P @ x + problem.q, rcond=None)[0]).max()
    for share in (1.01, 0.99):
        task = case.aimed(Elastic(share * worth, **costs))
        step = qt.solve_ik(case.c, [case.posture, task], DT, "daqp", limits=[])
        assert (np.abs(J @ step * DT + e).max() > 1e-6) == (share < 1.0)


def test_rows_without_cost_or_price_are_free() -> None:
    """The roll about the tool axis, in three ways."""
    case = Case(4, 0.001)
    roll = case.aimed(Elastic(1e4, orientation_cost=[1.0, 1.0, 0.0]))
    step = qt.solve_ik(case.c, [case.posture, roll], DT, "daqp", limits=LIMITS)
    missed = roll.compute_jacobian(case.c) @ step * DT + roll.compute_error(case.c)
    assert np.abs(missed[:5]).max() < 1e-9
    assert abs(missed[5]) > 1e-4
    free = qt.TwistTask.axis_free("tool", "site")
    free.set_target(case.target, twist=[0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    plain = case.aimed(mink.FrameTask("tool", "site", 1.0, 1.0))
    for around, held in ((Around(free, 1e4), free), (Around(plain, [1e4] * 5 + [0.0]), plain)):
        step = qt.solve_ik(case.c, [case.posture], DT, "daqp", limits=LIMITS, constraints=[around])
        J, e = held.compute_jacobian(case.c), held.compute_error(case.c)
        assert np.abs((J @ step * DT + e)[:5]).max() < 1e-9


@pytest.mark.parametrize("on_infeasible", ["scale", "relax"])
def test_constraints_that_do_not_fit_come_before_elastic_rows(on_infeasible: Any) -> None:
    case = Case(5, 0.5)
    point = qt.TwistTask.point("tool", "site")
    point.set_target(case.target)
    task = case.aimed(Elastic(1e4, position_cost=0.0))
    given: dict[str, Any] = {
        "limits": LIMITS,
        "constraints": [point],
        "on_infeasible": on_infeasible,
    }
    alone = qt.ik_step(case.c, [case.posture], DT, "daqp", **given)
    step = qt.ik_step(case.c, [case.posture, task], DT, "daqp", **given)
    assert step.status is alone.status is not qt.Status.SOLVED
    assert step.scale == pytest.approx(alone.scale, abs=2e-8)
    assert np.abs(step.residuals[0] - alone.residuals[0]).max() < 1e-6
    if on_infeasible == "scale":
        assert np.abs(step.residuals[0]).max() < 1e-8
        assert unexplained(case, task, step.velocity, point) < 1e-5


def excess(case: Case, task: Any, step: Any, hard: Any) -> float:
    """By what share it costs more than clarabel's step with the same motion of the hard task."""
    W, e, _ = task.compute_qp_residual(case.c)
    program = mink.build_ik(case.c, [case.posture], DT, limits=LIMITS)
    none, some = np.zeros((len(program.h), 6)), np.eye(6)
    J = hard.compute_jacobian(case.c)
    found = qpsolvers.solve_qp(
        csc_matrix(np.pad(program.P, (0, 6))), np.r_[program.q, task.penalty],
        csc_matrix(np.block([[program.G, none], [W, -some], [-W, -some]])),
        np.r_[program.h, e, -e], csc_matrix(np.pad(J, ((0, 0), (0, 6)))),
        DT * J @ step.velocity, solver="clarabel",
    )  # fmt: skip
    costs = [
        0.5 * x @ program.P @ x + program.q @ x + task.penalty @ np.abs(W @ x - e)
        for x in (step.velocity * DT, found[:7])
    ]
    return float((costs[0] - costs[1]) / abs(costs[1]))


@pytest.mark.parametrize("price", [1.0, 1e3, 1e7])
def test_the_levels_achieve_exactly_what_they_do_without_elastic_rows(price: float) -> None:
    """At full speed, scaled, relaxed and near a singularity, of solve_ik and of controllers."""
    seen, moved = list[qt.Status](), list[float]()
    for seed in range(24):
        case, rng = Case(seed, 10.0 ** -(seed % 4)), np.random.default_rng(seed)
        case.c.update(rng.uniform(-1.5, 1.5, 7) * (seed % 5 > 0))
        hard: Any = (qt.TwistTask.point, qt.TwistTask.axis_free)[seed % 2]("tool", "site")
        hard.set_target(case.target)
        task = case.aimed(Elastic(price * np.array(SOFTER) / 1e3))
        levels = [[hard], [case.aimed(mink.FrameTask("tool", "site", 0.0, 1.0))]]
        pairs, how = [], "relax" if seed % 3 == 0 else "scale"
        for tasks in ([case.posture], [case.posture, task]):
            given: dict[str, Any] = {"limits": LIMITS, "constraints": [hard], "on_infeasible": how}
            steps = [qt.ik_step(case.c, tasks, DT, "daqp", **given)]
            for solver in (None, "daqp"):
                for first in ({"tasks": [hard, *tasks]}, {"tasks": tasks, "levels": levels}):
                    given = {"on_infeasible": how, "solver": solver, "limits": [
                        qt.PositionLimit(ARM),
                        qt.MotionLimit(ARM, velocity=2.0, acceleration=50.0),
                    ]}  # fmt: skip
                    steps.append(qt.Controller(ARM, **first, **given).step(case.c, DT))
            pairs.append(steps)
        for alone, step in zip(*pairs, strict=True):
            assert step.status is alone.status, seed
            assert step.scale == pytest.approx(alone.scale, abs=1e-9)
            for ours, theirs in zip(step.residuals, alone.residuals, strict=True):
                assert ours == pytest.approx(theirs, abs=1e-7)
            seen.append(step.status)
            moved.append(float(np.abs(step.velocity - alone.velocity).max()))
        if price <= 1e3:  # beyond, clarabel makes insufficient progress
            assert excess(case, task, pairs[1][0], hard) < 1e-7
    assert set(seen) == set(qt.Status)
    assert sum(np.array(moved) > 1e-3) > 30


@pytest.mark.parametrize("far", [0.01, 0.5])
def test_a_controllers_task_comes_first_and_both_statements_agree(far: float) -> None:
    gains = []
    for seed in range(4):
        case, steps = Case(seed, far), []
        point = qt.TwistTask.point("tool", "site")
        point.set_target(case.target)
        task = case.aimed(Elastic(SOFTER, position_cost=0.0))
        for tasks, solver in (
            ([point, case.posture, task], None), ([point, case.posture, task], "daqp"),
            ([point, case.posture], None),
        ):  # fmt: skip
            limits = [qt.PositionLimit(ARM), qt.MotionLimit(ARM, velocity=2.0, acceleration=50.0)]
            controller = qt.Controller(ARM, tasks, limits=limits, solver=solver)
            steps.append(controller.step(case.c, DT))
        compiled, read, alone = steps
        assert np.abs(compiled.velocity - read.velocity).max() < 1e-6
        assert compiled.status is read.status is alone.status
        assert compiled.scale == pytest.approx(alone.scale, abs=1e-9)
        assert compiled.residuals[0] == pytest.approx(alone.residuals[0], abs=1e-6)
        W, e, _ = task.compute_qp_residual(case.c)
        miss = [np.abs(W @ step.velocity * DT - e).sum() for step in (compiled, alone)]
        gains.append(miss[1] - miss[0])
    assert min(gains) > -1e-9
    assert max(gains) > 1e-4


def test_the_program_names_the_rows_and_keeps_to_the_limits_far_out_of_reach() -> None:
    case = Case(6, 0.01)
    task = case.aimed(Elastic(SOFTER))
    named = qt.Controller(ARM, [case.posture, task], limits=LIMITS).build_ik(case.c, DT)
    rows = [f"Elastic('tool', 'site') row {i + 1} (elastic)" for i in range(6) for _ in range(2)]
    assert list(named.inequalities) == rows
    assert named.unknowns[7:] == tuple(f"slack {i + 1}" for i in range(6))
    for far in (0.1, 2.0):
        case.c.update(np.full(7, 0.4))
        pose = case.c.get_transform_frame_to_world("tool", "site")
        task.set_target(pose @ mink.SE3.from_translation(np.array([-far / 2, 0.0, -far / 2])))
        for _ in range(60):
            velocity = qt.solve_ik(case.c, [case.posture, task], DT, "daqp", limits=LIMITS)
            assert np.abs(velocity).max() <= 2.0 + 1e-9
            case.c.integrate_inplace(velocity, DT)
        error = np.linalg.norm(task.compute_error(case.c))
        assert error < 1e-6 if far == 0.1 else error > 0.5


def test_elastic_rows_alone_need_no_other_cost() -> None:
    case = Case(7, 0.001)
    task = case.aimed(Elastic())
    velocity = qt.solve_ik(case.c, [task], DT, "daqp", limits=LIMITS)
    W, e, _ = task.compute_qp_residual(case.c)
    assert np.abs(W @ velocity * DT - e).max() < 1e-9


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "damped": ({"lm_damping": 1.0}, r"Elastic\('tool', 'site'\) is elastic: set its lm_damping"),
    "no price": ({"penalty": None}, "its penalty: expected a number above 0, .* got None"),
    "perhaps": ({"elastic": np.array([True, False])}, "elastic: expected True or False"),
    "negative": ({"penalty": -1.0}, "its penalty: expected numbers above 0"),
    "zero": ({"penalty": [1, 1, 1, 1, 1, 0]}, "its penalty: expected numbers above 0"),
    "too few": ({"penalty": [1.0, 2.0]}, "its penalty: "),
    "NaN": ({"penalty": np.nan}, "its penalty: "),
    "beyond numbers": ({"penalty": 1e300}, "its penalty: .* too large to compute with"),
    "cost": ({"cost": np.full(6, np.nan)}, "its rows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_elastic_task_is_refused_by_name(name: str) -> None:
    case = Case(8, 0.01)
    task = case.aimed(Elastic())
    given, message = REFUSED[name]
    task.__dict__.update(given)
    for refused in (
        lambda: qt.solve_ik(case.c, [case.posture, task], DT, "daqp"),
        lambda: qt.Controller(ARM, [case.posture, task]).step(case.c, DT),
    ):
        with pytest.raises(qt.InvalidInput, match=message):
            refused()


def test_an_elastic_task_is_no_constraint_and_in_no_level() -> None:
    case = Case(9, 0.01)
    task, dense = case.aimed(Elastic()), mink.KineticEnergyRegularizationTask(1.0)
    dense.set_dt(DT)
    dense.elastic = True  # type: ignore[attr-defined]
    twist = case.aimed(qt.TwistTask.point("tool", "site"))
    twist.elastic = True  # type: ignore[attr-defined]

    def solve(**given: Any) -> Any:
        return qt.solve_ik(case.c, dt=DT, solver="daqp", **({"tasks": []} | given))

    def stated(rows: Any) -> Any:
        around = Around(point)
        around.compute_penalized_rows = lambda c: rows  # type: ignore[method-assign]
        return solve(constraints=[around])

    point = case.aimed(qt.TwistTask.point("tool", "site"))
    for match, refused in (
        ("neither a constraint nor", lambda: solve(constraints=[task])),
        ("neither a constraint nor", lambda: qt.Controller(ARM, levels=[[task]])),
        ("neither a constraint nor", lambda: qt.Controller(ARM, [twist])),
        ("states no rows", lambda: solve(tasks=[dense])),
        ("the class Around", lambda: solve(constraints=[Around])),
        ("its penalty", lambda: solve(constraints=[Around(twist, np.inf)])),
        (
            "its penalty: expected numbers at least 0",
            lambda: solve(constraints=[Around(point, -1)]),
        ),
        *(
            (f"compute_penalized_rows: expected the rows J, .* got {what}", partial(stated, given))
            for what, given in (("None", None), ("int", 3), ("tuple of 2", (np.eye(7), np.ones(7))))
        ),
    ):
        with pytest.raises(qt.InvalidInput, match=match):
            refused()
