"""Trajectories as CSV: comments, a line of names with units, rows."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import (
    ANGLES,
    LENGTHS,
    TIMES,
    Problems,
    TextTable,
    factor,
    split_unit,
    text_lines,
)
from qp_twist.trajectories.metadata import read_metadata
from qp_twist.trajectories.timed_path import TimedPath, resting_axis

_METADATA = "# metadata "
_ENDINGS = {unit + per for unit in ("rad", "deg", "mm") for per in ("", "/s")} | {"ms"}
"""Units that are recognised without brackets; ``slide_m`` may be the name of a joint."""
_INDEX = {"", "#", "waypoint", "index", "row", "point", "i", "k", "n", "no", "nr", "id"}
_TIME = {"t", "time", "times", "time_from_start", "timestamp", "seconds", "sec", "t_s", "time_s"}
_KINDS = {
    "position": r"positions?|pos|angle|q|theta",
    "velocity": r"velocity|velocities|vel|speed|dq|qd|qdot",
    "acceleration": r"acceleration|accelerations|accel|acc|ddq|qdd|qddot",
    "other": r"effort|torque|current",
}
_RATES = ("position", "velocity", "acceleration")
_OTHERS = tuple(f"other {kind}" for kind in _RATES)
"""Kinds of columns of axes that are not among the joints asked for."""
_BETWEEN = r"[\s_./:-]+"
_TWO_TURNS = 4.0 * math.pi
"""Positions above it without a unit are hardly in radians or metres."""


def encode(rows: TimedPath) -> str:
    """Two comment lines, the names, the rows; times and velocities if there are any.

    Raises:
        InvalidInput: If the metadata do not have the unit of each joint.
    """
    units = rows.metadata.get("units", {})
    if not isinstance(units, dict) or not set(rows.joint_names) <= set(units):
        raise InvalidInput(
            "the units of the joints, which a table states, are not in the trajectory's metadata; "
            "write .json or .npz."
        )
    known = [key for key in ("task", "method") if key in rows.metadata]
    task = " ".join(", ".join(f"{key} {rows.metadata[key]}" for key in known).split())
    how = "positions only, joints straight between rows"
    if rows.velocities is not None:
        how = "each joint on the cubic through positions and velocities of two rows"
    if rows.accelerations is not None:
        how = "each joint on the quintic through positions, velocities, accelerations of two rows"
    if rows.times is None:
        how = "no clock"
    header, columns = ["row"], []
    if rows.times is not None:
        header, columns = ["row", "time [s]"], [rows.times[:, None]]
    for values, rate, per in (
        (rows.q, "", ""),
        (rows.velocities, " velocity", "/s"),
        (rows.accelerations, " acceleration", "/s²"),
    ):
        if values is not None:
            header += [f"{name}{rate} [{units[name]}{per}]" for name in rows.joint_names]
            columns.append(values)
    file = io.StringIO()
    file.write(f"# qp_twist joint trajectory; {task}; {how}\n")
    file.write(_METADATA + json.dumps(rows.metadata, ensure_ascii=False) + "\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    for number, cells in enumerate(np.hstack(columns).tolist(), start=1):
        writer.writerow([number, *cells])
    return file.getvalue()


def decode(content: bytes, joint_names: tuple[str, ...] | None) -> TimedPath:
    """Rows of a CSV file, of this package or another tool.

    Supported are the delimiters, decimal marks and encodings of :mod:`qp_twist.files`; units in
    brackets or endings of the names (``joint_1 [deg]``, ``joint_1_deg``), else rad, m and s, which
    is refused where the numbers contradict it; velocities as ``joint_1 velocity``, ``vel_joint_1``
    or ``joint_1 [deg/s]``, accelerations likewise. Efforts are ignored. A column that is neither
    these nor a joint of the robot may be another axis: it has to stand still.
    """
    lines = text_lines(content)
    metadata: dict[str, Any] = {}
    for line in lines:
        if line.startswith(_METADATA):
            metadata = read_metadata(line.removeprefix(_METADATA))
    if joint_names is None and isinstance(metadata.get("units"), dict):
        joint_names = tuple(metadata["units"])

    def is_header(names: Sequence[str]) -> bool:
        kinds = {_Column.of(name, joint_names).kind for name in names}
        sure = {"velocity"} if joint_names is None else {"velocity", "position"}
        return not sure.isdisjoint(kinds) or {"time", "position"} <= kinds

    table = TextTable(
        lines,
        least=1,
        texts=False,
        expected="expected a line of column names and rows of numbers below it",
        is_header=is_header,
    )
    names = table.names
    if not names:
        raise InvalidInput(
            f"expected the names of the columns; put a line "
            f"with the joints' names above them, one for each of the {table.width} columns.",
            line=int(table.lines[0]),
        )
    columns = [_Column.of(name, joint_names) for name in names]
    if not any(column.kind == "position" for column in columns):
        known = "" if joint_names is None else f"; its joints are {', '.join(joint_names)}"
        raise InvalidInput(
            f"none of the columns {', '.join(names)} is a joint of the robot{known}. Name the "
            "columns as the robot names its joints."
        )
    used = [k for k, c in enumerate(columns) if c.kind in ("time", *_RATES)]
    problems = Problems()
    table.check(used, problems)
    problems.refuse()
    values = table.numbers[:, used] * [columns[k].scale() for k in used]
    read = [columns[k] for k in used]
    _refuse_other_units(read, values)
    notes = []
    if any(column.kind in _OTHERS for column in columns):
        notes = _resting_axes(columns, table.numbers)
    return _rows(read, values, metadata, notes)


def _resting_axes(columns: Sequence[_Column], values: Array) -> list[str]:
    """Notes about axes that the robot's model lacks; refuses them if they move."""
    travels: dict[str, float] = {}
    for column, cells in zip(columns, values.T, strict=False):
        number = cells[np.isfinite(cells)]
        size = 1.0 if column.unit is None else factor(column.unit, ANGLES, LENGTHS)
        if column.kind not in _OTHERS or size is None or not len(number):
            continue
        # A rate that is not 0 moves the axis wherever its positions are.
        position = column.kind == _OTHERS[0]
        travel = size * (np.ptp(number) if position else np.abs(number).max())
        travels[column.joint] = max(travel, travels.get(column.joint, 0.0))
    return [resting_axis(name, float(travel)) for name, travel in travels.items()]


@dataclass(frozen=True)
class _Column:
    """A column: its name, ``kind`` of ``joint``, and the unit after its name, if any."""

    name: str
    kind: str
    joint: str = ""
    unit: str | None = None

    @classmethod
    def of(cls, name: str, joint_names: tuple[str, ...] | None) -> _Column:
        """From the column's name, with the joints' names if known."""
        joints: Container[str] = joint_names or ()
        name = label = name.strip()
        unit = None
        if name not in joints:
            label, unit = split_unit(name, _ENDINGS)
            if unit is None:
                label = name  # "arm[0]": the brackets belong to the name
        if label not in joints and label.lower() in _INDEX:
            return cls(name, "index")
        if label.lower() in _TIME and (label not in joints or unit in TIMES):
            return cls(name, "time", unit=unit)
        kind, joint = _parted(label, joint_names)
        if kind == "position" and unit is not None:
            # For "joint_1 [deg/s]" the unit determines the kind.
            kind = {"s": "velocity", "s²": "acceleration"}.get(unit.partition("/")[2], kind)
        known = joint_names is None or joint in joints
        return cls(name, kind if known else f"other {kind}", joint, unit)

    def scale(self) -> float:
        """Factor from the column's unit to SI.

        Raises:
            InvalidInput: If the unit is unknown, or does not fit the column's kind.
        """
        if self.unit is None:
            return 1.0
        size = factor(self.unit, *((TIMES,) if self.kind == "time" else (ANGLES, LENGTHS)))
        per = {"velocity": ("", "s", "min"), "acceleration": ("", "s²")}.get(self.kind, ("",))
        if size is None or self.unit.partition("/")[2] not in per:
            raise InvalidInput(
                f"column {self.name!r}: the unit {self.unit!r} is not known; expected rad, deg, m "
                "or mm for joints, the same per s for velocities and per s² for accelerations, s "
                "or ms for time."
            )
        return size


def _refuse_other_units(columns: list[_Column], values: Array) -> None:
    """Refuse columns (N, columns) without a unit that are hardly in rad or m.

    Raises:
        InvalidInput: If a position without a unit is above two turns, or a column has none and
            others are in degrees.
    """
    in_degrees = [c.name for c in columns if (c.unit or "").partition("/")[0] == "deg"]
    for column, numbers in zip(columns, values.T, strict=True):
        if column.unit is not None or column.kind not in _RATES:
            continue
        largest = float(np.abs(numbers).max(initial=0.0))
        if in_degrees:
            why = f"column {in_degrees[0]!r} is in degrees"
        elif column.kind == "position" and largest > _TWO_TURNS:
            turns = largest / (2.0 * math.pi)
            why = f"its numbers reach {largest:.6g}, as radians {turns:.3g} turns"
        else:
            continue
        name, per = column.name, {"velocity": "/s", "acceleration": "/s²"}.get(column.kind, "")
        raise InvalidInput(
            f"column {name!r} has no unit, and {why}: write the unit of each "
            f"joint into the header, e.g. {name} [deg{per}] or {name} [rad{per}]."
        )


def _parted(label: str, joint_names: tuple[str, ...] | None) -> tuple[str, str]:
    """Kind and joint of a label such as ``joint_1 velocity``, ``vel_joint_1`` or ``joint_1``."""
    for kind, joint in (("position", label), ("velocity", label.removesuffix(" velocity"))):
        if joint_names is not None and joint in joint_names:
            return kind, joint
    for kind, words in _KINDS.items():
        for pattern in (rf"^(?:{words}){_BETWEEN}(.+)$", rf"^(.+?){_BETWEEN}(?:{words})$"):
            match = re.match(pattern, label, re.IGNORECASE)
            if match:
                return kind, match[1]
    return "position", label


def _rows(
    columns: list[_Column], values: Array, metadata: dict[str, Any], notes: list[str]
) -> TimedPath:
    kinds = [column.kind for column in columns]
    joints = tuple(column.joint for column in columns if column.kind == "position")
    for joint in joints:
        if joints.count(joint) > 1:
            raise InvalidInput(f"two columns hold the positions of {joint}.")
    rates: list[Array | None] = []
    for rate in _RATES:
        places = {c.joint: k for k, c in enumerate(columns) if c.kind == rate}
        without = [joint for joint in joints if joint not in places]
        if places and without and len(without) < len(joints):
            names = {"velocity": "velocities", "acceleration": "accelerations"}[rate]
            raise InvalidInput(
                f"there are {names}, but none of {', '.join(without)}; give those of all joints or "
                "of none."
            )
        rates.append(None if without else values[:, [places[joint] for joint in joints]])
    if kinds.count("time") > 1:
        raise InvalidInput("two columns hold the time; leave one of them.")
    times = values[:, kinds.index("time")] if "time" in kinds else None
    q, velocities, accelerations = rates
    assert q is not None
    return TimedPath(joints, q, times, velocities, metadata, accelerations, tuple(notes))
