"""Meaning and unit of a table's columns."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, cast

from qp_twist.errors import InvalidInput
from qp_twist.files import FEEDS, FeedUnit, Table, columns_named, split_unit
from qp_twist.paths.suggested_columns import Suggestion

Orientation = Literal["axis", "normal", "quaternion", "rpy", "none"]
Column = str | int
Unit = TypeVar("Unit", bound=str)

_SIZES = {"position": 3, "axis": 3, "normal": 3, "quaternion": 4, "rpy": 3, "angles": 3, "curve": 1,
          "feed": 1}  # fmt: skip


def _usual_names() -> dict[str, tuple[str, int]]:
    """Usual column names (letters and digits only): each with its group and index in it."""
    names: dict[str, tuple[str, int]] = {}
    forms = {
        "position": ("{}", "p{}", "pos{}", "{}pos", "position{}", "{}position", "coord{}",
                     "{}coord", "coordinate{}", "{}coordinate"),
        "axis": ("a{}", "axis{}", "{}axis", "toolaxis{}"),
        "normal": ("n{}", "norm{}", "{}norm", "normal{}", "{}normal"),
        "angles": ("r{}", "rot{}"),
    }  # fmt: skip
    for group, patterns in forms.items():
        for pattern in patterns:
            names.update({pattern.format(c): (group, i) for i, c in enumerate("xyz")})
    for pattern in ("q{}", "quat{}", "quaternion{}", "orientation{}"):
        names.update({pattern.format(c): ("quaternion", i) for i, c in enumerate("wxyz")})
    for letters, group in (("ijk", "axis"), ("wpr", "rpy")):
        names.update({c: (group, i) for i, c in enumerate(letters)})
    names.update({c: ("rpy", i) for i, c in enumerate(("roll", "pitch", "yaw"))})
    for c in ("curve", "curveid", "curvename", "pass", "contour", "stroke"):
        names[c] = ("curve", 0)
    for c in ("feed", "feedrate", "f", "speed", "velocity", "pathspeed", "tcpspeed"):
        names[c] = ("feed", 0)
    return names


_USUAL = _usual_names()


@dataclass(frozen=True)
class ColumnChoice:
    """Columns chosen by the user: names of the header, or numbers counted from 1.

    Attributes:
        position: x, y, z.
        axis: Axis of the tool, from its tip to its holder.
        normal: Normal of the surface, away from the part.
        quaternion_wxyz: w first.
        quaternion_xyzw: w last.
        rpy: Roll about x, pitch about y, yaw about z.
        curve: Another curve begins where its entry changes.
        feed: Feed of the motion to each point.
    """

    position: tuple[Column, ...] | None = None
    axis: tuple[Column, ...] | None = None
    normal: tuple[Column, ...] | None = None
    quaternion_wxyz: tuple[Column, ...] | None = None
    quaternion_xyzw: tuple[Column, ...] | None = None
    rpy: tuple[Column, ...] | None = None
    curve: Column | None = None
    feed: Column | None = None


class UnclearColumns(InvalidInput):
    """The header of a table does not identify its columns.

    Attributes:
        message: Without the suggestion.
        suggestion: Their likely meaning by the numbers, if there is one.
    """

    def __init__(self, message: str, suggestion: Suggestion | None = None) -> None:
        example = "For example: [path.columns] position = [1, 2, 3], normal = [4, 5, 6]."
        super().__init__(f"{message} {suggestion or example}")
        self.message = message
        self.suggestion = suggestion


def index_of(table: Table, key: str, column: Column) -> int:
    """Index of a column that was chosen by name, or by number from 1.

    Raises:
        InvalidInput: If there is no such column, or more than one.
    """
    if isinstance(column, int):
        if not 1 <= column <= table.width:
            raise InvalidInput(
                f"columns.{key}: the file has columns 1 to {table.width}, got {column}."
            )
        return column - 1
    found = columns_named(table.names, column)
    if len(found) == 1:
        return found[0]
    raise InvalidInput(
        f"columns.{key}: there is no column {column!r}; "
        + (f"the header names {', '.join(map(repr, table.names))}." if table.names
           else "the file has no header line, so give numbers, counted from 1.")
    )  # fmt: skip


def unit_of(
    table: Table, key: str, columns: Sequence[int], chosen: Unit | None, known: Collection[Unit]
) -> tuple[Unit, bool]:
    """The unit of some columns, and whether it is from the header.

    Raises:
        InvalidInput: If there is none, header and ``chosen`` differ, or it is not known.
    """
    found = {split_unit(table.names[i])[1] for i in columns} if table.names else {None}
    called = ", ".join(table.call(i) for i in columns)
    if len(found) > 1:
        raise InvalidInput(f"{called} have different units in the header; write one unit for all.")
    [unit] = found
    if unit is None:
        if chosen is not None:
            return chosen, False
        first, example = table.names[columns[0]] if table.names else "x", next(iter(known))
        raise InvalidInput(
            f"the unit of {called} is not said; add {key} = "
            + " or ".join(f'"{u}"' for u in known)
            + f" to [path] of the task file, or write it into the header: {first} [{example}]."
        )
    if unit not in known:
        raise InvalidInput(f"{called}: the header says {unit!r}; known are {', '.join(known)}.")
    if chosen not in (None, unit):
        raise InvalidInput(
            f"{called}: the header says {unit}, {key} of the task file says {chosen}; correct one "
            "of them."
        )
    return cast(Unit, unit), True


@dataclass(frozen=True)
class ColumnRoles:
    """Roles of the columns of a table.

    Attributes:
        position: Indices of x, y, z.
        orientation: Meaning of the direction columns.
        direction: Their indices; a quaternion's w first.
        curve: Index of the curve's name.
        feed: Index of the feed.
    """

    position: tuple[int, ...]
    orientation: Orientation
    direction: tuple[int, ...]
    curve: int | None
    feed: int | None = None

    @property
    def numbers(self) -> tuple[int, ...]:
        """Indices of the columns that must hold numbers: position, direction, feed."""
        return self.position + self.direction + (() if self.feed is None else (self.feed,))


def usual(names: Sequence[str]) -> dict[str, dict[int, list[int]]]:
    """Groups of columns with usual names: for each index in a group, the columns."""
    found: dict[str, dict[int, list[int]]] = {}
    for index, name in enumerate(names):
        letters = re.sub(r"[^a-z0-9]", "", split_unit(name)[0].lower())
        meant = _USUAL.get(letters) or _USUAL.get(
            re.sub(r"^(?:pose|tcp|point|waypoint|tool)", "", letters)
        )
        if meant:
            found.setdefault(meant[0], {}).setdefault(meant[1], []).append(index)
    return found


def has_position(names: Sequence[str]) -> bool:
    """Whether the names are those of a table with x, y and z."""
    return len(usual(names).get("position", {})) == 3


def column_roles(
    table: Table,
    choice: ColumnChoice,
    orientation: Orientation | None,
    feed_unit: FeedUnit | None = None,
) -> ColumnRoles:
    """Roles of the columns: as chosen, else by usual names, else the only ones possible.

    A feed column is used only if its unit is known: ``speed`` alone may be that of a spindle.

    Raises:
        InvalidInput: If the columns contradict each other.
        UnclearColumns: If the columns have to be chosen.
    """
    position = _chosen(table, "position", choice.position, 3)
    direction = _chosen_direction(table, choice)
    settled = set() if position is None else {"position"}
    if direction is not None or orientation == "none":
        settled |= _SIZES.keys() - {"position", "curve", "feed"}
    if choice.feed is not None:
        settled.add("feed")
    feed = index_of(table, "feed", choice.feed) if choice.feed is not None else None
    groups = _groups(table, settled, feed_unit)
    if position is None:
        position = groups.get("position")
    if feed is None and "feed" in groups:
        [feed] = groups["feed"]
    if position is None:
        if table.names:
            raise UnclearColumns(
                f"no columns x, y, z among {', '.join(map(repr, table.names))}; "
                "say which they are in [path.columns] of the task file."
            )
        if direction is None or table.width < 3:
            return _without_header(table, choice, orientation, feed)
        position = (0, 1, 2)
    curve = index_of(table, "curve", choice.curve) if choice.curve is not None else None
    if curve is None and "curve" in groups:
        [curve] = groups["curve"]
    if direction is not None:
        if orientation not in (None, direction[0], "none"):
            raise InvalidInput(
                f"columns has {direction[0]}, orientation is {orientation!r}; "
                "leave one of them out."
            )
        found = ("none", ()) if orientation == "none" else direction
    else:
        found = _usual_direction(table, groups, orientation)
    where = ColumnRoles(position, found[0], found[1], curve, feed)
    if len(set(where.numbers)) < len(where.numbers):
        raise InvalidInput("columns: a column is used twice.")
    return where


def _groups(
    table: Table, settled: set[str], feed_unit: FeedUnit | None
) -> dict[str, tuple[int, ...]]:
    """The complete groups among the usual names of a header, except those already settled."""
    groups = {}
    for group, places in usual(table.names).items():
        if group in settled:
            continue
        if group == "feed":
            # The same names are used for other quantities; the unit decides.
            known = [i for i in places[0] if split_unit(table.names[i])[1] in FEEDS]
            places = {0: known or (places[0] if feed_unit is not None else [])}  # noqa: PLW2901
            if not places[0]:
                continue
        twice = [columns for columns in places.values() if len(columns) > 1]
        if twice:
            raise InvalidInput(
                f"{' and '.join(table.call(i) for i in twice[0])} mean the same; "
                "say in [path.columns] of the task file which one counts."
            )
        if len(places) == _SIZES[group]:
            groups[group] = tuple(places[i][0] for i in range(_SIZES[group]))
            continue
        lonely = [columns[0] for columns in places.values()]
        # A lone letter is something else: i is an index, r a radius, rx … of a table without ry.
        if group in ("axis", "rpy") and all(len(table.names[i].strip()) == 1 for i in lonely):
            continue
        if group == "position" and len(places) < 3:
            continue  # column_roles says so
        raise InvalidInput(
            f"{', '.join(table.call(i) for i in lonely)}: {len(lonely)} of "
            f"{_SIZES[group]} columns of one {group}; add the missing ones, or say in "
            "[path.columns] what counts."
        )
    return groups


def _chosen(
    table: Table, key: str, columns: tuple[Column, ...] | None, size: int
) -> tuple[int, ...] | None:
    if columns is None:
        return None
    if len(columns) != size:
        raise InvalidInput(f"columns.{key}: expected {size} columns, got {len(columns)}.")
    return tuple(index_of(table, key, column) for column in columns)


def _chosen_direction(
    table: Table, choice: ColumnChoice
) -> tuple[Orientation, tuple[int, ...]] | None:
    found: list[tuple[Orientation, tuple[int, ...]]] = []
    kinds: tuple[tuple[str, Orientation], ...] = (
        ("axis", "axis"), ("normal", "normal"), ("quaternion_wxyz", "quaternion"),
        ("quaternion_xyzw", "quaternion"), ("rpy", "rpy"),
    )  # fmt: skip
    for key, orientation in kinds:
        indices = _chosen(table, key, getattr(choice, key), _SIZES[orientation])
        if indices is not None:
            if key == "quaternion_xyzw":
                indices = (indices[3], *indices[:3])
            found.append((orientation, indices))
    if len(found) > 1:
        raise InvalidInput(f"columns: choose one orientation, not {len(found)}.")
    return found[0] if found else None


def _usual_direction(
    table: Table, groups: dict[str, tuple[int, ...]], orientation: Orientation | None
) -> tuple[Orientation, tuple[int, ...]]:
    kinds: tuple[Orientation, ...] = ("axis", "normal", "quaternion", "rpy")
    present = [kind for kind in kinds if kind in groups]
    if orientation == "none" or (orientation is None and not present and "angles" not in groups):
        return "none", ()
    if orientation == "rpy" and not present and "angles" in groups:
        return "rpy", groups["angles"]
    if orientation is not None:
        if orientation not in groups:
            raise InvalidInput(
                f"orientation is {orientation!r}, but the header has no such "
                f"columns: {', '.join(map(repr, table.names))}; say which they are in "
                "[path.columns] of the task file."
            )
        return orientation, groups[orientation]
    if not present:
        raise InvalidInput(
            f"{', '.join(table.call(i) for i in groups['angles'])}: these can be "
            'roll, pitch, yaw or a rotation vector; add orientation = "rpy" to [path] of the task '
            'file if R = Rz Ry Rx, or orientation = "none" to leave them out.'
        )
    if len(present) > 1:
        raise InvalidInput(
            f"the header has columns for {' and '.join(present)}; add orientation = "
            f'"{present[0]}" or another to [path] of the task file.'
        )
    return present[0], groups[present[0]]


def _without_header(
    table: Table, choice: ColumnChoice, orientation: Orientation | None, feed: int | None
) -> ColumnRoles:
    """Roles in a table whose columns have no names and were not chosen."""
    curve = None if choice.curve is None else index_of(table, "curve", choice.curve)
    if table.width == 3 and orientation in (None, "none") and feed is None:
        return ColumnRoles((0, 1, 2), "none", (), curve)
    if table.width == 6 and orientation in ("axis", "normal", "rpy") and feed is None:
        return ColumnRoles((0, 1, 2), orientation, (3, 4, 5), curve)
    raise UnclearColumns(
        f"{table.width} columns and no header line with x, y, z; say what they "
        "are in [path.columns] of the task file, counted from 1: position, and normal, axis, "
        "quaternion_wxyz, quaternion_xyzw or rpy."
    )
