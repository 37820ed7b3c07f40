"""Trajectory files: what is written is read back, and what other tools write is understood."""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.joint_paths import evenly, joint_path, slider

import qp_twist as qt
from qp_twist.trajectories import (
    TimedPath,
    csv_trajectory,
    read_trajectory,
    time_trajectory,
    write_trajectory,
)

Array = np.ndarray
ENDINGS = (".csv", ".npz", ".json")
"""Formats that hold everything; bags and programs have tests of their own."""
SEEDS = st.integers(0, 2**32 - 1)


@functools.cache
def timed(seed: int = 0, acceleration: float = 5.0) -> TimedPath:
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.normal(scale=0.1, size=(7, 3)), axis=0)
    return time_trajectory(joint_path(slider(3), q, evenly(7, 0.1), acceleration=acceleration))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_gives_back_the_rows(tmp_path: Path, ending: str, seed: int) -> None:
    trajectory = timed(seed)
    path = tmp_path / f"rows{ending}"
    assert write_trajectory(trajectory, path) == path
    rows = read_trajectory(path)
    assert rows.joint_names == ("slide_1", "slide_2", "slide_3")
    assert (rows.q == trajectory.q).all()
    assert rows.times == pytest.approx(trajectory.times, abs=1e-9)
    assert (rows.velocities == trajectory.velocities).all()
    assert rows.metadata["task"] == "rows"
    assert rows.metadata["interpolation"] == "cubic"
    assert rows.metadata["units"] == dict.fromkeys(rows.joint_names, "m")
    # The same motion between the rows, too.
    t = np.linspace(0.0, trajectory.times[-1], 50)
    assert rows.motion.at(t).q == pytest.approx(trajectory.at(t).q, abs=1e-7)


@pytest.mark.parametrize("ending", ENDINGS)
def test_straight_pieces_have_no_velocities_and_no_clock_no_times(
    ending: str, tmp_path: Path
) -> None:
    straight = timed(acceleration=np.inf)
    rows = read_trajectory(write_trajectory(straight, tmp_path / f"straight{ending}"))
    assert rows.velocities is None
    assert rows.times == pytest.approx(straight.times)
    untimed = read_trajectory(write_trajectory(straight.trajectory, tmp_path / f"rows{ending}"))
    assert untimed.times is None
    assert (untimed.q == straight.q).all()


@pytest.mark.parametrize("ending", ENDINGS)
def test_no_file_names_the_machine(ending: str, tmp_path: Path) -> None:
    task = qt.load_task("planar_line")
    short = qt.follow(task, "qp_minimum_norm", stop=lambda *_: True)
    path = write_trajectory(short, tmp_path / f"line{ending}")
    metadata = read_trajectory(path).metadata
    assert metadata["robot"] == "planar_3r.xml"
    assert str(task.scene.parent) not in json.dumps(metadata)
    assert str(task.scene.parent).encode() not in path.read_bytes()


def test_the_json_has_the_fields_of_a_joint_trajectory(tmp_path: Path) -> None:
    trajectory = timed()
    document = json.loads(write_trajectory(trajectory, tmp_path / "t.json").read_text("utf-8"))
    assert list(document) == ["header", "joint_names", "points", "metadata"]
    assert document["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    for k, point in enumerate(document["points"]):
        assert set(point) == {
            *("positions", "velocities", "accelerations", "effort", "time_from_start")
        }
        stamp = point["time_from_start"]
        assert isinstance(stamp["sec"], int)
        assert 0 <= stamp["nanosec"] < 10**9
        assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(trajectory.times[k])
    [first] = document["metadata"]["projectors"]
    assert first == {"first_row": 1, "linear": "full", "angular": "none", "frame": "world"}


def test_the_csv_is_read_by_any_reader_of_csv(tmp_path: Path) -> None:
    trajectory = timed()
    text = write_trajectory(trajectory, tmp_path / "t.csv").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    head, *rows = csv.reader(lines)
    assert head[:3] == ["row", "time [s]", "slide_1 [m]"]
    assert head[5] == "slide_1 velocity [m/s]"
    assert [float(row[2]) for row in rows] == trajectory.q[:, 0].tolist()


BITS = ["joint", "_", "1", " ", ",", '"', "[", "]", "(", "#", "%", ";", ".", "/", "-", "velocity",
        "vel", "pos", "time", "deg", "rad", "m", "s", "é", "\u2028"]  # fmt: skip
NAMES = st.lists(st.sampled_from(BITS), min_size=1, max_size=4).map("".join)


@given(
    st.lists(NAMES.filter(lambda name: name.strip() == name), min_size=1, max_size=3, unique=True),
    st.booleans(), st.booleans(), SEEDS,
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_any_names_of_joints_go_through_a_table(
    names: list[str], timed: bool, cubic: bool, seed: int
) -> None:
    q = np.random.default_rng(seed).normal(size=(2, len(names)))
    units = dict(zip(names, ["rad", "m", "rad"], strict=False))
    metadata = {"units": units, "task": "a title\u2028of two lines", "method": "any"}
    written = TimedPath(
        tuple(names), q, np.array([0.0, 0.1]) if timed else None, -q if timed and cubic else None,
        metadata,
    )  # fmt: skip
    rows = csv_trajectory.decode(csv_trajectory.encode(written).encode(), None)
    assert rows.joint_names == written.joint_names
    assert rows.metadata == metadata
    assert (rows.q == q).all()
    assert (rows.times is not None) == timed
    assert (rows.velocities is not None) == (timed and cubic)
    assert rows.velocities is None or (rows.velocities == -q).all()


# ---------------------------------------------------------------- other tools' files

DEGREES = np.array([[10.0, -20.0], [30.0, 45.5]])


@pytest.mark.parametrize(
    "text",
    [
        "joint_1,joint_2\n{a[0]},{a[1]}\n{b[0]},{b[1]}\n",
        "\ufefftime;joint_2 [deg];joint_1 (deg)\n0;-20,0;10,0\n1;45,5;30,0\n",
        "# a robot\n\nt [ms]\tjoint_2_deg\tgripper\tjoint_1_deg\n0\t-20\topen\t10\n"
        "1000\t45.5\t\t30\n",
        "joint_1_deg joint_2_deg\n10 -20\n30 45.5\n",
        "time_s,joint_1_deg,joint_2_deg\n0,10,-20\n1,30,45.5\n",
        '"time_from_start","position_joint_1 [°]","position_joint_2 [°]"\n0, 10, -20\n'
        "1, 30, 45.5\n",
        "row,joint_1.pos [degrees],joint_2.pos [degrees],joint_1 torque\n1,10,-20,x\n2,30,45.5,y\n",
        "# joint_1_deg joint_2_deg\n10 -20\n30 45.5\n",
        "Cell 7\njoint_1;joint_2\ndeg;deg\n10;-20\n30;45,5\n",
        "gripper,joint_1_deg,joint_2_deg\nopen,10,-20\n,30,45.5\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_columns_are_found_by_name_in_any_order_and_unit(
    text: str, encoding: str, tmp_path: Path
) -> None:
    a, b = np.radians(DEGREES)
    path = tmp_path / "other.csv"
    mark = "\ufeff" if encoding == "utf-16" else ""  # has its own
    path.write_text(text.format(a=a, b=b).removeprefix(mark), encoding)
    rows = read_trajectory(path, ["joint_1", "joint_2"])
    assert rows.q == pytest.approx(np.radians(DEGREES), abs=1e-15)
    assert rows.velocities is None
    timed = any(name in text.splitlines()[-3:][0] for name in ("time", "t [ms]"))
    assert (rows.times is not None) == timed
    if timed:
        assert rows.times == pytest.approx([0.0, 1.0])


def test_numbers_without_a_unit_are_radians_up_to_two_turns(tmp_path: Path) -> None:
    path = tmp_path / "other.csv"
    path.write_text("joint_1,joint_2\n-12.5,0.3\n12.5,-3.1\n", "utf-8")
    assert read_trajectory(path).q.tolist() == [[-12.5, 0.3], [12.5, -3.1]]
    path.write_text("joint_1 [rad],joint_2 [rad]\n-125,0.3\n125,-3.1\n", "utf-8")
    assert read_trajectory(path).q[:, 0].tolist() == [-125, 125]


def test_velocities_of_other_tools_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "other.csv"
    path.write_text("time,vel_a [deg/s],a [deg],a_torque\n0,90,0,1\n1,180,45,1\n", "utf-8")
    rows = read_trajectory(path)
    assert rows.joint_names == ("a",)
    assert rows.q[:, 0] == pytest.approx([0.0, np.pi / 4])
    assert rows.velocities[:, 0] == pytest.approx([np.pi / 2, np.pi])


@pytest.mark.parametrize("unit", ["deg/s²", "deg/s^2", "deg/s2"])
def test_a_unit_says_that_a_column_holds_velocities(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "other.csv"
    path.write_text(f"time,a [deg],a [deg/s],a [{unit}]\n0,0,90,1\n1,45,180,1\n", "latin-1")
    rows = read_trajectory(path)
    assert rows.q[:, 0] == pytest.approx([0.0, np.pi / 4])
    assert rows.velocities[:, 0] == pytest.approx([np.pi / 2, np.pi])
    assert rows.accelerations[:, 0] == pytest.approx(np.radians([1.0, 1.0]))


def test_all_that_is_wrong_with_a_table_is_said_at_once(tmp_path: Path) -> None:
    path = tmp_path / "broken.csv"
    path.write_text("time,a,b\n0,1,2\n#N/A,1,2\n1,two,2\n2,1_0,2\n3,1\n4,1,2,3\n5,1,2\n")
    with pytest.raises(qt.InvalidInput) as refused:
        read_trajectory(path)
    said = str(refused.value).split("\n  ")
    assert said[0] == f"{path}: 5 problems:"
    assert [line.split(":")[0] for line in said[1:]] == [
        "line 3, column 'time'", "line 4, column 'a'", "line 5, column 'a'", "line 6, column 'b'",
        "line 7",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "stamp", [{"secs": 1, "nsecs": 500_000_000}, {"sec": 1, "nanosec": 500_000_000}, 1.5]
)
@pytest.mark.parametrize("around", [(), ("joint_trajectory",), ("goal", "trajectory")])
def test_messages_of_other_tools_are_understood(
    stamp: object, around: tuple[str, ...], tmp_path: Path
) -> None:
    document: dict[str, object] = {
        "joint_names": ["b", "a"],
        "points": [{"positions": [2, 1], "time_from_start": stamp}],
    }
    for key in reversed(around):
        document = {key: document}
    path = tmp_path / "message.json"
    path.write_text(json.dumps(document), "utf-8")
    rows = read_trajectory(path, ["a", "b"])
    assert rows.q.tolist() == [[1.0, 2.0]]
    assert rows.times.tolist() == [1.5]


def npy(array: Array) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(**arrays: Array) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def test_an_archive_of_another_tool_is_understood(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", positions=np.eye(2), time=np.array([0.0, 1.0]))
    rows = read_trajectory(tmp_path / "other.npz", ["a", "b"])
    assert (rows.q == np.eye(2)).all()
    with pytest.raises(qt.InvalidInput, match="'joint_names' that says which"):
        read_trajectory(tmp_path / "other.npz")


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("x.csv", "joint_1,joint_2\n1,2\n1,two\n", r"line 3, column 'joint_2': .*got 'two'"),
        (
            "x.csv",
            "# one\njoint_1,joint_2\n1\n",
            "line 3, .*'joint_2': the number is missing; .* 1 of 2",
        ),
        ("x.csv", "joint_1,joint_2\n1,nan\n", "line 2, column 'joint_2'"),
        ("x.csv", "1,2\n3,4\n", "line 1: expected the names of the columns"),
        ("x.csv", "joint_1\n", "expected a line of column names and rows"),
        ("x.csv", "joint_1 [furlong],joint_2\n1,2\n", "the unit 'furlong' is not known"),
        ("x.csv", "joint_1 [s],joint_2\n1,2\n", "column 'joint_1 .s.': the unit 's' is not known"),
        ("x.csv", "t [deg],joint_1\n1,2\n", "column 't .deg.': the unit 'deg' is not known"),
        (
            "x.csv",
            "joint_1,joint_2\n1,-85.7\n",
            "'joint_2' has no unit, and its numbers reach 85.7",
        ),
        (
            "x.csv",
            "joint_1 [deg],joint_2\n1,2\n",
            r"'joint_2' has no unit, and column 'joint_1 \[deg\]' is in degrees",
        ),
        (
            "x.csv",
            "t,joint_1_deg,joint_2_deg,vel_joint_1,vel_joint_2\n0,1,2,0,0\n1,1,2,0,0\n",
            r"'vel_joint_1' has no unit, .* vel_joint_1 \[deg/s\] or vel_joint_1 \[rad/s\]",
        ),
        ("x.csv", "joint_1,joint_2\none,two\n1,2\n", "line 2, column 'joint_1': .* got 'one'"),
        ("x.csv", "joint_1,other\n1,2\n", "no column for joint_2; it has joint_1"),
        ("x.csv", "joint_1,joint_1,joint_2\n1,2,3\n", "two columns hold the positions of joint_1"),
        ("x.csv", "a,b\n1,2\n", "none of the columns a, b is a joint"),
        ("x.csv", b"\xff\xfe\x00", "no text in UTF-8"),
        ("x.json", "{", "this is no JSON"),
        ("x.json", '{"points": []}', "expected the fields of trajectory_msgs/JointTrajectory"),
        ("x.json", '{"joint_names": ["joint_1"], "points": []}', "points not an empty one"),
        (
            "x.json",
            '{"joint_names": ["joint_1"], "points": [{"positions": [1]}, {"positions": [true]}]}',
            r"points\[1\].positions\[0\]: expected a finite number, got True",
        ),
        (
            "x.json",
            '{"joint_names": ["joint_1"], "points": [{"positions": [1, 2]}]}',
            r"points\[0\].positions: expected 1 numbers",
        ),
        (
            "x.json",
            '{"joint_names": ["joint_1"], "points": [{"positions": [1]}, {"positions": [2], '
            '"velocities": [1]}]}',
            r"points\[0\].velocities: expected 1 numbers, got None",
        ),
        (
            "x.json",
            '{"joint_names": ["joint_1"], "points": [{"positions": [1]}, {"positions": [2], '
            '"time_from_start": 1}]}',
            r"points\[0\].time_from_start: expected a finite number, got None",
        ),
        ("x.json", "[" * 100_000, "this is no JSON"),
        (
            "x.json",
            f'{{"joint_names": ["joint_1"], "points": [{{"positions": [1{"0" * 400}]}}]}}',
            r"points\[0\].positions\[0\]: expected a finite number, got inf",
        ),
        ("x.csv", 'joint_1,joint_2\n1,"' + "2" * 200_000, "line 2, .*'joint_2': expected a finite"),
        ("x.npz", "no archive", "this is no NumPy archive"),
        ("x.npz", npy(np.zeros((2, 2))), "this is no NumPy archive"),
        ("x.npz", npz(q=np.zeros((400, 2))).replace(b"q.npy", b"p.npy"), "no array 'q'"),
        ("x.txt", "", r"ends in .csv, .npz, .json"),
    ],
)
def test_what_cannot_be_read_is_a_sentence(
    name: str, content: str | bytes, sentence: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(qt.InvalidInput, match=sentence) as caught:
        read_trajectory(path, ["joint_1", "joint_2"])
    assert str(caught.value).startswith(str(path))


def test_an_archive_with_objects_in_it_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "evil.npz", q=np.array([{"a": 1}], dtype=object))
    with pytest.raises(qt.InvalidInput, match="no NumPy archive"):
        read_trajectory(tmp_path / "evil.npz")


def test_rows_that_do_not_fit_are_refused() -> None:
    with pytest.raises(qt.InvalidInput, match="stands twice"):
        TimedPath(("a", "a"), np.zeros((2, 2)))
    with pytest.raises(qt.InvalidInput, match="times"):
        TimedPath(("a",), np.zeros((2, 1)), np.zeros(3))
    with pytest.raises(qt.InvalidInput, match="expected a Trajectory"):
        write_trajectory("nothing", "x.csv")  # type: ignore[arg-type]


# ---------------------------------------------------------------- whole files


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "time,a,b,a velocity\n0,1,2,3\n1,1,2,3\n",
            "none of b; give those of all joints or of none",
        ),
        ("time,t,a,b\n0,0,1,2\n1,1,1,2\n", "two columns hold the time"),
        ("time,x,y\n0,1,2\n1,1,2\n", "none of the columns time, x, y is a joint of the robot; its"),
    ],
)
def test_a_table_that_says_less_than_it_seems_to_is_refused(
    text: str, sentence: str, tmp_path: Path
) -> None:
    file = tmp_path / "t.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(qt.InvalidInput, match=re.escape(sentence)):
        qt.read_trajectory(file, ["a", "b"])


@pytest.mark.parametrize("ending", [*ENDINGS, ".mcap"])
def test_accelerations_are_written_and_read_only_where_the_rows_have_them(
    ending: str, tmp_path: Path
) -> None:
    cubic = TimedPath.of(timed())
    back = read_trajectory(write_trajectory(cubic, tmp_path / f"cubic{ending}"))
    assert back.accelerations is None
    assert back.motion.interpolation == "cubic"
    a = np.random.default_rng(0).normal(size=cubic.q.shape)
    quintic = dataclasses.replace(cubic, accelerations=a)
    back = read_trajectory(write_trajectory(quintic, tmp_path / f"quintic{ending}"))
    assert back.accelerations == pytest.approx(a, abs=1e-15)
    assert back.motion.interpolation == "quintic"


def test_accelerations_without_velocities_define_no_curve(tmp_path: Path) -> None:
    file = qt.write_trajectory(qt.follow(qt.load_task("planar_line"), "minimum_norm"),
                               tmp_path / "t.json")  # fmt: skip
    text = file.read_text("utf-8")
    file.write_text(text.replace('"accelerations": []', '"accelerations": [1, 2, 3]'), "utf-8")
    with pytest.raises(qt.InvalidInput, match="accelerations, but no velocities"):
        qt.read_trajectory(file)
    # Of some rows only, neither.
    file.write_text(text.replace('"accelerations": []', '"accelerations": [1, 2, 3]', 1), "utf-8")
    with pytest.raises(qt.InvalidInput, match="accelerations: expected 3 numbers"):
        qt.read_trajectory(file)


def with_rail(path: Path, rail: Array, *, rate: bool = False) -> Path:
    """Two joints and a rail, from 0 to 1 s; or the rail's velocity in place of its positions."""
    rows = [[0.1, 0.2], [0.2, 0.3], [0.3, 0.4]]
    if path.suffix == ".csv":
        head = "time [s],joint_1 [rad],joint_2 [rad]," + ("rail velocity [m/s]" if rate else "rail")
        lines = [
            f"{0.5 * k},{q[0]},{q[1]},{x}" for k, (q, x) in enumerate(zip(rows, rail, strict=True))
        ]
        path.write_text("\n".join([head, *lines]), "utf-8")
        return path
    full = np.column_stack([rows, rail])
    return write_trajectory(
        TimedPath(("joint_1", "joint_2", "rail"), full, 0.5 * np.arange(3.0),
                  metadata={"units": {}, "task": "", "method": ""}), path)  # fmt: skip


@pytest.mark.parametrize("ending", [".csv", ".json", ".npz", ".mcap"])
def test_an_axis_that_the_robot_lacks_has_to_stand_still(ending: str, tmp_path: Path) -> None:
    names = ["joint_1", "joint_2"]
    moving = with_rail(tmp_path / f"moving{ending}", np.array([0.0, 1.0, 3.0]))
    with pytest.raises(qt.InvalidInput, match=r"rail moves by 3 .*no such joint"):
        read_trajectory(moving, names)
    still = read_trajectory(with_rail(tmp_path / f"still{ending}", np.full(3, 0.7)), names)
    assert still.joint_names == ("joint_1", "joint_2")
    assert [note for note in still.notes if note.startswith("rail stands still")]
