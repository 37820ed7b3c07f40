"""Siemens NX CLSF: no unit, ``MSYS``, axes on each point, circles with a tool vector."""

from __future__ import annotations

import numpy as np

from corpus import Array, TruePath, arc, case, mm

HEAD = """TOOL PATH/CONTOUR,TOOL,MILL_20
TLDATA/MILL,20.0000,1.0000,50.0000,0.0000,0.0000
MSYS/0.0000,0.0000,0.0000,1.0000000,0.0000000,0.0000000,0.0000000,1.0000000,0.0000000
$$ centerline data
PAINT/PATH
PAINT/SPEED,10
LOAD/TOOL,2,ADJUST,2
SELECT/TOOL,2
PAINT/COLOR,186
RAPID
GOTO/20.0000,0.0000,10.0000,0.0000000,0.0000000,1.0000000
FEDRAT/MMPM,600.0000
"""
END = "PAINT/SPEED,10\nPAINT/TOOL,NOMORE\nEND-OF-PATH\n"
UP = np.array([0.0, 0.0, 1.0])


def up(points: Array) -> Array:
    """The tool axis of a machine of three axes at each point."""
    return np.tile(UP, (len(points), 1))


@case("Siemens NX", "contour.cls", f"{HEAD}GOTO/20.0000,0.0000,4.0000\n"
      f"PAINT/COLOR,31\nGOTO/-20.0000,30.0000,4.0000\n{END}")  # fmt: skip
def contour() -> list[TruePath]:
    points = mm((20, 0, 10), (20, 0, 4), (-20, 30, 4))
    return [TruePath(points, up(points), feed=0.01)]


@case("Siemens NX", "quarter.cls",
      f"{HEAD}CIRCLE/0.,0.,10.,0.,0.,1.,20.,0.06,0.5,20.,1.\nGOTO/0.,20.,10.\n{END}")  # fmt: skip
def quarter() -> list[TruePath]:
    # NX writes the axis about which the tool goes clockwise.
    points = arc(np.array([0, 0, 0.01]), np.array([0.02, 0, 0.01]), -UP, 1.5 * np.pi)
    return [TruePath(points, up(points))]
