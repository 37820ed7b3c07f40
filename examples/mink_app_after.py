"""A mink app as it is now: the hand follows a target that is dragged in the viewer."""

from pathlib import Path

import mink
import mujoco
import numpy as np
from app import DT, HEADLESS, run

import qp_twist as qt

SCENE = Path(__file__).parents[1] / "scenes" / "arm_and_table.xml"
model = mujoco.MjModel.from_xml_path(str(SCENE))
configuration = mink.Configuration(model, np.array([0.0, 0.2, 0.0, -1.5, 0.0, 1.4, 0.0]))
data, mocap = configuration.data, model.body("target").mocapid[0]

hand = qt.TwistTask.axis_free("arm_tool", "site")  # the roll about its z is free
posture = mink.PostureTask(model, cost=1e-2)
posture.set_target_from_configuration(configuration)
limits = [
    mink.ConfigurationLimit(model),
    mink.VelocityLimit(model, {f"arm_joint_{k}": 1.0 for k in range(1, 8)}),
]
errors = []


def step(t: float) -> None:
    if HEADLESS:  # nobody drags it: around in a circle
        data.mocap_pos[mocap] = [0.5, 0.2 * np.sin(t), 0.45 + 0.1 * np.cos(t)]
        data.mocap_quat[mocap] = mink.SO3.from_y_radians(np.pi + 0.3 * np.sin(2.0 * t)).wxyz
    target = mink.SE3.from_mocap_id(data, mocap)
    hand.set_target(target)
    velocity = qt.solve_ik(configuration, [posture], DT, "daqp", limits=limits, constraints=[hand])
    configuration.integrate_inplace(velocity, DT)
    tool = target.inverse() @ configuration.get_transform_frame_to_world("arm_tool", "site")
    errors.append(1e3 * np.linalg.norm(tool.translation()))


run(configuration, step, lasts=60.0)
settled = errors[100:] or errors
print(f"off by {np.median(settled):.2g} mm in the median, {max(settled):.2g} mm at most")
