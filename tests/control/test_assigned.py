"""What is assigned between two steps is checked, and counts at once."""

from __future__ import annotations

from typing import Any

import mink
import numpy as np
import pytest
from scipy.optimize import linprog

import qp_twist as qt
from qp_twist.shipped import shipped_folder

PATH = qt.load_task("deburring")
MODEL = PATH.model
POINT = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())


def tool(frame: str = "tool") -> qt.TwistTask:
    task = qt.TwistTask(frame, "site", PATH.projector)
    task.set_target(PATH.waypoints[0])
    return task


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_largest_scale_does_not_depend_on_the_unit_of_the_rows(unit: float) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        A, b = rng.normal(size=(3, 5)), 10.0 * rng.normal(size=3)
        solution = qt.solve_levels([(unit * A, unit * b)], -np.ones(5), np.ones(5))
        found = linprog(
            np.append(np.zeros(5), -1.0), A_eq=np.column_stack([A, -b]), b_eq=np.zeros(3),
            bounds=[*[(-1.0, 1.0)] * 5, (0.0, 1.0)],
        )  # fmt: skip
        assert solution.scale == pytest.approx(-found.fun, rel=1e-7, abs=1e-9)


def test_a_lost_direction_of_a_constraint_in_part_contradictory_is_named() -> None:
    model = qt.load_robot(shipped_folder("scenes") / "seven_axis_arm.xml").model
    configuration = mink.Configuration(
        model, np.array([0.04, -0.04, 0.19, 0.03, -0.16, 0.11, 0.39])
    )
    task = qt.TwistTask.axis_free("elbow", "site")
    task.set_target_from_configuration(configuration)
    assert task.target is not None
    task.set_target(task.target.plus(np.array([0.01, 0.01, 0.0, 0.0, 0.0, 0.0])))
    posture = mink.PostureTask(model, cost=1.0)
    posture.set_target(np.zeros(7))
    for threshold in (0.0, 1e-3, 0.01, 0.05):
        step = qt.ik_step(
            configuration, [posture], 0.02, "daqp", 1e-6, constraints=[task], singularity=threshold
        )
        assert np.isfinite(step.velocity).all()
        assert all("elbow" in str(lost) for lost in step.lost)


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("secondary_space", "Twist", qt.InvalidInput),
        ("secondary_space", None, qt.InvalidInput),
        ("solver", "daqpp", qt.UnknownSolver),
        ("secondary", 3, qt.InvalidInput),
        ("secondary", [qt.PositionLimit(MODEL)], qt.InvalidInput),
        ("limits", None, qt.InvalidInput),
        ("limits", [3], qt.InvalidInput),
        ("levels", [[tool()]], qt.InvalidInput),
        ("tasks", [tool()], qt.InvalidInput),
        ("smooth", np.ones(2), qt.InvalidInput),
    ],
)
def test_a_controller_checks_what_is_assigned(name: str, value: Any, error: Any) -> None:
    controller = qt.Controller(MODEL, [tool()])
    with pytest.raises(error):
        setattr(controller, name, value)


@pytest.mark.parametrize("gain", [-1.0, 2.0])
def test_a_gain_outside_its_range_is_refused_when_it_is_assigned(gain: float) -> None:
    with pytest.raises(mink.InvalidGain, match="from 0 to 1"):
        tool().gain = gain


@pytest.mark.parametrize("gain", [None, "x", float("nan")])
def test_a_gain_that_is_no_number_is_a_sentence(gain: Any) -> None:
    with pytest.raises(qt.InvalidInput, match="gain"):
        tool().gain = gain


def test_a_projector_of_another_rank_takes_one_cost_for_all_rows_along() -> None:
    task, configuration = tool(), mink.Configuration(MODEL, PATH.start)
    task.cost = 2.0
    task.projector = POINT
    np.testing.assert_array_equal(task.cost, 2.0 * np.ones(3))
    assert qt.solve_ik(configuration, [task], 0.01, "daqp").shape == (MODEL.nv,)
    task.cost = [1.0, 2.0, 3.0]
    with pytest.raises(qt.InvalidInput, match="assign one number to cost first"):
        task.projector = PATH.projector
    with pytest.raises(qt.InvalidInput, match="must be a TwistProjector"):
        task.projector = None  # type: ignore[assignment]


def test_the_gradient_of_the_manipulability_is_that_of_the_frame_that_the_task_has_now() -> None:
    configuration, task = mink.Configuration(MODEL, PATH.start), tool()
    moved = qt.Manipulability(MODEL, task)
    moved.gradient(configuration)
    task.frame_name = "flange"
    anew = qt.Manipulability(MODEL, tool("flange"))
    np.testing.assert_allclose(moved.gradient(configuration), anew.gradient(configuration))


def test_the_speed_of_a_return_is_that_of_the_limit_as_it_is_now() -> None:
    q = PATH.start.copy()
    q[0] = float(MODEL.jnt_range[0, 1]) + 0.1
    outside = mink.Configuration(MODEL, q)

    def back(limit: Any) -> float:
        return float(limit.bounds(outside, 0.05)[1][0])

    motion = qt.MotionLimit(MODEL, velocity=0.2, acceleration=None)
    assert back(motion) == pytest.approx(-0.2)
    motion.max_velocity = np.full(MODEL.nv, 1.0)
    assert back(motion) == pytest.approx(-1.0)
    motion.max_velocity = np.full(MODEL.nv, np.inf)
    assert back(motion) == pytest.approx(-0.5)
    motion.recovery_speed = 0.1
    assert back(motion) == pytest.approx(-0.1)
    for wrong in (-1.0, float("nan"), "a"):
        with pytest.raises(qt.InvalidInput, match="recovery_speed"):
            motion.recovery_speed = wrong  # type: ignore[assignment]


def test_limits_and_secondaries_that_are_assigned_count_in_the_next_step() -> None:
    controller, configuration = (
        qt.Controller(MODEL, [tool()]),
        mink.Configuration(MODEL, PATH.start),
    )
    free = controller.step(configuration, 0.01)
    controller.limits = [mink.VelocityLimit(MODEL, {"joint_1": 1e-4})]
    assert abs(controller.step(configuration, 0.01).velocity[0]) <= 1e-4 * (1.0 + 1e-6)
    controller.limits.append(3)  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="limits"):
        controller.step(configuration, 0.01)
    controller.limits = []
    controller.secondary = [qt.JointCentering(MODEL)]
    led = controller.step(configuration, 0.01)
    assert np.abs(led.velocity - free.velocity).max() > 1e-6


def test_a_step_refuses_arguments_of_another_shape() -> None:
    controller, configuration = (
        qt.Controller(MODEL, [tool()]),
        mink.Configuration(MODEL, PATH.start),
    )
    with pytest.raises(qt.InvalidInput, match="use_secondary"):
        controller.step(configuration, 0.01, use_secondary=np.ones(3))  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="velocity"):
        qt.MotionLimit(MODEL).velocity = np.zeros(3)
    with pytest.raises(qt.InvalidInput, match="bands"):
        tool().bands = 3  # type: ignore[assignment]
