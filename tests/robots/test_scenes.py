"""The scenes against what is known of the robots, and the picture that is drawn of them.

The expected kinematics is written out here from the robots' tables and from textbook formulas; none
of it is read from the MJCF files.
"""

import io
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from matplotlib import image as matplotlib_image
from scipy.spatial.transform import Rotation

from qp_twist.drawing import NoPicture, picture, picture_of
from qp_twist.drawing.palette import RED
from qp_twist.drawing.picture import draw_scene

Array = npt.NDArray[np.float64]

SCENES = Path(__file__).parents[2] / "scenes"
DEBURRING = SCENES / "m16ib_deburring.xml"
PLANAR = SCENES / "planar_3r.xml"
CELL = SCENES / "m16ib_cell.xml"

# Fanuc M-16iB/20, ros-industrial/fanuc: origin in the parent [m], axis, limits [rad].
M16IB = [
    ((0.0, 0.0, 0.525), (0.0, 0.0, 1.0), (-2.9671, 2.9671)),
    ((0.150, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.5708, 2.7925)),
    ((0.0, 0.0, 0.770), (0.0, -1.0, 0.0), (-2.9671, 5.0615)),
    ((0.0, 0.0, 0.100), (-1.0, 0.0, 0.0), (-3.4907, 3.4907)),
    ((0.740, 0.0, 0.0), (0.0, -1.0, 0.0), (-2.4435, 2.4435)),
    ((0.100, 0.0, 0.0), (-1.0, 0.0, 0.0), (-7.8540, 7.8540)),
]
FLANGE = Rotation.from_euler("xyz", [np.pi, -np.pi / 2, 0.0])  # URDF's roll, pitch, yaw
TOOL = Rotation.from_euler("y", 48.0, degrees=True)
TOOL_POSITION = np.array([0.032, 0.0, 0.260])
START = np.deg2rad([109.2, 1.6, -63.6, -33.6, 53.1, -137.7])


def pose(rotation: Array, position: Array) -> Array:
    """Return the 4x4 matrix of a pose."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = position
    return matrix


def m16ib_poses(q: Array) -> tuple[Array, Array]:
    """Return the poses of flange and tool: the table's product of exponentials."""
    flange = np.eye(4)
    for (origin, axis, _), angle in zip(M16IB, q, strict=True):
        turn = Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
        flange = flange @ pose(turn, np.array(origin))
    flange = flange @ pose(FLANGE.as_matrix(), np.zeros(3))
    return flange, flange @ pose(TOOL.as_matrix(), TOOL_POSITION)


def site_pose(model: mujoco.MjModel, name: str, q: Array) -> Array:
    """Return the pose of a site, computed by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    site = data.site(name)
    return pose(site.xmat.reshape(3, 3), site.xpos)


def random_configurations(model: mujoco.MjModel, count: int, seed: int) -> Array:
    """Return configurations inside the limits, shape (count, nq)."""
    low, high = model.jnt_range.T
    return np.random.default_rng(seed).uniform(low, high, size=(count, model.nq))


@pytest.fixture(scope="module")
def m16ib() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(DEBURRING))


@pytest.fixture(scope="module")
def planar_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(PLANAR))


# ------------------------------------------------------------------------------- Fanuc M-16iB/20


def test_m16ib_forward_kinematics_is_the_tables(m16ib: mujoco.MjModel) -> None:
    for q in random_configurations(m16ib, 200, seed=1):
        flange, tool = m16ib_poses(q)
        np.testing.assert_allclose(site_pose(m16ib, "flange", q), flange, rtol=0, atol=1e-12)
        np.testing.assert_allclose(site_pose(m16ib, "tool", q), tool, rtol=0, atol=1e-12)


def test_m16ib_kinematics_agrees_with_opw(m16ib: mujoco.MjModel) -> None:
    opw = pytest.importorskip("py_opw_kinematics")
    flip = (False, False, True, True, True, True)
    kinematics = opw.KinematicModel(
        a1=0.15, a2=-0.10, b=0.0, c1=0.525, c2=0.77, c3=0.74, c4=0.10,
        offsets=(0.0, 0.0, -np.pi / 2, 0.0, 0.0, np.pi), flip_axes=flip,
    )  # fmt: skip
    robot = opw.Robot(kinematics, degrees=False)
    for q in random_configurations(m16ib, 200, seed=2):
        flange = site_pose(m16ib, "flange", q)
        expected = robot.forward(tuple(q)).as_matrix()
        np.testing.assert_allclose(flange, expected, rtol=0, atol=1e-9)

    for q in random_configurations(m16ib, 50, seed=3):
        flange = site_pose(m16ib, "flange", q)
        branches = robot.inverse(opw.RigidTransform.from_matrix(flange))
        assert len(branches) >= 2
        # One branch is the configuration itself, up to full turns.
        turns = (np.array(branches) - q) / (2 * np.pi)
        assert np.min(np.abs(turns - np.round(turns)).max(axis=1)) < 1e-7
        for branch in branches:
            found = site_pose(m16ib, "flange", np.array(branch))
            np.testing.assert_allclose(found, flange, rtol=0, atol=1e-9)


def test_m16ib_reaches_as_far_as_the_makers_sheet_says(m16ib: mujoco.MjModel) -> None:
    # Horizontal reach of the wrist's centre (joint 5) from the axis of joint 1: 1.667 m.
    data = mujoco.MjData(m16ib)
    elbow = np.arctan2(0.1, 0.74)  # the arm lies level, and the forearm's offset is turned away
    data.qpos[:] = [0.0, np.pi / 2, np.pi / 2 - elbow, 0.0, 0.0, 0.0]
    mujoco.mj_kinematics(m16ib, data)
    assert np.hypot(*data.body("link_5").xpos[:2]) == pytest.approx(1.667, abs=5e-4)


def test_m16ib_start_touches_the_part(m16ib: mujoco.MjModel) -> None:
    q = m16ib.key("start").qpos
    np.testing.assert_allclose(q, START, rtol=0, atol=1e-15)
    assert (q > m16ib.jnt_range[:, 0]).all()
    assert (q < m16ib.jnt_range[:, 1]).all()
    tool = site_pose(m16ib, "tool", q)
    centre = np.array([0.0, 1.0, 0.3])
    corner = centre + np.array([-0.125, -0.125, np.sqrt(0.3**2 - 2 * 0.125**2)])
    assert np.linalg.norm(tool[:3, 3] - corner) < 1e-3
    assert tool[:3, 2] @ (centre - corner) / 0.3 > np.cos(np.deg2rad(0.1))  # z points into it


def test_the_part_is_where_the_task_is(m16ib: mujoco.MjModel) -> None:
    data = mujoco.MjData(m16ib)
    mujoco.mj_kinematics(m16ib, data)
    assert m16ib.geom("part").type == mujoco.mjtGeom.mjGEOM_SPHERE
    assert m16ib.geom("part").size[0] == 0.3
    np.testing.assert_array_equal(data.geom("part").xpos, [0.0, 1.0, 0.3])


# ------------------------------------------------------------------------------------- planar 3R


def test_planar_forward_kinematics_is_a_sum_of_cosines(planar_model: mujoco.MjModel) -> None:
    for q in random_configurations(planar_model, 200, seed=4):
        angles = np.cumsum(q)
        x = 2.0 * np.cos(angles[0]) + 1.5 * np.cos(angles[1]) + 1.0 * np.cos(angles[2])
        y = 2.0 * np.sin(angles[0]) + 1.5 * np.sin(angles[1]) + 1.0 * np.sin(angles[2])
        c, s = np.cos(angles[2]), np.sin(angles[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # x runs along the link
        expected = pose(turn, np.array([x, y, 0.0]))
        np.testing.assert_allclose(site_pose(planar_model, "tip", q), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scene", [DEBURRING, PLANAR], ids=lambda scene: scene.stem)
def test_scenes_collide_with_nothing_and_can_be_drawn(scene: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(scene))
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert model.camera("overview").id >= 0
    assert model.vis.global_.offwidth >= 1920
    assert model.vis.global_.offheight >= 1440


# -------------------------------------------------------------------------------------- the cell

HULLS = 3
"""Group of the links' hulls, which are not drawn."""


def outside(model: mujoco.MjModel, geom: int, points: Array) -> Array:
    """Return how far points of the body's frame are outside a hull, from textbook formulas."""
    turn = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
    local, size = turn.inv().apply(points - model.geom_pos[geom]), model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.linalg.norm(np.maximum(np.abs(local) - size, 0.0), axis=1)
    beyond = np.maximum(np.abs(local[:, 2]) - size[1], 0.0)
    across = np.linalg.norm(local[:, :2], axis=1)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.hypot(beyond, np.maximum(across - size[0], 0.0))
    assert kind == mujoco.mjtGeom.mjGEOM_CAPSULE
    return np.maximum(np.hypot(across, beyond) - size[0], 0.0)


def test_in_the_cell_the_same_arm_can_collide(m16ib: mujoco.MjModel) -> None:
    cell = mujoco.MjModel.from_xml_path(str(CELL))
    for q in random_configurations(m16ib, 20, seed=5):
        np.testing.assert_array_equal(site_pose(cell, "tool", q), site_pose(m16ib, "tool", q))
    able = (cell.geom_contype != 0) & (cell.geom_conaffinity != 0)
    assert able[cell.geom_group == HULLS].all()
    seen = {cell.geom(g).name for g in np.flatnonzero(able & (cell.geom_group != HULLS))}
    assert seen == {
        "floor", "part", "fixture", "table", "clamp_post", "clamp_lever",
        "low_clamp_post", "low_clamp_lever",
    }  # fmt: skip
    data = mujoco.MjData(cell)
    mujoco.mj_kinematics(cell, data)
    for lever in ("clamp_lever", "low_clamp_lever"):
        ids = cell.geom(lever).id, cell.geom("part").id
        gap = mujoco.mj_geomDistance(cell, data, *ids, 1.0, None)
        assert gap == pytest.approx(0.0, abs=1e-4)  # it holds the part


# ----------------------------------------------------------------------------------- the picture


def deburring_path() -> Array:
    """Return a square on the top cap of the part, shape (N, 3)."""
    corners = 0.125 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    s = np.linspace(0.0, 4.0, 161)
    x, y = (np.interp(s, np.arange(5), corners[:, i]) for i in range(2))
    return np.column_stack([x, 1.0 + y, 0.3 + np.sqrt(0.09 - x**2 - y**2)])


def drawn_or_skip(*arguments: Any, **options: Any) -> Array:
    """Return a picture's colours, shape (H, W, 3), from 0 to 1; without OpenGL, check the sentence
    and skip what follows.
    """
    try:
        png = draw_scene(*arguments, **options)
    except NoPicture as error:
        assert "apt-get install" in str(error)
        pytest.skip(str(error))
    return np.asarray(matplotlib_image.imread(io.BytesIO(png))[..., :3], dtype=float)


def is_yellow(picture: Array) -> npt.NDArray[np.bool_]:
    """Return which pixels have Fanuc's yellow."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    yellow = (red > 0.5) & (green > 0.6 * red) & (green < 0.95 * red) & (blue < 0.4 * red)
    return np.asarray(yellow)


def is_red(picture: Array) -> npt.NDArray[np.bool_]:
    """Return which pixels have the path's red."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    return np.asarray((red > 0.6) & (green < 0.35 * red) & (blue < 0.45 * red))


def test_picture_shows_arm_and_path(m16ib: mujoco.MjModel) -> None:
    picture = drawn_or_skip(m16ib, START, [(deburring_path(), RED)], width=480, height=360)
    assert picture.shape == (360, 480, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
    assert 0.04 < is_yellow(picture).mean() < 0.4
    rows, columns = np.nonzero(is_red(picture))
    assert rows.size > 50
    # The path lies on the part: to the right of the arm, in the picture's lower half.
    assert columns.mean() > np.nonzero(is_yellow(picture))[1].mean() + 50
    assert rows.mean() > 180
    # The whole arm is in the picture: none of it touches the border.
    border = np.ones(picture.shape[:2], dtype=bool)
    border[2:-2, 2:-2] = False
    assert not (is_yellow(picture) & border).any()


@pytest.mark.parametrize("far", ["", "<geom type='box' size='9 9 .1' pos='20 0 0'/>"])
def test_picture_of_a_scene_without_the_camera(far: str) -> None:
    """What moves is seen in the middle and large, whatever stands far away."""
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{far}<body pos='3 0 5'><joint/>"
        "<geom type='box' size='.2 .1 .1' rgba='0.1 0.8 0.1 1'/></body></worldbody></mujoco>"
    )
    path = np.array([[3.3, -0.2, 5.0], [3.3, 0.2, 5.2]])
    drawn = SimpleNamespace(model=model, start=np.zeros(1), positions=path, joint_moves=())
    try:
        png = picture_of(drawn, "", width=160, height=120).png
    except NoPicture as error:
        pytest.skip(str(error))
    picture = np.asarray(matplotlib_image.imread(io.BytesIO(png))[..., :3], dtype=float)
    green = (picture[..., 1] > 0.2) & (picture[..., 0] < 0.5 * picture[..., 1])
    rows, columns = np.nonzero(green)
    assert green.mean() > 0.02
    assert abs(columns.mean() - 80) < 30
    assert abs(rows.mean() - 60) < 30


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's offscreen OpenGL")
@pytest.mark.parametrize(("given", "used"), [(None, "egl"), ("", "egl"), ("glfw", "glfw")])
def test_opengl_is_offscreen_unless_the_user_says_otherwise(
    given: str | None, used: str, m16ib: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def run(*_: object, env: dict[str, str], **__: object) -> SimpleNamespace:
        seen.append(env["MUJOCO_GL"])
        return SimpleNamespace(returncode=1, stderr=b"an error")

    monkeypatch.setattr(subprocess, "run", run)
    if given is None:
        monkeypatch.delenv("MUJOCO_GL", raising=False)
    else:
        monkeypatch.setenv("MUJOCO_GL", given)
    with pytest.raises(NoPicture, match=f"MUJOCO_GL={used}: an error"):
        draw_scene(m16ib, START)
    assert seen == [used]


@pytest.mark.parametrize("backend", ["osmesa-nonsense", "disable"])
def test_broken_opengl_is_a_sentence(
    backend: str, m16ib: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", backend)
    with pytest.raises(NoPicture) as caught:
        draw_scene(m16ib, START, width=160, height=120)
    sentence = str(caught.value)
    assert sentence.startswith("No picture of the scene: ")
    assert f"MUJOCO_GL={backend}" in sentence
    assert "apt-get install libegl1 libgl1-mesa-dri" in sentence
    assert "unset MUJOCO_GL" in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("returncode", "said"),
    [
        (-int(signal.SIGSEGV), "Segmentation fault"),
        (-int(signal.SIGABRT), "Aborted"),
        (1, "exit status 1"),
    ],
)
def test_a_crash_of_opengl_is_a_sentence(
    returncode: int, said: str, m16ib: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = SimpleNamespace(returncode=returncode, stderr=b"")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: ended)
    with pytest.raises(NoPicture, match=f"{said}.*apt-get"):
        draw_scene(m16ib, START)


def test_a_hanging_driver_is_a_sentence(
    m16ib: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "TIMEOUT_S", 0.01)
    with pytest.raises(NoPicture, match="no picture within"):
        draw_scene(m16ib, START)
