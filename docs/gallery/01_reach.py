"""Reach a point with a planar arm of three joints: two rows of the task, one joint to spare."""

import sys

import mink
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

model = qt.load_task("planar_line").model  # three hinges, links of 2, 1.5 and 1 m
in_the_plane = qt.TwistProjector(linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none())
task = qt.TwistTask("tip", "site", in_the_plane, gain=0.4)  # removes 40 % of the error a step
goal = np.array([0.5, 2.8, 0.0])
task.set_target(mink.SE3.from_translation(goal))
controller = qt.Controller(model, [task])

configuration = mink.Configuration(model, np.radians([70.0, 70.0, 100.0]))
arms, errors = [], []
for _ in range(13):
    joints, tip = configuration.data.xanchor, configuration.data.site("tip").xpos
    arms.append(np.vstack([joints, tip])[:, :2])
    errors.append(np.linalg.norm(goal - tip))
    step = controller.step(configuration, dt=0.1)
    configuration.integrate_inplace(step.velocity, 0.1)

figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[1.2, 1])
for k, arm in enumerate(arms):
    left.plot(*arm.T, "-o", color="#0072B2", alpha=0.12 + 0.88 * k / 12, markersize=4)
left.plot(*goal[:2], "+", color="#D55E00", markersize=16, markeredgewidth=2.5)
left.set(aspect="equal", xlabel="x, m", ylabel="y, m")
right.semilogy(errors, "-o", color="#0072B2")
right.set(xlabel="step", ylabel="distance from the point, m")
right.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_01.png", dpi=110)
