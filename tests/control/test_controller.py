"""The controller: limits, infeasibility, verification, and input that is refused."""

from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
import qpsolvers
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles.arms import random_arm, random_configuration
from oracles.compositions import HalfSpaces
from oracles.twists import ROLL_FREE, site
from scipy.optimize import lsq_linear

import qp_twist as qt

SOLVERS = ["daqp", "proxqp", "osqp"]
SEEDS = st.integers(0, 2**32 - 1)


class Arm:
    """A random arm with a task whose target is ``away`` (m and rad) from where it is."""

    def __init__(self, seed: int, joints: int = 7, away: float = 0.1) -> None:
        rng = np.random.default_rng(seed)
        self.model = random_arm(rng, joints)
        q = random_configuration(self.model, rng, margin=0.1)
        self.configuration = mink.Configuration(self.model, q)
        self.task = qt.TwistTask("tool", "site", ROLL_FREE)
        pose = site(self.configuration)
        self.task.set_target(pose.plus(away * rng.normal(size=6)))

    def velocity_limit(self, speed: float) -> mink.VelocityLimit:
        names = [self.model.joint(j).name for j in range(self.model.njnt)]
        return mink.VelocityLimit(self.model, dict.fromkeys(names, speed))


@pytest.mark.parametrize("solver", SOLVERS)
@given(seed=SEEDS)
@settings(max_examples=20)
def test_velocity_limits_scale_the_task_and_keep_its_direction(solver: str, seed: int) -> None:
    arm = Arm(seed, away=0.5)
    limit = arm.velocity_limit(0.2)
    limits = [qt.PositionLimit(arm.model), limit]
    controller = qt.Controller(arm.model, [arm.task], limits=limits, solver=solver)
    step = controller.step(arm.configuration, 0.05)
    rows, rate = arm.task.velocity_rows(arm.configuration, 0.05)
    assume(np.linalg.svd(rows, compute_uv=False)[-1] > 0.05)  # weaker directions lag behind
    assert step.status is qt.Status.SCALED
    assert 0.0 < step.scale < 1.0
    assert np.abs(step.velocity).max() <= 0.2 + 1e-9
    size = 1.0 + np.abs(rate).max()
    assert rows @ step.velocity == pytest.approx(step.scale * rate, abs=1e-7 * size)
    assert step.residuals[0] == pytest.approx(rows @ step.velocity - step.scale * rate, abs=1e-12)


@given(SEEDS)
@settings(max_examples=30)
def test_a_scaled_step_names_limits_that_are_reached_and_matter(seed: int) -> None:
    arm = Arm(seed, away=0.5)
    limits = [arm.velocity_limit(0.2)]
    controller = qt.Controller(arm.model, [arm.task], limits=limits)
    controller.smooth = False
    step = controller.step(arm.configuration, 0.05)
    assume(step.status is qt.Status.SCALED)
    names = [arm.model.joint(j).name for j in range(arm.model.njnt)]
    assert step.binding
    for limit in step.binding:
        assert limit.kind == "velocity"
        speed = step.velocity[names.index(limit.joint)]
        slack = 0.2 - speed if limit.side == "upper" else speed + 0.2
        # By duality: the 1e-8 of the scale that a scaled step gives up pays for all the slack.
        assert slack * limit.multiplier <= 2e-8
        assert slack < 1e-3
        assert limit.joint in step.message
    # Room at every binding limit lets the task go on faster.
    wider = dict.fromkeys(names, 0.2) | {limit.joint: 0.21 for limit in step.binding}
    more = qt.Controller(arm.model, [arm.task], limits=[mink.VelocityLimit(arm.model, wider)])
    more.smooth = False
    assert more.step(arm.configuration, 0.05).scale > step.scale


def test_raising_carries_the_problem_and_the_names(tmp_path: Path) -> None:
    arm = Arm(3, away=0.5)
    controller = qt.Controller(
        arm.model, [arm.task], limits=[arm.velocity_limit(0.2)], on_infeasible="raise"
    )
    with pytest.raises(qt.InfeasibleStep, match=r"binding: joint_\d") as caught:
        controller.step(arm.configuration, 0.05)
    assert caught.value.binding
    assert caught.value.problem is not None
    assert isinstance(caught.value, mink.NoSolutionFound)
    caught.value.problem.save(tmp_path / "step.npz")
    again = qt.QuadraticProgram.load(tmp_path / "step.npz")
    assert np.array_equal(again.b, caught.value.problem.b)
    assert np.array_equal(again.upper, caught.value.problem.upper)


def test_what_no_limit_forbids_is_said_to_be_a_contradiction_or_a_singularity() -> None:
    arm = Arm(3)
    other = qt.TwistTask("tool", "site", ROLL_FREE)
    assert arm.task.target is not None
    other.set_target(arm.task.target.plus(np.array([0.1, 0, 0, 0, 0, 0])))
    controller = qt.Controller(arm.model, [arm.task, other], limits=[])
    step = controller.step(arm.configuration, 0.1)
    # What both want is done; the difference of the two targets is one lost direction a row.
    assert step.status is qt.Status.DEGRADED
    assert step.sigma_min == pytest.approx(0.0, abs=1e-9)
    missing = np.linalg.norm([lost.missing for lost in step.lost])
    assert np.linalg.norm(np.concatenate(step.residuals)) == pytest.approx(missing, rel=1e-6)
    assert "contradict" in step.message
    strict = qt.Controller(arm.model, [arm.task, other], limits=[], on_infeasible="raise")
    with pytest.raises(qt.InfeasibleStep, match="contradict each other"):
        strict.step(arm.configuration, 0.1)
    # The same task twice is no contradiction.
    twice = qt.Controller(arm.model, [arm.task, arm.task], limits=[])
    assert twice.step(arm.configuration, 0.1).status is qt.Status.SOLVED


@given(SEEDS)
@settings(max_examples=30)
def test_a_relaxed_step_is_the_closest_inside_the_bounds(seed: int) -> None:
    arm = Arm(seed, away=0.5)
    controller = qt.Controller(
        arm.model, [arm.task], limits=[arm.velocity_limit(0.2)], on_infeasible="relax"
    )
    controller.smooth = False
    step = controller.step(arm.configuration, 0.05)
    assume(step.status is qt.Status.RELAXED)
    rows, rate = arm.task.velocity_rows(arm.configuration, 0.05)
    oracle = lsq_linear(rows, rate, (-0.2, 0.2), method="bvls", tol=1e-14)
    best = np.linalg.norm(rows @ oracle.x - rate)
    assert np.linalg.norm(rows @ step.velocity - rate) == pytest.approx(best, abs=1e-6)


@given(SEEDS)
@settings(max_examples=20)
def test_a_step_ends_inside_the_position_limits(seed: int) -> None:
    arm = Arm(seed, away=3.0)
    controller = qt.Controller(arm.model, [arm.task])
    for _ in range(5):
        step = controller.step(arm.configuration, 0.1)
        arm.configuration.integrate_inplace(step.velocity, 0.1)
    lower, upper = arm.model.jnt_range.T
    assert (arm.configuration.q >= lower - 1e-9).all()
    assert (arm.configuration.q <= upper + 1e-9).all()


def test_a_joint_at_its_limit_may_stand_still_and_never_goes_over_by_rounding() -> None:
    arm = Arm(6)
    q = arm.configuration.q.copy()
    q[1] = arm.model.jnt_range[1, 1]
    at_limit = mink.Configuration(arm.model, q)
    for dt in (1e-4, 0.05, 1.0):
        lower, upper = qt.PositionLimit(arm.model).bounds(at_limit, dt)
        assert upper[1] == 0.0
        assert lower[1] < 0.0
    rng = np.random.default_rng(0)
    for _ in range(300):
        q = random_configuration(arm.model, rng)
        dt = 10.0 ** rng.uniform(-4, 1)
        inside = mink.Configuration(arm.model, q)
        for bound in qt.PositionLimit(arm.model, recovery_speed=1e9).bounds(inside, dt):
            moved = q + bound * dt
            assert (moved >= arm.model.jnt_range[:, 0]).all()
            assert (moved <= arm.model.jnt_range[:, 1]).all()


def test_a_limit_with_general_rows_holds_and_is_named() -> None:
    arm = Arm(2)
    free = qt.Controller(arm.model, [arm.task], limits=[]).step(arm.configuration, 0.1)
    wall = float(free.velocity[:2].sum()) - 0.05

    sums = np.array([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    limits = [HalfSpaces(sums, np.array([wall]))]
    step = qt.Controller(arm.model, [arm.task], limits=limits).step(arm.configuration, 0.1)
    assert step.velocity[:2].sum() == pytest.approx(wall, abs=1e-8)
    assert [limit.joint for limit in step.binding] == ["HalfSpaces row 0"]


def test_soft_mink_tasks_weigh_in_as_in_mink() -> None:
    arm = Arm(21, away=0.02)
    posture = mink.PostureTask(arm.model, cost=1.0)
    posture.set_target(np.zeros(7))
    controller = qt.Controller(arm.model, [arm.task, posture], limits=[])
    ours = controller.step(arm.configuration, 0.1).velocity
    minks = mink.solve_ik(
        arm.configuration, [posture], 0.1, "daqp", limits=[], constraints=[arm.task]
    )
    assert ours == pytest.approx(minks, abs=1e-6)


# Input that is refused, with a sentence.


NO_JOINTS = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><site name="tool"/></worldbody></mujoco>'
)


@pytest.mark.parametrize(
    ("keywords", "error", "sentence"),
    [
        ({"model": NO_JOINTS}, qt.InvalidInput, "no joints"),
        ({"solver": "nosuch"}, qt.UnknownSolver, r"'nosuch'.*Installed: .*daqp"),
        ({"tasks": []}, qt.InvalidInput, "empty"),
        ({"tasks": Arm(1).task}, qt.InvalidInput, "expected a list"),
        ({"tasks": ["task"]}, qt.InvalidInput, "BaseTask"),
        ({"tasks": [qt.TwistTask.point("nowhere", "site")]}, mink.InvalidFrame, "nowhere"),
        ({"smooth": False}, TypeError, r"'smooth'; it is an attribute: .*smooth = False"),
    ],
)
def test_wrong_arguments_are_refused(
    keywords: dict[str, Any], error: type[Exception], sentence: str
) -> None:
    arm = Arm(1)
    with pytest.raises(error, match=sentence):
        qt.Controller(**({"model": arm.model, "tasks": [arm.task]} | keywords))


def test_a_step_says_itself_in_a_sentence() -> None:
    arm = Arm(1)
    step = qt.Controller(arm.model, [arm.task]).step(arm.configuration, 0.1)
    assert step.message.startswith("solved: ")
    assert "TwistTask('tool', 'site'" in repr(qt.Controller(arm.model, [arm.task]))


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
def test_any_backend_solves_the_program_of_a_step_whose_rows_have_names(solver: str) -> None:
    arm = Arm(2)
    arm.task.bands = (qt.RollBand([0, 0, 1], -3.0, 3.0, weight=10.0),)
    wall = HalfSpaces(np.ones((1, 7)), np.array([0.05]))
    controller = qt.Controller(
        arm.model, [arm.task], secondary=[qt.JointCentering(arm.model)], solver="daqp",
        limits=[qt.PositionLimit(arm.model), wall],
    )  # fmt: skip
    problem = controller.build_ik(arm.configuration, 1.0)
    assert problem.unknowns == (*(f"joint_{i + 1}" for i in range(7)), "slack 1")
    assert problem.equalities == tuple(f"TwistTask('tool', 'site') row {i + 1}" for i in range(5))
    assert problem.inequalities[0] == "HalfSpaces row 0 (HalfSpaces)"
    assert len(problem.inequalities) == len(problem.h) == 3
    accurate = {"daqp": {}, "proxqp": {"eps_abs": 1e-9}}[solver]
    x = qpsolvers.solve_problem(problem, solver, **accurate).x
    step = controller.step(arm.configuration, 1.0)
    assert step.status is qt.Status.SOLVED
    np.testing.assert_allclose(x[:7], step.velocity, atol=1e-5)
