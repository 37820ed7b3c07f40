"""Toolpaths from tables: CSV and its relatives."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from qp_twist.errors import InvalidInput
from qp_twist.toolpath.assemble import Rows, assembled
from qp_twist.toolpath.columns import (
    ANGLES,
    LENGTHS,
    AngleUnit,
    ColumnChoice,
    Header,
    Layout,
    LengthUnit,
    Orientation,
    has_position,
    is_unit_row,
    layout,
)
from qp_twist.toolpath.dialect import Dialect, detected
from qp_twist.toolpath.toolpath import Toolpath

_COMMENT = re.compile(r"\s*(?:#|//|%)")
_SPREADSHEET_ERROR = re.compile(r"\s*\"?#(?:N/?A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")


def read_csv(
    path: Path,
    lines: Sequence[str],
    *,
    choice: ColumnChoice,
    orientation: Orientation | None,
    length_unit: LengthUnit | None,
    angle_unit: AngleUnit | None,
) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows and a new entry in the curve's column begin another
    curve; the text names it.

    Raises:
        InvalidInput: If the table is not clear, or a row is broken; with line and column.
    """
    dialect = detected(path.name, (line for line in lines if not _is_comment(line)))
    table = _Table.of(path.name, lines, dialect, choice)
    header = table.header
    where = layout(header, choice, orientation)
    scale = header.unit("length_unit", where.position, length_unit, LENGTHS)
    angle = 1.0
    if where.orientation == "rpy":
        angle = header.unit("angle_unit", where.direction, angle_unit, ANGLES)
    curves = _curves(path.name, lines, table, where)
    for rows in curves:
        rows.positions = [tuple(scale * v for v in p) for p in rows.positions]
        if angle != 1.0:
            rows.directions = [tuple(angle * v for v in d) for d in rows.directions]
    used = {*where.numbers, *(() if where.curve is None else (where.curve,))}
    unused = [header.call(i) for i in range(header.width) if i not in used]
    notes = [f"not used: {', '.join(unused)}."] if unused else []
    call = ", ".join(header.call(i) for i in where.direction)
    return assembled(path, where.orientation, curves, call, notes)


def _is_comment(line: str) -> bool:
    return bool(_COMMENT.match(line)) and not _SPREADSHEET_ERROR.match(line)


@dataclass(frozen=True)
class _Table:
    """What is known of a table before its rows are read.

    Attributes:
        dialect: How its lines are split.
        header: Names and number of its columns.
        header_line: Index of the line with the names; −1 if there is none.
        first: Index of the first row.
        title: Text before the first row that names the first curve.
    """

    dialect: Dialect
    header: Header
    header_line: int
    first: int
    title: str

    @classmethod
    def of(cls, file: str, lines: Sequence[str], dialect: Dialect, choice: ColumnChoice) -> _Table:
        """Look for the first row, and above it for the names of the columns."""
        above: list[int] = []
        first = len(lines)
        for index, line in enumerate(lines):
            if not line.strip():
                continue
            if not _is_comment(line) and not _is_text(dialect, dialect.split(line)):
                first = index
                break
            above.append(index)
        if first == len(lines):
            raise InvalidInput(f"{file}: there is no row of numbers in it.")
        fields = _stripped(dialect.split(lines[first]))
        by_name = [
            column
            for columns in vars(choice).values()
            for column in (columns if isinstance(columns, tuple) else (columns,))
            if isinstance(column, str)
        ]
        at, names = _names(file, dialect, lines, above, len(fields), by_name)
        titles = [i for i in above if i > at and not _is_comment(lines[i])]
        for index in titles if names else ():
            units = _stripped(dialect.split(lines[index]))
            if is_unit_row(units, len(names)):
                names = [
                    f"{name} [{unit.strip('[](){} ')}]" if unit else name
                    for name, unit in itertools.zip_longest(names, units, fillvalue="")
                ]
                titles.remove(index)
                break
        return cls(
            dialect,
            Header(file, tuple(names), len(names) or len(fields)),
            at,
            first,
            _title(dialect, lines[titles[-1]]) if titles else "",
        )


def _names(
    file: str,
    dialect: Dialect,
    lines: Sequence[str],
    above: Sequence[int],
    width: int,
    wanted: Sequence[str],
) -> tuple[int, list[str]]:
    """The header among the lines above the first row, and its index; −1 if there is none.

    A line of usual names, or of those that are ``wanted``; a comment can be one if it has as many
    entries as the rows. Otherwise the last line of text that has.
    """
    last = (-1, list[str]())
    for index in reversed(above):
        comment = _is_comment(lines[index])
        text = _COMMENT.sub("", lines[index], count=1) if comment else lines[index]
        found = _stripped(dialect.names(text))
        named = has_position(found) or (
            bool(wanted) and all(Header(file, tuple(found), 0).named(name) for name in wanted)
        )
        fits = len(found) == width
        if named and (fits or not comment):
            return index, found
        if last[0] < 0 and fits and not comment and width >= 3 and not is_unit_row(found, width):
            last = (index, found)
    return last


def _stripped(fields: list[str]) -> list[str]:
    """Fields without empty ones at the end, which some programs write."""
    while fields and not fields[-1]:
        fields = fields[:-1]
    return fields


def _is_text(dialect: Dialect, fields: Sequence[str]) -> bool:
    """Whether a line is for people: it begins with a word and numbers are not its larger part."""
    filled = [field for field in fields if field]
    numbers = [dialect.number(field) is not None for field in filled]
    return not any(numbers) or (not numbers[0] and 2 * sum(numbers) <= len(numbers))


def _title(dialect: Dialect, line: str) -> str:
    return " ".join(field for field in dialect.split(line) if field)


def _curves(file: str, lines: Sequence[str], table: _Table, where: Layout) -> list[Rows]:
    """The rows of all curves, checked one by one."""
    dialect, header = table.dialect, table.header
    curves = [Rows(table.title)]
    label: str | None = None
    for index in range(table.first, len(lines)):
        line = lines[index]
        if _is_comment(line):
            continue
        fields = dialect.split(line)
        if not any(fields):
            if curves[-1].positions:
                curves.append(Rows())
            continue
        values = _numbers(dialect, fields, where, header.width)
        if values is None:
            if _separates(dialect, fields, where, header):
                # The header once more, or the units below it, is no name.
                again = table.header_line >= 0 and line == lines[table.header_line]
                again |= len(fields) == header.width and is_unit_row(fields, header.width)
                title = "" if again else _title(dialect, line)
                if curves[-1].positions:
                    curves.append(Rows())
                curves[-1].name = title or curves[-1].name
                continue
            _refuse(file, index + 1, dialect, fields, where, header)
        if where.curve is not None:
            name = fields[where.curve]
            if label is not None and name != label and curves[-1].positions:
                curves.append(Rows())
            label = name
            curves[-1].name = name
        curves[-1].positions.append(values[:3])
        curves[-1].directions.append(values[3:])
        curves[-1].lines.append(index + 1)
    return curves


def _numbers(
    dialect: Dialect, fields: list[str], where: Layout, width: int
) -> tuple[float, ...] | None:
    """The numbers of a row, or ``None`` if something is wrong with it."""
    if len(fields) < width or (len(fields) > width and len(_stripped(fields)) > width):
        return None
    found = []
    for index in where.numbers:
        value = dialect.number(fields[index])
        if value is None or not math.isfinite(value):
            return None
        found.append(value)
    return tuple(found)


def _separates(dialect: Dialect, fields: Sequence[str], where: Layout, header: Header) -> bool:
    """Whether a line among the rows is text that begins another curve."""
    if len(fields) == header.width:
        numbers = sum(dialect.number(fields[i]) is not None for i in where.numbers)
        # Words between blanks may be as many as there are columns: "Inner seam 2".
        if numbers and (dialect.delimiter or 2 * numbers >= len(where.numbers)):
            return False
    return _is_text(dialect, fields)


def _refuse(
    file: str, line: int, dialect: Dialect, fields: list[str], where: Layout, header: Header
) -> NoReturn:
    """Say what is wrong with a row."""
    place = f"{file}, line {line}"
    count = len(_stripped(fields))
    if count > header.width:
        raise InvalidInput(
            f"{place}: {count} columns, where {header.width} are expected; the row reads "
            f"{' | '.join(fields)[:80]!r}."
        )
    for index in where.numbers:
        column = header.call(index)
        field = fields[index] if index < len(fields) else ""
        value = dialect.number(field)
        if not field:
            raise InvalidInput(
                f"{place}, {column}: the number is missing; the row has {count} of "
                f"{header.width} columns."
                if count < header.width
                else f"{place}, {column}: the number is missing."
            )
        if value is None:
            other = replace(dialect, decimal="," if dialect.decimal == "." else ".")
            mark = "" if other.number(field) is None else f"; elsewhere it is {dialect.decimal!r}"
            hint = mark and f" with the decimal mark {other.decimal!r}{mark}"
            raise InvalidInput(f"{place}, {column}: expected a number, got {field[:40]!r}{hint}.")
        if not math.isfinite(value):
            raise InvalidInput(f"{place}, {column}: expected a finite number, got {field[:40]!r}.")
    raise InvalidInput(
        f"{place}, {header.call(len(fields))}: missing; the row has {len(fields)} of "
        f"{header.width} columns."
    )
