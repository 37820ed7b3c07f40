"""Damaged and malicious files: every reader reads them or refuses them, whatever is in them."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import numpy as np
import pytest
from oracles.mutations import mutated

import qp_twist as qt
from qp_twist.paths import read_toolpath, shipped_folder
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import joints_of, read_trajectory, write_trajectory

TASKS, SCENES = shipped_folder("tasks"), shipped_folder("scenes")
NAMES = tuple(f"joint_{k}" for k in range(1, 7))
JOINTS = ControllerJoints.as_modelled(NAMES)
OF_FANUC = joints_of(qt.load_task("deburring"), NAMES)  # LS couples J3 to J2

APT = """PARTNO/BRACKET
UNITS/MM
MULTAX/ON
RAPID
GOTO/-60,-40,50,0,0,1
FEDRAT/600,MMPM
GOTO/-60,-40,0,0,0,1
GOTO/40,-40,0,0,0,1
CIRCLE/40,-20,0,0,0,1,20
GOTO/60,-20,0,0,0,1
MOVARC/40,-20,0,0,0,1,20,ANGLE,90
GODLTA/-10,0,0
INDIRV/-1,0,0
TLON,GOFWD/(CIRCLE/30,-20,0,20),ON,(LINE/30,-40,0,30,40,0)
SPINDL/3000,RPM
FEDRAT/0.1,MMPR
TLAXIS/0,0.6,0.8
GOTO/-60,40,0
FINI
"""
GCODE = """%
O1000 (PART)
G21 G90 G17
G0 X0. Y0. Z10. B0. C0.
G43.4 H1
G1 X0. Y0. Z0. B0. F600.
G1 X1. Y0. Z0. B10. C20.
G2 X11. Y10. I10. J0.
G3 X1. Y0. R20.
G91 G1 X2. Y0. Z0. B0.
G90 G53 Z0.
M30
%
"""
CSV = "x [mm],y [mm],z [mm],nx,ny,nz,feed [mm/s]\n" + "".join(
    f"{'' if k else chr(10) + 'Seam 2' + chr(10)}{k},{2 * k},{0.5 * k},0,0.6,0.8,{10 + k}\n"
    for k in (1, 2, 3, 0, 4, 5)
)
URDF = """<?xml version="1.0"?>
<robot name="r">
<link name="a"><collision><geometry><box size=".1 .1 .1"/></geometry></collision>
<visual><origin xyz="0 0 0" rpy="0 0 0.1"/>
<geometry><mesh filename="m.obj" scale="1 1 1"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><mesh filename="package://p/m.stl"/></geometry></collision></link>
<link name="c"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/>
<origin xyz="0 0 1" rpy="0 1.57 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="k" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="j" multiplier="2"/></joint>
</robot>
"""
XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.5"/>
  <xacro:property name="length" value="$(arg length)"/>
  <xacro:macro name="hinge" params="name parent child z">
    <link name="${child}"/>
    <joint name="${name}" type="continuous">
      <parent link="${parent}"/><child link="${child}"/><origin xyz="0 0 ${z}"/>
    </joint>
  </xacro:macro>
  <link name="base"/>
  <xacro:hinge name="a" parent="base" child="upper" z="0.3"/>
  <xacro:hinge name="b" parent="upper" child="lower" z="${2 * length / 2}"/>
</robot>
"""
OBJ = "mtllib m.mtl\nusemtl m\n" + (
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
)
MTL = "newmtl m\nKd 1 0 0\nd 1.0\n"


def _stl() -> bytes:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    triangles = b"".join(
        np.zeros(3, "<f4").tobytes() + corners[face].tobytes() + b"\0\0" for face in faces
    )
    return bytes(80) + np.array(len(faces), "<u4").tobytes() + triangles


def _robot(file: Path) -> Any:
    """The robot whose mesh a file is."""
    (file.parent / "r.urdf").write_text(URDF.replace("package://p/", ""), "utf-8")
    return qt.load_robot(file.parent / "r.urdf")


def _trajectory(file: Path) -> Any:
    return read_trajectory(file, NAMES)


def _program(file: Path) -> Any:
    return read_trajectory(file, NAMES, OF_FANUC if file.suffix == ".ls" else JOINTS)


def _gcode(file: Path) -> Any:
    return read_toolpath(file, rotary="table-bc")


READERS: dict[str, Callable[[Path], Any]] = {
    "p.apt": lambda file: read_toolpath(file, arc_axis="right"),
    "p.nc": _gcode,
    "p.csv": read_toolpath,
    "t.csv": _trajectory,
    "t.json": _trajectory,
    "t.npz": _trajectory,
    "t.mcap": _trajectory,
    "t.mod": _program,
    "t.src": _program,
    "t.ls": _program,
    "t.script": _program,
    "r.urdf": qt.load_robot,
    "r.xacro": qt.load_robot,
    "r.xml": qt.load_robot,
    "m.obj": _robot,
    "m.mtl": _robot,
    "m.stl": _robot,
    "task.toml": qt.load_task,
}
"""Who reads a file of each name."""


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a valid file of each format."""
    folder = tmp_path_factory.mktemp("valid")
    texts = {"p.apt": APT, "p.nc": GCODE, "p.csv": CSV, "r.urdf": URDF, "r.xacro": XACRO,
             "m.obj": OBJ, "m.mtl": MTL}  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")
    (folder / "m.stl").write_bytes(_stl())
    task = (TASKS / "deburring_bands.toml").read_text("utf-8").replace("../scenes/", "")
    (folder / "task.toml").write_text(task, "utf-8")
    shutil.copy(SCENES / "planar_3r.xml", folder / "r.xml")
    q = np.linspace([0.1, -0.5, 0.3, 1.0, -1.2, 0.4], [0.3, -0.4, 0.2, 1.1, -1.1, 0.2], 6)
    metadata = {"task": "deburring", "x": [1e3], "units": dict.fromkeys(NAMES, "rad")}
    rows = qt.TimedPath(NAMES, q, np.arange(6.0), np.full((6, 6), 0.01), metadata)
    for ending in ("csv", "json", "npz", "mod", "src", "ls", "script"):
        write_trajectory(rows, folder / f"t.{ending}", OF_FANUC if ending == "ls" else JOINTS)
    with contextlib.suppress(qt.InvalidInput):  # the extra is not installed
        write_trajectory(rows, folder / "t.mcap")
    return folder


@pytest.mark.filterwarnings("ignore")  # of MuJoCo and trimesh on strange models
@pytest.mark.parametrize("name", READERS)
def test_a_mutated_file_is_read_or_refused(
    name: str, valid: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if not (valid / name).exists() or (name == "r.xacro" and not _has_xacro()):
        pytest.skip("an extra is not installed")
    read, content = READERS[name], (valid / name).read_bytes()
    for other in valid.iterdir():
        shutil.copy(other, tmp_path)
    read(tmp_path / name)
    refused = 0
    for number in range(100):
        (tmp_path / name).write_bytes(mutated(content, number))
        try:
            with np.errstate(all="ignore"):
                read(tmp_path / name)
        except mink.MinkError as error:
            refused += 1
            assert isinstance(error, qt.InvalidInput)
            assert name in str(error) or name.startswith("m."), f"mutation {number}: {error}"
    assert 0 < refused < 100 or name.startswith("m.")


def test_rows_without_units_are_no_table(tmp_path: Path) -> None:
    rows = qt.TimedPath(NAMES, np.zeros((3, 6)), np.arange(3.0))
    with pytest.raises(qt.InvalidInput, match="units of the joints"):
        write_trajectory(rows, tmp_path / "t.csv")
    assert write_trajectory(rows, tmp_path / "t.json").exists()


def _has_xacro() -> bool:
    try:
        import xacro  # noqa: F401
    except ImportError:
        return False
    return True


@pytest.mark.parametrize("value", [10**400, "x", None, {"joint_1": 10**400}])
@pytest.mark.parametrize("key", ["acceleration_limits", "task", "frame", "units", "interpolation"])
def test_metadata_may_hold_anything(key: str, value: object, tmp_path: Path) -> None:
    """A check refuses them or passes them over."""
    document = {
        "joint_names": NAMES,
        "points": [
            {"positions": [0.1 * k] * 6, "time_from_start": float(k)} for k in range(3)
        ],
        "metadata": {key: value, "generator": "qp_twist 1"},
    }  # fmt: skip
    (tmp_path / "t.json").write_text(json.dumps(document))
    rows = read_trajectory(tmp_path / "t.json", NAMES)
    with contextlib.suppress(qt.InvalidInput):
        assert not qt.check_trajectory(rows, qt.load_task("deburring")).passes
