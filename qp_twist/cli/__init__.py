"""The command-line interface."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Sequence
from typing import TextIO

from qp_twist import __version__

REFUSED = 2
"""Exit code where the input was refused, or something could not be read or written."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""
NOT_READ = 141
"""The same of a command that nobody reads the output of, 128 + SIGPIPE."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of ``qp-twist``.

    ``--quiet`` may stand anywhere among the arguments; ``--version`` stands alone.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            _main(given)
        finally:
            for stream in _streams():
                stream.flush()  # here, where it can be seen, and not when Python ends
    except OSError as error:
        unread = isinstance(error, BrokenPipeError) and not all(map(_is_read, _streams()))
        for stream in _streams():
            _drop_what_cannot_be_written(stream)
        if unread:
            raise SystemExit(NOT_READ) from None
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None


def _streams() -> list[TextIO]:
    return [stream for stream in (sys.stdout, sys.stderr) if stream is not None]


def _is_read(stream: TextIO) -> bool:
    """Whether there is still somebody at the other end of a pipe."""
    if not hasattr(select, "poll"):  # Windows
        return False
    end = select.poll()
    end.register(stream.fileno(), 0)
    return not any(event & (select.POLLERR | select.POLLHUP) for _, event in end.poll(0))


def _drop_what_cannot_be_written(stream: TextIO) -> None:
    """Empty a stream's buffer, so that Python does not try again, and complain, when it ends."""
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _main(given: list[str]) -> None:
    if given == ["--version"]:
        print(f"qp-twist {__version__}")
        return
    try:
        # What the commands need takes a second to load; Ctrl-C in that second is said, too.
        from qp_twist.cli.command import run_command

        run_command(given)
    except KeyboardInterrupt:
        print("qp-twist: interrupted; files that were written before are whole.", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
