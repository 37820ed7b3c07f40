"""What is assigned between two steps is checked, and counts at once."""

import copy
from typing import Any

import mink
import numpy as np
import pytest
from oracles.same_steps import plain_controller, same

import qp_twist as qt

PATH = qt.load_task("deburring")
MODEL = PATH.model


def tool(frame: str = "tool") -> qt.TwistTask:
    task = qt.TwistTask(frame, "site", PATH.projector)
    task.set_target(PATH.waypoints[0])
    return task


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("secondary_space", "Twist", "joint, twist"), ("secondary_space", None, "joint, twist"),
        ("solver", "daqpp", "Installed"), ("secondary", 3, "secondary"),
        ("secondary", [qt.PositionLimit(MODEL)], "secondary"), ("limits", None, "limits"),
        ("limits", [3], "limits"),
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
    ("name", "value"),
    [
        ("secondary", [qt.JointCentering(MODEL, gain=0.5)]), ("metric", np.arange(1.0, 7.0)),
        ("secondary_space", "twist"), ("solver", "daqp"), ("joint_weight", 1e-3),
        ("limits", [qt.MotionLimit(MODEL, velocity=0.01)]),
        ("free_twist_costs", (1.0, 9.0)), ("on_infeasible", "relax"), ("smooth", False),
    ],
)  # fmt: skip
def test_what_is_assigned_counts_in_all_steps_that_follow(name: str, value: Any) -> None:
    space: Any = "joint" if name in ("secondary_space", "metric") else "twist"
    configuration = mink.Configuration(MODEL, PATH.start)
    one, other = (
        qt.Controller(
            MODEL, [tool()], secondary=[qt.JointCentering(MODEL, gain=0.1)], secondary_space=space
        )
        for _ in range(2)
    )
    one.step(configuration, 0.1)
    for controlled in (one, other):
        setattr(controlled, name, value)
    other = copy.deepcopy(other)  # which is made anew with what was assigned
    for _ in range(3):
        same(other.step(configuration, 0.1), one.step(configuration, 0.1))


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


@pytest.mark.parametrize(
    ("objective", "name", "value"),
    [
        (qt.JointCentering(MODEL, gain=0.1), "gain", 0.5),
        (qt.JointCentering(MODEL, gain=0.1), "weight", "paper"),
        (qt.PostureReference(MODEL, PATH.start + 0.1, gain=0.1), "gain", 0.5),
        (qt.PostureReference(MODEL, PATH.start, gain=0.1), "q_ref", PATH.start + 0.3),
    ],
)
def test_what_an_objective_is_assigned_counts_also_after_a_step_without_it(
    objective: qt.SecondaryObjective, name: str, value: Any
) -> None:
    configuration = mink.Configuration(MODEL, PATH.start)
    controller = qt.Controller(MODEL, [tool()], secondary=[objective])
    before = controller.step(configuration, 0.1)
    setattr(objective, name, value)
    controller.step(configuration, 0.1, use_secondary=False)
    after = controller.step(configuration, 0.1)
    assert np.abs(after.velocity - before.velocity).max() > 1e-3
    same(qt.Controller(MODEL, [tool()], secondary=[objective]).step(configuration, 0.1), after)
    assert controller.reference_steps == 0


@pytest.mark.parametrize("name", ["period", "stale_after", "stop_within"])
def test_the_times_of_a_servo_are_set_when_it_is_made(name: str) -> None:
    controller, _, configuration = plain_controller("daqp")
    servo = qt.Servo(controller, configuration)
    with pytest.raises(AttributeError, match=name):
        setattr(servo, name, 1.0)
