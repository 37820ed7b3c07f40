"""The table of known robots against models that ship, and their own stated limits."""

import mujoco
import numpy as np
import pytest
from oracles.arms import random_arm
from oracles.real_robots import MJCF, URDF, RealRobot, each

import qp_twist as qt
from qp_twist.kinematics import JointRanges
from qp_twist.robots import KNOWN_ROBOTS, known_limits, known_robot

pytestmark = pytest.mark.numerical
EXPECTED = {
    "ur5e": "Universal Robots UR5e", "panda": "Franka Emika Panda", "iiwa": "KUKA LBR iiwa 7 R800",
    "kr16_2": "KUKA KR 16-2", "lbr_iiwa_14_r820": "KUKA LBR iiwa 14 R820",
}  # fmt: skip


@pytest.mark.parametrize("robot", each((*MJCF, *URDF)))
def test_shipped_models_are_recognised_and_no_other(robot: RealRobot) -> None:
    model = robot.load().model
    names = (robot.path.stem, robot.path.parent.name)
    found = known_robot(model, robot.frame, "body", names)
    assert (found.name if found else None) == EXPECTED.get(robot.name)
    # A frame halfway up the arm is not at its end.
    chain = [model.joint(j).id for j in range(3)]
    halfway = model.body(model.jnt_bodyid[chain[-1]]).name
    assert known_robot(model, halfway, "body", names) is None


@pytest.mark.parametrize("robot", each(URDF))
def test_the_table_says_what_urdfs_state_themselves(robot: RealRobot) -> None:
    loaded = robot.load()
    found = known_limits(loaded.model, robot.frame, "body", (robot.path.stem,))
    if found is None:
        return
    names = JointRanges.of(loaded.model).names
    for dof, speed in zip(found[1], found[0].speeds, strict=True):
        joint = names[dof]
        assert loaded.velocity_limits[joint] == pytest.approx(speed, rel=2e-4)


def test_the_paper_s_robot_is_known_with_the_limits_its_tasks_state() -> None:
    task = qt.load_task("deburring")
    assert task.known_limits is not None
    robot, speeds, accelerations = task.known_limits
    assert (accelerations == np.inf).all()  # the maker publishes none
    assert robot.name == "Fanuc M-16iB/20"
    assert speeds == pytest.approx(task.velocity_limits, rel=1e-4)
    assert qt.load_task("planar_line").known_limits is None


def test_each_line_of_the_table_is_complete() -> None:
    assert len({robot.name for robot in KNOWN_ROBOTS}) == len(KNOWN_ROBOTS)
    for robot in KNOWN_ROBOTS:
        count = len(robot.speeds_deg)
        assert len(robot.lines) == count
        assert robot.source
        assert (robot.speeds == np.radians(robot.speeds_deg)).all()
        assert all(60.0 < speed <= 1000.0 for speed in robot.speeds_deg)
        assert robot.program is None or count == 6


UR10E = {  # origin (m), rotation about x (rad) of each joint, from the maker's default_kinematics
    "shoulder_pan": ((0.0, 0.0, 0.1807), 0.0),
    "shoulder_lift": ((0.0, 0.0, 0.0), np.pi / 2),
    "elbow": ((-0.6127, 0.0, 0.0), 0.0),
    "wrist_1": ((-0.57155, 0.0, 0.17415), 0.0),
    "wrist_2": ((0.0, -0.11985, 0.0), np.pi / 2),
    "wrist_3": ((0.0, 0.11655, 0.0), -np.pi / 2),
}


def of_the_maker(name: str, longer: float = 0.0) -> mujoco.MjModel:
    """A UR10e as its maker's description has it; its forearm may be longer, m."""
    text = ""
    for joint, ((x, y, z), turn) in UR10E.items():
        at = x - longer if joint == "wrist_1" else x
        text += (
            f'<body name="{joint}_link" pos="{at} {y} {z}" euler="{turn} 0 0">'
            f'<joint name="{joint}_joint" axis="0 0 1"/><geom size="0.01"/>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco model="{name}"><compiler angle="radian"/><worldbody>{text}'
        f'<site name="tool0"/>{"</body>" * len(UR10E)}</worldbody></mujoco>'
    )


def test_an_arm_is_recognised_by_its_axes_under_its_makers_own_name() -> None:
    for name in ("ur", "left_arm"):
        found = known_robot(of_the_maker(name), "tool0", "site", ("ur.urdf", "urdf"))
        assert found is not None and found.name == "Universal Robots UR10e"
        assert found.speeds_deg == (120, 120, 180, 180, 180, 180)
    assert known_robot(of_the_maker("ur", longer=0.003), "tool0", "site") is None
    # The name of another robot is not overruled.
    assert known_robot(of_the_maker("ur5e"), "tool0", "site") is None


def test_slides_ball_joints_and_shapeless_arms_are_not_known() -> None:
    rng = np.random.default_rng(0)
    for model in (random_arm(rng, 6), random_arm(rng, 6, slides=True), random_arm(rng, 1)):
        assert known_robot(model, "tool", "site", ("ur5e", "panda")) is None
    ball = mujoco.MjModel.from_xml_string(
        '<mujoco model="panda"><worldbody><body><joint type="ball"/><geom size="0.1"/>'
        '<site name="tool"/></body></worldbody></mujoco>'
    )
    assert known_robot(ball, "tool", "site") is None
    assert known_limits(ball, "tool", "site") is None
