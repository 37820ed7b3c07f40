"""Tables, point clouds, poses and bags that are refused, or read with a warning."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from qp_twist.errors import InvalidInput
from qp_twist.paths import UnclearColumns, read_toolpath

PLY = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
PCD = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 2\n"
JOINTS = "waypoints:\n- {x: 1, y: 2, z: 3}\n- {config: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]}\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", PLY + "property float z\nelement face 1\nproperty list uchar int vertex_index\n"
         "end_header\n0 0 0\n1 0 0\n3 0 0 1\n", "mesh of 1 faces, and no path"),
        ("a.ply", PLY + "property float z\nend_header\n0 0 0\n", "2 points, and there are"),
        ("a.ply", PLY + "end_header\n0 0\n1 0\n", "no line has three numbers|no columns x, y, z"),
        ("a.ply", PLY + "property float z\n0 0 0\n1 0 0\n", "has no end_header"),
        ("a.ply", PLY + "property real z\nend_header\n0 0 0\n1 0 0\n", "line 6: .*property real"),
        ("a.pcd", PCD + "DATA binary\n1234567", "says 2 points, and there are fewer"),
        ("a.pcd", PCD + "DATA octal\n1 2 3\n", "DATA octal of the PCD file is not known"),
        ("a.yaml", JOINTS, "line 3: among poses, an entry without one"),
        ("a.yaml", "joints: [1, 2, 3, 4, 5, 6]\n", "there is no pose in it"),
        ("a.json", '{"x": [1, 2], "y": [1, 2], "z": [1, 2, 3]}', "lengths beside x, y, z: x 2, y"),
        ("a.json", "[[1, 2, 3, 4, 5, 6, 7]]", "last four numbers are no quaternion"),
        ("a.json", "[[1, 2, 3, 1, 0, 0, 0]]", "have the length 1 in each row and may state an or"),
        ("a.yaml", "a: [1, 2\nb: 3\n", "line 2: the text is no YAML"),
        ("a.yaml", "a: &a [*a, 1]\n", "cannot be read|no pose"),
        ("a.txt", "transforms:\n- child_frame_id: tool\n", "TF. are those of all frames"),
        ("a.db3", "SQLite format 3\0", "ros2 bag convert writes it as MCAP"),
        ("a.bag", "#ROSBAG V2.0\n", "rosbags-convert writes it as MCAP"),
        ("a.csv", "0.1,0.2,0.3,3.1,0.1,0.2\n0.2,0.2,0.3,3.1,0.2,0.2\n", "6 columns and no header"),
        ("a.csv", "f(1.5,2.5,3.5,0.0,0.0,1.0)\nf(2.5,2.5,3.5,0,0,1)\n", "6 columns and no header"),
        ("a.csv", "5.5,1.25,3.5\n0,1.25,8\n", "the unit of column 1.* is not said"),
        ("a.csv", "2e6,1e6,3\n2e6,1e6,8\n", "the unit of column 1.* is not said"),
    ],
)  # fmt: skip
def test_what_is_open_or_damaged_is_refused(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    path = tmp_path / name
    path.write_text(content, encoding="latin-1")
    with pytest.raises(InvalidInput, match=message) as refused:
        read_toolpath(path)
    assert "\n" not in str(refused.value)


def test_a_quaternion_whose_order_is_open_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "down.csv"
    path.write_text("500,0,300,1,0,0,0\n600,0,300,1,0,0,0\n", encoding="utf-8")
    with pytest.raises(UnclearColumns):
        read_toolpath(path)
    for order, up in (("wxyz", 1.0), ("xyzw", -1.0)):
        [curve] = read_toolpath(path, columns=f"position=1,2,3;quaternion_{order}=4,5,6,7").curves
        assert curve.rotations is not None
        assert curve.rotations[:, 2, 2] == pytest.approx(up)


def test_the_points_of_a_scan_are_said_to_be_in_no_order(tmp_path: Path) -> None:
    points = 0.3 * np.random.default_rng(0).random((400, 3))
    for name, order, scattered in (("scan", np.arange(400), True), ("path", None, False)):
        rows = points if order is not None else np.sort(points, axis=0)
        text = "\n".join(" ".join(map(str, row)) for row in rows)
        head = PCD.replace("POINTS 2", "POINTS 400")
        path = tmp_path / f"{name}.pcd"
        path.write_text(f"{head}DATA ascii\n{text}\n", encoding="utf-8")
        [note, *_] = read_toolpath(path).assumptions
        assert note.startswith("the points of the cloud are passed in the order of the file")
        assert ("no path's" in note) == scattered


def test_a_bag_has_its_only_path(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "part")
    turn = types["geometry_msgs/msg/Quaternion"](0.6, 0.0, 0.0, 0.8)

    def message(shift: float) -> object:
        at = [types["geometry_msgs/msg/Point"](0.1 * k + shift, 0.2, 0.3) for k in range(3)]
        found = [types["geometry_msgs/msg/Pose"](point, turn) for point in at]
        return types["geometry_msgs/msg/PoseArray"](header, found)

    kind = "geometry_msgs/msg/PoseArray"
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/tool_path", kind, typestore=store)
        for k in range(2):
            bag.write(topic, k, store.serialize_cdr(message(0.5 * k), kind))
    [path] = (tmp_path / "bag").glob("*.mcap")
    toolpath = read_toolpath(path)
    [curve] = toolpath.curves
    assert curve.positions == pytest.approx(np.array([[0.1 * k + 0.5, 0.2, 0.3] for k in range(3)]))
    assert curve.rotations is not None
    assert curve.rotations[0] @ [0, 0, 1] == pytest.approx([0.0, -0.96, 0.28])
    assert "the path is the topic /tool_path, the last of 2 messages." in toolpath.assumptions


def test_a_tangent_is_no_second_position(tmp_path: Path) -> None:
    path = tmp_path / "edge.csv"
    rows = "".join(f"{10 * k},0,4,0,0,1,1,0,0\n" for k in range(3))
    path.write_text(f"x,y,z,nx,ny,nz,tx,ty,tz\n{rows}", encoding="utf-8")
    toolpath = read_toolpath(path)
    assert toolpath.meaning == "normal"
    assert toolpath.passed_over == ("not used: column 'tx', column 'ty', column 'tz'.",)
    assert toolpath.curves[0].positions[2] == pytest.approx(np.array([0.02, 0.0, 0.004]))


def test_a_speed_holds_until_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "points_xyzs.csv"
    path.write_text("10,0,0,20\n20,0,0,\n30,0,0,40\n40,0,0,\n", encoding="utf-8")
    [curve] = read_toolpath(path).curves
    assert curve.feeds is not None
    assert curve.feeds[1:] == pytest.approx([0.02, 0.04, 0.04])


def test_a_header_of_numbers_and_a_count_are_no_points(tmp_path: Path) -> None:
    rows = "".join(f"{k},{10.5 * k},{0.25 * k},4.5\n" for k in range(3))
    for first in (",0,1,2\n", ""):
        path = tmp_path / "pandas.csv"
        path.write_text(first + rows, encoding="utf-8")
        [curve] = read_toolpath(path).curves
        assert len(curve) == 3
        assert curve.positions[1] == pytest.approx(np.array([10.5, 0.25, 4.5]) * 1e-3)


def test_large_files_are_read_in_time(tmp_path: Path) -> None:
    import time

    points = np.random.default_rng(1).random((4_000, 3)).tolist()
    path = tmp_path / "points.json"
    path.write_text(json.dumps(points, indent=0), encoding="utf-8")
    began = time.perf_counter()
    assert sum(map(len, read_toolpath(path).curves)) == 4_000
    assert time.perf_counter() - began < 20.0  # 20,000 lines; about 1 s on an idle machine
