"""Meaning and unit of a table's columns: by choice, else by their usual names."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar, cast

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
from qp_twist.paths.section import Section
from qp_twist.paths.suggested_columns import (
    LOOKED_AT,
    Suggestion,
    are_vectors,
    have_length_1,
    suggested,
)

Orientation = Literal["axis", "normal", "quaternion", "rpy", "rotation_vector", "matrix", "none"]
Unit = TypeVar("Unit", bound=str)
Places = dict[str, tuple[int, ...]]
"""Indices of the columns of each group, in the order of the reader."""

_EXAMPLE = "position=1,2,3;normal=4,5,6"
_NOT_POSES = "curve", "feed"
_ANGLES = {*ANGLES, "grad"}
_WITHIN = {
    *("pose", "tcp", "point", "waypoint", "tool", "field", "target", "actual", "current"),
    *("desired", "msg", "transform", "ee", "robot", "rist", "rsol"),
}
"""Words beside a column's name that say where it is from: ``field.pose.position.x``, ``X_RIst``."""
_OF_OTHERS = re.compile(r"err|vel|acc|cov|std|noise|twist|joint|delta|diff|force|torque")
"""Parts of such words with which it is another quantity."""
_IN_FILE_NAME = re.compile(r"xyz_?(wpr|abc|rpy|ijk|s)(?![a-z])", re.IGNORECASE)
"""Columns that the name of a file states, as RoboDK's examples do: ``Import-CSV-XYZWPR.csv``."""


@dataclass(frozen=True)
class Naming:
    """How tables name the columns of one group.

    Attributes:
        names: Place in the group, in the order of the reader, by the letters and digits of a name.
        means: What the columns are read as; ``None`` where the names leave it open.
        size: Number of columns.
        unit: Unit of its angles where the file states none and the numbers agree.
        length: Unit of the positions beside it where the file states none: that of its maker.
        called: The convention in notes, if only the letters of the names identify it.
    """

    names: Mapping[str, int]
    means: Orientation | None = None
    size: int = 3
    unit: AngleUnit | None = None
    length: LengthUnit | None = None
    called: str = ""


def _names(letters: Sequence[str], patterns: str = "{}") -> dict[str, int]:
    """The places of some letters in each pattern."""
    return {p.format(c): place for p in patterns.split() for place, c in enumerate(letters)}


_POSITIONS = (
    "{} p{} t{} pos{} {}pos position{} {}position coord{} {}coord coordinate{} {}coordinate "
    "translation{} location{}"
)
_QUATERNIONS = "q{} quat{} quaternion{} orientation{} ori{} orient{}"
NAMINGS = {
    "position": Naming(_names("xyz", _POSITIONS) | _names("012", "tcppose{}")),
    "axis": Naming(_names("ijk") | _names("xyz", "a{} axis{} {}axis toolaxis{}"), "axis"),
    "normal": Naming(_names("xyz", "n{} norm{} {}norm normal{} normals{} {}normal"), "normal"),
    "quaternion": Naming(_names("wxyz", _QUATERNIONS), "quaternion", 4),
    "numbered quaternion": Naming(
        _names("0123456789", _QUATERNIONS), "quaternion", 4, length="mm",
        called="a quaternion w, x, y, z, as ABB writes it",
    ),
    "rpy": Naming(_names(("roll", "pitch", "yaw")), "rpy"),
    "W P R": Naming(
        _names("wpr"), "rpy", unit="deg", length="mm",
        called="FANUC's W, P, R: R = Rz(R) Ry(P) Rx(W)"
    ),
    "A B C": Naming(
        _names("cba"), "rpy", unit="deg", length="mm",
        called="KUKA's A, B, C: R = Rz(A) Ry(B) Rx(C) (of a robot with A about x choose rpy = "
        "A, B, C in [path.columns])",
    ),
    "rotation vector": Naming(
        _names("xyz", "rotvec{} rotationvector{} rvec{} rv{} axisangle{}")
        | _names("345", "tcppose{}"),  # of the recorder of Universal Robots
        "rotation_vector", unit="rad",
    ),
    "matrix": Naming(
        _names([f"{i}{j}" for i in "123" for j in "123"], "r{} m{} rot{}"), "matrix", 9
    ),
    "angles": Naming(
        _names("xyzw", "r{} rot{} rotation{}") | _names(("alpha", "beta", "gamma"))
        | _names(("phi", "theta", "psi"))
    ),
    "curve": Naming(
        dict.fromkeys(("curve", "curveid", "curvename", "pass", "contour", "stroke"), 0), size=1
    ),
    "feed": Naming(
        dict.fromkeys(
            ("feed", "feedrate", "f", "speed", "velocity", "pathspeed", "tcpspeed"), 0
        ), size=1,
    ),
}  # fmt: skip
"""Usual names of columns. Those of another program are another row."""
_GROUPS = {name: (group, at) for group, of in NAMINGS.items() for name, at in of.names.items()}
_NONE = Naming({}, "none")


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
            found[key] = names[0] if key in _NOT_POSES else names
        return found

    def indices(self, table: Table) -> Places:
        """The columns of a table that each key chooses.

        Raises:
            InvalidInput: If there is no such column.
        """
        return {
            key: tuple(
                index_of(table, key, column)
                for column in (stated if isinstance(stated, tuple) else (stated,))
            )
            for key, stated in self
            if stated is not None
        }


class UnclearColumns(InvalidInput):
    """The header of a table does not identify its columns.

    Attributes:
        suggestion: Their likely meaning by the numbers, if there is one.
    """

    def __init__(
        self, message: str, suggestion: Suggestion | None = None, *, or_none: bool = False
    ) -> None:
        example = "For example: [path.columns] position = [1, 2, 3], normal = [4, 5, 6]."
        columns = suggestion.text if suggestion else f'"{_EXAMPLE}"'
        options = {"columns": columns, **({"orientation": "none"} if or_none else {})}
        super().__init__(f"{message} {suggestion or example}", options=options)
        self.suggestion = suggestion


def index_of(table: Table, key: str, column: str | int) -> int:
    """Index of a column that was chosen by name, or by number from 1.

    Raises:
        InvalidInput: If there is no such column, or more than one.
    """
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


def unit_of(
    table: Table, key: str, columns: Sequence[int], chosen: Unit | None, known: Collection[Unit]
) -> tuple[Unit, bool]:
    """The unit of some columns, and whether it is from the header.

    Raises:
        InvalidInput: If there is none, header and ``chosen`` differ, or it is not known.
    """
    found = {split_unit(table.names[i])[1] for i in columns} if table.names else {None}
    called = _called(table, columns)
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
        angle_unit: Unit of angles by convention, where neither the file nor the user states one.
        length_unit: Unit of positions likewise.
        notes: How an orientation is read that only the letters of its columns identify.
    """

    position: tuple[int, ...]
    orientation: Orientation = "none"
    direction: tuple[int, ...] = ()
    curve: int | None = None
    feed: int | None = None
    angle_unit: AngleUnit | None = None
    length_unit: LengthUnit | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Indices of the columns that must hold numbers: position, direction, feed."""
        return self.position + self.direction + (() if self.feed is None else (self.feed,))


def usual(names: Sequence[str]) -> dict[str, dict[int, list[int]]]:
    """Groups of columns with usual names: for each place in a group, the columns."""
    found: dict[str, dict[int, list[int]]] = {}
    for index, name in enumerate(names):
        if meant := _meant(split_unit(name)[0].lower()):
            found.setdefault(meant[0], {}).setdefault(meant[1], []).append(index)
    if 3 in found.get("angles", {}):  # rx, ry, rz, rw are a quaternion
        for place, columns in found.pop("angles").items():
            found.setdefault("quaternion", {}).setdefault((place + 1) % 4, []).extend(columns)
    numbered = found.pop("numbered quaternion", {})
    if numbered.keys() in ({0, 1, 2, 3}, {1, 2, 3, 4}):  # other numbers are those of joints
        first = min(numbered)
        found["numbered quaternion"] = {i - first: columns for i, columns in numbered.items()}
    return found


@lru_cache(maxsize=1000)
def _meant(name: str) -> tuple[str, int] | None:
    """The group and place of a name, or of its end behind words that say where it is from.

    An end of one word (``field.x``) counts only behind words that are known, one of two
    (``/robot.position.x``) also behind others.
    """
    words = re.findall(r"[a-z0-9]+", name)
    while len(words) > 1 and words[-1] in _WITHIN:
        words = words[:-1]
    for k in range(len(words)):
        letters = "".join(words[k:])
        bare = re.sub(r"^(?:pose|tcp|point|waypoint|tool)", "", letters)
        known = {*words[:k]} <= _WITHIN
        if k and not known and (len(words) - k < 2 or any(map(_OF_OTHERS.search, words[:k]))):
            return None
        if meant := _GROUPS.get(letters) or _GROUPS.get(bare):
            return meant
    return None


def names_in(stem: str, width: int) -> tuple[str, ...]:
    """Names of the columns that the name of a file states; empty if it states none."""
    found = _IN_FILE_NAME.search(stem)
    letters = f"xyz{found[1].lower()}" if found and width >= 3 + len(found[1]) else ""
    speed = {"s": "speed [mm/s]"}  # as RoboDK documents it; its lengths are mm
    names = [speed.get(letter, letter) for letter in letters]
    return tuple(names + [f"#{k}" for k in range(len(names) + 1, width + 1)]) if names else ()


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
    chosen = choice.indices(table)
    directions = [key for key in chosen if key not in ("position", *_NOT_POSES)]
    if len(directions) > 1:
        raise InvalidInput(f"choose one orientation, not {len(directions)}.", key="columns")
    settled = {"position", *_NOT_POSES} & chosen.keys()
    if directions or orientation == "none":
        settled |= NAMINGS.keys() - {"position", *_NOT_POSES}
    groups = _usual_groups(table, settled, feed_unit)
    position, notes = chosen.get("position") or groups.get("position"), list[str]()
    if position is None:
        if table.names:
            raise _without_position(table)
        position = (0, 1, 2)
        if not directions and orientation is not None and table.width == 6:
            directions, chosen[orientation] = [orientation], (3, 4, 5)
        elif not directions and (table.width > 3 or orientation not in (None, "none")):
            found, notes = _assumed(table, orientation)
            position = found.pop("position")
            chosen |= found
            directions = [*found]
    groups = {group: at for group, at in groups.items() if not {*at} & {*position}}
    naming, direction = _NONE, tuple[int, ...]()
    if orientation != "none" and directions:
        naming, direction = _chosen_direction(directions[0], chosen, orientation)
    elif orientation != "none":
        naming, direction = _usual_direction(table, groups, orientation)
    [curve] = chosen.get("curve") or groups.get("curve") or [None]
    [feed] = chosen.get("feed") or groups.get("feed") or [None]
    assert naming.means is not None
    words = {*re.findall("[a-z]+", " ".join(table.names).lower())}
    in_ros = {"position", "orientation"} <= words or {"transform", "translation"} <= words
    in_ros |= {"actual", "tcp", "pose"} <= words
    by_rule: LengthUnit | None = "m" if in_ros or any("TUM" in note for note in notes) else None
    where = ColumnRoles(
        position, naming.means, direction, curve, feed, length_unit=by_rule, notes=notes
    )
    if len(set(where.numbers)) < len(where.numbers):
        raise InvalidInput("a column is used twice.", key="columns")
    if direction:
        return _checked(table, where, naming)
    if orientation is None:
        _refuse_unused_orientation(table, where)
    return where


def _assumed(table: Table, orientation: Orientation | None) -> tuple[Places, list[str]]:
    """The columns of a table without a header, if its numbers leave nothing open, and a note.

    Raises:
        UnclearColumns: If they do.
    """
    found = suggested(table.sample(LOOKED_AT))
    if found is None or not found.settled or re.search(r"[(\[{=]", table.first_row):
        raise _without_position(table)
    places = {key: tuple(i - 1 for i in columns) for key, columns in found.columns.items()}
    [*kinds] = places.keys() - {"position"}
    kind = kinds[0] if kinds else "none"
    other = {"normal": "axis", "axis": "normal"}.get(kind, "none")
    if orientation == other != "none":
        places[other] = places.pop(kind)
    elif orientation not in (None, "none", kind.partition("_wxyz")[0].partition("_xyzw")[0]):
        raise _without_position(table)
    called = " and ".join(
        f"columns {', '.join(str(i + 1) for i in at)} as {key.replace('_', ' ')}"
        for key, at in places.items()
    )
    why = f" since {', '.join(found.reasons)}" if found.reasons else ""
    also = f", --orientation {other}" if other != "none" else ""
    return places, [f"no header: {called} are read{why}; --columns{also} reads it otherwise."]


def _without_position(table: Table) -> InvalidInput:
    """The error for a table whose position is open, or that has joint positions."""
    joints = [i for i, n in enumerate(table.names) if split_unit(n)[1] in _ANGLES or "joint" in n]
    if len(joints) >= 3:
        return InvalidInput(
            f"{_called(table, joints[:3])} … look like joint positions, and there are no columns x,"
            " y, z: a joint trajectory is no toolpath. qp-twist check TRAJECTORY TASK checks it."
        )
    if table.names:
        return UnclearColumns(
            f"no columns x, y, z among {', '.join(map(repr, table.names))}; say which they are in "
            "[path.columns] of the task file.",
            suggested(table.sample(LOOKED_AT)),
        )
    return UnclearColumns(
        f"{table.width} columns and no header line with x, y, z; say what they are in "
        "[path.columns] of the task file, counted from 1: position, and normal, axis, "
        "quaternion_wxyz, quaternion_xyzw, rpy or rotation_vector.",
        suggested(table.sample(LOOKED_AT)),
    )


def _usual_groups(table: Table, settled: set[str], feed_unit: FeedUnit | None) -> Places:
    """The complete groups among the usual names of a header, except those already settled."""
    groups: Places = {}
    for group, places in usual(table.names).items():
        size, bare = NAMINGS[group].size, _bare(table, places)
        if group in settled:
            continue
        if group == "feed":
            # The same names are used for other quantities; the unit decides.
            known = [i for i in places[0] if split_unit(table.names[i])[1] in FEEDS]
            places[0] = known or (places[0] if feed_unit is not None else [])
            if not places[0]:
                continue
        if len(places) < size and _is_something_else(group, bare):
            continue
        actual = {at: _measured(table, columns) for at, columns in places.items()}
        if twice := [columns for columns in actual.values() if len(columns) > 1]:
            raise InvalidInput(
                f"{' and '.join(table.call(i) for i in twice[0])} mean the same; "
                "say in [path.columns] of the task file which one counts."
            )
        if len(places) < size:
            lonely = _called(table, [columns[0] for columns in places.values()])
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
    plain = [i for i in columns if not re.fullmatch(r"t[\W_]*[xyz]", table.names[i].lower())]
    if plain:  # tx, ty, tz beside x, y, z are a tangent
        columns = plain
    actual = [i for i in columns if re.search("actual|rist", table.names[i].lower())]
    target = [i for i in columns if re.search("target|rsol", table.names[i].lower())]
    return actual if actual and len(actual) + len(target) == len(columns) else columns


def _bare(table: Table, places: dict[int, list[int]]) -> list[str]:
    return [split_unit(table.names[columns[0]])[0] for columns in places.values()]


def _is_something_else(group: str, names: Sequence[str]) -> bool:
    """Whether the names of an incomplete group are those of other quantities.

    Letters such as i and r are an index and a radius; one letter, or theta, is asked for where it
    is in degrees or radians, but rx alone is an angle.
    """
    if group in ("axis", "W P R"):
        return all(len(name) == 1 for name in names)
    if group in ("A B C", "angles"):
        return len(names) == 1 and len(names[0]) != 2
    return group == "position"


def _chosen_direction(
    key: str, chosen: Places, orientation: Orientation | None
) -> tuple[Naming, tuple[int, ...]]:
    """The convention of the orientation that the user names, and its columns."""
    columns, means = chosen[key], cast(Orientation, key.partition("_wxyz")[0].partition("_xyzw")[0])
    if orientation not in (None, means):
        raise InvalidInput(
            f"columns has {means}, orientation is {orientation!r}; leave one of them out."
        )
    if key == "quaternion_xyzw":
        columns = (columns[3], *columns[:3])
    return _as_stated(means), columns


def _as_stated(means: Orientation) -> Naming:
    return Naming({}, means, unit="rad" if means == "rotation_vector" else None)


def _usual_direction(
    table: Table, groups: Places, orientation: Orientation | None
) -> tuple[Naming, tuple[int, ...]]:
    """The convention of the orientation that the header names, and its columns."""
    angles = groups.get("angles")
    present = {group: of for group, of in NAMINGS.items() if group in groups and of.means}
    if orientation is None and not present and angles is None:
        return _NONE, ()
    stated = orientation or (None if angles is None else _evident(table, angles))
    if angles is not None and not present and stated in ("rpy", "rotation_vector"):
        naming = _as_stated(stated)
        return naming if orientation else replace(naming, called=_ASSUMED[stated]), angles
    if orientation is not None:
        present = {group: of for group, of in present.items() if of.means == orientation}
        if not present:
            raise InvalidInput(
                f"orientation is {orientation!r}, but the header has no such columns: "
                f"{', '.join(map(repr, table.names))}; say which they are in [path.columns] of the "
                "task file."
            )
    if angles is not None and not present:
        raise InvalidInput(
            f"{_called(table, angles)}: these can be roll, pitch, yaw or a rotation vector; add "
            'orientation = "rpy" to [path] of the task file if R = Rz Ry Rx, orientation = '
            '"rotation_vector" if they are axis times angle (as of Universal Robots), or '
            'orientation = "none" to leave them out.',
            options={"orientation": None},
        )
    if len(present) > 1 or (orientation is None and angles is not None):
        kinds = list(dict.fromkeys(of.means for of in present.values()))
        called = " and ".join([*present, *(["angles"] if angles is not None else [])])
        alike = len(kinds) < len(present)
        raise InvalidInput(
            f"the header has columns for {called}; "
            + ("say in [path.columns] of the task file which count." if alike else
               f'add orientation = "{kinds[0]}" or another to [path] of the task file.'),
            options={} if alike else {"orientation": None},
        )  # fmt: skip
    [(group, naming)] = present.items()
    return naming, groups[group]


_ASSUMED: dict[Orientation, str] = {
    "rpy": "roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll) (of a Staubli, with Rx Ry Rz, they "
    "are others; --orientation rotation_vector for axis times angle)",
    "rotation_vector": "a rotation vector, as of Universal Robots (--orientation rpy otherwise)",
}
"""How columns rx, ry, rz are called in notes if their numbers leave one reading."""


def _evident(table: Table, angles: tuple[int, ...]) -> Orientation | None:
    """What columns rx, ry, rz are by their numbers; ``None`` if they may be either.

    Nobody writes rotation vectors in degrees, and in radians those longer than half a turn are
    angles.
    """
    if not all(re.search(r"r(ot(ation)?)?[\W_]*[xyz]$", name) for name in _bare_of(table, angles)):
        return None
    values = _complete(table.sample(LOOKED_AT)[:, angles])
    lengths = np.linalg.norm(values, axis=1)
    unit = split_unit(table.names[angles[0]])[1]
    if unit == "deg" or not lengths.any() or (unit is None and np.abs(values).max() > 2.0 * np.pi):
        return "rpy"
    if unit is None and lengths.max() > 1.001 * np.pi:
        return "rpy"
    return "rotation_vector" if are_vectors(values) else None


def _bare_of(table: Table, columns: Sequence[int]) -> list[str]:
    return [split_unit(table.names[i])[0].lower() for i in columns]


def _checked(table: Table, where: ColumnRoles, naming: Naming) -> ColumnRoles:
    """The roles with the unit and the note of a convention, if the numbers agree with it.

    Raises:
        UnclearColumns: If they contradict it.
    """
    if not (naming.unit or naming.called):
        return where
    where = replace(where, length_unit=where.length_unit or naming.length, angle_unit=naming.unit)
    called, wrong = _called(table, sorted(where.direction)), ""
    values = _complete(table.sample(LOOKED_AT)[:, where.direction])
    largest = float(np.abs(values).max(initial=0.0))
    if naming.means == "quaternion":
        if not have_length_1(values):
            wrong = "their length is not 1; say what they are in [path.columns] of the task file,"
    else:
        unitless = not table.names or split_unit(table.names[where.direction[0]])[1] is None
        if unitless and have_length_1(values):
            wrong = (
                "in each row their length is 1, like that of a direction. Say what they are in "
                "[path.columns] of the task file: rpy, normal or axis;"
            )
        elif largest > 360.0:
            wrong = (
                f"a number in them is {largest:.6g}, more than 360 degrees. Say what they are in "
                "[path.columns] of the task file,"
            )
    if wrong and naming.called:
        raise UnclearColumns(
            f'{called} are named like {naming.called}; but {wrong} or orientation = "none" in '
            "[path].",
            or_none=True,
        )
    notes = [f"{called} are read as {naming.called}."] if naming.called else []
    return replace(where, notes=[*where.notes, *notes])


def _refuse_unused_orientation(table: Table, where: ColumnRoles) -> None:
    """Refuse to leave out columns that may state an orientation: the path would be without one.

    Raises:
        UnclearColumns: If unused columns are in a unit of angles, or neighbours have length 1.
    """
    named = usual(table.names)
    used = {i for group in _NOT_POSES for at in named.get(group, {}).values() for i in at}
    left = {*range(table.width)} - {*where.numbers} - used
    angles = [i for i, n in enumerate(table.names) if i in left and split_unit(n)[1] in _ANGLES]
    sample = table.sample(LOOKED_AT)
    spans = [range(i, i + size) for size in (4, 3) for i in sorted(left)]
    units = [at for at in spans if {*at} <= left and have_length_1(_complete(sample[:, at]))]
    if angles:
        found, why, kind, size = angles, "are angles", "rpy", 3
    elif units:
        found, why, size = [*units[0]], "have the length 1 in each row", len(units[0])
        kind = "normal" if size == 3 else "quaternion_wxyz"
    else:
        return
    suggestion = None
    if len(found) == size and len(units) < 3:  # no rotation matrix
        columns = {"position": where.position, kind: found}
        numbers = {key: tuple(i + 1 for i in at) for key, at in columns.items()}
        suggestion = Suggestion(numbers, ())
    raise UnclearColumns(
        f"{_called(table, found)} {why} and may state an orientation, which would be left out; say "
        "in [path.columns] of the task file what they are (a rotation matrix is not read), or "
        'orientation = "none" in [path] if they state none.',
        suggestion,
        or_none=True,
    )


def _complete(values: Array) -> Array:
    """The rows without missing numbers."""
    found: Array = values[np.isfinite(values).all(axis=1)]
    return found


def _called(table: Table, columns: Sequence[int]) -> str:
    return ", ".join(table.call(i) for i in columns)
