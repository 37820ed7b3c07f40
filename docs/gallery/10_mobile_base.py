"""A base that drives and an arm: ten joints share a task of three rows, the base at a price."""

import sys
from pathlib import Path

import mink
import mujoco
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

scenes = Path(qt.load_task("deburring").scene).parent
model = mujoco.MjModel.from_xml_path(str(scenes / "mobile_arm.xml"))
bent = [0.0, 0.0, 0.0, 0.0, 0.4, 0.0, -1.6, 0.0, -0.4, 0.0]
configuration = mink.Configuration(model, np.array(bent))
hand = qt.TwistTask.point("arm_tool", "site", max_linear_step=0.02)
controller = qt.Controller(
    model,
    [hand],
    secondary=[qt.PostureReference(model, configuration.q, gain=0.05)],
    metric=np.array([25.0] * 3 + [1.0] * 7),  # the base is five times as dear as the arm
)

dt = 0.02
start = configuration.get_transform_frame_to_world("arm_tool", "site").translation()
arms, points, hands, bases = [], [], [], []
for t in np.arange(0.0, 4.0 * np.pi, dt):
    angle = 0.5 * t
    around = [1.5 * np.sin(angle), 1.5 * (1.0 - np.cos(angle)), 0.2 * np.sin(3.0 * angle)]
    point = start + np.array(around)
    hand.set_target(mink.SE3.from_translation(point))
    step = controller.step(configuration, dt)
    configuration.integrate_inplace(step.velocity, dt)
    tip = configuration.get_transform_frame_to_world("arm_tool", "site").translation()
    arms.append(np.vstack([configuration.data.xanchor[2:], tip])[:, :2])
    points.append(point[:2])
    hands.append(tip[:2])
    bases.append(configuration.q[:2].copy())

figure = Figure(figsize=(8, 4.2), layout="constrained")
panel = figure.subplots()
panel.plot(*np.array(points).T, color="#D55E00", lw=4, alpha=0.4, label="the point")
panel.plot(*np.array(hands).T, color="#D55E00", lw=1.2, label="the hand")
panel.plot(*np.array(bases).T, "--", color="#0072B2", lw=2, label="the base")
for k in range(0, len(arms), 63):
    panel.plot(*arms[k].T, color="#777777", lw=1.5)
    panel.plot(*arms[k][0], "s", color="#0072B2", markersize=7)
panel.set(aspect="equal", xlabel="x, m (seen from above)", ylabel="y, m")
panel.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_10.png", dpi=110)
