"""Two arms: one holds a plate and moves it, the other draws on it, as if the plate stood still."""

from pathlib import Path

import mink
import mujoco
import numpy as np
from app import DT, off, run

import qp_twist as qt

SCENE = Path(__file__).parents[1] / "scenes" / "two_arms.xml"
spec = mujoco.MjSpec.from_file(str(SCENE))
held = spec.body("right_link_7").add_body(name="plate", pos=[0, 0, 0.13])
held.add_geom(
    type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.12, 0.12, 0.005], rgba=[0.3, 0.6, 0.5, 1], mass=0.3
)
held.add_site(name="face", pos=[0, 0, 0.006])
model = spec.compile()
left, right = [0.0, 0.1, 0.0, -1.5, 0.0, 0.8, 0.0], [0.0, 0.3, 0.0, -1.7, 0.0, -1.2, 0.0]
configuration = mink.Configuration(model, np.array(left + right))

# The pen on the plate, its axis into it; the roll of the pen is free. The plate carries the target.
pen = qt.TwistTask.axis_free(
    "left_tool", "site", relative_to=("face", "site"), max_linear_step=0.005, max_angular_step=0.03
)
into = mink.SO3.from_x_radians(np.pi)
carry = qt.TwistTask.axis_free("plate", "body", max_linear_step=0.005)
controller = qt.Controller(
    model,
    levels=[[pen], [carry]],  # where both do not fit, the drawing comes first
    secondary=[qt.PostureReference(model, configuration.q, gain=0.01)],
    limits=[qt.MotionLimit(model, velocity=1.5)],
)
plate = configuration.get_transform_frame_to_world("plate", "body")
drawn, moved = [], []


def on_plate(t: float) -> mink.SE3:
    circle = np.array([0.06 * np.cos(2.0 * t), 0.06 * np.sin(2.0 * t), 0.001])
    return mink.SE3.from_rotation_and_translation(into, circle)


def in_the_air(t: float) -> mink.SE3:
    sway = mink.SO3.from_y_radians(0.3 * np.sin(t))
    shift = np.array([0.05 * (1.0 - np.cos(t)), 0.1 * np.sin(0.7 * t), 0.08 * np.sin(1.3 * t)])
    return mink.SE3.from_translation(shift) @ plate @ mink.SE3.from_rotation(sway)


def step(t: float) -> None:
    for task, at in ((pen, on_plate), (carry, in_the_air)):
        task.set_target(at(t), qt.target_twist(at(t), at(t + DT), DT))
    configuration.integrate_inplace(controller.step(configuration, DT).velocity, DT)
    pen.set_target(on_plate(t + DT))
    if t > 1.0:  # once the pen is there
        drawn.append(off(pen, configuration))
    now = configuration.get_transform_frame_to_world("plate", "body")
    moved.append(np.linalg.norm(now.translation() - plate.translation()))


run(configuration, step, lasts=20.0)
print(f"the plate moved by up to {1e3 * max(moved):.0f} mm")
print(f"the pen was off its line on the plate by at most {max(drawn, default=0.0):.1e} (m, rad)")
