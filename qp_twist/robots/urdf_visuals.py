"""The visual shapes of a URDF as geoms that are drawn and collide with nothing."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput
from qp_twist.robots.mesh_files import Colour, coloured_meshes, msh
from qp_twist.robots.room import DRAWN, NOT_DRAWN
from qp_twist.robots.wording import listed, reason_of

_GREY: Colour = (0.72, 0.74, 0.77, 1.0)
_NAMED = "visual"


class Visual(NamedTuple):
    """A visual shape of a link."""

    link: str
    kind: str
    """``mesh``, ``box``, ``cylinder`` or ``sphere``."""
    position: list[float]
    wxyz: list[float]
    size: list[float]
    """Of a mesh its scale; half the sides; radius and half length; or radius. m."""
    colour: Colour | None
    file: Path | None
    stated: str


def visual_of(
    link: ET.Element, shape: ET.Element, materials: Mapping[str, Colour], file: Path | None
) -> Visual | None:
    """A ``<visual>`` of a link, or ``None`` if its numbers or shape are not understood."""
    geometry = shape.find("geometry")
    solid = next(iter(geometry), None) if geometry is not None else None
    if solid is None:
        return None
    origin = shape.find("origin")
    try:
        at = _numbers(origin, "xyz", "0 0 0", 3)
        rpy = _numbers(origin, "rpy", "0 0 0", 3)
        if solid.tag == "mesh":
            size = _numbers(solid, "scale", "1 1 1", 3)
        elif solid.tag == "box":
            size = [v / 2.0 for v in _numbers(solid, "size", "", 3)]
        elif solid.tag == "cylinder":
            size = [*_numbers(solid, "radius", "", 1), _numbers(solid, "length", "", 1)[0] / 2.0]
        elif solid.tag == "sphere":
            size = _numbers(solid, "radius", "", 1)
        else:
            return None
    except ValueError:
        return None
    x, y, z, w = Rotation.from_euler("xyz", rpy).as_quat().tolist()
    return Visual(
        link.get("name", ""), solid.tag, at, [w, x, y, z], size,
        _colour(shape.find("material"), materials), file, solid.get("filename", ""),
    )  # fmt: skip


def materials_of(root: ET.Element) -> dict[str, Colour]:
    """The colours of a URDF's materials by name."""
    found: dict[str, Colour] = {}
    for material in root.iter("material"):
        colour = _colour(material, {})
        if colour is not None:
            found.setdefault(material.get("name", ""), colour)
    return found


def add_visuals(spec: Any, visuals: list[Visual]) -> list[str]:
    """Draw the visual shapes, and what collides on the same links no more.

    Args:
        spec: The robot, whose bodies are the links.
        visuals: The shapes.

    Returns:
        A sentence for the shapes that cannot be drawn.
    """
    refused: dict[str, str] = {}
    assets = dict(spec.assets)
    names: dict[tuple[Path, tuple[float, ...]], list[tuple[str, Colour | None]]] = {}
    drawn = set()
    for visual in visuals:
        body = spec.body(visual.link)
        if body is None or visual.stated in refused:
            continue
        common = {"pos": visual.position, "quat": visual.wxyz, "group": DRAWN, "mass": 0.0,
                  "contype": 0, "conaffinity": 0}  # fmt: skip
        if visual.kind != "mesh":
            size = [*visual.size, 0.0, 0.0][:3]
            kind = {"box": mujoco.mjtGeom.mjGEOM_BOX, "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
                    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}[visual.kind]  # fmt: skip
            body.add_geom(type=kind, size=size, rgba=visual.colour or _GREY, **common)
            drawn.add(visual.link)
            continue
        assert visual.file is not None
        key = (visual.file, tuple(visual.size))
        if key not in names:
            try:
                names[key] = _meshes(spec, assets, visual.file, visual.size)
            except InvalidInput as error:
                refused[visual.stated] = clause(error)
                continue
        for name, own in names[key]:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name,
                rgba=visual.colour or own or _GREY, **common,
            )  # fmt: skip
        drawn.add(visual.link)
    spec.assets = assets
    for link in drawn:
        for geom in spec.body(link).geoms:
            if geom.contype or geom.conaffinity:
                geom.group = max(geom.group, NOT_DRAWN)
    if not refused:
        return []
    reasons = "; ".join(dict.fromkeys(refused.values()))
    return [f"Not drawn: {listed('visual mesh', list(refused))}; {reasons}."]


def _meshes(
    spec: Any, assets: dict[str, bytes], file: Path, scale: list[float]
) -> list[tuple[str, Colour | None]]:
    """Add the meshes of a file; their names and colours."""
    found = []
    meshes = coloured_meshes(file)
    for mesh in meshes:
        if reason := _refused(msh([mesh]), tuple(scale)):
            raise InvalidInput(reason)
    for mesh in meshes:
        number = 1 + sum(name.startswith(f"{_NAMED}_") for name in assets)
        name = f"{_NAMED}_{number}_{file.stem}"
        assets[f"{name}.msh"] = msh([mesh])
        spec.add_mesh(
            name=name, file=f"{name}.msh", scale=scale,
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        found.append((name, mesh.colour))
    return found


@lru_cache(maxsize=1024)
def _refused(content: bytes, scale: tuple[float, ...]) -> str:
    """Why MuJoCo refuses a mesh, or ``""``."""
    trial = mujoco.MjSpec()
    trial.assets = {"trial.msh": content}
    trial.add_mesh(
        name="trial", file="trial.msh", scale=list(scale),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )  # fmt: skip
    trial.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="trial", contype=0, conaffinity=0
    )
    try:
        trial.compile()
    except ValueError as error:
        return f"MuJoCo refuses it ({reason_of(error)[:120]})"
    return ""


def _colour(material: ET.Element | None, materials: Mapping[str, Colour]) -> Colour | None:
    if material is None:
        return None
    try:
        r, g, b, a = _numbers(material.find("color"), "rgba", "", 4)
    except ValueError:
        return materials.get(material.get("name", ""))
    return r, g, b, a


def _numbers(element: ET.Element | None, key: str, default: str, count: int) -> list[float]:
    text = default if element is None else element.get(key, default)
    found = [float(word) for word in text.split()]
    if len(found) != count or not np.isfinite(found).all():
        raise ValueError(text)
    return found
