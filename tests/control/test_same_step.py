"""The one contract between the two statements of the step: reference and kernel say the same."""

import copy
import dataclasses
import pickle
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.compositions import composition
from oracles.same_steps import by_reference, plain_controller, same
from oracles.twists import POINT
from oracles.two_statements import answer, ask, differences

import qp_twist as qt


@pytest.mark.parametrize("smooth", [True, False])
@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_reference_and_kernel_take_the_same_step(smooth: bool, seed: int) -> None:
    """A step brakes, fades, scales and gives way in the same words and numbers."""
    question = composition(seed)
    compiled = answer(question, "compiled", smooth=smooth)
    found = differences(compiled, ask(seed, "daqp", smooth=smooth))
    assert not found, f"{seed}: {'; '.join(found)} ({', '.join(question.words)})"


def test_a_difference_is_seen() -> None:
    """A comparison that cannot fail compares nothing."""
    asked = (ask(seed, "daqp") for seed in range(100))
    one = next(a for a in asked if a.settled and a.answer.active and a.spread < 1e-8)
    for change in (
        {"velocity": one.answer.velocity + 1e-5 * (1.0 + abs(one.answer.velocity).max())},
        {"residuals": one.answer.residuals + 1e-3 * (1.0 + abs(one.answer.velocity).max())},
        {"scale": one.answer.scale + 1e-4},
        {"status": "RELAXED" if one.answer.status != "RELAXED" else "SOLVED"},
        {"active": one.answer.active[1:]},
    ):
        assert differences(one.answer._replace(**change), one)
    assert not differences(one.answer, one)


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
    controller.step(configuration, 0.1)
    assert controller.reference_steps > 0


def test_a_copy_of_a_controller_has_arrays_of_its_own() -> None:
    controller, task, configuration = plain_controller("compiled")
    before = controller.step(configuration, 0.1)
    copied = copy.deepcopy(controller)
    copied.twist_tasks[0].gain = 0.5
    halved = copied.step(configuration, 0.1)
    assert copied.reference_steps == 0
    np.testing.assert_allclose(halved.velocity, 0.5 * before.velocity, atol=1e-6)
    again = controller.step(configuration, 0.1)
    np.testing.assert_allclose(again.velocity, before.velocity, atol=1e-6)
    assert task.gain == 1.0


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


@pytest.mark.parametrize("text", [BALL, FREE], ids=["ball", "free"])
@pytest.mark.parametrize("space", ["joint", "twist"])
def test_a_chain_with_a_ball_or_free_joint_is_compiled(text: str, space: Any) -> None:
    """Its Jacobian comes from MuJoCo: two frames, one of which the ball does not move."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(3)
    about_z = qt.TwistProjector(
        linear=qt.Projector.none(), angular=qt.Projector.line([0.0, 0.0, 1.0])
    )
    tool = qt.TwistTask.axis_free("tool", "site")
    turn = qt.TwistTask("other", "body", about_z)
    limits: list[mink.Limit] = [qt.MotionLimit(model, velocity=2.0, acceleration=None)]
    made = [
        qt.Controller(
            model, levels=[[tool], [turn]], limits=limits, solver="compiled",
            secondary=[qt.JointCentering(model)], secondary_space=space,
        )
        for _ in range(2)
    ]  # fmt: skip
    home = mink.Configuration(model)
    for _ in range(20):
        here = mink.Configuration(model, home.integrate(rng.uniform(-0.9, 0.9, model.nv), 1.0))
        for task in (tool, turn):
            pose = here.get_transform_frame_to_world(task.frame_name, task.frame_type)
            task.set_target(pose @ mink.SE3.exp(rng.uniform(-5e-3, 5e-3, 6)))
        compiled = made[0].step(here, 0.1)
        readable = by_reference(made[1]).step(here, 0.1)
        same(readable, compiled)
    assert made[0].reference_steps == 0


# ---------------------------------------------------------------- the result


def test_a_step_keeps_what_it_says_when_the_next_is_taken() -> None:
    controller, task, configuration = plain_controller("compiled")
    step = controller.step(configuration, 0.1)
    assert controller.reference_steps == 0
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
