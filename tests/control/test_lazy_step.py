"""The plain step as machine code: the reference's."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import subprocess
import sys
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from oracles.arms import planar_arm
from oracles.same_steps import by_reference, plain_controller, same
from oracles.twists import ALONG_X, PLANE, POINT

import qp_twist as qt
from qp_twist.control.lazy_step import LazyStep

Array = np.ndarray


# ---------------------------------------------------------------- the step


def test_most_steps_are_plain_and_with_limits_that_bind_too() -> None:
    path_task = qt.load_task("deburring")
    found: dict[str, list[qt.Step]] = {}
    for name in ("reference", "compiled"):
        task = qt.TwistTask("tool", "site", path_task.projector)
        controller = qt.Controller(
            path_task.model, [task], secondary=[qt.JointCentering(path_task.model, "natural")],
            limits=[qt.MotionLimit(path_task.model, velocity=0.4)],
            solver="daqp" if name == "reference" else name,
        )  # fmt: skip
        if name == "reference":
            by_reference(controller)
        configuration = mink.Configuration(path_task.model, path_task.start)
        found[name] = []
        for waypoint in path_task.waypoints[:150]:
            task.set_target(waypoint)
            found[name].append(controller.step(configuration, 0.05))
            configuration.integrate_inplace(found[name][-1].velocity, 0.05)
    plain = [step for step in found["compiled"] if isinstance(step, LazyStep)]
    assert len(plain) > 100
    assert sum(bool(step.binding) for step in plain) > 30
    for expected, step in zip(found["reference"], found["compiled"], strict=True):
        np.testing.assert_allclose(step.velocity, expected.velocity, atol=1e-7)
        assert [str(x) for x in step.binding] == [str(x) for x in expected.binding]
        for mine, theirs in zip(step.binding, expected.binding, strict=True):
            assert mine.multiplier == pytest.approx(theirs.multiplier, rel=1e-4, abs=1e-6)


def test_a_whole_run_is_the_same() -> None:
    runs = [qt.follow(qt.load_task("planar_line"), "qp", solver=s) for s in ("daqp", "compiled")]
    np.testing.assert_allclose(runs[1].q, runs[0].q, atol=1e-8)
    assert runs[1].binding == runs[0].binding


# ---------------------------------------------------------------- what may change under way


def test_what_is_changed_between_two_steps_counts() -> None:
    controller, task, configuration = plain_controller("compiled")
    before = controller.step(configuration, 0.1).velocity.copy()
    task.gain = 0.5
    np.testing.assert_allclose(controller.step(configuration, 0.1).velocity, 0.5 * before)
    task.max_linear_step = 1e-4
    slow = controller.step(configuration, 0.1)
    assert np.abs(slow.velocity).max() < 0.5 * np.abs(before).max()
    controller.limits.append(mink.VelocityLimit(controller.model, {"joint_1": 1e-4}))
    assert abs(controller.step(configuration, 0.1).velocity[0]) <= 1e-4 + 1e-12
    del controller.limits[-1]
    same(slow, controller.step(configuration, 0.1))
    controller.limits.append(3)
    with pytest.raises(qt.InvalidInput, match="limits"):
        controller.step(configuration, 0.1)
    del controller.limits[-1]
    task.projector = POINT
    assert [len(r) for r in controller.step(configuration, 0.1).residuals] == [3]
    task.frame_name, task.frame_type = "link_3", "body"
    other = controller.step(configuration, 0.1)
    assert not isinstance(other, LazyStep)


def test_another_composition_under_way_counts_too() -> None:
    model = qt.load_task("deburring").model
    controller, _, configuration = plain_controller(
        "compiled", secondary=[qt.JointCentering(model, gain=0.1)]
    )
    before = controller.step(configuration, 0.1)
    assert isinstance(before, LazyStep)
    weights = np.linspace(0.5, 3.0, 6)
    with pytest.raises(ValueError, match="read-only"):
        controller.metric[0] = 2.0
    for name, value in (
        ("metric", weights), ("secondary", ()), ("secondary_space", "twist"), ("solver", "proxqp"),
    ):  # fmt: skip
        was = getattr(controller, name)
        setattr(controller, name, value)
        changed = controller.step(configuration, 0.1)
        assert changed.solver == controller.solver
        if name in ("metric", "secondary"):
            given = {"secondary": [qt.JointCentering(model, gain=0.1)]} | {name: value}
            fresh = plain_controller("compiled", **given)[0].step(configuration, 0.1)
            np.testing.assert_allclose(changed.velocity, fresh.velocity, atol=1e-9)
            assert np.abs(changed.velocity - before.velocity).max() > 1e-6
        setattr(controller, name, was)
        same(before, controller.step(configuration, 0.1))


def test_limits_that_are_changed_under_way_count() -> None:
    model = qt.load_task("deburring").model
    limit = qt.PositionLimit(model)
    controller, task, configuration = plain_controller("compiled", limits=[limit])
    controller.step(configuration, 0.1)
    with pytest.raises(ValueError, match="read-only"):
        limit.lower[0] = 0.0
    with pytest.raises(qt.InvalidInput, match="expected an array of shape"):
        limit.lower = np.zeros(3)
    with pytest.raises(qt.InvalidInput, match="NaN"):
        limit.lower = np.full(6, np.nan)
    limit.lower = configuration.q - 1e-4
    limit.upper = configuration.q + 1e-4
    held = controller.step(configuration, 0.1)
    assert held.status is not qt.Status.SOLVED
    assert np.abs(held.velocity).max() <= 1e-3 + 1e-9
    task.relative_to = ("link_1", "body")
    carried = plain_controller("quadprog", limits=[limit])
    carried[1].relative_to = ("link_1", "body")
    np.testing.assert_allclose(
        controller.step(configuration, 0.1).velocity,
        carried[0].step(configuration, 0.1).velocity, atol=1e-6,
    )  # fmt: skip


def test_a_copy_of_a_controller_has_arrays_of_its_own() -> None:
    controller, task, configuration = plain_controller("compiled")
    before = controller.step(configuration, 0.1)
    copied = copy.deepcopy(controller)
    copied.twist_tasks[0].gain = 0.5
    halved = copied.step(configuration, 0.1)
    assert isinstance(halved, LazyStep)
    np.testing.assert_allclose(halved.velocity, 0.5 * before.velocity, atol=1e-6)
    again = controller.step(configuration, 0.1)
    np.testing.assert_allclose(again.velocity, before.velocity, atol=1e-6)
    assert task.gain == 1.0


def test_two_configurations_and_their_velocities_do_not_mix() -> None:
    model = qt.load_task("deburring").model
    controller, _, first = plain_controller(
        "compiled", limits=[qt.MotionLimit(model, acceleration=1.0)]
    )
    second = mink.Configuration(model, first.q + 0.1)
    controller.step(first, 0.1, velocity=np.zeros(6))
    there = controller.step(second, 0.1, velocity=np.full(6, 0.05)).velocity
    again = controller.step(second, 0.1, velocity=np.full(6, 0.05)).velocity
    np.testing.assert_allclose(there, again, atol=1e-12)
    np.testing.assert_allclose(controller.limits[0].velocity, again)  # type: ignore[attr-defined]


BALL = """<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 0.1">
  <joint name="rail" type="slide" axis="1 0 0" range="-1 1"/>
  <geom size="0.05" mass="1"/>
  <body name="wrist" pos="0.2 0 0"><joint name="wrist" type="ball"/><geom size="0.05" mass="1"/>
    <body name="arm" pos="0.3 0.1 0"><joint name="elbow" axis="0 1 1" range="-2 2"/>
      <geom name="palm" pos="0.1 0 0" size="0.05" mass="1"/>
      <body name="hand" pos="0.3 0 0.1"><joint name="hand" axis="1 0 0" range="-2 2"/>
        <geom size="0.05" mass="1"/><site name="tool" pos="0 0.1 0.2"/></body>
    </body></body></body>
  <body name="other"><joint name="turn" axis="0 0 1" range="-1 1"/><geom size="0.05" mass="1"/>
  </body></worldbody></mujoco>"""
FREE = BALL.replace('type="slide" axis="1 0 0" range="-1 1"', 'type="free"')


@pytest.mark.parametrize("frame", [("tool", "site"), ("palm", "geom"), ("base", "body")])
def test_a_ball_joint_in_the_chain_and_joints_beside_it_make_no_difference(
    frame: tuple[str, str],
) -> None:
    model = mujoco.MjModel.from_xml_string(BALL)
    rng = np.random.default_rng(4)
    found = []
    q = mink.Configuration(model).integrate(0.2 * rng.normal(size=model.nv), 1.0)
    configuration = mink.Configuration(model, q)
    for name in ("daqp", "compiled"):
        projector = ALONG_X
        task = qt.TwistTask(*frame, projector)
        task.set_target(configuration.get_transform_frame_to_world(*frame) @ mink.SE3.exp(
            np.array([0.01, 0.02, 0.0, 0.0, 0.0, 0.0])))  # fmt: skip
        found.append(qt.Controller(model, [task], solver=name))
    expected = by_reference(found[0]).step(configuration, 0.1)
    step = found[1].step(configuration, 0.1)
    assert isinstance(step, LazyStep)
    same(expected, step)


def test_a_configuration_of_another_robot_is_refused() -> None:
    """Of as many coordinates and degrees of freedom, but other joints: 7 + 4 + … = 4 + 3 · 1 + …"""
    parted = FREE.replace(
        '<joint name="rail" type="free"/>',
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint type="slide" axis="0 0 1"/><joint type="ball"/>',
    )
    one, other = (mujoco.MjModel.from_xml_string(text) for text in (FREE, parted))
    assert (one.nq, one.nv) == (other.nq, other.nv)
    task = qt.TwistTask.point("tool", "site")
    task.set_target_from_configuration(mink.Configuration(one))
    controller = qt.Controller(one, [task], solver="compiled")
    controller.step(mink.Configuration(one), 0.1)
    with pytest.raises(qt.InvalidInput, match="same model"):
        controller.step(mink.Configuration(other), 0.1)


# ---------------------------------------------------------------- the result


def test_a_step_keeps_what_it_says_when_the_next_is_taken() -> None:
    controller, task, configuration = plain_controller("compiled")
    step = controller.step(configuration, 0.1)
    assert isinstance(step, LazyStep)
    velocity = step.velocity.copy()
    task.set_target(qt.load_task("deburring").waypoints[9])
    controller.step(configuration, 0.1)
    np.testing.assert_array_equal(step.velocity, velocity)
    np.testing.assert_allclose(step.problem.A @ velocity, step.problem.b, atol=1e-10)
    assert "solved" in repr(step) and step.solver == "compiled"
    copied = pickle.loads(pickle.dumps(step))
    same(step, copied)
    assert dataclasses.replace(step, scale=0.5).scale == 0.5
    with pytest.raises(AttributeError):
        step.nothing  # noqa: B018
    with pytest.raises(dataclasses.FrozenInstanceError):
        step.scale = 2.0  # type: ignore[misc]


# ---------------------------------------------------------------- what it costs


def test_a_compiled_step_makes_few_calls() -> None:
    """Not a time, but what makes it: calls of functions. The reference makes hundreds."""
    path_task = qt.load_task("deburring")
    controller, _, configuration = plain_controller(
        "compiled", secondary=[qt.JointCentering(path_task.model)]
    )
    for _ in range(3):
        assert isinstance(controller.step(configuration, 0.1), LazyStep)
    calls = 0

    def count(frame: Any, event: str, argument: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        controller.step(configuration, 0.1)
    finally:
        sys.setprofile(None)
    assert calls <= 25


# ---------------------------------------------------------------- machine code


@pytest.mark.any_blas
def test_machine_code_that_can_be_kept_nowhere_is_made_all_the_same() -> None:
    script = """
import numba.core.caching as c
c.FunctionCache._impl_class._locator_classes = []
import numpy as np
from qp_twist.kernel.compiling import entry
from qp_twist.kernel.dual_active_set import cholesky as kernel
cholesky = entry(kernel.py_func)
S = np.array([[4.0, 0.0], [2.0, 5.0]])
assert cholesky(S)
np.testing.assert_allclose(S, [[2.0, 0.0], [1.0, 2.0]])
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300)


def test_steps_that_are_left_to_the_reference_are_counted() -> None:
    model = planar_arm([0.5, 0.4, 0.3])
    task = qt.TwistTask("tip", "site", PLANE)
    controller = qt.Controller(model, [task], solver="compiled")
    bent, outside = (mink.Configuration(model, np.full(3, angle)) for angle in (0.4, 3.5))
    assert (model.jnt_range[:, 1] < 3.5).all()
    for configuration, left in ((bent, 0), (outside, 1), (bent, 1)):
        task.set_target_from_configuration(configuration)
        controller.step(configuration, 0.01)
        assert controller.reference_steps == left
    by_name = qt.Controller(model, [task], limits=[], solver="daqp")
    by_name.step(bent, 0.01)
    assert by_name.reference_steps == 1
