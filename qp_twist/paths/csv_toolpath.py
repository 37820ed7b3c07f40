"""Toolpaths from tables: CSV and similar texts, and what other readers make a table of."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.files import (
    ANGLES,
    FEEDS,
    LENGTHS,
    LengthUnit,
    Problems,
    Table,
    TextTable,
    columns_named,
    split_unit,
)
from qp_twist.paths.assumed_units import assumed_angle_unit, assumed_length_unit, named_length_unit
from qp_twist.paths.column_names import has_position, names_in, usual
from qp_twist.paths.orientation import tangents
from qp_twist.paths.toolpath import Toolpath
from qp_twist.paths.toolpath_builder import ToolpathFormat
from qp_twist.paths.toolpath_columns import (
    ColumnChoice,
    ColumnRoles,
    called,
    column_roles,
    unit_of,
)
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.toolpath_points import (
    Points,
    PointsOfCurve,
    curves_between_rapids,
    toolpath_of,
)

_LISTED = 12
"""Number of unused columns that are named; the others are counted."""
_RAPID = re.compile(r"g?0+|rapid|travel|movej|ptp", re.IGNORECASE)
_CUT = re.compile(r"g?0*1|cut|cutting|feed|linear|work|contact|process|movel|lin", re.IGNORECASE)
_ARC = re.compile(r"g?0*[23]|arc|circ|circular|movec", re.IGNORECASE)
"""Entries of a column of motions."""


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a table in a text."""
    stated = (options.columns or ColumnChoice()).stated
    by_name = [c for columns in stated.values() for c in columns if isinstance(c, str)]
    table = TextTable(
        lines,
        least=3,
        texts=True,
        expected="a toolpath needs x, y and z in every row",
        is_header=lambda names: (
            has_position(names)
            or (bool(by_name) and all(columns_named(names, name) for name in by_name))
        ),
    )
    notes, passed_over = list[str](), list[str]()
    if not table.names and (of_file_name := names_in(path.stem, table.width)):
        table.names = of_file_name
        named = ", ".join(of_file_name)
        notes = [f"no header: the columns are {named}, by the file's name; --columns."]
    if table.counts:
        passed_over = [f"line {table.counts} counts the rows or the columns."]
    return table_toolpath(path, table, options, lines, notes, passed_over)


CSV = ToolpathFormat(lambda suffix, lines: True, _read, {})
"""Tables."""


def table_toolpath(
    path: Path,
    table: Table,
    options: ReadingOptions,
    lines: Sequence[str] = (),
    notes: Sequence[str] = (),
    passed_over: Sequence[str] = (),
) -> Toolpath:
    """The toolpath of a table.

    A blank line, a line of text between rows, or a new entry in the curve column begins another
    curve; the text is its name. The lines of the file may name the unit of length; ``notes`` and
    ``passed_over`` are those of its reader.

    Raises:
        InvalidInput: If the table is ambiguous, or rows are invalid; with line and column of each.
        UnclearColumns: If the columns have to be specified; with a suggestion if there is one.
    """
    choice = options.columns or ColumnChoice()
    where = column_roles(table, choice, options.orientation, options.feed_unit)
    rapid, notes = _rapid(table, where), [*notes, *where.notes]
    unit, in_file = _length_unit(table, where, options, notes, lines)
    angle, problems = _angle_scale(table, where, options, notes, unit), Problems()
    feed_column = where.single.get("feed")
    whole = table.check(where.numbers, problems, may_be_blank=feed_column)
    if not whole.all():
        table, rapid = table.kept(whole), None if rapid is None else rapid[whole]
    begins, names = _curves(table, where)
    ends = [*np.flatnonzero(begins).tolist(), len(begins)]
    positions = LENGTHS[unit] * table.numbers[:, where.position]
    orientation, directions = where.orientation, angle * table.numbers[:, where.direction]
    if where.second:
        second = table.numbers[:, where.second]
        second = second if where.second_axis == "x" else np.cross(second, directions)
        directions = np.hstack([directions, second])
    if where.orientation == "normal" and {"lead", "tilt"} & where.single.keys():
        orientation, outward = "axis", -1.0 if options.axes_point == "into" else 1.0
        lean = _lean(table, where, notes)
        directions[:, :3] = outward * _leaned(positions, outward * directions[:, :3], lean, ends)
    feeds = np.full(len(begins), np.nan)
    if feed_column is not None:
        feeds = _feeds(table, feed_column, options, begins, problems)
    points = Points(positions, directions, table.lines, feeds)
    if rapid is None:
        curves = [PointsOfCurve(points.part(slice(a, b), names[a])) for a, b in pairwise(ends)]
    else:
        curves = curves_between_rapids(points, names, rapid, begins)
    return toolpath_of(
        path,
        orientation,
        curves,
        called(table, where.direction),
        problems,
        assumptions=notes,
        passed_over=[*passed_over, *_unused(table, where, rapid=rapid is not None)],
        unit=unit,
        unit_in_file=in_file,
    )


def _feeds(
    table: Table, column: int, options: ReadingOptions, begins: Mask, problems: Problems
) -> Array:
    """Feeds, m/s, (N,); a blank leaves the feed as it was: RoboDK writes it where it changes."""
    scale = FEEDS[unit_of(table, "feed_unit", (column,), options.feed_unit, FEEDS)[0]]
    stated = table.numbers[:, column]
    last = np.maximum.accumulate(np.where(np.isfinite(stated), np.arange(len(stated)), -1))
    feeds: Array = np.where(last < 0, np.nan, scale * stated[last])
    # No motion leads to the first point of a curve; tables often have 0 there.
    for row in np.flatnonzero((feeds <= 0.0) & ~begins).tolist():
        what = f"expected a feed above 0, got {stated[last[row]]:g}"
        problems.add(int(table.lines[row]), what, table.call(column))
    return feeds


def _length_unit(
    table: Table,
    where: ColumnRoles,
    options: ReadingOptions,
    notes: list[str],
    lines: Sequence[str],
) -> tuple[LengthUnit, bool]:
    """The unit of the positions and whether the header states it; a likely one with a note."""
    chosen = options.length_unit
    stated = any(split_unit(table.names[i])[1] for i in where.position if table.names)
    if chosen is None and not stated:
        values = table.numbers[:, where.position]
        values = values[np.isfinite(values).all(axis=1)]
        likely = named_length_unit(lines) or assumed_length_unit(values, where.length_unit)
        if likely is not None:
            chosen, why = likely
            answer = options.answer("length_unit", "m" if chosen == "mm" else "mm")
            notes.append(f"read as {chosen}: {why}; {answer} reads it so.")
    return unit_of(table, "length_unit", where.position, chosen, LENGTHS)


def _angle_scale(
    table: Table, where: ColumnRoles, options: ReadingOptions, notes: list[str], length: LengthUnit
) -> float:
    """Radians in the unit of the angles, with a note if it is assumed; 1 for other directions."""
    if where.orientation not in ("rpy", "rotation_vector"):
        return 1.0
    chosen, columns = options.angle_unit, where.direction
    if chosen is None and not any(split_unit(table.names[i])[1] for i in columns if table.names):
        chosen = assumed_angle_unit(table.numbers[:, columns], where.angle_unit, length)
    unit, in_header = unit_of(table, "angle_unit", columns, chosen, ANGLES)
    if not in_header and options.angle_unit is None:
        word = "degrees" if unit == "deg" else "radians"
        notes.append(
            f"{called(table, sorted(columns))} are read in {word}, by their numbers; --angle-unit."
        )
    return ANGLES[unit]


def _lean(table: Table, where: ColumnRoles, notes: list[str]) -> Array:
    """Lead and tilt at each point, rad, (N, 2)."""
    lean, units = np.zeros((len(table.lines), 2)), set()
    for place, key in enumerate(("lead", "tilt")):
        if key in where.single:
            column = where.single[key]
            unit, _ = unit_of(table, key, (column,), "deg", ANGLES)
            lean[:, place] = ANGLES[unit] * table.numbers[:, column]
            units.add({"deg": "degrees", "rad": "radians"}[unit])
    if np.abs(lean).max(initial=0.0) >= 0.5 * np.pi:
        raise InvalidInput("lead and tilt are angles from the normal, below 90 degrees.")
    notes.append(
        "the tool leans from the normal by lead, towards the direction of the path, and by tilt, "
        f"to the left of it, in {' and '.join(sorted(units))}; --orientation none leaves both out."
    )
    return lean


def _leaned(positions: Array, normals: Array, lean: Array, ends: Sequence[int]) -> Array:
    r"""Tool axes of the normals n, (N, 3) each; lead λ and tilt τ as Lead/Lean of Autodesk.

    With t along each curve, perpendicular to n:

    .. math:: \cos\tau\,(\cos\lambda\,\mathbf n + \sin\lambda\,\mathbf t)
        + \sin\tau\,\mathbf n \times \mathbf t
    """
    found = normals.copy()
    for a, b in pairwise(ends):
        lengths = np.linalg.norm(normals[a:b], axis=1, keepdims=True)
        n = normals[a:b] / np.where(lengths > 0.0, lengths, 1.0)
        t = tangents("lead and tilt", positions[a:b], n)
        lead, tilt = lean[a:b, :1], lean[a:b, 1:]
        ahead = np.cos(lead) * n + np.sin(lead) * t
        found[a:b] = np.cos(tilt) * ahead + np.sin(tilt) * np.cross(n, t)
    return found


def _rapid(table: Table, where: ColumnRoles) -> Mask | None:
    """Which motions are rapid by a column of their types; ``None`` without such a column.

    Arcs are refused: a table has no columns for their centres.
    """
    if "type" not in where.single:
        return None
    entries = table.texts(where.single["type"])
    arcs = [bool(_ARC.fullmatch(entry)) for entry in entries]
    rapid = np.array([bool(_RAPID.fullmatch(entry)) for entry in entries])
    cut = [bool(_CUT.fullmatch(entry)) for entry in entries]
    if not (rapid | arcs | cut).all():
        return None
    if any(arcs):
        raise InvalidInput(
            "an arc, for which a table has no columns; write straight motions.",
            line=int(table.lines[arcs.index(True)]),
            column=table.call(where.single["type"]),
        )
    return rapid


def _curves(table: Table, where: ColumnRoles) -> tuple[Mask, list[str]]:
    """Where a curve begins, (N,), and the name of the part of the file that each row is in."""
    count = len(table.lines)
    begins, names = np.zeros(count, dtype=bool), [""] * count
    begins[:1] = True
    ends = [*table.breaks, count]
    for begin, end in pairwise(ends):
        if begin < count:
            begins[begin] = True
            names[begin:end] = [table.breaks[begin]] * (end - begin)
    if "curve" in where.single:
        names = table.texts(where.single["curve"])
        begins[1:] |= [a != b for a, b in pairwise(names)]
    return begins, names


def _unused(table: Table, where: ColumnRoles, *, rapid: bool) -> list[str]:
    """Notes on columns that are not used, and on feeds whose unit is open."""
    used = {*where.numbers, where.single.get("curve")}
    if rapid:
        used.add(where.single["type"])
    unused = [table.call(i) for i in range(table.width) if i not in used]
    more = f" and {len(unused) - _LISTED} more" if len(unused) > _LISTED else ""
    found = [f"not used: {', '.join(unused[:_LISTED])}{more}."] if unused else []
    speeds = usual(table.names).get("feed", {}).get(0, [])
    if "feed" not in where.single and speeds:
        found.append(
            f"{' and '.join(table.call(i) for i in speeds)} may state feeds, but not in which unit;"
            ' write it into the header, e.g. "feed [mm/min]", or add feed_unit = "mm/min" to '
            "[path]."
        )
    return found
