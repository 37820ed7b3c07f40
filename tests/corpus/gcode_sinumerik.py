"""Siemens SINUMERIK: TRAORI, vectors, CYCLE800, frames, corners."""

import numpy as np

from corpus import UP, TruePath, arc, at, case, mm, upright
from corpus.gcode_fanuc import turned

HEAD = '%_N_PART_MPF\n;$PATH=/_N_WKS_DIR/_N_PART_WPD\nN10 G0 G17 G40 G71 G90 G94\nN20 T="D10" D1\n'
case("SINUMERIK", "vectors.mpf", f"{HEAD}N30 M6\nN40 TRAORI\nN50 ORIWKS ORIAXES FFWON COMPCAD\n"
     "N55 MSG(\"A; (B)\")\nN60 CYCLE832(0.01,1,1)\n"
     "N70 G0 X0 Y0 Z20 A3=0 B3=0 C3=1\nN80 G1 Z0 F1200 A3=0.6 B3=0 C3=0.8\n"
     "N90 X25 A3=0 B3=-0.6 C3=0.8\nN100 TRAFOOF\nN110 G0 SUPA Z0 D0\nN120 M30\n",
     [TruePath(mm((0, 0, 20), (0, 0, 0), (25, 0, 0)),
     np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8]]), feed=0.02)])  # fmt: skip


@case("SINUMERIK", "swivel.mpf", f"{HEAD}N30 CYCLE800(1,\"TC1\",0,54,5,6,7,20,-30,40,1,2,3,1,0,1)\n"
      "N40 G0 X0 Y0 Z30\nN50 G1 Z0 F500\nN60 X=10 Y=IC(4)\nN70 G3 X20 Y4 CR=5\n"
      "N80 G0 Z30\nN90 CYCLE800()\nN100 M30\n")  # fmt: skip
def swivel() -> list[TruePath]:
    # Mode 54: about y, then x, then z, each as it was turned.
    plane = turned("yxz", 20.0, -30.0, 40.0)
    plane[:3, 3] = [5.0, 6.0, 7.0]
    after = np.eye(4)
    after[:3, 3] = [1.0, 2.0, 3.0]
    plane = plane @ after
    half = 1e3 * arc(at(15, 4, 0), at(10, 4, 0), UP, np.pi)
    points = np.vstack([[[0, 0, 30], [0, 0, 0]], half])
    whole = (np.hstack([points, np.ones((len(points), 1))]) @ plane.T)[:, :3]
    return [TruePath(1e-3 * whole, np.tile(plane[:3, 2], (len(points), 1)))]


case("SINUMERIK", "frames.spf", f"{HEAD}N30 TRANS X100 Y20\nN40 AROT Z90\nN50 G0 X0 Y0 Z5\n"
     "N60 G1 Z0 F300\nN70 X10\nN80 TRANS\nN90 Y0\nN100 M17\n",
     [upright(mm((100, 20, 5), (100, 20, 0), (100, 30, 0), (100, 0, 0)), feed=0.005)])  # fmt: skip


@case("SINUMERIK", "corners.mpf", f"{HEAD}N30 G0 X0 Y0 Z1\nN40 G1 Z0 F300\nN50 X30 RND=6\n"
      "N60 X30 Y40 CHR=3\nN70 X0 CHF=2\nN80 Y20\nN90 M30\n")  # fmt: skip
def corners() -> list[TruePath]:
    rounded = arc(at(24, 6, 0), at(24, 0, 0), UP, 0.5 * np.pi)
    leg = np.sqrt(2.0)
    return [upright(mm((0, 0, 1), (0, 0, 0)), rounded, mm((30, 37, 0), (27, 40, 0)),
                    mm((leg, 40, 0), (0, 40 - leg, 0), (0, 20, 0)))]  # fmt: skip


case("SINUMERIK", "parameters.mpf", f"{HEAD}N30 R1=5 R2=R1*2 ; size\nN40 R3=SQRT(R2*R2+(R1+6)*4)\n"
     "N50 G0 X=-R1 Y=R1+R2 Z=R1\nN60 G1 Z0 F=R2*30\nN70 X=R3\nN80 Y=IC(-R1) X=R2*SIN(30)\n"
     "N90 M30\n",
     [upright(mm((-5, 15, 5), (-5, 15, 0), (float(np.sqrt(100 + 44)), 15, 0), (5, 10, 0)),
     feed=0.005)])  # fmt: skip
case("SINUMERIK", "drilling.mpf", f"{HEAD}N30 G0 X5 Y5 Z50\nN40 F120\nN50 CYCLE81(20,0,2,-8)\n"
     "N60 MCALL CYCLE83(20,1,2,,9,0,3)\nN70 G0 X15\nN80 X25 Y9\nN90 MCALL\nN100 G0 X0 Y0\n"
     "N110 M30\n",
     [upright(mm((x, y, z), (x, y, -8)), feed=0.002)
      for x, y, z in ((5, 5, 2), (15, 5, 3), (25, 9, 3))])  # fmt: skip


@case("SINUMERIK", "arcs.mpf", f"{HEAD}N30 G0 X0 Y0 Z0\nN40 G1 X10 F600\nN50 CT X20 Y10\n"
      "N60 CIP X20 Y10 Z20 I1=20 J1=20 K1=10\nN70 G91 CIP X-10 Y0 Z0 I1=IC(-5) J1=5\n"
      "N80 M30\n")  # fmt: skip
def arcs() -> list[TruePath]:
    tangent = arc(at(10, 10, 0), at(10, 0, 0), UP, 0.5 * np.pi)
    through = arc(at(20, 10, 10), at(20, 10, 0), np.array([1.0, 0, 0]), np.pi)
    half = arc(at(15, 10, 20), at(20, 10, 20), UP, np.pi)
    return [upright(mm((0, 0, 0)), tangent, through, half)]
