"""Siemens NX CLSF: no unit, ``MSYS``, axes on each point, circles with a tool vector."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, mm, upright

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
case("Siemens NX", "contour.cls", f"{HEAD}GOTO/20.0000,0.0000,4.0000\n"
     f"PAINT/COLOR,31\nGOTO/-20.0000,30.0000,4.0000\n{END}",
     [upright(mm((20, 0, 10), (20, 0, 4), (-20, 30, 4)), feed=0.01)])  # fmt: skip
# NX writes the axis about which the tool goes clockwise.
case("Siemens NX", "quarter.cls",
     f"{HEAD}CIRCLE/0.,0.,10.,0.,0.,1.,20.,0.06,0.5,20.,1.\nGOTO/0.,20.,10.\n{END}",
     [upright(arc(np.array([0, 0, 0.01]), np.array([0.02, 0, 0.01]), -UP, 1.5 * np.pi))]
)  # fmt: skip


def msys(origin: Array, turn: Rotation) -> str:
    """The line MSYS of a frame: its origin, mm, and its x and y axes."""
    x, y, _ = turn.as_matrix().T
    return "MSYS/" + ",".join(f"{value:.7f}" for value in (*origin, *x, *y))


FIRST = (np.array([5.0, -3.0, 2.0]), Rotation.from_euler("z", 30, degrees=True))
SECOND = (np.array([40.0, 10.0, -6.0]), Rotation.from_euler("ZYX", [70, 20, -35], degrees=True))


@case("Siemens NX", "two_frames.cls", HEAD.replace(HEAD.split("\n")[2], msys(*FIRST))
      + "GOTO/20.,30.,10.\n" + END + HEAD.replace(HEAD.split("\n")[2], msys(*SECOND))
      + "GOTO/20.,20.,10.\nCIRCLE/0.,20.,10.,0.,0.,1.,20.\nGOTO/0.,0.,10.\n" + END)  # fmt: skip
def two_frames() -> list[TruePath]:
    # Points of the second operation in the frame of the first one.
    first = mm((20, 0, 10), (20, 30, 10))
    local = np.vstack([mm((20, 0, 10)),
                       arc(at(0, 20, 10), at(20, 20, 10), -UP,
                           0.5 * np.pi)])  # fmt: skip
    turn = FIRST[1].inv() * SECOND[1]
    shift = 1e-3 * FIRST[1].inv().apply(SECOND[0] - FIRST[0])
    second = turn.apply(local) + shift
    return [upright(first),
            TruePath(second, np.tile(turn.apply(UP), (len(second), 1)))]  # fmt: skip
