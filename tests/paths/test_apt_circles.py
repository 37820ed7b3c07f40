"""Circles of APT-CL behind which a point is on the circle, too."""

import math
from pathlib import Path

import numpy as np
import pytest

from qp_twist.errors import InvalidInput
from qp_twist.paths import read_toolpath

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
