"""Feeds in inverse time, switches of the kinematics, and units that nothing states."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath, read_toolpath
from qp_twist.paths.toolpath_summary import summarize


def read(folder: Path, text: str, **options: object) -> Toolpath:
    file = folder / "part.nc"
    file.write_text(text)
    return read_toolpath(file, **options)


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G93\nG1 X1 F4\nG1 X2\n", "line 4: G93: each block that cuts needs its own F"),
        ("G93\nG1 X1 F0\n", "line 3: F: expected a feed above 0, got 0"),
    ],
)
def test_a_feed_in_inverse_time_that_is_none_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, "G21 G90 G0 X0 Y0 Z0\n" + text)


def test_a_turn_in_place_in_inverse_time_has_no_feed(tmp_path: Path) -> None:
    text = "G21 G90 G43.4\nG0 X0 Y0 Z0 A0 C0\nG93\nG1 A30 F10\nG1 X10 F10\n"
    [curve] = read(tmp_path, text, rotary="table-ac").curves
    assert curve.feeds is not None
    assert np.isnan(curve.feeds[curve.lines == 4]).all()
    assert curve.feeds[curve.lines == 5] == pytest.approx(0.01 * 10 / 60)


def test_linuxcnc_switches_control_of_the_tip_on_and_off(tmp_path: Path) -> None:
    text = "G21 G90\nM428\nG0 X0 Y0 Z0 A30 C0\nG1 X10 F600\n"
    [curve] = read(tmp_path, text, rotary="table-ac").curves
    vectors = curve.vectors
    assert vectors is not None
    np.testing.assert_allclose(
        vectors[0], [0.0, -math.sin(math.pi / 6), math.cos(math.pi / 6)], atol=1e-12
    )
    with pytest.raises(InvalidInput, match="without control of the tool's tip"):
        read(tmp_path, text.replace("M428", "M428\nM429"), rotary="table-ac")


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
