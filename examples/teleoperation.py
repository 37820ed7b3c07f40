"""Two arms, each after the hand of an operator: 30 poses a second, of which some never come."""

from pathlib import Path

import mink
import mujoco
import numpy as np
from app import DT, off, run

import qp_twist as qt

SCENE = Path(__file__).parents[1] / "scenes" / "two_arms.xml"
model = mujoco.MjModel.from_xml_path(str(SCENE))
left, right = [0.0, 0.1, 0.0, -1.5, 0.0, 0.8, 0.0], [0.0, 0.3, 0.0, -1.7, 0.0, -1.2, 0.0]
configuration = mink.Configuration(model, np.array(left + right))
sides = ("left", "right")
tasks = {side: qt.TwistTask.axis_free(f"{side}_tool", "site") for side in sides}
controller = qt.Controller(
    model,
    list(tasks.values()),
    secondary=[qt.PostureReference(model, configuration.q, gain=0.01)],
    limits=[qt.MotionLimit(model, velocity=1.5)],
)
now = [0.0]
servo = qt.Servo(controller, configuration, period=DT, clock=lambda: now[0])
begin = {side: configuration.get_transform_frame_to_world(f"{side}_tool", "site") for side in sides}
rng = np.random.default_rng(0)
worst = dict.fromkeys(sides, 0.0)
seen = []


def hand(side: str, t: float) -> mink.SE3:
    """Where the operator's hand is."""
    phase = 0.0 if side == "left" else 1.0
    shift = 0.1 * np.array([np.sin(t + phase) - np.sin(phase), 0.0, 0.5 * np.sin(1.7 * t)])
    return mink.SE3.from_translation(shift) @ begin[side]


def step(t: float) -> None:
    """One tick; the right stream has a gap of a second."""
    now[0] = t
    for side in sides:
        gap = side == "right" and 3.0 < t < 4.0
        if round(t / DT) % 3 == 0 and not gap and rng.random() > 0.1:
            servo.track(hand(side, t), task=tasks[side])
    tick = servo.tick()
    configuration.integrate_inplace(tick.velocity, DT)
    if tick.state.name not in seen:
        seen.append(tick.state.name)
    for side in sides:
        if 1.0 < t < 3.0:
            place = configuration.get_transform_frame_to_world(f"{side}_tool", "site")
            behind = place.translation() - hand(side, t).translation()
            worst[side] = max(worst[side], float(np.linalg.norm(behind)))


run(configuration, step, lasts=8.0)
print("states:", ", ".join(seen).lower())
for side in sides:
    print(f"the {side} tool was at most {1e3 * worst[side]:.0f} mm behind the hand")
print(f"at the end off by {max(off(task, configuration) for task in tasks.values()):.1e} (m, rad)")
