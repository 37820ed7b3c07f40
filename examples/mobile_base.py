"""A base that drives, with an arm: the hand follows a point, ten joints share the work."""

from pathlib import Path

import mink
import mujoco
import numpy as np
from app import DT, off, run

import qp_twist as qt

SCENE = Path(__file__).parents[1] / "scenes" / "mobile_arm.xml"
model = mujoco.MjModel.from_xml_path(str(SCENE))
bent = np.array([0.0, 0.4, 0.0, -1.6, 0.0, -0.4, 0.0])
configuration = mink.Configuration(model, np.concatenate([np.zeros(3), bent]))

hand = qt.TwistTask.point("arm_tool", "site", max_linear_step=0.02)  # three rows for ten joints
base = {"drive_x": 0.8, "drive_y": 0.8, "turn": 0.8}
arm = {f"arm_joint_{k}": 2.0 for k in range(1, 8)}
controller = qt.Controller(
    model,
    [hand],
    # The base moves where the arm would have to leave its posture, and is five times as dear.
    secondary=[qt.PostureReference(model, configuration.q, gain=0.02)],
    metric=np.concatenate([np.full(3, 25.0), np.ones(7)]),
    # The point starts at full speed.
    limits=[qt.MotionLimit(model, velocity=base | arm, acceleration=None)],
)
start = configuration.get_transform_frame_to_world("arm_tool", "site").translation()
errors, scales = [], []


def point(t: float) -> np.ndarray:
    angle = 0.5 * t
    return start + np.array(
        [1.5 * np.sin(angle), 1.5 * (1.0 - np.cos(angle)), 0.2 * np.sin(3.0 * angle)]
    )


def step(t: float) -> None:
    now, then = (mink.SE3.from_translation(point(at)) for at in (t, t + DT))
    configuration.data.mocap_pos[0] = then.translation()
    hand.set_target(now, qt.target_twist(now, then, DT))
    made = controller.step(configuration, DT)
    configuration.integrate_inplace(made.velocity, DT)
    hand.set_target(then)
    errors.append(off(hand, configuration))
    scales.append(made.scale)


run(configuration, step, lasts=4.0 * np.pi)
print(
    f"the base drove to {configuration.q[:2].round(2)} and turned by {configuration.q[2]:.2f} rad"
)
print(
    f"the hand was off the point by at most {max(errors):.1e} m; smallest scale {min(scales):.2f}"
)
