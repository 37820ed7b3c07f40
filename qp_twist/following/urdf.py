"""The chain of a robot as URDF, for libraries that read no MJCF; kinematics only."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mink
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.serial_chain import Screw
from qp_twist.path import PathTask

FRAME = "controlled_frame"
"""Name of the link that stands for the controlled frame."""
UNLIMITED = 1e9
"""What stands for no limit; a joint without one would be ``continuous``, of another q."""


def chain_urdf(path_task: PathTask) -> str:
    """URDF text of the joints from the world to the controlled frame.

    Every link has the world's axes at the scene's reference configuration and its origin on its
    joint's axis; the world is the root. Joints keep their names, their coordinates and limits.

    Raises:
        InvalidInput: If a joint of the scene does not move the frame: such a robot is no chain.
    """
    model = path_task.model
    chain = SerialChain.of(model, path_task.frame_name, path_task.frame_type)
    if len(chain.screws) != model.nv:
        moving = {screw.dof for screw in chain.screws}
        names = JointRanges.of(model).names
        idle = ", ".join(names[dof] for dof in range(model.nv) if dof not in moving)
        raise InvalidInput(
            f"peers: {path_task.scene.name} is no serial chain to {path_task.frame_name!r}, which "
            f"{idle} does not move; use mink, or one of this package's methods."
        )
    return tree_urdf({FRAME: chain}, JointRanges.of(model), path_task.velocity_limits)


def tree_urdf(chains: Mapping[str, SerialChain], ranges: JointRanges, speeds: Array) -> str:
    """URDF text of all joints that move some frame, as :func:`chain_urdf` has them for one.

    Args:
        chains: The chain to each frame, by the name that its link is to have.
        ranges: The joints' names and ranges.
        speeds: Their velocity limits, rad/s or m/s, (nv,); ∞ where there is none.
    """
    robot = ET.Element("robot", name="chain")
    ET.SubElement(robot, "link", name="world")
    written: set[int] = set()
    for frame, chain in chains.items():
        parent, origin = "world", np.zeros(3)
        for screw in chain.screws:
            link = f"link_{screw.dof}"
            if screw.dof not in written:
                written.add(screw.dof)
                _joint(robot, parent, origin, screw, ranges, speeds)
            parent, origin = link, screw.anchor
        ET.SubElement(robot, "link", name=frame)
        fixed = ET.SubElement(robot, "joint", name=f"{frame}_joint", type="fixed")
        _place(fixed, parent, frame, chain.position - origin, chain.rotation)
    return ET.tostring(robot, encoding="unicode")


def _joint(
    robot: ET.Element,
    parent: str,
    origin: Array,
    screw: Screw,
    ranges: JointRanges,
    speeds: Array,
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

    The roll is read behind the yaw, so that the three agree where the pitch is straight up and yaw
    alone means nothing.
    """
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    unyawed = mink.SO3.from_z_radians(-yaw).as_matrix() @ rotation
    pitch = math.atan2(-unyawed[2, 0], unyawed[0, 0])
    return np.array([math.atan2(-unyawed[1, 2], unyawed[1, 1]), pitch, yaw])


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
