"""KUKA KRL: programs of path generators and of inline forms."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, held, mm

HEAD = """&ACCESS RVP
&REL 1
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
&PARAM EDITMASK = *
DEF PATH ( )
;FOLD INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0)
;ENDFOLD (INI)
"""


def zyx(*angles: tuple[float, float, float]) -> Array:
    """R_z(A) R_y(B) R_x(C) of some angles A, B, C in degrees."""
    return Rotation.from_euler("ZYX", np.array(angles), degrees=True).as_matrix()


MILL = (
    HEAD
    + """\
FDAT_ACT = {TOOL_NO 3,BASE_NO 2,IPO_FRAME #BASE}
BAS (#FRAMES)
BAS (#VEL_PTP,20)
PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}
$APO.CDIS = 0.5
$VEL.CP = 0.2
PTP {E6POS: X 100.0,Y 50.0,Z 30.0,A 0.0,B 20.0,C 180.0,E1 0.0,E2 0.0}
LIN {E6POS: X 100.0,Y 50.0,Z 0.0,A 0.0,B 20.0,C 180.0,E1 0.0,E2 0.0} C_DIS
LIN {X 160.5,Y 50.0,Z 0.0,A 10.0,B 10.0,C 180.0} C_DIS ; cut
LIN {X 160.5,Y 90.25,Z -1.5}
PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}
END
"""
)


case("KUKA KRL", "mill.src", MILL,
     [TruePath(mm((100, 50, 30), (100, 50, 0), (160.5, 50, 0), (160.5, 90.25, -1.5)),
     rotations=zyx(*[(0, 20, 180)] * 2, *[(10, 10, 180)] * 2), feed=0.2)])  # fmt: skip
CIRC = """\
DEF circ()
DECL E6POS home
home = {X 520,Y 0,Z 300,A 0,B 0,C 180}
$BASE = $NULLFRAME
BAS(#VEL_CP,0.05)
PTP home
CIRC {X 500,Y 20,Z 300,A 0,B 0,C 180},{X 480,Y 0,Z 300,A 0,B 0,C 180} C_DIS
CIRC {X 500,Y -20,Z 300,A 0,B 0,C 180},{X 520,Y 0,Z 300,A 0,B 0,C 180},CA 90
END
"""


@case("KUKA KRL", "circ.src", CIRC)
def circ() -> list[TruePath]:
    points = arc(at(500, 0, 300), at(520, 0, 300), UP, 1.5 * np.pi)
    return [held(Rotation.from_euler("x", 180, degrees=True), points, feed=0.05)]


TWO_BASES = (
    HEAD
    + """\
BASE_DATA[1] = {X 500,Y 0,Z 100,A 90,B 0,C 0}
BASE_DATA[2] = BASE_DATA[1]
$VEL.CP = 0.1
BAS(#BASE,1)
PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}
LIN {X 40,Y 0,Z 0,A 0,B 0,C 180}
$BASE = {FRAME: X 0,Y 600,Z 100,A 0,B 30,C 0}:{X 0,Y 0,Z 10,A 0,B 0,C 0}
PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}
LIN {X 40,Y 0,Z 0,A 0,B 0,C 180}
END
"""
)


@case("KUKA KRL", "two_bases.src", TWO_BASES)
def two_bases() -> list[TruePath]:
    points = mm((0, 0, 0), (40, 0, 0))
    down = Rotation.from_euler("x", 180, degrees=True)
    one = Rotation.from_euler("z", 90, degrees=True)
    other = Rotation.from_euler("y", 30, degrees=True)
    there = at(0, 600, 100) + other.apply([0, 0, 0.01])
    return [
        held(turn * down, turn.apply(points) + origin)
        for turn, origin in ((one, at(500, 0, 100)), (other, there))
    ]


RASTER = (
    HEAD
    + """\
INT i
DECL POS p[2]
p[1]={X 300,Y 0,Z 50,A 0,B 90,C 0}
$VEL.CP=0.3
FOR i = 0 TO 2
  p[1].Y = 10 * i
  LIN p[1] C_DIS
  LIN_REL {X 80} C_DIS
ENDFOR
IF $IN[3] THEN
  $OUT[4]=TRUE
ENDIF
SLIN {X 300,Y 40,Z 50,A 0,B 90,C 0} WITH $VEL = SVEL_CP(0.3, , LDEFAULT), $TOOL = STOOL2(F1)
END
"""
)


@case("KUKA KRL", "raster.src", RASTER)
def raster() -> list[TruePath]:
    lines = [(300.0 + x, 10.0 * k, 50.0) for k in range(3) for x in (0, 80)]
    turn = Rotation.from_euler("y", 90, degrees=True)
    return [held(turn, mm(*lines, (300, 40, 50)), feed=0.3)]
