"""The command-line interface."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from qp_twist import __version__

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of ``qp-twist``.

    ``--quiet`` may stand anywhere among the arguments; ``--version`` stands alone.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
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
