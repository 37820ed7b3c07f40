"""The languages of robot programs, by name and by suffix."""

from __future__ import annotations

from pathlib import Path

from qp_twist.programs.fanuc_ls import LS
from qp_twist.programs.joint_moves import Dialect
from qp_twist.programs.krl import KRL
from qp_twist.programs.rapid import RAPID
from qp_twist.programs.urscript import URSCRIPT

DIALECTS: dict[str, Dialect] = {dialect.name: dialect for dialect in (URSCRIPT, RAPID, KRL, LS)}
"""The languages, by the names that ``--to`` takes."""
SUFFIXES: tuple[str, ...] = tuple(dialect.suffix for dialect in DIALECTS.values())
"""Suffixes of programs."""


def dialect_of(path: Path) -> Dialect | None:
    """The language of a file by its suffix; ``None`` if it is no program."""
    for dialect in DIALECTS.values():
        if path.suffix.lower() == dialect.suffix:
            return dialect
    return None
