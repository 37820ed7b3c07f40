"""Compile URDF files by MuJoCo's reader, without what it refuses and kinematics does not need."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.robots.room import add_room, draw_once
from qp_twist.robots.stand_ins import add_rods
from qp_twist.robots.urdf_joints import read_joints
from qp_twist.robots.urdf_meshes import (
    VISUAL,
    Meshes,
    mesh_shapes,
    refused_mesh,
    sentence,
    take_meshes,
)
from qp_twist.robots.wording import listed, reason_of

_DEEPEST = 100
"""Largest nesting depth of elements. MuJoCo's reader supports 500, Python's writer about a
thousand."""
_TOKEN_MASS, _TOKEN_INERTIA = 1e-6, 1e-9


def read_urdf(
    text: str, file: Path, packages: Mapping[str, Path]
) -> tuple[mujoco.MjSpec, mujoco.MjModel, dict[str, float], tuple[str, ...]]:
    """Editable and compiled model, velocity limits by joint, and sentences on what is missing.

    Every link is a body; ``packages`` has folders by name.

    Raises:
        InvalidInput: If the file is not XML, or inconsistent, or MuJoCo refuses it.
    """
    root = _parsed(text, file)
    velocity_limits, lacking = read_joints(root, file)
    shapes = root.find("link/visual") is not None or root.find("link/collision") is not None
    meshes = take_meshes(root, file, packages)
    left_out = list(meshes.left_out)
    try:
        spec = _spec(root, meshes)
        model = spec.compile()
    except ValueError:
        unphysical = _without_unphysical_inertias(root)
        left_out += _without_refused_meshes(root, meshes)
        try:
            spec = _spec(root, meshes)
            spec.compiler.boundmass, spec.compiler.boundinertia = _TOKEN_MASS, _TOKEN_INERTIA
            model = spec.compile()
        except ValueError as error:
            raise InvalidInput(
                f"{file}: MuJoCo cannot load this URDF: {reason_of(error)}"
            ) from error
        tokens = [
            model.body(body).name
            for body in dict.fromkeys(model.jnt_bodyid.tolist())
            if model.body_mass[body] <= _TOKEN_MASS
            or model.body_inertia[body].min() <= _TOKEN_INERTIA
        ]
        if links := list(dict.fromkeys([*unphysical, *tokens])):
            left_out.append(
                f"No physical mass or inertia: {listed('link', links)}. A token, or what the shape "
                "gives, stands in: motions are right, forces are not."
            )
    left_out += lacking
    if shapes and root.find("link/visual") is None and root.find("link/collision") is None:
        left_out.append(
            "No shape: nothing is left of the shapes that the file states; rods from joint to "
            "joint stand in for them in pictures."
        )
    return spec, model, velocity_limits, tuple(left_out)


def _spec(root: ET.Element, meshes: Meshes) -> mujoco.MjSpec:
    """The editable model; without any shape it gets rods from joint to joint."""
    text = ET.tostring(root, encoding="unicode")
    spec = mujoco.MjSpec.from_string(text, assets=dict(meshes.assets))
    spec.compiler.fusestatic = False  # a link on a fixed joint may be the frame of a task
    for mesh in spec.meshes:
        if mesh.name.startswith(VISUAL):  # it need not enclose a volume
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    if not spec.geoms:
        add_rods(spec)
    draw_once(spec)
    add_room(spec, 0.0, collides=False)
    return spec


def _without_unphysical_inertias(root: ET.Element) -> list[str]:
    """Remove inertias that no rigid body has; the names of their links."""
    found = []
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None and not _is_physical(inertial):
            link.remove(inertial)
            found.append(link.get("name", ""))
    return found


def _is_physical(inertial: ET.Element) -> bool:
    """Whether the mass is positive and the moments of inertia A ≤ B ≤ C have 0 < A, C ≤ A + B."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        return False
    try:
        xx, yy, zz, xy, xz, yz = (
            float(inertia.get(key, "nan")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        value = float(mass.get("value", "nan"))
    except ValueError:
        return False
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite([value, *matrix.ravel()]).all():
        return False
    a, b, c = np.linalg.eigvalsh(matrix)
    return bool(value > 0.0 and a > 0.0 and c <= a + b)


def _without_refused_meshes(root: ET.Element, meshes: Meshes) -> list[str]:
    """Remove the shapes whose mesh MuJoCo refuses; a sentence about them."""
    refused: dict[str, str] = {}
    for link, shape, mesh in mesh_shapes(root):
        name = mesh.get("filename", "")
        if reason := refused_mesh(name, meshes.assets[name]):
            link.remove(shape)
            refused[meshes.stated[name]] = reason
    return sentence(refused)


def _depth(root: ET.Element) -> int:
    """Nesting depth of the elements, without recursion, which is limited to a thousand."""
    depth, level = 0, [root]
    while level:
        depth, level = depth + 1, [child for element in level for child in element]
    return depth


def _parsed(text: str, file: Path) -> ET.Element:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InvalidInput(f"{file}: is not well-formed XML ({error}); mend it there.") from error
    if _depth(root) > _DEEPEST:
        raise InvalidInput(
            f"{file}: its elements are nested more than {_DEEPEST} deep, where a URDF needs six; "
            "an element is not closed, or this is no URDF."
        )
    return root
