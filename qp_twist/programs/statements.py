"""Statements of robot programs as text: numbers, arguments, quoted texts, comments."""

from __future__ import annotations

import re

from qp_twist.errors import InvalidInput

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LONGEST = 80
"""Characters of a statement that messages show."""
CARRIES = (
    "the robot carries the part to a tool that stands still, which is not read; write the path of "
    "the tool on the part."
)
"""Why a move is refused."""
Statements = list[tuple[int, str]]
"""Statements with their lines."""


def shown(text: str) -> str:
    """A statement as messages show it."""
    text = " ".join(text.split())
    return repr(text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…")


def refuse(line: int, text: str, why: str) -> InvalidInput:
    """The error for a statement."""
    return InvalidInput(f"{shown(text)}: {why}", line=line)


_MARKS = re.compile(r"[,\[\](){}]")


def split(text: str) -> list[str]:
    """Arguments at commas outside brackets; one empty text for nothing."""
    parts, depth, begin = [], 0, 0
    for mark in _MARKS.finditer(text):
        if mark[0] != ",":
            depth += 1 if mark[0] in "[({" else -1
        elif not depth:
            parts.append(text[begin : mark.start()].strip())
            begin = mark.end()
    return [*parts, text[begin:].strip()]


_NAMED = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.+)", re.ASCII | re.DOTALL)


def by_name(line: int, text: str, names: tuple[str, ...]) -> dict[str, str]:
    """Arguments by position or as ``name=value``, by their names."""
    given: dict[str, str] = {}
    for place, argument in enumerate(split(text)):
        named = _NAMED.fullmatch(argument)
        key = named[1] if named else (names[place] if place < len(names) else "")
        if key not in names or key in given:
            raise refuse(line, argument, f"expected the arguments {', '.join(names)}.")
        given[key] = named[2] if named else argument
    return given


def without_texts(line: int, text: str, quotes: str, comment: str) -> tuple[str, str]:
    """A line's code with empty texts in place of its quoted ones, and its comment.

    Args:
        line: Its number.
        text: The line.
        quotes: Characters that begin and end a text; doubled, they stand in it.
        comment: The character that begins a comment.

    Raises:
        InvalidInput: If a text has no end, or what is no comment has other characters than ASCII.
    """
    code, place = "", 0
    if not any(mark in text for mark in quotes + comment):
        code, place = text, len(text)
    while place < len(text):
        mark = text[place]
        if mark == comment:
            break
        if mark in quotes:
            quoted = re.compile(f"{mark}(?:[^{mark}]|{mark}{mark})*{mark}").match(text, place)
            if quoted is None or "\\" in quoted[0]:
                raise refuse(line, text, "expected a text that ends on its line, without \\ in it.")
            code, place = code + '""', quoted.end()
        else:
            code, place = code + mark, place + 1
    if not code.isascii():
        raise refuse(line, code, "expected ASCII characters outside comments and texts.")
    return code.strip(), text[place + 1 :]
