"""FANUC: percent signs, tip control, tilted planes, corners, drilling, macros."""

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, mm, upright

HEAD = "%\nO1001 (PART)\n(DATE 2024-05-02)\nN10 G00 G17 G40 G49 G80 G90\nN20 G21 T1 M06\nG54\n"


def turned(axes: str, *angles: float) -> Array:
    """Product of rotations about coordinate axes, degrees, as a matrix (4, 4)."""
    found = np.eye(4)
    for axis, angle in zip(axes, angles, strict=True):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        found = found @ step
    return found


@case("FANUC", "tip.nc", f"{HEAD}S8000 M03\nG43.4 H01\nG00 X10. Y0. Z30. A0. C0.\n"
      "G01 Z5. F600. A20. C15.\nX30. A40. C60.\nG00 Z50.\nG49\nG91 G28 Z0.\nM30\n%\n")  # fmt: skip
def tip() -> list[TruePath]:
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    ends = np.array([[10, 0, 30, 0, 0], [10, 0, 5, 20, 15], [30, 0, 5, 40, 60.0]])
    rows = np.vstack([a + shares * (b - a) for a, b in pairwise(ends)])
    # The part sees the tool turned by A about x, then by C about z (ISO 841).
    vectors = np.array([(turned("zx", c, a) @ [0, 0, 1, 0])[:3] for a, c in rows[:, 3:]])
    return [TruePath(1e-3 * rows[:, :3], vectors, feed=0.01)]


case("FANUC", "vectors.nc", f"{HEAD}G43.5 H01\nG00 X0. Y0. Z20. I0. J0. K1.\n"
     "G01 Z0. F300. I0.6 J0. K0.8\nX25. I0. J-0.6 K0.8\nG49\nM30\n%\n",
     [TruePath(mm((0, 0, 20), (0, 0, 0), (25, 0, 0)),
     np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8]]), feed=0.005)])  # fmt: skip


@case("FANUC", "tilted.nc", f"{HEAD}G68.2 X10. Y20. Z5. I30. J40. K-15.\nG53.1\n"
      "G43 H01\nG00 X0. Y0. Z25.\nG01 Z0. F400.\nX30.\nG03 X30. Y20. R10.\nG00 Z25.\nG69\n"
      "G91 G28 Z0.\nM30\n%\n")  # fmt: skip
def tilted() -> list[TruePath]:
    plane = turned("zxz", 30.0, 40.0, -15.0)
    plane[:3, 3] = at(10.0, 20.0, 5.0)
    half = arc(at(30, 10, 0), at(30, 0, 0), UP, np.pi)
    points = np.vstack([mm((0, 0, 25), (0, 0, 0)), half])
    whole = (np.hstack([points, np.ones((len(points), 1))]) @ plane.T)[:, :3]
    return [TruePath(whole, np.tile(plane[:3, 2], (len(points), 1)))]


case("FANUC", "corners.nc", f"{HEAD}G43 H1 Z20.\nG00 X0. Y0.\nG01 Z-2. F200.\nX40. ,R5. F500.\n"
     "Y30. ,C4.\nX0.\nY0.\nG00 Z20.\nM30\n%\n",
     [upright(mm((0, 0, 20), (0, 0, -2)), arc(at(35, 5, -2), at(35, 0, -2), UP, 0.5 * np.pi),
              mm((40, 26, -2), (36, 30, -2), (0, 30, -2), (0, 0, -2)))])  # fmt: skip
case("FANUC", "holes.nc", f"{HEAD}G00 X10. Y5.\nG43 H1 Z50. M08\nG99 G83 Z-12. R2. Q3. F100.\n"
     "X20.\nG98 Y15.\nG80\nG91 G28 Z0.\nM30\n%\n",
     [upright(mm((x, y, 2), (x, y, -12)), feed=0.1 / 60)
      for x, y in ((10, 5), (20, 5), (20, 15))])  # fmt: skip


@case("FANUC", "macro.nc", f"{HEAD}#100=3.\n#101=20.\nG00 X#101 Y0. Z5.\n#1=0\n"
      "WHILE [#1 LT #100] DO1\n#1=#1+1.\nG01 Z[-2.*#1] F150.\n"
      "X-#101 Y[#101*SIN[30.]+#1]\nM98 P2000 (BACK)\nEND1\nG00 Z50.\nM30\nO2000\n"
      "G01 X#101 Y0.\nM99\n%\n")  # fmt: skip
def macro() -> list[TruePath]:
    points = [(20.0, 0.0, 5.0)]
    for k in (1, 2, 3):
        points += [(20, 0, -2 * k), (-20, 10 + k, -2 * k), (20, 0, -2 * k)]
    found = mm(*points)
    return [upright(found, feed=0.15 / 60)]


# A quarter turn about (20, 10): (30, 10) becomes (20, 20), (30, 20) becomes (10, 20).
case("FANUC", "turned.nc", f"{HEAD}G52 X100. Y50.\nG00 X5. Y0. Z10.\nG01 Z0. F100.\n"
     "X15.\nG00 Z10.\n"
     "G52 X0 Y0\nG68 X20. Y10. R90.\nG00 X30. Y10.\nG01 Z0.\nY20.\nG69\nX0. Y0.\nM30\n%\n",
     [upright(mm((105, 50, 10), (105, 50, 0), (115, 50, 0))),
     upright(mm((20, 20, 10), (20, 20, 0), (10, 20, 0), (0, 0, 0)))])  # fmt: skip
# FANUC, Custom Macro, argument specification I: A to C, I to K, D to F, H, M, Q to Z.
case("FANUC", "arguments.nc", f"{HEAD}G00 X0. Y0. Z0.\nG01 F600.\nG65 P2 X3. Y4. Z-1. I5. D7.\n"
     "M30\nO2\nG01 X#24 Y#25 Z#26\nX#4 Y#7\nM99\n%\n",
     [upright(mm((0, 0, 0), (3, 4, -1), (5, 7, -1)))])  # fmt: skip
case("FANUC", "smooth.nc", f"{HEAD}G00 X1. Y2. Z5.\nG05.1 Q2 X0 Y0 Z0\nG01 Z0. F300.\n"
     "X9.\nG05.1 Q0\nM30\n%\n", [upright(mm((1, 2, 5), (1, 2, 0), (9, 2, 0)), feed=0.005)]
)  # fmt: skip
case("FANUC", "thousandths.txt", "%\n:0007\nN1 G90 G17 G54\nN2 G00 X0 Y0 Z20000\n"
     "N3 G01 Z0 F300\nN4 X50000\nN5 G02 X50000 Y-20000 I0 J-10000\nM30\n%\n",
     [upright(mm((0, 0, 20), (0, 0, 0)), arc(at(50, -10, 0), at(50, 0, 0), -UP, np.pi))]
)  # fmt: skip
