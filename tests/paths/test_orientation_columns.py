"""Tables whose columns state orientations as robots and their makers do."""

from collections.abc import Sequence
from pathlib import Path

import mink
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.cli import main
from qp_twist.errors import InvalidInput
from qp_twist.paths import ColumnChoice, Orientation, UnclearColumns, load_task, read_toolpath

ANGLES = np.array([[180.0, 10.0, 0.0], [171.0, -35.0, 5.0], [-20.0, 50.0, 110.0]])
"""Three angles of each row, degrees."""


def turned_one_by_one(*turns: tuple[str, float]) -> Array:
    """A product of rotations about coordinate axes, the left-most first, degrees."""
    found = mink.SO3.identity()
    for axis, degrees in turns:
        found = found @ getattr(mink.SO3, f"from_{axis}_radians")(np.radians(degrees))
    return found.as_matrix()


def table(
    folder: Path,
    names: str,
    values: Sequence[Sequence[float]] | Array,
    position: str = "x [mm],y [mm],z [mm]",
) -> Path:
    path = folder / "poses.csv"
    rows = [[600, 50 * k, 400, *row] for k, row in enumerate(np.asarray(values).tolist())]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(f"{position},{names}\n{text}\n", encoding="utf-8")
    return path


def rotations(path: Path, **options: object) -> Array:
    [curve] = read_toolpath(path, **options).curves  # type: ignore[arg-type]
    assert curve.rotations is not None
    return curve.rotations


QUATERNIONS = Rotation.from_euler("xyz", ANGLES, degrees=True).as_quat()  # x, y, z, w
VECTORS = Rotation.from_euler("xyz", ANGLES, degrees=True).as_rotvec()


@pytest.mark.parametrize(
    ("names", "axes"),
    [("A [deg],B [deg],C [deg]", "zyx"), ("a,b,c", "zyx"), ("A,B,C", "zyx"),
     ("tcp_a,tcp_b,tcp_c", "zyx"), ("W [deg],P [deg],R [deg]", "xyz"), ("w,p,r", "xyz")],
)  # fmt: skip
def test_angles_are_read_by_the_letters_of_their_maker(
    tmp_path: Path, names: str, axes: str
) -> None:
    """R = Rz(A) Ry(B) Rx(C) of KUKA, R = Rz(R) Ry(P) Rx(W) of FANUC."""
    path = table(tmp_path, names, ANGLES)
    about = [dict(zip(axes, row, strict=True)) for row in ANGLES]
    expected = [turned_one_by_one(*((axis, row[axis]) for axis in "zyx")) for row in about]
    assert rotations(path) == pytest.approx(np.array(expected), abs=1e-12)
    maker = "KUKA" if axes == "zyx" else "FANUC"
    assert any(maker in note for note in read_toolpath(path).notes)


@pytest.mark.parametrize(
    ("names", "order"),
    [
        ("q1,q2,q3,q4", (3, 0, 1, 2)),
        ("q0,q1,q2,q3", (3, 0, 1, 2)),
        ("quat_1,quat_2,quat_3,quat_4", (3, 0, 1, 2)),
        ("ROT_X,ROT_Y,ROT_Z,ROT_W", (0, 1, 2, 3)),
        ("rx,ry,rz,rw", (0, 1, 2, 3)),
        ("rotation.w,rotation.x,rotation.y,rotation.z", (3, 0, 1, 2)),
        ("orientation.x,orientation.y,orientation.z,orientation.w", (0, 1, 2, 3)),
    ],
)
def test_quaternions_are_read_by_the_order_of_their_names(
    tmp_path: Path, names: str, order: tuple[int, ...]
) -> None:
    expected = [mink.SO3(q[[3, 0, 1, 2]]).as_matrix() for q in QUATERNIONS]
    found = rotations(table(tmp_path, names, QUATERNIONS[:, list(order)]))
    assert found == pytest.approx(np.array(expected), abs=1e-12)


def test_rotation_vectors_are_read_where_they_are_named_or_chosen(tmp_path: Path) -> None:
    expected = np.array([mink.SO3.exp(v).as_matrix() for v in VECTORS])
    named = table(tmp_path, "rotvec_x,rotvec_y,rotvec_z", VECTORS)
    assert rotations(named) == pytest.approx(expected, abs=1e-12)
    in_degrees = table(tmp_path, "rv_x [deg],rv_y [deg],rv_z [deg]", np.degrees(VECTORS))
    assert rotations(in_degrees) == pytest.approx(expected, abs=1e-12)
    open_ = table(tmp_path, "rx,ry,rz", 0.5 * VECTORS)
    expected = np.array([mink.SO3.exp(0.5 * v).as_matrix() for v in VECTORS])
    with pytest.raises(InvalidInput, match=r'orientation = "rotation_vector" if they are axis'):
        read_toolpath(open_)
    assert rotations(open_, orientation="rotation_vector") == pytest.approx(expected, abs=1e-12)
    columns = ColumnChoice(rotation_vector=("rx", "ry", "rz"))
    assert rotations(open_, columns=columns) == pytest.approx(expected, abs=1e-12)
    roll_pitch_yaw = rotations(open_, orientation="rpy", angle_unit="rad")
    assert roll_pitch_yaw == pytest.approx(
        np.array([mink.SO3.from_rpy_radians(*v / 2).as_matrix() for v in VECTORS]), abs=1e-12
    )


def test_rx_ry_rz_are_what_their_numbers_leave(tmp_path: Path) -> None:
    """No vector of a controller is longer than half a turn, and nobody writes one in degrees."""
    angles = np.array([[180.0, 0.0, 80.0], [-179.0, 2.0, 90.0]])
    as_angles = np.array([mink.SO3.from_rpy_radians(*np.radians(a)).as_matrix() for a in angles])
    assert rotations(table(tmp_path, "rx,ry,rz", angles)) == pytest.approx(as_angles, abs=1e-12)
    bare = table(tmp_path, "rx,ry,rz", np.radians(angles))  # above pi, and a half turn among them
    assert rotations(bare) == pytest.approx(as_angles, abs=1e-12)
    down = np.array([[2.2, 2.2, 0.0], [2.2, 2.2, 0.05], [1.9, 2.4, 0.0]])
    vectors = table(tmp_path, "rx,ry,rz", down)
    expected = np.array([mink.SO3.exp(v).as_matrix() for v in down])
    assert rotations(vectors) == pytest.approx(expected, abs=1e-12)
    assert any("Universal Robots" in note for note in read_toolpath(vectors).assumptions)


def test_a_rotation_matrix_has_nine_names(tmp_path: Path) -> None:
    turns = Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix()
    names = ",".join(f"r{i}{j}" for i in "123" for j in "123")
    assert rotations(table(tmp_path, names, turns.reshape(-1, 9))) == pytest.approx(turns)
    with pytest.raises(InvalidInput, match="the matrix is no rotation"):
        read_toolpath(table(tmp_path, names, 2.0 * turns.reshape(-1, 9)))


SMALL = [[0.1, 0.2, 0.3], [0.2, 0.3, 0.4]]
UNIT_3 = [[0.0, 0.6, 0.8], [0.0, 0.8, 0.6]]


@pytest.mark.parametrize(
    ("names", "values", "message"),
    [
        ("a,b,c", SMALL, r"the unit of column 'a'.*|the unit of column 'c'.* angle_unit"),
        ("a,b,c", UNIT_3, r"like KUKA's A, B, C.* length is 1, like that of a direction"),
        ("a,b,c", [[0, 10, 400], [0, 10, 410]], "is 410, more than 360 degrees"),
        ("b [deg],c [deg]", [[10, 20], [20, 30]], "2 of 3 columns of one A B C"),
        ("c [deg]", [[20], [30]], "are angles and may state an orientation"),
        ("rx,ry", [[1, 2], [2, 3]], "2 of 3 columns of one angles"),
        ("q1,q2,q3,q4", [[1, 2, 3, 4], [2, 3, 4, 5]], "named like a quaternion.*length is not 1"),
        ("u,v,w", UNIT_3, r"have the length 1.* position = \[1, 2, 3\], normal = \[4, 5, 6\]"),
        ("s,u,v,w", QUATERNIONS, r"quaternion_wxyz = \[4, 5, 6, 7\]"),
        ("s1 [deg],s2 [deg],s3 [deg]", ANGLES, r"are angles .* rpy = \[4, 5, 6\]"),
        ("alpha,beta,gamma", ANGLES, "roll, pitch, yaw or a rotation vector"),
        ("r11,r12,r13", [[1, 0, 0]] * 2, "3 of 9 columns of one matrix"),
        ("i,j,k,a,b,c", [[0, 0, 1, 10, 20, 30]] * 2, 'axis and A B C; add orientation = "axis"'),
        ("w,p,r,a,b,c", [[10, 20, 30, 10, 20, 30]] * 2, r"say in \[path.columns\].* which count"),
    ],
)  # fmt: skip
def test_an_orientation_that_is_open_is_asked_for_and_never_left_out(
    tmp_path: Path, names: str, values: Sequence[Sequence[float]], message: str
) -> None:
    path = table(tmp_path, names, values)
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(path)
    assert read_toolpath(path, orientation="none").meaning == "none"


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("q1,q2,q3,q4,q5,q6", [[0, 0.6, 0, 0.8, 1, 2]] * 2),
        ("a,i,feed,speed", [[1, 1, 0, 0]] * 2),
        ("theta", [[0.5]] * 2),
    ],
)
def test_joints_and_single_letters_are_no_orientation(
    tmp_path: Path, names: str, values: Sequence[Sequence[float]]
) -> None:
    path = table(tmp_path, names, [[*row] for row in values])
    if names.startswith("q1"):
        with pytest.raises(UnclearColumns, match="have the length 1"):
            read_toolpath(path)
        path = table(tmp_path, names, [[0, 30, 0, 40, 1, 2]] * 2)
    toolpath = read_toolpath(path)
    assert toolpath.meaning == "none"
    assert any(note.startswith("not used") for note in toolpath.notes)


@pytest.mark.parametrize(
    ("rows", "separator"),
    [
        (("1.200,5;-50,0;400,0", "1.200,5;50,0;400,0"), ";"),
        (("1,200.5;-50.0;400.0", "1,200.5;50.0;400.0"), ";"),
        (('"1,200.5","-50.0","400.0"', '"1,200.5","50.0","400.0"'), ","),
        (("1'200.5\t-50.0\t400.0", "1'200.5\t50.0\t400.0"), "\t"),
        (("1\u202f200,5;-50,0;400,0", "1\u202f200,5;50,0;400,0"), ";"),
    ],
)
def test_thousands_apart_are_read_where_a_decimal_mark_follows(
    tmp_path: Path, rows: tuple[str, str], separator: str
) -> None:
    path = tmp_path / "path.csv"
    names = separator.join(f"{axis} [mm]" for axis in "xyz")
    path.write_text("\n".join((names, *rows)) + "\n", encoding="utf-8")
    [curve] = read_toolpath(path).curves
    assert curve.positions == pytest.approx(np.array([[1.2005, -0.05, 0.4], [1.2005, 0.05, 0.4]]))


def test_new_asks_with_its_options_and_then_has_the_whole_pose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    vectors = np.array([[np.pi, 0.0, 0.0], [np.pi - 0.05, 0.0, 0.0]])
    table(tmp_path, "rx,ry,rz", vectors)
    given_ = ["new", "seven_axis_arm.xml", "--frame", "tool", "--path", "poses.csv"]
    with pytest.raises(SystemExit):
        main(given_)
    assert (
        "--orientation axis, normal, quaternion, rpy, rotation_vector, matrix or none"
        in capsys.readouterr().err
    )
    main([*given_, "--orientation", "rotation_vector"])
    capsys.readouterr()
    text = (tmp_path / "task.toml").read_text(encoding="utf-8")
    assert 'orientation = "rotation_vector"' in text
    assert "rank 6" in text
    main([*given_, "--orientation", "rotation_vector", "--roll", "free", "--force"])
    assert "roll: free, and drawn to that of the file" in capsys.readouterr().out
    free = load_task("./task.toml")
    assert free.projector.rank == 5 and free.settings("qp_gradient").secondary == "roll"


@pytest.mark.parametrize("orientation", ["axis", "normal", "quaternion", "rotation_vector"])
def test_an_orientation_that_the_file_lacks_is_refused(
    tmp_path: Path, orientation: Orientation
) -> None:
    path = table(tmp_path, "A [deg],B [deg],C [deg]", ANGLES)
    with pytest.raises(InvalidInput, match=f"orientation is '{orientation}'.* no such"):
        read_toolpath(path, orientation=orientation)
    assert read_toolpath(path, orientation="rpy").meaning == "rotation"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "# units: inch\nx,y,z\n1,0,3\n2,0,3\n"),
        ("a.csv", "# all values in inches\nx,y,z\n1,0,3\n2,0,3\n"),
        ("a.json", '{"unit":"inch","points":[[1,0,3],[2,0,3]]}'),
        ("a.yaml", "units: inch\nwaypoints:\n- {position: [1, 0, 3]}\n- {position: [2, 0, 3]}\n"),
        ("a.ply", "ply\nformat ascii 1.0\ncomment units inch\nelement vertex 2\nproperty float x\n"
         "property float y\nproperty float z\nend_header\n1 0 3\n2 0 3\n"),
    ],
)  # fmt: skip
def test_a_unit_beside_the_header_counts(tmp_path: Path, name: str, text: str) -> None:
    file = tmp_path / name
    file.write_text(text)
    (curve,) = read_toolpath(file).curves
    assert curve.positions == pytest.approx(0.0254 * np.array([[1, 0, 3], [2, 0, 3]]))
