"""The command ``qp-twist``."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence

import mink

# Each module adds its command; help lists them in this order.
from qp_twist.cli import (
    REFUSED,
    bench,
    check,
    compare,
    export,
    new,
    report,
    roadmap,
    run,
    starts,
    study,
    tasks,
    view,
)
from qp_twist.cli.app import app, quiet
from qp_twist.cli.names import check_names
from qp_twist.files import inputs

COMMANDS = {
    module.__name__.rpartition(".")[2]: getattr(module, module.__name__.rpartition(".")[2])
    for module in (
        bench,
        check,
        compare,
        export,
        new,
        report,
        roadmap,
        run,
        starts,
        study,
        tasks,
        view,
    )
}


def run_command(words: Sequence[str]) -> None:
    """Run the command that the words of the command line name."""
    before, read = quiet.set("--quiet" in words), inputs.set(set())
    for stream in (sys.stdout, sys.stderr):
        # A terminal whose encoding lacks θ prints a question mark instead of a stack trace.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        check_names(words, COMMANDS)
        app.cli(
            prog="qp-twist",
            description="QP-based task-priority control for tasks of fewer than six degrees of "
            "freedom, beside its closed forms. With --quiet a command prints errors only; "
            "--version prints the version.",
            args=[argument for argument in words if argument != "--quiet"],
        )
    except mink.MinkError as error:
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None
    finally:
        quiet.reset(before)
        inputs.reset(read)
