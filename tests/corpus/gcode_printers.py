"""3-D printers and five-axis slicers: filament, settings, no unit."""

from itertools import pairwise

import numpy as np

from corpus import TruePath, case, mm, upright
from corpus.gcode_fanuc import turned


@case("printer", "plate.gcode", ";FLAVOR:Marlin\nM201 X500 Y500 Z100 E5000\nM140 S60\nM83\nG28\n"
      "START_PRINT BED=60\nG92 E0\nG1 Z2.0 F3000\n;LAYER:0\nG1 X10 Y10 F6000\nG1 Z0.2\n"
      "G1 X20 Y10 F1200 E0.4\nG1 X20 Y20 E0.4\nG1 E-0.8 F2400\nG1 X40 Y20 F6000\nG1 E0.8\n"
      "G1 X40 Y30 F1200 E0.4\nM104 S0\nM84 X Y E\n")  # fmt: skip
def plate() -> list[TruePath]:
    paths = mm((10, 10, 0.2), (20, 10, 0.2), (20, 20, 0.2)), mm((40, 20, 0.2), (40, 30, 0.2))
    return [upright(path, feed=0.02) for path in paths]


def _tilting(first: tuple[float, ...], second: tuple[float, ...]) -> TruePath:
    """A is next to the bed, B next to the part; seen from the part the tool turns right-handed."""
    ends = np.array([[50, 50, 0.3, 0, 0], [60, 50, 0.3, 0, 0], [60, 60, 0.3, 10, 0],
                     [50, 60, 0.3, 10, 20.0]])  # fmt: skip
    points, axes = [], []
    for a, b in pairwise(ends):
        for share in np.linspace(0.0, 1.0, 300):
            row = a + share * (b - a)
            chain = np.eye(4)
            for axis, angle, pivot in (("y", row[4], second), ("x", row[3], first)):
                there, back = np.eye(4), np.eye(4)
                there[:3, 3], back[:3, 3] = pivot, -np.array(pivot)
                chain = chain @ there @ turned(axis, angle) @ back
            points.append((chain @ [*row[:3], 1.0])[:3])
            axes.append(chain[:3, 2])
    return TruePath(1e-3 * np.array(points), np.array(axes))


TILTING = ("G21\nG90\nM82\nG92 E0\nG1 F3000 E-2\nG0 F6000 X50 Y50 Z0.3 A0 B0\n"
      "G1 F1200 X60 Y50 E0.4\n"
           "G1 X60 Y60 A10 E0.8\nG1 X50 Y60 A10 B20 E1.2\nM104 S0\n")  # fmt: skip
case("printer", "slicer.gcode", TILTING,
     [_tilting((10.0, 20.0, -30.0), (10.0, 20.0, -30.0))], machine="table-ab", pivot="10,20,-30"
)  # fmt: skip
case("printer", "two_pivots.gcode", TILTING,
     [_tilting((10.0, 20.0, -30.0), (12.0, 25.0, -5.0))], machine="table-ab",
     pivot="10,20,-30,12,25,-5")  # fmt: skip
