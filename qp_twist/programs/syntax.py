"""A robot language: patterns of its blocks and of its statements."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from qp_twist.programs.moves import Kind

Effect = Literal["joint", "path", "leaves", "assigns", "call", "skip", "silent"] | Kind
"""What a statement does: a joint move; a move, or a change of frames or speeds, that is none;
leaves a loop, a procedure or the program; … ``skip``: moves nothing, and is not known well enough
to vouch for that; ``silent``: not worth a note."""
MOVING: Sequence[Effect] = ("joint", "path", "leaves")
Act = Callable[[int, "re.Match[str]"], str | None]
"""What a statement does, from its line and its match; perhaps a signal, on which runs what behind
it: ``break``, ``continue``, ``return``, ``end`` (of the program) or ``to`` a label."""
Rule = tuple[str, Act | str, Effect]
"""The pattern of a statement, and what it does; a text is its signal, and does nothing else."""


class Language(NamedTuple):
    """Patterns of a language.

    Attributes:
        opens: Begins of blocks, their ends, and what becomes of each: ``procedure`` (groups
            ``name``, ``arguments``), ``once`` (it runs where it stands), ``for`` (groups ``name``,
            ``first``, ``last``, ``step``), ``if`` and ``while`` (group ``condition``), ``until``
            (this group is in the end), ``for ever``, ``never``; ``open`` if nothing says whether it
            runs.
        otherwise: Other branches of an ``if``, with their ``condition``.
        coordinates: What stands in statements with a position, or with a frame by its number.
        outside: What may stand outside procedures, if that is strict.
        enclosed: Whether only in another block.
        reads: What ``check`` reads, for messages.
        own_counter: Whether the counter of ``for`` is the loop's own; without a step it then also
            counts down.
        flags: Of the patterns.
    """

    opens: Sequence[tuple[str, str, str]] = ()
    otherwise: str = r"(?!)"
    coordinates: str = r"\["
    outside: str = r".*"
    enclosed: bool = False
    reads: str = ""
    own_counter: bool = False
    flags: re.RegexFlag = re.IGNORECASE | re.ASCII | re.DOTALL
