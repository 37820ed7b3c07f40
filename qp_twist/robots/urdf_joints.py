"""The joints of a URDF: types, ranges, speeds, and which joint follows which."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.robots.wording import listed

_MOVING = ("revolute", "continuous", "prismatic")


class Mimic(NamedTuple):
    r"""A joint that follows another, :math:`\theta = o + r\,\theta_{leader}`."""

    joint: str
    leader: str
    ratio: float
    offset: float
    """rad or m."""


class Joints(NamedTuple):
    """What the joints of a file say beyond what MuJoCo's reader takes from them."""

    velocity_limits: dict[str, float]
    mimics: list[Mimic]
    left_out: list[str]


def read_joints(root: ET.Element, file: Path) -> Joints:
    """Read the joints, and leave in the tree what every version of MuJoCo reads alike.

    A continuous joint has no range whatever its ``<limit>`` says. A range from 0 to 0 is what
    exporters write for one that nobody stated: no range. ``<mimic>`` is taken out.

    Raises:
        InvalidInput: If a joint is of another type, its range is upside down or a single position
            other than 0, a number is none, or a joint follows one that is not there.
    """
    joints = root.findall("joint")
    _check_names(joints, file)
    moving = [joint.get("name", "") for joint in joints if joint.get("type") in _MOVING]
    speeds: dict[str, float] = {}
    mimics: list[Mimic] = []
    no_range: list[str] = []
    no_speed: list[str] = []
    for joint in joints:
        name, kind = joint.get("name", ""), joint.get("type")
        where = f"{file}: joint {name!r}"
        _check_vectors(joint, where)
        mimic = joint.find("mimic")
        if mimic is not None:
            joint.remove(mimic)
        if kind == "fixed":
            continue
        if kind not in _MOVING:
            raise InvalidInput(
                f"{where}: its type is {kind!r}, but only revolute, continuous, prismatic and "
                "fixed joints are read; replace it by those, or by a fixed one if it connects "
                "the robot to the world."
            )
        if mimic is not None:
            mimics.append(_mimic(mimic, name, moving, where))
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        speed = _number(limit, "velocity", math.inf, where)
        if speed <= 0.0:
            no_speed.append(name)
        elif speed < math.inf:
            speeds[name] = speed
        if kind == "continuous" or not _has_range(limit, where):
            limit.attrib.pop("lower", None)
            limit.attrib.pop("upper", None)
            if kind != "continuous" and mimic is None:
                no_range.append(name)
    left_out = []
    if no_range:
        left_out.append(
            f"No range: {listed('joint', no_range)}. None is stated, or one from 0 to 0; taken "
            "as not limited."
        )
    if no_speed:
        left_out.append(f"No velocity limit: {listed('joint', no_speed)}. Only one above 0 counts.")
    return Joints(speeds, mimics, left_out)


def _check_names(joints: list[ET.Element], file: Path) -> None:
    names = [joint.get("name", "") for joint in joints]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidInput(
            f"{file}: the name of {listed('joint', twice)} is given more than once; rename them."
        )


def _check_vectors(joint: ET.Element, where: str) -> None:
    """MuJoCo lets a NaN pass."""
    for element in (*joint.findall("origin"), *joint.findall("axis")):
        for attribute in ("xyz", "rpy"):
            text = element.get(attribute, "0 0 0")
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError:
                numbers = []
            if len(numbers) != 3 or not all(math.isfinite(value) for value in numbers):
                raise InvalidInput(
                    f"{where}: <{element.tag} {attribute}={text!r}>: expected three numbers."
                )


def _has_range(limit: ET.Element, where: str) -> bool:
    """Whether a range is stated; then both of its ends are."""
    lower, upper = (_number(limit, end, 0.0, where) for end in ("lower", "upper"))
    if lower > upper:
        raise InvalidInput(
            f"{where}: its range is upside down, from {lower:g} to {upper:g}; swap the two."
        )
    if lower == upper != 0.0:
        raise InvalidInput(
            f"{where}: its range is the one position {lower:g}; make it a fixed joint there."
        )
    # MuJoCo takes a range of which one end is not stated for none; URDF has it end at 0.
    limit.attrib.update(lower=repr(lower), upper=repr(upper))
    return lower < upper


def _mimic(mimic: ET.Element, name: str, moving: list[str], where: str) -> Mimic:
    leader = mimic.get("joint", "")
    if leader not in moving or leader == name:
        raise InvalidInput(
            f"{where}: it mimics {leader!r}, which is no other joint of this file that moves; name "
            f"one of {', '.join(other for other in moving if other != name) or 'several'}."
        )
    ratio = _number(mimic, "multiplier", 1.0, where)
    return Mimic(name, leader, ratio, _number(mimic, "offset", 0.0, where))


def _number(element: ET.Element, attribute: str, default: float, where: str) -> float:
    text = element.get(attribute)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise InvalidInput(
            f"{where}: <{element.tag} {attribute}={text!r}> is not a number; write one."
        )
    return value
