"""Tables of numbers with names, read from a text or made by a reader, and their problems."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

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
        """Add a problem of a line, from 1: a clause, its column, the options that settle it."""
        self._found.append(InvalidInput(f"{what}.", line=line, column=column, options=options))

    def refuse(self) -> None:
        """Raise the only problem, or the first :data:`SHOWN` in the order of the lines."""
        found = sorted(self._found, key=lambda problem: problem.line or 0)
        if len(found) == 1:
            raise found[0]
        if found:
            hidden = len(found) - SHOWN
            more = [f"and {hidden} more."] if hidden > 0 else []
            lines = [f"{len(found)} problems:", *map(str, found[:SHOWN]), *more]
            options = {name: value for one in found for name, value in one.options.items()}
            raise InvalidInput("\n  ".join(lines), options=options)


@dataclass(eq=False)
class Table:
    """A table of numbers.

    Attributes:
        names: Names of the columns, with their units; empty without a header.
        numbers: (N, columns), NaN for what is no number.
        lines: Line of the file of each row, from 1, (N,).
        breaks: Texts between the rows, empty for blank lines, by the row, from 0, that follows.
    """

    names: tuple[str, ...]
    numbers: Array
    lines: npt.NDArray[np.int64]
    breaks: dict[int, str] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.numbers.shape[1])

    def call(self, index: int) -> str:
        """Name of a column in messages."""
        return f"column {self.names[index]!r}" if self.names else f"column {index + 1}"

    def texts(self, index: int) -> list[str]:
        """The entries of a column."""
        return [f"{value:g}" for value in self.numbers[:, index]]

    def kept(self, rows: npt.NDArray[np.bool_]) -> Self:
        """Some of the rows."""
        found = copy.copy(self)
        found.numbers, found.lines = self.numbers[rows], self.lines[rows]
        found.breaks = {int(rows[:row].sum()): text for row, text in self.breaks.items()}
        return found

    def check(
        self, columns: Sequence[int], problems: Problems, *, may_be_blank: int | None = None
    ) -> npt.NDArray[np.bool_]:
        """Which rows have numbers in some columns (one of which may be blank), (N,).

        Each other row becomes a problem.
        """
        whole = np.asarray(np.isfinite(self.numbers[:, list(columns)]).all(axis=1))
        for row in np.flatnonzero(~whole).tolist():
            what, column = self._problem(row, columns, may_be_blank)
            if what:
                problems.add(int(self.lines[row]), what, column)
            whole[row] = not what
        return whole

    def _problem(
        self, row: int, columns: Sequence[int], may_be_blank: int | None
    ) -> tuple[str, str]:
        """What is wrong with a row, and in which column; empty if nothing is."""
        missing = [i for i in columns if not np.isfinite(self.numbers[row, i])]
        wrong = [i for i in missing if i != may_be_blank]
        return ("the number is missing", self.call(wrong[0])) if wrong else ("", "")


class TextTable(Table):
    """A table in a text.

    Args:
        lines: Lines of the file.
        least: Smallest number of numbers in a row.
        expected: Expected contents, for the message.
        texts: Whether lines of text are allowed between header and rows, and between rows.
        is_header: Whether some names are those of a header. Without such a line, the header is the
            first line of text (with ``texts`` the last) that has as many entries as a row.

    Attributes:
        first_row: Line with the first row.
        counts: Line, from 1, that has the number of rows, as point clouds have it, or numbers the
            columns, as pandas does; ``None`` without one.

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
        self._text, self._dialect, self._has_texts = lines, dialect, texts
        found_rows = (k for k in data if not self._is_text(dialect.split(lines[k])))
        first, second = next(found_rows, None), next(found_rows, None)
        if first is None:
            raise InvalidInput("there is no row of numbers in it.")
        self.counts = None
        if second is not None and _counts(*(dialect.split(lines[k]) for k in (first, second))):
            self.counts, first = first + 1, second
        width = len(_stripped(dialect.split(lines[first])))
        at, names = -1, list[str]()
        for index in range(first - 1, -1, -1) if texts else range(first):
            if index + 1 == self.counts:
                continue
            comment = _is_comment(lines[index])
            text = _COMMENT.sub("", lines[index], count=1) if comment else lines[index]
            found = _stripped(dialect.names(text))
            fits = len(found) == width
            if found and (fits or not comment) and is_header(found):
                at, names = index, found
                break
            usable = fits and not comment and width >= least
            if at < 0 and usable and not is_unit_row(found, width):
                at, names = index, found
        between = [k for k in data if at < k < first]
        for index in between if names else ():
            units = _stripped(dialect.split(lines[index]))
            if is_unit_row(units, len(names)):
                units += [""] * (len(names) - len(units))
                names = [_with_unit(*pair) for pair in zip(names, units, strict=True)]
                between.remove(index)
                break
        self.first_row = lines[first]
        self._header = lines[at] if names else None
        title = " ".join(filter(None, dialect.split(lines[between[-1]]))) if between else ""
        begin = between[0] if between and not texts else first
        super().__init__(tuple(names), *self._rows(begin, len(names) or width, title))

    def _rows(
        self, first: int, width: int, title: str
    ) -> tuple[Array, npt.NDArray[np.int64], dict[int, str]]:
        """The numbers, lines and breaks from the line ``first`` on."""
        dialect, lines = self._dialect, self._text
        last = len(lines)
        while not lines[last - 1].strip():
            last -= 1
        if dialect.decimal == "." and len(dialect.delimiter) < 2:
            try:  # fast, if every line is a row of numbers
                plain = np.loadtxt(
                    lines[first:last], delimiter=dialect.delimiter or None, comments=None, ndmin=2
                )
            except ValueError:
                pass
            else:
                if plain.shape == (last - first, width):
                    return plain, np.arange(first + 1, last + 1), {0: title}
        pattern = [k for k, field in enumerate(dialect.split(self.first_row))
                   if dialect.number(field) is not None]  # fmt: skip
        rows, at, breaks = list[list[float]](), list[int](), {0: title}
        for index in range(first, last):
            if _is_comment(lines[index]):
                continue
            fields = dialect.split(lines[index])
            numbers = [dialect.number(field) for field in fields[:width]]
            if not any(fields):
                breaks.setdefault(len(rows), "")
            elif self._has_texts and self._separates(fields, numbers, width, pattern):
                again = lines[index] == self._header or (
                    len(fields) == width and is_unit_row(fields, width)
                )
                text = "" if again else " ".join(filter(None, fields))
                breaks[len(rows)] = text or breaks.get(len(rows), "")
            else:
                whole = len(fields) == width or len(_stripped(fields)) <= width <= len(fields)
                rows.append([np.nan if n is None or not whole else n for n in numbers]
                            + [np.nan] * (width - len(numbers)))  # fmt: skip
                at.append(index + 1)
        return np.array(rows).reshape(-1, width), np.array(at, dtype=np.int64), breaks

    def texts(self, index: int) -> list[str]:
        """The entries of a column; empty where a row is too short."""
        rows = (self._dialect.split(self._text[line - 1]) for line in self.lines.tolist())
        return [fields[index] if index < len(fields) else "" for fields in rows]

    def _separates(
        self,
        fields: Sequence[str],
        numbers: Sequence[float | None],
        width: int,
        pattern: Sequence[int],
    ) -> bool:
        """Whether a line among the rows is text, not a row; numbers are expected in ``pattern``."""
        if len(fields) == width:
            found = sum(numbers[i] is not None for i in pattern)
            # Words between blanks may be as many as there are columns: "Inner seam 2".
            if found and (self._dialect.delimiter or 2 * found >= len(pattern)):
                return False
        return self._is_text(fields)

    def _is_text(self, fields: Sequence[str]) -> bool:
        """Whether a line has no numbers.

        If texts are allowed, also a line that begins with a word and is not mostly numbers.
        """
        numbers = [self._dialect.number(field) is not None for field in fields if field]
        return not any(numbers) or (
            self._has_texts and not numbers[0] and 2 * sum(numbers) <= len(numbers)
        )

    def _problem(
        self, row: int, columns: Sequence[int], may_be_blank: int | None
    ) -> tuple[str, str]:
        dialect, width = self._dialect, self.width
        fields = dialect.split(self._text[int(self.lines[row]) - 1])
        count = len(_stripped(fields))
        if count > width:
            text = shortened(" | ".join(fields))
            return f"{count} columns, where {width} are expected; the row reads {text!r}", ""
        for index in columns:
            entry = fields[index] if index < len(fields) else ""
            value = dialect.number(entry)
            if not entry:
                if index == may_be_blank and len(fields) >= width:
                    continue
                short = f"; the row has {count} of {width} columns"
                what = f"the number is missing{short if count < width else ''}"
            elif value is None:
                other = replace(dialect, decimal="," if dialect.decimal == "." else ".")
                what = f"expected a number, got {shortened(entry)!r}"
                if other.number(entry) is not None:
                    what += (
                        f" with the decimal mark {other.decimal!r}; elsewhere it is "
                        f"{dialect.decimal!r}"
                    )
            elif not np.isfinite(value):
                what = f"expected a finite number, got {shortened(entry)!r}"
            else:
                continue
            return what, self.call(index)
        if len(fields) < width:
            what = f"missing; the row has {len(fields)} of {width} columns"
            return what, self.call(len(fields))
        return "", ""


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
