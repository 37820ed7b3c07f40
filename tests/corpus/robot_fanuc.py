"""FANUC TP programs as text."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, TruePath, arc, at, case, held, mm

ATTRIBUTES = """/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 1000;
FILE_NAME	= ;
LINE_COUNT	= 0;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
"""


def point(number: int, xyz: str, wpr: str, frame: int = 1) -> str:
    (x, y, z), (w, p, r) = xyz.split(), wpr.split()
    return (
        f"P[{number}]{{\n   GP1:\n\tUF : {frame}, UT : 2,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
        f"\tX = {x:>9}  mm,\tY = {y:>9}  mm,\tZ = {z:>9}  mm,\n"
        f"\tW = {w:>9} deg,\tP = {p:>9} deg,\tR = {r:>9} deg\n}};\n"
    )


SEAM = f"""\
/PROG  SEAM
{ATTRIBUTES}   1:  !a seam ;
   2:  UFRAME_NUM=1 ;
   3:  UTOOL_NUM=2 ;
   4:J P[9] 20% CNT100    ;
   5:J P[1:START] 20% FINE    ;
    :  Arc Start[1]    ;
   6:L P[2] 30cm/min CNT100 COORD PTH ;
   7:L P[3] 5mm/sec FINE    ;
  8:  Arc End[1]    ;
   9:  DO[1:GUN]=OFF ;
  10:J P[9] 20% FINE    ;
/POS
{point(1, "100.000 -20.500 0", "-180 0 30.0")}{point(2, "100.000 .500 0", "-180 0 30.0")}\
{point(3, "160.000 .500 2.25", "-170 5.0 30.0")}P[9]{{
   GP1:
	UF : 1, UT : 2,
	J1=     0.000 deg,	J2=   -10.000 deg,	J3=     5.000 deg,
	J4=     0.000 deg,	J5=   -80.000 deg,	J6=     0.000 deg
}};
/END
"""
ANGLES = [(-180, 0, 30), (-180, 0, 30), (-170, 5, 30)]  # R = R_z(R) R_y(P) R_x(W)
case("FANUC LS", "SEAM.LS", SEAM, [
    TruePath(mm((100, -20.5, 0), (100, 0.5, 0), (160, 0.5, 2.25)),
             rotations=Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix(), feed=0.005)
])  # fmt: skip

RING = f"""\
/PROG RING
{ATTRIBUTES}1:L P[1] 100mm/sec FINE ;
2:C P[2]
 : P[3] 100mm/sec CNT100 ;
3:C P[4]
 : P[1] 100mm/sec FINE ACC100 ;
4:  WAIT   1.00(sec) ;
5:  CALL GRIPPER_OFF ;
/POS
""" + "".join(
    point(k, f"{x} {y} 300.0", "180.0 0.0 0.0")
    for k, (x, y) in enumerate(((520.0, 0.0), (500.0, 20.0), (480.0, 0.0), (500.0, -20.0)), 1)
) + "/END\n"  # fmt: skip
case("FANUC LS", "ring.ls", RING,
     [held(Rotation.from_euler("x", 180, degrees=True),
           arc(at(500, 0, 300), at(520, 0, 300), UP, 2 * np.pi), feed=0.1)])  # fmt: skip

DEPOSIT = f"""\
/PROG deposit
{ATTRIBUTES}:R[34]=0;
1: L P[1] 600mm/min CNT100 COORD ;
2: L P[2] WELD_SPEED CNT100 COORD PTH ;
3: L P[3] R[2]mm/sec CNT50 ;
4: JMP LBL[1] ;
/POS
P[1] {{
  GP1:
   UF : 6, UT : 5,  CONFIG: 'N U T, 0, 0, 0',
   X = 1.5 mm, Y = 0.0 mm, Z = 53.3 mm,
   W = 0.0 deg, P = 0.0 deg, R = 0.0 deg
  GP2:
   UF : 1, UT : 2,
   J1 = 0.0 deg, J2 = 0.0 deg
 }};
{point(2, "31.5 0 53.3", "0 0 0", frame=6)}{point(3, "31.5 12 53.3", "0 0 0", frame=6)}"""
case("FANUC LS", "deposit.ls", DEPOSIT,
     [held(Rotation.identity(), mm((1.5, 0, 53.3), (31.5, 0, 53.3), (31.5, 12, 53.3)))]
)  # fmt: skip
