"""Compile a URDF tree, without parts that MuJoCo refuses and kinematics does not need."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco

from qp_twist.errors import InvalidInput
from qp_twist.robots.stand_ins import add_rods
from qp_twist.robots.urdf_meshes import Meshes, mesh_shapes
from qp_twist.robots.wording import listed, reason_of

_TOKEN_MASS = 1e-6
_TOKEN_INERTIA = 1e-9
_TRIAL = """
<robot name="trial">
  {settings}
  <link name="root"/>
  <link name="tried">{parts}</link>
  <link name="ballast">
    <inertial>
      <mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="a" type="continuous"><parent link="root"/><child link="tried"/></joint>
  <joint name="b" type="fixed"><parent link="tried"/><child link="ballast"/></joint>
</robot>
"""
"""A robot with one part of another one, to test whether MuJoCo accepts that part."""


def compile_urdf(
    root: ET.Element, file: Path, meshes: Meshes
) -> tuple[mujoco.MjSpec, mujoco.MjModel, list[str]]:
    """Compile a tree; refused parts are only searched if MuJoCo refuses the whole.

    Returns:
        The editable model, in which every link is a body, the compiled one, and a sentence for each
        thing left out.

    Raises:
        InvalidInput: If MuJoCo refuses what remains too.
    """
    try:
        return *_seen(root, meshes.assets), []
    except ValueError:
        unphysical, unreadable = _without_what_is_refused(root, meshes.assets)
    try:
        spec, model = _seen(root, meshes.assets, token_inertia=True)
    except ValueError as error:
        raise InvalidInput(f"{file}: MuJoCo cannot load this URDF: {reason_of(error)}") from error
    left_out = []
    if unreadable:
        files = listed("mesh", [meshes.stated[name] for name in unreadable])
        reasons = "; ".join(dict.fromkeys(unreadable.values()))
        left_out.append(f"Not readable for MuJoCo: {files}; {reasons}.")
    massless = [
        model.body(body).name
        for body in dict.fromkeys(int(joint) for joint in model.jnt_bodyid)
        if model.body_mass[body] <= _TOKEN_MASS or model.body_inertia[body].min() <= _TOKEN_INERTIA
    ]
    if lacking := list(dict.fromkeys([*unphysical, *massless])):
        left_out.append(
            f"No physical mass or inertia: {listed('link', lacking)}. A token, or what the shape "
            "gives, stands in: motions are right, forces are not."
        )
    return spec, model, left_out


def _seen(
    root: ET.Element,
    assets: Mapping[str, bytes],
    *,
    token_inertia: bool = False,
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Compile the model; if it has no shapes, add rods from joint to joint."""
    spec, model = _compiled(root, assets, token_inertia=token_inertia)
    if model.ngeom:
        return spec, model
    return _compiled(root, assets, token_inertia=token_inertia, rods=True)


def _compiled(
    root: ET.Element,
    assets: Mapping[str, bytes],
    *,
    token_inertia: bool = False,
    rods: bool = False,
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    text = ET.tostring(root, encoding="unicode")
    spec = mujoco.MjSpec.from_string(text, assets=dict(assets))
    spec.compiler.fusestatic = False  # a link on a fixed joint may be the frame of a task
    if token_inertia:
        spec.compiler.boundmass = _TOKEN_MASS
        spec.compiler.boundinertia = _TOKEN_INERTIA
    # Visual shapes that are not wanted have left the tree; what is added later is to be drawn.
    spec.compiler.discardvisual = False
    if rods:
        add_rods(spec)
    return spec, spec.compile()


def _without_what_is_refused(
    root: ET.Element, assets: Mapping[str, bytes]
) -> tuple[list[str], dict[str, str]]:
    """Remove inertias and meshes that MuJoCo refuses; return links, reasons by mesh file."""
    settings = root.findall("mujoco")
    unphysical = []
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None and _refused(settings, [inertial], assets):
            link.remove(inertial)
            unphysical.append(link.get("name", ""))
    unreadable: dict[str, str] = {}
    for link, shape, mesh in mesh_shapes(root):
        reason = _refused(settings, [*link.findall("inertial"), shape], assets)
        if reason:
            link.remove(shape)
            unreadable[mesh.get("filename", "")] = reason
    return unphysical, unreadable


def _refused(
    settings: Sequence[ET.Element], parts: Sequence[ET.Element], assets: Mapping[str, bytes]
) -> str:
    """Why MuJoCo refuses a link with these parts under these settings, or ``""``."""
    trial = _TRIAL.format(settings=_text(settings), parts=_text(parts))
    try:
        _compiled(ET.fromstring(trial), assets)
    except ValueError as error:
        return reason_of(error)
    return ""


def _text(elements: Sequence[ET.Element]) -> str:
    return "".join(ET.tostring(element, encoding="unicode") for element in elements)
