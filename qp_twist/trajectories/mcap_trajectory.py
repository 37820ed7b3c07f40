"""Trajectories as ROS 2 bags (MCAP): one message ``trajectory_msgs/JointTrajectory``.

The bag has the definition of the message (``ros2msg``) and the message in CDR, as ROS 2 records
them; no ROS is needed. The library is mcap-ros2-support, of the extra ``ros``.
"""

from __future__ import annotations

import contextlib
import io
import json
from typing import Any

from qp_twist.errors import InvalidInput
from qp_twist.trajectories import json_trajectory
from qp_twist.trajectories.metadata import read_metadata
from qp_twist.trajectories.timed_path import TimedPath

TOPIC = "/joint_trajectory_controller/joint_trajectory"
"""Topic on which ROS' joint trajectory controller expects trajectories, by its usual name."""
_TYPE = "trajectory_msgs/msg/JointTrajectory"
_LINE = "=" * 80
_DEFINITION = f"""\
std_msgs/Header header
string[] joint_names
JointTrajectoryPoint[] points
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
{_LINE}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""
_METADATA = "qp_twist"


def encode(rows: TimedPath, topic: str = TOPIC) -> bytes:
    """A bag with one message, recorded at time 0, and the metadata.

    Raises:
        InvalidInput: If there are no times, or the library is not installed.
    """
    if rows.times is None:
        raise InvalidInput(
            "the trajectory has no times, so that a bag could not be played; give its task a "
            "[feed], or write times into the file."
        )
    _check_library()
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    bag = io.BytesIO()
    with Writer(bag, compression=CompressionType.NONE) as writer:
        schema = writer.register_msgdef(_TYPE, _DEFINITION)
        writer.write_message(topic, schema, json_trajectory.message(rows), log_time=0)
        text = json.dumps(rows.metadata, ensure_ascii=False)
        writer.add_metadata(_METADATA, {"metadata": text})
    return bag.getvalue()


def decode(content: bytes, joint_names: tuple[str, ...] | None) -> TimedPath:
    """The rows of the one JointTrajectory in a bag; ``joint_names`` is not used: it has its own."""
    del joint_names
    if not content:
        raise InvalidInput("the file is empty.")
    _check_library()
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    factory, types = DecoderFactory(), set[str]()
    found: list[dict[str, Any] | None] = []
    metadata: dict[str, Any] = {}
    try:
        reader = make_reader(io.BytesIO(content))
        # The library prints what it does not understand of a message's definition.
        with contextlib.redirect_stderr(io.StringIO()):
            for schema, channel, message in reader.iter_messages():
                types.add(schema.name if schema is not None else channel.topic)
                if schema is not None and schema.name == _TYPE:
                    decode_message = factory.decoder_for(channel.message_encoding, schema)
                    found.append(_fields(decode_message(message.data)) if decode_message else None)
        for record in reader.iter_metadata():
            if record.name == _METADATA:
                metadata = read_metadata(record.metadata.get("metadata", ""))
    except Exception as error:  # broken files raise errors of struct, lz4 and others
        why = str(error) or type(error).__name__
        raise InvalidInput(f"this is no bag that can be read (MCAP): {why}") from None
    fields = found[0] if len(found) == 1 else None
    if fields is None:
        has = f"{len(found)} of them" if found else ", ".join(sorted(types)) or "no messages"
        raise InvalidInput(
            f"expected one message of {_TYPE} in CDR in the bag; it has {has}. Record the "
            "trajectory alone."
        )
    return json_trajectory.rows_of(fields, metadata)


def _fields(message: Any) -> dict[str, Any]:
    """The fields that rows are read from; no times if all are zero."""
    points = [
        {key: list(getattr(point, key)) for key in ("positions", "velocities", "accelerations")}
        for point in message.points
    ]
    stamps = [point.time_from_start for point in message.points]
    if any(stamp.sec or stamp.nanosec for stamp in stamps):
        for fields, stamp in zip(points, stamps, strict=True):
            fields["time_from_start"] = {"sec": stamp.sec, "nanosec": stamp.nanosec}  # type: ignore[assignment]
    return {"joint_names": list(message.joint_names), "points": points}


def _check_library() -> None:
    try:
        import mcap_ros2  # noqa: F401
    except ImportError:
        raise InvalidInput(
            "bags (.mcap) need the package mcap-ros2-support: pip install 'qp_twist[ros]'."
        ) from None
