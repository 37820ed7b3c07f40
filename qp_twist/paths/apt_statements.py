"""Statements of APT-CL and the numbers in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.toolpath import LARGEST_NUMBER

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_FREE = re.compile(r"\s*(?:PARTNO|[PT]PRINT|REMARK|INSERT)", re.IGNORECASE)
_BEGUN = re.compile(r"\s*(?:[A-Z]{3,8}\s*/|RAPID\b)", re.IGNORECASE)
"""Texts, and the begin of a statement."""


class Statement(NamedTuple):
    """A statement: its line, its word, what follows ``/``, and the arguments in that."""

    line: int
    word: str
    rest: str
    arguments: list[str]

    @property
    def text(self) -> str:
        """The whole statement."""
        return f"{self.word}/{','.join(self.arguments)}" if self.arguments else self.word


def statements(lines: Sequence[str]) -> Iterator[Statement]:
    """The statements, with the line that each begins in; ``$`` continues one, ``$$`` ends a line.

    Words and arguments are in capitals. A line ``$$->`` of Creo is continued by ``$``, too. A text
    is not continued by a line that is a statement itself: ``$`` may be part of the text.
    """
    begun, text, comment = 0, "", False
    for k, line in enumerate([*lines, ""], start=1):
        if comment:
            comment = line.rstrip().endswith("$")
            continue
        if text and _FREE.match(text) and _BEGUN.match(line):
            yield _statement(begun, text)
            begun, text = 0, ""
        before, dollar, _ = line.partition("$$")[0].partition("$")
        comment = line.lstrip().startswith("$$->") and line.rstrip().endswith("$")
        begun, text = begun or k, text + before
        if dollar and k <= len(lines):
            continue
        if text.strip():
            yield _statement(begun, text)
        begun, text = 0, ""


def _statement(line: int, text: str) -> Statement:
    word, _, rest = text.strip().partition("/")
    words = (part.strip() for part in word.upper().split(","))
    arguments = [part.strip() for part in rest.upper().split(",")] if rest.strip() else []
    return Statement(line, ",".join(words), rest, arguments)


def taken(word: str, words: list[str], name: str) -> float | None:
    """The number after a name, both taken out of the words; ``None`` without the name."""
    if name not in words:
        return None
    at = words.index(name)
    value = number(f"{word}, {name}", (words[at + 1 :] or [""])[0])
    words[at : at + 2] = []
    return value


def coordinates(of: Statement) -> tuple[float, ...]:
    """Three or six numbers; a seventh, a feed in some systems, is left out."""
    if len(of.arguments) not in (3, 6, 7):
        raise InvalidInput(
            f"{of.word} takes x, y, z or x, y, z, i, j, k; got {len(of.arguments)} numbers"
        )
    pairs = zip("xyzijk", of.arguments, strict=False)
    return tuple(number(f"{of.word}, {name}", argument) for name, argument in pairs)


def unit_vector(word: str, vector: Sequence[float]) -> Array:
    """The direction of an axis."""
    axis = np.array(vector)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InvalidInput(f"{word}: the axis is zero and has no direction")
    return np.asarray(axis / length)


def number(place: str, argument: str) -> float:
    """A number.

    Raises:
        InvalidInput: If it is missing, none, or too large; ``place`` says where.
    """
    compact = argument.replace(" ", "")
    if not argument:
        raise InvalidInput(f"{place}: it is missing")
    if not NUMBER.fullmatch(compact):
        raise InvalidInput(f"{place}: expected a number, got {shortened(argument)!r}")
    value = float(compact.replace("D", "E").replace("d", "e"))
    if not abs(value) <= LARGEST_NUMBER:
        raise InvalidInput(f"{place}: {shortened(argument)!r} is too large")
    return value


def not_read(word: str, what: str) -> InvalidInput:
    """The refusal of a word that changes the path in a way that is not read."""
    return InvalidInput(
        f"{word} is {what}, which is not read; write the path as GOTO lines (in the CAM system: "
        "linear output, no cycles)"
    )
