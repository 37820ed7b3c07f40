"""The task files and scenes that come with the package; found without loading mink."""

from __future__ import annotations

import tomllib
from pathlib import Path


def shipped_folder(name: str) -> Path:
    """The folder ``tasks`` or ``scenes``: in the package of a wheel, beside it in a checkout."""
    package = Path(__file__).parent
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def shipped_tasks() -> list[Path]:
    """The task files that come with the package, by name."""
    return sorted(shipped_folder("tasks").glob("*.toml"))


def task_title(path: Path) -> str:
    """The title line of a task file, without loading its scene."""
    with path.open("rb") as file:
        return str(tomllib.load(file).get("title", ""))
