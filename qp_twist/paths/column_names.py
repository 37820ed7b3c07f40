"""What the names of a table's columns mean, in the words of many programs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from qp_twist.files import AngleUnit, LengthUnit, split_unit

Orientation = Literal["axis", "normal", "quaternion", "rpy", "rotation_vector", "matrix", "none"]
_WITHIN = {
    *("pose", "tcp", "point", "waypoint", "tool", "field", "target", "actual", "current"),
    *("desired", "msg", "transform", "ee", "robot", "rist", "rsol"),
}
"""Words beside a column's name that say where it is from: ``field.pose.position.x``, ``X_RIst``."""
_OF_OTHERS = re.compile(r"err|vel|acc|cov|std|noise|twist|joint|delta|diff|force|torque")
"""Parts of such words with which it is another quantity."""
_IN_FILE_NAME = re.compile(r"xyz_?(wpr|abc|rpy|ijk|s)(?![a-z])", re.IGNORECASE)
"""Columns that the name of a file states, as RoboDK's examples do: ``Import-CSV-XYZWPR.csv``."""
_TANGENT = re.compile(r"t[\W_]*[xyz]")
"""Names of positions, which beside other ones are those of a tangent."""


@dataclass(frozen=True)
class Naming:
    """How tables name the columns of one group.

    Attributes:
        names: Place in the group, in the order of the reader, by the letters and digits of a name.
        means: What the columns are read as; ``None`` if they are no orientation.
        size: Number of columns.
        unit: Unit of its angles where the file states none and the numbers agree; small angles
            are never degrees by it.
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


def _one(names: str) -> Naming:
    return Naming(dict.fromkeys(names.split(), 0), size=1)


_POSITIONS = (
    "{} p{} t{} pos{} {}pos position{} {}position coord{} {}coord coordinate{} {}coordinate "
    "translation{} location{}"
)
_QUATERNIONS = "q{} quat{} quaternion{} orientation{} ori{} orient{}"
NAMINGS = {
    "position": Naming(_names("xyz", _POSITIONS) | _names("012", "tcppose{}")),
    "axis": Naming(_names("ijk") | _names("xyz", "a{} axis{} {}axis toolaxis{}"), "axis"),
    "normal": Naming(_names("xyz", "n{} norm{} {}norm normal{} normals{} {}normal"), "normal"),
    "quaternion_wxyz": Naming(_names("wxyz", _QUATERNIONS), "quaternion", 4),
    "quaternion_xyzw": Naming({}, "quaternion", 4),
    "numbered quaternion": Naming(
        _names("0123456789", _QUATERNIONS), "quaternion", 4, length="mm",
        called="a quaternion w, x, y, z, as ABB writes it",
    ),
    "rpy": Naming(_names(("roll", "pitch", "yaw")), "rpy"),
    "W P R": Naming(
        _names("wpr"), "rpy", unit="deg", length="mm",
        called="FANUC's W, P, R: R = Rz(R) Ry(P) Rx(W)",
    ),
    "A B C": Naming(
        _names("cba"), "rpy", unit="deg", length="mm",
        called="KUKA's A, B, C: R = Rz(A) Ry(B) Rx(C) (of a robot with A about x choose rpy = "
        "A, B, C in [path.columns])",
    ),
    "rotation_vector": Naming(
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
    "x_axis": Naming(_names("xyz", "tangent{} tangents{} {}tangent tang{} xaxis{} axisx{}")),
    "y_axis": Naming(_names("xyz", "yaxis{} axisy{} binormal{} bitangent{}")),
    "z_axis": Naming(_names("xyz", "zaxis{} axisz{}")),
    "lead": _one("lead leadangle"),
    "tilt": _one("tilt tiltangle sidetilt"),
    "curve": _one("curve curveid curvename pass contour stroke"),
    "feed": _one("feed feedrate f speed velocity pathspeed tcpspeed"),
    "type": _one("type move motion movetype motiontype gcode command cmd"),
}  # fmt: skip
"""Usual names of columns. Those of another program are another row."""
DIRECTIONS = {group for group, of in NAMINGS.items() if of.means} | {"angles"}
"""Groups that are an orientation."""
BESIDE: dict[Orientation, set[str]] = {
    "axis": {"x_axis", "y_axis"},
    "normal": {"x_axis", "y_axis", "lead", "tilt"},
}
"""Groups that complete an orientation."""
COMPLETE = {group for groups in BESIDE.values() for group in groups}
"""All of them."""
_GROUPS = {name: (group, at) for group, of in NAMINGS.items() for name, at in of.names.items()}


def usual(names: Sequence[str]) -> dict[str, dict[int, list[int]]]:
    """Groups of columns with usual names: for each place in a group, the columns."""
    found: dict[str, dict[int, list[int]]] = {}
    for index, name in enumerate(names):
        if meant := _meant(split_unit(name)[0].lower()):
            found.setdefault(meant[0], {}).setdefault(meant[1], []).append(index)
    if 3 in found.get("angles", {}):  # rx, ry, rz, rw are a quaternion
        for place, columns in found.pop("angles").items():
            found.setdefault("quaternion_wxyz", {}).setdefault((place + 1) % 4, []).extend(columns)
    numbered = found.pop("numbered quaternion", {})
    if numbered.keys() in ({0, 1, 2, 3}, {1, 2, 3, 4}):  # other numbers are those of joints
        first = min(numbered)
        found["numbered quaternion"] = {i - first: columns for i, columns in numbered.items()}
    for place, columns in found.get("position", {}).items():
        tangent = [i for i in columns if _TANGENT.fullmatch(names[i].lower())]
        if 0 < len(tangent) < len(columns):
            found["position"][place] = [i for i in columns if i not in tangent]
            found.setdefault("x_axis", {}).setdefault(place, []).extend(tangent)
    frame = [found.get(f"{letter}_axis", {}) for letter in "xyz"]
    found.pop("z_axis", None)
    if frame[2] and (frame[0] or frame[1]):  # columns of the frame's rotation matrix
        for letter in "xy":
            found.pop(f"{letter}_axis", None)
        matrix = found.setdefault("matrix", {})
        for column, places in enumerate(frame):
            for place, columns in places.items():
                matrix.setdefault(3 * place + column, []).extend(columns)
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


def has_position(names: Sequence[str], *, once: bool = False) -> bool:
    """Whether the names are those of a table with x, y and z, or with one of each."""
    places = usual(names).get("position", {})
    return len(places) == 3 and not (once and any(len(columns) > 1 for columns in places.values()))
