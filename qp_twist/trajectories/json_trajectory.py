"""Trajectories as JSON in the field names of ROS' ``trajectory_msgs/JointTrajectory``."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from qp_twist.checks import Array, clause
from qp_twist.errors import InvalidInput
from qp_twist.trajectories.metadata import read_json
from qp_twist.trajectories.timed_path import TimedPath

_NANO = 1_000_000_000


def encode(rows: TimedPath) -> str:
    """A JointTrajectory with one point per line, and the additional field ``metadata``.

    With positions and velocities ROS' joint trajectory controller uses cubics, as the timing does;
    so ``accelerations`` is empty unless the rows have them, which means polynomials of degree five.
    """
    fields = message(rows)
    points = ",\n".join(json.dumps(point) for point in fields.pop("points"))
    lines = [
        *(f"{json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in fields.items()),
        f'"points": [\n{points}\n]',
        f'"metadata": {json.dumps(rows.metadata, ensure_ascii=False)}',
    ]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def message(rows: TimedPath) -> dict[str, Any]:
    """The fields of a JointTrajectory; points without times have no ``time_from_start``."""
    rates = {"velocities": rows.velocities, "accelerations": rows.accelerations}
    points = []
    for k, q in enumerate(rows.q):
        point: dict[str, Any] = {"positions": q.tolist()}
        point |= {key: [] if x is None else x[k].tolist() for key, x in rates.items()}
        point["effort"] = []
        if rows.times is not None:
            sec, nanosec = divmod(round(float(rows.times[k]) * _NANO), _NANO)
            point["time_from_start"] = {"sec": sec, "nanosec": nanosec}
        points.append(point)
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(rows.joint_names),
        "points": points,
    }


def decode(content: bytes, joint_names: tuple[str, ...] | None) -> TimedPath:
    """The rows of a JointTrajectory, also inside a ``joint_trajectory`` or a goal's ``trajectory``.

    ``joint_names`` is not used: the file has its own.
    """
    try:
        document = read_json(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # also invalid UTF-8 and endless numbers
        said = f"this is no JSON: {clause(error)}." if content.strip() else "the file is empty."
        raise InvalidInput(said) from None
    found = document
    for key in ("goal", "trajectory", "joint_trajectory"):
        if isinstance(found, dict) and isinstance(found.get(key), dict):
            found = found[key]
    if not isinstance(found, dict) or not {"joint_names", "points"} <= set(found):
        raise InvalidInput(
            "expected the fields of trajectory_msgs/JointTrajectory: joint_names and points."
        )
    metadata = found.get("metadata", document.get("metadata", {}))
    return rows_of(found, metadata if isinstance(metadata, dict) else {})


def rows_of(found: dict[str, Any], metadata: dict[str, Any]) -> TimedPath:
    """The rows of the fields of a JointTrajectory."""
    names, points = found["joint_names"], found["points"]
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise InvalidInput("joint_names and points have to be lists, points not an empty one.")
    if not all(isinstance(point, dict) for point in points):
        raise InvalidInput("points: every point has to be an object with positions.")
    q = _array(points, "positions", len(names))
    if q is None:
        raise InvalidInput("points[0].positions: missing.")
    return TimedPath(
        tuple(str(name) for name in names),
        q,
        _times(points),
        _array(points, "velocities", len(names)),
        metadata,
        _array(points, "accelerations", len(names)),
    )


def _array(points: list[dict[str, Any]], key: str, width: int) -> Array | None:
    """A field of all points, (N, n); ``None`` if no point has it."""
    if not any(point.get(key) for point in points):
        return None
    rows = np.empty((len(points), width))
    for k, point in enumerate(points):
        values = point.get(key)
        if not isinstance(values, list) or len(values) != width:
            raise InvalidInput(f"points[{k}].{key}: expected {width} numbers, got {values!r}.")
        for joint, value in enumerate(values):
            rows[k, joint] = _number(f"points[{k}].{key}[{joint}]", value)
    return rows


def _times(points: list[dict[str, Any]]) -> Array | None:
    if not any("time_from_start" in point for point in points):
        return None
    times = np.empty(len(points))
    for k, point in enumerate(points):
        key, stamp = f"points[{k}].time_from_start", point.get("time_from_start")
        if isinstance(stamp, dict):
            seconds = stamp.get("sec", stamp.get("secs", 0))
            nanoseconds = stamp.get("nanosec", stamp.get("nsecs", 0))
            times[k] = _number(key, seconds) + _number(key, nanoseconds) / _NANO
        else:
            times[k] = _number(key, stamp)
    return times


def _number(name: str, value: object) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise InvalidInput(f"{name}: expected a finite number, got {repr(value)[:60]}.")
