"""Poses in bags of ROS: MCAP and SQLite of ROS 2, the bags of ROS 1."""

from __future__ import annotations

import bz2
import contextlib
import io
import sqlite3
import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import Table
from qp_twist.paths.pose_records import only_frame

_MCAP, _SQLITE, _ROS_1 = b"\x89MCAP", b"SQLite format 3", b"#ROSBAG V2.0\n"
_NAMES = (*(f"position.{c} [m]" for c in "xyz"), *(f"orientation.{c}" for c in "xyzw"))
_ARRAYS = "PoseArray", "Path"
"""Messages that are a path each."""
_SINGLE = "Pose", "PoseStamped", "PoseWithCovarianceStamped", "Odometry"
"""Messages that are a point of a path."""


class _Message(NamedTuple):
    topic: str
    kind: str
    data: bytes
    ros: int


def is_bag(content: bytes) -> bool:
    """Whether a file is a bag of ROS."""
    return content.startswith((_MCAP, _SQLITE, b"#ROSBAG"))


def bag_table(content: bytes) -> tuple[Table, list[str]]:
    """The poses of a bag, in metres (REP 103), and a note; of several paths the last counts.

    Raises:
        InvalidInput: If it has no poses, or of several topics or frames, or a library is missing.
    """
    read = _mcap if content.startswith(_MCAP) else _sqlite if content[:6] == b"SQLite" else _ros_1
    topics: dict[tuple[str, str], list[_Message]] = {}
    for message in read(content):
        if message.kind in (*_ARRAYS, *_SINGLE):
            topics.setdefault(message[:2], []).append(message)
    for kinds in (_ARRAYS, _SINGLE):
        found = {topic: messages for topic, messages in topics.items() if topic[1] in kinds}
        if len(found) > 1:
            names = ", ".join(topic for topic, _ in found)
            raise InvalidInput(
                f"the bag has poses of the topics {names}; write one to a file: ros2 topic echo "
                "--csv TOPIC writes its poses as text while the bag is played."
            )
        for (topic, _), messages in found.items():
            counts = messages[-1:] if kinds is _ARRAYS else messages
            last = f", the last of {len(messages)} messages" if len(messages) > len(counts) else ""
            framed = [pose for message in counts for pose in _poses(message)]
            poses = np.array([pose for _, pose in framed]).reshape(-1, 7)
            frame = only_frame(topic, (frame for frame, _ in framed))
            within = f" in the frame {frame}" if frame else ""
            table = Table(_NAMES, poses, np.arange(1, len(poses) + 1), {0: ""})
            return table, [f"the path is the topic {topic}{within}{last}."]
    raise InvalidInput(
        f"the bag has no messages with poses; expected {', '.join((*_ARRAYS, *_SINGLE))}."
    )


def _poses(message: _Message) -> Iterator[tuple[str, tuple[float, ...]]]:
    """The poses of a message: their frame; x, y, z and the quaternion, its scalar last.

    A pose of a path without a frame of its own is in that of the path.

    ROS 2 writes CDR: a number stands at a multiple of its size behind four bytes that state the
    order of bytes. ROS 1 writes numbers without gaps, and the number of a message in its header.
    """
    data, aligned = message.data, message.ros == 2
    order, begin = ("<" if not aligned or data[1] & 1 else ">"), 4 if aligned else 0
    at = begin

    def take(form: str, size: int, count: int = 1) -> tuple[float, ...]:
        nonlocal at
        if aligned:
            at += (begin - at) % size
        at += size * count
        return struct.unpack_from(f"{order}{count}{form}", data, at - size * count)

    def text() -> str:
        nonlocal at
        size = int(take("I", 4)[0])
        at += size
        return data[at - size : at].rstrip(b"\0").decode("utf-8", "replace").strip("/")

    def frame_of_header() -> str:
        take("I", 4, 2 if aligned else 3)  # time, and the message's number
        return text()

    frame = frame_of_header() if message.kind != "Pose" else ""
    if message.kind == "Odometry":
        text()  # the frame of the velocity
    count = int(take("I", 4)[0]) if message.kind in _ARRAYS else 1
    for _ in range(count):
        own = frame_of_header() if message.kind == "Path" else ""
        yield own or frame, take("d", 8, 7)


def _mcap(content: bytes) -> Iterator[_Message]:
    try:
        from mcap.reader import make_reader
    except ImportError as error:
        raise InvalidInput(
            'a bag (MCAP) needs a library: pip install "qp_twist[ros]"; ros2 bag convert writes '
            "it as SQLite, which needs none."
        ) from error
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages():
        kind = "" if schema is None else schema.name.rpartition("/")[2]
        ros = 1 if channel.message_encoding == "ros1" else 2
        yield _Message(channel.topic, kind, message.data, ros)


def _sqlite(content: bytes) -> Iterator[_Message]:
    with contextlib.closing(sqlite3.connect(":memory:")) as bag:
        bag.deserialize(content)
        query = (
            "SELECT name, type, data FROM messages JOIN topics ON topics.id = topic_id "
            "ORDER BY timestamp"
        )
        for topic, kind, data in bag.execute(query):
            yield _Message(str(topic), str(kind).rpartition("/")[2], data, 2)


def _ros_1(content: bytes) -> Iterator[_Message]:
    if not content.startswith(_ROS_1):
        raise InvalidInput("this is a ROS 1 bag of an old version; rosbags-convert writes it anew.")
    yield from _records(content[len(_ROS_1) :], {})


def _records(part: bytes, connections: dict[bytes, tuple[str, str]]) -> Iterator[_Message]:
    """Messages among the records of a bag of ROS 1, each a header of fields, and data."""
    at = 0
    while at < len(part):
        header, at = _sized(part, at)
        data, at = _sized(part, at)
        fields = _fields(header)
        match fields[b"op"]:
            case b"\x05":  # a chunk of records
                packing = fields[b"compression"].decode()
                if packing not in ("none", "bz2"):
                    raise InvalidInput(
                        f"a ROS 1 bag packed by {packing}; rosbag decompress unpacks it, and "
                        "rosbags-convert writes it as MCAP."
                    )
                chunk = bz2.decompress(data) if packing == "bz2" else data
                yield from _records(chunk, connections)
            case b"\x07":
                kind = _fields(data)[b"type"].decode().rpartition("/")[2]
                connections[fields[b"conn"]] = (fields[b"topic"].decode(), kind)
            case b"\x02":
                yield _Message(*connections[fields[b"conn"]], data, 1)


def _sized(part: bytes, at: int) -> tuple[bytes, int]:
    """Bytes behind their number, and where they end."""
    (size,) = struct.unpack_from("<I", part, at)
    return part[at + 4 : at + 4 + size], at + 4 + size


def _fields(header: bytes) -> dict[bytes, bytes]:
    """The fields of a header: names and values, with = between them."""
    found, at = dict[bytes, bytes](), 0
    while at < len(header):
        field, at = _sized(header, at)
        name, _, value = field.partition(b"=")
        found[name] = value
    return found
