"""What is assigned between two steps is checked, and counts at once."""

from __future__ import annotations

import copy
from typing import Any

import mink
import numpy as np
import pytest
from oracles.same_steps import plain_controller, same
from oracles.twists import POINT

import qp_twist as qt
from qp_twist.shipped import shipped_folder

PATH = qt.load_task("deburring")
MODEL = PATH.model


def tool(frame: str = "tool") -> qt.TwistTask:
    task = qt.TwistTask(frame, "site", PATH.projector)
    task.set_target(PATH.waypoints[0])
    return task


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
    ("name", "value", "sentence"),
    [
        ("secondary_space", "Twist", "joint, twist"), ("secondary_space", None, "joint, twist"),
        ("solver", "daqpp", "Installed"), ("secondary", 3, "secondary"),
        ("secondary", [qt.PositionLimit(MODEL)], "secondary"), ("limits", None, "limits"),
        ("limits", [3], "limits"), ("levels", [[tool()]], "levels"), ("tasks", [tool()], "tasks"),
        ("smooth", np.ones(2), "smooth: expected"), ("smooth", "no", "smooth: expected"),
        ("braking", 0.5, "braking: expected"), ("on_infeasible", "stop", "on_infeasible: expected"),
        ("joint_weight", 0.0, "joint_weight"), ("joint_weight", np.inf, "joint_weight"),
        ("joint_weight", "a", "joint_weight"), ("singularity", np.inf, "singularity"),
        ("singularity", "no", "singularity"), ("metric", np.ones(3), "metric"),
        ("metric", np.zeros(6), "metric"), ("metric", None, "metric"),
        ("free_twist_costs", (1.0, -1.0), "free_twist_costs"),
    ],
)  # fmt: skip
def test_a_controller_checks_what_is_assigned_and_stays_as_it_was(
    name: str, value: Any, sentence: str
) -> None:
    controller, _, configuration = plain_controller("daqp")
    before = controller.step(configuration, 0.1)
    with pytest.raises((qt.InvalidInput, qt.UnknownSolver), match=sentence):
        setattr(controller, name, value)
    same(before, copy.deepcopy(controller).step(configuration, 0.1))


@pytest.mark.parametrize(
    ("name", "value", "error", "sentence"),
    [
        ("gain", -1.0, mink.InvalidGain, "from 0 to 1"),
        ("gain", 2.0, mink.InvalidGain, "from 0 to 1"),
        ("gain", None, qt.InvalidInput, "gain"),
        ("gain", "x", qt.InvalidInput, "gain"),
        ("gain", float("nan"), qt.InvalidInput, "gain"),
        *[
            ("max_linear_step", value, qt.InvalidInput, "max_linear_step")
            for value in ("a", None, 0.0, np.nan)
        ],
        ("bands", 3, qt.InvalidInput, "bands"),
    ],
)
def test_a_task_checks_what_it_is_assigned(
    name: str, value: Any, error: type[Exception], sentence: str
) -> None:
    with pytest.raises(error, match=sentence):
        setattr(tool(), name, value)


@pytest.mark.parametrize("value", ["a", None, 0.0, np.nan])
def test_an_objective_checks_what_it_is_assigned(value: Any) -> None:
    with pytest.raises(qt.InvalidInput, match="weight"):
        qt.JointCentering(MODEL).weight = value


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


def test_a_step_refuses_arguments_of_another_shape() -> None:
    controller, configuration = (
        qt.Controller(MODEL, [tool()]),
        mink.Configuration(MODEL, PATH.start),
    )
    with pytest.raises(qt.InvalidInput, match="use_secondary"):
        controller.step(configuration, 0.01, use_secondary=np.ones(3))  # type: ignore[arg-type]
    with pytest.raises(qt.InvalidInput, match="velocity"):
        qt.MotionLimit(MODEL).velocity = np.zeros(3)
