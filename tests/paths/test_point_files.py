"""Tables, point clouds, poses and bags that are refused, or read with a warning."""

from pathlib import Path
from typing import Any

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
        ("a.yaml", "".join(
            f"- header: {{frame_id: '{frame}'}}\n  pose: {{position: {{x: {k}, y: 2, z: 3}}}}\n"
            for k, frame in enumerate(("base", "tool", "base"))), "are in frames base and tool"),
        ("a.yaml", "".join(
            f"- header:\n    frame_id:\n      {frame}\n  pose: {{x: {k}, y: 2, z: 3}}\n"
            for k, frame in enumerate(("base", "tool", "base"))), "are in frames base and tool"),
        ("a.yaml", "- {x: 0, y: 0, z: 0}\n- {x: 1, y: 0, x: 5, z: 0}\n", "line 2: x stands twice"),
        ("a.yaml", "- {x: 0, y: 0, z: 0}\n- {x: 1, y: 0, z: 0, motion_type: MoveJ}\n",
         "line 2: motion_type: MoveJ may be a rapid motion"),
        ("a.json", '[{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0, "rapid": true}]',
         "line 1: rapid: true may be a rapid motion"),
        ("a.csv", "header.frame_id,x_m,y_m,z_m\na,0,0,0\nb,1,0,0\n", "are in frames a and b"),
        ("a.csv", "x_mm,y_mm,z_mm,tx,ty,tz\n0,0,0,1,0,0\n9,0,0,1,0,0\n", "which no column states"),
        ("a.txt", "transforms:\n- child_frame_id: tool\n", "TF. are those of all frames"),
        ("a.db3", "SQLite format 3\0", "its content cannot be read"),
        ("a.bag", "#ROSBAG V1.2\n", "rosbags-convert writes it anew"),
        ("a.bag", "#ROSBAG V2.0\n", "the bag has no messages with poses"),
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


def ros_message(store: Any, kind: str, shift: float, first: str = "part") -> Any:
    """A path of three poses, or the first of them, which has a frame of its own."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](1, 2)
    header_type = types["std_msgs/msg/Header"]
    number = [7] if "seq" in header_type.__dataclass_fields__ else []
    header, own = (header_type(*number, stamp, frame) for frame in ("part", first))
    turn = types["geometry_msgs/msg/Quaternion"](0.6, 0.0, 0.0, 0.8)
    at = [types["geometry_msgs/msg/Point"](0.1 * k + shift, 0.2, 0.3) for k in range(3)]
    poses = [types["geometry_msgs/msg/Pose"](point, turn) for point in at]
    if kind == "geometry_msgs/msg/PoseArray":
        return types[kind](header, poses)
    stamped = [
        types["geometry_msgs/msg/PoseStamped"](header if k else own, pose)
        for k, pose in enumerate(poses)
    ]
    if kind == "nav_msgs/msg/Path":
        return types[kind](header, stamped)
    covered = types["geometry_msgs/msg/PoseWithCovariance"](poses[0], np.zeros(36))
    if kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return types[kind](header, covered)
    return stamped[0]


KINDS = ["geometry_msgs/msg/PoseArray", "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped",
         "geometry_msgs/msg/PoseWithCovarianceStamped"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("container", ["mcap", "db3", "bag", "bz2"])
def test_a_bag_has_its_only_path(tmp_path: Path, container: str, kind: str) -> None:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    ros_2 = container in ("mcap", "db3")
    store = get_typestore(Stores.ROS2_HUMBLE if ros_2 else Stores.ROS1_NOETIC)
    path = tmp_path / "bag"
    if ros_2:
        pytest.importorskip("mcap")
        storage = (
            rosbag2.StoragePlugin.MCAP if container == "mcap" else rosbag2.StoragePlugin.SQLITE3
        )
        writer: Any = rosbag2.Writer(path, version=9, storage_plugin=storage)
        serialize = store.serialize_cdr
    else:
        writer = rosbag1.Writer(path)
        serialize = store.serialize_ros1
        if container == "bz2":
            writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
    with writer as bag:
        topic = bag.add_connection("/tool_path", kind, typestore=store)
        for k in range(2):
            bag.write(topic, k, serialize(ros_message(store, kind, 0.5 * k), kind))
    file = next(path.glob(f"*.{container}")) if ros_2 else path
    toolpath = read_toolpath(file)
    [curve] = toolpath.curves
    assert curve.rotations is not None
    assert curve.rotations[0] @ [0, 0, 1] == pytest.approx([0.0, -0.96, 0.28])
    if kind in KINDS[:2]:
        expected, last = [0.5, 0.6, 0.7], ", the last of 2 messages"
    else:
        expected, last = [0.0, 0.5], ""
    assert curve.positions == pytest.approx(np.array([[x, 0.2, 0.3] for x in expected]))
    note = f"the path is the topic /tool_path in the frame part{last}."
    assert note in toolpath.assumptions


@pytest.mark.parametrize("kind", [KINDS[1], KINDS[2]])
def test_poses_of_a_bag_in_several_frames_are_refused(tmp_path: Path, kind: str) -> None:
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    path = tmp_path / "bag"
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        topic = bag.add_connection("/p", kind, typestore=store)
        for k, frame in enumerate(("tool", "part", "tool")):
            message = ros_message(store, kind, 0.5 * k, frame)
            bag.write(topic, k, store.serialize_cdr(message, kind))
    with pytest.raises(InvalidInput, match="poses of /p are in frames tool and part"):
        read_toolpath(next(path.glob("*.db3")))


@pytest.mark.parametrize(
    ("names", "second"), [("tx,ty,tz", (1, 0, 0)), ("tangent_x,tangent_y,tangent_z", (3, 0, 1)),
                          ("y_axis_x,y_axis_y,y_axis_z", (0, 2, 0))],
)  # fmt: skip
@pytest.mark.parametrize("first", ["nx,ny,nz", "i,j,k"])
def test_a_second_axis_beside_the_first_is_the_roll(
    tmp_path: Path, names: str, second: tuple[int, ...], first: str
) -> None:
    path = tmp_path / "edge.csv"
    tail = ",".join(map(str, second))
    rows = "".join(f"{10 * k},0,4,0,0,2,{tail}\n" for k in range(3))
    path.write_text(f"x,y,z,{first},{names}\n{rows}", encoding="utf-8")
    toolpath = read_toolpath(path)
    assert toolpath.meaning == ("normal" if first[0] == "n" else "axis")
    [curve] = toolpath.curves
    assert curve.positions[2] == pytest.approx(np.array([0.02, 0.0, 0.004]))
    # Made perpendicular to the first axis, x or y is the second one.
    assert curve.rotations == pytest.approx(np.array([np.eye(3)] * 3))
    with pytest.raises(InvalidInput, match=r"line 3.*second axis is zero, or parallel"):
        path.write_text(path.read_text().replace(f"10,0,4,0,0,2,{tail}", "10,0,4,0,0,2,0,0,1"))
        read_toolpath(path)


def test_lead_and_tilt_lean_the_tool_from_the_normal(tmp_path: Path) -> None:
    """Along x with z up the tool leans by lead towards x, and by tilt to the left, which is y."""
    path = tmp_path / "lean.csv"
    rows = "".join(f"{10 * k},0,4,0,0,1,{lean}\n" for k, lean in enumerate(("30,0", "0,20", "0,0")))
    path.write_text(f"x,y,z,nx,ny,nz,lead,tilt\n{rows}", encoding="utf-8")
    toolpath = read_toolpath(path)
    assert toolpath.meaning == "axis"
    lead, tilt = np.radians([30.0, 20.0])
    expected = [[np.sin(lead), 0, np.cos(lead)], [0, np.sin(tilt), np.cos(tilt)], [0, 0, 1]]
    assert toolpath.curves[0].vectors == pytest.approx(np.array(expected))
    assert any("leans from the normal" in note for note in toolpath.assumptions)
    path.write_text(path.read_text().replace("30,0", "95,0"))
    with pytest.raises(InvalidInput, match="below 90 degrees"):
        read_toolpath(path)


def test_axes_that_point_into_the_part_are_turned_round(tmp_path: Path) -> None:
    path = tmp_path / "down.csv"
    rows = "".join(f"{10 * k},0,4,0,0.6,-0.8,1,0,0\n" for k in range(3))
    path.write_text(f"x,y,z,nx,ny,nz,tx,ty,tz\n{rows}", encoding="utf-8")
    toolpath = read_toolpath(path)
    assert any("--axes-point into turns them round" in note for note in toolpath.assumptions)
    turned = read_toolpath(path, axes_point="into")
    assert toolpath.curves[0].axes == pytest.approx(-turned.curves[0].axes)
    assert turned.curves[0].rotations is not None
    assert turned.curves[0].rotations[0, :, 0] == pytest.approx([1.0, 0.0, 0.0])
    assert not any("axes-point" in note for note in turned.assumptions)
    # The tool leans the same way, whichever way the normals are written.
    lean = "x,y,z,nx,ny,nz,lead,tilt\n" + "".join(
        f"{10 * k},0,4,0,0,{{}},30,10\n" for k in range(3)
    )
    path.write_text(lean.format(1, 1, 1))
    out = read_toolpath(path)
    path.write_text(lean.format(-1, -1, -1))
    into = read_toolpath(path, axes_point="into")
    assert into.curves[0].axes == pytest.approx(out.curves[0].axes)
    path.write_text("x,y,z\n10,0,4\n20,0,4\n")
    with pytest.raises(InvalidInput, match="axes_point: there are no tool axes or normals"):
        read_toolpath(path, axes_point="into")
    path = tmp_path / "flat.nc"
    path.write_text("G21 G90\nG1 X0 Y0 Z0 F100\nX10\n")
    with pytest.raises(InvalidInput, match="axes_point: the file states no tool axes"):
        read_toolpath(path, axes_point="into")


@pytest.mark.parametrize(
    ("axes", "into", "expected"),
    [
        ({"n": "0,0,1", "x": "1,0,0", "y": "0,-1,0"}, False, "x, y and normal are left-handed"),
        ({"n": "0,0,1", "x": "1,0,0", "y": "0,-1,0"}, True, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ({"n": "0,0,1", "x": "1,0,0", "y": "0,1,0"}, True, 'Then axes_point = "out"'),
        ({"n": "0,0,1", "x": "0,1,0", "y": "-1,0,0"}, False, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ({"n": "0,0,-1", "y": "0,-1,0"}, True, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ({"x": "0,1,0", "y": "-1,0,0", "z": "0,0,1"}, False, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    ],
)
def test_axes_of_a_frame_are_those_of_the_file(
    tmp_path: Path, axes: dict[str, str], into: bool, expected: str | list[list[int]]
) -> None:
    path = tmp_path / "frames.csv"
    names = [f"{k}{c}" if k == "n" else f"{k}axis_{c}" for k in axes for c in "xyz"]
    rows = "".join(f"{10 * k},0,0,{','.join(axes.values())}\n" for k in range(3))
    path.write_text(f"x_mm,y_mm,z_mm,{','.join(names)}\n{rows}", encoding="utf-8")
    if isinstance(expected, str):
        with pytest.raises(InvalidInput, match=f"line 2: .*{expected}"):
            read_toolpath(path, axes_point="into" if into else None)
        return
    toolpath = read_toolpath(path, axes_point="into" if into else None)
    [curve] = toolpath.curves
    assert curve.rotations is not None
    found = curve.rotations[0].T
    assert found == pytest.approx(np.array(expected))
    assert ("roll of the waypoints" in " ".join(toolpath.notes)) == ("n" in axes)


def test_a_column_of_motions_parts_rapid_ways_from_cuts(tmp_path: Path) -> None:
    path = tmp_path / "moves.csv"
    moves = [("G0", 0, 50), ("G0", 0, 0), ("G1", 30, 0), ("G1", 60, 0), ("G00", 60, 50),
             ("G0", 0, 40), ("G01", 10, 40), ("G0", 10, 50)]  # fmt: skip
    rows = "".join(f"{kind},{x},0,{z}\n" for kind, x, z in moves)
    path.write_text(f"type,x_mm,y_mm,z_mm\n{rows}", encoding="utf-8")
    first, second = read_toolpath(path).curves
    assert (1e3 * first.positions[:, 0]).tolist() == pytest.approx([0, 30, 60])
    assert (1e3 * second.positions[:, 0]).tolist() == pytest.approx([0, 10])
    assert first.before is not None and second.before is not None and second.after is not None
    assert second.before.lines.tolist() == [6]
    with pytest.raises(InvalidInput, match=r"line 4, column 'type': an arc"):
        path.write_text(path.read_text().replace("G1,30", "G2,30"))
        read_toolpath(path)


def test_a_second_axis_that_turns_back_is_said(tmp_path: Path) -> None:
    path = tmp_path / "zigzag.csv"
    rows = "".join(f"{10 * k},0,4,0,0,1,{(1, 1, -1, -1, 1)[k]},0,0\n" for k in range(5))
    path.write_text(f"x_mm,y_mm,z_mm,nx,ny,nz,tx,ty,tz\n{rows}", encoding="utf-8")
    notes = " ".join(read_toolpath(path).notes)
    assert "turn by more than 90 degrees from a point to the next (line 4 and 1 more)" in notes


@pytest.mark.parametrize(
    ("types", "expected"),
    [
        ("G0,G1,,G0,,G1", ""),
        ("0,1,1,0,0,1", "0 is read as G0, a rapid motion, and 1 as G1, a cut"),
        ("0.0,1.0,,0.0,,1.0", "0 is read as G0"),
        ("J,L,L,J,J,L", ""),
        ("T,P,P,T,T,P", ""),
        (
            "G0,G1,seam,G0,G0,G1",
            "line 4, column 'type': 'seam' is no type of motion.* leave it out",
        ),
        ("G0,G1,2,G0,G0,G1", "line 4, column 'type': an arc.* leave it out"),
        ("a,b,b,a,a,b", "line 2, column 'type': 'a' is no type of motion.* leave it out"),
        ("a,a,a,a,a,a", "not used: column 'type'"),
        ("1,2,3,4,5,6", "not used: column 'type'"),
    ],
)
def test_types_of_motions_are_all_known_or_all_the_same(
    tmp_path: Path, types: str, expected: str
) -> None:
    path = tmp_path / "moves.csv"
    at = [(0, 50), (0, 0), (10, 0), (10, 50), (20, 50), (20, 0)]
    rows = zip(at, types.split(","), strict=True)
    text = "".join(f"{x},0,{z},{kind}\n" for (x, z), kind in rows)
    path.write_text(f"x_mm,y_mm,z_mm,type\n{text}", encoding="utf-8")
    if expected.startswith("line"):
        with pytest.raises(InvalidInput, match=expected):
            read_toolpath(path)
        return
    toolpath = read_toolpath(path)
    if expected.startswith("not"):
        assert len(toolpath.curves) == 1
    else:
        assert [c.lines.tolist() for c in toolpath.curves] == [[2, 3, 4], [6, 7]]
    assert expected in " ".join(toolpath.notes)


@pytest.mark.parametrize(
    ("header", "rows", "options", "expected"),
    [
        ("nx,ny,nz,lead,type", ["0,0,1,10,G0", *["0,0,1,10,G1"] * 2] * 2, {}, "lean"),
        ("nx,ny,nz,lead [rad]", ["0,0,1,0.17453293"] * 6, {}, "in radians"),
        ("nx,ny,nz,lead", ["0,0,1,0.17453293"] * 6, {"angle_unit": "rad"}, "in radians"),
        ("nx,ny,nz,lead", ["0,0,1,10"] * 6, {}, "in degrees"),
        ("i,j,k,lead,tilt", ["0,0,1,10,0"] * 6, {}, "not used: column 'lead', column 'tilt'"),
    ],
)
def test_a_lean_is_that_of_each_cut_in_its_unit(
    tmp_path: Path, header: str, rows: list[str], options: dict[str, Any], expected: str
) -> None:
    """Two cuts there and back, which the first table parts by a rapid motion."""
    path = tmp_path / "lean.csv"
    at = [(0, 0), (10, 0), (20, 0), (20, 50), (10, 50), (0, 50)]
    text = "".join(f"{x},{y},0,{row}\n" for (x, y), row in zip(at, rows, strict=True))
    path.write_text(f"x_mm,y_mm,z_mm,{header}\n{text}", encoding="utf-8")
    toolpath = read_toolpath(path, **options)
    assert expected in " ".join(toolpath.notes)
    ahead = 0.0 if header.startswith("i") else np.sin(np.radians(10.0))
    axes = np.concatenate([curve.axes for curve in toolpath.curves])
    assert axes[0] == pytest.approx([ahead, 0.0, np.sqrt(1.0 - ahead**2)])
    assert axes[-1] == pytest.approx([-ahead, 0.0, np.sqrt(1.0 - ahead**2)])
    if "type" in header:
        assert axes[2] == pytest.approx(axes[0]) and axes[3] == pytest.approx(axes[-1])


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


def test_times_beyond_all_numbers_are_no_times_and_end_in_no_warning(tmp_path: Path) -> None:
    """TUM's ``t x y z qx qy qz qw`` with two exponents that are slips."""
    pose = "0.7 {} 0.4 -0.7057879 0.7068645 -0.0185099 -0.0431678"
    path = tmp_path / "a.tum"
    path.write_text(
        "".join(
            f"{t} {pose.format(k / 10)}\n" for k, t in enumerate(("1e400", "1e500", "1305000002.0"))
        )
    )
    [curve] = read_toolpath(path).curves
    assert curve.positions[:, 1] == pytest.approx([0.0, 0.1, 0.2])
