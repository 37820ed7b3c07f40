"""Meaning and unit of a table's columns."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeVar, cast

import numpy as np
from pydantic import Field, PlainValidator

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import ANGLES, FEEDS, AngleUnit, FeedUnit, Table, columns_named, split_unit
from qp_twist.paths.section import Section
from qp_twist.paths.suggested_columns import Suggestion, have_length_1

Orientation = Literal["axis", "normal", "quaternion", "rpy", "rotation_vector", "none"]
Column = str | int
Unit = TypeVar("Unit", bound=str)

_ANGLES = {*ANGLES, "grad"}
LOOKED_AT = 500
"""Number of rows whose numbers are compared with the names of their columns."""


@dataclass(frozen=True)
class Convention:
    """How a group of columns states an orientation.

    Attributes:
        orientation: What the columns are read as.
        order: Places in the group of roll, pitch, yaw, or of w, x, y, z.
        unit: Unit of its angles where the file states none and the numbers agree.
        called: The convention in notes, if only the letters of the names identify it.
    """

    orientation: Orientation
    order: tuple[int, ...] = (0, 1, 2)
    unit: AngleUnit | None = None
    called: str = ""


CONVENTIONS = {
    "axis": Convention("axis"),
    "normal": Convention("normal"),
    "quaternion": Convention("quaternion", (0, 1, 2, 3)),
    "numbered quaternion": Convention(
        "quaternion", (0, 1, 2, 3), called="a quaternion w, x, y, z, as ABB writes it"
    ),
    "rpy": Convention("rpy"),
    "W P R": Convention("rpy", unit="deg", called="FANUC's W, P, R: R = Rz(R) Ry(P) Rx(W)"),
    "A B C": Convention(
        "rpy",
        (2, 1, 0),
        unit="deg",
        called="KUKA's A, B, C: R = Rz(A) Ry(B) Rx(C) (of a robot with A about x choose rpy = "
        "A, B, C in [path.columns])",
    ),
    "rotation vector": Convention("rotation_vector", unit="rad"),
}
"""Groups of columns that state an orientation."""
_NOTHING = Convention("none", ())
_SIZES = {group: len(convention.order) for group, convention in CONVENTIONS.items()}
_SIZES |= {"position": 3, "angles": 3, "curve": 1, "feed": 1}


def _usual_names() -> dict[str, tuple[str, int]]:
    """Usual column names (letters and digits only): each with its group and index in it."""
    names: dict[str, tuple[str, int]] = {}
    forms = {
        "position": ("{}", "p{}", "pos{}", "{}pos", "position{}", "{}position", "coord{}",
                     "{}coord", "coordinate{}", "{}coordinate"),
        "axis": ("a{}", "axis{}", "{}axis", "toolaxis{}"),
        "normal": ("n{}", "norm{}", "{}norm", "normal{}", "{}normal"),
        "rotation vector": ("rotvec{}", "rotationvector{}", "rvec{}", "rv{}", "axisangle{}"),
        "angles": ("r{}", "rot{}", "rotation{}"),
    }  # fmt: skip
    for group, patterns in forms.items():
        for pattern in patterns:
            names.update({pattern.format(c): (group, i) for i, c in enumerate("xyz")})
    for pattern in ("q{}", "quat{}", "quaternion{}", "orientation{}"):
        names.update({pattern.format(c): ("quaternion", i) for i, c in enumerate("wxyz")})
        names.update({pattern.format(i): ("numbered quaternion", i) for i in range(10)})
    names.update({f"{c}w": ("angles", 3) for c in ("r", "rot", "rotation")})
    for letters, group in (("ijk", "axis"), ("wpr", "W P R"), ("abc", "A B C")):
        names.update({c: (group, i) for i, c in enumerate(letters)})
    names.update({c: ("rpy", i) for i, c in enumerate(("roll", "pitch", "yaw"))})
    for three in (("alpha", "beta", "gamma"), ("phi", "theta", "psi")):
        names.update({c: ("angles", i) for i, c in enumerate(three)})
    for c in ("curve", "curveid", "curvename", "pass", "contour", "stroke"):
        names[c] = ("curve", 0)
    for c in ("feed", "feedrate", "f", "speed", "velocity", "pathspeed", "tcpspeed"):
        names[c] = ("feed", 0)
    return names


_USUAL = _usual_names()


def _parse_column(value: object) -> str | int:
    """A column or a curve: a name, or a number from 1."""
    if isinstance(value, str) and value:
        return value
    if type(value) is int and value >= 1:
        return value
    raise ValueError(f"expected a name, or a number counted from 1, got {value!r}")


Name = Annotated[str | int, PlainValidator(_parse_column)]
Triple = Annotated[tuple[Name, Name, Name], Field(strict=False)]  # lists, too
Quadruple = Annotated[tuple[Name, Name, Name, Name], Field(strict=False)]


class ColumnChoice(Section):
    """Columns of a table without usual names: names of the header, or numbers counted from 1."""

    position: Triple | None = None
    axis: Triple | None = Field(default=None, description="of the tool, from its tip to its holder")
    normal: Triple | None = Field(default=None, description="of the surface, away from the part")
    quaternion_wxyz: Quadruple | None = None
    quaternion_xyzw: Quadruple | None = None
    rpy: Triple | None = None
    rotation_vector: Triple | None = Field(default=None, description="axis times angle")
    curve: Name | None = Field(default=None, description="where its entry changes a curve begins")
    feed: Name | None = Field(default=None, description="of the motion to each point")


class UnclearColumns(InvalidInput):
    """The header of a table does not identify its columns.

    Attributes:
        message: Without the suggestion.
        suggestion: Their likely meaning by the numbers, if there is one.
        or_none: Whether the columns that are unclear may be left out.
    """

    def __init__(
        self,
        message: str,
        suggestion: Suggestion | None = None,
        *,
        or_none: bool = False,
    ) -> None:
        example = "For example: [path.columns] position = [1, 2, 3], normal = [4, 5, 6]."
        columns = suggestion.text if suggestion else '"position=1,2,3;normal=4,5,6"'
        options = {"columns": columns, **({"orientation": "none"} if or_none else {})}
        super().__init__(f"{message} {suggestion or example}", options=options)
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
                f"the file has columns 1 to {table.width}, got {column}.", key=f"columns.{key}"
            )
        return column - 1
    found = columns_named(table.names, column)
    if len(found) == 1:
        return found[0]
    raise InvalidInput(
        f"there is no column {column!r}; "
        + (f"the header names {', '.join(map(repr, table.names))}." if table.names
           else "the file has no header line, so give numbers, counted from 1."),
        key=f"columns.{key}",
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
            + f" to [path] of the task file, or write it into the header: {first} [{example}].",
            options={key: None},
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
        angle_unit: Unit of angles where neither the file nor the user states one, if the numbers
            show that it is this one.
        note: How an orientation is read that only the letters of its columns identify.
    """

    position: tuple[int, ...]
    orientation: Orientation
    direction: tuple[int, ...]
    curve: int | None
    feed: int | None = None
    angle_unit: AngleUnit | None = None
    note: str = ""

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
    angles = found.get("angles", {})
    if 3 in angles:  # rx, ry, rz, rw are a quaternion; without rw what they are is open
        for place, columns in found.pop("angles").items():
            found.setdefault("quaternion", {}).setdefault((place + 1) % 4, []).extend(columns)
    numbered = found.pop("numbered quaternion", {})
    if numbered.keys() in ({0, 1, 2, 3}, {1, 2, 3, 4}):  # other numbers are those of joints
        first = min(numbered)
        found["numbered quaternion"] = {i - first: columns for i, columns in numbered.items()}
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
    position = _chosen(table, "position", choice.position)
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
    groups = {group: at for group, at in groups.items() if not {*at} & {*position}}
    curve = index_of(table, "curve", choice.curve) if choice.curve is not None else None
    if curve is None and "curve" in groups:
        [curve] = groups["curve"]
    convention, columns = _direction(table, direction, groups, orientation)
    where = ColumnRoles(position, convention.orientation, columns, curve, feed)
    if len(set(where.numbers)) < len(where.numbers):
        raise InvalidInput("a column is used twice.", key="columns")
    if orientation is None and convention.orientation == "none":
        _refuse_unused_orientation(table, where)
    return _with_convention(table, where, convention)


def _direction(
    table: Table,
    chosen: tuple[Orientation, tuple[int, ...]] | None,
    groups: dict[str, tuple[int, ...]],
    orientation: Orientation | None,
) -> tuple[Convention, tuple[int, ...]]:
    """The convention of the orientation, and its columns in the order of the reader."""
    if chosen is not None and orientation not in (None, chosen[0], "none"):
        raise InvalidInput(
            f"columns has {chosen[0]}, orientation is {orientation!r}; leave one of them out."
        )
    if orientation == "none":
        return _NOTHING, ()
    if chosen is not None:
        return _as_chosen(chosen[0]), chosen[1]
    return _usual_direction(table, groups, orientation)


def _with_convention(table: Table, where: ColumnRoles, convention: Convention) -> ColumnRoles:
    """The roles with what the convention of the orientation adds, if the numbers agree with it.

    Raises:
        UnclearColumns: If they contradict it.
    """
    called = ", ".join(table.call(i) for i in sorted(where.direction))
    if not where.direction or not (convention.unit or convention.called):
        return where
    values = _complete(table.sample(LOOKED_AT)[:, where.direction])
    unit = convention.unit
    if convention.orientation == "quaternion":
        if not have_length_1(values):
            raise UnclearColumns(
                f"{called} are named like {convention.called}, but their length is not 1; say what "
                'they are in [path.columns] of the task file, or orientation = "none" in [path].',
                or_none=True,
            )
    else:
        largest = float(np.abs(values).max(initial=0.0))
        states_unit = split_unit(table.names[where.direction[0]])[1] if table.names else None
        if convention.called and states_unit is None and have_length_1(values):
            raise UnclearColumns(
                f"{called} are named like {convention.called}; but in each row their length is 1, "
                "like that of a direction. Say what they are in [path.columns] of the task file: "
                'rpy, normal or axis; or orientation = "none" in [path].',
                or_none=True,
            )
        if convention.called and largest > 360.0:
            raise UnclearColumns(
                f"{called} are named like {convention.called}; but a number in them is "
                f"{largest:.6g}, more than 360 degrees. Say what they are in [path.columns] of the "
                'task file, or orientation = "none" in [path].',
                or_none=True,
            )
        # A vector above one turn is in degrees, and angles within one turn may be radians.
        agrees = largest <= 2.0 * np.pi if unit == "rad" else largest > 2.0 * np.pi
        unit = unit if agrees or largest == 0.0 else None
    note = f"{called} are read as {convention.called}." if convention.called else ""
    return replace(where, angle_unit=unit, note=note)


def _refuse_unused_orientation(table: Table, where: ColumnRoles) -> None:
    """Refuse to leave out columns that may state an orientation: the path would be without one.

    Raises:
        UnclearColumns: If unused columns are in a unit of angles, or neighbours have length 1.
    """
    named = usual(table.names)
    others = [i for group in ("feed", "curve") for at in named.get(group, {}).values() for i in at]
    left = {*range(table.width)} - {*where.numbers, *others}
    in_angles = [i for i, name in enumerate(table.names) if split_unit(name)[1] in _ANGLES]
    angles = tuple(i for i in in_angles if i in left)
    spans = [range(i, i + size) for size in (4, 3) for i in sorted(left)]
    sample = table.sample(LOOKED_AT)
    units = [at for at in spans if {*at} <= left and have_length_1(_complete(sample[:, at]))]
    if not angles and not units:
        return
    found, why, kind = angles, "are angles", "rpy"
    if not angles:
        found, why = tuple(units[0]), "have the length 1 in each row"
        kind = "normal" if len(found) == 3 else "quaternion_wxyz"
    suggestion = None
    if len(found) == _SIZES[kind.partition("_")[0]] and len(units) < 3:  # no rotation matrix
        columns = {"position": where.position, kind: found}
        numbers = {key: tuple(i + 1 for i in at) for key, at in columns.items()}
        suggestion = Suggestion(numbers, ())
    raise UnclearColumns(
        f"{', '.join(table.call(i) for i in found)} {why} and may state an orientation, which would"
        " be left out; say in [path.columns] of the task file what they are (a rotation matrix is "
        'not read), or orientation = "none" in [path] if they state none.',
        suggestion,
        or_none=True,
    )


def _complete(values: Array) -> Array:
    """The rows without missing numbers."""
    found: Array = values[np.isfinite(values).all(axis=1)]
    return found


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
        names = [split_unit(table.names[columns[0]]) for columns in places.values()]
        # One letter, or theta, is something else, and _refuse_unused_orientation asks where it is
        # in degrees or radians; rx alone is not.
        if group in ("A B C", "angles") and len(places) == 1 and len(names[0][0]) != 2:
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
        # Letters of an incomplete group are something else: i is an index, r a radius.
        if group in ("axis", "W P R") and all(len(name) == 1 for name, _ in names):
            continue
        if group == "position" and len(places) < 3:
            continue  # column_roles says so
        raise InvalidInput(
            f"{', '.join(table.call(i) for i in lonely)}: {len(lonely)} of "
            f"{_SIZES[group]} columns of one {group}; add the missing ones, or say in "
            '[path.columns] what counts, or orientation = "none" in [path] if they state none.',
            options={"orientation": "none"},
        )
    return groups


def _chosen(table: Table, key: str, columns: tuple[Column, ...] | None) -> tuple[int, ...] | None:
    if columns is None:
        return None
    return tuple(index_of(table, key, column) for column in columns)


def _as_chosen(orientation: Orientation) -> Convention:
    """The convention of columns that the user names."""
    return Convention(orientation, unit="rad" if orientation == "rotation_vector" else None)


def _chosen_direction(
    table: Table, choice: ColumnChoice
) -> tuple[Orientation, tuple[int, ...]] | None:
    found: list[tuple[Orientation, tuple[int, ...]]] = []
    kinds: tuple[tuple[str, Orientation], ...] = (
        ("axis", "axis"), ("normal", "normal"), ("quaternion_wxyz", "quaternion"),
        ("quaternion_xyzw", "quaternion"), ("rpy", "rpy"), ("rotation_vector", "rotation_vector"),
    )  # fmt: skip
    for key, orientation in kinds:
        indices = _chosen(table, key, getattr(choice, key))
        if indices is not None:
            if key == "quaternion_xyzw":
                indices = (indices[3], *indices[:3])
            found.append((orientation, indices))
    if len(found) > 1:
        raise InvalidInput(f"choose one orientation, not {len(found)}.", key="columns")
    return found[0] if found else None


def _usual_direction(
    table: Table, groups: dict[str, tuple[int, ...]], orientation: Orientation | None
) -> tuple[Convention, tuple[int, ...]]:
    """The convention of the orientation's columns, and their indices in its order."""
    present = {group: CONVENTIONS[group] for group in CONVENTIONS if group in groups}
    if orientation is None and not present and "angles" not in groups:
        return _NOTHING, ()
    if "angles" in groups and not present and orientation in ("rpy", "rotation_vector"):
        return _as_chosen(orientation), groups["angles"]
    if orientation is not None:
        present = {g: c for g, c in present.items() if c.orientation == orientation}
        if not present:
            raise InvalidInput(
                f"orientation is {orientation!r}, but the header has no such "
                f"columns: {', '.join(map(repr, table.names))}; say which they are in "
                "[path.columns] of the task file."
            )
    if not present:
        raise InvalidInput(
            f"{', '.join(table.call(i) for i in groups['angles'])}: these can be "
            'roll, pitch, yaw or a rotation vector; add orientation = "rpy" to [path] of the task '
            'file if R = Rz Ry Rx, orientation = "rotation_vector" if they are axis times angle '
            '(as of Universal Robots), or orientation = "none" to leave them out.',
            options={"orientation": None},
        )
    if len(present) > 1 or (orientation is None and "angles" in groups):
        kinds = list(dict.fromkeys(convention.orientation for convention in present.values()))
        called = " and ".join([*present, *(["angles"] if "angles" in groups else [])])
        if len(kinds) < len(present):
            answer = "say in [path.columns] of the task file which count"
            raise InvalidInput(f"the header has columns for {called}; {answer}.")
        raise InvalidInput(
            f'the header has columns for {called}; add orientation = "{kinds[0]}" or another to '
            "[path] of the task file.",
            options={"orientation": None},
        )
    [(group, convention)] = present.items()
    return convention, tuple(groups[group][i] for i in convention.order)


def _without_header(
    table: Table, choice: ColumnChoice, orientation: Orientation | None, feed: int | None
) -> ColumnRoles:
    """Roles in a table whose columns have no names and were not chosen."""
    curve = None if choice.curve is None else index_of(table, "curve", choice.curve)
    if table.width == 3 and orientation in (None, "none") and feed is None:
        return ColumnRoles((0, 1, 2), "none", (), curve)
    kinds = ("axis", "normal", "rpy", "rotation_vector")
    if table.width == 6 and orientation in kinds and feed is None:
        return ColumnRoles((0, 1, 2), orientation, (3, 4, 5), curve)
    raise UnclearColumns(
        f"{table.width} columns and no header line with x, y, z; say what they "
        "are in [path.columns] of the task file, counted from 1: position, and normal, axis, "
        "quaternion_wxyz, quaternion_xyzw, rpy or rotation_vector."
    )
