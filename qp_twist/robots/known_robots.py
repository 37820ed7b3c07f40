"""Joint speed limits of known robots, from their makers' data sheets.

MJCF has no joint speed limits, and many URDFs omit them. This table has those of some robots. A
robot is recognised by its name *and* its geometry, so that neither another arm of the same name nor
a renamed one of the same shape is mistaken for it. The limits are used in checks
(:func:`~qp_twist.check_trajectory`), which name them. Steps and plans use the task's limits only.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.kinematics.serial_chain import Screw

_NEAR = 2e-3
"""Lengths that differ by less count as equal, m: models are rounded or calibrated."""
_NEAR_DEG = 1.0
_PARALLEL = float(np.sin(np.radians(_NEAR_DEG)))
"""Sine of an angle below which axes have no single common normal."""


class _Axes(NamedTuple):
    """Geometry of the joint axes; independent of configuration and base."""

    distances: tuple[float, ...]
    """Distances between consecutive axes, along their common normal, m."""
    angles_deg: tuple[float, ...]
    """Angles between consecutive axes, 0° to 90°."""
    offsets: tuple[float | None, ...]
    """Offsets along each axis but the first and last, between its common normals with the
    neighbouring axes, m; ``None`` if a neighbour is parallel."""


@dataclass(frozen=True, eq=False)
class KnownRobot:
    """A robot whose joint speed limits are public.

    Attributes:
        name: Maker and model.
        pattern: What a name of the model, its file or its bodies contains, lower case.
        axes: Geometry.
        speeds_deg: Largest joint speeds from the base on, degrees/s.
        source: Source of the speeds.
    """

    name: str
    pattern: str
    axes: _Axes
    speeds_deg: tuple[float, ...]
    source: str

    @property
    def speeds(self) -> Array:
        """Largest joint speeds from the base on, rad/s."""
        return np.radians(self.speeds_deg)


_NONE = (None, None, None)


def _universal(
    model: str, upper: float, lower: float, wrist: float, speeds: tuple[float, ...]
) -> KnownRobot:
    axes = _Axes((0.0, upper, lower, 0.0, 0.0), (90.0, 0.0, 0.0, 90.0, 90.0), (*_NONE, wrist))
    return KnownRobot(
        f"Universal Robots {model}",
        rf"{model.lower()}(?![a-z0-9])",
        axes,
        speeds,
        f"Universal Robots e-Series User Manual, {model}, version 5.8, technical specifications",
    )


def _iiwa(model: str, pattern: str, d: float, speeds: tuple[float, ...]) -> KnownRobot:
    axes = _Axes((0.0,) * 6, (90.0,) * 6, (0.0, d, 0.0, 0.4, 0.0))
    source = "KUKA, Sensitive robotics: LBR iiwa (brochure), axis data"
    return KnownRobot(f"KUKA LBR iiwa {model}", pattern, axes, speeds, source)


KNOWN_ROBOTS: tuple[KnownRobot, ...] = (
    KnownRobot(
        "Fanuc M-16iB/20",
        r"m-?16ib",
        _Axes((0.15, 0.77, 0.1, 0.0, 0.0), (90.0, 0.0, 90.0, 90.0, 90.0), (None, None, 0.74, 0.0)),
        (165.0, 165.0, 175.0, 350.0, 340.0, 520.0),
        "Fanuc M-16iB maintenance manual B-81765EN/02, as cited by ros-industrial/fanuc",
    ),
    _universal("UR3e", 0.24355, 0.2132, 0.08535, (180.0,) * 3 + (360.0,) * 3),
    _universal("UR5e", 0.425, 0.3922, 0.0997, (180.0,) * 6),
    _universal("UR10e", 0.6127, 0.57155, 0.11985, (120.0, 120.0, 180.0, 180.0, 180.0, 180.0)),
    KnownRobot(
        "Franka Emika Panda",
        r"panda",
        _Axes((0.0, 0.0, 0.0825, 0.0825, 0.0, 0.088), (90.0,) * 6, (0.0, 0.316, 0.0, 0.384, 0.0)),
        tuple(float(x) for x in np.degrees([2.175] * 4 + [2.61] * 3)),
        "Franka Control Interface documentation, robot and interface specifications, Panda",
    ),
    _iiwa("7 R800", r"iiwa_?7|r800", 0.4, (98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0)),
    _iiwa("14 R820", r"iiwa_?14|r820", 0.42, (85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0)),
    KnownRobot(
        "KUKA KR 16-2",
        r"kr_?16[-_]?2",
        _Axes(
            (0.26, 0.68, 0.035, 0.0, 0.0), (90.0, 0.0, 90.0, 90.0, 90.0), (None, None, 0.67, 0.0)
        ),
        (156.0, 156.0, 156.0, 330.0, 330.0, 615.0),
        "KUKA KR 16-2 specification, as in ros-industrial/kuka_experimental",
    ),
)
"""The known robots."""


def known_robot(
    model: mujoco.MjModel,
    frame_name: str | int,
    frame_type: str,
    names: Iterable[str] = (),
) -> KnownRobot | None:
    """The robot of the table whose arm carries a frame; ``None`` if it is none of them.

    Args:
        model: The scene.
        frame_name: A frame at the end of the arm, or on a tool.
        frame_type: ``"body"``, ``"site"`` or ``"geom"``.
        names: Further names, such as that of its file.

    Raises:
        mink.InvalidFrame: If the model has no such frame.
    """
    try:
        screws = SerialChain.of(model, frame_name, frame_type).screws
    except InvalidInput:  # ball and free joints
        return None
    if any(screw.slides for screw in screws):
        return None
    bodies = (model.body(i).name for i in range(1, model.nbody))
    title = model.names.split(b"\0", 1)[0].decode(errors="replace")
    words = " ".join([title, *bodies, *names]).lower()
    axes = _axes(screws)
    for robot in KNOWN_ROBOTS:
        if re.search(robot.pattern, words) and _same(robot.axes, axes):
            return robot
    return None


def known_speeds(
    model: mujoco.MjModel,
    frame_name: str | int,
    frame_type: str,
    names: Iterable[str] = (),
) -> tuple[KnownRobot, dict[str, float]] | None:
    """The recognised robot and its largest joint speeds by joint name, rad/s.

    Arguments as for :func:`known_robot`; ``None`` if it is not in the table.
    """
    robot = known_robot(model, frame_name, frame_type, names)
    if robot is None:
        return None
    joints = JointRanges.of(model).names
    dofs = [screw.dof for screw in SerialChain.of(model, frame_name, frame_type).screws]
    speeds = robot.speeds.tolist()
    return robot, {joints[dof]: speed for dof, speed in zip(dofs, speeds, strict=True)}


def _axes(screws: tuple[Screw, ...]) -> _Axes:
    """The geometry of a chain of hinges."""
    distances: list[float] = []
    angles: list[float] = []
    feet: list[tuple[float, float] | None] = []
    for one, two in itertools.pairwise(screws):
        apart = two.anchor - one.anchor
        normal = np.cross(one.axis, two.axis)
        sine = float(np.linalg.norm(normal))
        angles.append(float(np.degrees(np.arctan2(sine, abs(one.axis @ two.axis)))))
        if sine < _PARALLEL:
            distances.append(float(np.linalg.norm(apart - (apart @ one.axis) * one.axis)))
            feet.append(None)
            continue
        distances.append(float(abs(apart @ normal)) / sine)
        # From both anchors to the common normal: one.axis s − two.axis t + normal u = apart.
        s, t, _ = np.linalg.solve(np.array([one.axis, -two.axis, normal]).T, apart)
        feet.append((float(s), float(t)))
    offsets = [
        None if before is None or after is None else abs(after[0] - before[1])
        for before, after in itertools.pairwise(feet)
    ]
    return _Axes(tuple(distances), tuple(angles), tuple(offsets))


def _same(known: _Axes, found: _Axes) -> bool:
    if len(known.distances) != len(found.distances):
        return False
    lengths = zip(
        (*known.distances, *known.offsets), (*found.distances, *found.offsets), strict=True
    )
    for one, other in lengths:
        if (one is None) != (other is None):
            return False
        if one is not None and other is not None and abs(one - other) > _NEAR:
            return False
    angles = zip(known.angles_deg, found.angles_deg, strict=True)
    return all(abs(one - other) <= _NEAR_DEG for one, other in angles)
