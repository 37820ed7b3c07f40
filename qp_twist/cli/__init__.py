"""The command-line interface."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Sequence
from typing import TextIO

from qp_twist import __version__

REFUSED = 2
"""Exit code of refused input, or of a file that could not be read or written."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, 128 + SIGINT."""
NOT_READ = 141
"""Exit code if the reader of the output has closed the pipe, 128 + SIGPIPE."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of ``qp-twist``.

    ``--quiet`` may be any of the arguments; ``--version`` must be the only one.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            _main(words)
        finally:
            for stream in _streams():
                stream.flush()  # here, so that errors are reported, and not when Python exits
    except OSError as error:
        unread = isinstance(error, BrokenPipeError) and not all(map(_is_read, _streams()))
        for stream in _streams():
            _discard_buffer(stream)
        if unread:
            raise SystemExit(NOT_READ) from None
        print(f"qp-twist: {error}", file=sys.stderr)
        raise SystemExit(REFUSED) from None


def _streams() -> list[TextIO]:
    return [stream for stream in (sys.stdout, sys.stderr) if stream is not None]


def _is_read(stream: TextIO) -> bool:
    """Whether the other end of a pipe is still open."""
    if not hasattr(select, "poll"):  # Windows
        return False
    end = select.poll()
    end.register(stream.fileno(), 0)
    return not any(event & (select.POLLERR | select.POLLHUP) for _, event in end.poll(0))


def _discard_buffer(stream: TextIO) -> None:
    """Empty a stream's buffer, so that Python does not fail on it again at exit."""
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


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
