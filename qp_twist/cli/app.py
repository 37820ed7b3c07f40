"""Parts that all commands share: the application, argument types and output.

======  =======================================================================================
code    meaning of an exit code
======  =======================================================================================
0       done
1       checked, and something is wrong
2       the input was refused; the message says why
130     interrupted
141     the reader of the output closed the pipe (``| head -1``), as for a tool ended by SIGPIPE
======  =======================================================================================
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, NoReturn

import tyro
from rich.console import Console, RenderableType
from tyro.extras import SubcommandApp

from qp_twist.cli.compiling import note_compiling
from qp_twist.comparison.table import WIDTH
from qp_twist.errors import InvalidInput
from qp_twist.files import inputs
from qp_twist.following import with_options
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, PathTask, check_method, load_task
from qp_twist.programs import SUFFIXES, dialect_of
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import Check, joints_of

app = SubcommandApp()


class _Console(Console):
    """A console that raises if the output pipe is closed; rich itself would exit with code 1."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
Names = Annotated[str | None, tyro.conf.arg(metavar="A,B,…")]
MethodName = Annotated[str, tyro.conf.arg(metavar="NAME")]
Solver = Annotated[str | None, tyro.conf.arg(metavar="NAME")]
Gain = Annotated[float | None, tyro.conf.arg(metavar="K")]
Weight = Annotated[str | None, tyro.conf.arg(metavar="gradient|paper|natural|equal")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
RobotName = Annotated[str | None, tyro.conf.arg(metavar="NAME")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Json = Annotated[bool, tyro.conf.arg(name="json"), tyro.conf.FlagCreatePairsOff]

quiet: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether progress, tables and the names of written files are left out."""


def say(*lines: str) -> None:
    """Print lines on standard output without markup; nothing if quiet."""
    if not quiet.get():
        for line in lines:
            console().print(line, highlight=False, markup=False, soft_wrap=True)


def fail(sentence: str) -> NoReturn:
    """Print on standard error, also if quiet, why a check failed; exit code 1."""
    print(f"qp-twist: {sentence}", file=sys.stderr)
    raise SystemExit(1)


def with_secondary(
    path_task: PathTask, methods: Sequence[str], gain: float | None, weight: str | None
) -> PathTask:
    """The task with --gain and --weight in place of the settings of the methods that use them."""
    given = {"gain": gain, "weight": weight}
    options = {name: value for name, value in given.items() if value is not None}
    if not options:
        return path_task
    return with_options(path_task, methods, options, " and ".join(f"--{name}" for name in options))


def failure(file: Path, check: Check, written: bool) -> str:
    """The verdict on a file that does not pass, and whether it was written."""
    if dialect_of(file) is None:
        return f"{file}: {check.verdict}"
    if written:
        how = "written with a first line that stops a controller (--force)"
    else:
        how = "the program is not written (--force writes it, with a first line that stops a "
        how += "controller)"
        how += "; the file of this name is an older one" if file.exists() else ""
    return f"{file}: {check.verdict}; {how}"


def show(table: RenderableType) -> None:
    """Print a table; nothing if quiet."""
    if not quiet.get():
        console().print(table)


def console() -> Console:
    """A console at least as wide as the tables: lines wrap, but no number is cut off."""
    found = _Console()
    if not found.is_terminal:
        return _Console(width=WIDTH, color_system=None)
    return found if found.width >= WIDTH else _Console(width=WIDTH)


def terminal() -> Console | None:
    """Standard error as a console if it is an interactive terminal and not quiet, else ``None``."""
    found = _Console(stderr=True)
    interactive = found.is_terminal and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    return found if interactive and not quiet.get() else None


def load(task: str, path: Path | None = None) -> PathTask:
    """Load a task; print on standard error what its robot's and toolpath's files leave out.

    A note follows there if the command has to compile kernels.
    """
    note_compiling(quiet=quiet.get())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path_task = load_task(task, path=path)
    notes = [str(warning.message) for warning in caught]
    if path_task.toolpath is not None:
        notes += path_task.toolpath.notes
    if not quiet.get():
        for note in notes:
            print(f"note: {note}", file=sys.stderr)
    return path_task


def program_joints(
    path: Path, path_task: PathTask, robot: str | None, as_modelled: bool
) -> ControllerJoints | None:
    """How the controller counts the joints, for a file that is a program; ``None`` for others."""
    if dialect_of(path) is None:
        if robot is not None or as_modelled:
            raise InvalidInput(
                f"{path}: --robot and --as-modelled are for programs ({', '.join(SUFFIXES)}); "
                "other files have the model's joints."
            )
        return None
    names = JointRanges.of(path_task.shown.model).names
    return joints_of(path_task, names, robot=robot, as_modelled=as_modelled)


def method_names(path_task: PathTask, methods: str | None) -> list[str]:
    """The methods named in an argument; without it all applicable ones."""
    if methods is None:
        return path_task.method_names()
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise InvalidInput(f"--methods {methods!r}: no name in it; known: {', '.join(METHODS)}.")
    return [check_method(name) for name in names]


def check_file(file: Path, option: str = "--out") -> None:
    """Refuse a file that cannot be written, before any computation; announce a new folder."""
    if file.is_dir():
        raise InvalidInput(f"{option} {file}: this is a folder; give a file to write.")
    if file.resolve() in (inputs.get() or ()):
        raise InvalidInput(
            f"{option} {file}: the command reads this file; give another one to write."
        )
    if why := _no_folder(file.parent):
        raise InvalidInput(
            f"{option} {file}: {file.parent}: {why[0]}; give a file in another folder."
        )
    if not file.parent.exists() and not quiet.get():
        print(f"note: {file.parent} is not there yet and will be made", file=sys.stderr)


def check_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a folder that cannot be written to, before any computation."""
    if why := _no_folder(folder):
        raise InvalidInput(f"{option} {folder}: {why[0]}; {why[1]}.")


def _no_folder(folder: Path) -> tuple[str, str] | None:
    """Why a folder cannot be written to, and what to do; ``None`` if it can.

    Tested with a temporary file in the nearest existing folder.
    """
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    if not existing.is_dir():
        which = "this" if existing == folder.absolute() else str(existing)
        return f"{which} is a file", "give a folder to write to"
    try:
        with tempfile.TemporaryFile(dir=existing):
            return None
    except OSError as error:
        return f"nothing can be written there ({error.strerror})", "give another folder"
