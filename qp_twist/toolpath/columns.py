"""Which column of a table is what, and in which unit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from qp_twist.errors import InvalidInput
from qp_twist.toolpath.suggest import Suggestion

Orientation = Literal["axis", "normal", "quaternion", "rpy", "none"]
LengthUnit = Literal["m", "mm", "inch"]
AngleUnit = Literal["deg", "rad"]
FeedUnit = Literal["mm/min", "mm/s", "m/min", "m/s", "inch/min"]
Column = str | int

LENGTHS: dict[LengthUnit, float] = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}
"""Metres in a unit."""
ANGLES: dict[AngleUnit, float] = {"deg": math.radians(1.0), "rad": 1.0}
"""Radians in a unit."""
FEEDS: dict[FeedUnit, float] = {
    "mm/min": 1e-3 / 60.0, "mm/s": 1e-3, "m/min": 1.0 / 60.0, "m/s": 1.0,
    "inch/min": 0.0254 / 60.0,
}  # fmt: skip
"""Metres per second in a unit."""

_UNITS = {
    "m": "m", "meter": "m", "meters": "m", "metre": "m", "metres": "m",
    "mm": "mm", "millimeter": "mm", "millimeters": "mm", "millimetre": "mm", "millimetres": "mm",
    "in": "inch", "inch": "inch", "inches": "inch",
    "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "grad": "grad",
    "rad": "rad", "radian": "rad", "radians": "rad",
    "cm": "cm", "um": "µm", "µm": "µm", "μm": "µm", "ft": "ft", "feet": "ft",
    "mm/min": "mm/min", "mmpm": "mm/min", "mm/s": "mm/s", "mm/sec": "mm/s", "m/min": "m/min",
    "m/s": "m/s", "m/sec": "m/s", "in/min": "inch/min", "inch/min": "inch/min", "ipm": "inch/min",
}  # fmt: skip
"""Units as headers write them; those that are no ``LengthUnit`` or ``AngleUnit`` are refused."""

_SIZES = {"position": 3, "axis": 3, "normal": 3, "quaternion": 4, "rpy": 3, "angles": 3, "curve": 1,
          "feed": 1}  # fmt: skip


def _usual_names() -> dict[str, tuple[str, int]]:
    """What the letters and digits of a usual column name mean: a group, and a place in it."""
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
    """Columns stated by hand: each a header's name, or a number counted from 1.

    Attributes:
        position: x, y, z.
        axis: Of the tool, from its tip to its holder.
        normal: Of the surface, away from the part.
        quaternion_wxyz: w first.
        quaternion_xyzw: w last.
        rpy: Roll about x, pitch about y, yaw about z.
        curve: Where its entry changes, another curve begins.
        feed: Of the motion to each point.
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
    """A table whose header does not say what its columns are.

    Attributes:
        message: Without the suggestion.
        suggestion: What they may be by their numbers, if these tell.
    """

    def __init__(self, message: str, suggestion: Suggestion | None = None) -> None:
        example = "For example: [path.columns] position = [1, 2, 3], normal = [4, 5, 6]."
        super().__init__(f"{message} {suggestion or example}")
        self.message = message
        self.suggestion = suggestion


@dataclass(frozen=True)
class Header:
    """The names of a table's columns, of which a file may have none.

    Attributes:
        file: Name of the file, for messages.
        names: As in the file; empty without a header line.
        width: Number of columns.
    """

    file: str
    names: tuple[str, ...]
    width: int

    def call(self, index: int) -> str:
        """A column as messages call it."""
        return f"column {self.names[index]!r}" if self.names else f"column {index + 1}"

    def named(self, name: str) -> list[int]:
        """Indices of the columns of a name: as it stands, or without its unit and in any case."""
        exact = [i for i, other in enumerate(self.names) if other == name]
        return exact or [
            i
            for i, other in enumerate(self.names)
            if split_unit(other)[0].lower() == name.strip().lower()
        ]

    def index(self, key: str, column: Column) -> int:
        """Index of a column that was stated by name, or by number from 1.

        Raises:
            InvalidInput: If there is no such column, or more than one.
        """
        if isinstance(column, int):
            if not 1 <= column <= self.width:
                raise InvalidInput(
                    f"{self.file}: columns.{key}: the file has columns 1 to {self.width}, got "
                    f"{column}."
                )
            return column - 1
        found = self.named(column)
        if len(found) == 1:
            return found[0]
        raise InvalidInput(
            f"{self.file}: columns.{key}: there is no column {column!r}; "
            + (f"the header names {', '.join(map(repr, self.names))}." if self.names
               else "the file has no header line, so give numbers, counted from 1.")
        )  # fmt: skip

    def unit(
        self, key: str, columns: Sequence[int], stated: str | None, known: Mapping[Any, float]
    ) -> float:
        """The unit of some columns, in m or rad: the header's, or the one stated.

        Raises:
            InvalidInput: If there is none, the two differ, or it is not known.
        """
        found = {split_unit(self.names[i])[1] for i in columns} if self.names else {None}
        called = ", ".join(self.call(i) for i in columns)
        if len(found) > 1:
            raise InvalidInput(
                f"{self.file}: {called} have different units in the header; write one unit for all."
            )
        [unit] = found
        if unit is None and stated is None:
            first, example = self.names[columns[0]] if self.names else "x", next(iter(known))
            raise InvalidInput(
                f"{self.file}: the unit of {called} is not said; add {key} = "
                + " or ".join(f'"{u}"' for u in known)
                + f" to [path] of the task file, or write it into the header: {first} [{example}]."
            )
        if unit is not None and unit not in known:
            raise InvalidInput(
                f"{self.file}: {called}: the header says {unit!r}; known are {', '.join(known)}."
            )
        if None not in (unit, stated) and unit != stated:
            raise InvalidInput(
                f"{self.file}: {called}: the header says {unit}, {key} of the task file says "
                f"{stated}; correct one of them."
            )
        return known[unit or stated]


@dataclass(frozen=True)
class Layout:
    """Where in a row everything stands.

    Attributes:
        position: Indices of x, y, z.
        orientation: What the other columns state.
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


def split_unit(name: str) -> tuple[str, str | None]:
    """A column's name, and the unit that is written behind it: ``x [mm]``, ``x_mm``, ``x/mm``."""
    bracket = re.fullmatch(r"(.*?)[\s_]*[\[({]\s*(.*?)\s*[\])}]\s*", name)
    if bracket and bracket[1]:
        written = bracket[2].strip().lower()
        # What is in brackets but no unit, as in "nx [-]", says nothing.
        return bracket[1], _UNITS.get(written, written if written.isalpha() else None)
    suffix = re.fullmatch(
        r"(.*?)\s*[\s_./-]\s*((?:mm|m|in|inch)/(?:min|sec|s)|[a-zµμ°]+)",
        name.strip(),
        re.IGNORECASE,
    )
    if suffix and suffix[1] and suffix[2].lower() in _UNITS:
        return suffix[1], _UNITS[suffix[2].lower()]
    return name.strip(), None


def is_unit_row(fields: Sequence[str], width: int) -> bool:
    """Whether a line below the header states the columns' units, in brackets or not."""
    bare = [field.strip("[](){} ").lower() for field in fields]
    return (
        len(fields) <= width
        and any(bare)
        and all(field in _UNITS or field in ("", "-", "1") for field in bare)
    )


def usual(names: Sequence[str]) -> dict[str, dict[int, list[int]]]:
    """Groups of columns that have usual names: for each place in a group, indices of columns."""
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


def layout(
    header: Header,
    choice: ColumnChoice,
    orientation: Orientation | None,
    feed_unit: FeedUnit | None = None,
) -> Layout:
    """Where everything stands: as stated, else by usual names, else in the only way possible.

    A column of feeds counts where its unit is known: ``speed`` alone may be that of a spindle.

    Raises:
        InvalidInput: If that does not settle it.
        UnclearColumns: If the columns have to be stated.
    """
    position = _stated(header, "position", choice.position, 3)
    stated = _stated_direction(header, choice)
    settled = set() if position is None else {"position"}
    if stated is not None or orientation == "none":
        settled |= _SIZES.keys() - {"position", "curve", "feed"}
    if choice.feed is not None:
        settled.add("feed")
    feed = header.index("feed", choice.feed) if choice.feed is not None else None
    groups = _groups(header, settled, feed_unit)
    if position is None:
        position = groups.get("position")
    if feed is None and "feed" in groups:
        [feed] = groups["feed"]
    if position is None:
        if header.names:
            raise UnclearColumns(
                f"{header.file}: no columns x, y, z among {', '.join(map(repr, header.names))}; "
                "say which they are in [path.columns] of the task file."
            )
        if stated is None or header.width < 3:
            return _without_header(header, choice, orientation, feed)
        position = (0, 1, 2)
    curve = header.index("curve", choice.curve) if choice.curve is not None else None
    if curve is None and "curve" in groups:
        [curve] = groups["curve"]
    if stated is not None:
        if orientation not in (None, stated[0], "none"):
            raise InvalidInput(
                f"{header.file}: columns states {stated[0]}, orientation states {orientation}; "
                "leave one of them out."
            )
        found = ("none", ()) if orientation == "none" else stated
    else:
        found = _usual_direction(header, groups, orientation)
    where = Layout(position, found[0], found[1], curve, feed)
    if len(set(where.numbers)) < len(where.numbers):
        raise InvalidInput(f"{header.file}: columns: a column is stated twice.")
    return where


def _groups(
    header: Header, settled: set[str], feed_unit: FeedUnit | None
) -> dict[str, tuple[int, ...]]:
    """The whole groups among the usual names of a header, without those settled otherwise."""
    groups = {}
    for group, places in usual(header.names).items():
        if group in settled:
            continue
        if group == "feed":
            # The same names are used for what is no feed; the unit tells.
            known = [i for i in places[0] if split_unit(header.names[i])[1] in FEEDS]
            places = {0: known or (places[0] if feed_unit is not None else [])}  # noqa: PLW2901
            if not places[0]:
                continue
        twice = [columns for columns in places.values() if len(columns) > 1]
        if twice:
            raise InvalidInput(
                f"{header.file}: {' and '.join(header.call(i) for i in twice[0])} mean the same; "
                "say in [path.columns] of the task file which one counts."
            )
        if len(places) == _SIZES[group]:
            groups[group] = tuple(places[i][0] for i in range(_SIZES[group]))
            continue
        lonely = [columns[0] for columns in places.values()]
        # A lone letter is something else: i is an index, r a radius, rx … of a table without ry.
        if group in ("axis", "rpy") and all(len(header.names[i].strip()) == 1 for i in lonely):
            continue
        if group == "position" and len(places) < 3:
            continue  # layout says so
        raise InvalidInput(
            f"{header.file}: {', '.join(header.call(i) for i in lonely)}: {len(lonely)} of "
            f"{_SIZES[group]} columns of one {group}; add the missing ones, or say in "
            "[path.columns] what counts."
        )
    return groups


def _stated(
    header: Header, key: str, columns: tuple[Column, ...] | None, size: int
) -> tuple[int, ...] | None:
    if columns is None:
        return None
    if len(columns) != size:
        raise InvalidInput(
            f"{header.file}: columns.{key}: expected {size} columns, got {len(columns)}."
        )
    return tuple(header.index(key, column) for column in columns)


def _stated_direction(
    header: Header, choice: ColumnChoice
) -> tuple[Orientation, tuple[int, ...]] | None:
    found: list[tuple[Orientation, tuple[int, ...]]] = []
    kinds: tuple[tuple[str, Orientation], ...] = (
        ("axis", "axis"), ("normal", "normal"), ("quaternion_wxyz", "quaternion"),
        ("quaternion_xyzw", "quaternion"), ("rpy", "rpy"),
    )  # fmt: skip
    for key, orientation in kinds:
        indices = _stated(header, key, getattr(choice, key), _SIZES[orientation])
        if indices is not None:
            if key == "quaternion_xyzw":
                indices = (indices[3], *indices[:3])
            found.append((orientation, indices))
    if len(found) > 1:
        raise InvalidInput(f"{header.file}: columns: state one orientation, not {len(found)}.")
    return found[0] if found else None


def _usual_direction(
    header: Header, groups: dict[str, tuple[int, ...]], orientation: Orientation | None
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
                f"{header.file}: orientation is {orientation!r}, but the header has no such "
                f"columns: {', '.join(map(repr, header.names))}; say which they are in "
                "[path.columns] of the task file."
            )
        return orientation, groups[orientation]
    if not present:
        raise InvalidInput(
            f"{header.file}: {', '.join(header.call(i) for i in groups['angles'])}: these can be "
            'roll, pitch, yaw or a rotation vector; add orientation = "rpy" to [path] of the task '
            'file if R = Rz Ry Rx, or orientation = "none" to leave them out.'
        )
    if len(present) > 1:
        raise InvalidInput(
            f"{header.file}: the header has columns for {' and '.join(present)}; add orientation = "
            f'"{present[0]}" or another to [path] of the task file.'
        )
    return present[0], groups[present[0]]


def _without_header(
    header: Header, choice: ColumnChoice, orientation: Orientation | None, feed: int | None
) -> Layout:
    """A table whose columns have no names and were not stated."""
    curve = None if choice.curve is None else header.index("curve", choice.curve)
    if header.width == 3 and orientation in (None, "none") and feed is None:
        return Layout((0, 1, 2), "none", (), curve)
    if header.width == 6 and orientation in ("axis", "normal", "rpy") and feed is None:
        return Layout((0, 1, 2), orientation, (3, 4, 5), curve)
    raise UnclearColumns(
        f"{header.file}: {header.width} columns and no header line with x, y, z; say what they "
        "are in [path.columns] of the task file, counted from 1: position, and normal, axis, "
        "quaternion_wxyz, quaternion_xyzw or rpy."
    )
