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

import inspect
import json
import os
import sys
import tempfile
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, Optional, TypeVar

import tyro
from tyro.extras import SubcommandApp

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

app = SubcommandApp()
Command = TypeVar("Command", bound=Callable[..., Any])


TABLE_WIDTH = 128
"""Of the widest table, that with bands, in characters: no number is cut off."""


# Optional, not a union by |: for that tyro loads typeguard, which takes longer than all of tyro.
Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
Names = Annotated[Optional[str], tyro.conf.arg(metavar="A,B,…")]
MethodName = Annotated[str, tyro.conf.arg(metavar="NAME")]
OptionalMethod = Annotated[Optional[str], tyro.conf.arg(metavar="NAME")]
Solver = Annotated[Optional[str], tyro.conf.arg(metavar="NAME")]
Gain = Annotated[Optional[float], tyro.conf.arg(metavar="K")]
Weight = Annotated[Optional[str], tyro.conf.arg(metavar="gradient|paper|natural|equal")]
Folder = Annotated[Optional[Path], tyro.conf.arg(metavar="DIR")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
OptionalFile = Annotated[Optional[Path], tyro.conf.arg(metavar="FILE")]
External = Annotated[Optional[str], tyro.conf.arg(metavar="AXIS=JOINT,…")]
RobotName = Annotated[Optional[str], tyro.conf.arg(metavar="NAME")]
Calls = Annotated[Optional[str], tyro.conf.arg(metavar="WORD=NAME,…")]
FeedMode = Annotated[Optional[str], tyro.conf.arg(metavar="fastest|constant")]
Share = Annotated[Optional[float], tyro.conf.arg(metavar="SHARE")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Json = Annotated[bool, tyro.conf.arg(name="json"), tyro.conf.FlagCreatePairsOff]

TrajectoryFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRAJECTORY")]
Metres = Annotated[Optional[float], tyro.conf.arg(metavar="M")]
Degrees = Annotated[Optional[float], tyro.conf.arg(metavar="DEG")]
Count = Annotated[int, tyro.conf.arg(metavar="N")]
OptionalCount = Annotated[Optional[int], tyro.conf.arg(metavar="N")]

SHARED = {
    "task": "Name of a shipped task, or path to a .toml file.",
    "trajectory": "File that ends in .csv, .npz, .json or .mcap, or a robot program (.script, "
    ".mod, .src, .ls).",
    "method": "Method name.",
    "methods": "Method names separated by commas; if omitted, all applicable ones.",
    "solver": "Backend of the QPs, e.g. proxqp, osqp; if omitted, machine code.",
    "gain": "Of the secondary objective, instead of the task file's or the method's own.",
    "weight": "Of a centering secondary, likewise.",
    "path": "Toolpath to follow instead of the task's own, e.g. path.csv.",
    "position_tolerance": "Largest linear task error that passes, m; if omitted, as the task file "
    "states it in [study], else 1e-4.",
    "axis_tolerance_deg": "Largest angular task error that passes, degrees; likewise, else 0.05.",
    "robot": "For a program: the robot's name in the table of known robots, or a file with a table "
    "of its own (.toml); if omitted, as the task file states it, or recognised by name and "
    "geometry.",
    "as_modelled": "For a program: the controller counts the joints as the model does.",
    "external": "For a program: the external axis of each joint besides those of the arm, e.g. "
    "'E1 = rail, E2 = -tilt + 90 deg'; if omitted, as the task file states it, or in the scene's "
    "order, as the model counts.",
    "feed": "constant: the tool has the programmed speed but on ramps, and each dip is reported; "
    "if omitted, as the task file states it in [feed] mode.",
    "max_dip": "Largest dip of that speed that passes, e.g. 0.1 of it; likewise.",
    "calls": "For a program: procedures of the controller that it calls for the toolpath's words "
    "of the process, e.g. 'SPINDL ON=SpindleOn, SPINDL OFF=SpindleOff'; others are comments; if "
    "omitted, as the task file states them in [program].",
    "force": "Write a program that does not pass, too; its first line stops a controller.",
    "json_": "Print one JSON document on standard output, and nothing else there.",
}
"""What an option means that several commands have; a command describes its others."""


def command(function: Command) -> Command:
    """Make a function a command; its shared options are described by :data:`SHARED`."""
    text = inspect.getdoc(function) or ""
    shared = [
        f"    {name}: {SHARED[name]}"
        for name in inspect.signature(function).parameters
        if name in SHARED and f"\n    {name}: " not in text
    ]
    if shared:
        head = [] if "\nArgs:\n" in text else ["", "Args:"]
        function.__doc__ = "\n".join([text, *head, *shared])
    app.command(function)
    return function


quiet: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether progress, tables and the names of written files are left out."""
typed: ContextVar[str] = ContextVar("typed", default="")
"""The command line."""


def say(*lines: str) -> None:
    """Print lines on standard output without markup; nothing if quiet."""
    if not quiet.get():
        for line in lines:
            print(line)


def show_json(facts: object) -> None:
    """Print what a command found as JSON."""
    print(json.dumps(facts, ensure_ascii=False, indent=2))


def only_json(asked: bool) -> None:
    """Print nothing more but the JSON document, and errors, if that is asked for."""
    if asked:
        quiet.set(True)


def fail(sentence: str) -> NoReturn:
    """Print on standard error, also if quiet, why a check failed; exit code 1."""
    print(f"qp-twist: {sentence}", file=sys.stderr)
    raise SystemExit(1)


def show(table: RenderableType) -> None:
    """Print a table, whose lines wrap on a narrow terminal; nothing if quiet."""
    if not quiet.get():
        found = _console()
        if not found.is_terminal:
            found = _console(width=TABLE_WIDTH, color_system=None)
        elif found.width < TABLE_WIDTH:
            found = _console(width=TABLE_WIDTH)
        found.print(table)


def _console(**options: Any) -> Console:
    """A console that raises if the output pipe is closed; rich itself would exit with code 1."""
    from rich.console import Console  # not needed by a command that only prints lines

    class Raises(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Raises(**options)


def terminal() -> Console | None:
    """Standard error as a console if it is an interactive terminal and not quiet, else ``None``."""
    interactive = sys.stderr.isatty() and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    return _console(stderr=True) if interactive and not quiet.get() else None


def check_file(file: Path, option: str = "--out") -> None:
    """Refuse a file that cannot be written, before any computation; announce a new folder."""
    from qp_twist.errors import InvalidInput  # with mink, which ``tasks`` does without
    from qp_twist.files import inputs

    if file.is_dir():
        raise InvalidInput(f"{option} {file}: this is a folder; give a file to write.")
    if file.resolve() in (inputs.get() or ()):
        raise InvalidInput(
            f"{option} {file}: the command reads this file; give another one to write."
        )
    _check_writable(file.parent, f"{option} {file}")
    if not file.parent.exists() and not quiet.get():
        print(f"note: {file.parent} is not there yet and will be made", file=sys.stderr)


def check_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a folder that cannot be written to, before any computation."""
    from qp_twist.errors import InvalidInput

    if folder.suffix.lower() in (".html", ".png"):
        raise InvalidInput(
            f"{option} {folder}: expected a folder, in which report.html is written."
        )
    _check_writable(folder, f"{option} {folder}")


def _check_writable(folder: Path, option: str) -> None:
    """Refuse a folder in whose nearest existing one nothing can be written."""
    from qp_twist.errors import InvalidInput

    existing = next(at for at in (folder, *folder.absolute().parents) if at.exists())
    if not existing.is_dir():
        raise InvalidInput(f"{option}: {existing} is a file; give another folder.")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise InvalidInput(
            f"{option}: nothing can be written in {existing} ({error.strerror}); give another "
            "folder."
        ) from None
