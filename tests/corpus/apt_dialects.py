"""APT-CL of CAMWorks, ISO 4343, CATIA, Creo, CAMplete, and of a slicer for welding."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, mm, up, upright

CAMWORKS = """PARTNO/1
UNIT/MM
CUTTER/20.,0,10.,0,0,0,100.
LOAD/TOOL,5
CSI_SET_FLUTE_LENGTH/32.
TRNTYP/WORLD,0,0,0
CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0
RAPID/
"""


case("CAMWorks", "lead.apt", CAMWORKS + "GOTO/-10.,0,5.\nFEDRAT/240.,MMPM\nGOTO/-10.,0,0\n"
     "GOTO/10.,0,0\nCIRCLE/10.,10.,0,0,0,1.\nGOTO/20.,10.,0\nGOTO/20.,30.,0\nFINI\n",
     [upright(mm((-10, 0, 5), (-10, 0, 0)), arc(at(10, 10, 0), at(10, 0, 0), UP, 0.5 * np.pi),
     mm((20, 30, 0)), feed=0.004)])  # fmt: skip


@case("CAMWorks", "holes.apt", CAMWORKS + "GOTO/0,0,25.\nCYCLE/DRILL,FEDTO,8.,MMPM,300.,RAPTO,3.,"
      "RTRCTO,25.,DWELL,0\nGOTO/10.,5.,0\nGOTO/30.,5.,-1.,0,.6,.8\nCYCLE/OFF\nFINI\n")  # fmt: skip
def camworks_holes() -> list[TruePath]:
    lean = np.array([0.0, 0.6, 0.8])
    found = []
    for hole, axis in ((at(10, 5, 0), UP), (at(30, 5, -1), lean)):
        points = np.array([hole + 0.003 * axis, hole - 0.008 * axis])
        found.append(TruePath(points, np.tile(axis, (2, 1)), feed=0.005))
    return found


case("ISO 4343", "arc.apt", "MODE/MILL\nPARTNO/'P 7'\nPPRINT/'Price 5$'\nUNITS/MM\nMULTAX/ON\n"
     "CUTTER/10., 1., 0., 1., 0., 0., 20.\nLOADTL/3, 0, 50., 3\nSPINDL/8000., RPM, CLW\nRAPID\n"
     "GOTO/20., 0., 20., 0., 0., 1.\nFEDRAT/600., MMPM\nGOTO/20., 0., 0., 0., 0., 1.\n"
     "MOVARC/0., 0., 0., 0., 0., -1., 20., ANGLE, 90.\nGOTO/0., -20., -2., 0., 0., 1.\nEND\nFINI\n",
     [upright(mm((20, 0, 20)), arc(np.zeros(3), at(20, 0, 0), -UP, 0.5 * np.pi, rise=0.002),
     feed=0.01)])  # fmt: skip
CATIA = """$$ -----------------------------------------------------------------
$$     Generated on Monday, 30 November 2026 08:46:00
$$     CATIA APT VERSION 1.0
$$ -----------------------------------------------------------------
$$ Part Operation.1
$$*CATIA0
$$     1.00000     0.00000     0.00000  -220.00000
$$     0.00000     1.00000     0.00000  -170.00000
$$     0.00000     0.00000     1.00000    20.00000
PARTNO PART TO BE MACHINED
COOLNT/ON
MULTAX
CUTTER/ 10.000000,  2.000000,  3.000000,  2.000000,  0.000000,$
         0.000000, 50.000000
TOOLNO/1,MILL,1,0,   10.000000,    2.000000,,  100.000000,$
 1000.000000,MMPM,   70.000000,RPM,CLW,ON,,NOTE
TPRINT/T1 End Mill D 10,,T1 End Mill D 10
LOADTL/1,1
FEDRAT/  300.0000,MMPM
SPINDL/   70.0000,RPM,CLW
"""


@case("CATIA", "pocket.aptsource", CATIA + "RAPID\n"
      "GOTO  /   98.00000,  100.00000,  120.00000, 0.000000, 0.000000, 1.000000\n"
      "GOTO  /   98.00000,  100.00000,   25.00000, 0.000000, 0.000000, 1.000000\n"
      "GOTO  /  108.00000,  100.00000,   25.00000, 0.000000, 0.000000, 1.000000\n"
      "AUTOPS\nINDIRV/ 1.00000, 0.00000, 0.00000\n"
      "TLON,GOFWD/ (CIRCLE/  108.00000,  110.00000,   25.00000,$\n   10.00000),ON,"
      "(LINE/  108.00000,  110.00000,   25.00000,$\n    118.00000,  110.00000,   25.00000)\n"
      "GOTO  /  118.00000,  130.00000,   26.00000, 0.000000, 0.600000, 0.800000\nFINI\n"
)  # fmt: skip
def catia_pocket() -> list[TruePath]:
    turn = arc(at(108, 110, 25), at(108, 100, 25), UP, 0.5 * np.pi)
    points = np.vstack([mm((98, 100, 120), (98, 100, 25)), turn, mm((118, 130, 26))])
    axes = np.vstack([up(points[:-1]), [[0.0, 0.6, 0.8]]])
    return [TruePath(points, axes, feed=0.005)]


CREO = """$$*          Pro/CLfile  Version 8.0 - 8.0.3.0
$$-> MFGNO / MFG0004
PARTNO / MFG0004
$$-> FEATNO / 32
MACHIN / UNCX01, 1
$$-> CUTCOM_GEOMETRY_TYPE / OUTPUT_ON_CENTER
UNITS / MM
LOADTL / 1
$$-> CUTTER / 3.000000
$$-> CSYS / 1.0000000000, 0.0000000000, 0.0000000000, 0.0000000000,  $
            0.0000000000, 1.0000000000, 0.0000000000, 0.0000000000,  $
            0.0000000000, 0.0000000000, 1.0000000000, 0.0000000000
SPINDL / RPM, 9000.000000,  CLW
RAPID
"""


case("Creo", "profile.ncl.1", CREO + "GOTO / 0.0000000000, 1.5000000000, 2.0000000000\n"
     "FEDRAT / 480.000000,  MMPM\nGOTO / 0.0000000000, 1.5000000000, -1.5000000000\n"
     "CIRCLE / 0.0000000000, 0.0000000000, -1.5000000000,  $\n"
     "0.0000000000, 0.0000000000, -1.0000000000,  1.5000000000\n"
     "GOTO / 1.5000000000, 0.0000000000, -1.5000000000\n"
     "GOTO / 1.5000000000, -33.0000000000, -1.5000000000\nSPINDL / OFF\n$$-> END /\nFINI\n",
     [upright(mm((0, 1.5, 2)), arc(at(0, 0, -1.5), at(0, 1.5, -1.5), -UP, 0.5 * np.pi),
     mm((1.5, -33, -1.5)), feed=0.008)])  # fmt: skip
case("Creo", "holes.ncl.2", CREO + "GOTO / -7.2290790757, -23.0000000000, 2.0000000000\n"
     "CYCLE / DEEP, DEPTH, 3.500000, STEP, 1.000000, MMPM, 60.000000, CLEAR,$\n 1.000000\n"
     "GOTO / -7.0, -23.0, 0.5\nGOTO / -16.0, -23.0, 0.5\nCYCLE / OFF\nRAPID\n"
     "GOTO / -16.0, -23.0, 2.0\nFINI\n",
     [upright(mm((x, -23, 1.5), (x, -23, -3)), feed=0.001) for x in (-7.0, -16.0)])  # fmt: skip
TURN = Rotation.from_euler("ZX", [25, 40], degrees=True)
ORIGIN = np.array([12.0, -7.0, 30.0])


def mcs(turn: Rotation, origin: Array) -> str:
    """A section of CAMplete: its x, y and z axes, then its origin, mm."""
    rows = [*turn.as_matrix().T, origin]
    lines = [", ".join(f"{value:.9f}" for value in row) for row in rows]
    return "UNITS/MM\nMULTAX/OFF\nMCS/" + ", $\n".join(lines) + "\nLOADTL/2, 0, 40, 2\nRAPID\n"


# Clockwise motions have the axis of the plane.
case("CAMplete", "sections.apt", "MACHIN/M\nMODE/MILL\nPARTNO/'P'\nCSI_TOOL_PATH/ROUGH\n"
     + mcs(Rotation.identity(), np.zeros(3)) + "GOTO/20, 0, 10\nFEDRAT/300, MMPM\nGOTO/20, 0, 0\n"
     "CIRCLE/0, 0, 0, 0, 0, 1, 20, 90, 0.0, 0.0, 0.0\nGOTO/0, -20, 0\n" + mcs(TURN, ORIGIN)
     + "GOTO/5, 1, 10\nGOTO/5, 1, -2\nGOTO/9, 3, -2\nEND\nFINI\n",
     [upright(mm((20, 0, 10)), arc(np.zeros(3), at(20, 0, 0), -UP, 0.5 * np.pi)),
     TruePath(TURN.apply(mm((5, 1, 10), (5, 1, -2), (9, 3, -2))) + 1e-3 * ORIGIN,
     np.tile(TURN.apply(UP), (3, 1)))])  # fmt: skip
case("ORNL Slicer", "bead.apt", "$$ ORNL SLICER 2\n$$ -> MFGNO\nPARTNO / CF HY-80\n"
     "MACHIN / MILL, 01\nUNITS / MM\nCALSUB/START_PROG\nMULTAX/ ON\nPPRINT/ T1 TORCH\nLOADTL/1\n"
     "SEQUENCE/ BEGIN,toolpath\nRAPID\nGOTO / 10.0000, 5.0000, 2.5000, 0.0000, 0.0000, 0.0000\n"
     "CALSUB/START_DEPO\nFEDRAT/ MMPM, 720.0000\n"
     "GOTO / 60.0000, 5.0000, 2.5000, 0.0000, 0.0000, 0.0000\n"
     "GOTO / 60.0000, 9.0000, 2.5000, 0.0000, 0.0000, 0.0000\nCALSUB/STOP_DEPO\n",
     [upright(mm((10, 5, 2.5), (60, 5, 2.5), (60, 9, 2.5)), feed=0.012)])  # fmt: skip
