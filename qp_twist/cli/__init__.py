"""The command-line interface."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from collections.abc import Sequence

from qp_twist import __version__

REFUSED = 2
"""Exit code of refused input, or of a file that could not be read or written."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, 128 + SIGINT."""
NOT_READ = 141
"""Exit code if the reader of the output has closed the pipe, 128 + SIGPIPE."""

_RARELY = 300_000
"""Threshold of the garbage collector. What a command imports and loads, a quarter of a million
objects, stays alive until its end: to look through it at Python's threshold of 700 takes a fifth of
the time of ``run``; once, a twentieth."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of ``qp-twist``.

    ``--quiet`` may be any of the arguments; ``--version`` must be the only one.
    """
    if arguments is not None:
        _reported(list(arguments))
        return
    gc.set_threshold(_RARELY)
    code: object = 0
    try:
        _reported(sys.argv[1:])
    except SystemExit as ended:
        code = ended.code or 0
    if not isinstance(code, int) or threading.active_count() > 1:
        raise SystemExit(code)
    # Python would take a thirtieth of the time of ``run`` to delete all that was loaded.
    atexit._run_exitfuncs()
    os._exit(code)


def _reported(words: list[str]) -> None:
    """Run a command; errors of files, and of the output, end it with their exit codes."""
    try:
        try:
            _main(words)
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()  # here, so that errors are reported, and not when Python exits
    except OSError as error:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except (
                OSError
            ):  # what is left in the buffer goes nowhere, or Python fails again at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if isinstance(error, BrokenPipeError):
            raise SystemExit(NOT_READ) from None
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None


def _main(words: list[str]) -> None:
    if words in (["--version"], ["-V"]):
        print(f"qp-twist {__version__}")
        return
    try:
        # Imported here: it takes a second, in which Ctrl-C is reported, too.
        from qp_twist.cli.command import run_command

        run_command(words)
    except KeyboardInterrupt:
        print("qp-twist: interrupted; files that were written before are whole.", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
