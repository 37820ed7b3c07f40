"""Heidenhain's Klartext: poles and polar coordinates, helices, M128, LN, tilted planes, labels."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, mm, upright

HEAD = """0  BEGIN PGM {} MM
1  BLK FORM 0.1 Z  X-50  Y-50  Z-20
2  BLK FORM 0.2  X+50  Y+50  Z+0
3  ;-------------------------------------
4  * - Contour
5  TOOL CALL 5 "MILL D10" Z S8000
6  L M140 MB MAX
7  M3
"""
END = "90 L  Z+50 R0 FMAX M9\n91 L M140 MB MAX\n92 M30\n93 END PGM PART MM\n"
case("Heidenhain", "contour.h", HEAD.format("CONTOUR") + "10 L  X-10  Y+0 R0 FMAX\n"
     "11 L  Z+5 R0 FMAX\n12 L  Z-1.000 F500\n13 L  X+20.000\n14 CC X+20 Y+10\n"
     "15 C  X+30 Y+10 DR+\n16 L Y+30\n17 CR X+20 Y+40 R+10 DR+\n18 L IX-30\n" + END,
     [upright(mm((-10, 0, 5), (-10, 0, -1), (20, 0, -1)),
     arc(at(20, 10, -1), at(20, 0, -1), UP, 0.5 * np.pi), mm((30, 30, -1)),
     arc(at(20, 30, -1), at(30, 30, -1), UP, 0.5 * np.pi), mm((-10, 40, -1)), feed=0.5 / 60)]
)  # fmt: skip


@case("Heidenhain", "helix.h", HEAD.format("HELIX") + "10 L  X+35  Y-40 R0 FMAX\n"
      "11 L  Z+5 R0 FMAX\n12 L  Z-3.6 F402\n13 CC  X+36.4  Z-3.6\n14 CP IPA-90 DR- F1206\n"
      "15 L  X+40\n16 CC  X+40  Y-30\n17 CP IPA+720 IZ-4 DR+\n18 CP PA+90 DR+\n" + END)  # fmt: skip
def helix() -> list[TruePath]:
    # A lead-in in the plane of X and Z: DR- turns the tool left-handed about y.
    first = arc(at(36.4, -40, -3.6), at(35, -40, -3.6), np.array([0.0, -1.0, 0.0]), 0.5 * np.pi)
    about, begin = at(40, -30, -5), at(40, -40, -5)
    turns = arc(about, begin, UP, 4.0 * np.pi, rise=-0.004)
    half = arc(about - 0.004 * UP, begin - 0.004 * UP, UP, np.pi)
    return [upright(mm((35, -40, 5)), first, turns, half)]


case("Heidenhain", "corners.h", HEAD.format("CORNERS") + "10 L X+3 Y-10 Z+2 FMAX\n11 L Z-10 F200\n"
     "12 L X+3 Y+87\n13 CHF 10\n14 L X+87 Y+87\n15 RND R5\n16 L X+87 Y+3\n"
     "17 CT X+67 Y+3\n" + END,
     [upright(mm((3, -10, 2), (3, -10, -10), (3, 77, -10), (13, 87, -10)),
     arc(at(82, 82, -10), at(82, 87, -10), -UP, 0.5 * np.pi),
     arc(at(77, 3, -10), at(87, 3, -10), -UP, np.pi))])  # fmt: skip


def leaning(b: float, c: float) -> Array:
    """The tool axis with B and C, degrees: Rz(C) Ry(B) ez."""
    return Rotation.from_euler("ZY", [c, b], degrees=True).apply(UP)


@case("Heidenhain", "five_axes.h", "0 BEGIN PGM FIVE MM\n1 TOOL CALL 5 Z S8000\n2 M128\n"
      "3 L X+0.5 Y-10.25 Z+5 B+10 C-20 FMAX\n4 L Z-1.000 F500\n5 L X+20.000 B+25 C+40\n"
      "6 M129\n" + END)  # fmt: skip
def five_axes() -> list[TruePath]:
    shares = np.linspace(0.0, 1.0, 601)[:, None]
    straight = mm((0.5, -10.25, -1)) + shares * mm((19.5, 0, 0))
    axes = [leaning(10 + 15 * s, -20 + 60 * s) for s in shares[:, 0]]
    points = np.vstack([mm((0.5, -10.25, 5)), straight])
    return [TruePath(points, np.vstack([[axes[0]], axes]), feed=0.5 / 60)]


case("Heidenhain", "vectors.h", "0 BEGIN PGM VECTORS MM\n1 TOOL CALL 5 Z S8000\n2 FUNCTION TCPM F "
     "TCP AXIS POS PATHCTRL AXIS\n3 LN X+10 Y+0 Z+20 NX+0 NY+0 NZ+1 TX+0 TY+0 TZ+1 FMAX\n"
     "4 LN X+10 Y+0 Z+5 NX+0 NY+0.6 NZ+0.8 TX+0 TY+0.6 TZ+0.8 F1000\n"
     "5 LN X+30 Y+2 Z+5 NX+0.6 NY+0 NZ+0.8\n6 FUNCTION RESET TCPM\n7 END PGM VECTORS MM\n",
     [TruePath(mm((10, 0, 20), (10, 0, 5), (30, 2, 5)),
     np.array([[0, 0, 1], [0, 0.6, 0.8], [0.6, 0, 0.8]]))])  # fmt: skip


@case("Heidenhain", "plane.h", HEAD.format("PLANE") + "10 CYCL DEF 7.0 DATUM SHIFT\n"
      "11 CYCL DEF 7.1 X+5\n12 CYCL DEF 7.2 Y-55\n13 CYCL DEF 7.3 Z-25\n"
      "14 PLANE SPATIAL SPA+20 SPB-30 SPC+110 STAY SEQ- TABLE ROT\n15 L B+Q121 C+Q122 FMAX M126\n"
      "16 L X-10 Y+7 R0 F MAX\n17 L Z+5 FMAX\n18 L Z-2 F300\n19 L X+20\n20 CC X+20 Y+17\n"
      "21 C X+30 Y+17 DR+\n22 L Z+70 FMAX\n23 PLANE RESET STAY\n" + END)  # fmt: skip
def plane() -> list[TruePath]:
    quarter = arc(at(20, 17, -2), at(20, 7, -2), UP, 0.5 * np.pi)
    local = np.vstack([mm((-10, 7, 5), (-10, 7, -2)), quarter])
    turn = Rotation.from_euler("ZYX", [110, -30, 20], degrees=True)
    points = turn.apply(local) + mm((5, -55, -25))
    return [TruePath(points, np.tile(turn.apply(UP), (len(points), 1)), feed=0.3 / 60)]


case("Heidenhain", "holes.h", HEAD.format("HOLES") + "10 L  X+13  Y-13.5 R0 FMAX\n"
     "11 L  Z+15 R0 FMAX\n12 CYCL DEF 200 DRILLING ~\n    Q200=+5    ;SET-UP CLEARANCE ~\n"
     "    Q201=-10   ;DEPTH ~\n    Q206=+120  ;FEED RATE FOR PLNGNG ~\n"
     "    Q203=+1    ;SURFACE COORDINATE ~\n    Q204=+9    ;2ND SET-UP CLEARANCE\n"
     "13 L FMAX M99\n14 L  X+30  Y-14 FMAX M99\n" + END,
     [upright(mm((x, y, 6), (x, y, -9)), feed=0.002) for x, y in ((13, -13.5), (30, -14))]
)  # fmt: skip


@case("Heidenhain", "labels.h", HEAD.format("LABELS") + "10 FN 0: Q5 = +2.5\n"
      "11 L X+0 Y+0 Z+1 FMAX\n12 LBL 1\n"
      "13 L IZ-Q5 F100\n14 L IX+10\n15 L IX-10\n16 CALL LBL 1 REP 2\n"
      "17 CALL LBL 7\n"
      "18 L Z+50 FMAX\n19 M30\n20 LBL 7\n21 CC X+0 Y+0\n22 LP PR+20 PA+30 F200\n"
      "23 LP IPA+60\n24 LBL 0\n25 END PGM LABELS MM\n")  # fmt: skip
def labels() -> list[TruePath]:
    points = [(0.0, 0.0, 1.0)]
    for k in range(3):
        z = 1.0 - 2.5 * (k + 1)
        points += [(0, 0, z), (10, 0, z), (0, 0, z)]
    z = points[-1][2]
    points += [(20 * np.cos(np.pi / 6), 10, z), (0, 20, z)]
    return [upright(mm(*points))]


case("Heidenhain", "rotated.i", "BEGIN PGM ROTATED INCH\nTOOL CALL 1 Z\nCYCL DEF 10.0 ROTATION\n"
     "CYCL DEF 10.1 ROT+90\nL X+1 Y+0 Z+0,1 FMAX\nL Z-0,1 F100\nL X+2 RL\nM2\n"
     "END PGM ROTATED INCH\n",
     [upright(25.4 * mm((0, 1, 0.1), (0, 1, -0.1), (0, 2, -0.1)), feed=10 * 0.0254 / 60)]
)  # fmt: skip
case("Heidenhain", "prepositioned.h", "0 BEGIN PGM PRE MM\n1 TOOL CALL 5 Z S8000\n2 M128\n"
     "3 L X+10 Y+0 Z+20 B+36.8699 C+90 FMAX\n"
     "4 LN X+10 Y+0 Z+5 NX+0 NY+0 NZ+1 TX+0 TY+0.6 TZ+0.8 F1000\n"
     "5 LN X+30 Y+2 Z+5 TX+0.6 TY+0 TZ+0.8\n6 END PGM PRE MM\n",
     [TruePath(mm((10, 0, 20), (10, 0, 5), (30, 2, 5)),
     np.array([leaning(36.8699, 90), [0, 0.6, 0.8], [0.6, 0, 0.8]]))])  # fmt: skip
case("Heidenhain", "computed.h", HEAD.format("COMPUTED") + "9 Q4 = 0\n"
     "10 Q1 = 2 * (3 + SIN 30) ; 7\n"
     "11 FN 2: Q2 = +Q1 - +2\n12 FN 4: QL3 = +Q2 DIV +2\n13 L X+0 Y+Q1 Z+1 FMAX\n14 L Z-QL3 F100\n"
     "15 LBL 5\n16 L IX+Q2\n17 Q4 = Q4 + 1\n18 FN 12: IF +Q4 LT +3 GOTO LBL 5\n" + END,
     [upright(mm((0, 7, 1), (0, 7, -2.5), (5, 7, -2.5), (10, 7, -2.5), (15, 7, -2.5)),
     feed=0.1 / 60)])  # fmt: skip
