"""Read a table of numbers with a header, and collect its problems."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files.table_text import Dialect, shortened
from qp_twist.files.table_units import is_unit_row, split_unit

SHOWN = 20
"""Number of problems that are listed; the others are counted."""
_LOOKED_AT = 300
"""Number of lines from which the dialect is detected."""
_COMMENT = re.compile(r"\s*(?:#|//|%)")
_SPREADSHEET_ERROR = re.compile(r"\s*\"?#(?:N/?A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")


class Problems:
    """Problems of a file, collected so that all are reported at once."""

    def __init__(self) -> None:
        self._found: list[InvalidInput] = []

    def __len__(self) -> int:
        """How many there are."""
        return len(self._found)

    def add(
        self,
        line: int,
        what: str,
        column: str = "",
        options: Mapping[str, str | None] | None = None,
    ) -> None:
        """Add a problem.

        Args:
            line: Of the file, from 1.
            what: What was read and what was expected, without a full stop.
            column: Column or word in the line, if there is one to name.
            options: Options of a toolpath that settle it.
        """
        self._found.append(InvalidInput(f"{what}.", line=line, column=column, options=options))

    def refuse(self) -> None:
        """Raise if there is a problem.

        Raises:
            InvalidInput: With every problem in the order of the lines, or the first :data:`SHOWN`
                and the number of others.
        """
        found = sorted(self._found, key=lambda problem: problem.line or 0)
        if len(found) == 1:
            raise found[0]
        if found:
            hidden = len(found) - SHOWN
            more = [f"and {hidden} more."] if hidden > 0 else []
            lines = [f"{len(found)} problems:", *map(str, found[:SHOWN]), *more]
            options = {name: value for one in found for name, value in one.options.items()}
            raise InvalidInput("\n  ".join(lines), options=options)


class TableLine(NamedTuple):
    """A line below the header.

    Attributes:
        line: Of the file, from 1.
        fields: Fields of the line; none if it repeats the header or the units.
        numbers: Numbers of the requested columns; ``None`` for a blank line or text.
    """

    line: int
    fields: list[str]
    numbers: tuple[float, ...] | None


class Table:
    """A table: its dialect, column names and first row.

    Args:
        lines: Lines of the file.
        least: Smallest number of numbers in a row.
        expected: Expected contents, for the message.
        texts: Whether lines of text are allowed between the rows, and between header and rows; if
            not, they are invalid rows.
        is_header: Whether some names are those of a header. Without such a line, the header is the
            first line of text (with ``texts`` the last) that has as many entries as a row.

    Attributes:
        names: Names of the columns, with their units; empty without a header line.
        width: Number of columns.
        first: Index of the line with the first row.
        first_row: That line.
        title: Text between the header and the first row.
        counts: Line, from 1, that has the number of the rows, or numbers the columns from 0, as
            point clouds and pandas have it; ``None`` without one.

    Raises:
        InvalidInput: If there is no row of numbers.
    """

    def __init__(
        self,
        lines: Sequence[str],
        *,
        least: int,
        expected: str,
        texts: bool,
        is_header: Callable[[Sequence[str]], bool],
    ) -> None:
        data = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
        dialect = Dialect.detected([lines[k] for k in data[:_LOOKED_AT]], least, expected)
        self._lines, self._dialect, self._texts = lines, dialect, texts
        found_rows = (k for k in data if not self._is_text(dialect.split(lines[k])))
        first, second = next(found_rows, None), next(found_rows, None)
        if first is None:
            raise InvalidInput("there is no row of numbers in it.")
        self.counts = None
        if second is not None and _counts(*(dialect.split(lines[k]) for k in (first, second))):
            self.counts, first = first + 1, second
        self.width = len(_stripped(dialect.split(lines[first])))
        at, names = -1, list[str]()
        for index in range(first - 1, -1, -1) if texts else range(first):
            if index + 1 == self.counts:
                continue
            comment = _is_comment(lines[index])
            text = _COMMENT.sub("", lines[index], count=1) if comment else lines[index]
            found = _stripped(dialect.names(text))
            fits = len(found) == self.width
            if found and (fits or not comment) and is_header(found):
                at, names = index, found
                break
            usable = fits and not comment and self.width >= least
            if at < 0 and usable and not is_unit_row(found, self.width):
                at, names = index, found
        between = [k for k in data if at < k < first]
        for index in between if names else ():
            units = _stripped(dialect.split(lines[index]))
            if is_unit_row(units, len(names)):
                units += [""] * (len(names) - len(units))
                names = [_with_unit(*pair) for pair in zip(names, units, strict=True)]
                between.remove(index)
                break
        self.names, self.width = tuple(names), len(names) or self.width
        self.first = between[0] if between and not texts else first
        self.title = " ".join(filter(None, dialect.split(lines[between[-1]]))) if between else ""
        self._header = lines[at] if names else None
        self.first_row = lines[first]

    def call(self, index: int) -> str:
        """Name of a column in messages."""
        return f"column {self.names[index]!r}" if self.names else f"column {index + 1}"

    def rows(
        self, columns: Sequence[int], problems: Problems, may_be_blank: Sequence[int] = ()
    ) -> Iterator[TableLine]:
        """The rows, and the blank lines and lines of text between them.

        Args:
            columns: Indices of the columns that must contain finite numbers.
            problems: Collects every invalid row.
            may_be_blank: Those that may also be blank, which counts as 0.
        """
        for index in range(self.first, len(self._lines)):
            line = self._lines[index]
            if _is_comment(line):
                continue
            fields = self._dialect.split(line)
            numbers = self._numbers(fields, columns, may_be_blank)
            if numbers is not None or not any(fields):
                yield TableLine(index + 1, fields, numbers)
            elif self._texts and self._separates(fields, columns):
                again = len(fields) == self.width and is_unit_row(fields, self.width)
                yield TableLine(index + 1, [] if again or line == self._header else fields, None)
            else:
                self._explain(problems, index + 1, fields, columns)

    def sample(self, count: int) -> Array:
        """The numbers of the first rows, (N, columns), NaN for other entries."""
        found, width = [], self.width
        for line in self._lines[self.first : self.first + 2 * count]:
            fields = self._dialect.split(line)
            if not _is_comment(line) and len(fields) >= width and any(fields):
                numbers = [self._dialect.number(field) for field in fields[:width]]
                found.append([np.nan if value is None else value for value in numbers])
        return np.array(found[:count], dtype=np.float64).reshape(-1, width)

    def _numbers(
        self, fields: list[str], columns: Sequence[int], may_be_blank: Sequence[int]
    ) -> tuple[float, ...] | None:
        """The numbers of a row, or ``None`` if it is invalid."""
        width = self.width
        if len(fields) < width or (len(fields) > width and len(_stripped(fields)) > width):
            return None
        found = []
        for index in columns:
            value = self._dialect.number(fields[index])
            if index in may_be_blank and not fields[index]:
                value = 0.0
            if value is None or not math.isfinite(value):
                return None
            found.append(value)
        return tuple(found)

    def _separates(self, fields: Sequence[str], columns: Sequence[int]) -> bool:
        """Whether a line among the rows is text, not an invalid row."""
        if len(fields) == self.width:
            numbers = sum(self._dialect.number(fields[i]) is not None for i in columns)
            # Words between blanks may be as many as there are columns: "Inner seam 2".
            if numbers and (self._dialect.delimiter or 2 * numbers >= len(columns)):
                return False
        return self._is_text(fields)

    def _is_text(self, fields: Sequence[str]) -> bool:
        """Whether a line has no numbers.

        If texts are allowed, also a line that begins with a word and is not mostly numbers.
        """
        numbers = [self._dialect.number(field) is not None for field in fields if field]
        return not any(numbers) or (
            self._texts and not numbers[0] and 2 * sum(numbers) <= len(numbers)
        )

    def _explain(
        self, problems: Problems, line: int, fields: list[str], columns: Sequence[int]
    ) -> None:
        """Add the problem of a row."""
        dialect, width, count = self._dialect, self.width, len(_stripped(fields))
        if count > width:
            row = shortened(" | ".join(fields))
            what = f"{count} columns, where {width} are expected; the row reads {row!r}"
            problems.add(line, what)
            return
        for index in columns:
            field = fields[index] if index < len(fields) else ""
            value = dialect.number(field)
            if not field:
                short = f"; the row has {count} of {width} columns"
                what = f"the number is missing{short if count < width else ''}"
            elif value is None:
                other = replace(dialect, decimal="," if dialect.decimal == "." else ".")
                mark = (
                    "" if other.number(field) is None else f"; elsewhere it is {dialect.decimal!r}"
                )
                hint = mark and f" with the decimal mark {other.decimal!r}{mark}"
                what = f"expected a number, got {shortened(field)!r}{hint}"
            elif not math.isfinite(value):
                what = f"expected a finite number, got {shortened(field)!r}"
            else:
                continue
            problems.add(line, what, self.call(index))
            return
        what = f"missing; the row has {len(fields)} of {width} columns"
        problems.add(line, what, self.call(len(fields)))


def columns_named(names: Sequence[str], name: str) -> list[int]:
    """Indices of the columns with a name: exactly, or without unit and case."""
    exact = [i for i, other in enumerate(names) if other == name]
    bare = name.strip().lower()
    return exact or [i for i, other in enumerate(names) if split_unit(other)[0].lower() == bare]


def _with_unit(name: str, unit: str) -> str:
    """A name with the unit below it, which may repeat that of the name."""
    both = f"{name} [{unit.strip('[](){} ')}]"
    return name if not unit or split_unit(name)[1] == split_unit(both)[1] else both


def _counts(fields: Sequence[str], row: Sequence[str]) -> bool:
    """Whether whole numbers before a row count rows or columns, and are no row themselves."""
    filled = [field for field in fields if field]
    numbered = filled == [str(k) for k in range(len(filled))] and "." in "".join(row)
    return (len(filled) == 1 < len(row) and filled[0].isdecimal()) or (len(filled) > 2 and numbered)


def _is_comment(line: str) -> bool:
    return bool(_COMMENT.match(line)) and not _SPREADSHEET_ERROR.match(line)


def _stripped(fields: list[str]) -> list[str]:
    """Fields without empty ones at the end, which some programs write."""
    while fields and not fields[-1]:
        fields = fields[:-1]
    return fields
