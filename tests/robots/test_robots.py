"""Robots from files: real ones on tasks, URDF against its own tags, and what is refused."""

import re
import struct
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from oracles.arms import random_configuration
from oracles.real_robots import MJCF, URDF, RealRobot, each
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.errors import InvalidInput
from qp_twist.paths import load_scene
from qp_twist.robots import Robot, load_robot

Array = npt.NDArray[np.float64]

SPIN_FREE = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0.0, 0.0, 1.0]), frame="body"
)
INERTIAL = """<inertial><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>"""
RANGE = '<limit lower="-1" upper="2" effort="10" velocity="1.5"/>'
BOX = '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'


NAN = f"""<robot name="r"><link name="base"/><link name="a">{INERTIAL}</link>
    <joint name="j" type="continuous"><origin rpy="0 0 nan"/><parent link="base"/><child link="a"/>
    </joint></robot>"""


def seeded(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


# ------------------------------------------------------------------------------------ real robots


@pytest.mark.parametrize("real", each((*MJCF, *URDF)))
def test_a_real_robot_has_its_joints_and_a_frame_at_its_end(real: RealRobot) -> None:
    model = real.load().model
    assert model.nv == model.nq == real.joints
    turning = [model.body(real.frame).id]  # every joint moves the frame
    while turning[-1]:
        turning.append(int(model.body_parentid[turning[-1]]))
    assert set(model.jnt_bodyid.tolist()) <= set(turning)


@pytest.mark.parametrize("real", each((*MJCF, *URDF)))
def test_a_real_robot_reaches_a_target_inside_its_limits(real: RealRobot) -> None:
    robot = real.load()
    model, rng, dt = robot.model, seeded(real.name), 0.05
    speed = np.array([robot.velocity_limits.get(model.joint(j).name, 1.0) for j in range(model.nv)])
    start = random_configuration(model, rng, margin=0.1)
    there = start + rng.uniform(-0.3, 0.3, model.nq)
    limited = model.jnt_limited.astype(bool)
    low, high = np.where(limited[:, None], model.jnt_range, [[-np.inf, np.inf]]).T
    task = qt.TwistTask(real.frame, "body", SPIN_FREE)
    task.set_target_from_configuration(mink.Configuration(model, np.clip(there, low, high)))
    target = task.target
    assert target is not None

    configuration = mink.Configuration(model, start)
    controller = qt.Controller(model, [task], limits=[qt.MotionLimit(model, velocity=speed)])
    for _ in range(100):
        velocity = controller.step(configuration, dt).velocity
        assert (np.abs(velocity) <= speed + 1e-9).all()
        configuration.integrate_inplace(velocity, dt)
        assert ((low <= configuration.q) & (configuration.q <= high)).all()
        body = configuration.data.body(real.frame)
        axis = body.xmat.reshape(3, 3)[:, 2]
        distance = np.linalg.norm(body.xpos - target.translation())
        tilt = np.linalg.norm(np.cross(axis, target.rotation().as_matrix()[:, 2]))
        if distance < 1e-6 and tilt < 1e-6:
            break
    assert distance < 1e-6
    assert tilt < 1e-6
    assert axis @ target.rotation().as_matrix()[:, 2] > 0.0


# ----------------------------------------------------------------------- URDF against its own tags


def numbers(element: ET.Element | None, attribute: str, default: str) -> Array:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def link_poses(file: Path, q: dict[str, float]) -> dict[str, Array]:
    """Pose of every link by name, (4, 4), from the <origin> and <axis> tags of the joints."""
    root = ET.parse(file).getroot()
    joints = root.findall("joint")
    children = {joint.find("child").get("link") for joint in joints}  # type: ignore[union-attr]
    names = [link.get("name", "") for link in root.findall("link")]
    poses = {name: np.eye(4) for name in names if name not in children}
    while len(poses) < len(names):
        for joint in joints:
            parent, child = (joint.find(tag).get("link", "") for tag in ("parent", "child"))  # type: ignore[union-attr]
            if parent not in poses or child in poses:
                continue
            origin, motion = np.eye(4), np.eye(4)
            roll, pitch, yaw = numbers(joint.find("origin"), "rpy", "0 0 0")
            turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
            origin[:3, :3] = turn.as_matrix()
            origin[:3, 3] = numbers(joint.find("origin"), "xyz", "0 0 0")
            axis = numbers(joint.find("axis"), "xyz", "1 0 0")
            value = q.get(joint.get("name", ""), 0.0)
            if joint.get("type") in ("revolute", "continuous"):
                motion[:3, :3] = Rotation.from_rotvec(
                    value * axis / np.linalg.norm(axis)
                ).as_matrix()
            elif joint.get("type") == "prismatic":
                motion[:3, 3] = value * axis / np.linalg.norm(axis)
            poses[child] = poses[parent] @ origin @ motion
    return poses


def assert_poses_are_those_of_the_tags(robot: Robot, rng: np.random.Generator) -> None:
    model = robot.model
    data = mujoco.MjData(model)
    for _ in range(3):
        data.qpos[:] = random_configuration(model, rng)
        mujoco.mj_kinematics(model, data)
        q = {model.joint(j).name: float(data.qpos[j]) for j in range(model.njnt)}
        for name, pose in link_poses(robot.path, q).items():
            body = data.body(name)
            np.testing.assert_allclose(body.xpos, pose[:3, 3], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(body.xmat.reshape(3, 3), pose[:3, :3], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("real", each(URDF))
def test_every_link_of_a_real_urdf_is_where_its_tags_say(real: RealRobot) -> None:
    assert_poses_are_those_of_the_tags(real.load(), seeded(real.name))


@pytest.mark.parametrize("real", each(URDF))
def test_ranges_and_speeds_of_a_real_urdf_are_those_of_its_tags(real: RealRobot) -> None:
    robot = real.load()
    speeds = {}
    for joint in ET.parse(robot.path).getroot().findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") == "fixed" or limit is None:
            continue
        name = joint.get("name", "")
        ends = [float(limit.attrib["lower"]), float(limit.attrib["upper"])]
        assert robot.model.joint(name).range.tolist() == ends
        if float(limit.attrib["velocity"]) > 0.0:
            speeds[name] = float(limit.attrib["velocity"])
    assert robot.velocity_limits == speeds


# ------------------------------------------------------------------------------------ small URDFs


def link(name: str, inside: str = INERTIAL) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = RANGE) -> str:
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
        <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0.6 0 0.8"/>{inside}</joint>"""


def write(folder: Path, *parts: str, name: str = "robot.urdf") -> Path:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f'<robot name="r">{link("base", "")}{"".join(parts)}</robot>', "utf-8")
    return file


def one_joint(folder: Path, kind: str = "revolute", inside: str = RANGE) -> Path:
    return write(folder, link("a"), joint("j", kind, "base", "a", inside))


def write_stl(file: Path, size: float) -> None:
    """Write a binary STL of the tetrahedron on the origin with edges ``size`` along the axes."""
    file.parent.mkdir(parents=True, exist_ok=True)
    corners = np.vstack([np.zeros(3), size * np.eye(3)])
    faces = [corners[list(face)] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *face.ravel(), 0) for face in faces)
    file.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + body)


def mesh(name: str, tag: str = "collision") -> str:
    return f'<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}>'


def mesh_sizes(robot: Robot) -> list[float]:
    """Edge of each tetrahedron, from its volume size³/6, sorted."""
    model = robot.model
    sizes = []
    for index in model.geom_dataid[model.geom_dataid >= 0]:
        first, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
        a, b, c, d = model.mesh_vert[first : first + count].astype(float)
        sizes.append(float(np.cbrt(abs(np.linalg.det([b - a, c - a, d - a])))))
    return sorted(sizes)


def test_links_of_all_kinds_of_joints_are_where_the_tags_say(tmp_path: Path) -> None:
    file = write(
        tmp_path, *(link(name) for name in "abc"), link("tool0", ""), link("camera", ""),
        joint("turn", "revolute", "base", "a"), joint("spin", "continuous", "a", "b"),
        joint("slide", "prismatic", "b", "c"), joint("flange", "fixed", "c", "tool0", ""),
        joint("eye", "fixed", "base", "camera", ""),
    )  # fmt: skip
    robot = load_robot(str(file))
    assert_poses_are_those_of_the_tags(robot, np.random.default_rng(1))
    assert robot.left_out == ()
    assert robot.path == file
    assert repr(robot) == "Robot('robot.urdf', 3 joints)"
    task = qt.TwistTask("tool0", "body", SPIN_FREE)
    task.set_target_from_configuration(mink.Configuration(robot.model))
    assert np.linalg.matrix_rank(task.compute_jacobian(mink.Configuration(robot.model))) == 3


@pytest.mark.parametrize(
    ("kind", "limit", "expected"),
    [
        ("revolute", RANGE, (-1.0, 2.0)),
        ("prismatic", '<limit upper="0.5"/>', (0.0, 0.5)),
        ("continuous", RANGE, None),
        ("continuous", "", None),
        ("revolute", '<limit lower="0" upper="0"/>', None),
        ("revolute", "", None),
    ],
)
def test_a_joint_has_the_range_that_is_meant(
    kind: str, limit: str, expected: tuple[float, float] | None, tmp_path: Path
) -> None:
    robot = load_robot(one_joint(tmp_path, kind, limit))
    ranges = qt.JointRanges.of(robot.model)
    assert (ranges.lower[0], ranges.upper[0]) == (expected or (-np.inf, np.inf))
    told = [s for s in robot.left_out if "No range: joint 'j'" in s]
    assert bool(told) == (kind != "continuous" and expected is None)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [('velocity="1.5"', {"j": 1.5}), ('velocity="inf"', {}), ("", {}), ('velocity="0"', {})],
)
def test_velocity_limits_are_read_and_can_be_held(
    stated: str, expected: dict[str, float], tmp_path: Path
) -> None:
    robot = load_robot(one_joint(tmp_path, "continuous", f"<limit {stated}/>"))
    assert robot.velocity_limits == expected
    assert [s for s in robot.left_out if "No velocity limit: joint 'j'" in s] == [
        s for s in robot.left_out if stated == 'velocity="0"'
    ]
    limit = qt.MotionLimit(robot.model, velocity=robot.velocity_limits)
    assert limit.max_velocity.tolist() == [expected.get("j", np.inf)]


def test_a_joint_that_mimics_another_follows_it(tmp_path: Path) -> None:
    mimic = RANGE + '<mimic joint="lead" multiplier="-0.5" offset="0.3"/>'
    robot = load_robot(
        write(
            tmp_path,
            *(link(name) for name in "abc"),
            joint("follow", "revolute", "b", "c", mimic),
            joint("lead", "revolute", "base", "a"),
            joint("between", "prismatic", "a", "b"),
        )
    )
    model = robot.model
    data = mujoco.MjData(model)

    def violation(lead: float, follow: float) -> float:
        data.joint("lead").qpos, data.joint("follow").qpos = lead, follow
        mujoco.mj_forward(model, data)
        [value] = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        return float(value)

    assert model.neq == 1
    for lead in (-0.9, 0.0, 1.7):
        assert violation(lead, 0.3 - 0.5 * lead) == pytest.approx(0.0, abs=1e-12)
        assert abs(violation(lead, 0.4 - 0.5 * lead)) == pytest.approx(0.1)
    assert robot.left_out == ()


# ------------------------------------------------------------------------------ what is left out


@pytest.mark.parametrize(
    "place", ["pkg/robot.urdf", "pkg/urdf/deep/robot.urdf", "other/urdf/robot.urdf", "robot.urdf"]
)
def test_a_package_is_found_around_the_file(place: str, tmp_path: Path) -> None:
    write_stl(tmp_path / "pkg" / "meshes" / "part.stl", 0.5)
    parts = link("a", INERTIAL + mesh("package://pkg/meshes/part.stl"))
    robot = load_robot(write(tmp_path, parts, joint("j", "revolute", "base", "a"), name=place))
    assert robot.left_out == ()
    assert mesh_sizes(robot) == pytest.approx([0.5])


def test_a_package_is_where_the_caller_says(tmp_path: Path) -> None:
    write_stl(tmp_path / "pkg" / "part.stl", 0.5)
    write_stl(tmp_path / "elsewhere" / "part.stl", 0.7)
    parts = link("a", INERTIAL + mesh("package://pkg/part.stl"))
    file = write(tmp_path, parts, joint("j", "revolute", "base", "a"))
    robot = load_robot(file, packages={"pkg": tmp_path / "elsewhere"})
    assert mesh_sizes(robot) == pytest.approx([0.7])
    assert mesh_sizes(load_robot(file)) == pytest.approx([0.5])


def test_a_package_is_where_the_task_file_says(tmp_path: Path) -> None:
    write_stl(tmp_path / "elsewhere" / "part.stl", 0.7)
    parts = link("a", INERTIAL + mesh("package://pkg/part.stl"))
    write(tmp_path, parts, joint("j", "revolute", "base", "a"))
    scene = load_scene(tmp_path / "task.toml", "robot.urdf", {"pkg": "elsewhere"})
    assert mesh_sizes(scene) == pytest.approx([0.7])
    with pytest.raises(qt.TaskFileError, match=r"packages\.pkg: there is no folder"):
        load_scene(tmp_path / "task.toml", "robot.urdf", {"pkg": "nowhere"})


def test_meshes_of_one_name_and_of_one_file_keep_their_sizes(tmp_path: Path) -> None:
    write_stl(tmp_path / "one" / "part.stl", 0.5)
    write_stl(tmp_path / "two" / "part.stl", 0.8)
    write_stl(tmp_path / "meshes" / "third.stl", 0.2)
    shapes = mesh("one/part.stl") + mesh((tmp_path / "two" / "part.stl").as_uri())
    shapes += mesh("two/part.stl").replace("/></g", ' scale="2 2 2"/></g') + mesh("third.stl")
    robot = load_robot(
        write(
            tmp_path,
            '<mujoco><compiler meshdir="meshes"/></mujoco>',
            *(link("a", INERTIAL + shapes), joint("j", "revolute", "base", "a")),
        )
    )
    assert mesh_sizes(robot) == pytest.approx([0.2, 0.5, 0.8, 1.6])


def test_missing_and_unreadable_meshes_are_left_out_and_told(tmp_path: Path) -> None:
    write_stl(tmp_path / "good.stl", 0.5)
    (tmp_path / "bad.dae").write_text("<COLLADA/>")
    (tmp_path / "bad.stl").write_text("solid, but as text")
    shapes = (BOX, *map(mesh, ("package://gone/x.stl", "package://gone/y.stl", "near.stl")))
    shapes += (*map(mesh, ("good.stl", "bad.dae", "bad.stl")), mesh("package://far/z.stl"))
    file = write(
        tmp_path, link("a", INERTIAL + "".join(shapes)), joint("j", "revolute", "base", "a")
    )
    robot = load_robot(file)
    assert_poses_are_those_of_the_tags(robot, np.random.default_rng(2))
    assert mesh_sizes(robot) == pytest.approx([0.5])
    assert (robot.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX).sum() == 1
    assert robot.model.body("a").mass[0] == pytest.approx(2.0)  # a shape's fate is not the mass's
    gone, near, far, dae, unreadable = robot.left_out
    assert gone.startswith("Not found: 2 meshes of the package 'gone'.")
    assert "packages={'gone': folder}" in gone
    assert near == "Not found: mesh 'near.stl'."
    assert "1 mesh of the package 'far'" in far
    assert dae.startswith("Not readable: mesh 'bad.dae'; cannot be read as a mesh")
    assert unreadable.startswith("Not readable: mesh 'bad.stl'; MuJoCo refuses it")
    assert repr(robot) == "Robot('robot.urdf', 1 joint, left out: 5)"


def test_a_robot_left_without_a_shape_says_so(tmp_path: Path) -> None:
    file = write(tmp_path, link("a", INERTIAL + mesh("x.stl")), joint("j", "revolute", "base", "a"))
    robot = load_robot(file)
    assert "No shape" in robot.left_out[-1]
    assert_poses_are_those_of_the_tags(robot, np.random.default_rng(3))
    rods = robot.model.geom_bodyid > 0
    assert rods.any()
    assert set(robot.model.geom_type[rods]) == {int(mujoco.mjtGeom.mjGEOM_CAPSULE)}
    assert not robot.model.geom_contype.any()
    assert robot.model.body("a").mass[0] == pytest.approx(2.0)  # rods weigh nothing
    assert load_robot(one_joint(tmp_path)).left_out == ()  # nothing stated, nothing left out


@pytest.mark.parametrize(
    ("setting", "collision", "kept"),
    [
        ("", BOX, True), ("", "", True), ('discardvisual="false"', BOX, True),
        ('discardvisual="true"', BOX, False),
    ],
)  # fmt: skip
def test_visual_shapes_are_drawn_unless_the_file_discards_them(
    setting: str, collision: str, kept: bool, tmp_path: Path
) -> None:
    write_stl(tmp_path / "seen.stl", 0.5)
    robot = load_robot(
        write(
            tmp_path,
            f"<mujoco><compiler {setting}/></mujoco>",
            link("a", INERTIAL + mesh("seen.stl", "visual") + collision),
            joint("j", "revolute", "base", "a"),
        )
    )
    assert len(mesh_sizes(robot)) == kept
    seen = robot.model.geom_dataid >= 0
    assert not robot.model.geom_contype[seen].any()
    assert robot.left_out == ()


UNPHYSICAL = {
    "nothing": "",
    "no mass": INERTIAL.replace('mass value="2"', 'mass value="0"'),
    "no inertia": re.sub(r'i(..)="0\.0."', r'i\1="0"', INERTIAL),
    "unbalanced": INERTIAL.replace('izz="0.04"', 'izz="0.4"'),
    "indefinite": INERTIAL.replace('ixy="0"', 'ixy="0.3"'),
    "incomplete": "<inertial><mass value='1'/></inertial>",
}


@pytest.mark.parametrize("inertial", UNPHYSICAL.values(), ids=UNPHYSICAL.keys())
def test_a_link_of_no_physical_mass_gets_a_token(inertial: str, tmp_path: Path) -> None:
    robot = load_robot(
        write(
            tmp_path,
            *(link("a", inertial), link("b"), link("tool0", "")),
            *(joint("j", "revolute", "base", "a"), joint("k", "revolute", "a", "b")),
            joint("f", "fixed", "b", "tool0", ""),
        )
    )
    assert_poses_are_those_of_the_tags(robot, np.random.default_rng(3))
    [sentence] = robot.left_out
    assert sentence.startswith("No physical mass or inertia: link 'a'.")
    assert robot.model.body("b").mass[0] == pytest.approx(2.0)
    assert sorted(robot.model.body("b").inertia) == pytest.approx([0.02, 0.03, 0.04])


@pytest.mark.parametrize(
    "stated",
    [
        "package://pkg/meshes/arm%20of%20it.stl", "package://pkg/Meshes/ARM of it.STL",
        "meshes\\Arm of it.stl", "meshes/ARM OF IT.STL", " meshes/Arm of it.stl ",
        "model://pkg/meshes\\arm of it.STL",
    ],
)  # fmt: skip
def test_names_of_meshes_from_other_systems_are_found(stated: str, tmp_path: Path) -> None:
    folder = tmp_path / "pkg" / "meshes"
    folder.mkdir(parents=True)
    (tmp_path / "pkg" / "package.xml").write_text("<package><name>pkg</name></package>")
    write_stl(folder / "Arm of it.stl", 0.5)
    write_stl(folder / "other.stl", 0.7)
    shapes = link("a", INERTIAL + mesh(stated))
    robot = load_robot(write(tmp_path / "pkg", shapes, joint("j", "revolute", "base", "a")))
    assert mesh_sizes(robot) == pytest.approx([0.5])
    assert robot.left_out == ()


def test_a_mesh_that_a_found_package_lacks_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "pkg"
    folder.mkdir()
    (folder / "package.xml").write_text("<package><name>pkg</name></package>")
    shapes = link("a", INERTIAL + BOX + mesh("package://pkg/gone.stl"))
    [said] = load_robot(write(folder, shapes, joint("j", "revolute", "base", "a"))).left_out
    assert "Not found in the package 'pkg'" in said and str(folder) in said
    assert "'package://pkg/gone.stl'" in said and "Say where" not in said


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [
        ("utf-16", "UTF-16"), ("utf-8-sig", "utf-8"), ("latin-1", "ISO-8859-1"),
        ("utf-8", "no-such-encoding"),
    ],
)  # fmt: skip
def test_a_urdf_is_read_in_its_encoding(
    encoding: str, declared: str | None, tmp_path: Path
) -> None:
    file = write(tmp_path, link("Träger"), joint("j", "revolute", "base", "Träger"))
    text = file.read_text("utf-8")
    declaration = "" if declared is None else f'<?xml version="1.0" encoding="{declared}"?>\n'
    file.write_bytes((declaration + text).encode(encoding))
    robot = load_robot(file)
    assert robot.model.njnt == 1
    assert robot.model.body("Träger").id > 0


def test_a_second_root_link_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, link("a"), link("table"), joint("j", "revolute", "base", "a"))
    with pytest.raises(
        InvalidInput, match=r"2 links \('base', 'table'\) are the child of no joint"
    ):
        load_robot(file)
    arms = link("a"), link("b"), link("c")
    moves = joint("j", "revolute", "base", "a"), joint("k", "revolute", "b", "c")
    with pytest.raises(InvalidInput, match=r"'base', 'b'"):
        load_robot(write(tmp_path, *arms, *moves))


# --------------------------------------------------------------------------------- what is refused


def test_mjcf_is_what_mujoco_loads(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(
        "<?xml version='1.0'?>\n<!-- two -- dashes, <robot> -->\n<mujoco><worldbody><body>"
        "<joint name='j' range='0 90'/><geom size='1'/></body></worldbody></mujoco>"
    )
    robot = load_robot(file)
    np.testing.assert_allclose(robot.model.jnt_range, [[0.0, np.pi / 2]])
    assert (robot.velocity_limits, robot.left_out) == ({}, ())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "is empty or no XML at all"),
        ("solid part\nendsolid", "is empty or no XML at all"),
        ("<sdf version='1.7'/>", "starts with <sdf>"),
        ("<!DOCTYPE html><html/>", "starts with <html>"),
        ("<robot><link", "is not well-formed XML (unclosed token: line 1"),
        ("<!-- a\nb --><robot>\n<link></robot>", "line 3"),
        ("<mujoco><worldbody><nonsense/></worldbody></mujoco>", "MuJoCo cannot load this MJCF"),
        ("<mujoco/>", "the robot has no joint that moves"),
        (NAN, "body 'a': quat = [nan nan nan nan] cannot be computed with"),
        (NAN.replace("0 0 nan", "0 0"), "'rpy' does not have enough data"),
        ("<robot name='r'><link name='base'/></robot>", "the robot has no joint that moves"),
        ("<robot name='r' xmlns:xacro='x/xacro'><xacro:arm/></robot>", "xacro cannot expand it"),
        ("<robot name='r'><link name='${prefix}base'/></robot>", "xacro cannot expand it"),
    ],
)
def test_a_file_that_is_no_robot_is_refused_in_a_sentence(
    content: str, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(content)
    with pytest.raises(InvalidInput) as refused:
        load_robot(file)
    assert said in str(refused.value)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "inside", "said"),
    [
        ("floating", "", "joint 'j': its type is 'floating'"),
        ("planar", "", "joint 'j': its type is 'planar'"),
        ("revolut", "", "joint 'j': its type is 'revolut'"),
        ("revolute", '<limit lower="1" upper="-1"/>', "upside down, from 1 to -1"),
        ("revolute", '<limit lower="0.5" upper="0.5"/>', "one position 0.5; make it a fixed"),
        ("revolute", '<limit lower="a" upper="1"/>', "<limit lower='a'> is not a number"),
        ("revolute", '<limit upper="1" velocity="nan"/>', "<limit velocity='nan'> is not"),
        ("revolute", '<mimic joint="k"/>', "it mimics 'k', which is no other joint"),
        ("revolute", '<mimic joint="j"/>', "it mimics 'j', which is no other joint"),
    ],
)
def test_a_joint_that_contradicts_itself_is_refused(
    kind: str, inside: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=re.escape(said)):
        load_robot(one_joint(tmp_path, kind, inside))


def test_what_is_no_file_or_folder_is_refused(tmp_path: Path) -> None:
    file = one_joint(tmp_path)
    with pytest.raises(InvalidInput, match="there is no such MJCF or URDF file"):
        load_robot(tmp_path / "missing.urdf")
    with pytest.raises(InvalidInput, match="is a folder; give the MJCF or URDF file in it"):
        load_robot(tmp_path)
    with pytest.raises(InvalidInput, match="expected a str or a Path, got int"):
        load_robot(3)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match=r"packages\.arm: there is no folder .*nowhere"):
        load_robot(file, packages={"arm": tmp_path / "nowhere"})
    with pytest.raises(InvalidInput, match="expected folders by package name, got str"):
        load_robot(file, packages="arm")  # type: ignore[arg-type]


@pytest.mark.parametrize("levels", [150, 3_000, 100_000])
def test_elements_that_are_nested_too_deep_are_refused(levels: int, tmp_path: Path) -> None:
    nested = levels * "<sensor>" + levels * "</sensor>"
    with pytest.raises(InvalidInput, match="nested more than 100 deep"):
        load_robot(write(tmp_path, link("a"), joint("j", "revolute", "base", "a", RANGE), nested))


ONE_JOINT = """<mujoco><compiler angle="radian"/><worldbody><body name="arm" pos="0 0 0">
  <joint name="j" axis="0 0 1" pos="0 0 0" range="-2 2"/><geom name="g" pos="0 0 0" size="1"/>
  <site name="tip" pos="0 0 0"/></body></worldbody><keyframe><key qpos="0"/></keyframe></mujoco>"""


# MuJoCo takes each of them; at a NaN it prints a warning.
@pytest.mark.parametrize("number", ["nan", "inf", "1e200"])
@pytest.mark.parametrize(
    ("stated", "instead", "said"),
    [
        ('name="arm" pos="0 0 0"', 'name="arm" pos="0 {} 0"', "body 'arm': pos = ["),
        ('pos="0 0 0" range', 'pos="{} 0 0" range', "joint 'j': pos = ["),
        ('name="tip" pos="0 0 0"', 'name="tip" pos="0 0 {}"', "site 'tip': pos = ["),
        ('key qpos="0"', 'key qpos="{}"', "key 0: qpos = ["),
    ],
)
def test_a_number_that_cannot_be_computed_with_is_named(
    stated: str, instead: str, said: str, number: str, tmp_path: Path
) -> None:
    file = tmp_path / "arm.xml"
    assert stated in ONE_JOINT
    file.write_text(ONE_JOINT.replace(stated, instead.format(number)), "utf-8")
    mujoco.MjModel.from_xml_path(str(file))
    with pytest.raises(InvalidInput, match=re.escape(said)):
        load_robot(file)


# ---------------------------------------------------------------- in a task file


TASK = """title = "A point of a URDF arm"
[robot]
scene = "robot.urdf"
frame = "c"
frame_type = "body"
[projector]
linear = { line = [0, 0, 1] }
angular = "none"
[path]
kind = "polyline"
points = [[0.3, -0.5, 0.8], [0.3, -0.5, 0.85]]
steps_per_segment = 2
[start]
q = [0.1, 0.1, 0.1]
"""


def test_a_task_file_may_name_a_urdf_and_has_its_speeds(tmp_path: Path) -> None:
    bodies = [("a", "base"), ("b", "a"), ("c", "b")]
    parts = [link(n) + joint(f"j_{n}", "revolute", before, n) for n, before in bodies]
    write(tmp_path, *parts)
    file = tmp_path / "point.toml"
    file.write_text(TASK + "[feed]\nspeed = 0.1\n", "utf-8")
    task = qt.load_task(file)
    np.testing.assert_array_equal(task.velocity_limits, np.full(3, 1.5))
    run = qt.follow(task, "qp_minimum_norm")
    assert run.position_error.max() < 1e-6
    # What the file states comes first; without a clock speeds mean nothing.
    file.write_text(TASK + "[feed]\nspeed = 0.1\n[limits.velocity]\nj_a = 0.5\n", "utf-8")
    np.testing.assert_array_equal(qt.load_task(file).velocity_limits, [0.5, np.inf, np.inf])
    file.write_text(TASK, "utf-8")
    assert np.isinf(qt.load_task(file).velocity_limits).all()
    # What is left out is told, and a file that is no robot is refused in the loader's words.
    write(tmp_path, *parts[:2], link("c", INERTIAL + BOX + mesh("x.stl")),
          joint("j_c", "revolute", "b", "c"))  # fmt: skip
    with pytest.warns(UserWarning, match=r"robot\.urdf: .*x\.stl"):
        qt.load_task(file)
    (tmp_path / "robot.urdf").write_text("nonsense", "utf-8")
    with pytest.raises(qt.TaskFileError, match=r"robot\.scene: .*no XML"):
        qt.load_task(file)


def test_joints_of_one_name_are_refused(tmp_path: Path) -> None:
    parts = [link("a"), joint("j", "revolute", "base", "a")]
    file = write(tmp_path, *parts, link("b"), joint("j", "revolute", "a", "b"))
    with pytest.raises(qt.InvalidInput, match="the name of joint 'j' is given more than once"):
        load_robot(file)
