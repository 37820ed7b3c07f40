"""Toolpaths from tables: CSV and similar formats."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from qp_twist.files import (
    ANGLES,
    FEEDS,
    LENGTHS,
    LengthUnit,
    Problems,
    Table,
    columns_named,
    split_unit,
)
from qp_twist.paths.assumed_units import assumed_angle_unit, assumed_length_unit, named_length_unit
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import Row, RowsOfCurve, ToolpathFormat, toolpath_of
from qp_twist.paths.toolpath_columns import (
    ColumnChoice,
    ColumnRoles,
    column_roles,
    has_position,
    names_in,
    unit_of,
    usual,
)
from qp_twist.paths.toolpath_options import ReadingOptions

_LISTED = 12
"""Number of unused columns that are named; the others are counted."""


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows, or a new entry in the curve column begins another
    curve; the text is its name.

    Raises:
        InvalidInput: If the table is ambiguous, or rows are invalid; with line and column of each.
        UnclearColumns: If the columns have to be specified; with a suggestion if there is one.
    """
    choice = options.columns or ColumnChoice()
    chosen = [c for columns in vars(choice).values() if isinstance(columns, tuple) for c in columns]
    by_name = [c for c in (*chosen, choice.curve, choice.feed) if isinstance(c, str)]
    table = Table(
        lines,
        least=3,
        texts=True,
        expected="a toolpath needs x, y and z in every row",
        is_header=lambda names: (
            has_position(names)
            or (bool(by_name) and all(columns_named(names, name) for name in by_name))
        ),
    )
    of_file_name = [] if table.names else names_in(path.stem, table.width)
    table.names = table.names or tuple(of_file_name)
    where = column_roles(table, choice, options.orientation, options.feed_unit)
    notes, angle, feed = [*where.notes], 1.0, 1.0
    if of_file_name:
        named = ", ".join(of_file_name)
        notes.insert(0, f"no header: the columns are {named}, by the file's name; --columns.")
    unit, in_file = _length_unit(table, where, options, notes, named_length_unit(lines))
    call = ", ".join(table.call(i) for i in where.direction)
    if where.orientation in ("rpy", "rotation_vector"):
        stated = any(split_unit(table.names[i])[1] for i in where.direction if table.names)
        numbers = table.sample(sys.maxsize)[:, where.direction]
        own = options.angle_unit or (
            None if stated else assumed_angle_unit(numbers, where.angle_unit, unit)
        )
        angles, in_header = unit_of(table, "angle_unit", where.direction, own, ANGLES)
        angle = ANGLES[angles]
        if not in_header and options.angle_unit is None:
            called = ", ".join(table.call(i) for i in sorted(where.direction))
            word = "degrees" if angles == "deg" else "radians"
            notes.append(f"{called} are read in {word}, by their numbers; --angle-unit.")
    if where.feed is not None:
        feed = FEEDS[unit_of(table, "feed_unit", (where.feed,), options.feed_unit, FEEDS)[0]]
    problems = Problems()
    curves = [*_curves(table, where, (LENGTHS[unit], angle, feed), problems)]
    used = {*where.numbers, where.curve}
    unused = [table.call(i) for i in range(table.width) if i not in used]
    more = f" and {len(unused) - _LISTED} more" if len(unused) > _LISTED else ""
    passed_over = [f"not used: {', '.join(unused[:_LISTED])}{more}."] if unused else []
    if table.counts:
        passed_over.append(f"line {table.counts} counts the rows or the columns.")
    speeds = usual(table.names).get("feed", {}).get(0, [])
    if where.feed is None and speeds:
        passed_over.append(
            f"{' and '.join(table.call(i) for i in speeds)} may state feeds, but not in which unit;"
            ' write it into the header, e.g. "feed [mm/min]", or add feed_unit = "mm/min" to '
            "[path]."
        )
    return toolpath_of(
        path, where.orientation, curves, call, problems, assumptions=notes,
        passed_over=passed_over, unit=unit,
        unit_in_file=in_file,
    )  # fmt: skip


def _length_unit(
    table: Table, where: ColumnRoles, options: ReadingOptions, notes: list[str],
    named: tuple[LengthUnit, str] | None,
) -> tuple[LengthUnit, bool]:  # fmt: skip
    """The unit of the positions and whether the header states it; else the likely one, with a note.

    ``named`` is what other lines say, which counts where the header does not.

    Raises:
        InvalidInput: If it is not stated, and the numbers leave it open.
    """
    chosen, likely = options.length_unit, None
    stated = any(split_unit(table.names[i])[1] for i in where.position if table.names)
    if chosen is None and not stated:
        values = table.sample(sys.maxsize)[:, where.position]
        values = values[np.isfinite(values).all(axis=1)]
        likely = named or assumed_length_unit(values, where.length_unit)
    if likely is not None:
        other = "m" if likely[0] == "mm" else "mm"
        answer = options.answer("length_unit", other)
        notes.append(f"read as {likely[0]}: {likely[1]}; {answer} reads it so.")
        chosen = likely[0]
    return unit_of(table, "length_unit", where.position, chosen, LENGTHS)


CSV = ToolpathFormat(lambda suffix, lines: True, _read, {})
"""Tables."""


def _curves(
    table: Table, where: ColumnRoles, units: tuple[float, float, float], problems: Problems
) -> Iterator[RowsOfCurve]:
    """The rows of each curve, in units of length, angle and feed; invalid entries are problems."""
    rows: list[Row] = []
    name, label = table.title, None
    of_length, of_angle, of_feed = units
    blank = () if where.feed is None else (where.feed,)
    last = math.nan
    for line, fields, numbers in table.rows(where.numbers, problems, may_be_blank=blank):
        entry = None if numbers is None or where.curve is None else fields[where.curve]
        if rows and (numbers is None or (label is not None and entry != label)):
            yield RowsOfCurve(rows, [], [])
            rows, name = [], ""
        if numbers is None:
            name = " ".join(filter(None, fields)) or name
            continue
        label, name = entry, name if entry is None else entry
        # A blank leaves the feed as it was: RoboDK writes it where it changes.
        last = math.nan if where.feed is None else numbers[-1] if fields[where.feed] else last
        feed = of_feed * last
        # No motion leads to the first point of a curve; tables often have 0 there.
        if feed <= 0.0 and rows and where.feed is not None:
            what = f"expected a feed above 0, got {numbers[-1]:g}"
            problems.add(line, what, table.call(where.feed))
        position = tuple(of_length * v for v in numbers[:3])
        direction = tuple(of_angle * v for v in numbers[3 : 3 + len(where.direction)])
        rows.append(Row(position, direction, line, feed, name=name))
    if rows:
        yield RowsOfCurve(rows, [], [])
