"""Xacro files: expanded without ROS, and what is said where that is not possible."""

import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest
from oracles.real_robots import URDF
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.cli import new as _command  # noqa: F401
from qp_twist.errors import InvalidInput
from qp_twist.robots import load_robot

ARM = """\
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.5"/>
  <xacro:include filename="$(find parts)/joint.xacro"/>
  <link name="base"/>
  <xacro:hinge name="a" parent="base" child="upper" z="0.3"/>
  <xacro:hinge name="b" parent="upper" child="lower" z="${2 * length / 2}"/>
  <xacro:if value="$(arg hand)">
    <xacro:hinge name="c" parent="lower" child="tool0" z="0.1"/>
  </xacro:if>
</robot>
"""
JOINT = """\
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="length" value="$(arg length)"/>
  <xacro:macro name="hinge" params="name parent child z">
    <link name="${child}">
      <visual><geometry><box size="0.05 0.05 0.05"/></geometry></visual>
      <inertial>
        <mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
      </inertial>
    </link>
    <joint name="${name}" type="revolute">
      <parent link="${parent}"/><child link="${child}"/>
      <origin xyz="0 0 ${z}"/><axis xyz="0 1 0"/>
      <limit lower="-2" upper="2" velocity="1" effort="1"/>
    </joint>
  </xacro:macro>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """An arm beside a package with its macros, in a folder of another name."""
    (tmp_path / "parts-main").mkdir()
    (tmp_path / "parts-main" / "package.xml").write_text("<package><name>parts</name></package>")
    (tmp_path / "parts-main" / "joint.xacro").write_text(JOINT)
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    (folder / "arm.urdf.xacro").write_text(ARM)
    return folder / "arm.urdf.xacro"


def heights(robot: qt.robots.Robot) -> dict[str, float]:
    data = mujoco.MjData(robot.model)
    mujoco.mj_kinematics(robot.model, data)
    bodies = range(1, robot.model.nbody)
    return {robot.model.body(k).name: float(data.xpos[k, 2]) for k in bodies}


def test_arguments_macros_and_packages_are_those_of_the_file(arm: Path) -> None:
    """Heights of the links by hand: 0.3, then the argument, then 0.1."""
    robot = load_robot(arm, arguments={"hand": "true"})
    assert heights(robot) == pytest.approx({"base": 0, "upper": 0.3, "lower": 0.8, "tool0": 0.9})
    robot = load_robot(arm, arguments={"hand": False, "length": 0.75})
    assert heights(robot) == pytest.approx({"base": 0, "upper": 0.3, "lower": 1.05})
    assert robot.velocity_limits == {"a": 1.0, "b": 1.0}


PANDA = ((0, 0.333, 0), (0, 0, -90), (0, 0.316, 90), (0.0825, 0, 90), (-0.0825, 0.384, -90),
         (0, 0, 90), (0.088, 0, 90), (0, 0.107, 0))  # fmt: skip
"""a, d, α in m and degrees: Craig's parameters of the maker's documentation, with the flange."""


def test_a_real_xacro_file_has_the_kinematics_of_the_data_sheet() -> None:
    folder = next(robot for robot in URDF if robot.package == "rtbdata").folder
    if folder is None:
        pytest.skip("rtb-data==2.0.0 is not installed")
    robots = folder / "xacro/qut_frankie_description/robots"
    model = load_robot(robots / "panda_arm.urdf.xacro").model
    assert model.njnt == 7
    rng = np.random.default_rng(0)
    for q in rng.uniform(-1.5, 1.5, (5, 7)):
        pose = np.eye(4)
        for (a, d, alpha), theta in zip(PANDA, [*q, 0.0], strict=True):
            step = np.eye(4)
            turn = Rotation.from_euler("x", alpha, degrees=True)
            step[:3, :3] = (turn * Rotation.from_euler("z", theta)).as_matrix()
            step[:3, 3] = turn.apply([0, 0, d]) + np.array([a, 0, 0])
            pose = pose @ step
        data = mujoco.MjData(model)
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        assert data.body("panda_link8").xpos == pytest.approx(pose[:3, 3], abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "arguments", "message"),
    [
        ("", "", {}, r"its argument 'hand' has no value; give one: .* --arg hand:=value"),
        ("", "", {"hand": True, "lenght": 1}, "it has no argument 'lenght'; it has 'length', 'ha"),
        ("find parts", "find nowhere", {"hand": True},
         r"the ROS package 'nowhere' is not found around the file. .* --package nowhere=folder"),
        ("/joint.xacro", "/none.xacro", {"hand": True}, "cannot expand it: .*none.xacro"),
        ("2 * length / 2", "length / 0", {"hand": True}, "cannot expand it: .*division by zero"),
        ("2 * length / 2", "width", {"hand": True}, "cannot expand it: .*'width' is not defined"),
        ("xacro:if", "xacro:whatever", {"hand": True}, "cannot expand it: .*xacro:whatever"),
        ("</xacro:if>", "", {"hand": True}, "cannot expand it: .*mismatched tag"),
        ("$(find parts)/joint", "arm.urdf", {"hand": True}, "it includes itself|too deep|recurs"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_expanded_is_refused_in_a_sentence(
    arm: Path, old: str, new: str, arguments: dict[str, bool], message: str
) -> None:
    arm.write_text(ARM.replace(old, new) if old else ARM)
    with pytest.raises(InvalidInput, match=message) as refused:
        load_robot(arm, arguments=arguments)
    assert "\n" not in str(refused.value)


def test_arguments_belong_to_xacro_files(arm: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.urdf"
    plain.write_text(
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='continuous'>"
        "<parent link='a'/><child link='b'/></joint></robot>"
    )
    assert load_robot(plain).model.njnt == 1
    with pytest.raises(InvalidInput, match="is no xacro file and has no arguments"):
        load_robot(plain, arguments={"hand": "true"})
    with pytest.raises(InvalidInput, match="expected values by name, got list"):
        load_robot(arm, arguments=["hand"])  # type: ignore[arg-type]


def test_new_takes_arguments_and_packages_and_writes_them_down(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere" / "xyz"
    elsewhere.parent.mkdir()
    (tmp_path / "parts-main").rename(elsewhere)
    (elsewhere / "package.xml").unlink()
    (tmp_path / "line.csv").write_text("x [m],y [m],z [m]\n0.2,0,0.7\n0.3,0,0.7\n")
    out = tmp_path / "arm.toml"
    words = ["new", str(arm), "--path", str(tmp_path / "line.csv"), "--out", str(out),
             "--frame", "tool0"]  # fmt: skip
    with pytest.raises(SystemExit):
        main(words)
    assert "--package parts=folder" in capsys.readouterr().err
    main([*words, "--package", f"parts={elsewhere}", "--arg", "hand:=true"])
    stated = tomllib.loads(out.read_text("utf-8"))["robot"]
    assert stated["packages"] == {"parts": "elsewhere/xyz"}
    assert stated["arguments"] == {"hand": "true"}
    assert heights(load_robot(arm, packages={"parts": elsewhere}, arguments={"hand": "true"}))
    assert qt.load_task(out).model.njnt == 3
    monkeypatch.chdir(tmp_path)  # a relative folder of a package is the task file's, not xacro's
    assert qt.load_task("./arm.toml").model.njnt == 3
    for option, text in (("--arg", "hand=true"), ("--package", "parts"), ("--arg", ":=1")):
        with pytest.raises(SystemExit):
            main([*words, "--force", option, text])
        assert "expected a name and a value" in capsys.readouterr().err
