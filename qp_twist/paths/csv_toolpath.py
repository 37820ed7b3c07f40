"""Toolpaths from tables: CSV and similar formats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from qp_twist.files import (
    ANGLES,
    FEEDS,
    LENGTHS,
    Problems,
    Table,
    columns_named,
    split_unit,
)
from qp_twist.paths.suggested_columns import suggested
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import (
    Row,
    RowsOfCurve,
    ToolpathFormat,
    toolpath_of,
)
from qp_twist.paths.toolpath_columns import (
    LOOKED_AT,
    ColumnChoice,
    ColumnRoles,
    UnclearColumns,
    column_roles,
    has_position,
    unit_of,
    usual,
)
from qp_twist.paths.toolpath_options import ReadingOptions


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows, or a new entry in the curve column begins another
    curve; the text is its name.

    Raises:
        InvalidInput: If the table is ambiguous, or rows are invalid; with line and column of each.
        UnclearColumns: If the columns have to be specified; with a suggestion if there is one.
    """
    choice = options.columns or ColumnChoice()
    chosen = [c if isinstance(c, tuple) else (c,) for c in vars(choice).values()]
    by_name = [column for columns in chosen for column in columns if isinstance(column, str)]
    table = Table(
        lines,
        least=3,
        texts=True,
        expected="a toolpath needs x, y and z in every row",
        is_header=lambda names: (
            has_position(names)
            or bool(by_name and all(columns_named(names, name) for name in by_name))
        ),
    )
    try:
        where = column_roles(table, choice, options.orientation, options.feed_unit)
    except UnclearColumns as error:
        if error.suggestion is not None or has_position(table.names):
            raise
        raise UnclearColumns(error.message, suggested(table.sample(LOOKED_AT))) from None
    unit, in_file = unit_of(table, "length_unit", where.position, options.length_unit, LENGTHS)
    call = ", ".join(table.call(i) for i in where.direction)
    notes = [where.note] if where.note else []
    angle, feed = 1.0, 1.0
    if where.orientation in ("rpy", "rotation_vector"):
        names = [table.names[i] for i in where.direction if table.names]
        by_numbers = None if any(split_unit(name)[1] for name in names) else where.angle_unit
        own = options.angle_unit or by_numbers
        stated, in_header = unit_of(table, "angle_unit", where.direction, own, ANGLES)
        angle = ANGLES[stated]
        if not in_header and options.angle_unit is None:
            called = ", ".join(table.call(i) for i in sorted(where.direction))
            word = "degrees" if stated == "deg" else "radians"
            notes.append(f"{called} are read in {word}, by their numbers.")
    if where.feed is not None:
        feed = FEEDS[unit_of(table, "feed_unit", (where.feed,), options.feed_unit, FEEDS)[0]]
    problems = Problems()
    curves = _curves(table, where, (LENGTHS[unit], angle, feed), problems)
    used = {*where.numbers, where.curve}
    unused = [table.call(i) for i in range(table.width) if i not in used]
    notes += [f"not used: {', '.join(unused)}."] if unused else []
    speeds = usual(table.names).get("feed", {}).get(0, [])
    if where.feed is None and speeds:
        notes.append(
            f"{' and '.join(table.call(i) for i in speeds)} may state feeds, but not in which unit;"
            ' write it into the header, e.g. "feed [mm/min]", or add feed_unit = "mm/min" to '
            "[path]."
        )
    return toolpath_of(
        path, where.orientation, curves, call, notes, problems, unit=unit, unit_in_file=in_file
    )


CSV = ToolpathFormat(lambda suffix, lines: True, _read, {})
"""Tables."""


def _curves(
    table: Table, where: ColumnRoles, units: tuple[float, float, float], problems: Problems
) -> list[RowsOfCurve]:
    """The rows of all curves, in units of length, angle and feed; invalid entries are problems."""
    curves: list[list[Row]] = [[]]
    name, label = table.title, None
    of_length, of_angle, of_feed = units
    for line, fields, numbers in table.rows(where.numbers, problems):
        entry = None if numbers is None or where.curve is None else fields[where.curve]
        if numbers is None or (label is not None and entry != label):
            if curves[-1]:
                curves.append([])
                name = ""
            if numbers is None:
                name = " ".join(filter(None, fields)) or name
                continue
        label, name = entry, name if entry is None else entry
        feed = math.nan
        if where.feed is not None:
            # No motion leads to the first point of a curve; tables often have 0 there.
            if numbers[-1] <= 0.0 and curves[-1]:
                what = f"expected a feed above 0, got {numbers[-1]:g}"
                problems.add(line, what, table.call(where.feed))
            feed = of_feed * numbers[-1]
        direction = numbers[3 : 3 + len(where.direction)]
        curves[-1].append(
            Row(
                tuple(of_length * v for v in numbers[:3]),
                tuple(of_angle * v for v in direction),
                line,
                feed,
                name=name,
            )
        )
    return [RowsOfCurve(rows, [], []) for rows in curves if rows]
