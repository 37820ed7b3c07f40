"""What controllers show for the joints of models: zero positions, signs, couplings."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.real_robots import URDF, RealRobot, each
from oracles.remodelled import axes_at, remodelled

import qp_twist as qt
from qp_twist.robots import (
    KNOWN_ROBOTS,
    ControllerJoints,
    KnownRobot,
    controller_joints,
    known_robot,
    named_robot,
    read_robots,
)

SIX = [robot for robot in KNOWN_ROBOTS if robot.program]
QUARTERS = st.sampled_from([-90.0, 0.0, 90.0, 180.0])


@pytest.mark.parametrize("robot", SIX, ids=lambda robot: robot.name)
@given(
    signs=st.lists(st.sampled_from([-1.0, 1.0]), min_size=6, max_size=6),
    quarters=st.tuples(QUARTERS, QUARTERS),
    base=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    q=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
)
@settings(max_examples=6, deadline=None)
def test_zero_positions_and_signs_of_any_model_are_found(
    robot: KnownRobot, signs: list[float], quarters: tuple[float, float],
    base: tuple[float, float, float], q: list[float],
) -> None:  # fmt: skip
    s, o = np.array(signs), np.radians([0.0, *quarters, 0.0, 0.0, 0.0])
    model = remodelled(robot, s, o, base)
    joints = controller_joints(model, "tip", "site", robot)
    theta = joints.signs * np.array(q) + joints.offsets
    assert theta == pytest.approx(s * np.array(q) + o, abs=1e-6)
    # MuJoCo's axes at q are the robot's at theta, and turn the same way.
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    bed = model.body("base").id
    R, p = data.xmat[bed].reshape(3, 3), data.xpos[bed]
    for axis, anchor, sign, (direction, point) in zip(
        data.xaxis, data.xanchor, joints.signs, axes_at(robot, theta), strict=True
    ):
        assert sign * axis == pytest.approx(R @ direction, abs=1e-6)
        assert np.cross(anchor - p - R @ point, axis) == pytest.approx(np.zeros(3), abs=1e-6)


def test_the_coupling_of_a_fanuc_is_the_forearm_s_angle_to_the_floor() -> None:
    task = qt.load_task("deburring")
    robot = known_robot(task.model, task.frame_name, task.frame_type, (task.scene.stem,))
    assert robot is not None
    joints = controller_joints(task.model, task.frame_name, task.frame_type, robot)
    assert joints.equations([f"J{k}" for k in range(1, 7)])[2] == "J3 = joint_3 - J2"
    data = mujoco.MjData(task.model)
    for q2, q3 in ((0.3, 0.2), (-0.4, 0.9)):
        data.qpos[:6] = [0.7, q2, q3, 0.0, 0.0, 0.0]
        mujoco.mj_kinematics(task.model, data)
        # With a straight wrist the forearm is along axis 4; up is positive.
        along = -data.xaxis[task.model.joint("joint_4").id]
        shown = joints.shown(data.qpos[None, :6])[0]
        assert np.sin(shown[2]) == pytest.approx(along[2], abs=1e-9)
        assert joints.positions(shown[None])[0] == pytest.approx(data.qpos[:6])


def test_zero_of_a_kuka_is_the_horizontal_arm_and_a3_90_the_bent_one() -> None:
    robot = named_robot("KR 16-2")
    model = remodelled(
        robot, np.ones(6), np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]), (0.0, 0.0, 0.0)
    )
    joints = controller_joints(model, "tip", "site", robot)
    shown = np.degrees(joints.shown(np.zeros((1, 6))))[0]
    assert shown == pytest.approx([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    assert joints.equations([f"A{k}" for k in range(1, 7)])[1] == "A2 = joint_2 - 90 deg"
    # Data sheet: at A2 = -90, A3 = 90 the elbow is 680 above the shoulder, the wrist 670 ahead.
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    elbow, wrist = data.xanchor[2] - data.xanchor[1], data.xanchor[4] - data.xanchor[2]
    assert elbow == pytest.approx([0.0, 0.0, 0.68], abs=1e-9)
    assert wrist[0] == pytest.approx(0.67, abs=1e-9)


@pytest.mark.parametrize("robot", each(URDF))
def test_urdfs_of_ros_industrial_count_as_the_controller(robot: RealRobot) -> None:
    model = robot.load().model
    found = known_robot(model, robot.frame, "body", (robot.path.stem,))
    if found is None or found.program is None:
        return
    joints = controller_joints(model, robot.frame, "body", found)
    assert (joints.signs == 1.0).all()
    assert joints.offsets == pytest.approx(np.zeros(6))


def test_rates_and_ranges() -> None:
    joints = ControllerJoints.of_robot(named_robot("Fanuc M-16iB/20"), [f"j{k}" for k in range(6)])
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 6))
    step = 1e-6 * q[1]
    assert joints.shown(q[:1] + step) - joints.shown(q[:1]) == pytest.approx(
        joints.shown_rates(step[None]), abs=1e-12
    )
    assert joints.rates(joints.shown_rates(q)) == pytest.approx(q)
    assert joints.outside(q) == ""
    assert "axis 2 (j1) would be at 171.8873°, outside -90° to 160°" in joints.outside(
        np.array([[0.0, 3.0, 0.0, 0.0, 0.0, 0.0]])
    )


def test_another_arm_is_refused() -> None:
    robot, other = named_robot("UR5e"), named_robot("UR10e")
    model = remodelled(robot, np.ones(6), np.zeros(6), (0.0, 0.0, 0.0))
    with pytest.raises(qt.InvalidInput, match="not those of the Universal Robots UR10e"):
        controller_joints(model, "tip", "site", other)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "one or more tables"),
        ("[[robot]]\nname = 'x'\n", r"\[\[robot\]\] 1, axes"),
        ("[[robot]]\nname = 1e", "no TOML"),
        ("[[robot]]\nname='x'\naxes=[[0,0,1],[0,0,0]]\npoints_mm=[[0,0,0],[0,0,0]]\n"
         "speeds_deg=[1,1]\nsource='s'", "length zero"),
        ("[[robot]]\nname='x'\naxes=[[0,0,1],[0,1,0]]\npoints_mm=[[0,0,0]]\n"
         "speeds_deg=[1,1]\nsource='s'", "points_mm: 1 entries, but there are 2 axes"),
        ("[[robot]]\nname='x'\naxes=[[0,0,1],[0,1,0]]\npoints_mm=[[0,0,0],[0,0,nan]]\n"
         "speeds_deg=[1,1]\nsource='s'", "points_mm.1.2"),
    ],
)  # fmt: skip
def test_a_table_of_one_s_own_with_mistakes(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(qt.InvalidInput, match=words):
        read_robots(path)


def test_names() -> None:
    assert named_robot("ur5e") is named_robot("Universal Robots UR5e")
    with pytest.raises(qt.InvalidInput, match="there is no robot 'ur6e'"):
        named_robot("ur6e")
