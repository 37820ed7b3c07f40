"""Universal Robots URScript: scripts of post processors, of generators and of PolyScope."""

import numpy as np
from scipy.spatial.transform import Rotation

from corpus import UP, Array, TruePath, arc, at, case, held, mm


def rotvec(*vectors: tuple[float, float, float]) -> Array:
    """Rotation matrices of rotation vectors, rad."""
    return Rotation.from_rotvec(np.array(vectors)).as_matrix()


PROGRAM = """\
def Program():
  penTcp = p[0, 0.05, 0.12, -1.5708, 0, 0]
  Speed000 = 0.1
  Zone000 = 0
  set_tcp(penTcp)
  set_payload(1.36, [0, 0, 0.05])
  movej([-0.95, -1.43, -2.41, -2.43, -0.95, -3.14], a=3.1, v=0.37, r=Zone000)
  movel(p[-0.025, -0.4, 0.1, 0, 3.14159, 0], a=1, v=Speed000, r=Zone000)
  set_digital_out(0, True)
  movel(p[-0.025, -0.48, 0.1, 0, 3.14159, 0], a=1, v=Speed000, r=0.001)
  textmsg("end, now")
  movel(p[0.05, -0.48, 0.1, 0.1, 3.1, 0], a=1, v=Speed000, r=Zone000)
end
"""


case("URScript", "program.script", PROGRAM,
     [TruePath(np.array([[-0.025, -0.4, 0.1], [-0.025, -0.48, 0.1], [0.05, -0.48, 0.1]]),
     rotations=rotvec((0, 3.14159, 0), (0, 3.14159, 0), (0.1, 3.1, 0)), feed=0.1 )])  # fmt: skip
POST = """\
def Prog1():
  # Global parameters:
  global speed_ms = 0.250
  global speed_rads = 0.750
  global accel_mss = 1.2
  global blend_radius_m = 0.001
  # set_reference(p[0.4, -0.2, 0.1, 0.0, 0.0, 1.5707963267949])
  global ref_frame = p[0.4, -0.2, 0.1, 0.0, 0.0, 1.5707963267949]
  movej(pose_trans(ref_frame,p[0.01, 0.02, 0.05, 3.1415927, 0, 0]),1.2,speed_rads,0,0)
  speed_ms = 0.050
  movel(pose_trans(ref_frame,p[0.01, 0.02, 0, 3.1415927, 0, 0]),accel_mss,speed_ms,0,blend_radius_m)
  movel(pose_trans(ref_frame,p[0.06, 0.02, 0, 3.1415927, 0, 0]),accel_mss,speed_ms,0,blend_radius_m)
end

Prog1()
"""


@case("URScript", "post.script", POST)
def post() -> list[TruePath]:
    quarter = Rotation.from_euler("z", 90, degrees=True)
    local = np.array([[0.01, 0.02, 0.05], [0.01, 0.02, 0], [0.06, 0.02, 0]])
    points = quarter.apply(local) + np.array([0.4, -0.2, 0.1])
    return [held(quarter * Rotation.from_rotvec([np.pi, 0, 0]), points, feed=0.05)]


CIRCLE = """\
movej(p[0.52, 0, 0.3, 3.1415927, 0, 0], a=1.2, v=0.3)
movec(p[0.5, 0.02, 0.3, 3.1415927, 0, 0], p[0.48, 0, 0.3, 3.1415927, 0, 0], a=0.3, v=0.02, r=0.001)
movec(p[0.5, -0.02, 0.3, 3.1415927, 0, 0], p[0.52, 0, 0.3, 3.1415927, 0, 0], a=0.3, v=0.02)
movep(p[0.56, 0, 0.3, 3.1415927, 0, 0], a=0.3, v=0.02, r=0.0)
stopl(1.2)
"""


case("URScript", "circle.script", CIRCLE,
     [held(Rotation.from_rotvec([np.pi, 0, 0]),
           arc(at(500, 0, 300), at(520, 0, 300), UP, 2 * np.pi), mm((560, 0, 300)), feed=0.02)]
)  # fmt: skip
POLYSCOPE = """\
def seam():
  set_gravity([0.0, 0.0, 9.82])
  set_tcp(p[0.0,0.0,0.1,0.0,0.0,0.0])
  step_count_1 = 0.0
  thread Step_Counter():
    while (True):
      step_count_1 = step_count_1 + 1.0
      sync()
    end
  end
  run Step_Counter()
  global A_p=p[.3, -.4, .2, 2.2, -2.2, .0]
  global A_q=[1.5, -1.2, 1.4, -1.7, -1.5, 0.0]
  global B_p=p[.35, -.4, .2, 2.2, -2.2, .0]
  while (True):
    $ 1 "Robot Program"
    $ 2 "MoveJ"
    movej(get_inverse_kin(A_p, qnear=A_q), a=1.3962634015954636, v=1.0471975511965976)
    $ 4 "MoveL"
    movel(B_p, a=1.2, v=0.25)
    if (get_standard_digital_in(1) == True):
      set_standard_digital_out(0, True)
    end
    movel(pose_add(B_p, p[0,0.06,0,0,0,0]), a=1.2, v=0.25)
  end
end
"""


case("URScript", "polyscope.script", POLYSCOPE,
     [TruePath(np.array([[0.3, -0.4, 0.2], [0.35, -0.4, 0.2], [0.35, -0.34, 0.2]]),
     rotations=rotvec(*[(2.2, -2.2, 0)] * 3), feed=0.25)])  # fmt: skip
