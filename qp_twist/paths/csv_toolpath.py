"""Toolpaths from tables: CSV and similar formats."""

from __future__ import annotations

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
from qp_twist.paths.assemble import RawCurve, assembled
from qp_twist.paths.suggested_columns import suggested
from qp_twist.paths.toolpath import Toolpath
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


def read_csv(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows, or a new entry in the curve column begins another
    curve; the text is its name.

    Raises:
        InvalidInput: If the table is ambiguous, or rows are invalid; with line and column of each.
        UnclearColumns: If the columns have to be specified; with a suggestion if there is one.
    """
    choice = options.columns or ColumnChoice()
    by_name = [
        column
        for columns in vars(choice).values()
        for column in (columns if isinstance(columns, tuple) else (columns,))
        if isinstance(column, str)
    ]
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
    scale, angle, feed = LENGTHS[unit], 1.0, 1.0
    notes = [where.note] if where.note else []
    if where.orientation in ("rpy", "rotation_vector"):
        own = options.angle_unit or (
            None if _states_unit(table, where.direction) else where.angle_unit
        )
        stated, in_header = unit_of(table, "angle_unit", where.direction, own, ANGLES)
        angle = ANGLES[stated]
        if not in_header and options.angle_unit is None:
            called = ", ".join(table.call(i) for i in sorted(where.direction))
            word = "degrees" if stated == "deg" else "radians"
            notes.append(f"{called} are read in {word}, by their numbers.")
    if where.feed is not None:
        feed = FEEDS[unit_of(table, "feed_unit", (where.feed,), options.feed_unit, FEEDS)[0]]
    problems = Problems()
    curves = _curves(table, where, problems)
    for rows in curves:
        rows.positions = [tuple(scale * v for v in p) for p in rows.positions]
        rows.feeds = [feed * v for v in rows.feeds]
        if angle != 1.0:
            rows.directions = [tuple(angle * v for v in d) for d in rows.directions]
    used = {*where.numbers, *(() if where.curve is None else (where.curve,))}
    unused = [table.call(i) for i in range(table.width) if i not in used]
    notes += [f"not used: {', '.join(unused)}."] if unused else []
    notes += _of_feeds(table, where)
    call = ", ".join(table.call(i) for i in where.direction)
    return assembled(
        path, where.orientation, curves, call, notes, problems, unit=unit, unit_in_file=in_file
    )


def _states_unit(table: Table, columns: Sequence[int]) -> bool:
    """Whether the header has the unit of one of some columns."""
    return bool(table.names) and any(split_unit(table.names[i])[1] for i in columns)


def _of_feeds(table: Table, where: ColumnRoles) -> list[str]:
    """Columns that are named like a feed but not used."""
    if where.feed is not None:
        return []
    named = usual(table.names).get("feed", {}).get(0, [])
    if not named:
        return []
    return [
        f"{' and '.join(table.call(i) for i in named)} may state feeds, but not in which unit; "
        'write it into the header, e.g. "feed [mm/min]", or add feed_unit = "mm/min" to [path].'
    ]


def _curves(table: Table, where: ColumnRoles, problems: Problems) -> list[RawCurve]:
    """The rows of all curves, checked one by one; invalid entries are problems."""
    curves = [RawCurve(table.title)]
    label: str | None = None
    for row in table.rows(where.numbers, problems):
        if row.numbers is None:
            if curves[-1].positions:
                curves.append(RawCurve())
            curves[-1].name = " ".join(filter(None, row.fields)) or curves[-1].name
            continue
        if where.curve is not None:
            name = row.fields[where.curve]
            if label is not None and name != label and curves[-1].positions:
                curves.append(RawCurve())
            label = name
            curves[-1].name = name
        rows = curves[-1]
        rows.positions.append(row.numbers[:3])
        rows.directions.append(row.numbers[3 : 3 + len(where.direction)])
        rows.lines.append(row.line)
        if where.feed is not None:
            value = row.numbers[-1]
            rows.feeds.append(value)
            # No motion leads to the first point of a curve; tables often have 0 there.
            if value <= 0.0 and len(rows.positions) > 1:
                what = f"expected a feed above 0, got {value:g}"
                problems.add(row.line, what, table.call(where.feed))
    return curves
