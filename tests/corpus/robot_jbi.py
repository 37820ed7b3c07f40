"""Yaskawa JBI: jobs of post processors."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, TruePath, arc, at, case, held, mm

JOB = """\
/JOB
//NAME {name}
//POS
///NPOS {count},0,0,0,0,0
///TOOL 1
{positions}//INST
///DATE 2024/01/01 12:00
///ATTR SC,RW,RJ
///GROUP1 RB1
NOP
{moves}END
"""
PLATE = """\
///POSTYPE PULSE
///PULSE
C00000=0,-1651,-20336,0,13929,0
///USER 2
///POSTYPE USER
///RECTAN
///RCONF 1,0,0,0,0,0,0,0
C00001=100.000,-20.500,0.000,180.0000,-10.0000,30.0000
C00002=100.000,0.500,0.000,180.0000,-10.0000,30.0000
C00003=160.250,0.500,2.250,-170.0000,0.0000,30.0000
"""
MOVES = """\
'a plate
MOVJ C00000 VJ=10.0 PL=0
MOVJ C00001 VJ=10.0
DOUT OT#(1) ON
MOVL C00002 V=50.0 PL=1
MOVL C00003 V=50.0
"""


ANGLES = [(180, -10, 30), (180, -10, 30), (-170, 0, 30)]
case("Yaskawa JBI", "PLATE.JBI", JOB.format(name="PLATE", count=4, positions=PLATE, moves=MOVES),
     [TruePath(mm((100, -20.5, 0), (100, 0.5, 0), (160.25, 0.5, 2.25)),
               rotations=Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix())]
)  # fmt: skip

RING = """\
///POSTYPE BASE
///RECTAN
///RCONF 1,0,0,0,0,0,0,0
P00001=520.000,0.000,300.000,180.0,0.0,0.0
P00002=500.000,20.000,300.000,180.0,0.0,0.0
P00003=480.000,0.000,300.000,180.0,0.0,0.0
P00004=440.000,0.000,300.000,180.0,0.0,0.0
"""
ARC = "".join(f"{word} P0000{k} V=46.0 PL=0\n" for word, k in (
    ("MOVL", 1), ("MOVC", 1), ("MOVC", 2), ("MOVC", 3), ("MOVL", 4)))  # fmt: skip
case("Yaskawa JBI", "RING.JBI", JOB.format(name="RING", count=4, positions=RING, moves=ARC),
     [held(Rotation.from_euler("x", 180, degrees=True),
           arc(at(500, 0, 300), at(520, 0, 300), UP, np.pi), mm((440, 0, 300)))])  # fmt: skip
