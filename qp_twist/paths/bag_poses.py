"""Poses in bags of ROS 2 (MCAP) as a table."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from typing import Any

from qp_twist.errors import InvalidInput

_BAGS = {
    b"\x89MCAP": "",
    b"SQLite format 3": "a ROS 2 bag in SQLite; ros2 bag convert writes it as MCAP",
    b"#ROSBAG": "a ROS 1 bag; rosbags-convert writes it as MCAP",
}
"""Bags by their begin, and why another one is refused."""
_ARRAYS: dict[str, Callable[[Any], Iterable[Any]]] = {
    "geometry_msgs/msg/PoseArray": lambda message: message.poses,
    "nav_msgs/msg/Path": lambda message: [stamped.pose for stamped in message.poses],
}
"""Messages that are a path, and the poses in them."""
_SINGLE: dict[str, Callable[[Any], Iterable[Any]]] = {
    "geometry_msgs/msg/Pose": lambda message: [message],
    "geometry_msgs/msg/PoseStamped": lambda message: [message.pose],
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: [message.pose.pose],
    "nav_msgs/msg/Odometry": lambda message: [message.pose.pose],
}
"""Messages that are a point of a path, likewise."""


def is_bag(content: bytes) -> bool:
    """Whether a file is a bag of ROS."""
    return content.startswith(tuple(_BAGS))


def bag_lines(content: bytes) -> tuple[list[str], list[str]]:
    """The lines of a table, and notes.

    Poses of ROS are in metres (REP 103). Of several messages that are a path each, the last counts.

    Raises:
        InvalidInput: If it is another bag than MCAP, has no poses or those of several topics, or
            the library is not installed.
    """
    kind = next(kind for magic, kind in _BAGS.items() if content.startswith(magic))
    text = "ros2 topic echo --csv TOPIC writes its poses as text while the bag is played"
    if kind:
        raise InvalidInput(f"this is {kind}.")
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InvalidInput(
            f'a bag (MCAP) needs a library: pip install "qp_twist[ros]"; or {text}.'
        ) from error
    topics: dict[tuple[str, str], list[Any]] = {}
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    for schema, channel, _, message in reader.iter_decoded_messages():
        name = "" if schema is None else schema.name
        topics.setdefault((channel.topic, name), []).append(message)
    for types in (_ARRAYS, _SINGLE):
        found = {topic: messages for topic, messages in topics.items() if topic[1] in types}
        if len(found) > 1:
            names = ", ".join(topic for topic, _ in found)
            raise InvalidInput(
                f"the bag has poses of the topics {names}; write one to a file: {text}."
            )
        if found:
            [((topic, name), messages)] = found.items()
            return _table(topic, types[name], messages[-1:] if types is _ARRAYS else messages,
                          len(messages) if types is _ARRAYS else 1)  # fmt: skip
    known = ", ".join(name.rpartition("/")[2] for name in (*_ARRAYS, *_SINGLE))
    raise InvalidInput(f"the bag has no messages with poses; expected {known}.")


def _table(
    topic: str, poses: Callable[[Any], Iterable[Any]], messages: list[Any], of: int
) -> tuple[list[str], list[str]]:
    names = [f"position.{c} [m]" for c in "xyz"] + [f"orientation.{c}" for c in "xyzw"]
    lines = [",".join(names)]
    for message in messages:
        for pose in poses(message):
            at, turn = pose.position, pose.orientation
            lines.append(",".join(map(repr, (at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w))))
    last = f", the last of {of} messages" if of > 1 else ""
    return lines, [f"the path is the topic {topic}{last}."]
