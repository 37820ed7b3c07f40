"""G-code: motions, arcs, feeds and tool axes, and what is refused."""

import math
import re
from pathlib import Path
from typing import get_args

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.cli import new as _command  # noqa: F401
from qp_twist.errors import InvalidInput
from qp_twist.paths import Rotary, Toolpath, read_toolpath
from qp_twist.paths.rotary_axes import rotary_letters, tool_axis
from qp_twist.paths.toolpath_summary import summarize
from qp_twist.paths.turning import angles_between

QUICK = settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
HEAD = "%\nO1000 (PART)\nN10 G21 G17 G90 G40 G49 G80\nN20 T1 M6\n"


def read(folder: Path, text: str, name: str = "part.nc", **options: object) -> Toolpath:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_toolpath(path, **options)  # type: ignore[arg-type]


def millimetres(toolpath: Toolpath) -> Array:
    [curve] = toolpath.curves
    found: Array = curve.positions * 1e3
    return found


# ---------------------------------------------------------------- straight motions


def test_modes_hold_and_points_are_complete_before_they_count(tmp_path: Path) -> None:
    text = HEAD + (
        "N30 G54 G0 X0. Y0. S3000 M3 (above the part)\nN40 G43 H1 Z50. M8\nZ2.\n"
        "N50 G1 Z0. F120 ; plunge\nX10. F600\nY10.5\nG91 X-4. Y1.\nG90 G0 Z50.\n"
        "G53 G0 Z0.\nM30\n%\n"
    )
    toolpath = read(tmp_path, text)
    [curve] = toolpath.curves
    assert millimetres(toolpath) == pytest.approx(
        np.array([[0, 0, 2], [0, 0, 0], [10, 0, 0], [10, 10.5, 0], [6, 11.5, 0]])
    )
    assert curve.lines.tolist() == [7, 8, 9, 10, 11]
    assert curve.feeds == pytest.approx([math.nan, 2e-3, 1e-2, 1e-2, 1e-2], nan_ok=True)
    assert curve.vectors == pytest.approx(np.array([[0, 0, 1.0]] * 5))
    assert curve.before is not None and curve.after is not None
    assert curve.before.positions * 1e3 == pytest.approx(np.array([[0, 0, 50]]))
    assert curve.after.positions * 1e3 == pytest.approx(np.array([[6, 11.5, 50]]))
    assert toolpath.has_ways and toolpath.unit == "mm" and toolpath.unit_in_file
    notes = " ".join(toolpath.notes)
    for said in ("no tool axis is stated", "G0 (3 times)", "G54", "G43", "T, M6", "S, M3",
                 "motions to the machine's own positions (G28, G53, … in line 13)"):  # fmt: skip
        assert said in notes


def test_cuts_from_a_position_of_the_machine_are_left_out(tmp_path: Path) -> None:
    """Some CAM systems write rapid motions as fast cuts: those before Z is known, too."""
    text = HEAD + "G53 G0 Z0.\nG1 X5. Y6. F5000.\nG43 H1 Z3.\nZ0. F100.\nX9.\nM30\n"
    toolpath = read(tmp_path, text)
    assert millimetres(toolpath) == pytest.approx(np.array([[5, 6, 3], [5, 6, 0], [9, 6, 0]]))
    assert any("cuts are left out while" in note for note in toolpath.notes)


def test_inches_and_feeds_per_turn(tmp_path: Path) -> None:
    text = "G20\nG0 X0 Y0 Z0\nG1 X1 F10\nG95 S1200 X2 F.01\nG94 X3 F20\n"
    [curve] = read(tmp_path, text, "a.tap").curves
    assert curve.positions[:, 0] == pytest.approx([0, 0.0254, 0.0508, 0.0762])
    per_second = [math.nan, 0.254 / 60, 0.01 * 0.0254 * 20, 0.508 / 60]
    assert curve.feeds == pytest.approx(per_second, nan_ok=True)
    # An F of the other kind does not hold.
    [curve] = read(tmp_path, text.replace(" F20", ""), "a.tap").curves
    assert math.isnan(curve.feeds[-1])
    with pytest.raises(InvalidInput, match="line 4: the feed is per turn of the spindle"):
        read(tmp_path, text.replace(" S1200", ""), "a.tap")
    metres = read(tmp_path, "G1 X0 Y0 Z0\nX1\n", length_unit="mm")
    assert metres.curves[0].positions[1, 0] == pytest.approx(1e-3)


@pytest.mark.parametrize("suffix", ["nc", "gcode", "tap", "mpf", "ngc", "NC"])
def test_the_suffix_tells_the_format(tmp_path: Path, suffix: str) -> None:
    text = "G21 G1 X0 Y0 Z0\nX1\n"
    assert len(read(tmp_path, text, f"a.{suffix}").curves[0]) == 2
    assert len(read(tmp_path, text, "a.txt", format="gcode").curves[0]) == 2


# ---------------------------------------------------------------- arcs


@QUICK
@given(st.data())
def test_arcs_in_each_plane_are_circles(tmp_path: Path, data: st.DataObject) -> None:
    """Random arcs and helices, by the centre, absolute or relative, and by the radius."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    plane, normal = data.draw(st.sampled_from([(17, 2), (18, 1), (19, 0)]))
    code = data.draw(st.sampled_from([2, 3]))
    how = data.draw(st.sampled_from(["IJK", "G90.1", "R"]))
    relative = data.draw(st.booleans())
    radius, sweep = rng.uniform(1, 80), rng.uniform(0.05, 6.2)
    centre = rng.uniform(-40, 40, 3)
    axis = np.eye(3)[normal] * (1 if code == 3 else -1)
    first = np.roll(np.eye(3)[normal], 1) * radius
    start = centre + Rotation.from_rotvec(rng.uniform(0, 6) * axis).apply(first)
    start[normal] = centre[normal] = 3.0
    shares = np.linspace(0, 1, 400)
    rise = np.eye(3)[normal] * data.draw(st.sampled_from([0.0, 5.0]))
    true = centre + Rotation.from_rotvec(np.outer(shares * sweep, axis)).apply(start - centre)
    true = true + shares[:, None] * rise
    end = true[-1]
    stated = end - start if relative else end
    text = f"G21 G{plane}\nG0 X{start[0]:.7f} Y{start[1]:.7f} Z{start[2]:.7f}\n"
    text += f"G{91 if relative else 90} G{code} F300"
    text += "".join(f" {c}{v:.7f}" for c, v in zip("XYZ", stated, strict=True))
    if how == "R":
        text += f" R{radius if sweep <= math.pi else -radius:.7f}"
    else:
        of = centre if how == "G90.1" else centre - start
        text += " G90.1" if how == "G90.1" else ""
        text += "".join(f" {'IJK'[k]}{of[k]:.7f}" for k in range(3) if k != normal)
    toolpath = read(tmp_path, text + "\n", arc_error=2e-5)
    found = millimetres(toolpath)
    apart = np.linalg.norm(true[:, None] - found[None], axis=2)
    assert apart.min(axis=0).max() < 0.6 * (radius * sweep / 399 + 0.02) + 1e-2
    assert found[0] == pytest.approx(start, abs=1e-5)
    assert found[-1] == pytest.approx(end, abs=1e-5)
    length = np.linalg.norm(np.diff(found, axis=0), axis=1).sum()
    assert length == pytest.approx(math.hypot(radius * sweep, rise.sum()), rel=2e-3)
    assert np.diff(found @ np.eye(3)[normal]).min() > -1e-9


def test_a_quarter_circle_and_its_complement_and_a_full_circle(tmp_path: Path) -> None:
    """By hand: G2 is clockwise seen from +z; −R is the longer way."""
    head = "G21 G0 X10 Y0 Z0\n"
    for block, sweep, y in (
        ("G3 X0 Y10 I-10 J0 F1", 90, 1), ("G2 X0 Y10 I-10 F1", -270, -1),
        ("G2 X0 Y-10 R10 F1", -90, -1), ("G3 X0 Y-10 R-10 F1", 270, 1), ("G3 I-10 F1", 360, 1),
        ("G2 I-10 J0 F1", -360, -1), ("G18 G2 X0 Z10 I-10 F1", -90, 0),
    ):  # fmt: skip
        found = millimetres(read(tmp_path, head + block + "\n"))
        vertical = found[:, 2] if "G18" in block else found[:, 1]
        angles = np.unwrap(np.arctan2(vertical, found[:, 0]))
        expected = -sweep if "G18" in block else sweep  # x to z is left-handed about y
        assert math.degrees(angles[-1] - angles[0]) == pytest.approx(expected)
        if y:
            assert math.copysign(1, found[1, 1]) == y
        within = 10 * (1 - np.cos(np.diff(angles) / 2))
        assert np.abs(within).max() <= 0.01 + 1e-9


# ---------------------------------------------------------------- tool axes


AXES = {"a": "1 0 0", "b": "0 1 0", "c": "0 0 1"}
TABLE_AXES = {"a": "-1 0 0", "b": "0 -1 0", "c": "0 0 -1"}
"""ISO 841: A', B', C' of a table turn the part the other way round."""


def machine(rotary: Rotary) -> mujoco.MjModel:
    """A machine with a head, a table or both, as a model of its joints.

    The first letter of a head is the axis next to the tool, of a table the one next to the bed.
    """
    head, _, table = rotary.removesuffix("-reversed").partition("table")
    letters = head.removeprefix("head").strip("-")[::-1], table.strip("-")
    axes = AXES, AXES if rotary.endswith("-reversed") else TABLE_AXES
    branches = []
    for end, chain, directions in zip(("tool", "part"), letters, axes, strict=True):
        body = f'<body name="{end}"><geom size="1"/></body>'
        for letter in reversed(chain):
            joint = f'<joint name="{letter}" axis="{directions[letter]}"/>'
            body = f'<body><geom size="1"/>{joint}{body}</body>'
        branches.append(body)
    text = f"<mujoco><worldbody>{''.join(branches)}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


@pytest.mark.parametrize("rotary", [name for name in get_args(Rotary) if name != "vector"])
def test_rotary_axes_turn_the_tool_as_the_joints_of_a_machine_do(
    rotary: Rotary, tmp_path: Path
) -> None:
    model = machine(rotary)
    data = mujoco.MjData(model)
    letters = [model.joint(k).name for k in range(model.njnt)]
    assert len(letters) == 2
    for angles in np.random.default_rng(3).uniform(-110, 110, (20, 2)).tolist():
        stated = dict(zip(letters, angles, strict=True))
        for letter, angle in stated.items():
            data.joint(letter).qpos = math.radians(angle)
        mujoco.mj_kinematics(model, data)
        tool, part = (data.body(name).xmat.reshape(3, 3) for name in ("tool", "part"))
        expected = part.T @ tool[:, 2]
        found = tool_axis(rotary, [stated[letter.lower()] for letter in rotary_letters(rotary)])
        assert found == pytest.approx(expected, abs=1e-9)
        words = " ".join(f"{letter.upper()}{angle:.8f}" for letter, angle in stated.items())
        text = f"G21 G43.4 H1\nG0 X0 Y0 Z5 {words}\nG1 Z0 F100\n"
        toolpath = read(tmp_path, text, rotary=rotary)
        assert toolpath.curves[0].vectors == pytest.approx(np.array([expected] * 2), abs=1e-9)
        [note] = [note for note in toolpath.notes if f"by {rotary}" in note]
        shown = [float(value) for value in note.partition("(")[2].partition(")")[0].split(",")]
        assert shown == pytest.approx(expected, abs=1e-3)


ROLLS = "G21 G43.4 H1\nG0 X0 Y0 Z0 {axis}{begin}{other}\n{mode} G1 X10 {axis}{end} F100\n"


def turned_in_all(toolpath: Toolpath) -> float:
    """Angle by which the tool axis turns along the only curve, degrees."""
    [curve] = toolpath.curves
    assert curve.vectors is not None
    return math.degrees(float(angles_between(curve.vectors[:-1], curve.vectors[1:]).sum()))


@pytest.mark.parametrize(
    ("begin", "end", "short", "written"),
    [
        (359.8, 0.2, 0.4, 359.6), (0.2, 359.8, 0.4, 359.6), (-179.0, 179.0, 2.0, 358.0),
        (90, -100, 170, 190), (-300, -40, 100, 260),
        # Not beyond half a turn, a full turn or more, or words of an axis that counts its turns.
        (0, 180, 180, 180), (0, 360, 360, 360), (700, 720.5, 20.5, 20.5), (350, 640, 290, 290),
    ],
)  # fmt: skip
@pytest.mark.parametrize("axis", ["A", "B", "C"])
@pytest.mark.parametrize("kind", ["head", "table"])
def test_a_rotary_axis_that_rolls_over_takes_the_short_way(
    tmp_path: Path, kind: str, axis: str, begin: float, end: float, short: float, written: float
) -> None:
    """A and B turn the axis itself, C at a lean of 90° too."""
    rotary = f"{kind}-{'ac' if axis == 'C' else axis.lower() + 'c'}"
    other = " A90" if axis == "C" else " C0"
    text = ROLLS.format(axis=axis, begin=begin, end=end, other=other, mode="")
    by_default = read(tmp_path, text, rotary=rotary)
    assert turned_in_all(by_default) == pytest.approx(short, abs=1e-6)
    assert turned_in_all(read(tmp_path, text, rotary=rotary, rollover="shortest")) == (
        pytest.approx(short, abs=1e-6)
    )
    as_written = read(tmp_path, text, rotary=rotary, rollover="as-written")
    assert turned_in_all(as_written) == pytest.approx(written, abs=1e-6)
    relative = ROLLS.format(axis=axis, begin=begin, end=end - begin, other=other, mode="G91")
    assert turned_in_all(read(tmp_path, relative, rotary=rotary)) == (
        pytest.approx(written, abs=1e-6)
    )
    notes = " ".join(by_default.notes)
    assert ('rollover = "shortest" (the default' in notes) == (short != written)
    assert ("(line 3): all the way, as written" in notes) == (short == written > 180.0)
    assert ("as written" in " ".join(as_written.notes)) == (written > 180.0)


def test_between_two_points_the_rotary_axes_move_in_proportion(tmp_path: Path) -> None:
    """At a lean of 60° about a turning C, the axis follows the cone and not the great circle."""
    text = "G21 G43.4 H1\nG0 X0 Y0 Z0 A60 C0\nG1 X90 C90 F100\nG91 C-90\n"
    [curve] = read(tmp_path, text, rotary="head-ac").curves
    assert curve.vectors is not None
    assert curve.vectors[:, 2] == pytest.approx(0.5)
    first = curve.positions[:, 0].argmax()
    turn = np.degrees(np.arctan2(curve.vectors[: first + 1, 0], -curve.vectors[: first + 1, 1]))
    assert turn == pytest.approx(curve.positions[: first + 1, 0] * 1e3)
    assert np.diff(turn).max() <= 3.0 + 1e-9
    # The last block turns the tool in place, back to where it was.
    assert curve.vectors[-1] == pytest.approx(curve.vectors[0])
    assert np.ptp(curve.positions[first:], axis=0) == pytest.approx(0)


def test_vectors_are_the_tool_axis_where_the_file_or_the_option_says_so(tmp_path: Path) -> None:
    text = "G21\nG0 X0 Y0 Z5 I0 J0 K1\nG1 Z0 F100 I0 J-.6 K.8\nG3 X10 I5 J0\n"
    with pytest.raises(InvalidInput, match=r"line 2: .* the tool axis; if so, add rotary"):
        read(tmp_path, text)
    for found in (
        read(tmp_path, text, rotary="vector"),
        read(tmp_path, text.replace("G21", "G21 G43.5 H1")),
    ):
        [curve] = found.curves
        assert curve.vectors is not None
        assert curve.vectors[0] == pytest.approx([0, 0, 1])
        assert curve.vectors[1:] == pytest.approx(np.tile([0, -0.6, 0.8], (len(curve) - 1, 1)))
        assert curve.positions[:, 1].min() == pytest.approx(-5e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "rotary", "message"),
    [
        ("G43.4\nG0 X0 Y0 Z0 A30 B5\nG1 X1", None, "line 3: A is a rotary axis; add rotary"),
        ("G43.4\nG0 X0 Y0 Z0 B30\nG1 X1", "head-ac", "line 3: B is not one of the rotary axes of"),
        ("G0 X0 Y0 Z0 A30\nG1 X1 Y0 Z0", "head-ac", "line 3: the rotary axes are turned without"),
        ("M428\nM429\nG0 X0 Y0 Z0 A30\nG1 X1", "head-ac", "line 5: the rotary axes are"),
        ("G43.4\nG0 X0 Y0 Z0\nG1 X1 A30", "head-ac", "line 4: A is first stated here, after the"),
        ("G0 X0 Y0 Z0\nG1 X1 I0 J1", "vector", "line 3: the tool axis has I and J alone"),
        ("G0 X0 Y0 Z0\nG1 X1 I0 J0 K0", "vector", "line 3: the tool axis is zero"),
        ("G43.4\nG0 X0 Y0 Z0 A30\nX1 A30 A3=0 C3=1", "head-ac", "by a vector and by rotary axes"),
    ],
)  # fmt: skip
def test_a_tool_axis_that_is_open_is_refused(
    tmp_path: Path, text: str, rotary: Rotary | None, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, f"G21\n{text} F100\n", rotary=rotary)


def test_without_control_of_the_tip_rapid_motions_lead_to_an_unknown_place(tmp_path: Path) -> None:
    """Turning before G43.4 and after G49 is usual; the points of the machine are left out."""
    text = (
        "G21 G90\nG0 G53 Z0\nG0 A30 C40\nG0 X5 Y5\nG43.4 H1 X0 Y0 Z20\nG1 Z0 F100\nX10\nG0 Z20\n"
        "G49\nG0 Z300\nA0 C0\nG0 X7\nM30\n"
    )
    toolpath = read(tmp_path, text, rotary="table-ac")
    assert millimetres(toolpath) == pytest.approx(np.array([[0, 0, 20], [0, 0, 0], [10, 0, 0]]))
    [curve] = toolpath.curves
    assert curve.before is None and curve.after is not None
    assert curve.after.positions * 1e3 == pytest.approx(np.array([[10, 0, 20]]))


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("G41 D1 X2", "G41 is a shift by the tool's radius, .* path of the tool's centre"),
        ("G68 X0 Y0", "G68 is read with R"), ("G68.2 P1 I10", "G68.2 with P, Q or R states"),
        ("G53.1", "there is none"), ("G52 X1\nG68.2 I1", "line 5: G68.2 in coordinates that are"),
        ("G51 P2", "G51 is a scaled path"), ("G51.1 X0", "G51.1 is a mirrored path"),
        ("G28 X0\nG92 X0", "line 5: G92: where the tool is in X is not known"),
        ("G68 X0 Y0 R9\nG52 X1", "line 5: a shift of coordinates that are turned"),
        ("G50 X1", "G50 is a shift of coordinates"), ("G16", "G16 is polar coordinates"),
        ("G10 L2 P1 X0", "G10 moves an offset"),
        ("G65 P9000", "G65: program O 9000 is not in this file"),
        ("G81 Z-5 R-9", "G81: R is below Z"), ("G81 Z-5", "G81: R is not stated"),
        ("G18 G81 Z-5 R2", "in the plane of G17 alone"), ("G87 X1", "G87 is a boring cycle"),
        ("G1 X2 ,R5\nY1", "line 5: the corner takes 5 mm of cuts"),
        ("G1 X2 ,R.5\nG0 Y1", "line 5: a corner is cut between two straight cuts alone"),
        ("CYCLE81(5,0,1)", "CYCLE81.5,0,1.: expected RTP, RFP, SDIS and DP or DPR"),
        ("CYCLE81(30,0,3,-20,7)", "DP and DPR are two depths"),
        ("ATRANS X10\nG91 X2", "line 5: X is relative, and its frame has changed"),
        ("R1=5\nX=R1 R1=6", "line 5: an R parameter is set in a block whose words use one"),
        ("#3=6 G1 X#3", "#3 has no value in this file"),
        ("G93 X5 F4 RND=1 FRC=2", "FRC and FRCM with G93"),
        ("CYCLE81(5,R,1,-3)", "expected numbers, got 'R'"),
        ("CYCLE84(5,0,1,-3)", "CYCLE84 is a cycle of the control"),
        ("CYCLE800(1,\"T\",0,192,0,0,0,1,2,3)", "CYCLE800 with the mode 192 states the plane"),
        ("ROT X20", "ROT about X tilts the plane"), ("BSPLINE X1", "BSPLINE is a spline"),
        ("POLY PO[X]=(1)", "is not computed|POLY is a polynomial"),
        ("CIP X1", "two points of the arc are the same"), ("G0 X5\nCT X1", "line 5: CT: expected"),
        ("G65 P1 A1", "G65: program O 1 is not"), ("M206 X5", "M206 has coordinates"),
        ("MYCYCLE(5)", "'MYCYCLE' is not read"), ("NEXTPART", "'NEXTPART' is not read"),
        ("G55 X2", "G55 is another frame than before"), ("G123", "G123 is not known"),
        ("G5 X1 Y1 I1 J1 P0 Q0", "G5 is a spline"),
        ("M98 P1000", "M98: program O 1000 is not in this file"), ("#101=[5", "is not computed"),
        ("X#101", "#101 has no value in this file"), ("X[1/0]", "has no value: .* zero"),
        ("X[2 FOO 3]", "is not computed"), ("X[[-1]**.5]", "is not computed|has no value"),
        ("IF [1 EQ 1] GOTO 10", "GOTO 10 is not in this file"),
        ("O<there> CALL", "O<there> calls a subprogram that is not in this file"),
        ("N7 GOTO 7", "run more than 100000 blocks beside"),
        ("X=R1+2", "R1 has no value in this file"), ("X=ACP(5)", "is not read"),
        ("M97 P7 L999999\nN7", "999999 repeats of a subprogram; at most 100000"),
        ("L9000", "L calls or repeats a subprogram"),
        ("U5", "U is no word that is known"),
        ("X1 X2", "X is there twice"), ("G0 G1 X1", "one code of a group; got several: G0, G1"),
        ("G91 X1 G90 Y5", "one code of a group; got several: G91, G90"),
        ("/X5", "a block behind / is run or not by a switch"), ("(open", "no closing bracket"),
        ("G1 R5 X1", "R belongs to an arc"), ("F0", "F: expected a feed above 0, got 0"),
        ("G93 X5 F4\nX9", "line 5: G93: each block that cuts needs its own F"),
        ("G20", "the unit changes after the first motion"),
        ("G2 X1 Y1", "has its centre in I and J, or a radius R; got neither"),
        ("G2 X1 Y1 R5 I1", "a radius R or a centre I, J, K; got both"),
        ("G2 R5", "ends at its start; write a full circle by I, J"),
        ("G2 X50 R5", "are 49 mm apart, more than twice its radius, 5 mm"),
        ("G2 X9 Y1 I5", "the arc starts 5 mm from its centre and ends 3.16228 mm"),
        ("G2 X2 I.5 K1", "has its centre in I and J alone; got I, K"),
        ("G2 X2 I.5 P3", "P: several turns are not read"),
        ("G2 I0 J0", "has the radius zero"), ("G19 G2 Y2 I1", "has its centre in J and K"),
        ("G90.1 G2 X2 I1.5", "G90.1: the centre needs both I and J"),
        ("G28 Z0\nG17 G2 X5 R9", "line 5: G2: where the tool is in Z is not known"),
        ("G28\nG91 X5", "line 5: X is relative to a position that is not known"),
        ("R1=-7 MOD 4\nX=R1", "controls differ in how a quotient below 0 is cut off"),
        ("G53 Z0\nG2 X2 I.5", "line 5: G2: where the tool is in Z is not known"),
    ],
)  # fmt: skip
def test_what_changes_the_path_or_is_open_is_refused_with_its_line(
    tmp_path: Path, block: str, message: str
) -> None:
    where = "" if "line 5" in message else "line 4: .*"
    with pytest.raises(InvalidInput, match=where + message):
        read(tmp_path, f"G21 G54\nG0 X0 Y0 Z0\nG1 X1 F100\n{block}\nX3\n")


@pytest.mark.parametrize(
    ("block", "ends"),
    [
        ("#3=15\nG1 X#3 #3=50\nY#3", [[15, 0], [15, 50]]),
        ("#3=6\n#3=9 G1 X#3 Y[#3+1] #4=[#3*2]\nY#4", [[6, 7], [6, 12]]),
        ("R[1]=7\nX=R[1]", [[7, 0]]),
        ("X=SIN(30)*10 (half)", [[5, 0]]),
        ('($Message("in [Files] #1") )\nX5', [[5, 0]]),
        ("X=ATAN2(1,1)/9 Y=TAN(45)", [[5, 1]]),
        ("X=TRUNC(2.7) Y=10*ABS(-3)-7 MOD 4", [[2, 27]]),
        ("R1=3\nX=R1**2 Y=R1 DIV 2", [[9, 1]]),
        ("G641 ADIS=0.5 X2", [[2, 0]]),
        ("ATRANS X10\nX1\nG91 X1 Y5\nG90", [[11, 0], [12, 5]]),
    ],
)
def test_values_are_those_that_the_control_computes(
    tmp_path: Path, block: str, ends: list[list[float]]
) -> None:
    toolpath = read(tmp_path, f"G21 G90\nG0 X0 Y0 Z0\nG1 Y0.5 F100\nY0\n{block}\n")
    assert millimetres(toolpath)[3:, :2] == pytest.approx(np.array(ends))


def test_holes_are_where_polar_words_say(tmp_path: Path) -> None:
    text = "G21 G90\nG0 X1 Y2 Z10\nG81 @5 ^45 Z-3 R1 F20\n@10\nG91 @2 ^0 Z-4 R-9 L2\nG80\n"
    holes = [1e3 * curve.positions[-1, :2] for curve in read(tmp_path, text).curves]
    radii = np.array([5, 10, 12, 14])
    assert holes == pytest.approx(np.outer(radii, [math.sqrt(0.5)] * 2))


@pytest.mark.parametrize(
    ("words", "feed"), [("RND=2 FRC=20", 20), ("FRCM=30 CHR=2", 30), ("FRCM=30 RND=2 FRC=9", 9)]
)
def test_a_corner_has_a_feed_of_its_own(tmp_path: Path, words: str, feed: float) -> None:
    [curve] = read(tmp_path, f"G21 G90\nG0 X0 Y0 Z0\nG1 X10 {words} F100\nY10\n").curves
    assert curve.feeds is not None
    per_minute = 6e4 * curve.feeds[1:]
    assert per_minute == pytest.approx([100, *[feed] * (len(curve) - 3), 100])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("G91\nX1\nG90\nX9\n", False),
        ("M83\nG1 X1 E1\nG91\nX1 E1\nG90\nX9 E5\n", True),
        ("M83\nG1 X1 E1\nX2 E1\n", False),
    ],
)
def test_what_g90_does_to_filament_is_said_where_there_is_some(
    tmp_path: Path, text: str, said: bool
) -> None:
    notes = read(tmp_path, f"G21 G90\nG0 X0 Y0 Z0\nG1 F100\n{text}").notes
    assert any("G90 makes E absolute" in note for note in notes) == said


def test_words_without_blanks_are_those_of_a_mill(tmp_path: Path) -> None:
    found = millimetres(read(tmp_path, "G21G90\nG0X0Y0Z5\nG1 Z0 F100\nG1X10Y20\nX30\n"))
    assert found[-2:].tolist() == [[10, 20, 0], [30, 20, 0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X0 Y0 Z0\n", "line 1: no G0, G1, G2 or G3 says how to move there"),
        ("G21\nM30\n", "there is no motion to a point with all coordinates"),
        ("G21 G0 X0 Y0 Z0\nG0 X5\n", "nothing is cut"),
        ("G21 G0 X0 Y0 Z0\nG1 X10. F100\nX5000\n", "line 3: X5000 has no decimal point, and"),
        ("G21 G0 X0 Z0\nG1 X10 F100\n", "X and Z alone are the program of a lathe"),
        ("G21 G0 X0 Y0 Z0\nG1 X999999. F1\n", "1000 m from the origin"),
    ],
)  # fmt: skip
def test_a_program_that_is_not_clear_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, text)


def test_options_of_other_formats_are_refused(tmp_path: Path) -> None:
    text = "G21 G1 X0 Y0 Z0\nX1 F1\n"
    with pytest.raises(InvalidInput, match="states the unit of a feed itself"):
        read(tmp_path, text, feed_unit="mm/s")
    with pytest.raises(InvalidInput, match="a G-code file has tool axes"):
        read(tmp_path, text, orientation="rpy")
    with pytest.raises(InvalidInput, match=r"the file is in mm, and length_unit \(--unit\) says m"):
        read(tmp_path, text, length_unit="m")
    with pytest.raises(InvalidInput, match="states tool axes as vectors; leave rotary"):
        read(tmp_path, "UNITS/MM\nGOTO/0,0,0\nGOTO/1,0,0\n", "a.apt", rotary="head-ac")


PIECES = ("G0", "G1", "G2", "G3", "G17", "G18", "G90", "G91", "G43.4", "G49", "G28", "G53", "X",
          "Y", "Z", "A", "C", "I", "J", "K", "R", "F", "1", "-2.5", "10.", "0", "nan", "1e9", "(",
          ")", ";", "/", "=", "[", "#", "%", "\n", "\n", "\n", " ", "M30", "T1 M6", "TRAORI", "A3=",
          "é", '"')  # fmt: skip


@settings(QUICK, max_examples=80)
@given(st.lists(st.sampled_from(PIECES), max_size=40))
def test_any_text_is_read_or_refused_in_a_sentence(tmp_path: Path, pieces: list[str]) -> None:
    text = "G21 G90 G43.4\nG0 X0 Y0 Z0 A10 C0\nG1 X5 F100\n" + "".join(pieces)
    try:
        toolpath = read(tmp_path, text, rotary="head-ac")
    except InvalidInput as error:
        assert error.file.endswith("part.nc")
    else:
        for curve in toolpath.curves:
            assert np.isfinite(curve.positions).all()
            assert curve.vectors is not None
            assert np.linalg.norm(curve.vectors, axis=1) == pytest.approx(1.0)


# ---------------------------------------------------------------- numbers without bounds


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("G1 X1. B100000000.", "line 4: a rotary axis turns by 1e+08 degrees in one cut"),
        ("G17 G2 X40. I" + 11 * "9" + ". J0", "line 4: the arc has a radius above"),
        ("G17 G3 X40. R" + 400 * "9" + ".", "line 4: R: "),
    ],
)
def test_a_number_that_would_make_endless_points_is_refused(
    text: str, sentence: str, tmp_path: Path
) -> None:
    head = "G21 G90 G43.4\nG0 X0. Y0. Z0. B0.\nG1 X0.5 F600.\n"
    with pytest.raises(InvalidInput, match=re.escape(sentence)):
        read(tmp_path, f"{head}{text}\n", rotary="head-bc")
    # A hundred turns are a number that somebody may mean.
    assert len(read(tmp_path, f"{head}G1 X1. B36000.\n", rotary="head-bc").curves[0]) == 12002


def test_arcs_of_a_file_have_a_bounded_number_of_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arcs = "G21 G17 G90\nG0 X0 Y0 Z0\nG1 X1 F600\n" + 9 * "G2 X1 Y0 I90000 J0\n"
    with pytest.raises(InvalidInput, match="at most 1000000 points are read"):
        read(tmp_path, arcs, arc_error=1e-20)
    monkeypatch.setattr("qp_twist.paths.toolpath_builder.MOST_POINTS", 20_000)
    with pytest.raises(InvalidInput, match="more than 20000 points"):
        read(tmp_path, arcs, arc_error=1e-5)


def test_a_rapid_motion_to_where_the_tool_is_adds_no_point(tmp_path: Path) -> None:
    """Two points at one place have no time between them: a path with rapids could not be run."""
    toolpath = read(tmp_path, "G21 G90\nG0 X0 Y0 Z10\nG0 X0 Y0 Z10\nG0 X5\nG0 X5 Z10\nG1 Z0 F600\n")
    (curve,) = toolpath.curves
    assert curve.before is not None
    assert (1e3 * curve.before.positions).tolist() == [[0, 0, 10]]
    assert (1e3 * curve.positions).tolist() == [[5, 0, 10], [5, 0, 0]]


def test_cuts_that_go_nowhere_are_no_curve_of_their_own(tmp_path: Path) -> None:
    text = "G21 G90\nG0 X0 Y0 Z10\nG1 Z10 F600\nG0 X5\nG1 Z10\nG1 Z0\nG0 Z10\nG1 Z10\n"
    (curve,) = read(tmp_path, text).curves
    assert (1e3 * curve.positions).tolist() == [[5, 0, 10], [5, 0, 0]]
    assert curve.before is not None and curve.after is not None
    assert (1e3 * curve.before.positions).tolist() == [[0, 0, 10]]
    assert (1e3 * curve.after.positions).tolist() == [[5, 0, 10]]


def test_a_carriage_return_inside_a_line_ends_no_line(tmp_path: Path) -> None:
    """A text with line ends of its own may have a stray one, as in a tool's name."""
    toolpath = read(tmp_path, "G21 G90 ;MILL\r 14 LONG\nG0 X0 Y0 Z0\nG1 X1 F600\nX2\n")
    assert millimetres(toolpath).tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert toolpath.curves[0].lines.tolist() == [2, 3, 4]


def test_a_way_from_where_the_tool_is_not_known_is_no_cut(tmp_path: Path) -> None:
    """What the program states later is unknown before; what it never states is 0."""
    toolpath = read(tmp_path, "G21 G90\nG1 Z5 F600\nG1 X10\nG1 Y20\nG1 Z0\nX30\n")
    assert millimetres(toolpath).tolist() == [[10, 20, 5], [10, 20, 0], [30, 20, 0]]
    assert any("left out" in note for note in toolpath.assumptions)
    flat = read(tmp_path, "G21 G90\nG0 X10 Y20\nG1 X30 F600\n")
    assert millimetres(flat).tolist() == [[10, 20, 0], [30, 20, 0]]
    assert any("Z is 0 until it is stated" in note for note in flat.assumptions)


def test_words_that_count_for_the_motions_behind_them_are_not_passed_over(tmp_path: Path) -> None:
    tilted = "G21 G90 G54\nG68.2 X0 Y0 Z0 I0 J90 K0\nG53.1\nG0 X0 Y0 Z5\nG1 Z0 F600\nX9\nG69\n"
    notes = read(tmp_path, tilted).notes
    assert "words that change what follows are applied (3 times): G68.2, G53.1, G69." in notes
    assert "passed over, since they move nothing (once): G54." in notes
    offset = read(tmp_path, "G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F600\nG43.1 Z-10\nX9\n")
    assert millimetres(offset)[-1] == pytest.approx([9, 0, 0])
    with pytest.raises(InvalidInput, match="a pattern of holes"):
        read(tmp_path, "G20 G90\nG0 X0 Y0 Z1\nG81 Z-.5 R.1 F10. L0\nG70 I2. J30. L6\n")


# ---------------------------------------------------------------- feeds and units


def test_a_feed_in_inverse_time_gives_each_block_its_time(tmp_path: Path) -> None:
    """A line of 30 mm in 1/4 minute, a half circle of radius 10 mm in half a minute."""
    text = "G21 G90\nG0 X0 Y0 Z0\nG93\nG1 X30 F4\nG3 X10 Y0 I-10 J0 F2\nG94 G1 X0 F600\n"
    toolpath = read(tmp_path, text)
    [curve] = toolpath.curves
    assert curve.feeds is not None
    steps = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1)
    times = steps / curve.feeds[1:]
    by_line = {line: times[curve.lines[1:] == line].sum() for line in (4, 5, 6)}
    assert by_line[4] == pytest.approx(15.0)
    assert by_line[5] == pytest.approx(30.0)
    assert by_line[6] == pytest.approx(1.0)
    assert np.ptp(curve.feeds[1:][curve.lines[1:] == 5]) < 1e-9
    assert curve.feeds[1] == pytest.approx(0.030 * 4 / 60)
    assert summarize(toolpath).time == pytest.approx(46.0)


def test_a_turn_in_place_in_inverse_time_has_no_feed(tmp_path: Path) -> None:
    text = "G21 G90 G43.4\nG0 X0 Y0 Z0 A0 C0\nG93\nG1 A30 F10\nG1 X10 F10\n"
    [curve] = read(tmp_path, text, rotary="table-ac").curves
    assert curve.feeds is not None
    assert np.isnan(curve.feeds[curve.lines == 4]).all()
    assert curve.feeds[curve.lines == 5] == pytest.approx(0.01 * 10 / 60)


def test_a_unit_is_assumed_where_only_one_fits_an_arm(tmp_path: Path) -> None:
    toolpath = read(tmp_path, "G90 G0 X0 Y0 Z0 (X9000)\nG1 X1400 F600\n")
    assert (toolpath.unit, toolpath.unit_in_file) == ("mm", False)
    assert "as inches it would be 35.6 m long; --unit inch reads it so." in toolpath.notes[0]
    # Either may be: mm unless a comment says inches; neither can be: asked.
    toolpath = read(tmp_path, "G90 G0 X0 Y0 Z0\nG1 X300 F600\n")
    assert toolpath.curves[0].positions[1, 0] == pytest.approx(0.3)
    toolpath = read(tmp_path, "(UNITS: INCH)\nG90 G0 X0 Y0 Z0\nG1 X30 F600\n")
    assert toolpath.curves[0].positions[1, 0] == pytest.approx(0.762)
    for text in ("G0 X0 Y0 Z0\nG1 X20000. F600\n", "(INCH or MM)\nG0 X0 Y0 Z0\nG1 X3 F600\n"):
        with pytest.raises(InvalidInput, match="no unit of length before the first point"):
            read(tmp_path, text)
