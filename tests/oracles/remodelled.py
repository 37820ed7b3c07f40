"""Models of a known robot that count its joints in other ways: other zero positions and signs."""

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from oracles.arms import text
from qp_twist.robots import KnownRobot

TIP = (0.1, 0.2, 0.3)
Array = np.ndarray


def remodelled(
    robot: KnownRobot,
    signs: Array,
    offsets: Array,
    base: tuple[float, float, float],
    tip: str = "tip",
    under: str = "",
    beside: str = "",
) -> mujoco.MjModel:
    """A robot whose joint i is at q_i where its axis is at signs_i q_i + offsets_i, rad.

    With MJCF in the body of its base, such as the joint of a rail, and beside it.

    Each body's frame is that of the world, turned with the links before it, at a point of its axis.
    """
    opened = closed = ""
    turned, moved = Rotation.identity(), np.zeros(3)
    last, origin = Rotation.identity(), np.zeros(3)
    for number, (line, sign, offset) in enumerate(
        zip(robot.lines, signs, offsets, strict=True), start=1
    ):
        axis, point = turned.apply(line.axis), turned.apply(line.point) + moved
        turn = Rotation.from_rotvec(offset * axis)
        turned, moved = turn * turned, point + turn.apply(moved - point)
        place = last.inv().apply(point - origin)
        x, y, z, w = (last.inv() * turned).as_quat()
        about = sign * turned.inv().apply(axis)
        last, origin = turned, point
        opened += (
            f'<body pos="{text(place)}" quat="{text((w, x, y, z))}">'
            f'<joint name="joint_{number}" axis="{text(about)}"/><geom size="0.01"/>'
        )
        closed += "</body>"
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody>'
        f'<body name="base" pos="1 2 3" euler="{text(base)}">{under}{opened}'
        f'<site name="{tip}" pos="{text(TIP)}"/>{closed}</body>{beside}'
        "</worldbody></mujoco>"
    )


def axes_at(robot: KnownRobot, theta: Array) -> list[tuple[Array, Array]]:
    """Directions and points of the robot's axes at angles theta, rad, in its base's frame."""
    turned, moved = Rotation.identity(), np.zeros(3)
    found = []
    for line, angle in zip(robot.lines, theta, strict=True):
        axis, point = turned.apply(line.axis), turned.apply(line.point) + moved
        found.append((axis, point))
        turn = Rotation.from_rotvec(angle * axis)
        turned, moved = turn * turned, point + turn.apply(moved - point)
    return found
