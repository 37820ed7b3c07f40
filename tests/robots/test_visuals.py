"""What a URDF states to be seen is drawn, in its colours, and collides with nothing."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from qp_twist.robots import load_robot
from qp_twist.robots.room import add_room

Array = np.ndarray
INERTIAL = (
    '<inertial><mass value="2"/>'
    '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>'
)
BOX = '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
RED, BLUE = (200, 20, 30, 255), (10, 40, 220, 255)


def robot(folder: Path, inside: str, more: str = "") -> Path:
    file = folder / "robot.urdf"
    file.write_text(
        f"<robot name='r'>{more}<link name='base'/><link name='a'>{INERTIAL}{inside}</link>"
        "<joint name='j' type='revolute'><parent link='base'/><child link='a'/>"
        "<origin xyz='0 0 1'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' velocity='1'/></joint>"
        "</robot>"
    )
    return file


def visual(geometry: str, origin: str = "", material: str = "") -> str:
    return f"<visual>{origin}<geometry>{geometry}</geometry>{material}</visual>"


def drawn(model: mujoco.MjModel) -> list[tuple[Array, Array]]:
    """Bounding box in the world at qpos0, m, and colour of every mesh that is drawn."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in np.flatnonzero(model.geom_dataid >= 0):
        assert model.geom_group[geom] <= 2
        assert not (model.geom_contype[geom] or model.geom_conaffinity[geom])
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        turn = data.geom_xmat[geom].reshape(3, 3)
        points = model.mesh_vert[first : first + count] @ turn.T + data.geom_xpos[geom]
        found.append((np.array([points.min(axis=0), points.max(axis=0)]), model.geom_rgba[geom]))
    return found


def two_boxes() -> trimesh.Scene:
    """A red box of 1 x 2 x 3 around the origin, and a blue unit cube at x = 10."""
    red = trimesh.creation.box((1, 2, 3))
    blue = trimesh.creation.box((1, 1, 1))
    blue.apply_translation((10, 0, 0))
    for mesh, colour in ((red, RED), (blue, BLUE)):
        mesh.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.SimpleMaterial(diffuse=colour)
        )
    return trimesh.Scene({"red": red, "blue": blue})


def dae(unit: float) -> str:
    """Both boxes as a COLLADA file, each with a material of its own."""
    effects, materials, geometries, nodes = "", "", "", ""
    for name, mesh in two_boxes().geometry.items():
        rgba = " ".join(str(v / 255.0) for v in (RED if name == "red" else BLUE))
        effects += (
            f'<effect id="{name}-fx"><profile_COMMON><technique sid="c"><lambert><diffuse><color>'
            f"{rgba}</color></diffuse></lambert></technique></profile_COMMON></effect>"
        )
        materials += f'<material id="{name}-m"><instance_effect url="#{name}-fx"/></material>'
        numbers = " ".join(f"{v:.6g}" for v in mesh.vertices.flatten())
        faces = " ".join(map(str, mesh.faces.flatten()))
        count = len(mesh.vertices)
        geometries += (
            f'<geometry id="{name}-g"><mesh><source id="{name}-p"><float_array id="{name}-a" '
            f'count="{3 * count}">{numbers}</float_array><technique_common><accessor '
            f'source="#{name}-a" count="{count}" stride="3"><param name="X" type="float"/>'
            '<param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
            f'</technique_common></source><vertices id="{name}-v"><input semantic="POSITION" '
            f'source="#{name}-p"/></vertices><triangles material="s" count="{len(mesh.faces)}">'
            f'<input semantic="VERTEX" source="#{name}-v" offset="0"/><p>{faces}</p></triangles>'
            "</mesh></geometry>"
        )
        nodes += (
            f'<node id="{name}"><instance_geometry url="#{name}-g"><bind_material>'
            f'<technique_common><instance_material symbol="s" target="#{name}-m"/>'
            "</technique_common></bind_material></instance_geometry></node>"
        )
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        f'version="1.4.1"><asset><unit name="u" meter="{unit}"/><up_axis>Y_UP</up_axis></asset>'
        f"<library_effects>{effects}</library_effects><library_materials>{materials}"
        f"</library_materials><library_geometries>{geometries}</library_geometries>"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_dae_is_drawn_in_its_colours_and_its_unit(unit: float, tmp_path: Path) -> None:
    (tmp_path / "arm.dae").write_text(dae(unit))
    origin = '<origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/>'
    shape = visual('<mesh filename="arm.dae" scale="0.1 0.1 0.2"/>', origin)
    loaded = load_robot(robot(tmp_path, shape + BOX))
    assert loaded.left_out == ()
    found = drawn(loaded.model)
    assert len(found) == 2
    turn = Rotation.from_euler("xyz", [0.4, 0.5, 0.6])
    for (size, at, colour), (box, rgba) in zip(
        (((1, 2, 3), (0, 0, 0), RED), ((1, 1, 1), (10, 0, 0), BLUE)), found, strict=True
    ):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
        points = unit * (corners * size + at) * [0.1, 0.1, 0.2]
        points = turn.apply(points) + np.array([0.1, 0.2, 1.3])
        assert box == pytest.approx(np.array([points.min(axis=0), points.max(axis=0)]), abs=1e-6)
        assert rgba == pytest.approx(np.array(colour) / 255.0, abs=3e-3)


def test_colours_are_of_the_urdf_then_of_the_file_then_grey(tmp_path: Path) -> None:
    two_boxes().export(tmp_path / "boxes.obj")
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "plain.stl")
    green = '<material name="green"><color rgba="0 1 0 0.5"/></material>'
    shapes = [
        visual('<mesh filename="boxes.obj"/>'),
        visual('<mesh filename="boxes.obj"/>', "", '<material name="green"/>'),
        visual('<mesh filename="plain.stl"/>', "", green.replace("0 1 0 0.5", "1 1 0 1")),
        visual('<mesh filename="plain.stl"/>'),
        visual('<sphere radius="0.2"/>', "", '<material name="green"/>'),
        visual('<cylinder radius="0.1" length="0.4"/>'),
    ]
    model = load_robot(robot(tmp_path, "".join(shapes) + BOX, green)).model
    colours = [tuple(round(float(v), 2) for v in rgba) for _, rgba in drawn(model)]
    red, blue = (tuple(round(v / 255.0, 2) for v in c) for c in (RED, BLUE))
    assert colours[:2] == [red, blue]
    assert colours[2:5] == [(0, 1, 0, 0.5), (0, 1, 0, 0.5), (1, 1, 0, 1)]
    assert max(colours[5][:3]) - min(colours[5][:3]) < 0.1  # grey
    cylinder = model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER
    assert model.geom_size[cylinder][0, :2] == pytest.approx([0.1, 0.2])
    sphere = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    assert model.geom_rgba[sphere][0] == pytest.approx([0, 1, 0, 0.5])


def test_what_is_drawn_weighs_nothing_and_hides_what_collides(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "plain.stl")
    bare = load_robot(robot(tmp_path, BOX)).model
    seen = load_robot(robot(tmp_path, visual('<mesh filename="plain.stl"/>') + BOX)).model
    assert seen.body("a").mass == pytest.approx(bare.body("a").mass)
    assert seen.body("a").inertia == pytest.approx(bare.body("a").inertia)
    box = seen.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    assert seen.geom_contype[box].all() and (seen.geom_group[box] == 3).all()
    assert (bare.geom_group[bare.geom_type == mujoco.mjtGeom.mjGEOM_BOX] <= 2).all()


def test_floor_light_and_sky_are_there_and_touch_nothing(tmp_path: Path) -> None:
    model = load_robot(robot(tmp_path, BOX)).model
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    assert plane.sum() == 1 and not model.geom_contype[plane].any()
    assert model.nlight == 1
    assert mujoco.mjtTexture.mjTEXTURE_SKYBOX in model.tex_type
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("none.stl", None, "Not found: mesh 'none.stl'"),
        ("bad.stl", b"solid but not", "Not readable: mesh 'bad.stl'"),
        ("bad.dae", b"<COLLADA/>", "Not readable: mesh 'bad.dae'"),
        ("arm.step", b"ISO-10303-21;", "Not readable: mesh 'arm.step'; expected a mesh, STL"),
        ("empty.obj", b"# nothing", "Not readable: mesh 'empty.obj'"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "Not readable: mesh 'nan.obj'"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3", "Not readable: mesh 'flat.obj'"),
    ],
)
def test_what_cannot_be_drawn_is_named_and_the_rest_is_there(
    name: str, content: bytes | None, reason: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "good.stl")
    shapes = visual(f'<mesh filename="{name}"/>') + visual('<mesh filename="good.stl"/>')
    loaded = load_robot(robot(tmp_path, shapes + BOX))
    assert len(drawn(loaded.model)) == 1
    [sentence] = loaded.left_out
    assert sentence.startswith(reason)


def test_a_floor_that_is_only_drawn_collides_in_a_cell() -> None:
    spec = mujoco.MjSpec()
    add_room(spec, 0.0, collides=False)
    assert not spec.compile().geom_contype.any()
    add_room(spec, -0.5, collides=True)
    model = spec.compile()
    assert model.ngeom == 1 and model.geom_contype.all() and model.nlight == 1 and model.ntex == 1
    assert model.geom_pos[0] == pytest.approx([0, 0, -0.5])
