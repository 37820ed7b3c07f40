"""The command ``qp-twist``."""

from __future__ import annotations

import importlib
import io
import sys
from collections.abc import Callable, Sequence
from typing import Any

import mink
import tyro

from qp_twist.cli import REFUSED
from qp_twist.cli.app import app, quiet
from qp_twist.cli.names import check_names
from qp_twist.files import inputs

# Each is a function in a module of its name; help lists them in this order.
COMMANDS = (
    "bench", "check", "compare", "export", "new", "report", "roadmap", "run", "starts", "study",
    "tasks", "view",
)  # fmt: skip


def command(name: str) -> Callable[..., Any]:
    """The function of a command; its module is loaded now."""
    found: Callable[..., Any] = getattr(importlib.import_module(f"qp_twist.cli.{name}"), name)
    return found


def run_command(words: Sequence[str]) -> None:
    """Run the command that the words of the command line name."""
    before, read = quiet.set("--quiet" in words), inputs.set(set())
    for stream in (sys.stdout, sys.stderr):
        # A terminal whose encoding lacks θ prints a question mark instead of a stack trace.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    given = [word for word in words if word != "--quiet"]
    try:
        check_names(given, COMMANDS, command)
        if given[:1] and given[0] in COMMANDS:  # the others need not be loaded
            tyro.cli(command(given[0]), prog=f"qp-twist {given[0]}", args=given[1:])
            return
        for name in COMMANDS:
            command(name)
        app.cli(
            prog="qp-twist",
            description="QP-based task-priority control for tasks of fewer than six degrees of "
            "freedom, beside its closed forms. With --quiet a command prints errors only; "
            "--version prints the version.",
            args=given,
        )
    except mink.MinkError as error:
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None
    finally:
        quiet.reset(before)
        inputs.reset(read)
