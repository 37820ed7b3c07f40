"""LinuxCNC and its kin: subprograms, names, switches of kinematics, offsets, absolute centres."""

import numpy as np

from corpus import UP, TruePath, arc, at, case, mm, upright
from corpus.gcode_fanuc import turned


@case("LinuxCNC", "boat-xyzac.ngc", "%\nM428 ;TCP:xyzac\n( 5 AXIS MILLING )\nG00 G17 G21 G40 G90\n"
      "G54 X-4.5 Y2 Z5 A0. C0. S630 M03\nG01 Z-1 F300.0\nX6.5 A-30 C20 F600\nM429\nM02\n"
      "%\n")  # fmt: skip
def boat() -> list[TruePath]:
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    ends = np.array([[-4.5, 2, 5, 0, 0], [-4.5, 2, -1, 0, 0], [6.5, 2, -1, -30, 20]])
    rows = np.vstack([ends[:1], ends[1] + shares * (ends[2] - ends[1])])
    # xyzac-trt: conventional-directions = 0, the table itself turns right-handed by A, then C.
    vectors = np.array([(turned("zx", -c, -a) @ [0, 0, 1, 0])[:3] for a, c in rows[:, 3:]])
    return [TruePath(1e-3 * rows[:, :3], vectors)]


@case("LinuxCNC", "spokes.ngc", "(spokes)\nG21 G90 G64 P0.01\n#<count> = 3\n#<far> = [10 * 2]\n"
      "o<spoke> sub\n  g0 x[#1 * cos[#2]] y[#1 * sin[#2]]\n  g1 z-1 f200\n  g1 x0 y0\n"
      "  g0 z5\no<spoke> endsub\nG0 X0 Y0 Z5\n#<k> = 0\no100 while [#<k> lt #<count>]\n"
      "  o101 if [#<k> eq 1]\n    o<spoke> call [#<far> / 2] [120]\n  o101 else\n"
      "    o<spoke> call [#<far>] [#<k> * 120]\n  o101 endif\n  #<k> = [#<k> + 1]\n"
      "o100 endwhile\nM2\n")  # fmt: skip
def spokes() -> list[TruePath]:
    found = []
    for k, far in enumerate((20.0, 10.0, 20.0)):
        x, y = far * np.cos(2 * np.pi * k / 3), far * np.sin(2 * np.pi * k / 3)
        points = mm((x, y, 5), (x, y, -1), (0, 0, -1))
        found.append(upright(points, feed=0.2 / 60))
    return found


case("LinuxCNC", "offsets.ngc", "G20 G90 G10 L2 P1 X1 Y2 Z3\nG54\nG0 X0 Y0 Z1\nG92 X5 Y0\n"
     "G1 Z0 F10\nX6\nG92.1\nY1\nM2\n",
     [upright(25.4 * mm((0, 0, 1), (0, 0, 0), (1, 0, 0), (1, 1, 0)), feed=10 * 0.0254 / 60)]
)  # fmt: skip
case("LinuxCNC", "centres.tap", "G17\nT2M6S1527F244.3( 10. END_MILL )\nG0X-22.Y-5.\nZ4.\n"
     "G1Z2.F122.2\nG2X-32.Y5.I-22.J5.\nM30\n",
     [upright(mm((-22, -5, 4)), arc(at(-22, 5, 2), at(-22, -5, 2), -UP, 0.5 * np.pi))])  # fmt: skip


@case("LinuxCNC", "indexed.ngc", "G21 G90\nG0 X0 Y0 Z30 A0\nG1 Z20 F100\nX10 A90\nG0 Z30\nM2\n")
def indexed() -> list[TruePath]:
    # A fourth axis: A turns the part about x through the origin, left-handed (ISO 841).
    found, axes = [np.array([0.0, 0.0, 30.0])], [UP]
    for share in np.linspace(0.0, 1.0, 400):
        turn = turned("x", 90.0 * share)
        found.append((turn @ [10.0 * share, 0.0, 20.0, 1.0])[:3])
        axes.append(turn[:3, 2])
    return [TruePath(1e-3 * np.array(found), np.array(axes))]


@case("LinuxCNC", "polar.ngc", "G21 G90 G17\nG0 @10 ^30 Z5\nG1 Z0 F600\n^120\nG91 @5\n^-30\nM2\n")
def polar() -> list[TruePath]:
    words = ((10, 30, 5), (10, 30, 0), (10, 120, 0), (15, 120, 0), (15, 90, 0))
    turns = [np.radians(angle) for _, angle, _ in words]
    points = [(r * np.cos(a), r * np.sin(a), z) for (r, _, z), a in zip(words, turns, strict=True)]
    return [upright(mm(*points), feed=0.01)]


case("LinuxCNC", "loops.ngc", "G21 G90\nG0 X0 Y0 Z0\n#1=0\nG1 F600\no1 do\n#1=[#1+1]\nX#1\n"
     "o1 while [#1 lt 3]\no2 repeat [5]\n#1=[#1+1]\no3 if [#1 eq 4]\no2 continue\n"
     "o3 elseif [#1 eq 6]\no2 break\no3 else\nY#1\no3 endif\no2 endrepeat\nX9\nM2\n",
     [upright(mm((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (3, 5, 0), (9, 5, 0)))])  # fmt: skip
