"""Convert URDF files for MuJoCo's reader."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import mujoco

from qp_twist.errors import InvalidInput
from qp_twist.robots.room import add_room
from qp_twist.robots.urdf_compiling import compile_urdf
from qp_twist.robots.urdf_joints import read_joints
from qp_twist.robots.urdf_meshes import take_meshes
from qp_twist.robots.urdf_visuals import add_visuals

_DEEPEST = 100
"""Largest nesting depth of elements. MuJoCo's reader supports 500, Python's writer about a
thousand."""


def read_urdf(
    text: str, file: Path, packages: Mapping[str, Path]
) -> tuple[mujoco.MjSpec, mujoco.MjModel, dict[str, float], tuple[str, ...]]:
    """Editable and compiled model, velocity limits by joint, and sentences on what is missing.

    Args:
        text: The file's text.
        file: Its path.
        packages: Folders by package name.

    Raises:
        InvalidInput: If the file is not XML, or inconsistent.
    """
    root = _parsed(text, file)
    velocity_limits, lacking = read_joints(root, file)
    shapes = len(root.findall("link/visual")) + len(root.findall("link/collision"))
    meshes = take_meshes(root, file, packages)
    spec, model, compiling = compile_urdf(root, file, meshes)
    not_drawn = add_visuals(spec, meshes.visuals)
    add_room(spec, 0.0, collides=False)
    model = spec.compile()
    left_out = [*meshes.left_out, *compiling, *not_drawn, *lacking]
    if shapes and not (
        root.findall("link/visual") or root.findall("link/collision") or meshes.visuals
    ):
        left_out.append(
            "No shape: nothing is left of the shapes that the file states; rods from joint to "
            "joint stand in for them in pictures."
        )
    return spec, model, velocity_limits, tuple(left_out)


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
