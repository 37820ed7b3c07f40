"""The command ``qp-twist``."""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import os
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import tyro

from qp_twist.cli import REFUSED
from qp_twist.cli.app import app, quiet, typed

# Each is a function in a module of its name; help lists them in this order.
COMMANDS = (
    "bench", "check", "compare", "export", "new", "place", "report", "roadmap", "run", "show",
    "starts", "study", "tasks", "tolerance", "view",
)  # fmt: skip
READS_NOTHING = "tasks"
"""A command without input files; it starts in the third of a second, as help does: mink, which the
others load, takes one."""
_ABOUT = (
    "QP-based task-priority control for tasks of fewer than six degrees of freedom, beside its "
    "closed forms."
)
_SWITCHES = "With --quiet a command prints errors only; --version prints the version."


def command(name: str) -> Callable[..., Any]:
    """The function of a command; its module is loaded now."""
    found: Callable[..., Any] = getattr(importlib.import_module(f"qp_twist.cli.{name}"), name)
    return found


def run_command(words: Sequence[str]) -> None:
    """Run the command that the words of the command line name."""
    before = quiet.set("--quiet" in words), typed.set(shlex.join(["qp-twist", *words]))
    for stream in (sys.stdout, sys.stderr):
        # A terminal whose encoding lacks θ prints a question mark instead of a stack trace.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    given = [word for word in words if word != "--quiet"]
    try:
        if given[:1] in ([], ["-h"], ["--help"], ["help"]):
            print(overview())
            if not given:
                raise SystemExit(REFUSED)
        elif given[0] == READS_NOTHING:
            _run(given)
        else:
            _run_with_files(given)
    finally:
        quiet.reset(before[0])
        typed.reset(before[1])


def _run(given: list[str]) -> None:
    tyro.cli(command(given[0]), prog=f"qp-twist {given[0]}", args=given[1:])


@contextlib.contextmanager
def _without_opengl() -> Iterator[None]:
    """Within it, MuJoCo is imported without OpenGL, which takes a fifth of its time.

    Pictures are drawn in processes of their own, which choose theirs (``drawing/picture.py``).
    """
    if "MUJOCO_GL" in os.environ:
        yield
        return
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]


def _run_with_files(given: list[str]) -> None:
    """Run a command; the files that it reads are noted, so that it does not write over them."""
    with _without_opengl():
        import mink

    from qp_twist.checks import did_you_mean
    from qp_twist.errors import InvalidInput
    from qp_twist.files import inputs

    read = inputs.set(set())
    try:
        if given[0] in COMMANDS:  # the others need not be loaded
            _run(given)
        elif given[0].startswith("--tyro-"):  # scripts by which a shell completes commands
            for name in COMMANDS:
                command(name)
            app.cli(prog="qp-twist", args=given)
        else:
            hint = did_you_mean(given[0], [*COMMANDS, "--help", "--quiet", "--version"])
            raise InvalidInput(
                f"there is no command {given[0]!r}{hint} Commands: {', '.join(COMMANDS)}."
            )
    except mink.MinkError as error:
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None
    finally:
        inputs.reset(read)


def overview() -> str:
    """The commands, each with the first sentence of its documentation."""
    lines = ["usage: qp-twist COMMAND …", "", *textwrap.wrap(_ABOUT, 80), ""]
    wide = max(map(len, COMMANDS)) + 2
    for name in COMMANDS:
        source = ast.parse(Path(__file__).with_name(f"{name}.py").read_text("utf-8"))
        about = next(
            ast.get_docstring(made) or ""
            for made in source.body
            if isinstance(made, ast.FunctionDef) and made.name == name
        )
        first = " ".join(about.partition("\n\n")[0].split())
        lines += textwrap.wrap(
            first, 80, initial_indent=f"  {name:<{wide}}", subsequent_indent=" " * (wide + 2)
        )
    return "\n".join([*lines, "", "qp-twist COMMAND --help has its options.", _SWITCHES])
