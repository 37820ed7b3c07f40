"""The joints of a URDF: types, ranges and speeds."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.robots.wording import listed

_MOVING = ("revolute", "continuous", "prismatic")


def read_joints(root: ET.Element, file: Path) -> tuple[dict[str, float], list[str]]:
    """Speeds by joint, and sentences on what the file lacks; both are unknown to MuJoCo.

    A range from 0 to 0 counts as none: exporters write it for a missing range.

    Raises:
        InvalidInput: If two links are the child of no joint, a joint has another type, its range is
            reversed or a single position other than 0, a number is invalid, or a joint mimics a
            missing one.
    """
    joints = root.findall("joint")
    names = [joint.get("name", "") for joint in joints]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InvalidInput(
            f"{file}: the name of {listed('joint', twice)} is given more than once; rename them."
        )
    _check_roots(root, joints, file)
    moving = [joint.get("name", "") for joint in joints if joint.get("type") in _MOVING]
    speeds: dict[str, float] = {}
    no_range: list[str] = []
    no_speed: list[str] = []
    for name, joint in zip(names, joints, strict=True):
        kind, mimic, where = joint.get("type"), joint.find("mimic"), f"{file}: joint {name!r}"
        if kind == "fixed":
            if mimic is not None:
                joint.remove(mimic)
            continue
        if kind not in _MOVING:
            raise InvalidInput(
                f"{where}: its type is {kind!r}, but only revolute, continuous, prismatic and "
                "fixed joints are read; replace it by those, or by a fixed one if it connects "
                "the robot to the world."
            )
        if mimic is not None:
            _check_mimic(mimic, name, moving, where)
        limit = joint.find("limit")
        limit = ET.SubElement(joint, "limit") if limit is None else limit
        speed = _number(limit, "velocity", math.inf, where)
        if speed <= 0.0:
            no_speed.append(name)
        elif speed < math.inf:
            speeds[name] = speed
        if kind != "continuous" and not _has_range(limit, where):
            limit.attrib.pop("lower", None)  # MuJoCo would warn
            limit.attrib.pop("upper", None)
            no_range += [name] if mimic is None else []
    left_out = []
    if no_range:
        left_out.append(
            f"No range: {listed('joint', no_range)}. None is stated, or one from 0 to 0; taken "
            "as not limited."
        )
    if no_speed:
        left_out.append(f"No velocity limit: {listed('joint', no_speed)}. Only one above 0 counts.")
    return speeds, left_out


def _check_roots(root: ET.Element, joints: list[ET.Element], file: Path) -> None:
    """Refuse a second root link, which MuJoCo would fix to the world's origin."""
    children = {child.get("link") for joint in joints for child in joint.findall("child")}
    links = [link.get("name", "") for link in root.findall("link")]
    roots = [name for name in links if name not in children]
    if len(roots) > 1 and children <= {*links}:  # MuJoCo refuses unknown links
        raise InvalidInput(
            f"{file}: {listed('link', roots)} are the child of no joint, but the links of a URDF "
            "are one tree with one root; connect the others to it, by a fixed joint if they do not "
            "move, or take them out."
        )


def _has_range(limit: ET.Element, where: str) -> bool:
    """Whether a range is given; then both of its ends are set."""
    lower, upper = (_number(limit, end, 0.0, where) for end in ("lower", "upper"))
    if lower > upper:
        raise InvalidInput(
            f"{where}: its range is upside down, from {lower:g} to {upper:g}; swap the two."
        )
    if lower == upper != 0.0:
        raise InvalidInput(
            f"{where}: its range is the one position {lower:g}; make it a fixed joint there."
        )
    # MuJoCo ignores the range of a prismatic joint with a missing end; in URDF that end is 0.
    limit.attrib.update(lower=repr(lower), upper=repr(upper))
    return lower < upper


def _check_mimic(mimic: ET.Element, name: str, moving: list[str], where: str) -> None:
    leader = mimic.get("joint", "")
    if leader not in moving or leader == name:
        raise InvalidInput(
            f"{where}: it mimics {leader!r}, which is no other joint of this file that moves; name "
            f"one of {', '.join(other for other in moving if other != name) or 'several'}."
        )
    for key in ("multiplier", "offset"):
        _number(mimic, key, 0.0, where)


def _number(element: ET.Element, attribute: str, default: float, where: str) -> float:
    text = element.get(attribute, str(default))
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise InvalidInput(
            f"{where}: <{element.tag} {attribute}={text!r}> is not a number; write one."
        )
    return value
