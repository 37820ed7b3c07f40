"""Meaning of a table's columns: by choice, else by their usual names, else by their numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from pydantic import Field, PlainValidator, model_validator

from qp_twist.checks import Array, did_you_mean
from qp_twist.errors import InvalidInput
from qp_twist.files import (
    ANGLES,
    FEEDS,
    AngleUnit,
    FeedUnit,
    LengthUnit,
    Table,
    columns_named,
    split_unit,
)
from qp_twist.paths.column_names import (
    BESIDE,
    COMPLETE,
    DIRECTIONS,
    NAMINGS,
    Naming,
    Orientation,
    usual,
)
from qp_twist.paths.section import Section
from qp_twist.paths.suggested_columns import (
    LOOKED_AT,
    Places,
    Suggestion,
    are_vectors,
    have_length_1,
    suggested,
)

Unit = TypeVar("Unit", bound=str)
_EXAMPLE = "position=1,2,3;normal=4,5,6"
_ANGLES = {*ANGLES, "grad"}
_NONE = Naming({}, "none")
_ASSUMED: dict[Orientation, str] = {
    "rpy": "roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll) (of a Staubli, with Rx Ry Rz, they "
    "are others; --orientation rotation_vector for axis times angle)",
    "rotation_vector": "a rotation vector, as of Universal Robots (--orientation rpy otherwise)",
}
"""How columns rx, ry, rz are called in notes if their numbers leave one reading."""


def _parse_column(value: object) -> str | int:
    """A column or a curve: a name, or a number from 1."""
    if (isinstance(value, str) and value) or (type(value) is int and value >= 1):
        return value
    raise ValueError(f"expected a name, or a number counted from 1, got {value!r}")


Name = Annotated[str | int, PlainValidator(_parse_column)]
Triple = Annotated[tuple[Name, Name, Name], Field(strict=False)]  # lists, too
Quadruple = Annotated[tuple[Name, Name, Name, Name], Field(strict=False)]
Nine = Annotated[tuple[Name, Name, Name, Name, Name, Name, Name, Name, Name], Field(strict=False)]


class ColumnChoice(Section):
    """Columns of a table without usual names: names of the header, or numbers counted from 1.

    Also as one text: ``"position=1,2,3;normal=4,5,6"``.
    """

    position: Triple | None = None
    axis: Triple | None = Field(default=None, description="of the tool, from its tip to its holder")
    normal: Triple | None = Field(default=None, description="of the surface, away from the part")
    quaternion_wxyz: Quadruple | None = None
    quaternion_xyzw: Quadruple | None = None
    rpy: Triple | None = None
    rotation_vector: Triple | None = Field(default=None, description="axis times angle")
    matrix: Nine | None = Field(default=None, description="rotation matrix, row by row")
    x_axis: Triple | None = Field(
        default=None, description="of the tool beside its axis or the normal, e.g. a tangent"
    )
    curve: Name | None = Field(default=None, description="where its entry changes a curve begins")
    feed: Name | None = Field(default=None, description="of the motion to each point")

    @model_validator(mode="before")
    @classmethod
    def _of_text(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        found: dict[str, object] = {}
        for part in value.split(";"):
            key, _, text = (side.strip() for side in part.partition("="))
            if key not in cls.model_fields:
                raise ValueError(
                    f"{key}: unknown key{did_you_mean(key, cls.model_fields)} Expected for example "
                    f'"{_EXAMPLE}", keys are {", ".join(cls.model_fields)}'
                )
            names = tuple(int(n) if n.strip().isdecimal() else n.strip() for n in text.split(","))
            found[key] = names[0] if key in ("curve", "feed") else names
        return found

    @property
    def stated(self) -> dict[str, tuple[str | int, ...]]:
        """The columns of each key that is given."""
        given = {key: value for key, value in self if value is not None}
        return {key: at if isinstance(at, tuple) else (at,) for key, at in given.items()}


class UnclearColumns(InvalidInput):
    """The columns of a table are open; ``suggestion`` is their likely meaning by the numbers."""

    def __init__(
        self, message: str, suggestion: Suggestion | None = None, *, or_none: bool = False
    ) -> None:
        example = "For example: [path.columns] position = [1, 2, 3], normal = [4, 5, 6]."
        columns = suggestion.text if suggestion else f'"{_EXAMPLE}"'
        options = {"columns": columns, **({"orientation": "none"} if or_none else {})}
        super().__init__(f"{message} {suggestion or example}", options=options)
        self.suggestion = suggestion


@dataclass(frozen=True)
class ColumnRoles:
    """Roles of the columns of a table.

    Attributes:
        position: Indices of x, y, z.
        orientation: Meaning of the direction columns.
        direction: Their indices; a quaternion's w first.
        x_axis: Indices of x of the tool beside its axis or the normal.
        y_axis: Those of y, likewise.
        single: Indices of columns by themselves: curve, feed, lead, tilt, type.
        angle_unit: Unit of angles by convention, where neither the file nor the user states one.
        length_unit: Unit of positions likewise.
        notes: How columns are read that only letters or numbers identify.
    """

    position: tuple[int, ...]
    orientation: Orientation = "none"
    direction: tuple[int, ...] = ()
    x_axis: tuple[int, ...] = ()
    y_axis: tuple[int, ...] = ()
    single: dict[str, int] = field(default_factory=dict)
    angle_unit: AngleUnit | None = None
    length_unit: LengthUnit | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Indices of the columns that must hold numbers."""
        single = [self.single[key] for key in ("lead", "tilt", "feed") if key in self.single]
        return (*self.position, *self.direction, *self.x_axis, *self.y_axis, *single)


def column_roles(
    table: Table,
    choice: ColumnChoice,
    orientation: Orientation | None,
    feed_unit: FeedUnit | None = None,
) -> ColumnRoles:
    """Roles of the columns: as chosen, else by usual names, else by the numbers.

    A feed column is used only if its unit is known: ``speed`` alone may be that of a spindle.

    Raises:
        InvalidInput: If the columns contradict each other.
        UnclearColumns: If the columns have to be chosen.
    """
    chosen = {
        key: tuple(_index_of(table, key, column) for column in columns)
        for key, columns in choice.stated.items()
    }
    directions = chosen.keys() & DIRECTIONS
    if len(directions) > 1:
        raise InvalidInput(f"choose one orientation, not {len(directions)}.", key="columns")
    settled = {*chosen} | (DIRECTIONS if directions or orientation == "none" else set())
    groups = _named_groups(table, settled, feed_unit) | chosen
    notes, length = list[str](), _length_by_words(table)
    if "position" not in groups and table.names:
        raise _without_position(table)
    if "position" not in groups:
        if not directions and orientation in DIRECTIONS and table.width == 6:
            groups[orientation] = (3, 4, 5)
        elif not directions and (table.width > 3 or orientation not in (None, "none")):
            found = _by_numbers(table, orientation)
            groups |= found.places
            notes, length = [found.note], found.length_unit
    position = groups.pop("position", (0, 1, 2))
    groups = {
        group: at for group, at in groups.items() if group in chosen or not {*at} & {*position}
    }
    naming, direction = _direction(table, groups, orientation)
    assert naming.means is not None
    beside = BESIDE.get(naming.means, set())
    groups = {group: at for group, at in groups.items() if group in beside or group not in COMPLETE}
    x_axis, y_axis = groups.get("x_axis", ()), groups.get("y_axis", ())
    single = {group: at[0] for group, at in groups.items() if NAMINGS[group].size == 1}
    where = ColumnRoles(
        position, naming.means, direction, x_axis, y_axis, single, length_unit=length, notes=notes
    )
    if len(set(where.numbers)) < len(where.numbers):
        raise InvalidInput("a column is used twice.", key="columns")
    if direction:
        return _checked(table, where, naming)
    if orientation is None:
        _refuse_unused_orientation(table, where)
    return where


def _index_of(table: Table, key: str, column: str | int) -> int:
    """Index of a column that was chosen by name, or by number from 1."""
    if isinstance(column, int):
        if 1 <= column <= table.width:
            return column - 1
        wrong = f"the file has columns 1 to {table.width}, got {column}."
    else:
        found = columns_named(table.names, column)
        if len(found) == 1:
            return found[0]
        known = "the file has no header line, so give numbers, counted from 1."
        if table.names:
            known = f"the header names {', '.join(map(repr, table.names))}."
        wrong = f"there is no column {column!r}; {known}"
    raise InvalidInput(wrong, key=f"columns.{key}")


def _length_by_words(table: Table) -> LengthUnit | None:
    """The metre, if the words of the header are those of ROS or of a Universal Robot's recorder."""
    words = {*re.findall("[a-z]+", " ".join(table.names).lower())}
    makers = ({"position", "orientation"}, {"transform", "translation"}, {"actual", "tcp", "pose"})
    return "m" if any(maker <= words for maker in makers) else None


def _by_numbers(table: Table, orientation: Orientation | None) -> Suggestion:
    """The columns of a table without a header, if its numbers leave nothing open."""
    found = suggested(table.numbers[:LOOKED_AT])
    first = getattr(table, "first_row", "")
    if found is None or not found.settled or re.search(r"[(\[{=]", first):
        raise _without_position(table)
    [kind] = found.places.keys() - {"position"} or {"none"}
    other = {"normal": "axis", "axis": "normal"}.get(kind, "")
    if orientation == other:
        found = replace(found, places={**found.places, other: found.places[kind]})
        del found.places[kind]
    elif orientation not in (None, "none", NAMINGS[kind].means if kind in NAMINGS else None):
        raise _without_position(table)
    return found


def _without_position(table: Table) -> InvalidInput:
    """The error for a table whose position is open, or that has joint positions."""
    joints = [i for i, n in enumerate(table.names) if split_unit(n)[1] in _ANGLES or "joint" in n]
    if len(joints) >= 3:
        return InvalidInput(
            f"{called(table, joints[:3])} … look like joint positions, and there are no columns x,"
            " y, z: a joint trajectory is no toolpath. qp-twist check TRAJECTORY TASK checks it."
        )
    what = (
        f"no columns x, y, z among {', '.join(map(repr, table.names))}; say which they are in "
        "[path.columns] of the task file."
        if table.names
        else f"{table.width} columns and no header line with x, y, z; say what they are in "
        "[path.columns] of the task file, counted from 1: position, and normal, axis, "
        "quaternion_wxyz, quaternion_xyzw, rpy or rotation_vector."
    )
    return UnclearColumns(what, suggested(table.numbers[:LOOKED_AT]))


def _named_groups(table: Table, settled: set[str], feed_unit: FeedUnit | None) -> Places:
    """The complete groups among the usual names of a header, except those already settled."""
    groups: Places = {}
    for group, places in usual(table.names).items():
        size = NAMINGS[group].size
        if group in settled:
            continue
        if group == "feed":
            # The same names are used for other quantities; the unit decides.
            known = [i for i in places[0] if split_unit(table.names[i])[1] in FEEDS]
            places[0] = known or (places[0] if feed_unit is not None else [])
        if not all(places.values()) or (len(places) < size and _is_other(table, group, places)):
            continue
        actual = {at: _measured(table, columns) for at, columns in places.items()}
        if twice := [columns for columns in actual.values() if len(columns) > 1]:
            raise InvalidInput(
                f"{' and '.join(table.call(i) for i in twice[0])} mean the same; "
                "say in [path.columns] of the task file which one counts."
            )
        if len(places) < size:
            lonely = called(table, [columns[0] for columns in places.values()])
            raise InvalidInput(
                f"{lonely}: {len(places)} of {size} columns of one {group}; add the missing ones, "
                'or say in [path.columns] what counts, or orientation = "none" in [path] if they '
                "state none.",
                options={"orientation": "none"},
            )
        groups[group] = tuple(actual[i][0] for i in range(size))
    return groups


def _measured(table: Table, columns: list[int]) -> list[int]:
    """Of columns with the same meaning those of the actual motion, where a controller recorded it.

    Beside them it records the target, from which the motion differs by the error of control.
    """
    actual = [i for i in columns if re.search("actual|rist", table.names[i].lower())]
    target = [i for i in columns if re.search("target|rsol", table.names[i].lower())]
    return actual if actual and len(actual) + len(target) == len(columns) else columns


def _is_other(table: Table, group: str, places: dict[int, list[int]]) -> bool:
    """Whether the names of an incomplete group are those of other quantities.

    Letters such as i and r are an index and a radius; one letter, or theta, is asked for where it
    is in degrees or radians, but rx alone is an angle.
    """
    names = [split_unit(table.names[columns[0]])[0] for columns in places.values()]
    if group in ("axis", "W P R"):
        return all(len(name) == 1 for name in names)
    if group in ("A B C", "angles"):
        return len(names) == 1 and len(names[0]) != 2
    return group in ("position", "x_axis", "y_axis")


def _direction(
    table: Table, groups: Places, orientation: Orientation | None
) -> tuple[Naming, tuple[int, ...]]:
    """The convention of the orientation, and its columns."""
    angles = groups.get("angles")
    present = {group: of for group, of in NAMINGS.items() if group in groups and of.means}
    if orientation == "none" or (orientation is None and not present and angles is None):
        return _NONE, ()
    if angles is not None and not present:
        stated = orientation or _evident(table, angles)
        if stated in ("rpy", "rotation_vector"):
            naming = NAMINGS[stated]
            return naming if orientation else replace(naming, called=_ASSUMED[stated]), angles
    if orientation is not None:
        known = dict.fromkeys(str(of.means) for of in present.values())
        present = {group: of for group, of in present.items() if of.means == orientation}
        if not present:
            raise InvalidInput(
                f"orientation is {orientation!r}, and there are no such columns"
                f"{', but ' + ', '.join(known) if known else ''}; say which they are in "
                "[path.columns] of the task file, or leave orientation out."
            )
    elif angles is not None and not present:
        raise InvalidInput(
            f"{called(table, angles)}: these can be roll, pitch, yaw or a rotation vector; add "
            'orientation = "rpy" to [path] of the task file if R = Rz Ry Rx, orientation = '
            '"rotation_vector" if they are axis times angle (as of Universal Robots), or '
            'orientation = "none" to leave them out.',
            options={"orientation": None},
        )
    if len(present) > 1 or (orientation is None and angles is not None):
        kinds = list(dict.fromkeys(of.means for of in present.values()))
        names = " and ".join([*present, *(["angles"] if angles is not None else [])])
        alike = len(kinds) < len(present)
        raise InvalidInput(
            f"the header has columns for {names}; "
            + ("say in [path.columns] of the task file which count." if alike else
               f'add orientation = "{kinds[0]}" or another to [path] of the task file.'),
            options={} if alike else {"orientation": None},
        )  # fmt: skip
    [(group, naming)] = present.items()
    columns = groups[group]
    return naming, (columns[3], *columns[:3]) if group == "quaternion_xyzw" else columns


def _evident(table: Table, angles: tuple[int, ...]) -> Orientation | None:
    """What columns rx, ry, rz are by their numbers; ``None`` if they may be either.

    Nobody writes rotation vectors in degrees, and in radians those longer than half a turn are
    angles.
    """
    names = [split_unit(table.names[i]) for i in angles]
    if not all(re.search(r"r(ot(ation)?)?[\W_]*[xyz]$", name.lower()) for name, _ in names):
        return None
    values, unit = _complete(table, angles), names[0][1]
    lengths = np.linalg.norm(values, axis=1)
    if unit == "deg" or not lengths.any() or (unit is None and np.abs(values).max() > 2.0 * np.pi):
        return "rpy"
    if unit is None and lengths.max() > 1.001 * np.pi:
        return "rpy"
    return "rotation_vector" if are_vectors(values) else None


def _checked(table: Table, where: ColumnRoles, naming: Naming) -> ColumnRoles:
    """The roles with the unit and the note of a convention, if the numbers agree with it."""
    where = replace(where, length_unit=where.length_unit or naming.length, angle_unit=naming.unit)
    if not naming.called:
        return where
    names, wrong = called(table, sorted(where.direction)), ""
    values = _complete(table, where.direction)
    largest = float(np.abs(values).max(initial=0.0))
    if naming.means == "quaternion":
        if not have_length_1(values):
            wrong = "their length is not 1; say what they are in [path.columns] of the task file,"
    elif split_unit(table.names[where.direction[0]])[1] is None and have_length_1(values):
        wrong = (
            "in each row their length is 1, like that of a direction. Say what they are in "
            "[path.columns] of the task file: rpy, normal or axis;"
        )
    elif largest > 360.0:
        wrong = (
            f"a number in them is {largest:.6g}, more than 360 degrees. Say what they are in "
            "[path.columns] of the task file,"
        )
    if wrong:
        raise UnclearColumns(
            f'{names} are named like {naming.called}; but {wrong} or orientation = "none" in '
            "[path].",
            or_none=True,
        )
    return replace(where, notes=[*where.notes, f"{names} are read as {naming.called}."])


def _refuse_unused_orientation(table: Table, where: ColumnRoles) -> None:
    """Refuse to leave out columns in a unit of angles, or neighbours of length 1.

    They may state an orientation, and the path would be without one.
    """
    named = usual(table.names)
    used = {i for group in ("curve", "feed") for at in named.get(group, {}).values() for i in at}
    left = {*range(table.width)} - {*where.numbers} - used
    angles = [i for i, n in enumerate(table.names) if i in left and split_unit(n)[1] in _ANGLES]
    spans = [range(i, i + size) for size in (4, 3) for i in sorted(left)]
    units = [at for at in spans if {*at} <= left and have_length_1(_complete(table, at))]
    if not (angles or units):
        return
    found = angles or [*units[0]]
    why = "are angles" if angles else "have the length 1 in each row"
    kind = "rpy" if angles else "normal" if len(found) == 3 else "quaternion_wxyz"
    suggestion = None
    beside = [i for key in COMPLETE for at in named.get(key, {}).values() for i in at]
    if {*found} & {*beside}:
        raise InvalidInput(
            f"{called(table, found)}: an axis beside that of the tool or a normal, which no column "
            'states; add it, or orientation = "none" to [path] to leave these columns out.',
            options={"orientation": "none"},
        )
    if len(found) == NAMINGS[kind].size and len(units) < 3:  # no rotation matrix
        suggestion = Suggestion({"position": where.position, kind: tuple(found)}, ())
    raise UnclearColumns(
        f"{called(table, found)} {why} and may state an orientation, which would be left out; say "
        "in [path.columns] of the task file what they are, or "
        'orientation = "none" in [path] if they state none.',
        suggestion,
        or_none=True,
    )


def unit_of(
    table: Table, key: str, columns: Sequence[int], chosen: Unit | None, known: Collection[Unit]
) -> tuple[Unit, bool]:
    """The unit of some columns, and whether it is from the header.

    Raises:
        InvalidInput: If there is none, header and ``chosen`` differ, or it is not known.
    """
    found = {split_unit(table.names[i])[1] for i in columns} if table.names else {None}
    names = called(table, columns)
    if len(found) > 1:
        raise InvalidInput(f"{names} have different units in the header; write one unit for all.")
    [unit] = found
    if unit is None:
        if chosen is not None:
            return chosen, False
        first, example = table.names[columns[0]] if table.names else "x", next(iter(known))
        raise InvalidInput(
            f"the unit of {names} is not said; add {key} = "
            + " or ".join(f'"{u}"' for u in known)
            + f" to [path] of the task file, or write it into the header: {first} [{example}].",
            options={key: None},
        )
    if unit not in known:
        raise InvalidInput(f"{names}: the header says {unit!r}; known are {', '.join(known)}.")
    if chosen not in (None, unit):
        raise InvalidInput(
            f"{names}: the header says {unit}, {key} of the task file says {chosen}; correct one "
            "of them."
        )
    return cast(Unit, unit), True


def called(table: Table, columns: Sequence[int]) -> str:
    """Names of columns in messages."""
    return ", ".join(table.call(i) for i in columns)


def _complete(table: Table, columns: Sequence[int]) -> Array:
    """The first rows of some columns, without those that lack numbers."""
    values: Array = table.numbers[:LOOKED_AT, list(columns)]
    return values[np.isfinite(values).all(axis=1)]
