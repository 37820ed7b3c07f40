"""Trajectories as CSV: comments, a line of names with units, rows."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.exchange.joint_rows import JointRows
from qp_twist.exchange.metadata import read_metadata

_METADATA = "# metadata "
_UNITS = {
    **dict.fromkeys(("", "rad", "radian", "radians", "m", "s", "sec", "seconds"), 1.0),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180.0),
    **dict.fromkeys(("mm", "ms"), 1e-3),
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
}
_BRACKETS = re.compile(r"^(?P<label>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")
_ENDING = re.compile(r"^(?P<label>.+?)[_ ](?P<unit>rad|deg|mm|ms)(?P<per>(?:[_/ ]?(?:per_)?s)?)$")
_INDEX = {"", "#", "waypoint", "index", "row", "point", "i", "k", "n", "no", "nr", "id"}
_TIME = {"t", "time", "times", "time_from_start", "timestamp", "seconds", "sec", "t_s", "time_s"}
_KINDS = {
    "position": r"positions?|pos|angle|q|theta",
    "velocity": r"velocity|velocities|vel|speed|dq|qd|qdot",
    "acceleration": r"acceleration|accelerations|accel|acc|ddq|qdd|qddot",
    "other": r"effort|torque|current",
}
_BETWEEN = r"[\s_./:-]+"


def encode(rows: JointRows) -> str:
    """Two comment lines, the names, the rows; times and velocities where there are any."""
    units = rows.metadata.get("units", {})
    told = ", ".join(f"{key} {rows.metadata[key]}" for key in ("task", "method"))
    how = "positions only, joints straight between rows"
    if rows.velocities is not None:
        how = "each joint on the cubic through positions and velocities of two rows"
    if rows.times is None:
        how = "no clock"
    header = ["row"] + ([] if rows.times is None else ["time [s]"])
    header += [f"{name} [{units[name]}]" for name in rows.joint_names]
    if rows.velocities is not None:
        header += [f"{name} velocity [{units[name]}/s]" for name in rows.joint_names]
    lines = [
        f"# qp_twist joint trajectory; {told}; {how}",
        _METADATA + json.dumps(rows.metadata, ensure_ascii=False),
        ",".join(_quoted(cell) for cell in header),
    ]
    for k in range(len(rows.q)):
        values = [*([] if rows.times is None else rows.times[k : k + 1]), *rows.q[k]]
        values += [] if rows.velocities is None else [*rows.velocities[k]]
        lines.append(",".join([str(k + 1), *(f"{value:.17g}" for value in values)]))
    return "\n".join(lines) + "\n"


def decode(content: bytes, joint_names: tuple[str, ...] | None) -> JointRows:
    """The rows of a CSV file, ours or another tool's.

    Understood: commas, semicolons (then with decimal commas as well), tabs or blanks between cells;
    blank lines and lines that begin with ``#``; units in the names' brackets or endings
    (``joint_1 [deg]``, ``joint_1_deg``), rad, m and s where there is none; velocities as
    ``joint_1 velocity`` or ``vel_joint_1``. Accelerations and efforts are left out.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidInput("this is no text in UTF-8.") from None
    metadata: dict[str, Any] = {}
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith(_METADATA):
            metadata = read_metadata(line.removeprefix(_METADATA))
        if line.strip() and not line.lstrip().startswith("#"):
            lines.append((number, line.strip()))
    if len(lines) < 2:
        raise InvalidInput("expected a line of column names and rows below it.")
    delimiter = _delimiter(lines[0][1])
    names = _cells(lines[0][1], delimiter, lines[0][0])
    if all(_is_number(name, delimiter) for name in names):
        raise InvalidInput(
            f"line {lines[0][0]}: expected the names of the columns, got numbers; put a line with "
            "the joints' names above them."
        )
    if joint_names is None and isinstance(metadata.get("units"), dict):
        joint_names = tuple(metadata["units"])
    columns = [_Column.of(name, joint_names) for name in names]
    used = [
        k for k, column in enumerate(columns) if column.kind in ("time", "position", "velocity")
    ]
    values = np.empty((len(lines) - 1, len(columns)))
    for row, (number, line) in enumerate(lines[1:]):
        cells = _cells(line, delimiter, number)
        if len(cells) != len(names):
            raise InvalidInput(
                f"line {number}: expected {len(names)} cells as in the line of names, got "
                f"{len(cells)}."
            )
        for k in used:
            values[row, k] = columns[k].scale * _number(cells[k], delimiter, number, names[k])
    if not any(column.kind == "position" for column in columns):
        known = "" if joint_names is None else f"; its joints are {', '.join(joint_names)}"
        raise InvalidInput(
            f"none of the columns {', '.join(names)} is a joint of the robot{known}. Name the "
            "columns as the robot names its joints."
        )
    return _rows(columns, values, metadata)


@dataclass(frozen=True)
class _Column:
    """What a column holds: ``kind`` of ``joint``, in units of ``scale``."""

    kind: str
    joint: str
    scale: float

    @classmethod
    def of(cls, name: str, joint_names: tuple[str, ...] | None) -> _Column:
        """From its name, with the joints' names where they are known."""
        label, unit = name.strip(), ""
        if joint_names is None or label not in joint_names:
            match = _BRACKETS.match(label) or _ENDING.match(label)
            if match:
                label, unit = match["label"].strip(), match["unit"].strip()
        if label.lower() in _INDEX and label not in (joint_names or ()):
            return cls("index", "", 1.0)
        if label.lower() in _TIME and label not in (joint_names or ()):
            return cls("time", "", _scale(name, unit))
        kind, joint = _parted(label, joint_names)
        wanted = joint_names is None or joint in joint_names
        if kind == "other" or not wanted:
            return cls("other", joint, 1.0)
        return cls(kind, joint, _scale(name, unit))


def _parted(label: str, joint_names: tuple[str, ...] | None) -> tuple[str, str]:
    """Kind and joint of a label such as ``joint_1 velocity``, ``vel_joint_1`` or ``joint_1``."""
    if joint_names is not None and label in joint_names:
        return "position", label
    for kind, words in _KINDS.items():
        for pattern in (rf"^(?:{words}){_BETWEEN}(.+)$", rf"^(.+?){_BETWEEN}(?:{words})$"):
            match = re.match(pattern, label, re.IGNORECASE)
            if match:
                return kind, match[1]
    return "position", label


def _rows(columns: list[_Column], values: Array, metadata: dict[str, Any]) -> JointRows:
    kinds = [column.kind for column in columns]
    positions = [k for k, kind in enumerate(kinds) if kind == "position"]
    joints = tuple(columns[k].joint for k in positions)
    for joint in joints:
        if joints.count(joint) > 1:
            raise InvalidInput(f"two columns hold the positions of {joint}.")
    velocities: Array | None = None
    places = {columns[k].joint: k for k, kind in enumerate(kinds) if kind == "velocity"}
    without = [joint for joint in joints if joint not in places]
    if places and without and len(without) < len(joints):
        raise InvalidInput(
            f"there are velocities, but none of {', '.join(without)}; give those of all joints or "
            "of none."
        )
    if joints and not without:
        velocities = values[:, [places[joint] for joint in joints]]
    if kinds.count("time") > 1:
        raise InvalidInput("two columns hold the time; leave one of them.")
    times = values[:, kinds.index("time")] if "time" in kinds else None
    accelerated = "acceleration" in kinds
    return JointRows(joints, values[:, positions], times, velocities, metadata, accelerated)


def _scale(name: str, unit: str) -> float:
    """SI units in one of the column's: what stands above the slash counts, below it are seconds."""
    above, _, below = unit.replace("^2", "²").partition("/")
    if above.strip() not in _UNITS or below.strip() not in ("", "s", "s²", "sec"):
        raise InvalidInput(
            f"column {name!r}: the unit {unit!r} is not known; expected rad, deg, m or mm for "
            "joints, the same per s for velocities, s or ms for time."
        )
    return _UNITS[above.strip()]


def _delimiter(line: str) -> str | None:
    """What stands between the cells; ``None`` for blanks."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _cells(line: str, delimiter: str | None, number: int) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        [cells] = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    except csv.Error as error:
        raise InvalidInput(f"line {number}: no row of cells: {error}.") from None
    return [cell.strip() for cell in cells]


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if re.search(r'[,"]', cell) else cell


def _is_number(cell: str, delimiter: str | None) -> bool:
    try:
        float(cell.replace(",", ".") if delimiter == ";" else cell)
    except ValueError:
        return False
    return True


def _number(cell: str, delimiter: str | None, line: int, name: str) -> float:
    if _is_number(cell, delimiter):
        value = float(cell.replace(",", ".") if delimiter == ";" else cell)
        if math.isfinite(value):
            return value
    raise InvalidInput(f"line {line}, column {name!r}: expected a number, got {cell!r}.")
