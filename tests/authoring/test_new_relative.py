"""qp-twist new for parts that move: on a turn table, and in the hand before a tool in the cell."""

import re
import tomllib
import warnings
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from oracles.real_robots import URDF

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.cli import new as _command  # noqa: F401
from qp_twist.paths import shipped_folder

Array = npt.NDArray[np.float64]
KR16 = next(robot for robot in URDF if robot.name == "kr16_2")


def rim(file: Path, radius: float, height: float) -> None:
    """A quarter of a circle in millimetres, seen from above, with normals up."""
    angles = np.linspace(-0.8, 0.8, 9)
    rows = [f"{radius * np.cos(a)},{radius * np.sin(a)},{height},0,0,1" for a in angles]
    file.write_text("\n".join(["x [mm],y [mm],z [mm],nx,ny,nz", *rows]) + "\n", encoding="utf-8")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """The deburring arm before a turn table; a table without shapes collides with nothing."""
    arm = (shipped_folder("scenes") / "m16ib_deburring.xml").resolve().as_posix()
    file = tmp_path / "robot.xml"
    file.write_text(
        f"""
        <mujoco model="table">
          <compiler angle="radian" autolimits="true"/>
          <visual><map znear="0.02" zfar="30" shadowclip="1.7" shadowscale="0.9"/></visual>
          <asset><model name="arm" file="{arm}"/></asset>
          <worldbody>
            <body name="plate" pos="0 1 0.3">
              <joint name="turn" axis="0 0 1" range="-3 3"/>
              <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            </body>
            <attach model="arm" body="base" prefix="arm_"/>
          </worldbody>
        </mujoco>
        """,
        encoding="utf-8",
    )
    return file


def load(file: Path) -> qt.PathTask:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # meshes that a URDF lacks
        return qt.load_task(file)


def seen_from(
    scene: Path, body: str, tool: str, names: tuple[str, ...], q: Array
) -> tuple[Array, Array]:
    """Position and z of a site in a body's frame, by MuJoCo in the scene as it stands."""
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    found = []
    for row in q:
        for name, value in zip(names, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        turn = data.body(body).xmat.reshape(3, 3).T
        site = data.site(tool)
        found.append((turn @ (site.xpos - data.body(body).xpos), turn @ site.xmat[2::3]))
    positions, axes = zip(*found, strict=True)
    return np.array(positions), np.array(axes)


def on_the_rim(positions: Array, radius: float, height: float) -> None:
    assert np.abs(np.hypot(positions[:, 0], positions[:, 1]) - radius).max() < 1e-3  # chords of 11°
    assert np.abs(positions[:, 2] - height).max() < 1e-6
    turned = np.arctan2(positions[[0, -1], 1], positions[[0, -1], 0])
    assert np.abs(turned - [-0.8, 0.8]).max() < 1e-4


def test_a_table_of_the_robot_file_carries_the_part(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rim(tmp_path / "rim.csv", 100.0, 0.0)
    out = tmp_path / "table.toml"
    main(["new", str(robot), "--frame", "arm_tool", "--relative-to", "plate", "--path",
          str(tmp_path / "rim.csv"), "--place", "0,0,0.21", "--out", str(out)])  # fmt: skip
    assert "run by qp_gradient: passes" in capsys.readouterr().out
    stated = tomllib.loads(out.read_text("utf-8"))
    assert stated["robot"]["relative_to"] == "plate"
    assert stated["path"]["placement"]["position"] == [0, 0, 0.21]
    assert len(stated["start"]["q_deg"]) == 7
    task = load(out)
    run = qt.follow(task)
    positions, axes = seen_from(robot, "plate", "arm_tool", run.joint_names, run.q)
    on_the_rim(positions, 0.1, 0.21)
    assert np.abs(axes - [0.0, 0.0, -1.0]).max() < 1e-6
    # The file's start, in the order of the scene, is that of the run.
    model = mujoco.MjModel.from_xml_path(str(robot))
    names = [model.joint(j).name for j in range(model.njnt)]
    start = dict(zip(run.joint_names, np.degrees(run.path_task.start), strict=True))
    assert [start[name] for name in names] == pytest.approx(stated["start"]["q_deg"])


def test_a_hand_holds_the_part_to_a_tool_that_is_fixed_in_the_cell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rim(tmp_path / "rim.csv", 40.0, 100.0)
    block = trimesh.creation.box((120, 120, 100))
    block.apply_translation((0, 0, 50))
    block.export(tmp_path / "block.stl")
    trimesh.creation.cylinder(8, 60, segment=[[0, 0, 0], [0, 0, 60]]).export(tmp_path / "tool.stl")
    out = tmp_path / "grind.toml"
    main(["new", str(KR16.path), "--frame", "tool0", "--path", str(tmp_path / "rim.csv"), "--part",
          str(tmp_path / "block.stl"), "--tool", str(tmp_path / "tool.stl"), "--mesh-units", "mm",
          "--tool-at", "1.1,0.2,0.7", "--tcp", "0,0,0.06", "--place", "0,0,0.02,0,0,30",
          "--out", str(out)])  # fmt: skip
    said = capsys.readouterr().out
    assert "frame: site 'tcp', the tip of the tool in the cell; body tool0 holds the part" in said
    assert "run by qp_gradient: passes" in said
    stated = tomllib.loads(out.read_text("utf-8"))
    assert stated["robot"]["relative_to"] == "part"
    assert stated["path"]["placement"] == {"position": [0, 0, 0], "rpy_deg": [0, 0, 0]}
    assert ["tool", "part"] in stated["clearance"]["ignore"]
    assert "body" not in stated["study"]["placement"]
    task = load(out)
    run = qt.follow(task)
    scene = tmp_path / "grind_cell" / "scene.xml"
    on_the_rim(seen_from(scene, "part", "tcp", run.joint_names, run.q)[0], 0.04, 0.1)
    # The tip stands still in the cell, and the part is in the hand as --place says.
    model = mujoco.MjModel.from_xml_path(str(scene))
    robot = KR16.load().model
    rng = np.random.default_rng(2)
    for q in rng.uniform(-1.0, 1.0, (4, 6)):
        there, hand = mujoco.MjData(model), mujoco.MjData(robot)
        there.qpos[:], hand.qpos[:] = q, q
        mujoco.mj_kinematics(model, there)
        mujoco.mj_kinematics(robot, hand)
        np.testing.assert_allclose(there.site("tcp").xpos, [1.1, 0.2, 0.76], atol=1e-6)
        turn = hand.body("tool0").xmat.reshape(3, 3)
        at = hand.body("tool0").xpos + 0.02 * turn[:, 2]
        np.testing.assert_allclose(there.body("part").xpos, at, atol=1e-6)
        c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
        turned = turn @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(there.body("part").xmat.reshape(3, 3), turned, atol=1e-6)
    # The KUKA's program is that of the arm, which carries the part.
    main(["run", str(out), "--out", str(tmp_path / "grind.src")])
    assert "passes" in capsys.readouterr().out


def test_a_part_on_the_table_stands_on_its_plate(robot: Path, tmp_path: Path) -> None:
    """A mesh of the part is a body of the plate, and is moved by its joints."""
    rim(tmp_path / "rim.csv", 100.0, 0.0)
    plate = trimesh.creation.box((150, 150, 40))
    plate.apply_translation((0, 0, -20))
    plate.export(tmp_path / "part.stl")
    out = tmp_path / "table.toml"
    main(["new", str(robot), "--frame", "arm_tool", "--relative-to", "plate", "--path",
          str(tmp_path / "rim.csv"), "--place", "0,0,0.21", "--part", str(tmp_path / "part.stl"),
          "--mesh-units", "mm", "--out", str(out)])  # fmt: skip
    model = load(out).shown.model
    parent = int(model.body("part").parentid[0])
    assert model.body(parent).name == "plate"
    assert np.abs(model.body("part").pos - [0.0, 0.0, 0.21]).max() < 1e-9


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--relative-to", "plat"], "--relative-to: the scene has no body 'plat'; did you mean"),
        (["--relative-to", "arm_link_6", "--frame", "arm_tool"], "no frame 'arm_tool' that moves"),
        (["--relative-to", "plate", "--tool-at", "1,0,1"], "--relative-to: with a tool"),
        (["--tool-at", "1,0"], "--tool-at '1,0': expected three numbers"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    rim(tmp_path / "rim.csv", 100.0, 0.0)
    with pytest.raises(SystemExit):
        main(["new", str(robot), "--path", str(tmp_path / "rim.csv"), *options,
              "--out", str(tmp_path / "task.toml")])  # fmt: skip
    assert re.search(re.escape(words), " ".join(capsys.readouterr().err.split()))
    assert not (tmp_path / "task.toml").exists()
