"""``qt.solve_ik``: mink's meaning while the step is feasible, a verified one where it is not."""

import inspect
import logging
from typing import Any

import mink
import numpy as np
import pytest
import qpsolvers
from oracles import mink_problems
from oracles.twists import at, site
from scipy.optimize import linprog, lsq_linear

import qp_twist as qt

pytestmark = [
    pytest.mark.filterwarnings("ignore::qpsolvers.warnings.SparseConversionWarning"),
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),  # of OSQP's own interface
]
DT = 0.01
PLANAR = qt.load_task("planar_line").model


def solve(problem: mink_problems.Problem, solver: str = "daqp", **options: object) -> qt.Step:
    return qt.ik_step(
        problem.configuration, problem.tasks, problem.dt, solver,
        limits=problem.limits, constraints=problem.constraints, **options,
    )  # type: ignore[arg-type]  # fmt: skip


def test_the_signature_is_minks_with_keywords_of_ours_behind() -> None:
    theirs = inspect.signature(mink.solve_ik).parameters
    ours = inspect.signature(qt.solve_ik).parameters
    positional = [p for p in ours.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    expected = [p for p in theirs.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert [(p.name, p.default) for p in positional] == [(p.name, p.default) for p in expected]
    added = set(ours) - set(theirs)
    assert all(ours[name].kind is inspect.Parameter.KEYWORD_ONLY for name in added)
    assert ours["kwargs"].kind is inspect.Parameter.VAR_KEYWORD


@pytest.mark.parametrize("seed", range(2))
def test_while_feasible_the_optimum_is_minks(seed: int) -> None:
    binding: set[str] = set()
    for name, problem in mink_problems.named(seed).items():
        step = solve(problem)
        found = mink_problems.difference(problem, step.velocity)
        assert abs(found.value) < 1e-6, name
        assert found.excess < 1e-9, name
        assert step.status is qt.Status.SOLVED, name
        binding |= {limit.kind for limit in step.binding}
    assert binding == {"position", "velocity", "collision", "FreeJointVelocityLimit"}


@pytest.mark.parametrize("seed", range(40))
def test_what_does_not_fit_is_scaled_in_machine_code_as_by_a_backend(seed: int) -> None:
    """Options of a backend, here its default, have the backend solve the program."""
    rng = np.random.default_rng(seed)
    model = qt.load_task("deburring").model
    configuration = mink.Configuration(model, rng.uniform(*model.jnt_range.T))
    hand = qt.TwistTask.axis_free("tool", "site")
    there = configuration.get_transform_frame_to_world("tool", "site")
    hand.set_target(there @ mink.SE3.exp(10.0 ** rng.uniform(-3.0, 0.0) * rng.normal(size=6)))
    posture = mink.PostureTask(model, cost=1e-2)
    posture.set_target(np.zeros(model.nv))
    speeds = {model.joint(k).name: rng.uniform(0.2, 2.0) for k in range(model.njnt)}
    limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
    arguments: Any = (configuration, [posture], DT, "daqp")
    given: Any = {"limits": limits, "constraints": [hand]}
    velocity = qt.solve_ik(*arguments, **given)
    ours, theirs = qt.ik_step(*arguments, **given), qt.ik_step(*arguments, **given, iter_limit=1000)
    assert velocity.shape == (model.nv,)
    np.testing.assert_array_equal(velocity, ours.velocity)
    assert ours.scale == pytest.approx(theirs.scale, rel=1e-6, abs=1e-8)
    np.testing.assert_allclose(velocity, theirs.velocity, atol=1e-5)


@pytest.mark.parametrize("solver", ["proxqp", "osqp", "clarabel", "quadprog", "piqp"])
def test_with_any_backend(solver: str) -> None:
    if solver not in qpsolvers.available_solvers:
        pytest.skip(f"{solver} is not installed")
    problems = mink_problems.named(1)
    for name in ("all limits, constraints", "TwistTask in constraints", "CollisionAvoidanceLimit"):
        found = mink_problems.difference(problems[name], solve(problems[name], solver).velocity)
        assert abs(found.value) < 1e-6, name
        assert found.excess < 1e-8, name


# ---------------------------------------------------------------- where it is infeasible


def too_fast(speed: float = 0.1) -> mink_problems.Problem:
    """A constraint that asks for more than the arm's joints may do."""
    c = mink_problems.configuration(5)
    task = qt.TwistTask.axis_free("left_hand", "site")
    pose = site(c, "left_hand")
    task.set_target(at(0.03, -0.02, 0.02) @ pose)
    limit = mink.VelocityLimit(
        c.model,
        {f"{side}_{k}": speed for side in ("left", "right") for k in range(1, 8)}
        | {"cart_x": speed, "cart_y": speed, "cart_yaw": speed},
    )
    posture = mink.PostureTask(c.model, 0.1)
    posture.set_target(c.q)
    return mink_problems.Problem(c, [posture], [limit], [task])


def test_the_task_is_slowed_down_as_little_as_possible() -> None:
    problem = too_fast()
    stated = mink_problems.program(problem)
    args = problem.configuration, problem.tasks, problem.dt, "daqp"
    with pytest.raises(mink.NoSolutionFound):
        mink.solve_ik(*args, limits=problem.limits, constraints=problem.constraints)
    step = solve(problem)
    assert step.status is qt.Status.SCALED
    # The oracle: the largest s of mink's own rows, as a linear program in (Δq, s).
    n = stated.P.shape[0]
    largest = linprog(
        np.append(np.zeros(n), -1.0),
        np.hstack([stated.G, np.zeros((len(stated.h), 1))]), stated.h,
        np.hstack([stated.A, -stated.b[:, None]]), np.zeros(len(stated.b)),
        bounds=[(None, None)] * n + [(0.0, 1.0)],
    )  # fmt: skip
    assert step.scale == pytest.approx(largest.x[-1], abs=1e-7)
    assert 0.01 < step.scale < 0.9
    np.testing.assert_allclose(stated.A @ step.velocity * DT, step.scale * stated.b, atol=1e-10)
    assert (stated.G @ step.velocity * DT <= stated.h + 1e-10).all()
    assert {limit.kind for limit in step.binding} == {"velocity"}
    joints = {problem.configuration.model.joint(j).name for j in range(18)}
    assert {limit.joint for limit in step.binding} <= joints


def test_or_relaxed_to_the_closest() -> None:
    problem = too_fast()
    stated = mink_problems.program(problem)
    step = solve(problem, on_infeasible="relax")
    assert step.status is qt.Status.RELAXED
    moving = np.abs(stated.G).max(axis=0) > 0.0
    closest = lsq_linear(
        stated.A[:, moving] / DT, stated.b / DT,
        bounds=(-0.1 * DT, 0.1 * DT), tol=1e-14,
    )  # fmt: skip
    residual = np.linalg.norm(stated.A @ step.velocity - stated.b / DT)
    assert residual == pytest.approx(np.sqrt(2.0 * closest.cost), rel=1e-6)


def test_or_raised_as_minks_own_exception() -> None:
    problem = too_fast()
    with pytest.raises(mink.NoSolutionFound, match=r"binding: .*velocity limit") as caught:
        solve(problem, on_infeasible="raise")
    assert isinstance(caught.value, qt.InfeasibleStep)
    assert caught.value.binding


def test_rows_that_contradict_themselves_are_met_where_they_can_be() -> None:
    """AxisAlignTask has three rows of rank two, which mink cannot hold as a constraint."""
    c = mink_problems.configuration(3)
    rng = np.random.default_rng(0)
    task, posture = mink_problems.align(c, rng), mink_problems.posture(c, rng)
    with pytest.raises(mink.NoSolutionFound):
        mink.solve_ik(c, [posture], DT, "daqp", constraints=[task])
    assert np.linalg.norm(task.compute_error(c)) > 0.02
    for _ in range(20):
        step = qt.ik_step(c, [posture], DT, "daqp", constraints=[task])
        assert step.status in (qt.Status.SOLVED, qt.Status.DEGRADED, qt.Status.SCALED)
        c.integrate_inplace(step.velocity, DT)
    assert np.linalg.norm(task.compute_error(c)) < 1e-7


def test_outside_a_range_as_mink_does(caplog: pytest.LogCaptureFixture) -> None:
    problem = mink_problems.named(1)["FrameTask in tasks"]
    c = problem.configuration
    q = c.q.copy()
    q[c.model.joint("left_2").qposadr[0]] = 2.62
    c.update(q)
    with pytest.raises(mink.NotWithinConfigurationLimits):
        qt.solve_ik(c, problem.tasks, DT, "daqp", safety_break=True)
    with caplog.at_level(logging.DEBUG):
        velocity = qt.solve_ik(c, problem.tasks, DT, "daqp")
    assert "2.62" in caplog.text  # mink's own line
    np.testing.assert_allclose(velocity, mink.solve_ik(c, problem.tasks, DT, "daqp"), atol=1e-3)
    assert velocity[c.model.joint("left_2").dofadr[0]] < -1.8  # back in two steps


# ---------------------------------------------------------------- options and bad input


def test_options_reach_the_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, object]] = []
    honest = qpsolvers.solve_problem

    def listening(stated: qpsolvers.Problem, solver: str, **options: object) -> qpsolvers.Solution:
        seen.append(options)
        return honest(stated, solver=solver, **options)

    monkeypatch.setattr(qpsolvers, "solve_problem", listening)
    problem = mink_problems.named(1)["FrameTask in tasks"]
    # One iteration solves nothing, and no other backend is asked.
    with pytest.raises(qt.SolverInaccurate, match="osqp returned"):
        solve(problem, "osqp", max_iter=1)
    assert all(options["max_iter"] == 1 for options in seen)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tasks": "frame"}, "tasks is a list of mink tasks; got 'frame'"),
        ({"tasks": [1]}, r"tasks\[0\] is int, which is none of mink's tasks"),
        ({"limits": [qt.PositionLimit(PLANAR)]}, "PositionLimit is for a model of 3 degrees"),
        ({"limits": [mink.ConfigurationLimit(PLANAR)]}, "for a model of 3 degrees"),
        ({"limits": [mink.VelocityLimit(PLANAR, {"joint_1": 1.0})]}, "for a model of 3 degrees"),
        ({"tasks": [mink.PostureTask(PLANAR, 1.0)]}, "PostureTask is for a model of 3 degrees"),
        ({"constraints": [3]}, "constraints"),
        ({"limits": [None]}, "limits"),
        ({"dt": 0.0}, "dt"),
        ({"dt": float("nan")}, "dt"),
        ({"damping": -1.0}, "damping"),
        ({"solver": "magic"}, "not installed or not known"),
        ({"on_infeasible": "hope"}, "on_infeasible"),
        ({"singularity": 2.0}, "singularity"),
        ({"configuration": None}, "configuration"),
        ({"no_such_option": 1}, "does not take the options"),
    ],
)
def test_bad_input_is_a_sentence(change: dict[str, object], message: str) -> None:
    problem = mink_problems.named(1)["FrameTask in tasks"]
    arguments = {
        "configuration": problem.configuration, "tasks": problem.tasks, "dt": DT, "solver": "daqp",
    }  # fmt: skip
    with pytest.raises(qt.InvalidInput, match=message):
        qt.solve_ik(**(arguments | change))  # type: ignore[arg-type]


# ---------------------------------------------------------------- twist tasks under mink itself


def test_the_time_step_reaches_the_feed_forward() -> None:
    c = mink_problems.configuration(2)
    task = qt.TwistTask.point("left_hand", "site")
    task.set_target_from_configuration(c)
    assert task.target is not None
    task.set_target(task.target, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    velocity = qt.solve_ik(c, [], DT, "daqp", damping=1e-6, constraints=[task])
    moved = task.compute_jacobian(c) @ velocity
    np.testing.assert_allclose(moved, [0.1, 0.0, 0.0], atol=1e-9)


# ---------------------------------------------------------------- and in the controller


def test_the_controller_takes_all_of_minks_limits_and_keeps_loops_closed() -> None:
    """A cart with two arms, coupled fingers, a limited ball joint, a free joint, a closed loop."""
    c = mink_problems.configuration(2)
    model = c.model
    closed = mink.EqualityConstraintTask(model, cost=1.0)
    for _ in range(20):  # first the loop, which a random configuration leaves open
        c.integrate_inplace(mink.solve_ik(c, [closed], DT, "daqp", damping=1e-8), DT)
    assert np.abs(closed.compute_error(c)).max() < 1e-9
    weld = qt.TwistTask.axis_free("left_hand", "site", max_linear_step=0.004, gain=0.5)
    start = site(c, "left_hand")
    weld.set_target(at(-0.05, 0.03, 0.04) @ start)
    fly = mink_problems.drone(c, np.random.default_rng(0))
    turn = mink.PostureTask(model, cost=1e-2)
    turn.set_target(c.integrate(np.full(model.nv, 0.05), 1.0))
    limits = [make(c) for make in mink_problems.LIMITS.values()]
    controller = qt.Controller(model, [turn, fly], levels=[[closed], [weld]], limits=limits)
    kinds: set[str] = set()
    for _ in range(60):
        step = controller.step(c, DT)
        for limit in limits:
            rows = limit.compute_qp_inequalities(c, DT)
            assert rows.G is not None
            assert (rows.G @ step.velocity * DT <= rows.h + 1e-9).all()
        kinds |= {limit.kind for limit in step.binding}
        c.integrate_inplace(step.velocity, DT)
        assert np.abs(closed.compute_error(c)).max() < 1e-5
    assert np.linalg.norm(weld.state(c).error) < 1e-6
    assert kinds >= {"velocity", "FreeJointVelocityLimit"}


def test_a_misspelt_keyword_is_refused_with_the_one_that_is_meant() -> None:
    configuration = mink.Configuration(PLANAR)
    with pytest.raises(qt.InvalidInput, match="did you mean 'on_infeasible'"):
        qt.solve_ik(configuration, [], DT, "daqp", on_infeasable="raise")
    with pytest.raises(TypeError, match="no argument 'on_infeasable'; did you mean 'on_infeas"):
        qt.Controller(PLANAR, [], on_infeasable="raise")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"no argument 'colour'\."):
        qt.Controller(PLANAR, [], colour="red")  # type: ignore[call-arg]
    assert list(inspect.signature(qt.Controller).parameters)[:4] == [
        "model", "tasks", "levels", "secondary",
    ]  # fmt: skip

    class Mine(qt.Controller):
        def __init__(self, colour: str, **options: Any) -> None:
            super().__init__(PLANAR, [qt.TwistTask.point("tip", "site")], **options)
            self.colour = colour

    assert Mine(colour="red", on_infeasible="raise").colour == "red"
    with pytest.raises(TypeError, match="on_infeasable"):
        Mine(colour="red", on_infeasable="raise")
