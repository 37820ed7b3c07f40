"""Klartext: what is refused, and what is said of what was assumed."""

from pathlib import Path

import numpy as np
import pytest

from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath, read_toolpath

HEAD = "0 BEGIN PGM P MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+5 R0 FMAX M3\n3 L Z-1 F500\n"


def read(folder: Path, text: str, **options: object) -> Toolpath:
    file = folder / "part.h"
    file.write_text(text)
    return read_toolpath(file, **options)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("L X+Q7", "Q7 has no value in this file"),
        ("FN 8: Q7 = +3 LEN +4\nL X+Q7", "Q7 has no value in this file: FN 8 is not computed"),
        ("CYCL DEF 200 D\nL X+30 FMAX M89", "M89 in a block with a motion"),
        ("M128\nLN X+1 TX+0 TY+0.6 TZ+0.8\nL X+3 C+0", "A or B is open, since the tool axis was"),
        ("FN 16: F-PRINT A.A/B.B", None),
        ("Q7 = Q1 + 2\nL X+Q7", "Q7 has no value in this file"),
        ("Q7 = 3\nFN 18: SYSREAD Q7 = ID270 NR1 IDX1\nL X+Q7", "Q7 has no value in this file"),
        (
            "PLANE SPATIAL SPA+20 SPB+0 SPC+0 STAY\nM128\nL X+0 Y+0 Z+9 A+5 FMAX",
            "rotary axes with M128 in a tilted plane",
        ),
        (
            "CYCL DEF 1.1 DIST2\nCYCL DEF 1.2 DEPTH-3\nCYCL DEF 1.5 F100\nCYCL DEF 1.0 PECKING\n"
            "CYCL DEF 1.1 DIST2\nL M99",
            "cycle 1: its depth or its feed is missing",
        ),
        ("CALL PGM OTHER", "'CALL PGM OTHER' calls another program"),
        ("TCH PROBE 417 DATUM", "is a measurement, after which the coordinates are elsewhere"),
        (
            "CYCL DEF 251 POCKET ~\n Q218=+20\nL M99",
            "cycle 251 moves the tool in a way that is not",
        ),
        ("CYCL DEF 19.0 PLANE\nCYCL DEF 19.1 A+0 B+30", "cycle 19 is a tilted plane by angles"),
        ("CYCL DEF 11.1 SCL 0.9", "cycle 11 is a scaled path"),
        ("CYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1 X", "cycle 8 is a mirrored path"),
        ("CYCL DEF 7.1 #4", "a datum of a table is not known"),
        ("PLANE VECTOR BX1 BY0 BZ0 NX0 NY0 NZ1", "PLANE VECTOR is a tilted plane that is not read"),
        ("L A+30 C+10 FMAX\nL X+5", "the rotary axes are turned without control of the tool's tip"),
        ("M128\nL A+30 B+10 FMAX\nL X+5", "A is a rotary axis; add rotary ="),
        ("FL PR+20 PA+30", "'FL PR\\+20 PA\\+30' is not read"),
        ("C X+10 Y+0 DR+", "expected a CC with two of X, Y and Z"),
        ("CC X+5 Y+0\nC X+10 Y+0", "the arc has no DR\\+ or DR-"),
        ("CC X+0 Y+0\nLP PR+20 PA+30\nL X+50 Y+0\nLP PA+60", "LP without PR where the tool is not"),
        ("CC X+5 Y+0\nCP IPA-90 DR+", "IPA and DR have different signs"),
        ("L X+10\nRND R20\nL Y+10", "the corner takes 20 mm of cuts that are 10 mm"),
        ("L X+10\nRND R5 FMAX\nL Y+10", "RND: expected its size, above 0, and perhaps F with a n"),
        ("FN 14: ERROR = 1000", "FN 14 ends the program here with a message of an error"),
        ("Q1 = -7\nQ2 = Q1 % 2\nL X+Q2", "Q2 has no value in this file"),
        ("L M99", "a cycle is called, and none is defined before"),
        ("/L X+5", "a block behind / is run or not by a switch"),
        ("L X+5 M130", "M130 is a point out of the plane"),
        ("FUNCTION TCPM F TCP AXIS SPAT PATHCTRL AXIS", "AXIS SPAT"),
        ("L M140 MB MAX\nL Z-5 F100\nL X+9 Y+1", None),
        ("L X+0 M91\nL Y+5 F100", None),
        ("CALL LBL 9", "LBL 9: there is no such LBL"),
        ("LBL 3\nCALL LBL 3", "more than 50 deep"),
    ],
)
def test_what_changes_the_path_and_is_not_read_is_refused(
    tmp_path: Path, block: str, message: str | None
) -> None:
    text = f"{HEAD}{block}\nL X+50\nL Y+50\nEND PGM P MM\n"
    if message is None:
        read(tmp_path, text)
        return
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, text)


def test_cylinder_radius_and_approach_are_said(tmp_path: Path) -> None:
    text = HEAD + "APPR LCT X+10 Y+20 R5 RL F300\nL Y+40\nDEP LT LEN20\nL Z+50 R0 FMAX\n"
    toolpath = read(tmp_path, text + "END PGM P MM\n")
    assert [len(curve) for curve in toolpath.curves] == [2, 2]
    assert toolpath.curves[1].positions.tolist() == [[0.01, 0.02, -0.001], [0.01, 0.04, -0.001]]
    assert any(note.startswith("RL, RR") is False and "APPR and DEP" in note
               for note in toolpath.passed_over)  # fmt: skip


def test_the_radius_of_the_tool_is_not_taken_off(tmp_path: Path) -> None:
    toolpath = read(tmp_path, HEAD + "L X+10 RL\nL Y+10 RL\nEND PGM P MM\n")
    assert any(note.startswith("RL, RR (line 5 and 1 more)") for note in toolpath.assumptions)


def test_a_program_is_known_by_its_first_block(tmp_path: Path) -> None:
    file = tmp_path / "part.nc"
    file.write_text("; made up\n" + HEAD + "L X+1\nEND PGM P MM\n")
    assert len(read_toolpath(file).curves) == 1


def test_rotary_axes_state_the_tool_axis_after_a_vector(tmp_path: Path) -> None:
    text = HEAD + "M128\nLN X+10 TX+0 TY+0.6 TZ+0.8\nL X+20\nL X+30 A+0 C+0\nL X+40\n"
    [curve] = read(tmp_path, text + "END PGM P MM\n").curves
    assert curve.vectors is not None
    assert curve.vectors[2:] == pytest.approx(np.array([[0, 0.6, 0.8]] * 2 + [[0, 0, 1]] * 2))


def test_a_corner_has_a_feed_of_its_own(tmp_path: Path) -> None:
    text = HEAD + "L X+10\nRND R5 F50\nL Y+10\nCHF 2 F20\nL X+0\nEND PGM P MM\n"
    [curve] = read(tmp_path, text).curves
    assert curve.feeds is not None
    expected = [500, 500, *[50] * (len(curve) - 6), 500, 20, 500]
    assert 6e4 * curve.feeds[1:] == pytest.approx(expected)


@pytest.mark.parametrize(("function", "value"), [("5: Q7 = SQRT +16", 4), ("6: Q7 = SIN+30", 0.5)])
def test_functions_of_parameters_are_computed(tmp_path: Path, function: str, value: float) -> None:
    [curve] = read(tmp_path, f"{HEAD}FN {function}\nL X+Q7\nEND PGM P MM\n").curves
    assert 1e3 * curve.positions[-1, 0] == pytest.approx(value)


def test_a_machine_and_its_corners_are_those_of_gcode(tmp_path: Path) -> None:
    """The same program in both languages, its rotary axes without control of the tip."""
    klartext = (
        "0 BEGIN PGM P MM\n1 L X+0 Y+0 Z+5 A+20 C-30 FMAX\n2 L Z+0 F600\n3 L X+30\n4 RND R4\n"
        "5 L Y+20\n6 CHF 3\n7 L IX-30\n8 L Y+40 A+35 C+15\n9 END PGM P MM\n"
    )
    gcode = (
        "G21 G90\nG0 X0 Y0 Z5 A20 C-30\nG1 Z0 F600\nX30 ,R4\nY20 ,C3\nG91 X-30\nG90 Y40 A35 C15\n"
    )
    of_machine = {"machine": "table-ac", "pivot": "1,2,-50"}
    one = read(tmp_path, klartext, **of_machine)
    (tmp_path / "part.nc").write_text(gcode)
    other = read_toolpath(tmp_path / "part.nc", **of_machine)
    [a], [b] = one.curves, other.curves
    assert a.vectors is not None and b.vectors is not None and len(a) > 30
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)
    np.testing.assert_allclose(a.vectors, b.vectors, atol=1e-12)
    np.testing.assert_allclose(a.feeds, b.feeds)


def test_a_shift_of_the_datum_leaves_the_tool_where_it_is(tmp_path: Path) -> None:
    text = (
        "0 BEGIN PGM A MM\nL X+0 Y+0 Z+2 FMAX\nLBL 1\nL Z-5 F100\nL IX+20 F300\nL Z+2 FMAX\n"
        "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 IX+50\nL X+0 Y+0 FMAX\nCALL LBL 1 REP2\n"
        "END PGM A MM\n"
    )
    file = tmp_path / "a.h"
    file.write_text(text)
    curves = read_toolpath(file).curves
    assert [len(curve) for curve in curves] == [3, 3, 3]
    for k, curve in enumerate(curves):
        expected = [[50 * k, 0, 2], [50 * k, 0, -5], [50 * k + 20, 0, -5]]
        assert 1e3 * curve.positions == pytest.approx(np.array(expected))
