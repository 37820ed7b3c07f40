"""Read from an SRDF beside a robot's file which of its links need no collision check."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.files import read_text


class DisabledPair(NamedTuple):
    """Two links of a ``<disable_collisions>``, and the reason that the file gives."""

    one: str
    other: str
    reason: str


def srdf_beside(robot: Path, name: str) -> Path | None:
    """The SRDF that belongs to a robot's file; ``None`` if there is none in its folder.

    That is the file of the same stem, else the only one whose robot has the same ``name``.
    """
    stem = robot.name.removesuffix(".xacro").removesuffix(".urdf").removesuffix(".xml")
    same = robot.with_name(f"{stem}.srdf")
    if same.is_file():
        return same
    named = [file for file in sorted(robot.parent.glob("*.srdf")) if _name(file) == name]
    return named[0] if len(named) == 1 else None


def disabled_pairs(srdf: Path) -> tuple[DisabledPair, ...]:
    """The pairs of links between which an SRDF disables collisions.

    Raises:
        InvalidInput: If the file is no XML.
    """
    try:
        root = ET.fromstring(read_text(srdf, "SRDF file"))
    except ET.ParseError as error:
        raise InvalidInput(
            f"{srdf}: is not well-formed XML ({error}); mend it, or move it away from the robot's "
            "file, beside which it is read."
        ) from error
    return tuple(
        DisabledPair(pair.get("link1", ""), pair.get("link2", ""), pair.get("reason", ""))
        for pair in root.iter("disable_collisions")
    )


def _name(file: Path) -> str:
    try:
        return ET.fromstring(read_text(file, "SRDF file")).get("name", "")
    except (ET.ParseError, InvalidInput):
        return ""
