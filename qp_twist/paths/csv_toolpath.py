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
    of_lines,
    split_unit,
)
from qp_twist.paths.assumed_units import assumed_angle_unit, assumed_length_unit, named_length_unit
from qp_twist.paths.column_names import has_position, names_in, usual
from qp_twist.paths.orientation import tangents
from qp_twist.paths.pose_records import only_frame
from qp_twist.paths.toolpath import SAME_POINT, Toolpath
from qp_twist.paths.toolpath_builder import ToolpathFormat
from qp_twist.paths.toolpath_columns import ColumnChoice, ColumnRoles, called, column_roles, unit_of
from qp_twist.paths.toolpath_options import ReadingOptions
from qp_twist.paths.toolpath_points import Points, PointsOfCurve, curves_between_rapids, toolpath_of

_LISTED = 12
"""Number of unused columns that are named; the others are counted."""
_RAPID = re.compile(r"g?0+(\.0*)?|rapid|r|retract|travel|t|movej|ptp|joint|j", re.IGNORECASE)
_CUT = re.compile(
    r"g?0*1(\.0*)?|cut|cutting|feed|linear|work|contact|process|print|p|movel|lin|l", re.IGNORECASE
)
_ARC = re.compile(r"g?0*[23](\.0*)?|arc|circ|circular|movec|c", re.IGNORECASE)
"""Entries of a column of motions."""
_FRAME = re.compile(r"(?<!child)(?:frameid|referenceframe|wobj|workobject)$")
"""Ends of the names of columns that name the frame of each row, by their letters."""
_TYPES = "G0, rapid, travel, joint (or MoveJ, PTP) and G1, cut, feed, linear (MoveL, LIN)"


def _read(path: Path, lines: Sequence[str], options: ReadingOptions) -> Toolpath:
    """The toolpath of a table in a text."""
    stated = (options.columns or ColumnChoice()).stated
    by_name = [c for columns in stated.values() for c in columns if isinstance(c, str)]
    table = TextTable(
        lines, least=3, texts=True, expected="a toolpath needs x, y and z in every row",
        is_header=lambda names: (
            has_position(names)
            or (bool(by_name) and all(columns_named(names, name) for name in by_name))
        ),
    )  # fmt: skip
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
    notes = [*notes, *where.notes]
    rapid = _rapid(table, where, notes)
    for column, name in enumerate(table.names):
        if _FRAME.search(re.sub(r"[\W_]", "", name.lower())):
            frame = only_frame(table.call(column), map(str.strip, table.texts(column)))
            notes += [f"points are in the frame {frame}."] if frame else []
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
    outward = -1.0 if options.axes_point == "into" else 1.0
    if where.x_axis or where.y_axis:
        into = options.axes_point == "into"
        second = _x_axes(table, where, directions, problems, notes, into=into)
        directions = np.hstack([directions, second])
    if {"lead", "tilt"} & where.single.keys():
        orientation, lean = "axis", _lean(table, where, options, notes)
        starts = begins if rapid is None else begins | rapid
        normals = outward * directions[:, :3]
        directions[:, :3] = outward * _leaned(positions, normals, lean, starts, rapid)
    feeds = np.full(len(begins), np.nan)
    if feed_column is not None:
        feeds = _feeds(table, feed_column, options, begins, problems)
    points = Points(positions, directions, table.lines, feeds)
    if rapid is None:
        curves = [PointsOfCurve(points.part(slice(a, b), names[a])) for a, b in pairwise(ends)]
    else:
        curves = curves_between_rapids(points, names, rapid, begins)
    return toolpath_of(
        path, orientation, curves, called(table, where.direction), problems, assumptions=notes,
        passed_over=[*passed_over, *_unused(table, where, rapid=rapid is not None)], unit=unit,
        unit_in_file=in_file,
    )  # fmt: skip


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


def _x_axes(
    table: Table,
    where: ColumnRoles,
    directions: Array,
    problems: Problems,
    notes: list[str],
    *,
    into: bool,
) -> Array:
    """x of the tool at each point, (N, 3), from columns of x or of y and from z, with a note."""
    outward = -directions if into else directions
    x, y = (table.numbers[:, at] for at in (where.x_axis, where.y_axis))
    if where.x_axis and where.y_axis:
        other = "out" if into else "into"
        left_handed = (np.cross(x, y) * outward).sum(axis=1) < 0.0
        for line in table.lines[left_handed][:1].tolist():
            what = f"x, y and {where.orientation} are left-handed; does the {where.orientation} "
            what += f'point the other way? Then axes_point = "{other}"'
            problems.add(line, what, options={"axes_point": other})
    letter, columns = ("x", where.x_axis) if where.x_axis else ("y", where.y_axis)
    stated = table.numbers[:, columns]
    back = np.flatnonzero((stated[1:] * stated[:-1]).sum(axis=1) < 0.0) + 1
    note = f"{called(table, columns)} are {letter} of the tool: the roll of the waypoints."
    if len(back):
        where_back = of_lines(table.lines[back].tolist())
        note += f" They turn by more than 90 degrees from a point to the next ({where_back})."
    notes.append(note)
    return x if where.x_axis else np.cross(y, outward)


def _lean(table: Table, where: ColumnRoles, options: ReadingOptions, notes: list[str]) -> Array:
    """Lead and tilt at each point, rad, (N, 2)."""
    lean, units = np.zeros((len(table.lines), 2)), set()
    for place, key in enumerate(("lead", "tilt")):
        if key in where.single:
            column = where.single[key]
            stated = split_unit(table.names[column])[1]
            chosen = options.angle_unit or (None if stated else "deg")
            unit, _ = unit_of(table, "angle_unit", (column,), chosen, ANGLES)
            lean[:, place] = ANGLES[unit] * table.numbers[:, column]
            units.add({"deg": "degrees", "rad": "radians"}[unit])
    if np.abs(lean).max(initial=0.0) >= 0.5 * np.pi:
        raise InvalidInput("lead and tilt are angles from the normal, below 90 degrees.")
    notes.append(
        "the tool leans from the normal by lead, towards the direction of the path, and by tilt, "
        f"to the left of it, in {' and '.join(sorted(units))}; --orientation none leaves both out."
    )
    return lean


def _leaned(
    positions: Array, normals: Array, lean: Array, starts: Mask, rapid: Mask | None
) -> Array:
    r"""Tool axes of the normals n, (N, 3) each; lead λ and tilt τ as Lead/Lean of Autodesk.

    With t along each curve or cut (they begin at ``starts``), perpendicular to n; at a point
    between rapid motions it is that of the next cut, or of the last one:

    .. math:: \cos\tau\,(\cos\lambda\,\mathbf n + \sin\lambda\,\mathbf t)
        + \sin\tau\,\mathbf n \times \mathbf t
    """
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    n = normals / np.where(lengths > 0.0, lengths, 1.0)
    t, cut = np.zeros_like(n), np.ones(len(n), dtype=bool)
    for a, b in pairwise([*np.flatnonzero(starts).tolist(), len(starts)]):
        if rapid is not None and rapid[a] and np.ptp(positions[a:b], axis=0).max() < SAME_POINT:
            cut[a:b] = False
        else:
            t[a:b] = tangents("lead and tilt", positions[a:b], n[a:b])
    if cut.any():
        alone, of_cuts = np.flatnonzero(~cut), np.flatnonzero(cut)
        after = np.minimum(np.searchsorted(of_cuts, alone), len(of_cuts) - 1)
        t[alone] = t[of_cuts[after]]
        t[alone] -= (t[alone] * n[alone]).sum(axis=1, keepdims=True) * n[alone]
        size = np.linalg.norm(t[alone], axis=1, keepdims=True)
        t[alone] /= np.where(size > 0.0, size, 1.0)
    lead, tilt = lean[:, :1], lean[:, 1:]
    ahead = np.cos(lead) * n + np.sin(lead) * t
    return np.cos(tilt) * ahead + np.sin(tilt) * np.cross(n, t)


def _rapid(table: Table, where: ColumnRoles, notes: list[str]) -> Mask | None:
    """Which motions are rapid by a column of their types; ``None`` without such a column.

    A blank repeats the type before it. Arcs are refused: a table has no columns for their centres.
    """
    if "type" not in where.single:
        return None
    column = where.single["type"]
    entries = [entry.strip() for entry in table.texts(column)]
    for k in range(1, len(entries)):
        entries[k] = entries[k] or entries[k - 1]
    known = [_type_of(entry) for entry in entries]
    numbers = [float(entry) for entry in entries if re.fullmatch(r"\d+(\.\d*)?", entry)]
    counted = max(numbers, default=0.0) > 3.0  # numbers of the points, or of tools
    if counted or (not any(known) and len({*filter(None, entries)}) < 2):
        return None
    begin = 0 if entries[0] else 1  # no motion of the table leads to its first point
    if None in known[begin:] or "arc" in known:
        wrong = known.index(None, begin) if None in known[begin:] else known.index("arc")
        raise InvalidInput(
            (
                f"{entries[wrong] or 'a blank'!r} is no type of motion among {_TYPES}; write one "
                "of these"
                if known[wrong] is None
                else "an arc, for which a table has no columns; write straight motions"
            )
            + ", or give the column another name in the header to leave it out.",
            line=int(table.lines[wrong]),
            column=table.call(column),
        )
    if numbers:
        name = table.call(column)
        notes.append(
            f"{name}: 0 is read as G0, a rapid motion, and 1 as G1, a cut; another name in the "
            "header leaves the column out."
        )
    return np.array([kind == "rapid" for kind in known])


def _type_of(entry: str) -> str | None:
    """Which motion an entry of a column of types names; ``None`` if it is another word."""
    kinds = {"rapid": _RAPID, "cut": _CUT, "arc": _ARC}
    return next((kind for kind, words in kinds.items() if words.fullmatch(entry)), None)


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
