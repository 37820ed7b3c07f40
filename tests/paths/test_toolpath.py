"""Toolpath files: tables in every dialect, APT-CL, and what is said of a broken one."""

import math
from pathlib import Path

import mink
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths import MOST, ColumnChoice, Orientation, UnclearColumns, read_toolpath

QUICK = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
PER_METRE = {"m": 1.0, "mm": 1000.0, "inch": 1 / 0.0254}


def write(folder: Path, text: str, name: str = "path.csv", *, encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


# ---------------------------------------------------------------- tables


@QUICK
@given(st.data())
def test_a_table_in_any_dialect_reads_back_as_it_was_written(  # noqa: PLR0915
    tmp_path: Path, data: st.DataObject
) -> None:
    """Numbers, curves and names go through random delimiters, units, orders and line ends."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    delimiter = data.draw(st.sampled_from([",", ";", "\t", "  "]))
    decimal = "." if delimiter == "," else data.draw(st.sampled_from([".", ","]))
    unit = data.draw(st.sampled_from(["m", "mm", "inch"]))
    angle = data.draw(st.sampled_from(["deg", "rad"]))
    kind: Orientation = data.draw(
        st.sampled_from(["axis", "normal", "quaternion", "rpy", "none"])  # type: ignore[arg-type]
    )
    names = data.draw(st.booleans())
    newline = data.draw(st.sampled_from(["\n", "\r\n", "\r", "\r\r\n"]))
    counts = data.draw(st.lists(st.integers(1, 4), min_size=1, max_size=3))

    total = sum(counts)
    positions = rng.uniform(-2, 2, (total, 3))
    values: Array
    if kind == "quaternion":
        values = Rotation.random(total, random_state=1).as_quat()[:, [3, 0, 1, 2]]
        titles = ["qw", "qx", "qy", "qz"]
    elif kind == "rpy":
        values = rng.uniform(-1.5, 1.5, (total, 3))
        titles = [f"{n}_{angle}" for n in ("roll", "pitch", "yaw")]
        expected = Rotation.from_euler("ZYX", values[:, ::-1]).as_matrix()
    else:
        values = rng.normal(size=(total, 3))
        titles = ["i", "j", "k"] if kind == "axis" else ["nx", "ny", "nz"]
    written = values * (180 / np.pi if kind == "rpy" and angle == "deg" else 1.0)
    if kind == "none":
        written, titles = np.zeros((total, 0)), []
    table = np.column_stack([np.arange(total), positions * PER_METRE[unit], written])
    titles = ["no", *(f"{c}{s}" for c in "xyz" for s in [f" [{unit}]"]), *titles]
    order = rng.permutation(table.shape[1])

    lines = ["# made by a test"]
    if names:
        lines.append(delimiter.join(titles[i] for i in order))
    rows = iter(table[:, order])
    for number, count in enumerate(counts, start=1):
        lines.append("" if number % 2 else f"seam {number}")
        lines += [
            delimiter.join(f"{v:.17g}".replace(".", decimal) for v in next(rows))
            for _ in range(count)
        ]
    mark = "\ufeff" if data.draw(st.booleans()) else ""
    path = write(tmp_path, mark + newline.join(lines) + newline)

    where = {int(column): i + 1 for i, column in enumerate(order)}
    choice = None
    if not names:
        directions = tuple(where[i] for i in range(4, table.shape[1]))
        key = "quaternion_wxyz" if kind == "quaternion" else kind
        choice = ColumnChoice(
            position=(where[1], where[2], where[3]), **({} if kind == "none" else {key: directions})
        )
    toolpath = read_toolpath(
        path,
        columns=choice,
        length_unit=None if names else unit,
        angle_unit=None if names or kind != "rpy" else angle,
    )
    assert [len(curve) for curve in toolpath.curves] == counts
    assert np.vstack([c.positions for c in toolpath.curves]) == pytest.approx(positions, abs=1e-12)
    assert [c.name for c in toolpath.curves][1:2] == ["seam 2"][: len(counts) - 1]
    assert toolpath.meaning == ("rotation" if kind in ("quaternion", "rpy") else kind)
    if kind == "quaternion":
        expected = Rotation.from_quat(values[:, [1, 2, 3, 0]]).as_matrix()
    if kind in ("quaternion", "rpy"):
        rotations = np.vstack([c.rotations for c in toolpath.curves if c.rotations is not None])
        assert rotations == pytest.approx(expected, abs=1e-9)
    elif kind != "none":
        vectors = np.vstack([c.vectors for c in toolpath.curves if c.vectors is not None])
        lengths = np.linalg.norm(values, axis=1, keepdims=True)
        assert vectors == pytest.approx(values / lengths, abs=1e-9)


@pytest.mark.parametrize(
    ("header", "meaning"),
    [
        ("X [mm];Y [mm];Z [mm];NX;NY;NZ", "normal"),
        ("x_mm;y_mm;z_mm;ax;ay;az", "axis"),
        ("Pos X (mm);Pos Y (mm);Pos Z (mm);i [-];j [-];k [-]", "axis"),
        ("pose.position.x/mm;pose.position.y/mm;pose.position.z/mm;normal_x;normal_y;normal_z",
         "normal"),
        ("X mm;Y mm;Z mm;roll_deg;pitch_deg;yaw_deg", "rotation"),
        ("x [mm];y [mm];z [mm];W [°];P [°];R [°]", "rotation"),
        ('"x [mm]";"y [mm]";"z [mm]";feed;speed;tool', "none"),
        ("# x [mm];y [mm];z [mm];nx;ny;nz", "normal"),
        ("x;y;z;nx;ny;nz\n[mm];[mm];[mm];;;", "normal"),
        ("x;y;z;nx;ny;nz\nmm;mm;mm;-;-;-", "normal"),
        ("x [mm];y [mm];z [mm];nx;ny;nz\nmm;mm;mm;;;", "normal"),
    ],
)  # fmt: skip
def test_usual_headers_are_understood(tmp_path: Path, header: str, meaning: str) -> None:
    toolpath = read_toolpath(write(tmp_path, f"{header}\n10;20;30;0;0,6;0,8\n11;20;30;0;0;1\n"))
    assert toolpath.meaning == meaning
    [curve] = toolpath.curves
    assert curve.positions[0] == pytest.approx([0.01, 0.02, 0.03])
    assert curve.lines[-1] - curve.lines[0] == 1


def test_columns_are_chosen_by_name_or_number(tmp_path: Path) -> None:
    path = write(tmp_path, "id,Lage 1 [mm],Lage 2 [mm],Lage 3 [mm],u,v,w\n7,1,2,3,0,0,2\n")
    by_name = ColumnChoice(position=("Lage 1", "lage 2", "Lage 3 [mm]"), normal=("u", "v", "w"))
    by_number = ColumnChoice(position=(2, 3, 4), normal=(5, 6, 7))
    as_in_a_file = {"position": [2, 3, 4], "normal": [5, 6, 7]}
    for choice in (by_name, by_number, as_in_a_file):
        [curve] = read_toolpath(path, columns=choice).curves
        assert curve.positions == pytest.approx(np.array([[0.001, 0.002, 0.003]]))
        assert curve.vectors == pytest.approx(np.array([[0, 0, 1.0]]))


def test_curves_are_told_apart_and_named(tmp_path: Path) -> None:
    text = """\
Part 4711; left side
x;y;z;pass
outer
0;0;0;a
1;0;0;a

2;0;0;a
# a comment is none
3;0;0;a
4;0;0;b
x;y;z;pass
5;0;0;b

Pass 7
;;;
6;0;0;b
"""
    toolpath = read_toolpath(write(tmp_path, text), length_unit="mm")
    found = [(c.name, (c.positions[:, 0] * 1e3).round().tolist()) for c in toolpath.curves]
    assert found == [("a", [0, 1]), ("a", [2, 3]), ("b", [4]), ("b", [5]), ("b", [6])]
    plain = read_toolpath(
        write(tmp_path, "x y z\nouter\n0 0 0\n1 0 0\n\n\nInner seam 2\n2 0 0\n\n3 0 0\n"),
        length_unit="mm",
    )
    assert [c.name for c in plain.curves] == ["outer", "Inner seam 2", "3"]
    assert [c.lines.tolist() for c in plain.curves] == [[3, 4], [8], [10]]
    assert [len(c) for c in plain.chosen(["Inner seam 2", 1]).curves] == [1, 2]
    with pytest.raises(InvalidInput, match=r"no curve 4; it has 3: 'outer', 'Inner seam 2', '3'"):
        plain.chosen([4])
    head = "x;y;z\nmm;mm;mm\n"
    again = read_toolpath(write(tmp_path, head + "0;0;0\n1;0;0\n" + head + "2;0;0\n3;0;0\n"))
    assert [c.name for c in again.curves] == ["1", "2"]


def test_repeated_points_are_dropped_and_counted_but_a_turn_in_place_is_kept(
    tmp_path: Path,
) -> None:
    text = "x [m],y [m],z [m],nx,ny,nz\n0,0,0,0,0,1\n0,0,0,0,0,2\n0,0,0,0,1,0\n1,0,0,0,1,0\n"
    toolpath = read_toolpath(write(tmp_path, text))
    assert toolpath.curves[0].lines.tolist() == [2, 4, 5]
    assert toolpath.notes == ("a point that repeats the one before was dropped (line 3).",)


def test_other_encodings_are_read(tmp_path: Path) -> None:
    text = "x [mm];y [mm];z [mm];roll [°];pitch [°];yaw [°]\n1;2;3;90;0;0\n"
    for encoding in ("latin-1", "utf-16", "utf-8-sig"):
        [curve] = read_toolpath(write(tmp_path, text, encoding=encoding)).curves
        assert curve.rotations is not None
        assert curve.rotations[0] == pytest.approx(
            np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), abs=1e-12
        )


HEAD = "x [mm],y [mm],z [mm],nx,ny,nz\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "0,0,0,0,0,1\n1,,0,0,0,1\n", r"path.csv, line 3, column 'y \[mm\]': .* missing"),
        (HEAD + "0,0,0,0,0,1\n1,0,0\n", r"line 3, column 'nx': .* missing; .* 3 of 6 columns"),
        (HEAD + "0,0,0,0,0,1\n1,0,0,0,0,1,9\n", r"line 3: 7 columns, where 6 are expected"),
        (HEAD + "0,0,0,0,0,1\n1,O.5,0,0,0,1\n", r"line 3, column 'y \[mm\]': .*'O.5'"),
        (HEAD + "0,0,0,0,0,1\n#N/A,0,0,0,0,1\n", r"line 3, column 'x \[mm\]': .*'#N/A'"),
        (HEAD + "0,0,0,0,0,1\n\n1,0,nan,0,0,1\n", r"line 4, column 'z \[mm\]': .*'nan'"),
        (HEAD + "0,0,0,0,0,1\n1,0,0,inf,0,1\n", r"line 3, column 'nx': expected a finite .*'inf'"),
        (HEAD + "0,0,0,0,0,1\n1,0,0,1e999,0,1\n", r"line 3, column 'nx': .*finite"),
        (HEAD + "0,0,0,0,0,1\n1,0,0,0,0,0\n", r"line 3, column 'nx', .*: the normal is zero"),
        (HEAD + "0,0,0,0,0,1\n999999,0,0,0,0,1\n", r"line 3: the point is 1000 m from the origin"),
        ("x [m],y [m],z [m]\n0,0,0\n250,0,0\n",
         r"line 3: .* is the file in mm\? the file says m, so write mm there"),
        ("x;y;z\n1,5;2;3\n1.5;2;3\n", r"unit of column 'x', column 'y', .* length_unit = \"mm\""),
        ("x [mm];y [mm];z [mm]\n1,5;2;3\n1.5;2;3\n",
         r"line 2, .*'1,5' with the decimal mark ','; elsewhere it is '.'"),
        ("x [mm],y [m],z [mm]\n1,2,3\n", "different units"),
        ("x [mm],y [mm],z [mm]\nm,m,m\n1,2,3\n", r"no columns x, y, z among 'x \[mm\] \[m\]'"),
        ("x [cm],y [cm],z [cm]\n1,2,3\n", "the header says 'cm'; known are mm, m, inch"),
        ("x [mm],y [mm],z [mm],roll,pitch,yaw\n1,2,3,1,0,0\n", r"add angle_unit = \"deg\" or"),
        ("x [mm],y [mm],z [mm],rx,ry,rz\n1,2,3,1,0,0\n", r"roll, pitch, yaw or a rotation vector"),
        ("x [mm],y [mm],z [mm],nx,ny\n1,2,3,0,0\n", r"'nx', column 'ny': 2 of 3 columns"),
        ("x [mm],y [mm],z [mm],i,j,k,nx,ny,nz\n1,2,3,0,0,1,0,0,1\n",
         "columns for axis and normal; add orientation"),
        ("x [mm],X (mm),y [mm],z [mm]\n1,1,2,3\n", "mean the same"),
        ("x [mm],y [mm],z [mm],qw,qx,qy,qz\n1,2,3,0.5,0,0,0\n", "quaternion has the length 0.5"),
        ("u,v,w\n1,2,3\n", r"no columns x, y, z among 'u', 'v', 'w'"),
        ("1 2 3 0 0 1\n", r"the unit of column 1, column 2, column 3 is not said"),
        ("1 2 3 4 5 6\n", r"6 columns and no header .* position = \[1, 2, 3\]"),
        ("1 2 3 1 0 0 0\n", r"7 columns and no header"),
        ("", "path.csv: the file is empty"),
        (" \n\n", "path.csv: the file is empty"),
        ("only words\nand more\n", "no line has three numbers"),
        ("a\x00b", "no text file"),
    ],
)  # fmt: skip
def test_a_broken_table_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, text))


def test_a_unit_that_contradicts_the_header_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, HEAD + "0,0,0,0,0,1\n")
    with pytest.raises(InvalidInput, match="header says mm, length_unit of the task file says m;"):
        read_toolpath(path, length_unit="m")
    assert len(read_toolpath(path, length_unit="mm").curves) == 1


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (ColumnChoice(position=(1, 2, 9)), "the file has columns 1 to 6, got 9"),
        (ColumnChoice(position=(1, 2, "q")), "there is no column 'q'; the header names 'x"),
        (ColumnChoice(position=(1, 2, 2)), "a column is used twice"),
        (ColumnChoice(normal=(4, 5, 6), axis=(4, 5, 6)), "choose one orientation, not 2"),
        (ColumnChoice(normal=(3, 5, 6)), "a column is used twice"),
    ],
)
def test_columns_that_do_not_fit_are_refused(
    tmp_path: Path, columns: ColumnChoice, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, HEAD + "0,0,0,0,0,1\n"), columns=columns)


# ---------------------------------------------------------------- APT-CL

APT = """\
$$ made by hand
PARTNO/BRACKET 1,2,3
UNITS/MM
MULTAX/ON
TOOL PATH/EDGE_A,TOOL,BURR
FROM/0,0,500,0,0,1
RAPID
GOTO/ 0.0, 0.0, 50.0, 0.0, 0.0, 1.0
RAPID
goto / 0, 0, 10.0, $
   0, 0, 1          $$ above the part
FEDRAT/250.0,MMPM
GOTO/10.,0.,1.0D+01
GOTO/20,0,10,0,.6,.8
SPINDL/ON
GOTO/30,0,10
TOOL PATH/EDGE_B
RAPID
GOTO/0,80,10,0,0,1
GOTO/30,80,10
MULTAX/OFF
GOTO/40,80,10
END-OF-PATH
FINI
"""


def test_apt_lines_become_curves(tmp_path: Path) -> None:
    toolpath = read_toolpath(write(tmp_path, APT, "part.apt"))
    first, second = toolpath.curves
    assert toolpath.meaning == "axis"
    assert (first.name, second.name) == ("EDGE_A", "EDGE_B")
    assert first.positions * 1e3 == pytest.approx(
        np.array([[0, 0, 10], [10, 0, 10], [20, 0, 10], [30, 0, 10]])
    )
    # An axis holds until the next one; without MULTAX it is that of a machine with three axes.
    assert first.vectors == pytest.approx(
        np.array([[0, 0, 1], [0, 0, 1], [0, 0.6, 0.8], [0, 0.6, 0.8]])
    )
    assert first.lines.tolist() == [10, 13, 14, 16]
    assert second.vectors == pytest.approx(np.array([[0, 0, 1.0]] * 3))
    rapid, passed = toolpath.notes
    assert rapid.startswith('RAPID (3 times): with rapids = "keep" in [path] the tool goes')
    assert passed == ("passed over, since they move nothing (4 times): PARTNO, MULTAX (2), SPINDL.")
    assert first.before is not None and second.before is None and second.after is None
    assert first.before.positions * 1e3 == pytest.approx(np.array([[0, 0, 50]]))
    # The feed is stated after the first point, to which RAPID leads, and holds until the end.
    assert first.feeds == pytest.approx([math.nan, *[0.25 / 60] * 3], nan_ok=True)
    assert second.feeds == pytest.approx([math.nan, *[0.25 / 60] * 2], nan_ok=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("GOTO/1,0,0\nGOTO/2,0,0\n", r"line 1: no unit of length before .*; add UNITS/MM above it"),
        ("UNITS/FEET\nGOTO/1,0,0\n", r"line 1: UNITS/FEET: expected MM or INCHES"),
        ("UNITS/MM\nGOTO/1,0,0\nUNITS/INCHES\nGOTO/2,0,0", "line 3: the unit changes after"),
        ("UNITS/MM\nGOTO/1,0\n", "line 2: GOTO takes x, y, z or x, y, z, i, j, k; got 2"),
        ("UNITS/MM\nGOTO/1,0,0\nGOTO/2,0,\n", "line 3: GOTO, z: it is missing"),
        ("UNITS/MM\nGOTO/1,P2,0\n", "line 2: GOTO, y: expected a number, got 'P2'"),
        ("UNITS/MM\nGOTO/1,0,1e999\n", "line 2: GOTO, z: '1E999' is too large"),
        ("UNITS/MM\nGOTO/1,0,0\nCIRCLE/0,0,0,0,0,1,5\nGOTO/2,0,0\n",
         "line 4: CIRCLE of line 3: the arc starts 1 mm from its centre and ends 2 mm from it, and "
         "the radius is 5 mm"),
        ("UNITS/MM\nFROM/0,0,0\nGODLTA/0,0,1\nGOTO/0,0,0\n",
         "line 3: GODLTA: where the tool is before it is not known"),
        ("UNITS/MM\nGODLTA/0,0\nGOTO/0,0,0\n", "line 2: GODLTA takes dx, dy, dz; got 2 numbers"),
        ("UNITS/MM\nGOTO/1,0,0\nWIGGLE/3\nGOTO/2,0,0\n", "line 3: 'WIGGLE' is not known"),
        ("UNITS/MM\nGOTO/1,0,0,0,0,1\nGOTO/2,0,0,0,0,0\n", "line 3, i, j, k: the axis is zero"),
        ("UNITS/MM\nRAPID\nGOTO/1,0,0\nRAPID\nGOTO/2,0,0\n", "nothing is cut"),
        ("UNITS/M\nGOTO/0,0,0\nGOTO/500,0,0\n", "line 3: the point is 500 m from the origin"),
    ],
)  # fmt: skip
def test_apt_that_is_not_clear_is_refused_with_its_line(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, text, "part.cls"))


def test_harmless_apt_words_are_passed_over_and_counted(tmp_path: Path) -> None:
    text = (
        "UNITS/MM\nCYCLE/OFF\nCUTCOM/OFF\nPPRINT GOTO THE PART\nCOOLNT/ON\nSET/OFSETL,3\n"
        "MSYS/0,0,0,1,0,0,0,1,0\nTOOL PATH/A,TOOL,B\nLOADTL/1\nSPINDL/RPM,3000,CLW\nPAINT/PATH\n"
        "TRANS/0,0,0.0\nTRACUT/NOMORE\nCOOLNT/OFF\n$$ a comment\n"
        "GOTO/1,0,0\nGOTO/2,0,0\n"
    )
    toolpath = read_toolpath(write(tmp_path, text))
    assert len(toolpath.curves[0]) == 2
    [note] = [note for note in toolpath.notes if note.startswith("passed over")]
    assert note == (
        "passed over, since they move nothing (12 times): CYCLE, CUTCOM, PPRINT, COOLNT (2), SET, "
        "MSYS, LOADTL, SPINDL, PAINT, TRANS, TRACUT."
    )


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("TRANS/0,0,5", "TRANS is a change of coordinates"),
        ("ORIGIN/10,0,0", "ORIGIN is a change of coordinates"),
        ("TRACUT/LAST,NOMORE", "TRACUT is a change of coordinates"),
        ("COPY/1,SAME,2", "COPY is a repetition"), ("ROTABL/AAXIS,30", "ROTABL is a turn of the"),
        ("CYCLE/TAP,FEDTO,5,RAPTO,2", "CYCLE/TAP is a cycle"),
        ("MODE/INCR", "MODE/INCR is a change to"),
        ("SET/MODE,INCR", "SET/INCR is a change to relative coordinates"),
        ("TLAXIS/0,0,0", "TLAXIS takes i, j, k, not all of them zero"),
        ("TLAXIS/SAME", "TLAXIS takes i, j, k"),
        ("TLLFT,GOFWD/C1", "'TLLFT,GOFWD' is not known"),
    ],
)  # fmt: skip
def test_apt_that_changes_the_geometry_is_refused(
    tmp_path: Path, statement: str, message: str
) -> None:
    text = f"UNITS/MM\nMSYS/0,0,0,1,0,0,0,1,0\nGOTO/1,0,0\n{statement}\nGOTO/2,0,0\n"
    with pytest.raises(InvalidInput, match=f"line 4: .*{message}"):
        read_toolpath(write(tmp_path, text))


# ---------------------------------------------------------------- arcs of APT-CL


def on_circle(centre: Array, axis: Array, start: Array, angles: Array) -> Array:
    """Points of a circle by scipy's rotations, (N, 3)."""
    axis = axis / np.linalg.norm(axis)
    turns = Rotation.from_rotvec(angles[:, None] * axis)
    return centre + turns.apply(start - centre)


def apt_numbers(*vectors: Array) -> str:
    return ",".join(f"{v:.9f}" for vector in vectors for v in np.atleast_1d(vector))


@QUICK
@given(st.data())
def test_an_arc_in_any_plane_is_the_circle(tmp_path: Path, data: st.DataObject) -> None:
    """Random circles and helices in space, as each of the two statements with an axis has them."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    centre, axis = rng.uniform(-50, 50, 3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    radius, sweep = rng.uniform(0.5, 200), rng.uniform(0.02, 6.2)
    word = data.draw(st.sampled_from(["CIRCLE", "MOVARC"]))
    handed = data.draw(st.sampled_from(["right", "left"]))
    rise = data.draw(st.sampled_from([0.0, 7.0]))
    outward = np.cross(axis, rng.normal(size=3))
    start = centre + radius * outward / np.linalg.norm(outward)
    motion = axis if handed == "right" else -axis
    angles = np.linspace(0, sweep, 2000)
    true = on_circle(centre, motion, start, angles) + np.outer(rise * angles / sweep, axis)
    tangent = np.cross(motion, start - centre) / radius
    angle = f",ANGLE,{math.degrees(sweep):.9f}" if word == "MOVARC" else ""
    text = (
        f"UNITS/MM\nGOTO/{apt_numbers(start - 5 * tangent)}\nFEDRAT/600,MMPM\n"
        f"GOTO/{apt_numbers(start)}\n"
        f"{word}/{apt_numbers(centre, axis, np.array(radius))}{angle}\n"
        f"GOTO/{apt_numbers(true[-1])}\n"
    )
    toolpath = read_toolpath(write(tmp_path, text, "arc.apt"), arc_error=2e-5)
    [curve] = toolpath.curves
    found = curve.positions[1:] * 1e3
    # Each point is on the true curve, and each point of that is near a chord.
    nearest = np.linalg.norm(true[:, None] - found[None], axis=2)
    assert nearest.min(axis=0).max() < 2 * radius * sweep / 2000 + 1e-6
    chords, starts = np.diff(found, axis=0), found[:-1]
    share = ((true[:, None] - starts) * chords).sum(axis=2) / (chords**2).sum(axis=1)
    feet = starts + np.clip(share, 0, 1)[..., None] * chords
    off = np.linalg.norm(true[:, None] - feet, axis=2).min(axis=1)
    assert off.max() < 0.02 + 1e-6
    assert found[-1] == pytest.approx(true[-1], abs=1e-6)
    # No step back, and the length is that of the arc: less by (δ²/24) at most.
    length = math.hypot(radius * sweep, rise)
    assert np.linalg.norm(chords, axis=1).sum() == pytest.approx(length, rel=2e-3)
    assert curve.feeds == pytest.approx([math.nan, *[0.01] * (len(curve) - 1)], nan_ok=True)
    assert f"{handed}-handed about their axes" in toolpath.notes[-1]


def test_the_sense_of_a_circle_is_asked_for_where_nothing_tells_it(tmp_path: Path) -> None:
    """A quarter circle after a corner: with one sense 90°, with the other 270°."""
    text = "UNITS/MM\nGOTO/20,0,0\nGOTO/10,0,0\nCIRCLE/0,0,0,0,0,1,10\nGOTO/0,10,0\n"
    path = write(tmp_path, text, "arc.apt")
    with pytest.raises(InvalidInput, match=r"no straight motion .* add arc_axis = .right. or"):
        read_toolpath(path)
    for sense, sweep in (("right", math.pi / 2), ("left", 3 * math.pi / 2)):
        [curve] = read_toolpath(path, arc_axis=sense).curves  # type: ignore[arg-type]
        length = np.linalg.norm(np.diff(curve.positions[1:], axis=0), axis=1).sum()
        assert length == pytest.approx(0.01 * sweep, rel=1e-3)
    mixed = text + "GOTO/-5,10,0\nCIRCLE/-5,15,0,0,0,1,5\nGOTO/-10,15,0\nGOTO/-10,20,0\n"
    with pytest.raises(InvalidInput, match="fit right-handed ones once and left-handed ones 2 t"):
        read_toolpath(write(tmp_path, mixed, "arc.apt"))
    # One line out of the first circle without a corner is enough.
    [curve] = read_toolpath(write(tmp_path, text + "GOTO/-5,10,0\n", "arc.apt")).curves
    assert curve.positions[:-1, 0].min() > -1e-9


MICRO = """\
UNITS/MM
GOTO/-50,25,0
GOTO/0,25,0
CIRCLE/0,0,0,0,0,1,25,.06,.5,10,1
GOTO/25,0,0
GOTO/{x:.6f},{y:.6f},0
GOTO/25,-60,0
"""
"""A quarter circle, clockwise, and a point of the circle by an angle beyond its end."""


@pytest.mark.parametrize("micrometres", [2, 5, 500, 1300])
def test_an_arc_that_is_its_chord_within_the_tolerance_is_no_question(
    tmp_path: Path, micrometres: float
) -> None:
    """The chord of 1.3 mm on a circle of 25 mm is 8.5 µm from its arc, arc_error is 10 µm."""
    angle = micrometres / 25e3
    text = MICRO.format(x=25 * math.cos(angle), y=-25 * math.sin(angle))
    toolpath = read_toolpath(write(tmp_path, text, "micro.cls"))
    [curve] = toolpath.curves
    length = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1).sum()
    assert length == pytest.approx(0.05 + 0.025 * math.pi / 2 + 0.06, abs=1e-4)
    assert any("left-handed about their axes" in note for note in toolpath.notes)


@pytest.mark.parametrize("micrometres", [5000, -5])
def test_an_arc_that_goes_on_further_or_all_around_is_refused(
    tmp_path: Path, micrometres: float
) -> None:
    angle = micrometres / 25e3
    text = MICRO.format(x=25 * math.cos(angle), y=-25 * math.sin(angle))
    with pytest.raises(InvalidInput, match="line 6: the point is on the circle of line 4 too"):
        read_toolpath(write(tmp_path, text, "micro.cls"), arc_axis="left")


def test_a_program_that_is_no_toolpath_is_called_by_its_name(tmp_path: Path) -> None:
    text = ".PROGRAM a()\nLMOVE p1\n.END\n"
    with pytest.raises(InvalidInput, match=r"this is an AS program.*not read as a toolpath"):
        read_toolpath(write(tmp_path, text, "a.as"))


def test_a_full_circle_returns_to_where_it_began(tmp_path: Path) -> None:
    head = "UNITS/MM\nGOTO/10,-5,0\nGOTO/10,0,0\n"
    for arc in ("CIRCLE/0,0,0,0,0,1,10\nGOTO/10,0,0\n", "MOVARC/0,0,0,0,0,1,10,ANGLE,360\n",
                "MOVARC/0,0,0,0,0,1,10,ANGLE,360\nGOTO/10,0,0\n"):  # fmt: skip
        [curve] = read_toolpath(write(tmp_path, head + arc, "arc.apt")).curves
        length = np.linalg.norm(np.diff(curve.positions[1:], axis=0), axis=1).sum()
        assert length == pytest.approx(0.02 * math.pi, rel=1e-3)
        assert curve.positions[len(curve) // 4 + 1, 1] > 0.009  # counter-clockwise
    nearly = head + "CIRCLE/0,0,0,0,0,1,10\nGOTO/10,0.001,0\n"
    with pytest.raises(InvalidInput, match="may be a full circle or nearly none"):
        read_toolpath(write(tmp_path, nearly, "arc.apt"))


def test_an_arc_by_its_angle_alone_ends_where_the_angle_says(tmp_path: Path) -> None:
    for degrees, end in ((90, (0, 10)), (-90, (0, -10)), (180, (-10, 0)), (270, (0, -10))):
        text = f"UNITS/MM\nGOTO/10,0,3\nMOVARC/0,0,3,0,0,1,10,ANGLE,{degrees}\nFINI\n"
        [curve] = read_toolpath(write(tmp_path, text, "arc.apt"), arc_axis="right").curves
        assert curve.positions[-1] * 1e3 == pytest.approx([*end, 3], abs=1e-9)
        length = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1).sum()
        assert length == pytest.approx(0.01 * math.radians(abs(degrees)), rel=1e-3)


def test_an_angle_that_fits_one_sense_alone_decides_it(tmp_path: Path) -> None:
    """Posts that do not turn the axis of clockwise arcs round are recognised by the angle."""
    text = "UNITS/MM\nGOTO/10,0,0\nMOVARC/0,0,0,0,0,1,10,ANGLE,90\nGOTO/0,-10,0\n"
    toolpath = read_toolpath(write(tmp_path, text, "arc.apt"))
    [curve] = toolpath.curves
    assert curve.positions[:, 1].max() < 1e-9
    assert "left-handed about their axes" in toolpath.notes[-1]


CATIA = """\
UNITS/MM
GOTO/ 10,0,5
INTOL/ 0.01
OUTTOL/ 0.01
AUTOPS
INDIRV/ 0,{sign}1,0
TLON,GOFWD/ (CIRCLE/ 0.0, 0.0, 5.0,$
 10.0),ON,{which}(LINE/ 0,0,5,$
 {x:.6f},{y:.6f},5)
GOTO/ 40,40,5
"""


@pytest.mark.parametrize(
    ("sign", "which", "degrees", "sweep"),
    [
        ("", "", 90, 90), ("", "", 180, 180), ("", "2,INTOF,", 270, 270), ("-", "", -60, -60),
        ("-", "2,INTOF,", -200, -200), ("", "2,INTOF,", 360, 360),
    ],
)  # fmt: skip
def test_a_motion_along_a_circle_ends_where_it_crosses_the_line(
    tmp_path: Path, sign: str, which: str, degrees: float, sweep: float
) -> None:
    x, y = 10 * math.cos(math.radians(degrees)), 10 * math.sin(math.radians(degrees))
    text = CATIA.format(sign=sign, which=which, x=x, y=y)
    [curve] = read_toolpath(write(tmp_path, text, "part.aptsource")).curves
    arc = curve.positions[:-1] * 1e3
    assert arc[-1] == pytest.approx([x, y, 5], abs=1e-6)
    assert np.linalg.norm(arc[:, :2], axis=1) == pytest.approx(10, abs=1e-6)
    angles = np.unwrap(np.arctan2(arc[:, 1], arc[:, 0]))
    assert math.degrees(angles[-1] - angles[0]) == pytest.approx(sweep, abs=1e-4)
    assert (np.diff(angles) * sweep > 0).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("INDIRV/ 0,1,0\n", "", r"line 6: GOFWD: expected an INDIRV before it"),
        ("INDIRV/ 0,1,0", "INDIRV/ 1,0,0", "INDIRV is not along the circle where the tool is"),
        ("0.000000,10.000000,5)", "0,-10,5)", "crosses the line at another point first"),
        ("(LINE/ 0,0,5", "(LINE/ 40,10,5", "LINE does not cross the circle"),
        ("(LINE/ 0,0,5", "(LINE/ 0,10,5", "the two points of LINE are the same"),
        (" 10.0),ON", " 12.0),ON", "the arc starts 10 mm from its centre .* the radius is 12 mm"),
        ("),ON,", "),TANTO,", "GOFWD is a move along a surface, of which"),
        ("0.0, 5.0,$\n 10.0)", "0.0, 10.0)", r"expected 4 or 7 numbers, got '0.0,0.0,10.0'"),
        ("GOTO/ 10,0,5\n", "", "expected a GOTO before it"),
    ],
)  # fmt: skip
def test_a_motion_along_a_circle_that_is_not_clear_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = CATIA.format(sign="", which="", x=0, y=10)
    assert old in text
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, text.replace(old, new), "part.aptsource"))


@pytest.mark.parametrize(
    ("arc", "message"),
    [
        ("CIRCLE/0,0,0,0,0,0,10\nGOTO/0,10,0", "line 3: CIRCLE: the axis is zero"),
        ("CIRCLE/0,0,0,0,0\nGOTO/0,10,0", "line 3: CIRCLE takes the centre x, y, z, the axis"),
        ("CIRCLE/0,0,0,0,0,1,10,TIMES,0.5\nGOTO/0,10,0", "line 3: CIRCLE, TIMES: expected a num"),
        ("CIRCLE/0,0,0,0,0,1,10,TIMES\nGOTO/0,10,0", "line 3: CIRCLE, TIMES: it is missing"),
        ("CIRCLE/0,0,nan,0,0,1,10\nGOTO/0,10,0", "line 3: CIRCLE: expected a number, got 'NAN'"),
        ("CIRCLE/0,0,0,0,0,1,10\nGOTO/0,12,0", "ends 12 mm from it, and the radius is 10 mm"),
        ("CIRCLE/10,0,0,0,0,1,0\nGOTO/10,0,0", "line 4: CIRCLE of line 3: .* the radius zero"),
        ("CIRCLE/0,0,0,0,0,1,10\nFINI", "line 3: CIRCLE: no GOTO follows, so where the arc ends"),
        ("CIRCLE/0,0,0,0,0,1,10\nRAPID\nGOTO/0,10,0", "line 3: CIRCLE: no GOTO follows"),
        ("MOVARC/0,0,0,0,0,1,10,ANGLE\nGOTO/0,10,0", "line 3: MOVARC, ANGLE: it is missing"),
        ("MOVARC/0,0,0,0,0,1,10,90\nGOTO/0,10,0", "line 3: MOVARC takes the centre .* then ANGLE"),
        ("MOVARC/0,0,0,0,0,1,10,ANGLE,400\nGOTO/0,10,0", "expected an angle up to 360 degrees"),
        ("MOVARC/0,0,0,0,0,1,10,ANGLE,80\nGOTO/0,10,0",
         "the angle is 80 degrees, but the point after it is 90 degrees on, or 270"),
        ("FROM/0,0,0\nCIRCLE/0,0,0,0,0,1,10\nGOTO/0,10,0", "line 4: CIRCLE: where the tool is"),
        ("CIRCLE/0,0,0,0,0,1,10\nGOTO/0,10,0\nGOTO/-10,0,0",
         "line 5: the point is on the circle of line 3 too, and whether the motion to it is the"),
    ],
)  # fmt: skip
def test_an_arc_that_is_not_clear_is_refused(tmp_path: Path, arc: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, f"UNITS/MM\nGOTO/10,0,0\n{arc}\n", "part.apt"))


def test_the_tool_axis_turns_evenly_along_an_arc(tmp_path: Path) -> None:
    text = (
        "UNITS/MM\nGOTO/10,-5,0,0,0,1\nGOTO/10,0,0\nCIRCLE/0,0,0,0,0,1,10,.002,.5,1,0\n"
        "GOTO/0,10,0,0,0.6,0.8\n"
    )
    [curve] = read_toolpath(write(tmp_path, text, "arc.apt")).curves
    assert curve.vectors is not None
    lean = np.degrees(np.arccos(curve.vectors[1:, 2]))
    on = np.degrees(np.arctan2(curve.positions[1:, 1], curve.positions[1:, 0]))
    assert lean == pytest.approx(on / 90 * math.degrees(math.acos(0.8)), abs=1e-6)


APT_PIECES = (
    "GOTO/", "CIRCLE/", "MOVARC/", "INDIRV/", "TLON,GOFWD/(CIRCLE/", "),ON,", "2,INTOF,", "(LINE/",
    "0,0,0", "10,0,0", "0,10,0", ",0,0,1", ",0,0,0", ",10", ",ANGLE,", "90", "-400", "1e300", "nan",
    "UNITS/MM", "RAPID", "GODLTA/", "TLAXIS/", "FROM/", "MSYS/", "FEDRAT/", "MULTAX/OFF", "$", "$$",
    "CUTCOM/LEFT", "SET/", "/", ",", "(", ")", "\n", "\n", "\n", "\nGOTO/1,2,3\n", "é",
)  # fmt: skip


@settings(QUICK, max_examples=150)
@given(st.lists(st.sampled_from(APT_PIECES), max_size=40))
def test_any_text_is_read_or_refused_in_a_sentence(tmp_path: Path, pieces: list[str]) -> None:
    text = "UNITS/MM\nGOTO/10,0,0\n" + "".join(pieces)
    try:
        toolpath = read_toolpath(write(tmp_path, text, "any.apt"))
    except InvalidInput as error:
        assert error.file.endswith("any.apt")
    else:
        assert all(np.isfinite(curve.positions).all() for curve in toolpath.curves)


# ---------------------------------------------------------------- rapid motions of a file


WITH_WAYS = """\
UNITS/MM
RAPID
GOTO/0,0,60,0,0,1
RAPID
GOTO/0,0,5
FEDRAT/600,MMPM
GOTO/0,0,0
GOTO/20,0,0
GOTO/20,0,5
RAPID
GOTO/20,0,60
RAPID
GOTO/60,0,60
RAPID
GOTO/60,0,5
GOTO/60,0,0
GOTO/60,20,0
RAPID
GOTO/60,20,60
FINI
"""


def test_rapid_motions_of_a_file_are_the_path_where_they_are_kept(tmp_path: Path) -> None:
    toolpath = read_toolpath(write(tmp_path, WITH_WAYS, "seam.apt"))
    first, second = toolpath.curves
    assert toolpath.has_ways
    assert first.before is not None and second.before is not None and second.after is not None
    assert second.before.positions[:, 2] * 1e3 == pytest.approx([60, 60])
    old = '"seam.csv"\nmax_spacing = 0.005\nmax_turn_deg = 45'
    new = '"seam.apt"\nrapids = "keep"\nmax_spacing = 1.0'
    more = "[path.placement]\nposition = [0, 1.0, 0.6]\n[feed]\nspeed = 0.1\n"
    loaded = qt.load_task(task(tmp_path, more, old=old, new=new))
    of_file = [
        [float(v) for v in line.removeprefix("GOTO/").split(",")[:3]]
        for line in WITH_WAYS.splitlines() if line.startswith("GOTO")
    ]  # fmt: skip
    # Every point of the file, in its order, and no other one.
    assert (loaded.positions - [0, 1.0, 0.6]) * 1e3 == pytest.approx(np.array(of_file), abs=1e-9)
    # 600 mm/min on the cuts, the speed of [feed] on the rapid ways.
    lengths = np.linalg.norm(np.diff(loaded.positions, axis=0), axis=1)
    assert loaded.durations is not None
    speeds = lengths / loaded.durations[1:]
    rapid = [True, False, False, False, True, True, True, False, False, True]
    assert speeds == pytest.approx(np.where(rapid, 0.1, 0.01))
    dropped = qt.load_task(task(tmp_path, more + "[path.transfer]\n", old=old,
                                new=new.replace("keep", "drop")))  # fmt: skip
    assert dropped.positions[:, 2].max() < 0.6051
    with pytest.raises(qt.TaskFileError, match=r'rapids = "keep" has the tool come and go as in'):
        qt.load_task(task(tmp_path, WAYS + more, old=old, new=new))


@pytest.mark.parametrize(
    ("text", "has_ways"),
    [
        (WITH_WAYS, True),
        ("GOTO/0,0,0\nGOTO/9,0,0\nRAPID\nGOTO/9,9,0\nGOTO/0,9,0", False),
        ("GOTO/0,0,0\nGOTO/9,0,0\nGOTO/9,0,9\nRAPID\nGOTO/9,9,9\nGOTO/9,9,0\nGOTO/0,9,0", True),
        ("GOTO/0,0,0\nGOTO/9,0,0\nGOTO/9,0,9\nRAPID\nGOTO/9,9,0\nGOTO/0,9,0", False),
        ("GOTO/0,0,0\nGOTO/9,0,0", False),
        ("RAPID\nGOTO/0,0,9\nRAPID\nGOTO/0,0,0\nGOTO/9,0,0", True),
    ],
)
def test_a_file_leads_the_tool_itself_or_does_not(
    tmp_path: Path, text: str, has_ways: bool
) -> None:
    text = text if "UNITS" in text else f"UNITS/MM\n{text}\n"
    assert read_toolpath(write(tmp_path, text, "a.apt")).has_ways is has_ways


# ---------------------------------------------------------------- in a task

TASK = """\
title = "A task along a file"

[robot]
scene = "m16ib_deburring.xml"
frame = "tool"

[projector]
linear = "full"
angular = { plane = [0, 0, 1] }
frame = "body"

[path]
kind = "file"
file = "seam.csv"
max_spacing = 0.005
max_turn_deg = 45

[start]
q_deg = [109.2, 1.6, -63.6, -33.6, 53.1, -137.7]
"""
SEAM = HEAD + "0,0,0,0,0,1\n20,0,0,0,0,1\n20,10,0,0,1,1\n"
TWO = SEAM + "second\n20,40,0,0,1,1\n0,40,0,0,0,1\n"
PLACED = "[path.placement]\nposition = [0.0, 1.0, 0.6]\nrpy_deg = [0, 0, 90]\n"
WAYS = (
    "[path.approach]\ndistance = 0.03\nsteps = 4\nlinear = 'full'\nangular = 'full'\nblend = 2\n"
    "[path.retreat]\ndistance = 0.02\nsteps = 5\nlinear = 'full'\nangular = 'none'\nblend = 3\n"
)


def task(folder: Path, more: str = "", csv: str = SEAM, old: str = "", new: str = "") -> Path:
    write(folder, csv, "seam.csv")
    assert old in TASK
    return write(folder, TASK.replace(old, new) + more, "mine.toml")


def rotations_of(path_task: qt.PathTask) -> Array:
    return np.array([w.rotation().as_matrix() for w in path_task.waypoints])


def test_a_file_in_millimetres_with_normals_becomes_waypoints_in_the_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = task(tmp_path, PLACED)
    monkeypatch.chdir(tmp_path.parent)  # the file is looked for beside the task
    loaded = qt.load_task(path)
    # x of the file is y of the world, y is −x; 20 mm are four steps, 10 mm two.
    expected = [[0, 1 + 0.005 * k, 0.6] for k in range(5)] + [
        [-0.005 * k, 1.02, 0.6] for k in (1, 2)
    ]
    assert loaded.positions == pytest.approx(np.array(expected), abs=1e-12)
    z = rotations_of(loaded)[:, :, 2]
    assert z[0] == pytest.approx([0, 0, -1])  # into the part
    assert z[-1] == pytest.approx(np.array([1, 0, -1]) / math.sqrt(2))
    half = math.radians(22.5)
    assert z[5] == pytest.approx([math.sin(half), 0, -math.cos(half)])
    assert loaded.lines is not None
    assert loaded.lines.tolist() == [2, 2, 2, 2, 3, 3, 4]
    trajectory = qt.follow(loaded, "qp_minimum_norm")
    assert trajectory.position_error.max() < 1e-8
    assert trajectory.axis_error.max() < 1e-8


@pytest.mark.parametrize(("tool", "sign"), [("into", -1.0), ("out", 1.0)])
def test_a_second_axis_of_the_file_is_the_roll_of_the_waypoints(
    tmp_path: Path, tool: str, sign: float
) -> None:
    """z is along the normal or against it, x along the tangent: y completes them."""
    csv = HEAD.replace("nz", "nz,tx,ty,tz") + "0,0,0,0,0,1,1,0,0\n20,0,0,0,0.6,0.8,1,0,0\n"
    path = task(tmp_path, PLACED, csv, old='"seam.csv"', new=f'"seam.csv"\ntool = "{tool}"')
    loaded = qt.load_task(path)
    found = rotations_of(loaded)[[0, -1]]
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    axes = np.array([[0, 0, 1], [0, 0.6, 0.8]])
    for rotation, axis in zip(found, axes, strict=True):
        assert rotation[:, 2] == pytest.approx(turn @ (sign * axis))
        assert rotation[:, 0] == pytest.approx(turn @ [1.0, 0, 0])
        assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert loaded.from_start == "nothing" and loaded.projector.rank == 5


def test_a_free_roll_is_drawn_to_that_of_the_file(tmp_path: Path) -> None:
    """The turn of the frame about its z against the waypoint's, at the end of the path."""
    tangents = HEAD.replace("nz", "nz,tx,ty,tz")
    rolls = 0.3 + 0.01 * np.arange(40)
    rows = "".join(
        f"{5 * k},0,0,0,0.6,0.8,{math.cos(roll)},{math.sin(roll)},0\n"
        for k, roll in enumerate(rolls)
    )
    loaded = qt.load_task(task(tmp_path, PLACED, tangents + rows))
    assert loaded.projector.rank == 5
    off = {}
    for secondary in ("roll", "centering"):
        run = qt.follow(loaded, "qp_gradient", secondary=secondary, gain=1.0)
        frame = mink.Configuration(loaded.model, run.q[-1])
        R = frame.get_transform_frame_to_world("tool", "site").rotation().as_matrix()
        off[secondary] = np.degrees(math.acos(min(1.0, rotations_of(loaded)[-1, :, 0] @ R[:, 0])))
        assert run.position_error.max() < 1e-8
    assert off["roll"] < 0.1 and off["centering"] > 1.0


def test_the_tool_points_out_where_asked_and_the_roll_rule_gives_both_signs(tmp_path: Path) -> None:
    path = task(tmp_path, "[roll]\nplane_normal = [0, 1, 0]\n", old='"seam.csv"\n',
                new='"seam.csv"\ntool = "out"\n')  # fmt: skip
    loaded = qt.load_task(path)
    rotations = rotations_of(loaded)
    assert rotations[0, :, 2] == pytest.approx([0, 0, 1])
    assert rotations[:, 1, 1] == pytest.approx(0.0, abs=1e-12)  # y in the xz-plane
    assert loaded.flipped_waypoints is not None
    flipped = np.array([w.rotation().as_matrix() for w in loaded.flipped_waypoints])
    assert flipped[:, :, 1] == pytest.approx(-rotations[:, :, 1])


def test_without_a_rule_the_roll_is_carried_along_from_the_start(tmp_path: Path) -> None:
    loaded = qt.load_task(task(tmp_path, PLACED))
    rotations = rotations_of(loaded)
    held = mink.Configuration(loaded.model, loaded.start).get_transform_frame_to_world(
        loaded.frame_name, "site"
    )
    before = held.rotation().as_matrix()
    for after in rotations:
        turn = Rotation.from_matrix(after @ before.T).as_rotvec()
        assert abs(turn @ after[:, 2]) < 1e-9
        before = after
    assert loaded.flipped_waypoints is None


def test_approach_and_retreat_have_their_ways_projectors_and_blends(tmp_path: Path) -> None:
    loaded = qt.load_task(task(tmp_path, PLACED + WAYS))
    count = 4 + 7 + 5
    assert len(loaded.waypoints) == count
    p = loaded.positions
    assert p[:5] == pytest.approx(np.array([[0, 1, 0.6 + 0.0075 * k] for k in (4, 3, 2, 1, 0)]))
    normal = np.array([-1, 0, 1]) / math.sqrt(2)
    ends = [p[10] + 0.004 * k * normal for k in range(6)]
    assert p[10:] == pytest.approx(np.array(ends))
    rotations = rotations_of(loaded)
    assert rotations[:5] == pytest.approx(np.array([rotations[4]] * 5))
    ranks = [t.rank for t in loaded.in_force]
    # The change to five rows is over before contact, the one to three begins after it.
    assert ranks == [6] * 2 + [5] * 9 + [3] * 5
    assert [(s.first, s.blend) for s in loaded.segments] == [(2, 2), (11, 3)]
    assert loaded.projector.rank == 6


def test_between_curves_the_tool_may_be_fast(tmp_path: Path) -> None:
    more = PLACED + WAYS + "[path.transfer]\n[feed]\nspeed = 0.05\nrapid = 0.25\n"
    loaded = qt.load_task(task(tmp_path, more, TWO))
    assert loaded.durations is not None
    lengths = np.linalg.norm(np.diff(loaded.positions, axis=0), axis=1)
    speeds = lengths / loaded.durations[1:]
    # 4 + 7 + 5 waypoints of the first curve, 3 + 1 of the way to the second, then 0.05 m/s again.
    ends = np.flatnonzero(np.diff(speeds > 0.15)) + 1
    assert len(ends) == 2
    assert speeds[ends[0] : ends[1]] == pytest.approx(0.25)
    assert np.delete(speeds, np.arange(*ends)) == pytest.approx(0.05)
    begin, end = loaded.positions[[ends[0], ends[1]]]
    assert end - begin != pytest.approx(0.0)
    with pytest.raises(qt.TaskFileError, match="give either dt or speed"):
        qt.load_task(task(tmp_path, more + "dt = 0.1\n", TWO))
    plain = Path("tasks/deburring.toml").read_text("utf-8")
    (tmp_path / "plain.toml").write_text(
        plain.replace("speed = ", "rapid = 1.0\nspeed = "), "utf-8"
    )
    with pytest.raises(qt.TaskFileError, match=r"feed\.rapid: it is for the ways"):
        qt.load_task(tmp_path / "plain.toml")


def test_between_curves_the_tool_goes_straight_with_the_projector_of_the_retreat(
    tmp_path: Path,
) -> None:
    loaded = qt.load_task(task(tmp_path, PLACED + WAYS + "[path.transfer]\nblend = 2\n", TWO))
    p = loaded.positions
    ranks = np.array([t.rank for t in loaded.in_force])
    last, first = 15, int(np.flatnonzero(ranks == 6)[2])  # end of the retreat, next approach
    chord = p[first] - p[last]
    along = (p[last:first] - p[last]) @ chord / (chord @ chord)
    assert p[last:first] - p[last] == pytest.approx(np.outer(along, chord), abs=1e-12)
    assert (np.diff(along) > 0).all()
    assert (ranks[last:first] == 3).all()
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).min() > 1e-4
    blends = [s.blend for s in loaded.segments]
    assert blends == [2, 3, 2, 2, 3]
    own = qt.load_task(
        task(tmp_path, PLACED + WAYS + "[path.transfer]\nlinear = 'none'\nangular = 'full'\n", TWO)
    )
    assert [t.rank for t in own.in_force][last + 1 : first] == [3] * (first - last - 1)
    assert own.in_force[last + 1].linear.rank == 0


def test_a_feed_gives_every_waypoint_its_time(tmp_path: Path) -> None:
    feed = "[feed]\nspeed = 0.01\nangular_speed_deg = 90\n"
    turn = HEAD + "0,0,0,0,0,1\n20,0,0,0,0,1\n20,0,0,0,1,0\n20,0,0,0,1,0\n20,10,0,0,1,0\n"
    loaded = qt.load_task(task(tmp_path, PLACED + WAYS + feed, turn))
    assert loaded.durations is not None
    assert loaded.durations[1:].min() > 0.0
    # 30 mm in, 30 mm along, 20 mm out at 10 mm/s, and a turn in place by 90° at 90°/s.
    assert loaded.durations.sum() == pytest.approx(8.0 + 1.0)
    with pytest.raises(qt.TaskFileError, match=r"add feed\.angular_speed_deg"):
        qt.load_task(task(tmp_path, PLACED + "[feed]\nspeed = 0.01\n", turn))


def test_curves_that_touch_have_their_common_point_once(tmp_path: Path) -> None:
    csv = HEAD + "0,0,0,0,0,1\n10,0,0,0,0,1\n\n10,0,0,0,0,1\n20,0,0,0,0,1\n"
    loaded = qt.load_task(task(tmp_path, "[path.transfer]\n", csv))
    assert loaded.positions[:, 0] == pytest.approx([0, 0.005, 0.01, 0.015, 0.02])
    # A curve that is nothing but that point, too, and whatever follows it.
    alone = csv.replace("\n\n", "\n\n10,0,0,0,0,1\n\n")
    again = qt.load_task(task(tmp_path, "[path.transfer]\n", alone))
    assert again.positions == pytest.approx(loaded.positions)


def test_whole_orientations_are_taken_as_they_are(tmp_path: Path) -> None:
    csv = "x [mm],y [mm],z [mm],roll_deg,pitch_deg,yaw_deg\n0,0,0,180,0,30\n2,0,0,180,10,30\n"
    loaded = qt.load_task(task(tmp_path, PLACED, csv))
    expected = Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler(
        "xyz", [[180, 0, 30], [180, 10, 30]], degrees=True
    )
    assert rotations_of(loaded) == pytest.approx(expected.as_matrix(), abs=1e-12)
    plain = qt.load_task(task(tmp_path, csv="x [m],y [m],z [m]\n0,1,0.6\n0,1,0.7\n"))
    held = mink.Configuration(plain.model, plain.start).get_transform_frame_to_world("tool", "site")
    assert rotations_of(plain) == pytest.approx(
        np.array([held.rotation().as_matrix()] * len(plain.waypoints))
    )


@pytest.mark.parametrize(
    ("more", "csv", "message"),
    [
        ("", HEAD + "0,0,0,0,0,1\n1,,0,0,0,1\n",
         r"mine.toml, line 14: path.file: .*seam.csv, line 3, column 'y \[mm\]'"),
        ("", TWO, r"path.file: seam.csv has 2 curves, which begin in lines 2, 6; say how"),
        ("", HEAD + "0,0,0,0,0,1\n", "path.file: seam.csv: a path needs at least two points"),
        ("[path.approach]\ndistance = 0.1\n", SEAM, "line 20: path.approach.steps: missing"),
        ("[path.approach]\ndistance = 0.1\nsteps = 4\nlinear = 'full'\n", SEAM,
         "path.approach: give both linear and angular"),
        ("[path.approach]\ndistance = 0.1\nsteps = 4\nblend = 2\n", SEAM,
         "path.approach: blend needs a projector of its own"),
        (WAYS.replace("blend = 3", "blend = 5"), SEAM,
         "path.retreat: blend has to be less than steps = 5"),
        ("[path.columns]\nposition = [1, 2]\n", SEAM, r"path.columns.position\[2\]: missing"),
        ("[path.columns]\nposition = [0, 1, 2]\n", SEAM, r"position\[0\]: expected a name, or a"),
        ("[path.placement]\nrpy_deg = [0, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]\n", SEAM,
         "path.placement: give either quaternion_wxyz or rpy_deg"),
        (WAYS + "[path.transfer]\nblend = 99\n", TWO, "path.transfer.blend: waypoints 17 to"),
        (WAYS + "[[segments]]\nfirst = 3\nlinear = 'full'\nangular = 'none'\n", SEAM,
         "segments: .* change T already"),
        ("[path.approach]\ndistance = 0.1\nsteps = 4\nblend = 2\nlinear = 'full'\n"
         "angular = { plane = [1, 0, 0] }\n", SEAM, "path.approach: .* fixed to 'world'"),
    ],
)  # fmt: skip
def test_a_wrong_file_path_in_a_task_is_named(
    tmp_path: Path, more: str, csv: str, message: str
) -> None:
    with pytest.raises(qt.TaskFileError, match=message):
        qt.load_task(task(tmp_path, more, csv))


def test_a_toolpath_takes_the_place_of_the_path_of_a_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write(tmp_path, HEAD + "0,0,0,0,0,1\n10,0,0,0,0,1\n", "other.csv")
    monkeypatch.chdir(tmp_path)
    shipped = qt.load_task("deburring", path="other.csv")
    assert shipped.positions == pytest.approx(np.array([[0, 0, 0], [0.01, 0, 0]]))
    assert rotations_of(shipped)[:, :, 2] == pytest.approx(np.array([[0, 0, -1.0]] * 2))
    assert shipped.title.endswith("; along other.csv")
    assert shipped.toolpath is not None
    assert shipped.toolpath.source == other
    kept = qt.load_task(task(tmp_path, PLACED + WAYS), path=other)
    assert len(kept.waypoints) == 4 + 3 + 5  # its spacing, its ways and its placement
    assert kept.positions[4] == pytest.approx([0, 1, 0.6])
    with pytest.raises(qt.TaskFileError, match="segments: they count the waypoints"):
        qt.load_task("approach_contact_retreat", path=other)
    with pytest.raises(qt.TaskFileError, match="there is no such toolpath file"):
        qt.load_task("deburring", path="none.csv")


def test_the_shipped_toolpath_lies_on_its_dome_and_is_followed() -> None:
    loaded = qt.load_task("dome_seams")
    assert loaded.toolpath is not None
    assert [c.name for c in loaded.toolpath.curves] == ["around", "across"]
    from_centre = loaded.positions - [0.0, 1.0, 0.3]
    radii = np.linalg.norm(from_centre, axis=1)
    contact = radii < 0.3001
    # Chords of the file, and of what was left out of it, lie below the sphere.
    assert radii.min() > 0.3 - 2e-4 - 1e-4
    assert contact.sum() > 100
    assert radii.max() == pytest.approx(0.35, abs=1e-6)  # the ends of the ways
    inward = -from_centre / radii[:, None]
    lean = np.degrees(np.arccos((rotations_of(loaded)[:, :, 2] * inward).sum(axis=1)))
    assert lean[contact] == pytest.approx(5.0, abs=0.5)
    trajectory = qt.follow(loaded, "qp_minimum_norm")
    assert trajectory.position_error.max() < 1e-8
    assert trajectory.axis_error.max() < 1e-8
    assert trajectory.scale.min() == 1.0


# ---------------------------------------------------------------- feeds


def test_feeds_of_apt_become_the_times_of_their_stretches(tmp_path: Path) -> None:
    """Against times added up by hand: 20 mm at 600, 10 mm at 60 and 30 mm at 300 mm/min."""
    apt = (
        "UNITS/MM\nRAPID\nGOTO/0,0,0,0,0,1\nFEDRAT/600,MMPM\nGOTO/20,0,0\nFEDRAT/MMPM,60\n"
        "GOTO/30,0,0\nFEDRAT/300\nGOTO/60,0,0\n"
    )
    write(tmp_path, apt, "seam.apt")
    plain = task(tmp_path, PLACED + WAYS + "[feed]\nspeed = 0.01\n", old="seam.csv", new="seam.apt")
    loaded = qt.load_task(plain)
    assert loaded.durations is not None and loaded.toolpath is not None
    lengths = np.linalg.norm(np.diff(loaded.positions, axis=0), axis=1)
    cut = loaded.positions[:, 2] < 0.6 + 1e-9
    x = loaded.positions[:, 1] - 1.0  # x of the file is y of the world
    for first, last, feed in ((0, 0.02, 0.01), (0.02, 0.03, 0.001), (0.03, 0.06, 0.005)):
        here = cut[1:] & cut[:-1] & (x[1:] > first + 1e-9) & (x[1:] < last + 1e-9)
        assert lengths[here] / loaded.durations[1:][here] == pytest.approx(feed)
        assert loaded.durations[1:][here].sum() == pytest.approx((last - first) / feed)
    # The ways to and from the path at the task's speed: 30 mm in and 20 mm out at 10 mm/s.
    assert loaded.durations.sum() == pytest.approx(2 + 10 + 6 + 3 + 2)
    said = " ".join(loaded.toolpath.notes)
    assert "FEDRAT without a unit (line 8) is read as mm per minute" in said
    assert "RAPID (once)" in said
    # Without [feed] the file is the clock, and the ways have the feed of what is next to them.
    alone = qt.load_task(task(tmp_path, PLACED + WAYS, old="seam.csv", new="seam.apt"))
    assert alone.durations is not None
    assert alone.durations.sum() == pytest.approx(2 + 10 + 6 + 3 + 4)
    ours = '"seam.apt"\nfeeds = "task"'
    other = task(tmp_path, PLACED + "[feed]\nspeed = 0.01\n", old='"seam.csv"', new=ours)
    assert qt.load_task(other).durations.sum() == pytest.approx(6)
    clock = qt.load_task(task(tmp_path, "[feed]\ndt = 0.5\n", old="seam.csv", new="seam.apt"))
    assert set(clock.durations[1:]) == {0.5}
    assert "feed.dt is the time of every waypoint" in clock.toolpath.notes[-1]


def test_a_stretch_without_a_feed_and_a_task_without_one_is_refused(tmp_path: Path) -> None:
    text = "UNITS/MM\nGOTO/0,0,0,0,0,1\nGOTO/20,0,0\nFEDRAT/60,MMPM\nGOTO/30,0,0\n"
    write(tmp_path, text, "seam.apt")
    with pytest.raises(
        qt.TaskFileError, match=r"states feeds, but none for line 3; add .feed. with"
    ):
        qt.load_task(task(tmp_path, old="seam.csv", new="seam.apt"))


@pytest.mark.parametrize(
    ("words", "metres_per_second"),
    [
        ("FEDRAT/250.0,MMPM", 0.25 / 60), ("FEDRAT/ 10 , IPM", 0.254 / 60),
        ("FEDRAT/IPM,10", 0.254 / 60), ("fedrat / 1.5D+02", 0.15 / 60), ("FEED/2,MPM", 2 / 60),
        ("SPINDL/RPM,3000,CLW\nFEDRAT/.1,MMPR", 0.1e-3 * 50),
        ("SPINDL/3000,RPM,CLW\nSPINDL/ON\nFEDRAT/.01,IPR", 0.254e-3 * 50),
        ("FEDRAT/600,UPM", 0.01), ("FEDRAT/.2,MMPM\nFEDRAT/600,PERMIN", 0.01),
    ],
)  # fmt: skip
def test_feeds_are_read_in_every_unit(tmp_path: Path, words: str, metres_per_second: float) -> None:
    text = f"UNITS/MM\nGOTO/0,0,0\n{words}\nGOTO/1,0,0\nRAPID\nGOTO/9,0,0\nGOTO/10,0,0\n"
    toolpath = read_toolpath(write(tmp_path, text))
    first, second = toolpath.curves
    assert first.feeds == pytest.approx([math.nan, metres_per_second], nan_ok=True)
    assert second.feeds == pytest.approx([math.nan, metres_per_second], nan_ok=True)
    assert toolpath.feeds == pytest.approx((metres_per_second, metres_per_second))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("FEDRAT/0,MMPM", "line 3: FEDRAT: expected a feed above 0, got 0"),
        ("FEDRAT/-5,MMPM", "line 3: FEDRAT: expected a feed above 0, got -5"),
        ("FEDRAT/FAST", "line 3: FEDRAT/FAST: expected a number and its unit, one of MMPM, "),
        ("FEDRAT/5,KNOTS", "line 3: FEDRAT/5,KNOTS: expected a number and its unit"),
        ("FEDRAT/", "line 3: FEDRAT/: expected a number and its unit"),
        ("FEDRAT/1,2,MMPM", "line 3: FEDRAT/1,2,MMPM: expected a number"),
        ("FEDRAT/1e999,MMPM", "line 3: FEDRAT: '1E999' is too large"),
        ("FEDRAT/.1,MMPR", "line 4: the feed is per turn of the spindle, and nothing before it"),
        ("SPINDL/100,SFM\nFEDRAT/.1,MMPR", "line 5: the feed is per turn"),
    ],
)  # fmt: skip
def test_a_feed_that_is_none_is_refused(tmp_path: Path, words: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_toolpath(write(tmp_path, f"UNITS/MM\nGOTO/0,0,0\n{words}\nGOTO/1,0,0\n"))


@pytest.mark.parametrize(
    ("name", "unit", "scale"),
    [
        ("feed [mm/min]", None, 1e-3 / 60), ("Feed_Rate_mmpm", None, 1e-3 / 60),
        ("speed (m/s)", None, 1.0), ("v;F [in/min]", None, 0.0254 / 60), ("feed", "mm/s", 1e-3),
        ("velocity_mm/s", None, 1e-3),
    ],
)  # fmt: skip
def test_a_column_of_feeds_is_read(
    tmp_path: Path, name: str, unit: str | None, scale: float
) -> None:
    more = ";7" * name.count(";")
    text = f"x [mm];y [mm];z [mm];{name}\n0;0;0{more};0\n1;0;0{more};5\n2;0;0{more};6\n"
    [curve] = read_toolpath(write(tmp_path, text), feed_unit=unit).curves  # type: ignore[arg-type]
    assert curve.feeds == pytest.approx([math.nan, 5 * scale, 6 * scale], nan_ok=True)
    with pytest.raises(InvalidInput, match=r"line 3, column .*: expected a feed above 0, got -1"):
        read_toolpath(write(tmp_path, text.replace(";5", ";-1")), feed_unit=unit)  # type: ignore[arg-type]


def test_a_column_of_feeds_without_a_unit_is_not_dropped_in_silence(tmp_path: Path) -> None:
    path = write(tmp_path, "x [mm];y [mm];z [mm];feed\n0;0;0;1\n1;0;0;5\n")
    toolpath = read_toolpath(path)
    assert toolpath.feeds is None
    assert "column 'feed' may state feeds, but not in which unit" in toolpath.notes[-1]
    chosen = read_toolpath(path, columns=ColumnChoice(feed=4), feed_unit="mm/s")
    assert chosen.feeds == pytest.approx((5e-3, 5e-3))
    with pytest.raises(InvalidInput, match=r"the unit of column 'feed' is not said; add feed_unit"):
        read_toolpath(path, columns=ColumnChoice(feed=4))


def test_what_is_left_out_of_a_path_keeps_the_points_where_the_feed_changes(tmp_path: Path) -> None:
    rows = "".join(f"{x};0;0;{300 if x < 12 else 60}\n" for x in range(21))
    csv = "x [mm];y [mm];z [mm];feed [mm/min]\n" + rows
    keys = '"seam.csv"\nchord_error = 0.001'
    loaded = qt.load_task(task(tmp_path, csv=csv, old='"seam.csv"', new=keys))
    assert loaded.durations is not None
    # 11 mm at 5 mm/s and 9 mm at 1 mm/s, in steps of 5 mm at most.
    assert loaded.durations.sum() == pytest.approx(11 / 5 + 9 / 1)
    assert len(loaded.waypoints) == 1 + 3 + 2


# ---------------------------------------------------------------- all errors at once


def test_all_that_is_wrong_with_a_file_is_said_at_once(tmp_path: Path) -> None:
    rows = [f"{x},0,0,0,0,1" for x in range(60)]
    for line, row in ((3, "1,O.5,0,0,0,1"), (7, "1,0,0,0,0"), (9, "1,0,nan,0,0,1"),
                      (12, "1,0,0,0,0,0"), (20, "1,0,0,0,0,1,2")):  # fmt: skip
        rows[line - 2] = row
    with pytest.raises(InvalidInput) as refused:
        read_toolpath(write(tmp_path, HEAD + "\n".join(rows)))
    said = str(refused.value).split("\n  ")
    assert said[0].endswith("path.csv: 5 problems:")
    assert [line.split(":")[0] for line in said[1:]] == [
        "line 3, column 'y [mm]'", "line 7, column 'nz'", "line 9, column 'z [mm]'",
        "line 12, column 'nx', column 'ny', column 'nz'", "line 20",
    ]  # fmt: skip
    rows[5:50] = ["1,2,x,0,0,1"] * 45
    with pytest.raises(InvalidInput) as refused:
        read_toolpath(write(tmp_path, HEAD + "\n".join(rows)))
    said = str(refused.value).split("\n  ")
    assert said[0].endswith("path.csv: 46 problems:")
    assert len(said) == 1 + 20 + 1
    assert said[-1] == "and 26 more."
    apt = "GOTO/0,0,0,0,0,1\nFEDRAT/0\nWIGGLE/3\nGOTO/1,x,0\nGOTO/1,0,0,0,0,0\nGOTO/2,0,0\n"
    with pytest.raises(InvalidInput) as refused:
        read_toolpath(write(tmp_path, apt))
    said = str(refused.value).split("\n  ")
    assert [line.split(":")[0] for line in said[1:]] == [
        "line 1", "line 2", "line 3", "line 4", "line 5, i, j, k"
    ]  # fmt: skip


# ---------------------------------------------------------------- what a table may be


T = np.linspace(0, 1, 30)
POSITION = np.column_stack([300 * T, 40 * np.sin(3 * T), 100 + 10 * T**2])
NORMAL = np.column_stack([0.3 * np.sin(T), 0.2 * np.cos(T), 1 + 0 * T])
NORMAL /= np.linalg.norm(NORMAL, axis=1, keepdims=True)
QUATERNION = np.column_stack([0.6 * NORMAL, 0.8 + 0 * T])
DEGREES = np.column_stack([170 + 10 * T, 5 * T, 90 * T])
ROWS = np.arange(30)


@pytest.mark.parametrize(
    ("parts", "option"),
    [
        ([ROWS + 1, POSITION, NORMAL], '"position=2,3,4;normal=5,6,7"'),
        ([0.02 * ROWS, POSITION, NORMAL], '"position=2,3,4;normal=5,6,7"'),
        ([ROWS, 0.02 * ROWS, POSITION, NORMAL], '"position=3,4,5;normal=6,7,8"'),
        ([POSITION, QUATERNION], '"position=1,2,3;quaternion_wxyz=4,5,6,7"'),
        ([ROWS, POSITION, QUATERNION], '"position=2,3,4;quaternion_xyzw=5,6,7,8"'),
        ([NORMAL, POSITION], '"position=4,5,6;normal=1,2,3"'),
        ([POSITION, NORMAL, 500 + 0 * T], '"position=1,2,3;normal=4,5,6"'),
        ([POSITION, DEGREES], '"position=1,2,3;rpy=4,5,6" --angle-unit deg'),
        ([ROWS, POSITION, np.radians(DEGREES)], '"position=2,3,4;rpy=5,6,7" --angle-unit rad'),
        ([10 * ROWS, POSITION], '"position=2,3,4"'),
        # x in whole millimetres is no index where three columns would be missing without it.
        ([ROWS, POSITION[:, 1:], NORMAL], '"position=1,2,3;normal=4,5,6"'),
        # A flat part and a tool straight down: not the quaternion (0, 0, 0, 1).
        ([0.1 * ROWS, POSITION[:, :2], 0 * T, 0 * NORMAL + [0, 0, 1]],
         '"position=2,3,4;normal=5,6,7"'),
        ([POSITION, 0 * QUATERNION + [0, 1, 0, 0]], '"position=1,2,3;quaternion_wxyz=4,5,6,7"'),
    ],
)  # fmt: skip
def test_the_columns_that_are_suggested_fit_the_numbers(
    tmp_path: Path, parts: list[Array], option: str
) -> None:
    table = np.column_stack(parts)
    lines = [",".join(f"{v:.9g}" for v in row) for row in table]
    names = ",".join(f"col{k}" for k in range(table.shape[1])) + "\n"
    with pytest.raises(UnclearColumns) as refused:
        read_toolpath(write(tmp_path, names + "\n".join(lines)), length_unit="mm")
    suggestion = refused.value.suggestion
    assert suggestion is not None
    assert suggestion.text == option
    assert "By the numbers in it: [path.columns] position = [" in str(refused.value)
    # The suggestion is read without a further question.
    unit = suggestion.angle_unit or None
    columns = ColumnChoice.model_validate(suggestion.text.split('"')[1])
    read = read_toolpath(
        tmp_path / "path.csv", columns=columns, length_unit="mm", angle_unit=unit  # type: ignore[arg-type]
    )  # fmt: skip
    at = list(suggestion.places["position"])
    assert read.curves[0].positions * 1e3 == pytest.approx(table[:, at], abs=1e-6)
    # Without a header it is assumed if it is settled, and asked for otherwise.
    bare = write(tmp_path, "\n".join(lines))
    if suggestion.settled:
        assumed = read_toolpath(bare, length_unit="mm")
        assert assumed.curves[0].positions == pytest.approx(read.curves[0].positions)
        assert assumed.meaning == read.meaning
        assert "no header: columns" in assumed.assumptions[0]
    else:
        with pytest.raises(UnclearColumns):
            read_toolpath(bare, length_unit="mm")


# ---------------------------------------------------------------- extent, unit and number


def test_a_path_that_no_robot_of_this_size_reaches_is_refused_with_its_likely_unit(
    tmp_path: Path,
) -> None:
    csv = "x [m],y [m],z [m]\n" + "".join(f"{x},0,80\n" for x in range(0, 80, 2))
    words = (
        r"80 m and it is 78 m across; the robot reaches.*is the file in mm\? the file says m, so"
    )
    with pytest.raises(qt.TaskFileError, match=words):
        qt.load_task(task(tmp_path, csv=csv))
    bare = csv.replace(" [m]", "")
    with pytest.raises(
        qt.TaskFileError, match=r'is the file in mm\? if it is, say length_unit = "mm"'
    ):
        qt.load_task(
            task(tmp_path, csv=bare, old='"seam.csv"', new='"seam.csv"\nlength_unit = "m"')
        )
    huge = csv.replace("\n78,", "\n2e9,").replace("[m]", "[mm]")
    with pytest.raises(
        qt.TaskFileError, match=r"in no unit that is known would it be small enough"
    ):
        qt.load_task(task(tmp_path, csv=huge))
    small = qt.load_task(task(tmp_path, csv=csv.replace("[m]", "[mm]")))
    assert len(small.waypoints) == 40


def test_the_number_of_waypoints_is_bounded_over_all_curves(tmp_path: Path) -> None:
    half = MOST // 2 + 10
    csv = HEAD + f"0,0,0,0,0,1\n{half * 1e-3},0,0,0,0,1\n\n0,1,0,0,0,1\n{half * 1e-3},1,0,0,0,1\n"
    path = task(tmp_path, "[path.transfer]\n", csv, "max_spacing = 0.005", "max_spacing = 1e-6")
    with pytest.raises(qt.TaskFileError, match=r"make \d+ waypoints or more; at most"):
        qt.load_task(path)


# ---------------------------------------------------------------- what Python gives


def test_columns_may_be_one_text_as_in_the_command_line(tmp_path: Path) -> None:
    path = write(tmp_path, "0,0,0,0,0,1\n1,0,0,0,0,1\n")
    toolpath = read_toolpath(path, columns="position=1,2,3;normal=4,5,6", length_unit="m")
    assert toolpath.meaning == "normal"
    with pytest.raises(InvalidInput, match=r"columns: positon: unknown key; did you mean 'pos"):
        read_toolpath(path, columns="positon=1,2,3")
    with pytest.raises(InvalidInput, match="columns: expected a table, got 3"):
        read_toolpath(path, columns=3)
    with pytest.raises(InvalidInput, match="length_unit: expected 'mm', 'm' or 'inch', got"):
        read_toolpath(path, length_unit="cm")


def test_an_error_carries_the_file_as_it_was_given(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="file: expected a str or a Path, got int"):
        read_toolpath(3)  # type: ignore[arg-type]
    for path in (tmp_path / "none.csv", write(tmp_path, "only words\n")):
        with pytest.raises(InvalidInput) as refused:
            read_toolpath(path)
        assert refused.value.file == str(path)


def test_a_joint_trajectory_is_no_toolpath(tmp_path: Path) -> None:
    path = write(tmp_path, "time [s],joint_1 [rad],joint_2 [rad],joint_3 [rad]\n0,1,2,3\n1,1,2,4\n")
    with pytest.raises(InvalidInput, match=r"look like joint positions.*qp-twist check") as refused:
        read_toolpath(path)
    assert not refused.value.options


@pytest.mark.parametrize("chosen", ["gcode", "apt"])
def test_a_table_in_another_format_is_refused_once(tmp_path: Path, chosen: str) -> None:
    path = write(tmp_path, "x [mm],y [mm],z [mm]\n" + "1,2,3\n" * 30)
    with pytest.raises(InvalidInput) as refused:
        read_toolpath(path, format=chosen)
    assert "\n" not in str(refused.value)
