"""The syntax of a robot language: patterns of its blocks and of its statements."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Literal

from qp_twist.programs.moves import Kind
from qp_twist.programs.statements import Statements, refuse

Effect = Literal["joint", "path", "leaves", "assigns", "call", "skip", "silent"] | Kind
"""What a statement does: a joint move; a move, or a change of frames or speeds, that is none;
leaves a loop, a procedure or the program; … ``skip``: moves nothing, and is not known well enough
to vouch for that; ``silent``: not worth a note."""
MOVING: Sequence[Effect] = ("joint", "path", "leaves")
Act = Callable[[int, "re.Match[str]"], str | None]
"""What a statement does, from its line and its match; perhaps a signal, on which runs what behind
it: ``break``, ``continue``, ``return``, ``end`` (of the program) or ``to`` a label."""
Rule = tuple[str, Act, Effect]
"""The pattern of a statement, and what it does."""


class Syntax:
    """Patterns of a language, compiled.

    Args:
        opens: Begins of blocks, their ends, and what becomes of each.
        rules: Statements; the first rule that fits counts, and the last one fits all.
        flags: Of the patterns.
    """

    def __init__(
        self, opens: Sequence[tuple[str, str, str]], rules: Sequence[Rule], flags: re.RegexFlag
    ) -> None:
        self._flags = flags
        self._opens = [(re.compile(begin, flags), end, role) for begin, end, role in opens]
        self._begins = self._any([begin for begin, *_ in opens])
        self._closes = self._any([end for _, end, _ in opens])
        self._rules = [(re.compile(p, flags), act, effect) for p, act, effect in rules]
        self._acts: dict[str, tuple[Act, re.Match[str], Effect]] = {}

    def _any(self, patterns: Sequence[str]) -> re.Pattern[str]:
        """One pattern of several, whose groups have no names."""
        unnamed = (re.sub(r"\(\?P<\w+>", "(", pattern) for pattern in patterns)
        return re.compile("|".join(unnamed) or r"(?!)", self._flags)

    def opened(self, text: str) -> tuple[str, re.Match[str], str] | None:
        """What becomes of the block that a statement begins, and the pattern of its end."""
        if not self._begins.fullmatch(text):
            return None
        fits = ((role, pattern.fullmatch(text), end) for pattern, end, role in self._opens)
        return next((role, match, end) for role, match, end in fits if match)

    def closes(self, text: str) -> bool:
        """Whether a statement ends a block."""
        return self._closes.fullmatch(text) is not None

    def end(self, statements: Statements, begin: int, end: str) -> int:
        """Where the block ends whose first statement is ``begin``."""
        ends = [end]
        for k in range(begin, len(statements)):
            text = statements[k][1]
            opened = self.opened(text)
            if opened is not None:
                ends.append(opened[2])
            elif self.closes(text):
                if not re.fullmatch(ends.pop(), text, self._flags):
                    break
                if not ends:
                    return k
        raise refuse(*statements[begin - 1], "has no end; a line was lost.")

    def act(self, text: str) -> tuple[Act, re.Match[str], Effect]:
        """What a statement does, its match, and its effect."""
        if text not in self._acts:
            fits = ((act, pattern.fullmatch(text), effect) for pattern, act, effect in self._rules)
            self._acts[text] = next((act, match, e) for act, match, e in fits if match)
        return self._acts[text]
