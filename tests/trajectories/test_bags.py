"""ROS 2 bags, read back by another library (rosbags)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.program_rows import random_rows
from rosbags.highlevel import AnyReader

import qp_twist as qt
from qp_twist.trajectories import TimedPath, read_trajectory, write_trajectory


@given(seed=st.integers(0, 2**32 - 1), velocities=st.booleans())
@settings(max_examples=20, deadline=None)
def test_another_library_reads_the_message(
    tmp_path_factory: pytest.TempPathFactory, seed: int, velocities: bool
) -> None:
    rows, _ = random_rows(seed, "krl", velocities=velocities)
    path = tmp_path_factory.mktemp("bag") / "motion.mcap"
    write_trajectory(rows, path)
    with AnyReader([path]) as reader:
        [(connection, stamp, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    assert connection.topic == "/joint_trajectory_controller/joint_trajectory"
    assert connection.msgtype == "trajectory_msgs/msg/JointTrajectory"
    assert stamp == 0
    assert tuple(message.joint_names) == rows.joint_names
    assert (np.array([point.positions for point in message.points]) == rows.q).all()
    assert rows.times is not None
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
    assert times == pytest.approx(rows.times, abs=1e-9)
    if velocities:
        assert (np.array([point.velocities for point in message.points]) == rows.velocities).all()
    assert all(len(point.accelerations) == 0 for point in message.points)
    back = read_trajectory(path, rows.joint_names)
    assert (back.q == rows.q).all()
    assert back.times == pytest.approx(rows.times, abs=1e-9)
    assert back.metadata == rows.metadata


def test_what_is_no_bag_of_one_trajectory(tmp_path: Path) -> None:
    rows, _ = random_rows(1, "krl")
    untimed = TimedPath(rows.joint_names, rows.q)
    with pytest.raises(qt.InvalidInput, match="has no times"):
        write_trajectory(untimed, tmp_path / "a.mcap")
    path = write_trajectory(rows, tmp_path / "b.mcap")
    content = path.read_bytes()
    path.write_bytes(b"")
    with pytest.raises(qt.InvalidInput, match="the file is empty"):
        read_trajectory(path)
    for cut in (10, len(content) // 2, len(content) - 3):
        path.write_bytes(content[:cut])
        with pytest.raises(qt.InvalidInput, match=r"can be read \(MCAP\): \S|expected one message"):
            read_trajectory(path)
    from mcap_ros2.writer import Writer

    with path.open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("std_msgs/msg/String", "string data")
        writer.write_message("/chatter", schema, {"data": "hello"}, log_time=0)
    with pytest.raises(qt.InvalidInput, match="it has std_msgs/msg/String"):
        read_trajectory(path)
