"""APT as CAM systems write it, against paths computed here by angles, matrices and de Boor's rule.

The inputs are made up after files of the systems: their words, their order and their numbers.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from corpus.apt_nx import END as NX_END
from corpus.apt_nx import HEAD as NX
from hypothesis import given
from hypothesis import strategies as st

from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath, read_toolpath
from qp_twist.paths.splines import clamped_cubic

Array = npt.NDArray[np.float64]
CAMWORKS = """PARTNO/1
UNIT/MM
INSERT/[HOLDER=C40] 20.0mm END MILL
CUTTER/20.,0,10.,0,0,0,100.
LOAD/TOOL,5
CSI_SET_FLUTE_LENGTH/32.
CSI_SET_EXTENSION_LENGTH/60.
SELECT/TOOL,5
SETUP/START,1
COOLNT/FLOOD
SPINDL/2321,RPM,CLW
TRNTYP/WORLD,0,0,0
CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0
RAPID/
GOTO/20.,0,10.
FEDRAT/600.,MMPM
"""
CAMWORKS_END = "SETUP/END,1\nFINI\n"
CHORD = 2e-5
"""Twice the error allowed for chords, m."""


def read(folder: Path, text: str, name: str = "part.apt", **options: object) -> Toolpath:
    file = folder / name
    file.write_text(text)
    return read_toolpath(file, **options)


def lies_on(points: Array, curve: Array) -> float:
    """The largest distance of the points of a path from a densely sampled curve, m."""
    return max(float(np.linalg.norm(curve - point, axis=1).min()) for point in points)


def length(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def helix(begin_deg: float, end_deg: float, radius: float, low: float, high: float) -> Array:
    """Points of a helix about z, from one angle and height to another, m."""
    share = np.linspace(0.0, 1.0, 40_001)
    angle = np.radians(begin_deg + share * (end_deg - begin_deg))
    height = low + share * (high - low)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


# ------------------------------------------------------------------ units and words


def test_nx_states_its_unit_by_its_feeds(tmp_path: Path) -> None:
    toolpath = read(tmp_path, NX + "GOTO/20.0000,30.0000,10.0000\n" + NX_END)
    assert (toolpath.unit, toolpath.unit_in_file) == ("mm", False)
    assert "read as mm: its feeds are in MMPM; --unit inch reads it so." in toolpath.notes
    [curve] = toolpath.curves
    np.testing.assert_allclose(curve.positions, [[0.02, 0.0, 0.01], [0.02, 0.03, 0.01]])
    assert curve.name == "CONTOUR" and curve.feeds is not None
    assert curve.feeds[1] == pytest.approx(0.01)
    inches = read(tmp_path, NX + "GOTO/20,30,10\n", length_unit="inch")
    assert inches.curves[0].positions[1, 1] == pytest.approx(30 * 0.0254)
    assert not any("read as" in note for note in inches.notes)


@pytest.mark.parametrize(
    ("feeds", "unit"),
    [("FEDRAT/10,IPM", "inch"), ("FEDRAT/.1,MMPR", "mm"), ("FEDRAT/10", None),
     ("FEDRAT/10,IPM\nFEDRAT/10,MMPM", None), ("", None)],
)  # fmt: skip
def test_a_unit_is_assumed_only_where_all_feeds_say_the_same(
    tmp_path: Path, feeds: str, unit: str | None
) -> None:
    text = f"SPINDL/1000,RPM\nGOTO/1,0,0\n{feeds}\nGOTO/2,0,0\n"
    if unit is None:
        with pytest.raises(InvalidInput, match="no unit of length before the first point"):
            read(tmp_path, text)
    else:
        assert read(tmp_path, text).unit == unit


def test_a_stated_unit_is_no_assumption(tmp_path: Path) -> None:
    toolpath = read(tmp_path, "UNITS/INCHES\nGOTO/1,0,0\nFEDRAT/600,MMPM\nGOTO/2,0,0\n")
    assert (toolpath.unit, toolpath.unit_in_file) == ("inch", True)


# ------------------------------------------------------------------ circles


ISO_4343 = """PARTNO/ 'PART 7'
MACHIN/ POST, 1
UNITS/ MM
MULTAX/ ON
LOADTL/ 3, IN, 1, LENGTH, 50.
SPINDL/ RPM, 8000, CLW
RAPID
GOTO/ 20., 0., 10., 0., 0., 1.
FEDRAT/ PERMIN, 600.
"""
NX_ARC = "CIRCLE/0.,0.,{:g},0.,0.,{:g},20.,0.0600,0.5000,20.0000,1.0000"
ISO_ARC = "MOVARC/ CENTER, 0., 0., 10., AXIS, 0., 0., {:g}, RADIUS, 20.\nGOTO/ 0., 20., 10.\n"


@pytest.mark.parametrize(
    ("text", "sweep", "height"),
    [
        (NX + NX_ARC.format(10, 1) + "\nGOTO/0,-20.,10.\n" + NX_END, -90.0, 10.0),
        (NX + NX_ARC.format(10, -1) + "\nGOTO/0,-20.,10.\n" + NX_END, 270.0, 10.0),
        *((f"{NX}{NX_ARC.format(4, -1)},TIMES,{turns}\nGOTO/0.,20.,4.\n{NX_END}",
           360.0 * turns - 270.0, 4.0) for turns in (1, 2, 3)),
        *((f"{CAMWORKS}CIRCLE/0,0,10.,0,0,{axis}.\nGOTO/0,20.,10.\n{CAMWORKS_END}", sweep, 10.0)
          for axis, sweep in ((1, 90.0), (-1, -270.0))),
        *((f"{ISO_4343}{ISO_ARC.format(axis)}FINI\n", sweep, 10.0)
          for axis, sweep in ((1, 90.0), (-1, -270.0))),
    ],
)  # fmt: skip
def test_circles_turn_as_their_dialect_has_it(
    tmp_path: Path, text: str, sweep: float, height: float
) -> None:
    """Of NX clockwise about the axis, TIMES counts the turns begun; of others right-handed."""
    [curve] = read(tmp_path, text).curves
    assert lies_on(curve.positions, helix(0.0, sweep, 0.02, 0.010, 1e-3 * height)) < CHORD
    way = math.hypot(0.02 * math.radians(sweep), 0.010 - 1e-3 * height)
    assert length(curve.positions) == pytest.approx(way, rel=2e-3)


def test_a_cusp_beside_a_circle_does_not_turn_the_sense_of_a_dialect(tmp_path: Path) -> None:
    """The tool comes along the tangent and goes back: nothing speaks for the other way round."""
    cusp = "GOTO/20.,10.,10.\nGOTO/20.,0,10.\nCIRCLE/0,0,10.,0,0,1.\nGOTO/0,20.,10.\n"
    [curve] = read(tmp_path, CAMWORKS + cusp + CAMWORKS_END).curves
    assert curve.positions[:, 0].min() > -1e-9


# ------------------------------------------------------------------ splines


def de_boor(control: Array, inner: Array, at: float) -> Array:
    """A point of a clamped cubic B-spline by de Boor's recursion."""
    knots = [0.0] * 4 + list(inner) + [1.0] * 4
    k = max(j for j in range(3, len(control)) if knots[j] <= at or j == 3)
    d = [control[j] for j in range(k - 3, k + 1)]
    for r in range(1, 4):
        for j in range(3, r - 1, -1):
            low, high = knots[j + k - 3], knots[j + 1 + k - r]
            share = (at - low) / (high - low)
            d[j] = (1.0 - share) * d[j - 1] + share * d[j]
    return np.asarray(d[3])


@given(seed=st.integers(0, 10**6), inner=st.integers(0, 6))
def test_chords_of_a_spline_are_as_near_to_it_as_asked(seed: int, inner: int) -> None:
    rng = np.random.default_rng(seed)
    control = 0.1 * rng.normal(size=(inner + 4, 3))
    knots = np.sort(rng.uniform(0.05, 0.95, size=inner))
    error = 1e-4
    points, at = clamped_cubic(control, knots, error)
    np.testing.assert_allclose(points[-1], control[-1], atol=1e-15)
    ends, begins = np.append(0.0, at), control[0]
    chain = np.vstack([begins, points])
    for k in range(len(at)):
        exact = de_boor(control, knots, 0.5 * (ends[k] + ends[k + 1]))
        assert np.linalg.norm(exact - 0.5 * (chain[k] + chain[k + 1])) <= 1.001 * error
        np.testing.assert_allclose(points[k], de_boor(control, knots, at[k]), atol=1e-12)


def test_nx_splines_begin_where_the_tool_is(tmp_path: Path) -> None:
    control = np.array([[20, 0, 10], [25, 10, 12], [15, 20, 8], [10, 10, 9], [0, 0, 10]]) / 1e3
    words = "".join(f"CNTRL/{x:.4f},{y:.4f},{z:.4f}\n" for x, y, z in 1e3 * control[1:])
    text = NX + "NURBS/\nKNOT/0.4000000,1.0000000\n" + words + "GOTO/0,-5.,10.\n" + NX_END
    [curve] = read(tmp_path, text).curves
    expected = [de_boor(control, np.array([0.4]), t) for t in np.linspace(0.0, 1.0, 4001)[:-1]]
    assert lies_on(curve.positions[:-1], np.array([*expected, control[-1]])) < CHORD
    np.testing.assert_allclose(curve.positions[-1], [0.0, -0.005, 0.01])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("NURBS/\nKNOT/1.\nCNTRL/1,0,0\n", "a cubic spline of 2 control points, the start"),
        ("NURBS/\nKNOT/.5\nCNTRL/1,0,0\nCNTRL/2,0,0\nCNTRL/3,0,0\n", "knots that end in 1"),
        ("NURBS/\nKNOT/.7,.2,1\n" + "CNTRL/1,0,0\n" * 5, "the knots of a spline ascend"),
        ("NURBS/\nKNOT/1\nCNTRL/1,0,0,0,0,1\n", "CNTRL takes x, y, z; got 6 numbers"),
        ("KNOT/1\n", "KNOT: expected NURBS before it"), ("CNTRL/1,1,1\n", "expected NURBS before"),
    ],
)  # fmt: skip
def test_a_spline_that_is_none_is_refused(tmp_path: Path, words: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, NX + words + "GOTO/0,0,0\n" + NX_END)


# ------------------------------------------------------------------ drilling


@pytest.mark.parametrize(
    ("cycle", "axis", "above", "near", "depth"),
    [
        ("DRILL,FEDTO,8.,MMPM,300.,RAPTO,3.,RTRCTO,25.,DWELL,0", (0.0, 0.0, 1.0), 25, 3, 8),
        ("DEEP2,FEDTO,31.8,1STPECK,5.,SUBPECK,2.,MMPM,300,RAPTO,3.", (0.0, 0.0, -1.0), 3, 3, 31.8),
        ("DRILL,DEEP,RAPTO,3.0000,FEDTO,-6.0000,MMPM,300.0000", (0.6, 0.0, 0.8), 3, 3, 6),
    ],
)
def test_a_drilling_cycle_goes_along_the_axis_and_back(
    tmp_path: Path, cycle: str, axis: tuple[float, ...], above: float, near: float, depth: float
) -> None:
    direction = ",".join(map(str, axis))
    text = f"{CAMWORKS}CYCLE/INIT\nCYCLE/{cycle}\n" + "".join(
        f"GOTO/{x}.,0,0,{direction}\n" for x in (10, 30)
    )
    toolpath = read(tmp_path, text + "CYCLE/OFF\n" + CAMWORKS_END)
    out = np.array(axis)
    assert len(toolpath.curves) == 2
    for curve, x in zip(toolpath.curves, (0.010, 0.030), strict=True):
        hole = np.array([x, 0.0, 0.0])
        np.testing.assert_allclose(
            curve.positions, [hole + 1e-3 * near * out, hole - 1e-3 * depth * out], atol=1e-12
        )
        assert curve.feeds is not None and curve.feeds[1] == pytest.approx(0.005)
        np.testing.assert_allclose(curve.vectors, [axis, axis])
    last = toolpath.curves[-1].after
    assert last is not None
    np.testing.assert_allclose(last.positions[-1], np.array([0.03, 0, 0]) + 1e-3 * above * out)
    assert any("CYCLE (" in note and "without pecking" in note for note in toolpath.notes)


@pytest.mark.parametrize(
    ("cycle", "message"),
    [
        ("TAP,FEDTO,8,RAPTO,3", "CYCLE/TAP is a cycle, which is not read"),
        ("DRILL,8,MMPM,300,3", "CYCLE/DRILL: '8' is not known in a cycle"),
        ("DRILL,FEDTO,8", "CYCLE/DRILL: expected FEDTO and RAPTO"),
        ("DRILL,FEDTO,RAPTO,3", "CYCLE/DRILL, FEDTO: expected a number, got 'RAPTO'"),
        ("DRILL,FEDTO", "CYCLE/DRILL, FEDTO: it is missing"),
    ],
)
def test_another_cycle_is_refused_by_its_name(tmp_path: Path, cycle: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, f"{CAMWORKS}CYCLE/{cycle}\nGOTO/1,0,0\nGOTO/2,0,0\n{CAMWORKS_END}")


# ------------------------------------------------------------------ frames


def test_points_of_camworks_are_in_the_world_whatever_the_set_up(tmp_path: Path) -> None:
    turned = CAMWORKS.replace(
        "CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0", "CSYS/0,0,-1.,0,-1.,0,0,0,0,1.,0,5."
    )
    toolpath = read(tmp_path, turned + "GOTO/30.,0,10.\n" + CAMWORKS_END)
    np.testing.assert_allclose(toolpath.curves[0].positions[:, 0], [0.02, 0.03])
    assert any(note.startswith("CSYS (line 13)") for note in toolpath.notes)


def test_a_frame_that_the_points_are_in_is_refused(tmp_path: Path) -> None:
    for change in (("TRNTYP/WORLD,0,0,0\n", ""), ("TRNTYP/WORLD", "TRNTYP/LOCAL")):
        text = CAMWORKS.replace(*change).replace("CSYS/1.", "CSYS/-1.")
        with pytest.raises(InvalidInput, match="is a change of coordinates, which is not read"):
            read(tmp_path, text + "GOTO/30.,0,10.\n" + CAMWORKS_END)


HEAD = "$$-> MFGNO / M\nUNITS / MM\n"


def arcs(count: int, seconds: int) -> str:
    """Quarter circles, some of them with a second point on the circle 30 degrees on."""
    text = HEAD
    on = f"GOTO / {-10 * math.sin(math.pi / 6):.7f}, {10 * math.cos(math.pi / 6):.7f}, 0.\n"
    for k in range(count):
        text += (
            "RAPID\nGOTO / 10., 0., 0.\nCIRCLE / 0., 0., 0., 0., 0., 1., 10.\nGOTO / 0., 10., 0.\n"
        )
        text += on if k < seconds else ""
        text += "GOTO / -20., 10., 0.\n"
    return text


def test_a_second_point_on_a_circle_ends_a_chord_where_other_circles_have_one(
    tmp_path: Path,
) -> None:
    file = tmp_path / "part.ncl"
    file.write_text(arcs(4, 1))
    toolpath = read_toolpath(file)
    first = toolpath.curves[0].positions
    radii = np.linalg.norm(0.5 * (first[1:, :2] + first[:-1, :2]), axis=1)
    assert np.sum(radii < 0.0099) == 1  # the middle of the chord
    assert any("a point behind an arc is on its circle, too" in note for note in toolpath.notes)
    file.write_text(arcs(4, 2))
    with pytest.raises(InvalidInput, match="the point is on the circle of line 5 too"):
        read_toolpath(file)
