"""Write the scene of a cell: a robot with a tool, a part, fixtures and a floor."""

from __future__ import annotations

import shutil
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mink
import mujoco
import numpy as np

from qp_twist.authoring.frame_choice import FrameChoice
from qp_twist.authoring.request import Request
from qp_twist.authoring.solids import Solid, convex_pieces, read_solid
from qp_twist.authoring.touching import DISTANCE, overlapping
from qp_twist.checks import Array
from qp_twist.constraints import Clearance
from qp_twist.errors import InvalidInput
from qp_twist.files import read_bytes, write_atomically
from qp_twist.kinematics import JointRanges
from qp_twist.robots import Robot, load_robot
from qp_twist.robots.room import DRAWN, NOT_DRAWN, add_room, draw_once
from qp_twist.robots.stand_ins import add_pen
from qp_twist.robots.wording import free_name, reason_of

if TYPE_CHECKING:
    import trimesh

TOOL, PART, FIXTURE, TCP = "tool", "part", "fixture", "tcp"
_COLOURS = {
    TOOL: (0.92, 0.42, 0.10, 1.0),
    PART: (0.62, 0.68, 0.75, 1.0),
    FIXTURE: (0.36, 0.38, 0.41, 1.0),
}
_SAME = 1e-6
"""Largest difference of a written robot from the one that was read, m."""
_CONFIGURATIONS = 10
"""Number of random configurations in which the two are compared."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A scene that was written: its robot, the controlled frame, and names of bodies.

    ``tool`` and ``part`` are empty without one; ``carrier`` carries the path, ``None``: the world.
    """

    robot: Robot
    frame: FrameChoice
    tool: str
    part: str
    carrier: str | None
    notes: tuple[str, ...]


def cell_folder(out: Path) -> Path:
    """The folder of the scene that belongs to a task file."""
    return out.with_name(f"{out.stem}_cell")


def write_cell(
    folder: Path, robot: Robot, frame: FrameChoice, request: Request, rpy_deg: Array, at: Array
) -> Cell:
    """Write ``scene.xml`` and its meshes into an empty folder.

    The robot's ``frame`` carries the tool; with ``request.tool_at`` the part. Part and fixtures are
    in the toolpath's frame, whose origin ``at``, m, and orientation are in the robot's world, or in
    the frame of what carries the part.

    Raises:
        InvalidInput: If a mesh is refused, or the robot's own meshes are not found.
    """
    if request.tool_mesh is not None and request.tcp is None and request.tool_at is None:
        raise InvalidInput(
            f"{request.tool_mesh}: where is its tip? Add --tcp "
            "X,Y,Z,ROLL_DEG,PITCH_DEG,YAW_DEG, its pose in the robot's frame, in m and degrees.",
            key="tool_mesh",
        )
    spec = robot.spec.copy()
    # A solid's name is that of its body, its geom and its mesh.
    taken = {item.name for kind in (spec.bodies, spec.geoms, spec.meshes) for item in kind}
    solids: list[Solid] = []
    names: dict[str, str] = {}
    files_of = {
        TOOL: (request.tool_mesh,),
        PART: (request.part_mesh,),
        FIXTURE: request.fixture_meshes,
    }
    for kind, files in files_of.items():
        for file in filter(None, files):
            name = _free(kind, taken)
            names.setdefault(kind, name)
            solids.append(read_solid(name, file, request.mesh_unit))
    meshes = _Meshes(spec, _own_files(spec, robot))
    _name_geoms(spec)
    of_links = _divide_links(spec, robot.model, taken, meshes)
    draw_once(spec)
    tip, carrier = frame, request.relative_to
    lowest = [0.0]
    identity = mink.SE3.identity()
    turned = mink.SO3.from_rpy_radians(*np.radians(rpy_deg))
    placed = mink.SE3.from_rotation_and_translation(turned, at)
    # The parent and the pose of each kind of body.
    base: Any = spec.worldbody if carrier is None else spec.body(carrier)
    where = {TOOL: (base, identity), PART: (base, placed), FIXTURE: (base, placed)}
    if request.tcp is not None or request.tool_at is not None:
        hand, position, wxyz = _carrier(robot.model, frame)
        held = mink.SE3.from_rotation_and_translation(mink.SO3(wxyz), position)
        where[TOOL] = spec.body(hand), held
        at_tip = f"the tool's tip, on {frame.kind} {frame.name}"
        if request.tool_at is not None:
            carrier = names.setdefault(PART, _free(PART, taken))
            where = {
                TOOL: (spec.worldbody, _pose(request.tool_at)),
                PART: (spec.body(hand), held @ placed),
                FIXTURE: (spec.worldbody, identity),
            }
            at_tip = f"the tip of the tool in the cell; {frame.kind} {frame.name} holds the part"
        tool = _add_body(*where[TOOL], names.get(TOOL, _free(TOOL, taken)))
        point = identity if request.tcp is None else _pose(request.tcp)
        site = _add_tip(spec, tool, point, drawn=request.tool_mesh is not None)
        tip = FrameChoice(site, "site", at_tip)
        if request.tool_at is not None and request.part_mesh is None:
            _add_body(*where[PART], names[PART])
    for solid in solids:
        kind = next(k for k in (TOOL, PART, FIXTURE) if solid.name.startswith(k))
        parent, pose = where[kind]
        body = tool if kind == TOOL else _add_body(parent, pose, solid.name)
        if parent is spec.worldbody:
            heights = pose.rotation().as_matrix()[2] @ solid.drawn.vertices.T
            lowest.append(float(heights.min() + pose.translation()[2]))
        meshes.add_solid(body, solid, _COLOURS[kind])
    add_room(spec, min(lowest), collides=True)
    _write(folder, spec, meshes.written, robot)
    scene = load_robot(folder / "scene.xml")
    _check_same(robot, scene)
    notes = [*of_links, *(note for solid in solids for note in solid.notes)]
    part = "" if request.part_mesh is None else names[PART]
    return Cell(scene, tip, names.get(TOOL, ""), part, carrier, tuple(notes))


@contextmanager
def new_folder(folder: Path, *, force: bool) -> Iterator[None]:
    """An empty folder; after a failure it is gone, and an older one is unchanged.

    Raises:
        InvalidInput: If there is something already, without ``force``.
    """
    if folder.exists() and not force:
        raise InvalidInput(
            f"{folder}: there is such a folder already, where the scene belongs; give another "
            "--out, or --force to replace it."
        )
    folder.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    older = aside / folder.name
    try:
        if folder.exists():
            folder.rename(older)
        folder.mkdir()
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        if older.exists():
            older.rename(folder)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


# ---------------------------------------------------------------- what is added


def _pose(six: tuple[float, float, float, float, float, float]) -> mink.SE3:
    """Of a position, m, and roll, pitch and yaw, degrees."""
    turn = mink.SO3.from_rpy_radians(*np.radians(six[3:]))
    return mink.SE3.from_rotation_and_translation(turn, np.array(six[:3]))


def _add_body(parent: Any, pose: mink.SE3, name: str) -> Any:
    return parent.add_body(name=name, pos=pose.translation(), quat=pose.rotation().wxyz)


def _add_tip(spec: Any, tool: Any, point: mink.SE3, *, drawn: bool) -> str:
    """Add the site of the tool's tip, and a pen to a tool that is not drawn; the site's name."""
    site = _free(TCP, {s.name for s in spec.sites})
    tool.add_site(
        name=site, pos=point.translation(), quat=point.rotation().wxyz, group=4, size=[0.005] * 3
    )
    if not drawn:
        add_pen(tool, point.translation(), _COLOURS[TOOL])
    return site


def _free(name: str, taken: set[str], suffix: str = "") -> str:
    """The name, numbered if it is taken; it is taken afterwards."""
    free = free_name(name, {other.removesuffix(suffix) for other in taken}) + suffix
    taken.add(free)
    return free


def _name_geoms(spec: Any) -> None:
    """Name the geoms that may collide, so that messages and ``ignore`` can name them."""
    taken = {geom.name for geom in spec.geoms}
    for geom in spec.geoms:
        if not geom.name and (geom.contype or geom.conaffinity):
            geom.name = _free(geom.parent.name or "geom", taken)


def _divide_links(spec: Any, model: mujoco.MjModel, taken: set[str], meshes: _Meshes) -> list[str]:
    """Divide concave meshes of the robot's links whose hulls overlap; sentences about them.

    Of links with one link between them, or that touch in every configuration: see
    :func:`~qp_twist.authoring.touching.overlapping`.
    """
    if not JointRanges.of(model).only_hinges_and_slides:
        return []
    import trimesh  # half a second

    clearance = Clearance(model, DISTANCE)
    notes = []
    for geom in np.unique(clearance.pairs[list(overlapping(clearance))]):
        body = int(model.geom_bodyid[geom])
        name, number = str(model.body(body).name), int(geom) - int(model.body_geomadr[body])
        if int(model.geom_type[geom]) != mujoco.mjtGeom.mjGEOM_MESH or not name:
            continue
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        turn = mink.SO3(model.geom_quat[geom].copy()).as_matrix()
        vertices = model.mesh_vert[first : first + count] @ turn.T + model.geom_pos[geom]
        pieces, note = convex_pieces(
            name, trimesh.Trimesh(vertices, model.mesh_face[begin : begin + faces])
        )
        if note:
            notes.append(note)
        if pieces:
            on = spec.body(name)
            old = on.geoms[number]
            old.contype = old.conaffinity = 0
            meshes.add_pieces(on, _free(f"{name}_part", taken), pieces, list(old.rgba))
    return notes


def _carrier(model: mujoco.MjModel, frame: FrameChoice) -> tuple[str, Array, Array]:
    """Name of the body that carries a frame, and the frame's position and orientation on it."""
    if frame.kind == "body":
        return frame.name, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    of = model.site(frame.name) if frame.kind == "site" else model.geom(frame.name)
    name = str(model.body(int(of.bodyid[0])).name)
    if not name:
        raise InvalidInput(
            f"the {frame.kind} {frame.name!r} is on a body without a name; name it in the "
            "robot's file, so that the tool can be put on it.",
            key="frame",
        )
    return name, of.pos.copy(), of.quat.copy()


class _Meshes:
    """The meshes that are written beside a scene: each with its file and a geom of its name."""

    def __init__(self, spec: Any, written: dict[str, bytes]) -> None:
        self._spec, self.written = spec, written

    def add_solid(self, body: Any, solid: Solid, colour: Sequence[float]) -> None:
        """Add a geom that is drawn and collides, or one drawn and its pieces."""
        collides = not solid.pieces
        self.add(body, solid.name, solid.drawn, colour, group=DRAWN, collides=collides)
        self.add_pieces(body, solid.name, solid.pieces, colour)

    def add_pieces(
        self, body: Any, of: str, pieces: Sequence[trimesh.Trimesh], colour: Sequence[float]
    ) -> None:
        """Add convex pieces, in the axes of the body, that collide and are not drawn."""
        for count, piece in enumerate(pieces, start=1):
            name = f"{of}_piece_{count}"
            self.add(body, name, piece, colour, group=NOT_DRAWN, collides=True)

    def add(
        self, body: Any, name: str, mesh: trimesh.Trimesh, colour: Sequence[float], *, group: int,
        collides: bool,
    ) -> None:  # fmt: skip
        """Add a mesh."""
        file = _free(name, set(self.written), ".obj")
        self.written[file] = str(mesh.export(file_type="obj", digits=9, header=None)).encode()
        hull = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        self._spec.add_mesh(name=name, file=file, inertia=hull)
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=colour, group=group,
            mass=0.0, contype=int(collides), conaffinity=int(collides),
        )  # fmt: skip


# ---------------------------------------------------------------- files


def _own_files(spec: Any, robot: Robot) -> dict[str, bytes]:
    """Contents of the robot's meshes and textures by new names, which the assets then have."""
    contents: dict[str, bytes] = {}
    for assets, folder in ((spec.meshes, spec.meshdir), (spec.textures, spec.texturedir)):
        for asset in assets:
            if not asset.file:
                continue
            file = Path(asset.file)
            content = robot.spec.assets.get(asset.file)
            if content is None:
                base = Path(spec.modelfiledir or robot.path.parent)
                places = [base / folder / file, robot.path.parent / folder / file]
                found = next((place for place in places if place.is_file()), None)
                if found is None:
                    raise InvalidInput(
                        f"{robot.path}: {asset.file} cannot be copied beside the scene: it is not "
                        f"in {places[0].parent}."
                    )
                content = read_bytes(found, "file")
            elif isinstance(content, str):
                content = content.encode()
            asset.name = asset.name or file.stem
            asset.file = _free(file.stem, set(contents), file.suffix)
            contents[asset.file] = content
    spec.meshdir = spec.texturedir = "meshes"
    return contents


def _write(folder: Path, spec: Any, written: dict[str, bytes], robot: Robot) -> None:
    for name, content in written.items():
        write_atomically(folder / "meshes" / name, content)
    spec.assets = {f"meshes/{name}": content for name, content in written.items()}
    try:
        model = spec.compile()
    except ValueError as error:
        raise InvalidInput(
            f"{robot.path}: MuJoCo refuses the cell around it: {reason_of(error)}"
        ) from error
    write_atomically(folder / "scene.xml", _precise(spec.to_xml(), model))


def _precise(text: str, model: mujoco.MjModel) -> str:
    """An MJCF with all digits of bodies, joints and sites, of which MuJoCo writes six."""
    root = ET.fromstring(text)
    world = root.find("worldbody")
    assert world is not None
    for body, parent in _without_frames(world):
        kind, name = body.tag, body.get("name", "")
        if not name or parent.tag == "frame":
            continue
        if kind == "body":
            _set(body, pos=model.body(name).pos, quat=model.body(name).quat)
        elif kind == "site":
            _set(body, pos=model.site(name).pos, quat=model.site(name).quat)
        elif kind == "joint" and model.joint(name).type[0] != mujoco.mjtJoint.mjJNT_FREE:
            _set(body, pos=model.joint(name).pos, axis=model.joint(name).axis)
        if kind == "joint" and model.joint(name).limited[0]:
            _set(body, range=model.joint(name).range)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _without_frames(element: ET.Element) -> Iterator[tuple[ET.Element, ET.Element]]:
    for child in element:
        yield child, element
        yield from _without_frames(child)


def _set(element: ET.Element, **values: Iterable[float]) -> None:
    if "quat" in values:
        for other in ("axisangle", "xyaxes", "zaxis", "euler", "fromto"):
            element.attrib.pop(other, None)
    for key, numbers in values.items():
        element.set(key, " ".join(repr(float(x)) for x in numbers))


def _check_same(robot: Robot, scene: Robot) -> None:
    """Refuse a scene whose robot moves differently."""
    ranges = JointRanges.of(robot.model)
    low = np.where(ranges.limited, ranges.lower, -np.pi)
    high = np.where(ranges.limited, ranges.upper, np.pi)
    names = [str(robot.model.body(body).name) for body in range(robot.model.nbody)]
    rng = np.random.default_rng(0)
    for _ in range(_CONFIGURATIONS):
        positions = rng.uniform(low, high)
        poses = []
        for model in (robot.model, scene.model):
            data = mujoco.MjData(model)
            data.qpos[ranges.qpos] = positions
            mujoco.mj_kinematics(model, data)
            poses.append(np.array([data.body(name).xpos for name in names if name]))
        if not np.abs(poses[0] - poses[1]).max(initial=0.0) <= _SAME:
            raise InvalidInput(
                f"{robot.path}: the robot differs in the scene that was written; write the scene "
                "by hand, and give it to qp-twist new without meshes."
            )
