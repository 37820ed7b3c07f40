"""How the numbers of a line are told apart: delimiter and decimal mark."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from qp_twist.errors import InvalidInput

_POINT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]+)?|,[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(?:1\.#)?(?:nan|inf|infinity|ind|qnan)(?:\(\w*\))?", re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """How one line is split.

    Attributes:
        delimiter: Between the fields; empty for any blanks.
        decimal: The decimal mark, ``"."`` or ``","``.
    """

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """The fields of a line, stripped of blanks and quotes."""
        if not self.delimiter:
            fields = line.split()
        else:
            fields = self._quoted(line) if '"' in line else line.split(self.delimiter)
        return [field.strip().strip('"').strip() for field in fields]

    def _quoted(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
        except csv.Error:  # a field longer than any number; that is said where it is read
            return line.split(self.delimiter)

    def names(self, line: str) -> list[str]:
        """The fields of a header line: a unit in brackets belongs to the name before it."""
        if self.delimiter:
            return self.split(line)
        found: list[str] = []
        for field in self.split(line):
            if found and field[0] in "[(":
                found[-1] += f" {field}"
            else:
                found.append(field)
        return found

    def number(self, field: str) -> float | None:
        """The number that a field states, NaN and infinite ones included; ``None`` for text."""
        field = field.replace("\u2212", "-")
        if (_POINT if self.decimal == "." else _COMMA).fullmatch(field):
            return float(field.replace(",", ".").replace("d", "e").replace("D", "e"))
        return float("nan") if _NOT_FINITE.fullmatch(field) else None


_DIALECTS = [Dialect(d, m) for d in ";\t" for m in ".,"] + [
    Dialect(",", "."),
    Dialect("", "."),
    Dialect("", ","),
]


def detected(name: str, lines: Iterable[str]) -> Dialect:
    """The dialect in which the first lines of a file have the most numbers.

    Raises:
        InvalidInput: If in none of them a line has three numbers.
    """
    sample = list(_first(lines, 300))
    scores = [sum(_numbers(dialect, line) for line in sample) for dialect in _DIALECTS]
    best = max(scores, default=0)
    if best == 0:
        raise InvalidInput(
            f"{name}: no line has three numbers; a toolpath needs x, y and z in every row, "
            "separated by commas, semicolons, tabs or blanks."
        )
    return _DIALECTS[scores.index(best)]


def _numbers(dialect: Dialect, line: str) -> int:
    count = sum(dialect.number(field) is not None for field in dialect.split(line))
    return count if count >= 3 else 0


def _first(lines: Iterable[str], count: int) -> Iterator[str]:
    for line in lines:
        if count == 0:
            return
        if line.strip():
            count -= 1
            yield line
