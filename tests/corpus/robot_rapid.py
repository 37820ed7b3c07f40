"""ABB RAPID: modules of RobotStudio and of path generators."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, TruePath, arc, at, case, held, mm

DOWN = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])  # x, y, z, w: half a turn about x


MODULE = r"""MODULE Module1
    PERS tooldata pen:=[TRUE,[[0,0,120],[1,0,0,0]],[0.5,[0,0,40],[1,0,0,0],0,0,0]];
    TASK PERS wobjdata plate:=[FALSE,TRUE,"",[[400,-50,200],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
    CONST robtarget Target_10:=[[10,20,50],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST robtarget Target_20:=[[10,20,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST robtarget Target_30:=[[60,20,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST robtarget Target_40:=[[60,80,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST jointtarget home:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
!***********
    PROC main()
        ! the contour
        MoveAbsJ home\NoEOffs,v1000,z100,pen;
        Path_10;
        SetDO gun,0;
        MoveAbsJ home\NoEOffs,v1000,z100,pen;
    ENDPROC
    PROC Path_10()
        MoveJ Target_10,v300,z10,pen\WObj:=plate;
        MoveL Target_20,v50,fine,pen\WObj:=plate;
        SetDO gun,1;
        MoveL Target_30,v50,z1,pen\WObj:=plate;
        MoveL Target_40,v50,fine,pen\WObj:=plate;
    ENDPROC
ENDMODULE
"""


case("ABB RAPID", "Module1.mod", MODULE,
     [held(DOWN, mm((10, 20, 50), (10, 20, 0), (60, 20, 0), (60, 80, 0)), feed=0.05)])  # fmt: skip
ARCS = r"""MODULE arcs
CONST speeddata slow:=[20,500,5000,1000];
PROC main()
ConfL \Off;
MoveJ [[520,0,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,fine,tool0;
MoveC [[500,20,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
  [[480,0,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],slow,z1,tool0\WObj:=wobj0;
MoveC [[500,-20,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
  [[520,0,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],slow,fine,tool0\WObj:=wobj0;
ENDPROC
ENDMODULE
"""


case("ABB RAPID", "arcs.mod", ARCS,
     [held(DOWN, arc(at(500, 0, 300), at(520, 0, 300), UP, 2 * np.pi), feed=0.02)])  # fmt: skip
HATCH = r"""MODULE hatch
    CONST robtarget start:=[[400,0,100],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    VAR num i;
    VAR robtarget from_;
    MoveJ Offs(start,0,0,50),v500,z50,tool0;
    FOR i FROM 0 TO 2 DO
      from_ := Offs(start, 0, i*10, 0);
      IF i > 5 THEN
        TPWrite "late";
      ENDIF
      MoveL from_, v100, z5, tool0;
      SetDO laser, 1;
      MoveL Offs(from_, 30*2, 0, 0), v100, z5, tool0;
      SetDO laser, 0;
    ENDFOR
    MoveL RelTool(start,0,0,-20\Rz:=90), v100, fine, tool0;
  ENDPROC
ENDMODULE
"""


@case("ABB RAPID", "hatch.mod", HATCH)
def hatch() -> list[TruePath]:
    lines = [(400.0 + x, 10.0 * k, 100.0) for k in range(3) for x in (0, 60)]
    # z of the tool points down, so that 20 mm against it is up.
    path = held(DOWN, mm((400, 0, 150), *lines, (400, 0, 120)), feed=0.1)
    path.rotations[-1] = (DOWN * Rotation.from_euler("z", 90, degrees=True)).as_matrix()
    return [path]


TWO_OBJECTS = r"""%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE two_objects
  PERS wobjdata w1:=[FALSE,TRUE,"",[[500,0,100],[0.70710678,0,0,0.70710678]],[[0,0,10],[1,0,0,0]]];
  PERS wobjdata w2:=[FALSE,TRUE,"",[[0,600,100],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
    CONST robtarget a:=[[0,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST robtarget b:=[[40,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    WHILE TRUE DO
      MoveL a,v100,fine,tool0\WObj:=w1;
      MoveL b,v100,fine,tool0\WObj:=w1;
      MoveJ a,v100,fine,tool0\WObj:=w2;
      MoveL b,v100,fine,tool0\WObj:=w2;
    ENDWHILE
  ENDPROC
ENDMODULE
"""


@case("ABB RAPID", "two_objects.prg", TWO_OBJECTS)
def two_objects() -> list[TruePath]:
    points = mm((0, 0, 0), (40, 0, 0))
    quarter = Rotation.from_euler("z", 90, degrees=True)
    first, second = quarter.apply(points) + at(500, 0, 110), points + at(0, 600, 100)
    return [held(quarter * DOWN, first, feed=0.1), held(DOWN, second, feed=0.1)]
