"""Folders of ROS packages, found without ROS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from qp_twist.errors import InvalidInput
from qp_twist.files import is_folder, read_bytes

_LEVELS = 5
"""Number of parent folders in which other folders are looked at for their ``package.xml``."""


def package_folders(name: str, file: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Folders that may be a ROS package, the most likely first.

    If ``packages`` has the package, that folder alone. Else, from the file upwards: a parent folder
    of this name, or whose ``package.xml`` states it; a folder of this name in it; and, a few levels
    up, folders in it whose ``package.xml`` states it.
    """
    if name in packages:
        yield packages[name]
        return
    for level, parent in enumerate(file.resolve().parents):
        if parent.name == name or _stated_name(parent) == name:
            yield parent
        if is_folder(parent / name):
            yield parent / name
        if level < _LEVELS:
            yield from (folder for folder in _folders(parent) if _stated_name(folder) == name)


def how_to_state(name: str) -> str:
    """What to do about a package that is not found."""
    return (
        f"Say where it is: load_robot(..., packages={{{name!r}: folder}}), qp-twist new --package "
        f'{name}=folder, or in a task file [robot.packages] {name} = "folder".'
    )


def _folders(parent: Path) -> list[Path]:
    try:
        return sorted(path for path in parent.iterdir() if path.is_dir())
    except OSError:
        return []


def _stated_name(folder: Path) -> str | None:
    """The name in a folder's ``package.xml``."""
    try:
        text = read_bytes(folder / "package.xml").decode("utf-8", "replace")
    except InvalidInput:
        return None
    found = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    return found[1] if found else None
