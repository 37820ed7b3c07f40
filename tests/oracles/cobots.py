"""Arms without a spherical wrist, and two of seven joints, by their makers' published lengths."""

import math
from collections.abc import Sequence

import mujoco
from scipy.spatial.transform import Rotation

from oracles.arms import text

PI, TURN = math.pi, 2.0 * math.pi
Numbers = Sequence[float]
Joint = tuple[Numbers, Numbers, Numbers, float, float]
"""Origin in the frame of the joint before, m; roll, pitch, yaw; axis; lower and upper limit."""


def _of_denavit_hartenberg(rows: Sequence[Numbers], limits: Sequence[Numbers]) -> list[Joint]:
    """Joints of rows (α, a, d); the last row is the flange's."""
    before = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), *(((a, 0, d), (x, 0, 0)) for x, a, d in rows)]
    return [(*at, (0, 0, 1), *ends) for at, ends in zip(before, limits, strict=False)]


_WIDE = 2 * [(-TURN, TURN)] + [(-PI, PI)] + 3 * [(-TURN, TURN)]
_NO: Numbers = (0.0, 0.0, 0.0)

COBOTS: dict[str, tuple[list[Joint], Numbers, Numbers, float]] = {
    # Joints; place of the tool's frame and its roll, pitch, yaw; the reach, m.
    "UR5e": (
        _of_denavit_hartenberg(
            [(PI / 2, 0, 0.1625), (0, -0.425, 0), (0, -0.3922, 0), (PI / 2, 0, 0.1333),
             (-PI / 2, 0, 0.0997)], _WIDE), (0, 0, 0.1996), _NO, 0.85,
    ),
    "UR10e": (
        _of_denavit_hartenberg(
            [(PI / 2, 0, 0.1807), (0, -0.6127, 0), (0, -0.57155, 0), (PI / 2, 0, 0.17415),
             (-PI / 2, 0, 0.11985)], _WIDE), (0, 0, 0.21655), _NO, 1.3,
    ),
    "CRX-10iA": (
        [((0, 0, 0.245), _NO, (0, 0, 1), -3.32, 3.32), (_NO, _NO, (0, 1, 0), -3.14, 3.14),
         ((0, 0, 0.54), _NO, (0, -1, 0), -4.71, 4.71), (_NO, _NO, (-1, 0, 0), -3.32, 3.32),
         ((0.54, 0, 0), _NO, (0, -1, 0), -3.14, 3.14),
         ((0, -0.15, 0), _NO, (-1, 0, 0), -3.93, 3.93)], (0.26, 0, 0), (PI, -PI / 2, 0), 1.2,
    ),
    "Gen3 6": (  # its angles are rounded
        [((0, 0, 0.15643), (-3.1416, 0, 0), (0, 0, 1), -PI, PI),
         ((0, 0.005375, -0.12838), (1.5708, 0, 0), (0, 0, 1), -2.41, 2.41),
         ((0, -0.41, 0), (3.1416, 0, 0), (0, 0, 1), -2.66, 2.66),
         ((0, 0.20843, -0.006375), (1.5708, 0, 0), (0, 0, 1), -PI, PI),
         ((0, -0.00017505, -0.10593), (-1.5708, 0, 0), (0, 0, 1), -2.23, 2.23),
         ((0, 0.10593, -0.00017505), (1.5708, 0, 0), (0, 0, 1), -PI, PI)],
        (0, 0, -0.16), (3.1416, 0, -3.1416), 0.85,
    ),
    "xArm6": (
        [((0, 0, 0.267), _NO, (0, 0, 1), -TURN, TURN),
         (_NO, (-1.5708, 0, 0), (0, 0, 1), -2.059, 2.0944),
         ((0.053, -0.2845, 0), _NO, (0, 0, 1), -3.927, 0.19198),
         ((0.0775, 0.3425, 0), (-1.5708, 0, 0), (0, 0, 1), -TURN, TURN),
         (_NO, (1.5708, 0, 0), (0, 0, 1), -1.69297, PI),
         ((0.076, 0.097, 0), (-1.5708, 0, 0), (0, 0, 1), -TURN, TURN)], (0, 0, 0.1), _NO, 0.7,
    ),
    "Rizon 4": (
        [((0, 0, 0.155), (0, 0, -PI), (0, 0, 1), -2.8798, 2.8798),
         ((0, 0.03, 0.21), _NO, (0, 1, 0), -2.3562, 2.3562),
         ((0, 0.035, 0.205), _NO, (0, 0, 1), -3.0543, 3.0543),
         ((-0.02, -0.03, 0.19), (0, 0, -PI), (0, 1, 0), -1.9548, 2.7751),
         ((-0.02, 0.025, 0.195), (0, 0, -PI), (0, 0, 1), -3.0543, 3.0543),
         ((0, 0.03, 0.19), _NO, (0, 1, 0), -1.4835, 4.6251),
         ((-0.015, 0.073, 0.11), (0, -PI / 2, 0), (0, 0, 1), -3.0543, 3.0543)],
        (0, 0, 0.181), _NO, 0.75,
    ),
    "iiwa 14": (
        [((0, 0, z), _NO, axis, -end, end) for z, axis, end in (
            (0.1575, (0, 0, 1), 2.967), (0.2025, (0, 1, 0), 2.094), (0.2045, (0, 0, 1), 2.967),
            (0.2155, (0, -1, 0), 2.094), (0.1845, (0, 0, 1), 2.967), (0.2155, (0, 1, 0), 2.094),
            (0.081, (0, 0, 1), 3.054))], (0, 0, 0.145), _NO, 0.8,
    ),
    "Panda": (
        [((0, 0, 0.333), _NO, (0, 0, 1), -2.8973, 2.8973),
         (_NO, (-PI / 2, 0, 0), (0, 0, 1), -1.7628, 1.7628),
         ((0, -0.316, 0), (PI / 2, 0, 0), (0, 0, 1), -2.8973, 2.8973),
         ((0.0825, 0, 0), (PI / 2, 0, 0), (0, 0, 1), -3.0718, -0.0698),
         ((-0.0825, 0.384, 0), (-PI / 2, 0, 0), (0, 0, 1), -2.8973, 2.8973),
         (_NO, (PI / 2, 0, 0), (0, 0, 1), -0.0175, 3.7525),
         ((0.088, 0, 0), (PI / 2, 0, 0), (0, 0, 1), -2.8973, 2.8973)], (0, 0, 0.207), _NO, 0.75,
    ),
}  # fmt: skip


def cobot(name: str) -> mujoco.MjModel:
    """The model of one of them, its controlled frame the site ``tool``."""
    joints, place, turn, _ = COBOTS[name]
    bodies = "".join(
        f'<body {_frame(at, angles)}><joint name="joint_{k}" axis="{text(axis)}" limited="true" '
        f'range="{lower!r} {upper!r}"/><geom size="0.01" contype="0" conaffinity="0"/>'
        for k, (at, angles, axis, lower, upper) in enumerate(joints, start=1)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}'
        f'<site name="tool" {_frame(place, turn)}/>{"</body>" * len(joints)}</worldbody></mujoco>'
    )


def _frame(at: Numbers, angles: Numbers) -> str:
    turn = Rotation.from_euler("xyz", angles).as_quat(scalar_first=True)
    return f'pos="{text(at)}" quat="{text(turn)}"'
