"""Arms of four and five joints whose models have rounded angles: what they reach, and by how much
they miss what they do not reach, against least squares on MuJoCo's kinematics."""

from __future__ import annotations

import dataclasses
import math
import re
from functools import cache

import mink
import mujoco
import numpy as np
import pytest
from oracles.rounded_arms import axis_path, scara, vertical_arm
from scipy.optimize import least_squares

import qp_twist as qt
from qp_twist.following import find_starts
from qp_twist.planning import what_forbids
from qp_twist.referee import Tolerances

Array = np.ndarray
ALLOWED = Tolerances()


def errors(model: mujoco.MjModel, q: Array, waypoint: mink.SE3) -> tuple[float, float]:
    """Distance of the tip, m, and angle of its z axis, rad, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    R, R_d = data.site("tip").xmat.reshape(3, 3), waypoint.rotation().as_matrix()
    angle = 2.0 * math.asin(min(1.0, 0.5 * float(np.linalg.norm(R[:, 2] - R_d[:, 2]))))
    return float(np.linalg.norm(data.site("tip").xpos - waypoint.translation())), angle


@cache
def least(model: mujoco.MjModel, waypoint: mink.SE3) -> tuple[float, float]:
    """The least errors of a waypoint that least squares find from 40 configurations."""
    data, rng, found = mujoco.MjData(model), np.random.default_rng(0), []
    goal, axis = waypoint.translation(), waypoint.rotation().as_matrix()[:, 2]
    lower, upper = model.jnt_range.T

    def off(q: Array) -> Array:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        R = data.site("tip").xmat.reshape(3, 3)
        return np.r_[data.site("tip").xpos - goal, R[:, 2] - axis]

    for _ in range(40):
        begin = rng.uniform(lower, upper)
        solved = least_squares(off, begin, bounds=(lower, upper), xtol=1e-15, ftol=1e-15)
        found.append(errors(model, solved.x, waypoint))
    return min(found, key=lambda pair: max(pair[0] / ALLOWED.position, pair[1] / ALLOWED.axis))


CASES = [
    (vertical_arm, "1.5708"),
    (vertical_arm, "1.57"),
    (scara, "3.1416"),
    (scara, "3.141"),
]


@pytest.mark.parametrize(("make", "angle"), CASES)
def test_what_least_squares_reach_within_the_tolerances_is_planned(make, angle: str) -> None:
    model = make(angle)
    task = axis_path(model)
    for waypoint in task.waypoints[::5]:
        linear, angular = least(model, waypoint)
        assert linear <= ALLOWED.position and angular <= ALLOWED.axis
    plan = qt.plan(task, max_step_deg=30.0)
    q = plan.motion()
    for configuration, waypoint in zip(q, task.waypoints, strict=True):
        linear, angular = errors(model, configuration, waypoint)
        assert linear <= ALLOWED.position and angular <= ALLOWED.axis
    assert qt.JointRanges.of(model).inside(q).all()
    at = {f.name: f for f in plan.examined()}
    assert at["position error"].passes and at["axis error"].passes


@pytest.mark.parametrize(("make", "angle"), [(vertical_arm, "1.5708"), (scara, "3.14159")])
def test_a_run_starts_and_ends_on_such_a_path(make, angle: str) -> None:
    task = axis_path(make(angle))
    [start, *_] = find_starts(task)
    run = qt.follow(dataclasses.replace(task, start=start.q), "qp_gradient")
    assert run.position_error.max() <= ALLOWED.position
    assert run.axis_error.max() <= ALLOWED.axis


@pytest.mark.parametrize("angle", ["3.14", "2.9"])
def test_an_axis_that_is_missed_is_missed_by_what_least_squares_say(angle: str) -> None:
    """A spindle that leans by more than the tolerance cannot be righted by any joint."""
    model = scara(angle)
    task = axis_path(model)
    plan = qt.plan(task)
    assert plan.q is None and plan.certificate.kind == "unreachable"
    said = re.search(r"misses waypoint (\d+) by (\S+) mm and (\S+)°", str(plan.certificate))
    assert said is not None, str(plan.certificate)
    linear, angular = least(model, task.waypoints[int(said[1]) - 1])
    assert angular > ALLOWED.axis
    # The errors weigh alike in both, in m and rad.
    assert float(said[3]) == pytest.approx(math.degrees(angular), rel=0.05)
    assert float(said[2]) == pytest.approx(1e3 * linear, abs=0.1 * 1e3 * angular)
    assert re.search(r"misses waypoint 1 by \S+ mm and \S+°", what_forbids(task))


@pytest.mark.parametrize(("beyond", "reached"), [(5e-5, True), (3e-4, False)])
def test_an_arm_that_is_stretched_reaches_what_a_check_lets_pass(
    beyond: float, reached: bool
) -> None:
    model = scara(repr(math.pi))
    far = mink.SE3.from_rotation_and_translation(
        mink.SO3.from_rpy_radians(math.pi, 0.0, 0.0), np.array([0.7 + beyond, 0.0, 0.6])
    )
    near = mink.SE3.from_translation(np.array([-0.05, 0.0, 0.0])) @ far
    task = dataclasses.replace(axis_path(model), waypoints=(near, far))
    assert least(model, far)[0] == pytest.approx(beyond, rel=0.02)
    plan = qt.plan(task, max_step_deg=60.0)
    assert (plan.q is not None) == reached
    if reached:
        assert errors(model, plan.motion()[1], far)[0] <= ALLOWED.position
    else:
        assert plan.certificate.waypoints == (2,)
        assert "misses waypoint 2 by 0.3 mm" in str(plan.certificate)
