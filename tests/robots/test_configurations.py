"""Configuration data: from joints to a pose and its data, and back, by the test's own matrices."""

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.data_sheets import RODS, SHEETS, data_of, links, places
from oracles.remodelled import remodelled

import qp_twist as qt
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.robots import ControllerArm, ToolChain, controller_joints, named_robot
from qp_twist.robots.axis_geometry import Line, axis_geometry
from qp_twist.robots.configurations import configuration, has_configuration

Array = np.ndarray


def arm_of(name: str, rng: np.random.Generator) -> tuple[ControllerArm, mujoco.MjModel, Array]:
    """A model with random zeros and signs, its arm, and the θ that are drawn inside the ranges."""
    robot = named_robot(name)
    signs = rng.choice([-1.0, 1.0], 6)
    offsets = np.zeros(6)
    offsets[1:3] = np.radians(rng.choice([-90.0, 0.0, 90.0, 180.0], 2))
    model = remodelled(robot, signs, offsets, tuple(rng.uniform(-0.3, 0.3, 3)), "tool")
    joints = controller_joints(model, "tool", "site", robot)
    chain = SerialChain.of(model, "tool", "site")
    tool = ToolChain(chain, JointRanges.of(model).names, "tool")
    arm = joints.with_tool(tool, robot).arm
    assert arm is not None
    return arm, model, drawn(name, rng)


def drawn(name: str, rng: np.random.Generator) -> Array:
    """Angles θ, degrees, inside the ranges of the robot; of rods those that ABB's sheet shows."""
    if name != RODS:
        low, high = np.array(named_robot(name).range_deg).T
        return rng.uniform(low, high)
    while True:
        theta = rng.uniform([-180, -100, -60, -200, -120, -400], [180, 110, 65, 200, 120, 400])
        theta[2] -= theta[1]  # shown is the forearm's angle to the floor
        if places(name, theta)[1] > 0.0:  # what the rods forbid
            return theta


def site(model: mujoco.MjModel, q: Array) -> Array:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.site("tool").xmat.reshape(3, 3), data.site("tool").xpos
    return pose


@pytest.mark.parametrize("name", SHEETS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_from_joints_to_pose_and_configuration_and_back(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, model, theta = arm_of(name, rng)
    q = (np.radians(theta) - arm.offsets) * arm.signs
    pose = site(model, q)
    # The base and the flange are the controller's: by the data sheet's lengths.
    flange = links(name, theta)[-1]
    there = arm.base.as_matrix() @ flange @ arm.tool_in_flange.as_matrix()
    assert np.abs(there - pose).max() < 1e-9
    data = arm.configuration(q)
    if abs(theta[4]) < 0.5 or min(map(abs, places(name, theta))) < 2e-3:
        return  # at a singularity no rule tells the joints
    turned = name == "Fanuc M-20iA"  # its third axis has more than a turn, of which no data say
    near = q + rng.uniform(-0.5, 0.5, 6) if turned else None
    found = arm.joints_at(mink.SE3.from_matrix(pose), data, near)
    assert np.abs(np.degrees(found - q)).max() < 1e-5


@pytest.mark.parametrize("name", SHEETS)
def test_the_numbers_mean_what_the_makers_say(name: str) -> None:
    robot, rng = named_robot(name), np.random.default_rng(1)
    seen = set()
    for _ in range(300):
        theta = drawn(name, rng)
        data = configuration(robot, np.radians(theta))
        assert data == data_of(name, theta)
        seen.add(
            data[-1 if name != RODS else 0]
            if robot.program == "rapid"
            else data[0]
            if robot.program == "krl"
            else data[:3]
        )
        assert has_configuration(robot, np.radians(theta), data)
        wrist = theta * [1, 1, 1, 1, -1, 1] + np.array([0, 0, 0, 180, 0, 180])
        assert not has_configuration(robot, np.radians(wrist), data)
    assert len(seen) >= 4


def test_public_points_of_kuka() -> None:
    """HOME of KUKA's templates is S 2, T 2; a wrist bent upwards in front of it S 6, T 18."""
    robot = named_robot("KUKA KR 16-2")
    for degrees, data in (([0, -90, 90, 0, 0, 0], (2, 2)), ([0, -90, 90, 0, -30, 0], (6, 18)),
                          ([-5, -90, 90, 0, 30, -9], (2, 35))):  # fmt: skip
        assert configuration(robot, np.radians(degrees)) == data


def test_what_no_rule_tells_is_refused() -> None:
    for name, words in (
        ("Universal Robots UR5e", "urscript, which has none"),
        ("Franka Emika Panda", "none of the languages"),
    ):
        robot = named_robot(name)
        with pytest.raises(qt.InvalidInput, match=words):
            configuration(robot, np.zeros(len(robot.lines)))
    arm, model, _ = arm_of("ABB IRB 120", np.random.default_rng(0))
    theta = np.radians([20.0, 10.0, 20.0, 30.0, 40.0, 50.0])
    q = (theta - arm.offsets) * arm.signs
    pose = mink.SE3.from_matrix(site(model, q))
    assert arm.configuration(q) == (0, 0, 0, 0)
    for data, words in (
        ((1, 0, 0, 0), r"no joint position in its ranges has the configuration \[1, 0, 0, 0\]"),
        ((0, 0, 0, 1), "no joint position"),
        ((0, 0, 4, 0), "no joint position"),  # a turn more: 410°
        ((0, 0, 0, 8), "cfx is 8; expected 0 to 7"),
        ((0, 0), "expected 4 numbers of a configuration, got 2"),
    ):
        with pytest.raises(qt.InvalidInput, match=words):
            arm.joints_at(pose, data)
    with pytest.raises(qt.InvalidInput, match=r"arrives with the configuration \[0, 0, 0, 0\]"):
        arm.check_configuration(q, (0, 0, 0, 1))
    arm, _, theta = arm_of(RODS, np.random.default_rng(0))
    with pytest.raises(qt.InvalidInput, match=r"cfx is 2; of an arm with parallel rods expected 0"):
        arm.check_configuration((np.radians(theta) - arm.offsets) * arm.signs, (0, 0, 0, 2))
    arm, _, _ = arm_of("ABB IRB 120", np.random.default_rng(0))
    far = mink.SE3.from_translation(np.array([9.0, 0.0, 0.0]))
    with pytest.raises(qt.InvalidInput, match="no joint position"):
        arm.joints_at(far, (0, 0, 0, 0))


@given(seed=st.integers(0, 10**6), parallel=st.booleans(), signs=st.tuples(*[st.booleans()] * 6))
def test_axes_that_count_backwards_have_the_geometry_of_the_turned_lines(
    seed: int, parallel: bool, signs: tuple[bool, ...]
) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(6, 3))
    if parallel:  # as the second, third and fourth of many arms
        axes[2] = axes[1]
        axes[3] = -axes[1]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    points = rng.normal(size=(6, 3))
    turn = np.where(signs, -1.0, 1.0)
    lines = [Line(axis, point) for axis, point in zip(axes, points, strict=True)]
    expected = axis_geometry([Line(s * a, p) for s, a, p in zip(turn, axes, points, strict=True)])
    found = axis_geometry(lines).turned(turn)
    assert found.is_like(expected) and expected.is_like(found)
    np.testing.assert_allclose(np.exp(1j * found.angles), np.exp(1j * expected.angles), atol=1e-9)
    np.testing.assert_allclose(found.lengths, expected.lengths, atol=1e-9)
