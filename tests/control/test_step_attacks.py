"""What a first user of prepared steps ran into: other robots and threads, what is written into."""

import copy
import sys
import threading
import warnings
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from oracles.same_steps import by_reference, plain_controller, same
from oracles.twists import at

import qp_twist as qt

pytestmark = pytest.mark.numerical
ARM = """<mujoco><compiler angle="radian"/><worldbody>{before}
  <body pos="0 0 .1"><joint name="j1" axis="0 0 1" range="-2 2"/><geom size=".02"/>
  <body pos="{reach} 0 0"><joint name="j2" axis="0 1 0" range="-2 2"/><geom size=".02"/>
  <body pos=".3 0 0"><joint name="j3" axis="0 1 0" range="-2 2"/><geom size=".02"/>
  <site name="tip" pos=".2 0 0"/>{behind}</body></body></body></worldbody></mujoco>"""


def arm(before: str = "", reach: float = 0.3, behind: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(before=before, reach=reach, behind=behind))


@pytest.mark.parametrize("sites", ["<site name='a'/>", "<site name='a'/><site name='b'/>"])
def test_the_same_arm_with_other_sites_is_another_robot(sites: str) -> None:
    one, other = arm(before=sites), arm(behind="<site name='c' pos='.2 .1 .3'/>")
    task = qt.TwistTask.point("tip", "site")
    for model, theirs in ((one, other), (other, one)):
        task.set_target_from_configuration(mink.Configuration(model))
        controller = qt.Controller(model, [task], limits=[], solver="compiled")
        with pytest.raises(qt.InvalidInput, match="same model"):
            controller.step(mink.Configuration(theirs, np.array([0.3, 0.4, 0.5])), 0.1)


def test_the_same_robot_read_again_or_with_other_lengths_is_taken() -> None:
    task = qt.TwistTask.point("tip", "site")
    task.set_target(at(0.6, 0.2, 0.05))
    controllers = [qt.Controller(arm(), [task], limits=[], solver=s) for s in ("daqp", "compiled")]
    by_reference(controllers[0])
    for reach in (0.3, 0.5):
        there = mink.Configuration(arm(reach=reach), np.array([0.3, 0.4, 0.5]))
        expected, step = (controller.step(there, 0.1) for controller in controllers)
        same(expected, step)


def test_one_controller_in_two_threads_gives_each_its_own_step() -> None:
    model = qt.load_task("deburring").model
    controller, _, first = plain_controller("compiled")
    places = [first, mink.Configuration(model, first.q + 0.1)]
    wanted = [controller.step(place, 0.1).velocity for place in places]
    assert np.abs(wanted[0] - wanted[1]).max() > 1e-3
    worst = [0.0, 0.0]

    def work(i: int) -> None:
        for _ in range(300):
            found = controller.step(places[i], 0.1).velocity
            worst[i] = max(worst[i], float(np.abs(found - wanted[i]).max()))

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    assert max(worst) < 1e-7


def test_a_limit_that_takes_a_step_of_its_own_does_not_disturb_the_one_it_is_asked_in() -> None:
    controller, _, configuration = plain_controller("daqp")
    free = controller.step(configuration, 0.1).velocity.copy()

    class Asks(mink.Limit):
        def compute_qp_inequalities(self, configuration: Any, dt: float) -> mink.Constraint:
            other = mink.Configuration(controller.model, configuration.q + 0.2)
            asked.limits, kept = [], asked.limits
            asked.step(other, dt)
            asked.limits = kept
            return mink.Constraint()

    asked = plain_controller("daqp", limits=[qt.PositionLimit(controller.model), Asks()])[0]
    np.testing.assert_allclose(asked.step(configuration, 0.1).velocity, free, atol=1e-9)


@pytest.mark.parametrize("gain", [1e300, np.inf, np.nan])
def test_what_overflows_is_refused_without_warnings(gain: float) -> None:
    controller, task, configuration = plain_controller("compiled")
    with pytest.raises((qt.InvalidInput, mink.InvalidGain)):
        task.gain = gain
    task._gain = gain  # type: ignore[attr-defined]  # as if no one had checked it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(qt.InvalidInput):
            controller.step(configuration, 0.1)


# ---------------------------------------------------------------- model and data replaced

LONGER = arm(behind="<body pos='.1 0 0'><joint name='j4' axis='0 1 0'/><geom size='.02'/></body>")
SHORTER = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint name='j1'/><geom size='.1'/></body></worldbody></mujoco>"
)
RENAMED = mujoco.MjModel.from_xml_string(
    ARM.format(before="", reach=0.3, behind="").replace("j3", "k3")
)


def data_of(model: mujoco.MjModel) -> mujoco.MjData:
    return mink.Configuration(model, np.full(model.nq, 0.3)).data


def other_data(model: mujoco.MjModel) -> Any:
    return lambda configuration: setattr(configuration, "data", data_of(model))


def other_model(model: Any) -> Any:
    return lambda configuration: setattr(configuration, "model", model)


REPLACED = {
    "data of the same robot": other_data(arm()),
    "data of one with other lengths": other_data(arm(reach=0.5)),
    "data of one with other names": other_data(RENAMED),
    "data of a longer robot": other_data(LONGER),
    "data deleted": lambda configuration: delattr(configuration, "data"),
    "data reset": lambda configuration: mujoco.mj_resetData(
        configuration.model, configuration.data
    ),
    "the same robot read again": other_model(arm()),
    "a model with other names": other_model(RENAMED),
    "no model": other_model(None),
}


@pytest.mark.parametrize("change", REPLACED)
def test_a_configuration_that_was_changed_after_a_step_is_looked_at_again(change: str) -> None:
    """The same as without a step before, and as the reference: a step, or a sentence."""
    task = qt.TwistTask.point("tip", "site")
    task.set_target(at(0.6, 0.2, 0.05))
    outcomes = []
    for prepared, steps_before in ((False, 0), (True, 0), (True, 1)):
        model = arm()
        controller = qt.Controller(model, [task], limits=[], solver="compiled")
        if not prepared:
            by_reference(controller)
        configuration = mink.Configuration(model, np.array([0.3, 0.4, 0.5]))
        for _ in range(steps_before):
            controller.step(configuration, 0.1)
        REPLACED[change](configuration)
        try:
            outcomes.append(controller.step(configuration, 0.1).velocity)
        except qt.InvalidInput as error:
            assert "configuration" in str(error)
            outcomes.append(str(error))
    expected = outcomes[0]
    taken = ("data of the same robot", "data of one with other lengths", "data reset",
             "the same robot read again")  # fmt: skip
    assert isinstance(expected, np.ndarray) == (change in taken)
    for outcome in outcomes[1:]:
        if isinstance(expected, str):
            assert outcome == expected
        else:
            np.testing.assert_allclose(outcome, expected, rtol=1e-9, atol=1e-9)


def test_a_copy_of_a_configuration_goes_its_own_way() -> None:
    task = qt.TwistTask.point("tip", "site")
    task.set_target(at(0.6, 0.2, 0.05))
    model = arm()
    controller = qt.Controller(model, [task], limits=[], solver="compiled")
    configuration = mink.Configuration(model, np.array([0.3, 0.4, 0.5]))
    expected = controller.step(configuration, 0.1).velocity
    other = copy.copy(configuration)
    np.testing.assert_array_equal(controller.step(other, 0.1).velocity, expected)
    other.data = data_of(SHORTER)
    with pytest.raises(qt.InvalidInput, match=r"configuration\.data belongs to a model"):
        controller.step(other, 0.1)
    np.testing.assert_array_equal(controller.step(configuration, 0.1).velocity, expected)
