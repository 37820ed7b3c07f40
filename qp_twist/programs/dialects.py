"""The languages of robot programs, by name and by suffix, and their joint moves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from qp_twist.files import read_bytes
from qp_twist.programs import jbi
from qp_twist.programs.fanuc_ls import LS
from qp_twist.programs.header import read_header
from qp_twist.programs.joint_moves import Beside, Dialect, JointMoves
from qp_twist.programs.krl import KRL
from qp_twist.programs.moves import Course
from qp_twist.programs.rapid import RAPID
from qp_twist.programs.urscript import URSCRIPT

DIALECTS: dict[str, Dialect] = {dialect.name: dialect for dialect in (URSCRIPT, RAPID, KRL, LS)}
"""The languages, by the names that ``--to`` takes."""
EXECUTE = {**{name: each.execute for name, each in DIALECTS.items()}, "jbi": jbi.execute}
"""What executes a program, by its language; jobs of Yaskawa are not written."""
SUFFIXES: tuple[str, ...] = tuple(dialect.suffix for dialect in DIALECTS.values())
"""Suffixes of programs."""


def dialect_of(path: Path) -> Dialect | None:
    """The language of a file by its suffix; ``None`` if it is no program."""
    return next((d for d in DIALECTS.values() if path.suffix.lower() == d.suffix), None)


def files_beside(path: Path) -> Beside:
    """The files in the folder of a program."""

    def read(name: str) -> bytes | None:
        for file in sorted(path.parent.iterdir()):
            if file.name.lower() == name.lower() and file.is_file():
                return read_bytes(file, "program")
        return None

    return read


def joint_moves(
    path: Path, dialect: Dialect, lines: Sequence[str], calls: Collection[str] = ()
) -> JointMoves:
    """The joint moves of a program, which has nothing else but ``calls`` of these procedures.

    Raises:
        InvalidInput: At a statement that ``check`` does not vouch for.
    """
    course = Course(calls)
    comments = dialect.execute(course, lines, path.stem, files_beside(path))
    return course.moves(read_header(comments))
