"""A robot, a toolpath and meshes become a scene in which distances are kept."""

import importlib.util
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh

import qp_twist as qt
from qp_twist.authoring import NewTask, Request, new_task
from qp_twist.authoring.solids import read_solid
from qp_twist.authoring.touching import watched
from qp_twist.cli import main
from qp_twist.cli import new as _command  # noqa: F401

SEVEN = Path("seven_axis_arm.xml")
PLACE = (0.45, 0.0, 0.3)


def box(file: Path, size: tuple[float, ...], at: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Path:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    mesh.export(file)
    return file


def bracket(file: Path, at: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Path:
    """An L of two boxes, 100 x 20 x 100 mm and 80 x 20 x 20 mm, as one closed prism."""
    outline = np.array([[0, 0], [100, 0], [100, 20], [20, 20], [20, 100], [0, 100]], dtype=float)
    top, bottom = (np.column_stack([outline, np.full(6, z)]) for z in (20.0, 0.0))
    cap = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    faces = [*cap, *([c + 6, b + 6, a + 6] for a, b, c in cap)]
    for k in range(6):
        n = (k + 1) % 6
        faces += [[k, k + 6, n + 6], [k, n + 6, n]]
    trimesh.Trimesh(np.vstack([top, bottom]) + at, faces).export(file)
    return file


def line(folder: Path) -> Path:
    """A line of 20 mm along x, its normals up."""
    rows = [f"{x};0;0;0;0;1" for x in (-10, 0, 10)]
    file = folder / "line.csv"
    file.write_text("\n".join(["x [mm];y [mm];z [mm];nx;ny;nz", *rows]), encoding="utf-8")
    return file


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return line(tmp_path)


def whole_cell(folder: Path) -> Request:
    """Tool, part and fixture around a line."""
    return Request(
        SEVEN, line(folder), frame="tool", place=PLACE, place_rpy_deg=(0.0, 0.0, 90.0),
        tool_mesh=box(folder / "cutter.stl", (20, 20, 60), (0, 0, 30)),
        tcp=(0.0, 0.0, 0.06, 0.0, 0.0, 45.0),
        part_mesh=box(folder / "block.obj", (60, 40, 50), (0, 0, -25)),
        fixture_meshes=(box(folder / "plate.stl", (300, 200, 20), (0, 0, -400)),), mesh_unit="mm",
        search_seconds=20.0,
    )  # fmt: skip


@pytest.fixture
def request_(tmp_path: Path) -> Request:
    return whole_cell(tmp_path)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> NewTask:
    """The whole cell, made once for all tests that look at it."""
    folder = tmp_path_factory.mktemp("whole")
    return new_task(whole_cell(folder), folder / "cell.toml")


def corners(model: mujoco.MjModel, name: str) -> np.ndarray:
    """Lowest and highest coordinates of a mesh geom in the world at qpos0, m, (2, 3)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mesh = model.geom_dataid[model.geom(name).id]
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    geom = data.geom(name)
    points = model.mesh_vert[first : first + count] @ geom.xmat.reshape(3, 3).T + geom.xpos
    return np.array([points.min(axis=0), points.max(axis=0)])


def at_random(
    robot: mujoco.MjModel, model: mujoco.MjModel, seed: int
) -> Iterator[tuple[mujoco.MjData, mujoco.MjData]]:
    """Two models with the same joints at the same random configurations."""
    rng = np.random.default_rng(seed)
    for q in rng.uniform(*robot.jnt_range.T, size=(5, robot.nq)):
        here, there = mujoco.MjData(robot), mujoco.MjData(model)
        here.qpos[:] = there.qpos[:] = q
        mujoco.mj_kinematics(robot, here)
        mujoco.mj_kinematics(model, there)
        yield here, there


def test_a_cell_has_everything_where_the_meshes_and_the_options_say(cell: NewTask) -> None:
    assert cell.runs, cell.notes
    task = qt.load_task(cell.path)
    model = task.model
    assert task.scene == cell.path.parent / "cell_cell" / "scene.xml"
    # The toolpath's frame is turned by 90°: the part is 40 mm wide along x, and 60 mm along y.
    at = np.array(PLACE)
    expected = at + 1e-3 * np.array([[-20, -30, -50], [20, 30, 0]])
    np.testing.assert_allclose(corners(model, "part"), expected, atol=1e-6)
    expected = at + 1e-3 * np.array([[-100, -150, -410], [100, 150, -390]])
    np.testing.assert_allclose(corners(model, "fixture"), expected, atol=1e-6)
    assert model.geom("floor").pos[2] == pytest.approx(0.3 - 0.41)
    # The tip is 60 mm along the frame's z, turned by 45° about it, at every configuration.
    robot = qt.load_robot(qt.load_task("deburring").scene.with_name(str(SEVEN))).model
    for here, there in at_random(robot, model, seed=1):
        turn = here.site("tool").xmat.reshape(3, 3)
        tip = here.site("tool").xpos + 0.06 * turn[:, 2]
        np.testing.assert_allclose(there.site("tcp").xpos, tip, atol=1e-7)
        c = np.sqrt(0.5)
        expected = turn @ np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]])
        np.testing.assert_allclose(there.site("tcp").xmat.reshape(3, 3), expected, atol=1e-6)
    assert (task.frame_name, task.frame_type) == ("tcp", "site")


def test_tool_and_part_may_touch_and_everything_else_keeps_5_mm(cell: NewTask) -> None:
    stated = tomllib.loads(cell.path.read_text("utf-8"))["clearance"]
    assert stated["distance"] == 0.005
    assert ["tool", "part"] in stated["ignore"]
    assert "# the tool works on the part" in cell.path.read_text("utf-8")
    (clearance,) = (c for c in cell.path_task.constraints if isinstance(c, qt.Clearance))
    pairs = {frozenset(name.split(" to ")) for name in clearance.names}
    assert {frozenset(("tool", "fixture")), frozenset(("tool", "floor"))} <= pairs
    assert frozenset(("tool", "part")) not in pairs
    assert not {frozenset(("part", "fixture")), frozenset(("part", "floor"))} & pairs  # still
    [count] = [note for note in cell.notes if "pairs of shapes keep 5 mm" in note]
    assert count.startswith(f"clearance: {len(clearance.pairs)} pairs")
    assert count.endswith(", of floor, link_2, link_4, link_6, tool, part, fixture.")
    [bare] = [note for note in cell.notes if "no shape" in note]
    assert bare == (
        "clearance: link_1, link_3, link_5, link_7 have no shape: nothing is checked for them."
    )
    assert any("tool and part may touch" in note for note in cell.notes)


def test_a_part_is_not_moved_with_the_path(request_: Request, tmp_path: Path) -> None:
    far = request_.changed(place=(5.0, 0.0, 0.3))
    made = new_task(far, tmp_path / "far.toml")
    assert not made.runs
    assert not any("MOVED" in note for note in made.notes)
    free = far.changed(place=None, toolpath=tmp_path / "far.csv")
    text = request_.toolpath.read_text("utf-8").replace(";0;0;0;0;1", ";0;5000;0;0;1")
    (tmp_path / "far.csv").write_text(text, encoding="utf-8")
    made = new_task(free, tmp_path / "free.toml")
    assert not any("MOVED" in note for note in made.notes)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"mesh_unit": None}, r"cutter\.stl.*--mesh-units mm or --mesh-units m"),
        ({"tcp": None}, r"cutter\.stl: where is its tip\? Add --tcp"),
        ({"part_mesh": Path("none.stl")}, r"none\.stl: there is no such mesh file"),
        ({"part_mesh": Path("part.step")}, r"part\.step: expected a mesh, STL, OBJ or DAE"),
    ],
)
def test_a_cell_that_is_refused_leaves_nothing_behind(
    change: dict[str, object], sentence: str, request_: Request, tmp_path: Path
) -> None:
    before = sorted(tmp_path.iterdir())
    with pytest.raises(qt.InvalidInput, match=sentence):
        new_task(request_.changed(**change), tmp_path / "cell.toml")
    assert sorted(tmp_path.iterdir()) == before


def test_a_scene_is_not_overwritten_unless_forced(request_: Request, tmp_path: Path) -> None:
    folder = tmp_path / "cell_cell"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(qt.InvalidInput, match=r"cell_cell.*--force"):
        new_task(request_, tmp_path / "cell.toml")
    refused = request_.changed(mesh_unit=None)
    with pytest.raises(qt.InvalidInput, match="--mesh-units"):
        new_task(refused, tmp_path / "cell.toml", force=True)
    assert (folder / "mine.txt").read_text("utf-8") == "mine"  # a failure changes nothing
    new_task(request_, tmp_path / "cell.toml", force=True)
    assert sorted(file.name for file in folder.iterdir()) == ["meshes", "scene.xml"]


def without(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    """As if a package were not installed."""
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == missing else real(name, *a)
    )


def test_the_hull_of_a_concave_mesh_is_said_to_be_larger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "coacd")
    solid = read_solid("fixture", bracket(tmp_path / "bracket.stl"), "mm")
    assert solid.pieces == ()
    # An L of 100² − 80² mm² in a hull of 100² − 80²/2 mm².
    assert f"{6800 / 3600:.3g} times the volume of the mesh" in solid.notes[0]
    assert "qp_twist[cell]" in solid.notes[0]
    assert read_solid("fixture", box(tmp_path / "box.stl", (10, 20, 30)), "mm").notes == ()


def test_the_pieces_of_a_concave_mesh_collide_and_the_mesh_is_drawn(
    request_: Request, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    low, high = -0.4, -0.38  # away from the path
    legs = [trimesh.creation.box(bounds=[(0, 0, low), (0.1, 0.02, high)]),
            trimesh.creation.box(bounds=[(0, 0.02, low), (0.02, 0.1, high)])]  # fmt: skip
    fake = SimpleNamespace(
        set_log_level=lambda level: None,
        Mesh=lambda vertices, faces: None,
        run_coacd=lambda mesh, **options: [(leg.vertices, leg.faces) for leg in legs],
        __spec__=importlib.util.spec_from_loader("coacd", None),
    )
    monkeypatch.setitem(sys.modules, "coacd", fake)
    fixtures = (bracket(tmp_path / "bracket.stl", (0, 0, 1e3 * low)),)
    request_ = request_.changed(part_mesh=None, fixture_meshes=fixtures)
    made = new_task(request_, tmp_path / "cell.toml")
    model = made.path_task.model
    assert not model.geom("fixture").contype[0] and not model.geom("fixture").conaffinity[0]
    assert model.geom("fixture").group[0] <= 2 < model.geom("fixture_piece_1").group[0]
    for piece in ("fixture_piece_1", "fixture_piece_2"):
        assert model.geom(piece).contype[0] and model.geom(piece).conaffinity[0]
    [note] = [note for note in made.notes if "convex pieces" in note]
    # The two boxes fill the L exactly.
    assert "divided into 2 convex pieces, 1 times the volume of the mesh (its hull 1.89)" in note


CHAIN = """\
<mujoco><compiler angle="radian"/><worldbody>
  <body name="base"><geom name="base" type="box" size="0.1 0.1 0.05"/>
  <body name="one" pos="0 0 0.3"><joint name="a" axis="0 0 1" range="-2 2"/>
    <geom name="one" type="sphere" size="0.06"/>
    <body name="two" pos="0.02 0 0"><joint name="b" axis="0 1 0" range="-1 1"/>
      <geom name="two" type="sphere" size="0.05" contype="0" conaffinity="0"/>
      <body name="three" pos="0.02 0 0"><joint name="c" axis="1 0 0" range="-2 2"/>
        <geom name="wrist" type="sphere" size="0.06"/>
        <geom name="rod" type="capsule" size="0.01" fromto="0.3 0 0 0.6 0 0"/>
</body></body></body></body></worldbody></mujoco>
"""


def test_pairs_that_always_touch_are_ignored_and_bare_links_named() -> None:
    found = watched(mujoco.MjModel.from_xml_string(CHAIN))
    assert found is not None
    # The spheres of one and three are never more than 40 mm apart, and 120 mm would be needed; the
    # rod begins 300 mm from them. Base and one are joined by a joint.
    assert [(pair.one, pair.other) for pair in found.ignored] == [("one", "wrist")]
    assert "each of 2000 random configurations" in found.ignored[0].why
    # base to wrist, base to rod, one to rod.
    assert found.notes[0] == "3 pairs of shapes keep 5 mm, of base, one, three."
    assert found.notes[-1] == "two has no shape: nothing is checked for it."


def test_the_command_takes_several_fixtures_and_says_what_it_watches(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    box(tmp_path / "plate.stl", (0.3, 0.2, 0.02), (0, 0, -0.4))
    box(tmp_path / "post.stl", (0.02, 0.02, 0.1), (0.3, 0.2, -0.3))
    main(["new", str(SEVEN), "--frame", "tool", "--path", str(path), "--place", "0.45,0,0.3",
          "--fixture", "plate.stl", "--fixture", "post.stl", "--mesh-units", "m",
          "--tcp", "0,0,0.05"])  # fmt: skip
    said = capsys.readouterr().out
    assert "pairs of shapes keep 5 mm" in said
    assert "run by qp_gradient: passes" in said
    model = qt.load_task("./task.toml").model
    assert corners(model, "fixture_2")[0] == pytest.approx([0.74, 0.19, -0.05])
    with pytest.raises(SystemExit):
        main(["new", str(SEVEN), "--path", str(path), "--tcp", "1,2", "--force"])
    assert "--tcp '1,2': expected three numbers in metres" in capsys.readouterr().err


WRIST = """
<mujoco model="wrist"><compiler angle="radian" autolimits="true"/>{asset}<worldbody>
<body name="l1" pos="0 0 0.36"><joint name="j1" axis="0 0 1" range="-2.9 2.9"/>{inertia}
<body name="l2" pos="0.12 0 0.1"><joint name="j2" axis="0 1 0" range="-1.7 2.2"/>{inertia}
<body name="l3" pos="0 0 0.5"><joint name="j3" axis="0 1 0" range="-2.4 1.6"/>{inertia}
<body name="l4" pos="0.1 0 0.06"><joint name="j4" axis="1 0 0" range="-3 3"/>{inertia}{four}
<body name="l5" pos="0.42 0 0"><joint name="j5" axis="0 1 0" range="-2.1 2.1"/>{inertia}
<body name="l6" pos="{length} 0 0"><joint name="j6" axis="1 0 0" range="-3 3"/>{inertia}{six}
<site name="tip" pos="0.05 0 0" euler="0 1.5707963267948966 0"/>
</body></body></body></body></body></body></worldbody></mujoco>
"""
TOUCHES = '<geom type="box" size="0.25 0.1 0.1" pos="0.25 0 0"/>'
"""The sphere of l6 is nowhere more than 10 mm outside of this, and has a radius of 60 mm."""


def wrist(file: Path, four: str = TOUCHES, six: float = 0.06, **other: str) -> Path:
    """An arm of six joints; shapes of its links 4 and 6 alone."""
    inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    sphere = f'<geom type="sphere" size="{six}"/>'
    parts = {"asset": "", "length": "0.09", "inertia": inertia, "four": four, "six": sphere}
    file.write_text(WRIST.format(**parts | other), encoding="utf-8")
    return file


def with_tool(robot: Path, path: Path, tmp_path: Path) -> Request:
    return Request(
        robot, path, frame="tip", place=(0.62, 0.0, 0.45), tcp=(0, 0, 0.1, 0, 0, 0),
        tool_mesh=box(tmp_path / "cutter.stl", (20, 20, 60), (0, 0, 70)), mesh_unit="mm",
    )  # fmt: skip


def ignored(file: Path) -> list[list[str]]:
    found: list[list[str]] = tomllib.loads(file.read_text("utf-8"))["clearance"]["ignore"]
    return found


def test_links_that_always_overlap_may_touch_but_not_what_the_outer_one_carries(
    path: Path, tmp_path: Path
) -> None:
    request = with_tool(wrist(tmp_path / "wrist.xml"), path, tmp_path)
    made = new_task(request, tmp_path / "task.toml")
    assert made.runs
    assert ignored(made.path) == [["l4 geom 1", "l6 geom 1"]]
    assert any(
        note.startswith("clearance: l4 geom 1 and l6 geom 1 may touch: nearer than 5 mm in each")
        for note in made.notes
    )
    [clearance] = qt.load_task(made.path).clearances
    assert set(clearance.names) == {"floor to l4", "floor to l6", "floor to tool", "l4 to tool"}


def test_what_an_srdf_beside_the_robot_disables_may_touch(path: Path, tmp_path: Path) -> None:
    """Pairs of its links alone: neither what they carry, nor those of another robot."""
    four = TOUCHES.replace("0.25 0.1 0.1", "0.15 0.02 0.02").replace('pos="0.25', 'pos="0.15')
    robot = wrist(tmp_path / "wrist.xml", four, 0.02)
    request = with_tool(robot, path, tmp_path)
    assert ignored(new_task(request, tmp_path / "task.toml").path) == []
    disabled = (
        '<robot name="{}"><disable_collisions link1="l6" link2="l4" reason="Never"/>'
        '<disable_collisions link1="l6" link2="gone"/></robot>'
    )
    names = {"floor to l4", "floor to l6", "floor to tool", "l4 to tool"}
    for name, inside, expected in (
        ("other.srdf", "another", False), ("other.srdf", "wrist", True), ("wrist.srdf", "x", True)
    ):  # fmt: skip
        (tmp_path / name).write_text(disabled.format(inside), encoding="utf-8")
        made = new_task(request, tmp_path / "task.toml", force=True)
        assert ignored(made.path) == ([["l4 geom 1", "l6 geom 1"]] if expected else [])
        assert (f"# {name} disables it: Never" in made.path.read_text("utf-8")) is expected
        [clearance] = qt.load_task(made.path).clearances
        assert set(clearance.names) == names | (set() if expected else {"l4 to l6"})
    (tmp_path / "wrist.srdf").write_text("<robot>", encoding="utf-8")
    with pytest.raises(qt.InvalidInput, match=r"wrist\.srdf: is not well-formed XML"):
        new_task(request, tmp_path / "task.toml", force=True)


def test_a_plan_names_a_pair_that_no_motion_takes_apart_as_the_task_file_needs_it(
    path: Path, tmp_path: Path
) -> None:
    request = with_tool(wrist(tmp_path / "wrist.xml"), path, tmp_path).changed(tool_mesh=None)
    file = new_task(request, tmp_path / "task.toml").path
    lines = file.read_text("utf-8").splitlines()
    pair = next(k for k, line in enumerate(lines) if line.startswith('  ["l4", "l6"],'))
    file.write_text("\n".join([*lines[:pair], *lines[pair + 1 :]]), encoding="utf-8")
    task = qt.load_task(file)
    sentence = "in each of 2000 random configurations these pairs are nearer: l4 to l6"
    with pytest.raises(qt.InvalidInput, match=sentence) as refused:
        qt.plan(task)
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.follow(task, "qp_gradient")
    line = re.search(r"ignore = \[.*?\]\]", str(refused.value))
    assert line is not None
    begin = next(k for k, line in enumerate(lines) if line.startswith("ignore"))
    lines[begin : lines.index("]") + 1] = [line[0]]
    file.write_text("\n".join(lines), encoding="utf-8")
    assert qt.plan(qt.load_task(file)).q is not None


LINK = """
<link name="{name}">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 {half}"/><geometry><mesh filename="package://arm/{mesh}.stl"/>
  </geometry></collision>
</link>"""
JOINT = """
<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="0.1234567891 0 {z}" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>
  <limit lower="-2.000000123" upper="2.1" velocity="1.5" effort="1"/></joint>"""


def urdf(folder: Path) -> Path:
    """An arm of six hinges whose links share one mesh file, and a fixed flange."""
    (folder / "arm").mkdir()
    trimesh.creation.box((0.04, 0.04, 0.1)).export(folder / "arm" / "bar.stl")
    parts = ['<link name="base"/>']
    above = "base"
    for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")):
        parts.append(LINK.format(name=f"link_{k}", half=0.1, mesh="bar"))
        parts.append(
            JOINT.format(name=f"joint_{k}", kind="revolute", parent=above, child=f"link_{k}",
                         z=0.2, axis=axis)
        )  # fmt: skip
        above = f"link_{k}"
    parts.append('<link name="flange"/>')
    parts.append(JOINT.format(name="fixed", kind="fixed", parent=above, child="flange", z=0.05,
                              axis="1 0 0"))  # fmt: skip
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return file


def test_what_is_no_solid_is_refused(tmp_path: Path) -> None:
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    flat.export(tmp_path / "flat.stl")
    with pytest.raises(qt.InvalidInput, match=r"flat\.stl: is flat"):
        read_solid("part", tmp_path / "flat.stl", "m")
    (tmp_path / "text.stl").write_text("no mesh", encoding="utf-8")
    with pytest.raises(qt.InvalidInput, match=r"text\.stl: "):
        read_solid("part", tmp_path / "text.stl", "m")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n", encoding="utf-8")
    with pytest.raises(qt.InvalidInput, match=r"empty\.obj: "):
        read_solid("part", tmp_path / "empty.obj", "m")


def test_open_and_huge_meshes_are_questioned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "coacd")
    mesh = trimesh.load(bracket(tmp_path / "bracket.stl"))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "open.stl")
    assert "not closed" in read_solid("fixture", tmp_path / "open.stl", "mm").notes[0]
    [note] = read_solid("part", box(tmp_path / "box.stl", (100, 20, 30)), "m").notes
    assert note == "box.stl: it is 100 m across: is the file in mm?"


def test_the_robot_of_a_urdf_is_the_same_in_its_scene(path: Path, tmp_path: Path) -> None:
    file = urdf(tmp_path)
    request = Request(
        file, path, frame="flange", place=(0.5, 0.1, 0.6), tcp=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
        search_seconds=2.0,
    )  # fmt: skip
    made = new_task(request, tmp_path / "arm.toml")
    robot, model = qt.load_robot(file).model, made.path_task.model
    np.testing.assert_array_equal(model.jnt_range, robot.jnt_range)  # MuJoCo writes six digits
    for here, there in at_random(robot, model, seed=2):
        flange = here.body("flange")
        tip = flange.xpos + 0.1 * flange.xmat.reshape(3, 3)[:, 2]
        np.testing.assert_allclose(there.site("tcp").xpos, tip, rtol=0, atol=1e-12)
    assert made.path_task.velocity_limits.tolist() == [1.5] * 6
    assert (tmp_path / "arm_cell" / "meshes" / "bar.stl").is_file()
    shutil.rmtree(tmp_path / "arm")
    assert qt.load_task(tmp_path / "arm.toml").model.nmesh == 1  # the scene stands on its own
