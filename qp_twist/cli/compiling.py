"""A note on standard error while numba makes machine code, which takes long on a new machine."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

from qp_twist.kernel import MACHINE_CODE


class _Note:
    """Whether a command has said so already, and whether it may."""

    due = False


def note_compiling(*, quiet: bool) -> None:
    """Print a note when a kernel is compiled from now on, once; nothing if quiet."""
    _listen()
    _Note.due = not quiet


@cache
def _listen() -> None:
    from numba.core import event  # numba takes half a second

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            if _Note.due:
                _Note.due = False
                print(f"note: {MACHINE_CODE}", file=sys.stderr)

        def on_end(self, event: Any) -> None:
            """Nothing more is said."""

    of_numba: Any = event
    of_numba.register("numba:compile", Listener())
