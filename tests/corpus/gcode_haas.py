"""Haas, Mazak in its ISO language, and machines whose geometry is given."""

from itertools import pairwise

import numpy as np

from corpus import TruePath, case, mm, upright
from corpus.gcode_fanuc import turned


@case("Haas", "umc.nc", "%\nO00021 (BRACKET)\n(USING HIGH FEED G1 F500.)\n"
      "G00 G17 G40 G53 G80 G49 G90\n"
      "T5 M06\nG103 P1\nG154 P2\nG187 P2 E0.02\nG20\nG00 B0. C0.\nG234 H05\nG00 X1. Y0.5 Z2.\n"
      "G93\nG01 Z0.1 B-20. F30.\nX2. B-35. C40. F60.\nG94\nG49\nG53 Z0.\nM30\n%\n")  # fmt: skip
def umc() -> list[TruePath]:
    shares = np.linspace(0.0, 1.0, 300)[:, None]
    ends = np.array([[1, 0.5, 2, 0, 0], [1, 0.5, 0.1, -20, 0], [2, 0.5, 0.1, -35, 40]])
    rows = np.vstack([a + shares * (b - a) for a, b in pairwise(ends)])
    vectors = np.array([(turned("zy", c, b) @ [0, 0, 1, 0])[:3] for b, c in rows[:, 3:]])
    return [TruePath(0.0254 * rows[:, :3], vectors)]


case("Haas", "subprogram.eia", "%\nO0100 (MAIN)\nG21 G90 G54\nG00 X0. Y0. Z5.\n"
     "M98 P200 L2\nM97 P900\n"
     "M30\nN900 G90 G01 X0. Y0. F100.\nM99\nO0200\nG91 G01 Z-1. F50.\nX10.\nG00 Z1.\nM99\n%\n",
     [upright(path) for path in (mm((0, 0, 5), (0, 0, 4), (10, 0, 4)),
     mm((10, 0, 5), (10, 0, 4), (20, 0, 4)), mm((20, 0, 5), (0, 0, 5)))])  # fmt: skip
HEADS = "G21 G90\nG0 X0. Y0. Z50. A0. C0.\nG1 Z10. F600.\nX20. A25. C40.\nG3 X20. Y20. R10.\nM30\n"


@case("Haas", "head.nc", HEADS, machine="head-ac", pivot="0,5,150")
def head() -> list[TruePath]:
    ends = np.array([[0, 0, 50, 0, 0], [0, 0, 10, 0, 0], [20, 0, 10, 25, 40.0]])
    rows = [ends[0], *(ends[1] + s * (ends[2] - ends[1]) for s in np.linspace(0, 1, 500))]
    for angle in np.linspace(-np.pi / 2, np.pi / 2, 500):
        rows.append(np.array([20 + 10 * np.cos(angle), 10 + 10 * np.sin(angle), 10, 25, 40]))
    pivot, points, axes = np.array([0.0, 5.0, 150.0]), [], []
    for row in rows:
        turn = turned("zx", row[4], row[3])[:3, :3]
        points.append(row[:3] + pivot - turn @ pivot)
        axes.append(turn[:, 2])
    return [TruePath(1e-3 * np.array(points), np.array(axes))]


@case("Haas", "reversed.nc", "G21 G90\nG0 X5. Y8. Z40. B0. C0.\nG1 Z10. F600.\n"
      "B30. C-70. X15.\nM30\n",
      machine="table-bc-reversed", pivot="0,0,-50")  # fmt: skip
def reversed_table() -> list[TruePath]:
    ends = np.array([[5, 8, 40, 0, 0], [5, 8, 10, 0, 0], [15, 8, 10, 30, -70.0]])
    rows = [ends[0], *(ends[1] + s * (ends[2] - ends[1]) for s in np.linspace(0, 1, 800))]
    pivot, points, axes = np.array([0.0, 0.0, -50.0]), [], []
    for row in rows:
        # The table itself turns right-handed: seen from the part, the tool turns the other way.
        turn = turned("zy", -row[4], -row[3])[:3, :3]
        points.append(pivot + turn @ (row[:3] - pivot))
        axes.append(turn[:, 2])
    return [TruePath(1e-3 * np.array(points), np.array(axes))]


@case("Mazak", "turned_c.eia", "O7(MAZATROL ISO)\nN1 G21 G90 G94 G54\nN2 T01 T02 M6\n"
      "N3 G0 X30. Y0. Z5. C0.\n"
      "N4 G1 Z0. F200.\nN5 C180.\nN6 M30\n")  # fmt: skip
def turned_c() -> list[TruePath]:
    angles = np.radians(np.linspace(0, 180, 2000))
    points = np.column_stack([30 * np.cos(angles), 30 * np.sin(angles), 0 * angles])
    points = 1e-3 * np.vstack([[30, 0, 5], points])
    return [upright(points)]
