"""Toolpaths from tables: CSV and similar formats."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from qp_twist.files import ANGLES, FEEDS, LENGTHS, Problems, Table, columns_named, split_unit
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import Row, RowsOfCurve, ToolpathFormat, toolpath_of
from qp_twist.paths.toolpath_columns import (
    ColumnChoice,
    ColumnRoles,
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
    where = column_roles(table, choice, options.orientation, options.feed_unit)
    unit, in_file = unit_of(table, "length_unit", where.position, options.length_unit, LENGTHS)
    call = ", ".join(table.call(i) for i in where.direction)
    notes, angle, feed = [*where.notes], 1.0, 1.0
    if where.orientation in ("rpy", "rotation_vector"):
        stated = any(split_unit(table.names[i])[1] for i in where.direction if table.names)
        own = options.angle_unit or (None if stated else where.angle_unit)
        angles, in_header = unit_of(table, "angle_unit", where.direction, own, ANGLES)
        angle = ANGLES[angles]
        if not in_header and options.angle_unit is None:
            called = ", ".join(table.call(i) for i in sorted(where.direction))
            word = "degrees" if angles == "deg" else "radians"
            notes.append(f"{called} are read in {word}, by their numbers.")
    if where.feed is not None:
        feed = FEEDS[unit_of(table, "feed_unit", (where.feed,), options.feed_unit, FEEDS)[0]]
    problems = Problems()
    curves = [*_curves(table, where, (LENGTHS[unit], angle, feed), problems)]
    used = {*where.numbers, where.curve}
    unused = [table.call(i) for i in range(table.width) if i not in used]
    passed_over = [f"not used: {', '.join(unused)}."] if unused else []
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


CSV = ToolpathFormat(lambda suffix, lines: True, _read, {})
"""Tables."""


def _curves(
    table: Table, where: ColumnRoles, units: tuple[float, float, float], problems: Problems
) -> Iterator[RowsOfCurve]:
    """The rows of each curve, in units of length, angle and feed; invalid entries are problems."""
    rows: list[Row] = []
    name, label = table.title, None
    of_length, of_angle, of_feed = units
    for line, fields, numbers in table.rows(where.numbers, problems):
        entry = None if numbers is None or where.curve is None else fields[where.curve]
        if rows and (numbers is None or (label is not None and entry != label)):
            yield RowsOfCurve(rows, [], [])
            rows, name = [], ""
        if numbers is None:
            name = " ".join(filter(None, fields)) or name
            continue
        label, name = entry, name if entry is None else entry
        feed = math.nan if where.feed is None else of_feed * numbers[-1]
        # No motion leads to the first point of a curve; tables often have 0 there.
        if feed <= 0.0 and rows and where.feed is not None:
            what = f"expected a feed above 0, got {numbers[-1]:g}"
            problems.add(line, what, table.call(where.feed))
        position = tuple(of_length * v for v in numbers[:3])
        direction = tuple(of_angle * v for v in numbers[3 : 3 + len(where.direction)])
        rows.append(Row(position, direction, line, feed, name=name))
    if rows:
        yield RowsOfCurve(rows, [], [])
