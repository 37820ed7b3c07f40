"""Toolpaths from tables: CSV and its relatives."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.toolpath.assemble import Rows, assembled
from qp_twist.toolpath.columns import (
    ANGLES,
    FEEDS,
    LENGTHS,
    AngleUnit,
    ColumnChoice,
    FeedUnit,
    Header,
    Layout,
    LengthUnit,
    Orientation,
    UnclearColumns,
    has_position,
    is_unit_row,
    layout,
    split_unit,
    usual,
)
from qp_twist.toolpath.dialect import Dialect, detected
from qp_twist.toolpath.problems import Problems
from qp_twist.toolpath.suggest import suggested
from qp_twist.toolpath.toolpath import Toolpath

_LOOKED_AT = 500
"""Rows by whose numbers columns are suggested."""
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
    feed_unit: FeedUnit | None,
) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows and a new entry in the curve's column begin another
    curve; the text names it.

    Raises:
        InvalidInput: If the table is not clear, or rows are broken; with line and column of each.
        UnclearColumns: If the columns have to be stated; with a suggestion where there is one.
    """
    dialect = detected(path.name, (line for line in lines if not _is_comment(line)))
    table = _Table.of(path.name, lines, dialect, choice)
    header = table.header
    try:
        where = layout(header, choice, orientation, feed_unit)
    except UnclearColumns as error:
        raise UnclearColumns(error.message, suggested(_some_rows(lines, table))) from None
    scale = header.unit("length_unit", where.position, length_unit, LENGTHS)
    angle, feed = 1.0, 1.0
    if where.orientation == "rpy":
        angle = header.unit("angle_unit", where.direction, angle_unit, ANGLES)
    if where.feed is not None:
        feed = header.unit("feed_unit", (where.feed,), feed_unit, FEEDS)
    problems = Problems(path.name)
    curves = _curves(lines, table, where, problems)
    for rows in curves:
        rows.positions = [tuple(scale * v for v in p) for p in rows.positions]
        rows.feeds = [feed * v for v in rows.feeds]
        if angle != 1.0:
            rows.directions = [tuple(angle * v for v in d) for d in rows.directions]
    used = {*where.numbers, *(() if where.curve is None else (where.curve,))}
    unused = [header.call(i) for i in range(header.width) if i not in used]
    notes = [f"not used: {', '.join(unused)}."] if unused else []
    notes += _of_feeds(header, where)
    call = ", ".join(header.call(i) for i in where.direction)
    [unit] = [name for name, metres in LENGTHS.items() if metres == scale]
    stated = bool(header.names) and split_unit(header.names[where.position[0]])[1] is not None
    return assembled(
        path, where.orientation, curves, call, notes, problems, unit=unit, unit_in_file=stated
    )


def _of_feeds(header: Header, where: Layout) -> list[str]:
    """What is not used although it is called like a feed."""
    if where.feed is not None:
        return []
    named = usual(header.names).get("feed", {}).get(0, [])
    if not named:
        return []
    return [
        f"{' and '.join(header.call(i) for i in named)} may state feeds, but not in which unit; "
        'write it into the header, e.g. "feed [mm/min]", or add feed_unit = "mm/min" to [path].'
    ]


def _some_rows(lines: Sequence[str], table: _Table) -> Array:
    """The numbers of the first rows, (N, columns), NaN where there is none."""
    found = []
    for line in itertools.islice(lines, table.first, table.first + 2 * _LOOKED_AT):
        fields = table.dialect.split(line)
        if not _is_comment(line) and len(fields) >= table.header.width and any(fields):
            numbers = [table.dialect.number(f) for f in fields[: table.header.width]]
            if sum(value is not None for value in numbers) >= 3:
                found.append([np.nan if value is None else value for value in numbers])
        if len(found) == _LOOKED_AT:
            break
    return np.array(found, dtype=np.float64).reshape(len(found), table.header.width)


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


def _curves(lines: Sequence[str], table: _Table, where: Layout, problems: Problems) -> list[Rows]:
    """The rows of all curves, checked one by one; what is wrong with a row is a problem."""
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
            _explain(problems, index + 1, dialect, fields, where, header)
            continue
        if where.curve is not None:
            name = fields[where.curve]
            if label is not None and name != label and curves[-1].positions:
                curves.append(Rows())
            label = name
            curves[-1].name = name
        rows = curves[-1]
        rows.positions.append(values[:3])
        rows.directions.append(values[3 : 3 + len(where.direction)])
        rows.lines.append(index + 1)
        if where.feed is not None:
            rows.feeds.append(values[-1])
            # No motion leads to the first point of a curve; tables often have 0 there.
            if values[-1] <= 0.0 and len(rows.positions) > 1:
                what = f"expected a feed above 0, got {values[-1]:g}"
                problems.add(index + 1, what, header.call(where.feed))
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


def _explain(
    problems: Problems,
    line: int,
    dialect: Dialect,
    fields: list[str],
    where: Layout,
    header: Header,
) -> None:
    """Say what is wrong with a row."""
    count = len(_stripped(fields))
    if count > header.width:
        problems.add(
            line,
            f"{count} columns, where {header.width} are expected; the row reads "
            f"{' | '.join(fields)[:80]!r}",
        )
        return
    for index in where.numbers:
        column = header.call(index)
        field = fields[index] if index < len(fields) else ""
        value = dialect.number(field)
        if not field:
            short = f"; the row has {count} of {header.width} columns"
            what = f"the number is missing{short if count < header.width else ''}"
        elif value is None:
            other = replace(dialect, decimal="," if dialect.decimal == "." else ".")
            mark = "" if other.number(field) is None else f"; elsewhere it is {dialect.decimal!r}"
            hint = mark and f" with the decimal mark {other.decimal!r}{mark}"
            what = f"expected a number, got {field[:40]!r}{hint}"
        elif not math.isfinite(value):
            what = f"expected a finite number, got {field[:40]!r}"
        else:
            continue
        problems.add(line, what, column)
        return
    problems.add(
        line,
        f"missing; the row has {len(fields)} of {header.width} columns",
        header.call(len(fields)),
    )
