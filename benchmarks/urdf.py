"""A robot as URDF, for libraries that do not read MJCF; kinematics only."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.serial_chain import Screw

UNLIMITED = 1e9
"""Value for no limit; a joint without limits would be ``continuous``, with another q."""


def link_name(number: int) -> str:
    """Name of the link of a controlled site."""
    return f"frame_{number}"


def robot_urdf(model: mujoco.MjModel, sites: Sequence[str], speeds: Array) -> str:
    """URDF text of the joints between the world and some sites.

    Every link has the world's axes at the scene's reference configuration and its origin on its
    joint's axis; the world is the root. Joints keep their names, their coordinates and limits.

    Args:
        model: The robot.
        sites: The controlled sites; each becomes a link named :func:`link_name`.
        speeds: Velocity limits, rad/s or m/s, (nv,); ∞ without a limit.

    Raises:
        InvalidInput: If a joint of the model moves none of the sites.
    """
    ranges = JointRanges.of(model)
    robot = ET.Element("robot", name="robot")
    ET.SubElement(robot, "link", name="world")
    written: set[int] = set()
    for number, site in enumerate(sites):
        chain = SerialChain.of(model, site, "site")
        parent, origin = "world", np.zeros(3)
        for screw in chain.screws:
            link = f"link_{screw.dof}"
            if screw.dof not in written:
                written.add(screw.dof)
                _joint(robot, parent, origin, screw, ranges, speeds)
            parent, origin = link, screw.anchor
        ET.SubElement(robot, "link", name=link_name(number))
        fixed = ET.SubElement(robot, "joint", name=f"{link_name(number)}_joint", type="fixed")
        _place(fixed, parent, link_name(number), chain.position - origin, chain.rotation)
    if len(written) != model.nv:
        idle = ", ".join(ranges.names[dof] for dof in range(model.nv) if dof not in written)
        raise InvalidInput(f"robot_urdf: {idle} does not move {', '.join(sites)}.")
    return ET.tostring(robot, encoding="unicode")


def _joint(
    robot: ET.Element, parent: str, origin: Array, screw: Screw, ranges: JointRanges, speeds: Array
) -> None:
    """Add a joint and the link that it moves; ``origin`` (3,) is that of the parent."""
    link = f"link_{screw.dof}"
    ET.SubElement(robot, "link", name=link)
    kind = "prismatic" if screw.slides else "revolute"
    joint = ET.SubElement(robot, "joint", name=ranges.names[screw.dof], type=kind)
    # At coordinate 0 the link is one reference back along, or about, its own axis.
    back = -screw.reference * screw.axis
    shift, turn = (back, np.zeros(3)) if screw.slides else (np.zeros(3), back)
    _place(joint, parent, link, screw.anchor - origin + shift, mink.SO3.exp(turn).as_matrix())
    ET.SubElement(joint, "axis", xyz=_numbers(screw.axis))
    lower, upper, speed = (
        float(np.clip(limit[screw.dof], -UNLIMITED, UNLIMITED))
        for limit in (ranges.lower, ranges.upper, speeds)
    )
    ET.SubElement(
        joint, "limit", lower=repr(lower), upper=repr(upper), velocity=repr(speed),
        effort=repr(UNLIMITED),
    )  # fmt: skip


def _place(joint: ET.Element, parent: str, child: str, position: Array, rotation: Array) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_numbers(position), rpy=_numbers(roll_pitch_yaw(rotation)))


def roll_pitch_yaw(rotation: Array) -> Array:
    """Angles (3,), rad, with rotation = Rz(yaw) Ry(pitch) Rx(roll).

    The roll is computed after the yaw, so that the three are consistent at a pitch of 90°, where
    yaw alone is undefined.
    """
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    unyawed = mink.SO3.from_z_radians(-yaw).as_matrix() @ rotation
    pitch = math.atan2(-unyawed[2, 0], unyawed[0, 0])
    return np.array([math.atan2(-unyawed[1, 2], unyawed[1, 1]), pitch, yaw])


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
